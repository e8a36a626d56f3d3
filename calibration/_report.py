"""A fit as one self-contained HTML page, in the style of the other reports."""

from __future__ import annotations

import html
import importlib.util
import os
from pathlib import Path
from types import ModuleType

import wiggers

from ._fit import NOT_DETERMINED, Fit


def _page() -> ModuleType:
    """The module of the result reports: its style and its tables."""
    path = Path(wiggers.__file__).parent / "report" / "page.py"
    spec = importlib.util.spec_from_file_location("wiggers_report_page", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_report(fit: Fit, path: str | os.PathLike[str], title: str = "Calibration") -> Path:
    """Writes the page: parameters with intervals, targets met and missed, what constrains what."""
    page = _page()
    explained = fit.explain()
    free = fit.problem.free
    parameters = []
    intervals, undetermined = fit.intervals, fit.undetermined
    for name, value in fit.parameters.items():
        low, high = intervals[name]
        known = NOT_DETERMINED if name in undetermined else f"{low:.5g} to {high:.5g}"
        bounds = f"{free[name].lower:g} to {free[name].upper:g}" if name in free else f"= {fit.problem.ties[name]}"
        info = fit.problem.model.parameters.info(name)
        flag = " <span class='flag'>at its bound</span>" if name in fit.at_bound else ""
        parameters.append([f"{html.escape(name)}{flag}", f"{value:.6g}", known,
                           html.escape(bounds), html.escape(info.unit)])
    targets = []
    for target, output in zip(fit.problem.targets, fit.point.outputs, strict=True):
        kind = "good" if target.met(output) else "flag"
        targets.append([html.escape(target.label), f"{output:.5g}", html.escape(target.text),
                        html.escape(fit.problem.unit_of(target)),
                        f"<span class='{kind}'>{target.off(output):+.2f}</span>"])
    searches = [[str(k + 1), "" if s.cost is None else f"{s.cost:.5g}", html.escape(s.message)]
                for k, s in enumerate(fit.searches)]
    verdict = "<br>".join(html.escape(line) for line in fit.verdict)
    text = "".join([
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{html.escape(title)}</title><style>{page.STYLE}</style></head><body><h1>{html.escape(title)}</h1>",
        f"<p class='verdict'>{verdict}</p>",
        f"<p>Cost {fit.cost:.4g} after {fit.solves} limit cycles and {fit.gradients} gradients, {fit.seconds:.1f} s; "
        f"{len(fit.failures)} points without a limit cycle.</p>",
        "<h2>Parameters</h2>",
        page.table(["parameter", "value", "95 % interval", "bounds", "unit"], parameters),
        "<h2>Targets</h2>", page.table(["output", "value", "wanted", "unit", "off by, sd"], targets),
        "<h2>Starts</h2>", page.table(["start", "cost", "what became of it"], searches),
        "<h2>What is known, and what is not</h2>", f"<pre>{html.escape(str(explained))}</pre></body></html>"])
    target_path = Path(path)
    beside = target_path.with_name(target_path.name + ".part")
    beside.write_text(text)
    os.replace(beside, target_path)
    return target_path
