"""The report of a body of 3D tissue that was run alone: its electrophysiology, or its mechanics under prescribed loads.

Results are those of tissue/body/body_run.hpp. Drawing and tables are shared with the tissue of a heart (tissue.py,
tissue_page.py); here is what those results hold, which pictures they allow and what the page says.
"""

import html
import json
import tomllib
from pathlib import Path

import h5py
import matplotlib.pyplot as plt
import numpy as np
from figures import COLOUR, STYLE
from matplotlib.colors import Normalize
from page import table, verdict_list, write_document
from result import CHAMBERS, ResultFile, provenance, wall_figures
from tissue import STRETCH_ROWS, Body, Tissue, activation_views, cost_chart, field_views, lead_chart, make_pictures
from tissue_page import SMALLEST_GOOD_VOLUME_RATIO, cost_table, embedded, sizes_table
from vtu import Frame

CHAMBER_NAMES = {"LA": "left atrium", "LV": "left ventricle", "RA": "right atrium", "RV": "right ventricle"}
LEAD_UNIT = "mV m²/s"
MOST_TABLE_ROWS = 25  # of the load; longer tables are thinned out
CAPTIONS = {
    "activation": "Activation: the moment the potential of a point rises above its threshold, in the last beat, on all surfaces "
                  "of the myocardium. The mesh does not move. Azimuths turn from x towards y.",
    "curves": "Share of the nodes that were activated in the beat, and means over all nodes. Dotted: a beat begins.",
    "leads": "Pseudo-ECG at the electrodes of the scene: the tissue in an endless uniform conductor, no torso.",
    "potential": "Membrane potential. One camera and one scale throughout; the section passes through the middle along the long "
                 "axis. Grey: caps and other tissue without cells.",
    "cost": "Wall time of each part on the first process. The share is of what is shown.",
    "pressure_volume": "Pressure over volume of each cavity; a dot for each equilibrium that was found.",
    "load": "Mean fibre stretch of the myocardium, and J, the volume over that in the unloaded shape: of the myocardium and the "
            "smallest of all elements.",
    "deformation": "One camera and one scale throughout; the section passes through the middle along the long axis. Grey: "
                   "caps and other tissue without fibres. The colours end at the 99th percentile.",
}


def is_body(result_path):
    """Whether a result file is of a body alone and not of a heart."""
    with h5py.File(result_path, "r") as file:
        return "body" in file


def report_body(result_path, answer):
    """Adds the pictures and the page to the answer. Returns the page, the pictures and what was left out."""
    result = BodyResult(result_path)
    kind = MechanicsBody if result.physics == "mechanics" else ElectrophysiologyBody
    body = kind(result, "body")
    pictures = make_pictures(body, body.makers(), answer)
    page = write_document(answer, result, body.page_parts(pictures))
    return page, list(pictures.values()), body.trouble


class BodyResult:
    """One result file of a body, read into arrays by name."""

    phases = {}  # no heart around it

    def __init__(self, path):
        self.path = Path(path)
        with ResultFile(path) as file:
            self.summary = json.loads(file["summary"][()].decode())
            self.physics = self.summary["physics"]
            # Rows stand over the time (s), or over the share of the load.
            self.rows = file["load" if self.physics == "mechanics" else "time"][:]
            self.curves = {name: data[:] for name, data in file["body"].items()}
            self.cavities = {
                chamber: (file[f"cavities/{chamber}/pressure"][:], file[f"cavities/{chamber}/volume"][:])  # mmHg, mL
                for chamber in CHAMBERS
                if chamber in file.get("cavities", {})
            }
            self.walls = wall_figures(file)
            self.scene, self.title, self.version, self.status = provenance(file)
        self.settings = tomllib.loads(self.scene)
        self.span = "the load in the result" if self.physics == "mechanics" else "the time in the result"

    def tissue_settings(self, _name):
        """The table of the body in the scene."""
        return self.settings.get("body", {})


class AloneBody(Tissue):
    """What bodies of both kinds of physics share."""

    def frames_of_result(self, frames):
        # A run that was killed may have written frames after its last checkpoint.
        last = self.result.rows[-1]
        return [(at, path) for at, path in frames if at <= last + 1e-6 * max(last, 1e-3)]

    def three_frames(self, moments):
        """(place of the frame, name, body) at moments (name, time or share of the load), each frame only once."""
        found = {}
        for name, wanted in moments:
            at, path = min(self.frames, key=lambda frame: abs(frame[0] - wanted))
            found.setdefault(path, (at, name))
        return [(at, name, Body(Frame(path), deformed=self.deforms)) for path, (at, name) in found.items()]

    def page_parts(self, pictures):
        trouble = f"<p class='flag'>{html.escape(self.trouble)}</p>" if self.trouble else ""
        parts = [verdict_list(self.result, self.verdicts()), trouble, *self.main_parts(pictures), "<h2>Cost</h2>", *self.cost_parts(pictures)]
        return [part for part in parts if part]


# ---- electrophysiology ----


class ElectrophysiologyBody(AloneBody):
    views = "no view of the potential and no activation map"
    deforms = False

    def __init__(self, result, name):
        super().__init__(result, name)
        result.time = result.rows
        result.period = float(result.settings.get("heart", {}).get("period_s", result.time[-1]))
        self.traces = result.curves

    def makers(self):
        makers = {"curves": curves_chart, "leads": lambda body: lead_chart(body, f"{body.result.title}: pseudo-ECG", LEAD_UNIT)}
        if self.frames:
            makers |= {"activation": activation_map, "potential": potential_views}
        if seconds := self.seconds():
            makers["cost"] = lambda body: cost_chart(seconds, f"{body.result.title}: cost", "s")
        return makers

    def moments(self):
        """(name, time in s) of the moments of the last beat that are drawn."""
        time = self.result.time
        start = self.start_of_last_beat()
        # The row at its start still shows the beat before.
        beat = np.flatnonzero(time > start + 1e-9 if start > 0 else time >= 0)
        time, share, potential = time[beat], self.traces["activated_share"][beat], self.traces["membrane_potential"][beat]
        half, peak = int(np.argmax(share >= 0.5 * share.max())), int(np.argmax(potential))
        repolarised = np.flatnonzero(potential[peak:] < 0.5 * (potential.max() + potential.min()))
        moments = [("half activated" if share.max() > 0.5 else "activation spreads", time[half])]
        moments.append(("highest mean potential", time[peak]))
        moments.append(("half repolarised", time[peak + repolarised[0]]) if repolarised.size else ("end of the run", time[-1]))
        return moments

    def start_of_last_beat(self):
        """A beat that begins with the end of the run is none."""
        return max(0.0, (np.ceil(self.result.time[-1] / self.result.period - 1e-9) - 1) * self.result.period)

    def was_resumed(self):
        """Figures of cost are counted anew when a run is resumed: then there are fewer steps than its time needs."""
        tau_ms = self.result.settings.get("body", {}).get("electrophysiology", {}).get("tau_ms")
        steps = self.figures.get("electrophysiology_steps")
        return bool(tau_ms and steps) and steps["value"] * tau_ms < 0.999 * 1e3 * self.result.time[-1]

    def seconds(self):
        """Wall time of each part that the file has, and of the rest of the run."""
        seconds = {key: figure["value"] for key, figure in self.figures.items() if figure["unit"] == "s"}
        if seconds and not self.was_resumed():
            seconds["electrophysiology_rest"] = max(0.0, self.result.summary["cost"]["run_s"] - sum(seconds.values()))
        return seconds

    def verdicts(self):
        activation = self.result.summary["activation"]
        text = f"activated: {100 * activation['share']:.1f} % of the nodes"
        if "first_ms" in activation:
            text += f", from {activation['first_ms']:.1f} to {activation['last_ms']:.1f} ms within the beat"
        return [(activation["share"] > 0.9999, text)]

    def main_parts(self, pictures):
        return [embedded(pictures, "activation", CAPTIONS), embedded(pictures, "curves", CAPTIONS), self.extremes(),
                embedded(pictures, "leads", CAPTIONS), embedded(pictures, "potential", CAPTIONS)]

    def extremes(self):
        """Table of the smallest and largest value of each mean and when they were."""
        rows = []
        for key, name, digits in (("membrane_potential", "mean potential [mV]", 1), ("calcium", "mean calcium [uM]", 3)):
            values, t = self.traces[key], 1e3 * self.result.time
            low, high = values.argmin(), values.argmax()
            rows.append((name, f"{values[low]:.{digits}f}", f"{t[low]:.0f}", f"{values[high]:.{digits}f}", f"{t[high]:.0f}"))
        return table(("", "lowest", "at [ms]", "highest", "at [ms]"), rows)

    def cost_parts(self, pictures):
        cost, time_s = self.result.summary["cost"], self.result.time[-1]
        text = f"Start (mesh, fibres, paced cells) {cost['start_s']:.2f} s; {1e3 * time_s:.0f} ms of the model in {cost['run_s']:.2f} s."
        if self.was_resumed():
            text += " The run was resumed: the parts and counts below are of what came after."
        seconds = self.seconds()
        parts = [f"<p>{text}</p>", embedded(pictures, "cost", CAPTIONS)]
        return [*parts, cost_table(seconds, "s") if seconds else "", sizes_table(self.figures)]


def activation_map(body):
    # The result has the activation at its very end; the last frame may be older.
    return activation_views(Body(Frame(body.frames[0][1]), deformed=False), body.traces["activation"], f"{body.result.title}: activation")


def potential_views(body):
    columns = [(f"{name}\n{1e3 * t:.0f} ms", shape) for t, name, shape in body.three_frames(body.moments())]
    rows = [("potential_mV", 1.0, "potential [mV]", open_, potential_colours) for open_ in (False, True)]
    return field_views(columns, rows, f"{body.result.title}: membrane potential")


def potential_colours(values):
    return Normalize(np.floor(values.min()), np.ceil(values.max() + 1e-3)), plt.get_cmap("viridis")


def curves_chart(body):
    """Activated share, mean potential and mean calcium over the whole run."""
    result, t = body.result, 1e3 * body.result.time
    panels = (
        (100 * body.traces["activated_share"], "activated\n[% of the nodes]", "#1b7837"),
        (body.traces["membrane_potential"], "mean potential\n[mV]", "black"),
        (body.traces["calcium"], "mean calcium\n[µM]", "#762a83"),
    )
    with plt.rc_context(STYLE):
        inches = 1.6 * len(panels) + 0.9
        figure, axes = plt.subplots(len(panels), 1, sharex=True, figsize=(8.2, inches))
        for axis, (values, label, colour) in zip(axes, panels):
            axis.plot(t, values, color=colour)
            axis.set_ylabel(label)
            for beat in range(1, int(np.ceil(result.time[-1] / result.period - 1e-9))):
                axis.axvline(1e3 * beat * result.period, color="0.6", lw=0.8, ls=":", zorder=0)
        axes[0].set_ylim(-4, 104)
        axes[-1].set_ylim(bottom=0)
        axes[-1].set_xlabel("time [ms]")
        axes[-1].set_xlim(0, t[-1])
        _finish(figure, axes, f"{result.title}: over the run", inches)
        return figure


# ---- mechanics ----


class MechanicsBody(AloneBody):
    views = "no view of the deformation"
    deforms = True

    def __init__(self, result, name):
        super().__init__(result, name)
        self.chamber = "LV" if "LV" in result.cavities else next(iter(result.cavities), None)

    def fields_off(self):
        return "fields = false" if self.result.tissue_settings(self.name).get("fields") is False else None

    def makers(self):
        makers = {"pressure_volume": pressure_volume_chart, "load": load_chart}
        return makers | {"deformation": deformed_views} if self.frames else makers

    def verdicts(self):
        reached, ratio = self.result.rows[-1], self.result.curves["smallest_volume_ratio"]
        worst = int(ratio.argmin())
        return [(reached > 1 - 1e-9, f"load: {100 * reached:.0f} % of the whole"),
                (ratio[worst] > SMALLEST_GOOD_VOLUME_RATIO,
                 f"smallest volume ratio of an element {ratio[worst]:.3f}, at {100 * self.result.rows[worst]:.0f} % of the load")]

    def main_parts(self, pictures):
        return [embedded(pictures, "pressure_volume", CAPTIONS), embedded(pictures, "deformation", CAPTIONS),
                "<h2>Over the load</h2>", embedded(pictures, "load", CAPTIONS), self.rows_table()]

    def rows_table(self):
        result, n = self.result, len(self.result.rows)
        columns = [("load [%]", 100 * result.rows, 1)]
        for chamber, (pressure, volume) in result.cavities.items():
            columns += [(f"{chamber} pressure [mmHg]", pressure, 3), (f"{chamber} volume [mL]", volume, 2)]
        columns.append(("mean fibre stretch", result.curves["stretch"], 4))
        if "myocardium_volume_ratio" in result.curves:
            columns.append(("J of the myocardium", result.curves["myocardium_volume_ratio"], 4))
        columns.append(("smallest J", result.curves["smallest_volume_ratio"], 3))
        shown = np.unique(np.linspace(0, n - 1, min(n, MOST_TABLE_ROWS)).round().astype(int))
        rows = [[f"{values[k]:.{digits}f}" for _, values, digits in columns] for k in shown]
        note = "" if len(shown) == n else f"<p><small>{len(shown)} of {n} rows; the result file has all.</small></p>"
        return table([name for name, *_ in columns], rows) + note

    def cost_parts(self, _pictures):
        cost = self.result.summary["cost"]
        steps = len(self.result.rows) - 1
        text = (f"Start (mesh, fibres, unloaded shape) {cost['start_s']:.2f} s; loading {cost['run_s']:.2f} s with "
                f"{cost['newton_iterations']} Newton iterations in {steps} step{'' if steps == 1 else 's'}.")
        return [f"<p>{text}</p>", sizes_table(self.figures)]


def pressure_volume_chart(body):
    """Pressure over volume of each cavity, from the unloaded shape to the load that was reached."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(8.2, 4.4))
        for chamber, (pressure, volume) in body.result.cavities.items():
            axis.plot(volume, pressure, color=COLOUR[chamber], marker="o", ms=3.5, label=CHAMBER_NAMES[chamber])
        axis.axhline(0, color="0.8", lw=0.6, zorder=0)
        axis.set_xlabel("volume [mL]")
        axis.set_ylabel("pressure [mmHg]")
        axis.legend(loc="upper left")
        _finish(figure, [axis], f"{body.result.title}: pressure and volume", 4.4)
        return figure


def load_chart(body):
    """Stretch and volume ratios over the load."""
    curves, load = body.result.curves, 100 * body.result.rows
    with plt.rc_context(STYLE):
        inches = 4.3
        figure, (stretch, ratio) = plt.subplots(2, 1, sharex=True, figsize=(8.2, inches))
        stretch.plot(load, curves["stretch"], color="black", marker="o", ms=3)
        stretch.set_ylabel("mean fibre\nstretch [1]")
        if "myocardium_volume_ratio" in curves:
            ratio.plot(load, curves["myocardium_volume_ratio"], color="0.55", marker="o", ms=3, label="myocardium")
        ratio.plot(load, curves["smallest_volume_ratio"], color="#b2182b", marker="o", ms=3, label="smallest of all elements")
        ratio.set_ylabel("volume ratio\nJ [1]")
        ratio.legend(loc="lower left")
        for axis in (stretch, ratio):
            axis.axhline(1, color="0.8", lw=0.8, zorder=0)
            axis.ticklabel_format(axis="y", useOffset=False)
        ratio.set_xlabel("load [%]")
        _finish(figure, (stretch, ratio), f"{body.result.title}: over the load", inches)
        return figure


def deformed_views(body):
    """The shape at no load, half of the load that was reached and all of it, coloured by stretch."""
    result = body.result
    reached = result.rows[-1]
    columns = []
    for share, _, shape in body.three_frames([("", 0.0), ("", 0.5 * reached), ("", reached)]):
        heading = "no load" if share < 1e-9 else "whole load" if share > 1 - 1e-9 else f"{100 * share:.0f} % of the load"
        if body.chamber:
            pressure, volume = (np.interp(share, result.rows, values) for values in result.cavities[body.chamber])
            of_it = f"{body.chamber} " if len(result.cavities) > 1 else ""
            heading += f"\n{of_it}{volume:.0f} mL, {pressure:.1f} mmHg"
        columns.append((heading, shape))
    return field_views(columns, STRETCH_ROWS, f"{result.title}: deformation")


def _finish(figure, axes, title, inches):
    """Title, aligned labels and margins of a figure of this height."""
    figure.align_ylabels(axes)
    figure.suptitle(title, fontsize=12, fontweight="bold")
    figure.subplots_adjust(left=0.115, right=0.97, top=1 - 0.42 / inches, bottom=0.5 / inches, hspace=0.15)
