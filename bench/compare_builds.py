"""Two builds of the command, one against the other: every scene, loop, cell and force, summaries and traces.

    python bench/compare_builds.py OLD/wiggers NEW/wiggers [--scenes] [--tissue] [--only NAME ...]

Prints for each command the largest relative difference of any number of its summary and of its trace (relative to the
largest value of the column), and the ratio of user times. Status 1 where one build refuses what the other does, or a
difference is above --tolerance.
"""

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).parent.parent
# Costs and names of files differ, and what only one build knows.
IGNORED = ("wall", "cost", "seconds", "_s_per_", "host", "revision", "provenance", "version", "time_s", "solver", "memory",
           "residual", "drift", "limit_cycle/distance")


def run(command, words, folder):
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run([command, *words], cwd=folder, capture_output=True, text=True)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    return done.returncode, json.loads(lines[-1]) if lines else done.stderr, seconds


def numbers(value, name=""):
    """Leaves of a summary by their path."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not any(word in key for word in IGNORED):
                yield from numbers(inner, f"{name}/{key}")
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            yield from numbers(inner, f"{name}[{k}]")
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield name, float(value)


def difference(a, b):
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape:
        return math.inf
    if a.size == 0:
        return 0.0
    both = np.isnan(a) & np.isnan(b)
    scale = max(np.nanmax(np.abs(a[~both]), initial=0), np.nanmax(np.abs(b[~both]), initial=0), 1e-300)
    return float(np.max(np.abs(a[~both] - b[~both]), initial=0) / scale)


def columns(path):
    """Numeric columns of a table or result."""
    if path.suffix == ".csv":
        rows = path.read_text().splitlines()
        data = np.array([[float(x) if x else math.nan for x in row.split(",")] for row in rows[1:]])
        return dict(zip(rows[0].split(","), data.T, strict=True))
    found = {}

    def keep(name, item):
        if isinstance(item, h5py.Dataset) and item.dtype.kind == "f" and not any(word in name for word in IGNORED) \
                and not name.startswith("checkpoint"):
            found[name] = item[()]
    with h5py.File(path) as file:
        file.visititems(keep)
    return found


def commands(options):
    models = subprocess.run([options.old, "models"], capture_output=True, text=True, check=True).stdout.splitlines()
    for line in models:
        name = line.split()[0]
        if name == "circulation" or "force" in line:
            continue
        for integrator in ("cvode", "rosenbrock", "rush-larsen", "rush-larsen-2", "generalised-rush-larsen-2", "bdf2-imex"):
            yield f"cell {name} {integrator}", ["cell", name, "--beats", "2", "--integrator", integrator, "-o", "out.csv"]
        yield f"cell {name} cycle", ["cell", name, "--until", "limit-cycle", "--integrator", "rush-larsen-2", "-o", "out.csv"]
    for parameters in ("human37", "fedele2023-ventricles", "fedele2023-atria"):
        yield f"force {parameters}", ["force", "--parameters", parameters, "--calcium", "0.6", "--sarcomere-length", "1.9",
                                      "--duration-s", "0.3", "--start", "published", "-o", "out.csv"]
    for parameters in ("wiggers-healthy-0d", "baseline75", "regazzoni2022-script", "circulation-0.3.1"):
        for integrator in ("runge-kutta-4", "cvode"):
            (options.folder / f"{parameters}.toml").write_text(f'parameters = "{parameters}"\n')
            yield f"loop {parameters} {integrator}", ["loop", str(options.folder / f"{parameters}.toml"), "--until", "limit-cycle",
                                                      "--integrator", integrator, "-o", "out.csv"]
    for scene in sorted((ROOT / "scenes").glob("*.toml")):
        text = scene.read_text()
        if "tissue" in text or "[body" in text:
            if options.tissue:
                yield f"3D {scene.stem}", ["run", str(scene), "--set", "run.stop_after_ms=40", "-o", "out.h5"]
        else:
            yield f"run {scene.stem}", ["run", str(scene), "-o", "out.h5"]
            if "kind = \"reduced\"" in text and "triseg" not in text:
                for rate in ("lagged", "implicit", "none"):
                    yield f"run {scene.stem} {rate}", ["run", str(scene), "--set", f"solver.stretch_rate={rate}", "--set",
                                                       "run.beats=1", "-o", "out.h5"]


def compare(options):
    """The largest difference of a trace."""
    worst = 0.0
    for name, words in commands(options):
        if options.only and not any(word in name for word in options.only):
            continue
        with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
            old, new = (run(command, [*words, "--quiet", "--json"], folder)
                        for command, folder in ((options.old, first), (options.new, second)))
            if old[0] != new[0] or isinstance(old[1], str) != isinstance(new[1], str):
                print(f"{name}: status {old[0]} became {new[0]}: {new[1] if isinstance(new[1], str) else ''}")
                worst = math.inf
                continue
            if isinstance(old[1], str):
                print(f"{name}: refused by both" if old[1] == new[1] else f"{name}: {old[1]} became {new[1]}")
                continue
            before, after = dict(numbers(old[1])), dict(numbers(new[1]))
            shared = before.keys() & after.keys()
            summary = max((difference([before[k]], [after[k]]) if abs(before[k]) > 1e-12 else 0.0 for k in shared), default=0)
            at = max(shared, key=lambda k: difference([before[k]], [after[k]]), default="")
            trace, where = 0.0, ""
            output = words[words.index("-o") + 1]
            a, b = columns(Path(first) / output), columns(Path(second) / output)
            for key in a.keys() & b.keys():
                if (d := difference(a[key], b[key])) > trace:
                    trace, where = d, key
            gone = sorted(a.keys() - b.keys()) + sorted(before.keys() - after.keys())
            print(f"{name}: summary {summary:.1e} {at if summary > 0 else ''}, trace {trace:.1e} {where}, user time "
                  f"{new[2] / max(old[2], 1e-9):.2f}{'; gone: ' + ', '.join(gone) if gone else ''}", flush=True)
            worst = max(worst, trace)
    return worst


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=lambda p: str(Path(p).resolve()))
    parser.add_argument("new", type=lambda p: str(Path(p).resolve()))
    parser.add_argument("--tissue", action="store_true", help="40 ms of the 3D scenes, too")
    parser.add_argument("--only", nargs="*", default=[], help="commands whose name has one of these words")
    parser.add_argument("--tolerance", type=float, default=1e-9)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        options.folder = Path(folder)
        worst = compare(options)
    print(f"largest difference of a trace: {worst:.1e}")
    sys.exit(1 if worst > options.tolerance else 0)


if __name__ == "__main__":
    main()
