"""Measures the 3D tissue and writes docs/tissue-measured.md: cost, ranks, the main scene, stabilisations.

    python docs/make_tissue_tables.py build/wiggers-3d docs

Nothing else should run on the machine meanwhile (some twenty minutes on two cores). Ends with an error, after
the page is written, if a figure misses what the project promises.
"""

import json
import math
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from datetime import date
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "heart" / "report"))

import vtu  # noqa: E402

SCENE = Path(__file__).parent.parent / "scenes" / "left_ventricle_3d.toml"
ENVIRONMENT = dict(os.environ, OMP_NUM_THREADS="1", OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                   OMPI_MCA_rmaps_base_oversubscribe="1")


page, missed = [], []


def say(text):
    print(text, flush=True)
    page.append(text)


def promise(claim, value, low=-math.inf, high=math.inf, form="{:.3g}"):
    """A figure with its bounds, for the page's last table."""
    good = low <= value <= high
    bounds = f"{low:g} to {high:g}" if low > -math.inf and high < math.inf else (
        f"at most {high:g}" if high < math.inf else f"at least {low:g}")
    promises.append(f"| {claim} | {bounds} | {form.format(value)}{'' if good else ' **missed**'} |")
    if not good:
        missed.append(claim)


promises = []


def processor():
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.processor()


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
    say("| h, mm | tetrahedra | unknowns, potential / displacement | a step of electrophysiology, ms "
          "| ionic / right side / solve | a step of mechanics: assembly / solve, ms "
          "| assembly, us per tetrahedron and core | s per 1000 steps |")
    say("|---|---|---|---|---|---|---|---|")
    points = []
    for size in (8, 6, 4, 3):
        f = cost(command, 2, size, 220, folder)
        n, e = f["steps"], f["electrophysiology_steps"]
        per_assembly = f["mechanics_assembly"] / (f["tangents"] + f["residuals"])
        points.append((f["tetrahedra"], f["heart"] / n))
        say(f"| {size} | {f['tetrahedra']:.0f} | {f['potential_nodes']:.0f} / {f['displacement_unknowns']:.0f} "
              f"| {1e3 * f['electrophysiology'] / e:.2f} | {1e3 * f['electrophysiology_ionic'] / e:.2f} / "
              f"{1e3 * f['electrophysiology_right_side'] / e:.2f} / {1e3 * f['electrophysiology_solve'] / e:.2f} "
              f"| {1e3 * f['mechanics_assembly'] / n:.0f} / {1e3 * f['mechanics_solve'] / n:.0f} "
              f"| {1e6 * per_assembly * f['ranks'] / f['tetrahedra']:.2f} | {1e3 * f['heart'] / n:.1f} |")
    slope = np.polyfit(*np.log(points).T, 1)[0]
    last = math.log(points[-1][1] / points[-2][1]) / math.log(points[-1][0] / points[-2][0])
    say(f"\nPower of the number of tetrahedra: {slope:.2f} over all sizes, {last:.2f} between the finest two.")
    one, two = (cost(command, ranks, 3, 80, folder)["heart"] for ranks in (1, 2))
    say(f"3 mm, the first 80 ms: {one:.1f} s on one rank, {two:.1f} s on two: {one / two:.2f} times.\n")
    promise("one rank to two, 3 mm", one / two, low=1.7)
    promise("step of electrophysiology at 3 mm, ms", 1e3 * f["electrophysiology"] / f["electrophysiology_steps"], high=12)
    promise("assembly of mechanics, us per tetrahedron and core", 1e6 * per_assembly * f["ranks"] / f["tetrahedra"], high=4)


def whole_beat(command, folder):
    """All physics at 3 mm, from the unloaded shape's recovery to the end of the beat. First, so that the memory is its own."""
    result = folder / "whole.h5"
    begin = time.monotonic()
    done = run(command, 2, result, walls__LV__size_mm=3)
    if done.returncode:
        sys.exit(done.stderr)
    f = figures(result)
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    parts = {name: f[name] for name in ("electrophysiology", "active_force", "mechanics_assembly", "mechanics_solve",
                                        "deformation")}
    core_hours = 2 * f["heart"] / 3600 / f["tetrahedra"] * 1e3
    say(f"3 mm, {f['tetrahedra']:.0f} tetrahedra, one whole beat of 800 ms on two ranks, all physics: {f['heart']:.0f} s, "
        f"start-up (unloaded shape, initial displacement, cells) {f['start']:.0f} s, in all "
        f"{time.monotonic() - begin:.0f} s; largest memory of a rank {memory:.2f} GB.")
    say("Of the beat: " + ", ".join(f"{name.replace('_', ' ')} {value:.0f} s" for name, value in parts.items()) +
        f". {core_hours:.4f} core-hours per thousand tetrahedra and beat; the founding paper's figure is 0.84 "
        "(228 core-hours for 270 000 tetrahedra).\n")
    promise("a whole beat at 3 mm on two ranks, s", f["heart"], high=900)
    promise("memory of both ranks, GB", 2 * memory, high=3)
    promise("founding paper's core-hours over ours", 0.84 / core_hours, low=40, form="{:.0f}")


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
        say(f"1 and {n} ranks, 8 mm, 50 ms, largest difference over largest value: {text}.")
        promise(f"1 and {n} ranks, largest relative difference of the four",
                max(np.abs(other[name] - first).max() / np.abs(first).max() for name, first in traces[0].items()),
                high=1e-6, form="{:.1e}")
    say("")


def main_scene(command, folder):
    """The scene as it is delivered: three beats from near the limit cycle."""
    result = folder / "main.h5"
    words = ["mpirun", "-n", "2", command, "run", str(SCENE), "--quiet", "--json", "-o", str(result),
             "--set", "walls.LV.fields_every_ms=0"]
    done = subprocess.run(words, env=ENVIRONMENT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    summary = json.loads(done.stdout.splitlines()[-1])
    f = figures(result)
    lv, audits = summary["indexes"]["LV"], summary["audits"]
    with h5py.File(result) as file:
        p, aorta = file["/cavities/LV/pressure"][:], file["/circulation/p_AR_SYS"][:]
        Q = file["/valves/AV/flow"][:].max()
    say(f"`scenes/left_ventricle_3d.toml`, {f['tetrahedra']:.0f} tetrahedra, two ranks, three beats: start-up "
        f"{f['start']:.0f} s, {f['heart'] / 3:.0f} s a beat. Third beat: LV peak {p.max():.1f} mmHg, EF {lv['EF_percent']:.1f} %, "
        f"peak Q_AV {Q:.0f} mL/s, aorta {aorta.min():.0f}-{aorta.max():.0f} mmHg; flips of the pressure "
        f"{summary['flips']['p_LV_mmHg']:.2g} mmHg; blood volume drift {audits['blood_volume_drift_mL']:.1e} mL; wall and "
        f"circulation differ by at most {audits['volume_mismatch_mL']:.1e} mL at Newton's linearisation; distance to the limit "
        f"cycle {summary['limit_cycle']['distance']:.2g}; {f['rejected_steps']:.0f} steps rejected, "
        f"{f['direct_solves']:.0f} systems left to the direct solver.\n")
    promise("LV peak of the third beat, mmHg", p.max(), 100, 135, "{:.1f}")
    promise("ejection fraction, %", lv["EF_percent"], 45, 70, "{:.1f}")
    promise("peak Q_AV, mL/s", Q, 450, 750, "{:.0f}")
    promise("flips of the pressure, mmHg", summary["flips"]["p_LV_mmHg"], high=0.1)
    promise("blood volume drift, mL a beat", abs(audits["blood_volume_drift_mL"]), high=1e-8, form="{:.1e}")


def across(command, folder):
    """One element across the wall (8, 6 mm) beside two and more."""
    say("| h, mm | tetrahedra | LV peak, mmHg | EF, % | end-diastolic volume, mL | stroke volume, mL | peak Q_AV, mL/s | smallest J |")
    say("|---|---|---|---|---|---|---|---|")
    better = {f"walls__LV__electrophysiology__conductivity__{direction}_mm2_per_ms": 0.8
              for direction in ("fibre", "sheet", "normal")}
    better |= {f"walls__LV__stimuli__{place}__radius_mm": 8 for place in ("septum", "free_wall", "apex")}
    ejected = {}
    for size in (8, 6, 4):
        result = folder / f"across_{size}.h5"
        done = run(command, 2, result, walls__LV__size_mm=size, walls__LV__reference__recover="false", **better)
        if done.returncode:
            sys.exit(done.stderr)
        with h5py.File(result) as file:
            p, V = (file[f"/cavities/LV/{name}"][:] for name in ("pressure", "volume"))
            Q, J = file["/valves/AV/flow"][:].max(), file["/cells/LV/smallest_volume_ratio"][:].min()
        ejected[size] = 100 * (1 - V.min() / V.max())
        say(f"| {size} | {figures(result)['tetrahedra']:.0f} | {p.max():.1f} | {ejected[size]:.1f} | {V.max():.1f} "
            f"| {V.max() - V.min():.1f} | {Q:.0f} | {J:.2f} |")
    say("")
    promise("EF at 8 mm beside that at 4 mm, %", abs(ejected[8] - ejected[4]), high=2)


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
    say("| | LV peak, mmHg | EF, % | peak Q_AV, mL/s | flips of the pressure, mmHg | smallest J "
          "| smallest volume of the wall, share |\n|---|---|---|---|---|---|---|")
    cases = {"as it is (implicit rate)": {}, "`solver.stretch_rate=lagged`": {"solver__stretch_rate": "lagged"},
             "`solver.stretch_rate=none`": {"solver__stretch_rate": "none"},
             "`solver.stabilise.volumes=false`": {"solver__stabilise__volumes": "false"},
             "`solver.stabilise.active_stress=false`": {"solver__stabilise__active_stress": "false"},
             "`walls.LV.a_XB_kPa=15e5`, `walls.LV.materials.ventricles.bulk_Pa=5e4` (the founding paper's), "
             "`walls.LV.reference.recover=false`":
                 {"walls__LV__a_XB_kPa": "15e5", "walls__LV__materials__ventricles__bulk_Pa": "5e4",
                  "walls__LV__reference__recover": "false"}}
    flow, flip = {}, {}
    for k, (name, changes) in enumerate(cases.items()):
        flow[name], flip[name] = math.nan, math.inf  # unless it comes to its end
        result = folder / f"case_{k}.h5"
        done = run(command, 2, result, walls__LV__size_mm=5, walls__LV__fields_every_ms=20, **changes)
        if done.returncode:
            said = (line for line in done.stderr.splitlines() if line.startswith("wiggers:"))
            reason = next(said, done.stderr[-300:]).replace(f"{folder}/", "")
            say(f"| {name} | {reason} | | | | | |")
            continue
        with h5py.File(result) as file:
            flips = json.loads(file["/summary"].asstr()[()])["flips"]["p_LV_mmHg"]
            J = file["/cells/LV/smallest_volume_ratio"][:].min()
            p, V = (file[f"/cavities/LV/{name}"][:] for name in ("pressure", "volume"))
            Q = file["/valves/AV/flow"][:]
        flow[name], flip[name] = Q.max(), flips
        say(f"| {name} | {p.max():.1f} | {100 * (1 - V.min() / V.max()):.1f} | {Q.max():.0f} | {flips:.2g} "
              f"| {J:.2f} | {smallest_wall(folder / f'case_{k}.LV.fields'):.3f} |")


    names = list(cases)
    promise("peak Q_AV without rate feedback over that with it", flow[names[2]] / flow[names[0]], low=1.6)
    promise("flips without stabilised volumes, mmHg", flip[names[3]], low=5)
    promise("flips without stabilised active stress, mmHg (inf: it breaks down)", flip[names[4]], low=5)
    say("")


def main():
    command, docs = str(Path(sys.argv[1]).resolve()), Path(sys.argv[2])
    say("# The 3D tissue, measured\n")
    say(f"Made by `make tissue-tables` on {date.today().isoformat()}: two cores of an {processor()}, otherwise idle.\n")
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            say("## A whole beat\n")
            whole_beat(command, folder)
            say("## Cost against mesh size\n")
            say("`scenes/left_ventricle_3d.toml` on two ranks, its first 220 ms (activation within them), the mesh taken as unloaded, "
                "no fields: P2 potential, P1 displacement, tau 0.05 ms, dt 1 ms.\n")
            sizes(command, folder)
            say("## Ranks\n")
            ranks(command, folder)
            say("## The main scene\n")
            main_scene(command, folder)
            say("## Elements across the wall\n")
            say("The main scene's first beat, its mesh taken as unloaded, all conductivities 0.8 mm2/ms and stimuli of 8 mm radius, so "
                "that conduction does not depend on the mesh. 8 and 6 mm have one element across the wall.\n")
            across(command, folder)
            say("## Stabilisations and rate feedback\n")
            say("The main scene at 5 mm, its first beat, with the key shown. Flips: largest change of sign of the pressure's "
                "difference from step to step (`/summary`).\n")
            stabilisations(command, folder)
        say("## What was promised\n")
        say("| claim | bound | measured |\n|---|---|---|")
        for line in promises:
            say(line)
    finally:
        # What was measured is not lost when a later part fails.
        (docs / "tissue-measured.md").write_text("\n".join(page) + "\n")
    if missed:
        sys.exit("missed: " + ", ".join(missed))


if __name__ == "__main__":
    main()
