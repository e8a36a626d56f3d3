"""The part of the page about one wall of 3D tissue."""

import base64
import html

from page import mark, table
from tissue import PARTS

# Elements that lose more of their volume than this deserve a look: tissue hardly compresses.
SMALLEST_GOOD_VOLUME_RATIO = 0.8
# Sizes and counts, in the order of the page. Counts are for one beat.
SIZES = ("tetrahedra", "potential_nodes", "displacement_unknowns", "ranks", "reference_volume_ratio", "reference_smallest_angle")
COUNTS = ("steps", "rejected_steps", "tangents", "residuals", "solves", "solver_iterations", "halved_updates",
          "electrophysiology_steps", "electrophysiology_iterations")
CAPTIONS = {
    "activation": "Activation: the moment the potential of a point rises above its threshold, on all surfaces of the "
                  "myocardium, drawn on its shape at the end of diastole. Azimuths turn from x towards y.",
    "deformation": "One camera and one scale throughout; the section passes through the middle along the long axis. Grey: "
                   "caps and other tissue without fibres. The colours end at the 99th percentile.",
    "cost": "Wall time of each part for one beat, on the first process. The share is of what is shown.",
    "convergence": "Over the last beat. J is the volume of an element over that in the unloaded shape; the smallest of all "
                   "elements at each moment. Shading: phases of the left heart.",
    "chambers": "Means over each chamber's wall and its smallest element; the ventricles share the septum by which cavity is nearer. "
                "Motion: of the centre of the left ventricle's base and of its apex along the long axis, from the mesh as it was given.",
    "leads": "Pseudo-ECG at the electrodes of the scene: the tissue in an endless uniform conductor, no torso.",
}


# Of a part of a beat.
CAPTIONS_OF_PART = CAPTIONS | {
    "activation": CAPTIONS["activation"].replace("the end of diastole", "the start of the beat"),
    "cost": "Wall time of each part of what was run, on the first process. The share is of what is shown.",
    "convergence": "Over the part of the beat that was run. J is the volume of an element over that in the unloaded shape; the "
                   "smallest of all elements at each moment.",
}


def captions_of(wall):
    captions = dict(CAPTIONS if wall.result.is_whole_beat else CAPTIONS_OF_PART)
    if len(wall.chambers) > 1:
        cavities = ", ".join(wall.chambers)
        captions["deformation"] += f" Volumes and pressures: of the cavities {cavities}, which this one body encloses."
        if wall.result.is_whole_beat:
            captions["activation"] = captions["activation"].replace("end of diastole", f"end of diastole of {wall.chamber}")
            captions["deformation"] += f" The end of diastole is that of {wall.chamber}."
    return captions


def tissue_section(wall, pictures):
    captions = captions_of(wall)
    parts = [f"<h2>Tissue of {html.escape(wall.name)}</h2>"]
    if wall.trouble:
        parts.append(f"<p class='flag'>{html.escape(wall.trouble)}</p>")
    parts += [embedded(pictures, kind, captions) for kind in ("activation", "deformation", "chambers", "leads")]
    if wall.figures:
        beats = wall.beats_measured()
        if wall.result.is_whole_beat:
            count_unit, note = "per beat", f"means over {_number(beats)} beat{'' if beats == 1 else 's'}."
        else:
            count_unit, note = "", f"sums over the run until {wall.result.end_ms}; if it was resumed, since then."
        parts += ["<h3>Cost</h3>", embedded(pictures, "cost", captions), cost_table(wall.seconds_per_beat(), wall.cost_unit()),
                  sizes_table(wall.figures, beats, count_unit) + f"<p><small>Costs and counts: {note}</small></p>"]
    else:
        parts.append("<p>The result holds no costs of this wall: the run was stopped before its end.</p>")
    parts += ["<h3>Convergence</h3>", _convergence(wall), embedded(pictures, "convergence", captions)]
    return "\n".join(part for part in parts if part)


def embedded(pictures, kind, captions):
    """One of the pictures {kind: file} with its caption, inside the page; nothing where there is no such picture."""
    if kind not in pictures:
        return ""
    data = base64.b64encode(pictures[kind].data).decode()
    return (f"<figure><img style='max-width: 100%' alt='{kind}' src='data:image/png;base64,{data}'>"
            f"<figcaption>{html.escape(captions[kind])}</figcaption></figure>")


def cost_table(seconds, unit):
    """`seconds`: wall time of each of PARTS."""
    whole = sum(seconds.values())
    rows = [(name, f"{seconds[key]:.3f}", f"{100 * seconds[key] / whole:.1f}" if whole > 0 else "")
            for key, name, _ in PARTS if key in seconds]
    rows.append(("together", f"{whole:.3f}", ""))
    return table(("part", f"wall time [{unit}]", "share [%]"), rows)


def sizes_table(figures, counted_over=1, count_unit=""):
    """Figures that are no wall time, with what the file says about them; counts are divided by `counted_over`."""
    known = [key for key in (*SIZES, *COUNTS) if key in figures]
    more = [key for key, figure in figures.items() if key not in known and figure["unit"] != "s"]
    rows = []
    for key in (*known, *more):
        figure = figures[key]
        name = html.escape(f"{key.replace('_', ' ')}: {figure['meaning']}")
        unit = "" if figure["unit"] == "1" else html.escape(figure["unit"])
        if key in COUNTS:
            rows.append((name, _number(figure["value"] / counted_over), count_unit))
        else:
            rows.append((name, _number(figure["value"]), unit))
    return table(("size or count", "value", ""), rows)


def _number(value):
    if value == int(value) or abs(value) >= 1000:
        return f"{value:,.0f}".replace(",", "&thinsp;")
    return f"{value:.3g}"


def _convergence(wall):
    result = wall.result
    rows = []
    ratio = wall.traces.get("smallest_volume_ratio")
    if ratio is not None:
        rows.append((ratio.min() > SMALLEST_GOOD_VOLUME_RATIO,
                     f"smallest volume ratio of an element {ratio.min():.3f}, at {1e3 * result.time[ratio.argmin()]:.0f} ms"))
    cycle = result.summary.get("limit_cycle")
    if cycle and (result.is_whole_beat or result.beats > 0):
        rows.append((cycle["verdict"] == "period-1",
                     f"scaled distance to the limit cycle {cycle['distance']:.1e} after {cycle['beats']} beats"))
    mismatch = result.summary["audits"].get("volume_mismatch_mL")
    if mismatch is not None:
        rows.append((mismatch < 1e-3, f"volumes of walls and of the blood in them differ by at most {mismatch:.1e} mL"))
    steps, newton = result.solver.get("steps"), result.solver.get("newton_iterations")
    where = "in the last beat"
    if not result.is_whole_beat:
        steps, where = len(result.time) - 1, f"until {result.end_ms}"
    if steps and newton is not None:
        rows.append((None, f"Newton iterations of the coupled heart: {newton:.0f} {where}, {newton / steps:.2f} a step"))
    counts = {key: figure["value"] for key, figure in wall.figures.items()}
    own_steps = counts.get("steps")
    if own_steps and "tangents" in counts and "residuals" in counts:
        rows.append((None, f"mechanics: {counts['tangents'] / own_steps:.2f} tangents and {counts['residuals'] / own_steps:.2f} "
                           "further residuals a step"))
    if counts.get("solves") and "solver_iterations" in counts:
        rows.append((None, f"mechanics: {counts['solver_iterations'] / counts['solves']:.1f} iterations a linear system"))
    if counts.get("electrophysiology_steps") and "electrophysiology_iterations" in counts:
        rows.append((None, f"electrophysiology: {counts['electrophysiology_iterations'] / counts['electrophysiology_steps']:.1f} "
                           "iterations a linear system"))
    for key, text in (("rejected_steps", "steps repeated in halves"), ("halved_updates", "Newton updates cut back")):
        if key in counts:
            rows.append((counts[key] == 0, f"{text}: {counts[key]:.0f}"))
    items = "".join(f"<li>{mark(good)}{text}</li>" for good, text in rows)
    return f"<ul>{items}</ul>"
