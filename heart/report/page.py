"""The report as one self-contained HTML file: pictures inside, no scripts, nothing fetched."""

import html

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; margin: 0.6rem 0; } td, th { padding: 0.2rem 0.8rem; text-align: right; }
th { border-bottom: 1px solid #999; font-weight: 600; } td:first-child, th:first-child { text-align: left; }
tr:nth-child(even) td { background: #f6f6f6; } .flag { color: #b2182b; font-weight: 600; } .good { color: #1b7837; }
figure { margin: 1rem 0; } figure svg { max-width: 100%; height: auto; } figcaption { font-size: 0.9rem; color: #555; }
pre { background: #f6f6f6; padding: 0.8rem; overflow-x: auto; font-size: 12.5px; } .verdict { font-size: 1.05rem; }
"""


def write_page(answer, result, pictures, sections=()):
    """`sections`: HTML that stands before the scene."""
    missing = result.what_is_missing()
    return write_document(answer, result, [
        *([f"<p class='flag verdict'>{html.escape(missing)}</p>"] if missing else []),
        _verdicts(result),
        _picture(pictures["wiggers"], _wiggers_caption(result)),
        _picture(pictures["pv_loops"], _loops_caption(result)),
        *(_index_parts(result) if result.has_indexes else []),
        *sections,
    ])


def _index_parts(result):
    indexes = result.summary["indexes"]
    parts = ["<h2>Indexes</h2>", _two_sides(indexes)]
    if result.ranges:
        parts += ["<h2>Against reference ranges</h2>", _ranges(result)]
    return [*parts, "<h2>Valves</h2>", _valves(indexes["valves"])]


def _wiggers_caption(result):
    parts = ["Wiggers diagram of the last beat." if result.is_whole_beat else "Wiggers diagram of the part of the beat that was run."]
    if result.phases:
        parts.append("Shading: phases of the left heart.")
    if result.ecg_surrogate() is not None:
        parts.append("The ECG is a surrogate drawn from the activation of the chambers: its shape has no torso behind it.")
    return " ".join(parts)


def _loops_caption(result):
    if not result.is_whole_beat:
        return "Pressure over volume of each chamber, open curves: the beat was not run to its end."
    return "Pressure-volume loops with the phases of their own side." if result.phases else "Pressure-volume loops."


def write_document(answer, result, parts):
    """`parts`: HTML between the title and the scene. Returns the page."""
    lines = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='generator' content='written by wiggers'>",  # by which it may be replaced (core/file_kind.hpp)
        f"<title>{html.escape(result.title)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{html.escape(result.title)}</h1>",
        *parts,
        "<h2>The scene</h2>",
        f"<pre>{html.escape(result.scene)}</pre>",
        f"<p><small>{html.escape(result.version)}</small></p></body></html>",
    ]
    return answer.file("index.html", "\n".join(lines).encode("utf-8", "replace"))


def _picture(picture, caption):
    svg = picture.data.decode()
    return f"<figure>{svg[svg.index('<svg'):]}<figcaption>{html.escape(caption)}</figcaption></figure>"


def _verdicts(result):
    s = result.summary
    rows = []
    if "limit_cycle" in s and not (result.beats == 0 and not result.is_whole_beat):
        cycle = s["limit_cycle"]
        good = cycle["verdict"] == "period-1"
        words = cycle["verdict"] + "".join(f"{', with warnings: ' if k == 0 else '; '}{w}" for k, w in enumerate(cycle.get("warnings", [])))
        rows.append((good and "warnings" not in cycle, f"limit cycle: {html.escape(words)}, scaled distance {cycle['distance']:.1e} after "
                           f"{cycle['beats']} beats, leading multiplier {cycle['multiplier']:.3f}"))
    for name, cell in s.get("cells", {}).items():
        if "limit_cycle" in cell:
            cycle = cell["limit_cycle"]
            rows.append((cycle["verdict"] == "period-1",
                         f"cells {html.escape(name)}: {html.escape(cycle['verdict'])}, distance {cycle['distance']:.1e} after {cycle['beats']} "
                         f"beats; calcium {cell['calcium_min_uM']:.3f} to {cell['calcium_max_uM']:.3f} uM at the force model"))
    audits = s["audits"]
    # Both hold over whole beats only: within one, blood and energy are stored on the way.
    if result.beats > 0 or result.is_whole_beat:
        rows.append((audits["blood_volume_drift_mL"] < 1e-6, f"blood volume drift {audits['blood_volume_drift_mL']:.1e} mL a beat"))
    if result.is_whole_beat:
        rows.append((audits["energy_imbalance"] < 0.02,
                     f"energy: chambers' work and losses differ by {100 * audits['energy_imbalance']:.2f} % (step error)"))
    flips = s["flips"]
    rows.append((flips["p_LV_mmHg"] < 0.1 and flips["Q_AV_mL_per_s"] < 1,
                 f"largest step-to-step flip: p_LV {flips['p_LV_mmHg']:.3g} mmHg, Q_AV {flips['Q_AV_mL_per_s']:.3g} mL/s"))
    return verdict_list(result, rows)


def verdict_list(result, rows):
    """`rows`: (good or not, None where it cannot be judged; HTML). Warnings of the run follow."""
    items = "".join(f"<li>{mark(good)}{text}</li>" for good, text in rows)
    # What speaks of indexes that there are not is said by the page itself.
    told = [] if getattr(result, "has_indexes", True) else ["there are no indexes", "the indexes are of the last beat"]
    warnings = [w for w in result.summary.get("warnings", []) if not w.endswith(tuple(told))]
    warnings = "".join(f"<li class='flag'>{html.escape(w)}</li>" for w in warnings)
    if result.status != "complete":
        warnings = "<li class='flag'>this run is not complete</li>" + warnings
    return f"<ul class='verdict'>{items}{warnings}</ul>"


def mark(good):
    return "" if good is None else f"<span class='{'good' if good else 'flag'}'>{'good' if good else 'look'}</span> "


def table(headings, rows):
    head = "".join(f"<th>{h}</th>" for h in headings)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _two_sides(indexes):
    lv, rv, la, ra = (indexes[c] for c in ("LV", "RV", "LA", "RA"))
    aorta, pa = indexes["aorta"], indexes["pulmonary_artery"]
    rows = []
    for key, name, digits in (("EDV_mL", "end-diastolic volume [mL]", 1), ("ESV_mL", "end-systolic volume [mL]", 1),
                              ("SV_mL", "stroke volume [mL]", 2), ("EF_percent", "ejection fraction [%]", 1),
                              ("pressure_max_mmHg", "ventricle, highest pressure [mmHg]", 1),
                              ("pressure_min_mmHg", "ventricle, lowest pressure [mmHg]", 1),
                              ("stroke_work_J", "stroke work [J]", 3), ("dpdt_max_mmHg_per_s", "dp/dt max [mmHg/s]", 0)):
        rows.append((name, f"{lv[key]:.{digits}f}", f"{rv[key]:.{digits}f}"))
    rows.append(("artery, highest / lowest pressure [mmHg]",
                 *(f"{a['pressure_max_mmHg']:.1f} / {a['pressure_min_mmHg']:.1f}" for a in (aorta, pa))))
    for key, name in (("Vmax_mL", "atrium, largest volume [mL]"), ("VpreAC_mL", "atrium, before contraction [mL]"),
                      ("Vmin_mL", "atrium, smallest volume [mL]"), ("pressure_mean_mmHg", "atrium, mean pressure [mmHg]")):
        rows.append((name, *(f"{a[key]:.1f}" if key in a else "" for a in (la, ra))))
    for key, name in (("E_over_A", "E/A"), ("atrial_kick_percent", "share of atrial kick in filling [%]")):
        if key in indexes:
            rows.append((name, *(f"{indexes[key][v]:.2f}" if v in indexes[key] else "" for v in ("MV", "TV"))))
    return table(("", "left", "right"), rows)


def _ranges(result):
    rows = []
    for name in (f"{c}.{i}" for c in ("LV", "RV") for i in ("EDV", "ESV", "SV", "EF")):
        rows.append(_range_row(result, name))
    for name in (f"{c}.{i}" for c in ("LA", "RA") for i in ("Vmax", "VpreAC", "Vmin", "PassEF", "ActEF", "TotEF")):
        rows.append(_range_row(result, name))
    note = (f"<p><small>Volumes per body surface area of {result.body_surface_area} m2. Ranges: men, cardiac magnetic "
            "resonance (Kawel-Boehm et al. 2020; PassEF, ActEF and VpreAC from Li et al. 2017).</small></p>")
    return table(("index", "value", "unit", "range", "Fedele et al. 2023", ""), rows) + note


def _range_row(result, name):
    r = result.ranges[name]
    if "value" not in r:  # an atrium that does not contract
        return (name, "", r["unit"], f"{r['lower']:.0f} to {r['upper']:.0f}", f"{r['founding_paper']:.1f}", "")
    flag = "below" if r["value"] < r["lower"] else "above" if r["value"] > r["upper"] else ""
    return (name, f"{r['value']:.1f}", html.escape(r["unit"]), f"{r['lower']:.0f} to {r['upper']:.0f}", f"{r['founding_paper']:.1f}",
            f"<span class='flag'>{flag}</span>")


def _valves(valves):
    rows = []
    for name, long in (("MV", "mitral"), ("AV", "aortic"), ("TV", "tricuspid"), ("PV", "pulmonary")):
        v = valves[name]
        rows.append((long, *(f"{1e3 * v[k]:.0f}" if k in v else "" for k in ("opens_s", "closes_s")),
                     f"{v['peak_flow_mL_per_s']:.0f}", f"{v['backward_volume_mL']:.3f}"))
    return table(("valve", "opens [ms]", "closes [ms]", "peak flow [mL/s]", "backward volume [mL]"), rows)
