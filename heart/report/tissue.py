"""What a run with 3D tissue adds to the report: activation map, deformed views, cost per part, convergence, leads.

Also the parts that the report of a body alone shares (body.py).

Fields come from the folder that the run wrote beside its result, RESULT.WALL.fields; without it the report says so
and shows the rest.
"""

import io

import matplotlib.pyplot as plt
import numpy as np
from figures import COLOUR, STYLE, shade_phases
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.ticker import MaxNLocator
from PIL import Image
from result import CHAMBERS, WALL_CHAMBERS
from surface import Camera, clipped, draw, outer_patches, section
from vtu import BrokenFields, Frame, read_index

MYOCARDIUM = (1, 2, 3)  # volume tags, see tissue/mesh/mesh.hpp
LARGEST_PATCH_M = 1e-3  # drawn in one colour
# A section through the long axis shows both ventricles: z is up and the right ventricle stands along x.
SECTION_NORMAL = np.array([0.0, 1.0, 0.0])
SECTION_CAMERA = Camera(-80, 12)
OUTER_CAMERAS = (Camera(-60, 22), Camera(120, 22))
PARTS = (  # figure of the wall, name in the report, colour
    ("electrophysiology_ionic", "electrophysiology: ionic cells", "#08519c"),
    ("electrophysiology_solve", "electrophysiology: linear systems", "#3182bd"),
    ("electrophysiology_right_side", "electrophysiology: right-hand sides", "#6baed6"),
    ("electrophysiology_assembly", "electrophysiology: matrices", "#9ecae1"),
    ("electrophysiology_rest", "electrophysiology: rest", "#c6dbef"),
    ("active_force", "active force", "#fdae6b"),
    ("mechanics_assembly", "mechanics: residuals and tangents", "#cb181d"),
    ("mechanics_solve", "mechanics: linear systems", "#fb6a4a"),
    ("deformation", "stretches, deformed conductivities", "#74c476"),
)


class Tissue:
    """One body of 3D tissue: figures from the result, fields from the folder beside it.

    Kinds of it say which views need the fields, what in the scene turns them off, and which frames are of the result.
    """

    views = "neither an activation map nor a view of the deformation"

    def __init__(self, result, name):
        self.result, self.name = result, name
        self.figures = result.walls.get(name, {})
        base = result.path.name.removesuffix(".h5")
        self.folder = result.path.with_name(f"{base}.{name}.fields")
        self.frames, self.trouble = [], None
        try:
            self._find_frames()
        except BrokenFields as error:
            self.trouble = f"The fields in {self.folder.name} cannot be read ({error}); "
        if self.trouble:
            self.trouble += f"so there is {self.views}."

    def _find_frames(self):
        if not self.folder.is_dir():
            self.trouble = f"There is no folder {self.folder.name} beside the result file"
            if off := self.fields_off():
                self.trouble += f" (the scene has {off})"
            self.trouble += ", "
            return
        if off := self.fields_off():
            self.trouble = f"The scene has {off}: the fields in {self.folder.name} are of another run, "
            return
        self.frames = self.frames_of_result(read_index(self.folder))
        if not self.frames:
            self.trouble = f"The index in {self.folder.name} lists no frame of {self.result.span}, "

    def fields_off(self):
        """The setting of the scene by which the run wrote no fields, if it has it."""
        return "fields_every_ms = 0" if self.result.tissue_settings(self.name).get("fields_every_ms") == 0 else None

    def frame_time(self, time_s):
        """Time (s) of the frame nearest to that time; that time itself without frames."""
        return min((t for t, _ in self.frames), key=lambda t: abs(t - time_s), default=time_s)

    def frame_at(self, time_s):
        """(time in s, frame) of the frame nearest to that time."""
        t, path = min(self.frames, key=lambda frame: abs(frame[0] - time_s))
        return t, Frame(path)


class TissueWall(Tissue):
    """One wall of 3D tissue of a heart, with its traces over the beat."""

    def __init__(self, result, name):
        super().__init__(result, name)
        self.traces = result.cells.get(name, {})
        self.chambers = (name,) if name in CHAMBERS else WALL_CHAMBERS.get(name, ("LV",))  # that it encloses
        self.chamber = self.chambers[0]  # its volume and pressure tell the moments of the beat
        self.colour = COLOUR[self.chamber] if len(self.chambers) == 1 else "black"

    def frames_of_result(self, frames):
        # Frames carry the time since the start of the run; the result holds its last beat, whole or in part.
        start, end = self.result.start, self.result.time[-1]
        slack = 1e-6 * self.result.period
        times = [(t - start, path) for t, path in frames]
        return [(t, path) for t, path in times if -slack <= t <= end + slack]

    def moments(self):
        """(name, time in s) of the moments that are drawn."""
        time = self.result.time
        of_it = f"{self.chamber} " if len(self.chambers) > 1 else ""
        if not self.result.is_whole_beat:
            highest = time[np.argmax(self.result.pressure[self.chamber])]
            # Pressure may rise or fall all the way.
            is_end = self.frame_time(highest) in (self.frame_time(time[0]), self.frame_time(time[-1]))
            middle = ("half-way", 0.5 * time[-1]) if is_end else (f"highest {of_it}pressure", highest)
            moments = (("start of the beat", time[0]), middle, ("end of the run", time[-1]))
            return tuple({self.frame_time(moment[1]): moment for moment in moments[::-1]}.values())[::-1]
        volume, pressure = self.result.volume[self.chamber], self.result.pressure[self.chamber]
        side = "right" if self.chamber in ("RA", "RV") else "left"
        phases = self.result.phases.get(side, {})
        # When the inlet valve closes; without phases when the chamber is largest.
        filled = phases["IVC"][0] if "IVC" in phases else time[np.argmax(volume)]
        if len(self.chambers) > 2 and {"IVC", "VE", "IVR", "VPF"} <= set(phases):
            # The whole heart: at the ends of the left side's phases.
            return (("end of filling", filled), ("aortic valve opens", phases["VE"][0]), ("end of ejection", phases["VE"][1]),
                    ("mitral valve opens", phases["IVR"][1]), ("atria contract", phases["VPF"][1]))
        highest = time[np.argmax(pressure)]
        return (("end of diastole", filled), (f"highest {of_it}pressure", highest), ("end of the beat", time[-1]))

    def heading(self, name, time_s):
        """Of a view: the moment, and what the chambers that the wall encloses hold."""
        when = f"{1e3 * time_s:.0f} ms"
        lines = [f"{name},", when] if len(self.chambers) > 2 else [f"{name}, {when}"]
        for chamber in self.chambers:
            of_it = f"{chamber} " if len(self.chambers) > 1 else ""
            curves = self.result.volume[chamber], self.result.pressure[chamber]
            volume, pressure = (np.interp(time_s, self.result.time, curve) for curve in curves)
            lines.append(f"{of_it}{volume:.0f} mL, {pressure:.0f} mmHg")
        return "\n".join(lines)

    def lead_unit(self):
        units = self.result.cell_units.get(self.name, {})
        return units.get("lead_1", "").replace("^2", "²")

    def cost_unit(self):
        return "s per beat" if self.result.is_whole_beat else "s"

    def seconds_per_beat(self):
        """Wall time of each part for one beat, in the order of PARTS; parts that the file does not have are left out.

        Of a part of a beat: for what was run.
        """
        seconds = {key: figure["value"] for key, figure in self.figures.items() if figure["unit"] == "s"}
        of_it = [value for key, value in seconds.items() if key.startswith("electrophysiology_")]
        if "electrophysiology" in seconds:
            seconds["electrophysiology_rest"] = max(0.0, seconds["electrophysiology"] - sum(of_it))
        beats = self.beats_measured()
        return {key: seconds[key] / beats for key, *_ in PARTS if key in seconds}

    def beats_measured(self):
        """Beats over which the figures of this wall were counted; fewer than the run's after it was resumed.

        1 for a part of a beat: its figures are shown as they are.
        """
        if not self.result.is_whole_beat:
            return 1.0
        steps, per_beat = self.figures.get("steps"), self.result.solver.get("steps")
        return steps["value"] / per_beat if steps and per_beat else 1.0


def tissue_walls(result):
    """The walls of 3D tissue of a result, none for most."""
    return [TissueWall(result, name) for name in result.tissue_names()]


# ---- surfaces ----


class Body:
    """The mesh of a frame, deformed or as it was, in the order of the file."""

    def __init__(self, frame, deformed=True):
        self.points = frame.points + (frame.field("displacement_m") if deformed else 0.0)
        self.cells = frame.cells
        self.myocardium = np.isin(frame.tag, MYOCARDIUM)
        self.frame = frame

    def whole(self, values):
        return outer_patches(self.points, self.cells, values, self.myocardium)

    def of_myocardium(self, values, origin):
        """Views of the myocardium alone: (layers, camera, name)."""
        cells = self.cells[self.myocardium]
        every = np.ones(len(cells), bool)
        whole = outer_patches(self.points, cells, values, every)
        half = clipped(whole, origin, SECTION_NORMAL), section(self.points, cells, values, every, origin, SECTION_NORMAL)
        sides = [((whole,), camera, f"from azimuth {camera.azimuth}°") for camera in OUTER_CAMERAS]
        return [*sides, (half, SECTION_CAMERA, "cut open")]

    def half(self, values, origin):
        """What lies behind the section, and in front of it the cut face."""
        cut = section(self.points, self.cells, values, self.myocardium, origin, SECTION_NORMAL)
        return clipped(self.whole(values), origin, SECTION_NORMAL), cut

    def middle(self):
        """Of the myocardium: the section passes through it."""
        used = self.points[np.unique(self.cells[self.myocardium])]
        return 0.5 * (used.min(axis=0) + used.max(axis=0))


def _frame_axes(axis, low, high):
    """Empty axes of equal scale that show `low` to `high` (mm)."""
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_aspect("equal")
    axis.set_axis_off()


def _bounds(pairs):
    """Common limits (mm) of patches in their cameras, with a margin."""
    flat = [camera.flat_mm(patches.corners[:, :, :3].reshape(-1, 3)) for patches, camera in pairs]
    low, high = np.min([f.min(axis=0) for f in flat], axis=0), np.max([f.max(axis=0) for f in flat], axis=0)
    margin = 0.03 * (high - low).max()
    return low - margin, high + margin


def _scale_bar(axis, low, high):
    """20 mm, at the lower right."""
    x, y = high[0] - 0.02 * (high[0] - low[0]), low[1] + 0.02 * (high[1] - low[1])
    axis.plot([x - 20, x], [y, y], color="0.2", lw=2, solid_capstyle="butt")
    axis.text(x - 10, y + 0.012 * (high[1] - low[1]), "20 mm", ha="center", va="bottom", fontsize=8, color="0.2")


def activation_map(wall):
    """Activation time on the myocardium from two sides and cut open, on the shape at the first of the moments."""
    _, last = wall.frame_at(wall.result.time[-1])
    _, filled = wall.frame_at(wall.moments()[0][1])
    body = Body(filled)
    return activation_views(body, last.field("activation_s"), f"{wall.result.title}: activation of {wall.name}")


def activation_views(body, activation, title):
    """Activation (s, negative where there was none) on a body from two sides and cut open; the title gets its span."""
    if len(activation) != len(body.points):
        raise BrokenFields("the frames are of different meshes")
    body.points = body.points - body.middle()  # so that all cameras look at the middle
    views = body.of_myocardium(1e3 * activation, np.zeros(3))
    for layers, *_ in views:
        for patches in layers:
            # A time of -1 s: not activated; no colour can be told between it and a true time.
            patches.coloured &= (patches.values() >= 0).all(axis=1)
    own = 1e3 * activation[np.unique(body.cells[body.myocardium])]
    reached = own >= 0
    with plt.rc_context(STYLE):
        low, high = _bounds([(patches, camera) for layers, camera, _ in views for patches in layers])
        height = 8.2 * 0.98 / len(views) * (high[1] - low[1]) / (high[0] - low[0])
        inches = height + 1.65
        figure, axes = plt.subplots(1, len(views), figsize=(8.2, inches))
        levels = MaxNLocator(12).tick_values(own[reached].min(), max(own[reached].max(), own[reached].min() + 1)) if reached.any() else [0, 1]
        colours = plt.get_cmap("turbo_r")
        norm = BoundaryNorm(levels, colours.N)
        for axis, (layers, camera, view) in zip(axes, views):
            for patches in layers:
                draw(axis, patches, camera, norm, colours, 4 * LARGEST_PATCH_M, levels)
            _frame_axes(axis, low, high)
            axis.set_title(view)
        _scale_bar(axes[-1], low, high)
        figure.subplots_adjust(left=0.01, right=0.99, top=1 - 0.75 / inches, bottom=0.9 / inches, wspace=0.02)
        if reached.any():
            bar = figure.colorbar(ScalarMappable(norm, colours), cax=figure.add_axes((0.2, 0.6 / inches, 0.6, 0.15 / inches)), orientation="horizontal")
            bar.set_label("activation, time within the beat [ms]")
        if not reached.all():
            figure.text(0.99, 0.65 / inches, f"grey: not activated\n({_percent((~reached).mean())} of the points)", ha="right", va="center", fontsize=8)
        span = f", {own[reached].min():.0f} to {own[reached].max():.0f} ms" if reached.any() else ": nothing was activated"
        figure.suptitle(f"{title}{span}", y=1 - 0.1 / inches, va="top", fontsize=12, fontweight="bold")
        return figure


def _percent(share):
    return f"{100 * share:.0f} %" if share >= 0.01 else "< 1 %"


def deformed_views(wall):
    """The body at its moments from outside and cut open, all with one camera, scale and colours."""
    result = wall.result
    columns = []
    for name, time_s in wall.moments():
        t, frame = wall.frame_at(time_s)
        columns.append((wall.heading(name, t), Body(frame)))
    tension = ("active_tension_Pa", 1e-3, "active tension [kPa]", True, tension_colours)
    return field_views(columns, (*STRETCH_ROWS, tension), f"{result.title}: deformation of {wall.name}")


def stretch_colours(values):
    """Centred at the unstretched fibre; few extreme points do not wash out the rest."""
    reach = max(0.02, np.percentile(np.abs(values - 1), 99))
    return Normalize(1 - reach, 1 + reach), plt.get_cmap("RdBu_r")


def tension_colours(values):
    return Normalize(0, max(1e-3, np.percentile(values, 99))), plt.get_cmap("YlOrRd")


STRETCH_ROWS = (  # field, factor, label, cut open or from outside, colours
    ("fibre_stretch", 1.0, "fibre stretch [1]", False, stretch_colours),
    ("fibre_stretch", 1.0, "fibre stretch [1]", True, stretch_colours),
)


def field_views(columns, rows, title):
    """A table of views with one camera and one scale.

    `columns`: (heading, body). `rows`: (field, factor, label, cut open or from outside, colours of its values in all columns).
    """
    bodies = [body for _, body in columns]
    origin = bodies[0].middle()
    with plt.rc_context(STYLE):
        pictures = []
        for field, factor, _, open_, _ in rows:
            row = []
            for body in bodies:
                values = factor * body.frame.field(field)
                row.append(body.half(values, origin) if open_ else (body.whole(values),))
            pictures.append(row)
        low, high = _bounds([(patches, SECTION_CAMERA) for row in pictures for layers in row for patches in layers])
        width, left, right = 8.2, 0.045, 0.86
        cell = (right - left) * width / len(bodies)  # inches
        height = cell * (high[1] - low[1]) / (high[0] - low[0])
        lines = max(heading.count("\n") + 1 for heading, _ in columns)
        head, gap = 0.95 + 0.165 * max(0, lines - 2), 0.08
        total = head + len(rows) * (height + gap) + 0.1
        figure = plt.figure(figsize=(width, total))
        for r, (field, factor, label, open_, colours_of) in enumerate(rows):
            own = np.concatenate([factor * body.frame.field(field)[np.unique(body.cells[body.myocardium])] for body in bodies])
            norm, colours = colours_of(own)
            bottom = (total - head - (r + 1) * height - r * gap) / total
            for c, (heading, _) in enumerate(columns):
                axis = figure.add_axes((left + c * cell / width, bottom, cell / width, height / total))
                for patches in pictures[r][c]:
                    draw(axis, patches, SECTION_CAMERA, norm, colours, LARGEST_PATCH_M)
                _frame_axes(axis, low, high)
                if r == 0:
                    axis.set_title(heading, fontsize=min(9.0, 33 / len(columns)))
                if c == len(bodies) - 1 and r == len(rows) - 1:
                    _scale_bar(axis, low, high)
            view = "cut open" if open_ else "from outside"
            figure.text(0.028, bottom + 0.5 * height / total, view, rotation=90, va="center", ha="center", fontsize=9)
            bar = figure.colorbar(ScalarMappable(norm, colours), cax=figure.add_axes((right + 0.02, bottom + 0.12 * height / total, 0.018, 0.76 * height / total)), extend="both")
            bar.set_label(label)
        figure.suptitle(title, y=1 - 0.1 / total, va="top", fontsize=12, fontweight="bold")
        return figure


# ---- curves ----


def cost_chart(seconds, title, unit):
    """`seconds`: wall time of each of PARTS; the title gets their sum."""
    whole = sum(seconds.values())
    shown = [(name, colour, seconds[key]) for key, name, colour in PARTS if key in seconds]
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(8.2, 0.34 * len(shown) + 1.2))
        rows = np.arange(len(shown))[::-1]
        values = np.array([value for *_, value in shown])
        axis.barh(rows, values, height=0.68, color=[colour for _, colour, _ in shown])
        for row, value in zip(rows, values):
            axis.text(value + 0.01 * values.max(), row, f"{value:.3g} s, {100 * value / max(whole, 1e-300):.1f} %", va="center", fontsize=8.5)
        axis.set_yticks(rows, [name for name, *_ in shown])
        axis.tick_params(axis="y", length=0)
        axis.set_xlim(0, 1.22 * max(values.max(), 1e-9))
        axis.set_xlabel(f"wall time [{unit}]")
        figure.suptitle(f"{title}, {whole:.3g} {unit}", fontsize=12, fontweight="bold")
        inches = 0.34 * len(shown) + 1.2
        figure.subplots_adjust(left=0.31, right=0.97, top=1 - 0.42 / inches, bottom=0.5 / inches)
        return figure


def convergence_chart(wall):
    """Newton iterations of each step, where the file has them, and the smallest volume ratio over the beat."""
    result = wall.result
    t = 1e3 * result.time
    panels = []
    newton = wall.traces.get("newton_iterations")
    if newton is not None:
        panels.append((newton, "Newton iterations\nof a step", "0.35"))
    if "smallest_volume_ratio" in wall.traces:
        panels.append((wall.traces["smallest_volume_ratio"], "smallest volume\nratio J [1]", wall.colour))
    if not panels:
        return None
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(len(panels), 1, sharex=True, squeeze=False, figsize=(8.2, 1.8 * len(panels) + 0.9))
        axes = axes[:, 0]
        for axis, (values, label, colour) in zip(axes, panels):
            axis.plot(t, values, color=colour)
            axis.set_ylabel(label)
            shade_phases(axis, result)
        if "smallest_volume_ratio" in wall.traces:
            ratio = wall.traces["smallest_volume_ratio"]
            k = int(np.argmin(ratio))
            axes[-1].plot(t[k], ratio[k], "o", color=wall.colour, ms=4, clip_on=result.is_whole_beat)
            side = "left" if t[k] < 0.1 * t[-1] else "right" if t[k] > 0.9 * t[-1] else "center"
            axes[-1].annotate(f"{ratio[k]:.2f} at {t[k]:.0f} ms", (t[k], ratio[k]), xytext=(0, 9),
                              textcoords="offset points", ha=side, fontsize=8.5)
            axes[-1].set_ylim(min(0.0, 1.1 * ratio.min()), max(1.05, 1.05 * ratio.max()))
            axes[-1].axhline(1, color="0.8", lw=0.8, zorder=0)
        axes[-1].set_xlabel("time [ms]")
        axes[-1].set_xlim(0, t[-1])
        span = "over the beat" if result.is_whole_beat else f"until {result.end_ms}"
        figure.suptitle(f"{result.title}: {wall.name} {span}", fontsize=12, fontweight="bold")
        inches = 1.8 * len(panels) + 0.9
        figure.align_ylabels(axes)
        figure.subplots_adjust(left=0.115, right=0.97, top=1 - 0.4 / inches, bottom=0.5 / inches, hspace=0.15)
        return figure


CHAMBER_PANELS = (("active_tension", "active\ntension [kPa]"), ("stretch", "fibre\nstretch [1]"),
                  ("smallest_volume_ratio", "smallest volume\nratio J [1]"), ("wall_volume", "volume of the\nwall [mL]"))


def chamber_chart(wall):
    """Tension, stretch, smallest J and wall volume of each chamber's wall, and how base and apex move; None where the file has
    none of them."""
    t = 1e3 * wall.result.time
    panels = [(name, label) for name, label in CHAMBER_PANELS if any(f"{name}_{c}" in wall.traces for c in wall.chambers)]
    motion = [(key, label, colour) for key, label, colour in (("base_motion", "base towards apex", COLOUR["LV"]),
                                                              ("apex_motion", "apex towards base", "0.35")) if key in wall.traces]
    rows = len(panels) + bool(motion)
    if not rows:
        return None
    with plt.rc_context(STYLE):
        inches = 1.45 * rows + 0.9
        figure, axes = plt.subplots(rows, 1, sharex=True, squeeze=False, figsize=(8.2, inches))
        axes = axes[:, 0]
        for axis, (name, label) in zip(axes, panels):
            for chamber in wall.chambers:
                if f"{name}_{chamber}" in wall.traces:
                    axis.plot(t, wall.traces[f"{name}_{chamber}"], color=COLOUR[chamber], label=chamber)
            axis.set_ylabel(label)
        for key, label, colour in motion:
            axes[-1].plot(t, wall.traces[key], color=colour, label=label)
        if motion:
            axes[-1].set_ylabel("motion along the\nlong axis [mm]")
            axes[-1].axhline(0, color="0.8", lw=0.8, zorder=0)
        for axis in axes:
            shade_phases(axis, wall.result)
        for axis in {axes[0], axes[-1]} if panels and motion else {axes[0]}:
            axis.legend(loc="upper right", ncol=4, fontsize=8, frameon=False)
        axes[-1].set_xlabel("time [ms]")
        axes[-1].set_xlim(0, t[-1])
        figure.suptitle(f"{wall.result.title}: walls of {wall.name}", fontsize=12, fontweight="bold")
        figure.align_ylabels(axes)
        figure.subplots_adjust(left=0.115, right=0.97, top=1 - 0.4 / inches, bottom=0.5 / inches, hspace=0.15)
        return figure


def lead_chart(tissue, title, unit):
    """The pseudo-ECG at each electrode; None without electrodes."""
    leads = sorted((int(key.removeprefix("lead_")), key) for key in tissue.traces if key.startswith("lead_"))
    if not leads:
        return None
    names = list(tissue.result.tissue_settings(tissue.name).get("electrodes", {}))
    t = 1e3 * tissue.result.time
    with plt.rc_context(STYLE):
        inches = 0.95 * len(leads) + 0.95
        figure, axes = plt.subplots(len(leads), 1, sharex=True, squeeze=False, figsize=(8.2, inches))
        axes = axes[:, 0]
        for axis, (number, key) in zip(axes, leads):
            axis.axhline(0, color="0.8", lw=0.6, zorder=0)
            axis.plot(t, tissue.traces[key], color="black", lw=1.3)
            axis.set_ylabel(names[number - 1] if len(names) == len(leads) else f"lead {number}", rotation=0, ha="right", va="center")
            axis.yaxis.set_label_coords(-0.075, 0.5)
            axis.locator_params(axis="y", nbins=3)
            shade_phases(axis, tissue.result)
        axes[-1].set_xlabel("time [ms]")
        axes[-1].set_xlim(0, t[-1])
        figure.suptitle(f"{title} [{', '.join(filter(None, (unit, 'no absolute scale')))}]", fontsize=12, fontweight="bold")
        figure.subplots_adjust(left=0.16, right=0.97, top=1 - 0.4 / inches, bottom=0.5 / inches, hspace=0.2)
        return figure


# ---- everything of one wall ----


def make_tissue_pictures(wall, answer):
    title = wall.result.title
    makers = {"convergence": convergence_chart, "chambers": chamber_chart,
              "leads": lambda _: lead_chart(wall, f"{title}: pseudo-ECG of {wall.name}", wall.lead_unit())}
    if seconds := wall.seconds_per_beat():
        makers = {"cost": lambda _: cost_chart(seconds, f"{title}: cost of {wall.name}", wall.cost_unit())} | makers
    if wall.frames:
        makers |= {"activation": activation_map, "deformation": deformed_views}
    return make_pictures(wall, makers, answer)


def make_pictures(tissue, makers, answer):
    """Adds what can be drawn to the answer. Returns the pictures by kind; what the fields do not allow goes to `tissue.trouble`."""
    pictures = {}
    for kind, make in makers.items():
        try:
            figure = make(tissue)
        except BrokenFields as error:
            tissue.trouble = f"The fields in {tissue.folder.name} cannot be read ({error}); views that need them are left out."
            continue
        if figure is None:
            continue
        pictures[kind] = answer.file(f"{tissue.name}_{kind}.png", _drawn(figure))
        plt.close(figure)
    return pictures


def _drawn(figure):
    """Drawn twice as large and reduced: patches are painted without smoothing, which would show their seams."""
    drawn, reduced = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, dpi=320, format="png")
    picture = Image.open(drawn).convert("RGB")
    picture.resize((picture.width // 2, picture.height // 2), Image.Resampling.BOX).save(reduced, "PNG", optimize=True)
    return reduced.getvalue()
