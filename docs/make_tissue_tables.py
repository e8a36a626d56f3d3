"""Measures the tables of docs/tissue.md: cost against mesh size, ranks, stabilisations.

    python docs/make_tissue_tables.py build/wiggers-3d

Prints markdown. Nothing else should run on the machine meanwhile (some twenty minutes on two cores).
"""

import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "heart" / "report"))

import vtu  # noqa: E402

SCENE = Path(__file__).parent.parent / "scenes" / "left_ventricle_3d.toml"
ENVIRONMENT = dict(os.environ, OMP_NUM_THREADS="1", OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                   OMPI_MCA_rmaps_base_oversubscribe="1")


def run(command, ranks, result, **changes):
    settings = {"walls.LV.fields_every_ms": 0, "run.beats": 1}
    settings |= {key.replace("__", "."): value for key, value in changes.items()}
    words = ["mpirun", "-n", str(ranks), command, "run", str(SCENE), "--quiet", "-o", str(result)]
    for key, value in settings.items():
        words += ["--set", f"{key}={value}"]
    return subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True)


def figures(result):
    with h5py.File(result) as file:
        values = {name: float(np.ravel(data[()])[0]) for name, data in file["/solver/walls/LV"].items()}
        values["heart"] = float(np.ravel(file["/solver/cost_heart"][()])[0])
        values["start"] = float(np.ravel(file["/solver/cost_cells"][()])[0])
    return values


def cost(command, ranks, size_mm, window_ms, folder):
    result = folder / f"cost_{size_mm}_{ranks}_{window_ms}.h5"
    done = run(command, ranks, result, walls__LV__size_mm=size_mm, walls__LV__reference__recover="false",
               run__stop_after_ms=window_ms)
    if done.returncode:
        sys.exit(done.stderr)
    return figures(result)


def sizes(command, folder):
    print("| h, mm | tetrahedra | unknowns, potential / displacement | a step of electrophysiology, ms "
          "| ionic / right side / solve | a step of mechanics: assembly / solve, ms "
          "| assembly, us per tetrahedron and core | s per 1000 steps |")
    print("|---|---|---|---|---|---|---|---|")
    points = []
    for size in (8, 6, 4, 3):
        f = cost(command, 2, size, 220, folder)
        n, e = f["steps"], f["electrophysiology_steps"]
        per_assembly = f["mechanics_assembly"] / (f["tangents"] + f["residuals"])
        points.append((f["tetrahedra"], f["heart"] / n))
        print(f"| {size} | {f['tetrahedra']:.0f} | {f['potential_nodes']:.0f} / {f['displacement_unknowns']:.0f} "
              f"| {1e3 * f['electrophysiology'] / e:.2f} | {1e3 * f['electrophysiology_ionic'] / e:.2f} / "
              f"{1e3 * f['electrophysiology_right_side'] / e:.2f} / {1e3 * f['electrophysiology_solve'] / e:.2f} "
              f"| {1e3 * f['mechanics_assembly'] / n:.0f} / {1e3 * f['mechanics_solve'] / n:.0f} "
              f"| {1e6 * per_assembly * f['ranks'] / f['tetrahedra']:.2f} | {1e3 * f['heart'] / n:.1f} |", flush=True)
    slope = np.polyfit(*np.log(points).T, 1)[0]
    last = math.log(points[-1][1] / points[-2][1]) / math.log(points[-1][0] / points[-2][0])
    print(f"\nPower of the number of tetrahedra: {slope:.2f} over all sizes, {last:.2f} between the finest two.")
    one, two = (cost(command, ranks, 3, 80, folder)["heart"] for ranks in (1, 2))
    print(f"3 mm, 80 ms: {one:.1f} s on one rank, {two:.1f} s on two: {one / two:.2f} times.\n", flush=True)


def whole_beat(command, folder):
    """All physics at 3 mm, from the unloaded shape's recovery to the end of the beat."""
    result = folder / "whole.h5"
    begin = time.monotonic()
    done = run(command, 2, result, walls__LV__size_mm=3)
    if done.returncode:
        sys.exit(done.stderr)
    f = figures(result)
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    parts = {name: f[name] for name in ("electrophysiology", "active_force", "mechanics_assembly", "mechanics_solve",
                                        "deformation")}
    print(f"3 mm, {f['tetrahedra']:.0f} tetrahedra, one beat of 800 ms on two ranks: {f['heart']:.0f} s, "
          f"start-up {f['start']:.0f} s, in all {time.monotonic() - begin:.0f} s; largest memory of a rank {memory:.2f} GB.")
    print("Of the beat: " + ", ".join(f"{name.replace('_', ' ')} {value:.0f} s" for name, value in parts.items()) +
          f"; {2 * f['heart'] / 3600 / f['tetrahedra'] * 1e3:.4f} core-hours per thousand tetrahedra.\n", flush=True)


def ranks(command, folder):
    traces = []
    for n in (1, 2, 3):
        result = folder / f"ranks_{n}.h5"
        done = run(command, n, result, walls__LV__size_mm=8, run__stop_after_ms=50)
        if done.returncode:
            sys.exit(done.stderr)
        with h5py.File(result) as file:
            traces.append({name: file[place][:] for name, place in (
                ("pressure", "/cavities/LV/pressure"), ("volume", "/cavities/LV/volume"),
                ("potential", "/cells/LV/membrane_potential"), ("stretch", "/cells/LV/stretch"))})
    for n, other in zip((2, 3), traces[1:], strict=True):
        text = ", ".join(f"{name} {np.abs(other[name] - first).max() / np.abs(first).max():.1e}"
                         for name, first in traces[0].items())
        print(f"1 and {n} ranks, 8 mm, 50 ms, largest difference over largest value: {text}.")
    print(flush=True)


def smallest_wall(fields):
    """Smallest volume of the myocardium over the frames, over its unloaded volume."""

    def volume(points, cells):
        a, b, c, d = (points[cells[:, k]] for k in range(4))
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6

    ratios = []
    for path in sorted(fields.glob("frame_*.vtu")):
        frame = vtu.Frame(path)
        cells = frame.cells[frame.tag == 1]
        ratios.append(volume(frame.points + frame.field("displacement_m"), cells) / volume(frame.points, cells))
    return min(ratios)


def stabilisations(command, folder):
    print("| | LV peak, mmHg | EF, % | peak Q_AV, mL/s | flips of the pressure, mmHg | smallest J "
          "| smallest volume of the wall, share |\n|---|---|---|---|---|---|---|")
    cases = {"as it is (implicit rate)": {}, "`solver.stretch_rate=lagged`": {"solver__stretch_rate": "lagged"},
             "`solver.stretch_rate=none`": {"solver__stretch_rate": "none"},
             "`solver.stabilise.volumes=false`": {"solver__stabilise__volumes": "false"},
             "`solver.stabilise.active_stress=false`": {"solver__stabilise__active_stress": "false"},
             "`walls.LV.a_XB_kPa=15e5`, `walls.LV.materials.ventricles.bulk_Pa=5e4` (the founding paper's)":
                 {"walls__LV__a_XB_kPa": "15e5", "walls__LV__materials__ventricles__bulk_Pa": "5e4"}}
    for k, (name, changes) in enumerate(cases.items()):
        result = folder / f"case_{k}.h5"
        done = run(command, 2, result, walls__LV__size_mm=5, walls__LV__fields_every_ms=20, **changes)
        if done.returncode:
            said = (line for line in done.stderr.splitlines() if line.startswith("wiggers:"))
            reason = next(said, done.stderr[-300:])
            print(f"| {name} | {reason} | | | | | |", flush=True)
            continue
        with h5py.File(result) as file:
            flips = json.loads(file["/summary"].asstr()[()])["flips"]["p_LV_mmHg"]
            J = file["/cells/LV/smallest_volume_ratio"][:].min()
            p, V = (file[f"/cavities/LV/{name}"][:] for name in ("pressure", "volume"))
            Q = file["/valves/AV/flow"][:]
        print(f"| {name} | {p.max():.1f} | {100 * (1 - V.min() / V.max()):.1f} | {Q.max():.0f} | {flips:.2g} "
              f"| {J:.2f} | {smallest_wall(folder / f'case_{k}.LV.fields'):.3f} |", flush=True)


def main():
    command = str(Path(sys.argv[1]).resolve())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sizes(command, folder)
        whole_beat(command, folder)
        ranks(command, folder)
        stabilisations(command, folder)


if __name__ == "__main__":
    main()
