"""The pictures: the Wiggers diagram and the pressure-volume loops."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D

# One colour per place, the same in every picture (left side warm, right side cool).
COLOUR = {
    "LV": "#b2182b",
    "LA": "#ef8a62",
    "aorta": "#67001f",
    "RV": "#2166ac",
    "RA": "#67a9cf",
    "PA": "#053061",
    "MV": "#ef8a62",
    "AV": "#b2182b",
    "TV": "#67a9cf",
    "PV": "#2166ac",
}
PHASE_COLOUR = {"AC": "#fdb863", "IVC": "#b2abd2", "VE": "#e66101", "IVR": "#5e3c99", "VPF": "#80b1a4"}
PHASE_NAME = {
    "AC": "atrial contraction",
    "IVC": "isovolumetric contraction",
    "VE": "ejection",
    "IVR": "isovolumetric relaxation",
    "VPF": "passive filling",
}
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelsize": 9,
    "axes.titlesize": 10,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.6,
    "svg.fonttype": "none",
}


def wiggers_diagram(result):
    with plt.rc_context(STYLE):
        ecg = result.ecg_surrogate()
        heights = [2.6, 1.6, 2.0, 2.0, 0.9] + ([0.9] if ecg is not None else [])
        figure, panels = plt.subplots(
            len(heights), 1, sharex=True, figsize=(8.2, 1.28 * sum(heights)), height_ratios=heights
        )
        t = result.time * 1e3
        left, right, volumes, flows, bars = panels[:5]

        left.plot(t, result.circulation["p_AR_SYS"], color=COLOUR["aorta"], label="aorta", ls="--")
        left.plot(t, result.pressure["LV"], color=COLOUR["LV"], label="left ventricle")
        left.plot(t, result.pressure["LA"], color=COLOUR["LA"], label="left atrium")
        right.plot(t, result.circulation["p_AR_PUL"], color=COLOUR["PA"], label="pulmonary artery", ls="--")
        right.plot(t, result.pressure["RV"], color=COLOUR["RV"], label="right ventricle")
        right.plot(t, result.pressure["RA"], color=COLOUR["RA"], label="right atrium")
        for panel in (left, right):
            panel.set_ylabel("pressure [mmHg]")
        for chamber, name in (("LV", "left ventricle"), ("RV", "right ventricle"), ("LA", "left atrium"), ("RA", "right atrium")):
            volumes.plot(t, result.volume[chamber], color=COLOUR[chamber], label=name)
        volumes.set_ylabel("volume [mL]")
        for valve, name in (("AV", "aortic"), ("PV", "pulmonary"), ("MV", "mitral"), ("TV", "tricuspid")):
            flows.plot(t, result.flow[valve], color=COLOUR[valve], label=name)
        flows.set_ylabel("valve flow [mL/s]")
        for panel in (left, right, volumes, flows):
            panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            panel.axhline(0, color="0.8", lw=0.6, zorder=0)

        for row, (valve, name) in enumerate((("PV", "pulmonary"), ("TV", "tricuspid"), ("AV", "aortic"), ("MV", "mitral"))):
            spans = [(1e3 * a, 1e3 * (b - a)) for a, b in result.open_spans(valve)]
            bars.barh(row, t[-1], left=0, height=0.62, color="0.93", zorder=1)
            bars.broken_barh(spans, (row - 0.31, 0.62), facecolors=COLOUR[valve], zorder=2)
        bars.set_yticks(range(4), ["pulmonary", "tricuspid", "aortic", "mitral"])
        bars.tick_params(axis="y", length=0)
        bars.set_ylim(-0.6, 3.6)
        bars.text(1.01, 0.5, "valve open", transform=bars.transAxes, fontsize=8, va="center")
        bars.spines["left"].set_visible(False)
        if ecg is not None:
            panels[5].plot(t, ecg, color="black", lw=1.3)
            panels[5].set_ylabel("ECG\nsurrogate")
            panels[5].set_yticks([])
        panels[-1].set_xlabel("time [ms]")
        panels[-1].set_xlim(0, t[-1])

        for panel in panels:
            shade_phases(panel, result)
        _name_phases(left, result)
        title = result.title if result.is_whole_beat else f"{result.title}: until {result.end_ms}"
        figure.suptitle(title, y=0.995, fontsize=12, fontweight="bold")
        # The valve names of the bar panel would push the labels off the sheet.
        figure.align_ylabels([panel for panel in panels if panel is not bars])
        figure.subplots_adjust(left=0.115, right=0.80, top=0.945, bottom=0.05, hspace=0.13)
        return figure


def _phase_spans(result, side="left"):
    """Phases as spans within [0, period] in ms, split where they wrap."""
    for name, (begin, end) in result.phases.get(side, {}).items():
        begin, end = 1e3 * begin, 1e3 * end
        period = 1e3 * result.period
        if abs(end - begin) < 1e-9:
            continue
        if end > begin:
            yield name, begin, end
        else:
            if period - begin > 1e-6:
                yield name, begin, period
            if end > 1e-6:
                yield name, 0.0, end


def shade_phases(panel, result):
    for name, begin, end in _phase_spans(result):
        panel.axvspan(begin, end, color=PHASE_COLOUR[name], alpha=0.13, lw=0, zorder=0)


def _name_phases(panel, result):
    for name, begin, end in _phase_spans(result):
        if end - begin > 0.03 * 1e3 * result.period:
            panel.text(0.5 * (begin + end), 1.015, name, transform=panel.get_xaxis_transform(), ha="center", va="bottom", fontsize=8.5, color="0.25")


def pv_loops(result):
    """Loops over a whole beat; open curves where a part of a beat was run."""
    phases_known = bool(result.phases)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 2, figsize=(8.2, 7.2))
        for axis, (chamber, name, side) in zip(
            axes.flat,
            (("LV", "left ventricle", "left"), ("RV", "right ventricle", "right"), ("LA", "left atrium", "left"), ("RA", "right atrium", "right")),
        ):
            V, p = result.volume[chamber], result.pressure[chamber]
            phases = result.phase_at(side)
            if phases_known:
                axis.plot(V, p, color="0.75", lw=1)
            else:
                axis.plot(V, p, color=COLOUR[chamber])
            if not result.is_whole_beat:  # an open curve
                axis.plot(V[0], p[0], "o", color=COLOUR[chamber], mfc="white", ms=5.5)
                axis.plot(V[-1], p[-1], "o", color=COLOUR[chamber], ms=5.5)
                axis.ticklabel_format(useOffset=False)
            for phase, colour in PHASE_COLOUR.items():
                inside = phases == phase
                joined = inside | np.roll(inside, 1)  # draw up to the first sample of the next phase
                joined[0] = inside[0]
                axis.plot(np.where(joined, V, np.nan), np.where(joined, p, np.nan), color=colour, lw=2.2)
            axis.set_title(name)
            axis.set_xlabel("volume [mL]")
            axis.set_ylabel("pressure [mmHg]")
            axis.margins(0.08)
            if not result.is_whole_beat:  # what hardly changes is not blown up
                for values, limit in ((V, axis.set_xlim), (p, axis.set_ylim)):
                    if np.ptp(values) < 0.5:  # mL or mmHg
                        middle = 0.5 * (values.min() + values.max())
                        limit(middle - 0.5, middle + 0.5)
        handles = [Line2D([], [], color=PHASE_COLOUR[p], lw=3, label=f"{p}  {PHASE_NAME[p]}") for p in PHASE_COLOUR if phases_known]
        if not result.is_whole_beat:
            handles += [Line2D([], [], color="0.3", marker="o", ls="", mfc=fill, label=name)
                        for fill, name in (("white", "start of the beat"), ("0.3", f"end of the run, {result.end_ms}"))]
        if handles:
            figure.legend(handles=handles, loc="lower center", ncol=3, fontsize=8.5)
        kind = "loops" if result.is_whole_beat else "curves"
        figure.suptitle(f"{result.title}: pressure-volume {kind}", fontsize=12, fontweight="bold")
        figure.subplots_adjust(left=0.08, right=0.98, top=0.90, bottom=0.15, hspace=0.34, wspace=0.24)
        return figure
