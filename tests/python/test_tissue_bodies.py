"""Bodies of tissue from outside: several cavities in one wall, bodies without circulation, steps that fail.

Meshes are as coarse as they can be, as in test_tissue.py.
"""

import os
import re
import shutil
import signal
import subprocess
import time

import h5py
import numpy as np
import pytest
from conftest import SCENES
from killing import KILLS, kill_until, reseal
from tissue_runs import COARSE, ENVIRONMENT, datasets, run, sets, words_for

# The whole heart, with cells as they were published: nothing is paced.
FROM_PUBLISHED = f"""
base = "{SCENES / 'whole_heart.toml'}"
[cells.atria]
start = "published"
[cells.ventricles]
start = "published"
"""

BOTH_VENTRICLES = FROM_PUBLISHED + """
[walls.ventricles]
kind = "tissue"
cells = "ventricles"
a_XB_kPa = 7e5
shape = "biventricular"
size_mm = 14
fields_every_ms = 0
[walls.ventricles.electrophysiology]
order = 1
tau_ms = 0.1
relative_tolerance = 1e-12
[walls.ventricles.electrophysiology.conductivity]
fibre_mm2_per_ms = 0.8
sheet_mm2_per_ms = 0.8
normal_mm2_per_ms = 0.8
[walls.ventricles.mechanics]
residual_tolerance = 1e-9
linear_tolerance = 1e-6
[walls.ventricles.stimuli.apex]
z_mm = -70
radius_mm = 15
start_ms = 0
[walls.ventricles.materials.ventricles]
bulk_Pa = 2e5
[walls.ventricles.reference]
recover = false
[circulation.initial]
V_LV = 110
V_RV = 110
[solver]
dt_s = 2e-3
[run]
beats = 1
stop_after_ms = 100
"""

HEART = FROM_PUBLISHED + """
[walls.heart]
kind = "tissue"
mesh = "heart.msh"
fields_every_ms = 0
[walls.heart.cells.ventricles]
cells = "ventricles"
a_XB_kPa = 7e5
[walls.heart.cells.atria]
cells = "atria"
a_XB_kPa = 3e5
[walls.heart.fibres]
rule = "doste"
[walls.heart.electrophysiology]
order = 1
tau_ms = 0.1
[walls.heart.stimuli.apex]
z_mm = -60
radius_mm = 20
start_ms = 0
[walls.heart.reference]
recover = false
[circulation.initial]
V_LA = 34
V_LV = 80
V_RA = 33
V_RV = 65
[solver]
dt_s = 2e-3
[run]
beats = 1
stop_after_ms = 10
"""

FILLING = ["run", SCENES / "filling_3d.toml", "--quiet", *sets(body__size_mm=10, body__reference__recover="false", run__load_steps=4)]
ACTIVATION = ["run", SCENES / "activation_3d.toml", "--quiet",
              *sets(body__size_mm=12, body__electrophysiology__order=1, body__electrophysiology__tau_ms=0.1,
                    body__electrophysiology__relative_tolerance="1e-12", cells__ventricles__start="published",
                    run__end_ms=60, run__checkpoint_every_ms=20, body__stimuli__septum__radius_mm=12,
                    body__stimuli__free_wall__radius_mm=12, body__stimuli__apex__radius_mm=12,
                    # Conduction fails on meshes as coarse as this one otherwise.
                    **{f"body__electrophysiology__conductivity__{direction}_mm2_per_ms": 0.8
                       for direction in ("fibre", "sheet", "normal")})]


def wait_for(path, process):
    """Until the file is there or the process has ended."""
    for _ in range(6000):
        if path.exists() or process.poll() is not None:
            return
        time.sleep(0.005)


def field_times(result):
    index = (result.parent / (result.stem + ".body.fields") / "index.pvd").read_text()
    return [float(t) for t in re.findall(r'timestep="([^"]+)"', index)]


def column(path, name):
    with h5py.File(path) as file:
        return file[name][()]


# --- several cavities in one wall -----------------------------------------------------------------------------------


def test_both_ventricles_are_one_body_on_any_number_of_ranks(tmp_path):
    (tmp_path / "both.toml").write_text(BOTH_VENTRICLES)
    for ranks in (1, 2):
        outcome = run("run", "both.toml", "--quiet", "--json", "-o", f"{ranks}.h5", ranks=ranks, cwd=tmp_path)
        assert outcome.status == 0, outcome.err
        audits = outcome.json()["audits"]
        assert audits["volume_mismatch_mL"] < 1e-5
        assert abs(audits["blood_volume_drift_mL"]) < 1e-8
    found = datasets(tmp_path / "1.h5")
    assert found["cells/ventricles/active_tension"].max() > 1  # it contracts: both pressures rise with it
    for cavity in ("LV", "RV"):
        assert found[f"cavities/{cavity}/pressure"][-1] > found[f"cavities/{cavity}/pressure"][0] + 3
    other = datasets(tmp_path / "2.h5")
    for name in ("cavities/LV/pressure", "cavities/RV/pressure", "cavities/LV/volume", "cells/ventricles/stretch"):
        assert np.abs(found[name] - other[name]).max() <= 1e-6 * np.abs(found[name]).max(), name
    # The right ventricle's share of the strength matters to the right pressure.
    weak = run("run", "both.toml", "--quiet", "-o", "weak.h5", *sets(walls__ventricles__right_share=0.1), cwd=tmp_path)
    assert weak.status == 0, weak.err
    assert column(tmp_path / "weak.h5", "cavities/RV/pressure")[-1] < found["cavities/RV/pressure"][-1] - 0.3


def test_four_chambers_and_two_arteries_in_one_body(tmp_path):
    made = run("mesh", "heart", "--size-mm", 12, "-o", "heart.msh", cwd=tmp_path)
    assert made.status == 0, made.err
    (tmp_path / "heart.toml").write_text(HEART)
    outcome = run("run", "heart.toml", "--quiet", "--json", "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert outcome.json()["audits"]["volume_mismatch_mL"] < 1e-5
    volumes = {name: column(tmp_path / "r.h5", f"cavities/{name}/volume")[0] for name in ("LA", "LV", "RA", "RV")}
    assert volumes == pytest.approx({"LA": 34, "LV": 80, "RA": 33, "RV": 65})
    # What atria conduct is the scene's; refused where the mesh has none.
    refused = run("run", SCENES / "left_ventricle_3d.toml", *sets(walls__LV__electrophysiology__atrial_conductivity__fibre_mm2_per_ms=1))
    assert refused.status == 2 and "atrial_conductivity" in refused.err


# --- steps that fail ------------------------------------------------------------------------------------------------


def test_steps_too_long_for_newton_are_halved(tmp_path):
    words = [*COARSE, *sets(heart__period_s=0.8, solver__inductors="implicit", walls__LV__fields_every_ms=0,
                                circulation__valves__AV__Rmin=0.0135,  # so that the aorta bears such long steps
                                walls__LV__a_XB_kPa=1.2e7)]  # too strong for them
    long = run("run", SCENES / "left_ventricle_3d.toml", *words, *sets(solver__dt_s=0.04), "-o", "long.h5", "--json", cwd=tmp_path)
    assert long.status == 0, long.err
    figures = datasets(tmp_path / "long.h5")
    assert figures["solver/walls/LV/rejected_steps"] > 0
    assert figures["solver/walls/LV/steps"] > 20  # the halves count
    audits = long.json()["audits"]
    assert audits["volume_mismatch_mL"] < 1e-4 and abs(audits["blood_volume_drift_mL"]) < 1e-8
    # Half steps of a bad step are no worse than the next shorter step: pressures of the same beat.
    short = run("run", SCENES / "left_ventricle_3d.toml", *words, *sets(solver__dt_s=0.004), "-o", "short.h5", cwd=tmp_path)
    assert short.status == 0, short.err
    peak = [column(tmp_path / f"{name}.h5", "cavities/LV/pressure").max() for name in ("long", "short")]
    assert peak[0] == pytest.approx(peak[1], rel=0.1)


# --- bodies without circulation -------------------------------------------------------------------------------------


def test_filling_on_two_ranks_and_resumed(tmp_path):
    for ranks in (1, 2):
        outcome = run(*FILLING, "-o", f"{ranks}.h5", "--json", ranks=ranks, cwd=tmp_path)
        assert outcome.status == 0, outcome.err
    one, two = datasets(tmp_path / "1.h5"), datasets(tmp_path / "2.h5")
    assert one["load"] == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert one["cavities/LV/pressure"] == pytest.approx([0, 5, 10, 15, 20])
    assert (np.diff(one["cavities/LV/volume"]) > 0).all()
    # Tissue stiffens: in the end a further 5 mmHg fills less than before.
    assert np.diff(one["cavities/LV/volume"], 2)[-1] < 0
    for name in ("cavities/LV/volume", "body/stretch", "body/smallest_volume_ratio"):
        assert one[name] == pytest.approx(two[name], rel=1e-7)
    files = sorted(p.name for p in (tmp_path / "1.body.fields").iterdir())
    assert files == [*(f"frame_{k:06d}.vtu" for k in range(5)), "index.pvd"]
    # Stopped on the way, then on from there on another number of ranks: the same curve and frames.
    process = subprocess.Popen([*words_for(1, *FILLING, "-o", "r.h5")], cwd=tmp_path, env=ENVIRONMENT)
    wait_for(tmp_path / "r.body.fields" / "frame_000002.vtu", process)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert 1 <= len(column(tmp_path / "r.h5", "load")) < 5
    resumed = run(*FILLING, "--resume", "r.h5", ranks=2, cwd=tmp_path)
    assert resumed.status == 0, resumed.err
    found = datasets(tmp_path / "r.h5")
    assert found["provenance/status"] == b"complete"
    for name in ("load", "cavities/LV/pressure", "cavities/LV/volume", "body/stretch"):
        assert found[name] == pytest.approx(one[name], rel=1e-6)
    assert sorted(p.name for p in (tmp_path / "r.body.fields").iterdir()) == files
    # A finished one has nothing left to do, but may be asked into another file.
    copied = run(*FILLING, "--resume", "r.h5", "-o", "copy.h5", cwd=tmp_path)
    assert copied.status == 0 and datasets(tmp_path / "copy.h5")["cavities/LV/volume"] == pytest.approx(found["cavities/LV/volume"])
    failed = run(*FILLING, *sets(body__load__LV__pressure_mmHg=19), "--resume", "1.h5", cwd=tmp_path)
    assert failed.status == 2 and "another scene" in failed.err and "pressure_mmHg" in failed.err


def test_filling_that_fails_keeps_the_last_equilibrium(tmp_path):
    outcome = run(*FILLING, *sets(body__load__LV__pressure_mmHg=900, body__materials__ventricles__C_Pa=100,
                                  body__materials__ventricles__bulk_Pa=2000), "-o", "r.h5", cwd=tmp_path, timeout=300)
    assert outcome.status == 1
    assert "of the load" in outcome.err and "volume tag" in outcome.err
    if "last good state" in outcome.err:
        assert column(tmp_path / "r.h5", "provenance/status") == b"incomplete"


def test_activation_killed_and_resumed_is_the_undisturbed_one(tmp_path):
    outcome = run(*ACTIVATION, "-o", "whole.h5", "--json", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert 0.3 < outcome.json()["activation"]["share"] <= 1
    whole = datasets(tmp_path / "whole.h5")
    assert whole["time"] == pytest.approx(np.arange(61) * 1e-3)
    assert {"body/lead_1", "body/lead_2", "body/activation"} <= set(whole)
    assert not any(name.startswith(("cavities", "valves", "circulation")) for name in whole)
    # Killed after the first checkpoint.
    process = subprocess.Popen([*words_for(1, *ACTIVATION, "-o", "r.h5")], cwd=tmp_path, env=ENVIRONMENT)
    wait_for(tmp_path / "r.body.fields" / "frame_000003.vtu", process)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    for ranks, copy in ((1, "one.h5"), (2, "two.h5")):
        (tmp_path / copy).write_bytes((tmp_path / "r.h5").read_bytes())
        shutil.copytree(tmp_path / "r.body.fields", tmp_path / copy.replace(".h5", ".body.fields"))
        resumed = run(*ACTIVATION, "--resume", copy, ranks=ranks, cwd=tmp_path)
        assert resumed.status == 0, resumed.err
        found = datasets(tmp_path / copy)
        assert field_times(tmp_path / copy) == pytest.approx(np.arange(7) * 0.01)
        for name in ("time", "body/activated_share", "body/membrane_potential", "body/calcium", "body/lead_1", "body/activation"):
            if ranks == 1:
                assert np.array_equal(found[name], whole[name]), name
            else:
                assert np.abs(found[name] - whole[name]).max() <= 1e-6 * np.abs(whole[name]).max(), name


def test_activation_is_the_same_on_two_ranks_and_repeats_with_the_period(tmp_path):
    for ranks in (1, 2):
        outcome = run(*ACTIVATION, *sets(heart__period_s=0.3, run__end_ms=320), "-o", f"{ranks}.h5", ranks=ranks, cwd=tmp_path)
        assert outcome.status == 0, outcome.err
    one, two = datasets(tmp_path / "1.h5"), datasets(tmp_path / "2.h5")
    assert one["body/lead_1"] == pytest.approx(two["body/lead_1"], rel=1e-6, abs=1e-6 * np.abs(one["body/lead_1"]).max())
    # The second beat forgets the first: its activated share begins anew.
    share = one["body/activated_share"]
    assert share[300] > 0.9 and share[302] < 0.5


@pytest.mark.parametrize("words, expected", [
    (["--monolithic"], "monolithic"),
    (["--set", "run.beats=3"], "beats"),
    (["--accuracy", "draft"], "--accuracy"),
    (["--set", "run.rows_every_ms=0.7"], "does not divide the period"),
    (["--set", "run.end_ms=10.5"], "not a multiple"),
    (["--set", "body.shape=heart"], "cells.atria"),
    (["--set", "body.mechanics.order=2"], "mechanics"),
    (["--set", "body.stimuli.apex.z_mm=500"], "stimulus"),
    (["--set", "body.electrophysiology.tau_ms=0.5", "--set", "run.rows_every_ms=0.1"], "rows_every_ms"),
])
def test_refused(tmp_path, words, expected):
    outcome = run(*ACTIVATION, *words, "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 2, outcome.err
    assert expected in outcome.err
    assert not (tmp_path / "r.h5").exists()


def test_verbs_know_what_a_body_is(tmp_path):
    checked = run("check", SCENES / "filling_3d.toml")
    assert checked.status == 0 and "body: tissue, mechanics alone" in checked.out
    full = run("check", SCENES / "activation_3d.toml", "--full")
    assert full.status == 0 and "[body.electrophysiology" in full.out
    assert "mechanics" not in full.out and "circulation" not in full.out
    refused = run("trade", "heart", SCENES / "activation_3d.toml", "-o", tmp_path / "t", cwd=tmp_path)
    assert refused.status == 2, refused.err


def test_a_mesh_in_another_unit_is_refused(tmp_path):
    made = run("mesh", "ellipsoid", "--size-mm", 12, "-o", "lv.msh", cwd=tmp_path)
    assert made.status == 0
    (tmp_path / "s.toml").write_text("""
[body]
physics = "mechanics"
mesh = "lv.msh"
mesh_unit = "cm"
[body.load.LV]
pressure_mmHg = 5
""")
    outcome = run("run", "s.toml", cwd=tmp_path)
    assert outcome.status == 2
    assert "no size of a heart" in outcome.err and "unit" in outcome.err


def test_a_stop_on_request_is_kept(tmp_path):
    process = subprocess.Popen([*words_for(2, *ACTIVATION, *sets(run__end_ms=100000, run__checkpoint_every_ms=500), "-o", "r.h5")],
                               cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    time.sleep(6)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "--resume" in err, err
    assert column(tmp_path / "r.h5", "provenance/status") == b"incomplete"


OWN_MESH = """
title = "own mesh"
[cells.ventricles]
ionic = "ttp06-endo"
start = "published"
[body]
physics = "electrophysiology"
cells = "ventricles"
mesh = "mesh.msh"
fields_every_ms = 2
[body.stimuli.apex]
z_mm = -66
start_ms = 0
radius_mm = 30
[run]
end_ms = 20
checkpoint_every_ms = 2
"""


@pytest.fixture(scope="module")
def own_mesh(tmp_path_factory):
    """A scene with its mesh in a file, and the result of a part of it."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "s.toml").write_text(OWN_MESH)
    assert run("mesh", "ellipsoid", "--size-mm", 12, "-o", "mesh.msh", cwd=folder).status == 0
    outcome = run("run", "s.toml", *sets(run__end_ms=6), "-o", "r.h5", "--quiet", cwd=folder)
    assert outcome.status == 0, outcome.err
    return folder


def test_meshes_are_not_overwritten(own_mesh, tmp_path):
    """By results, by fields beside them, by fibres; not through links either."""
    shutil.copytree(own_mesh, tmp_path, dirs_exist_ok=True)
    os.link(tmp_path / "mesh.msh", tmp_path / "hard.h5")
    (tmp_path / "soft.vtu").symlink_to("mesh.msh")
    (tmp_path / "x.body.fields").mkdir()
    shutil.copy(tmp_path / "mesh.msh", tmp_path / "x.body.fields" / "frame_000007.msh")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    inside = ["--set", "body.mesh=x.body.fields/frame_000007.msh"]
    for words in (["run", "s.toml", "-o", "mesh.msh"], ["run", "s.toml", "-o", "hard.h5"], ["run", "s.toml", *inside, "-o", "x.h5"],
                  ["run", "s.toml", "-o", "s.toml"], ["fibres", "mesh.msh", "-o", "soft.vtu"]):
        outcome = run(*words, cwd=tmp_path)
        assert outcome.status == 2 and "name another file" in outcome.err, (words, outcome.err)
        assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}, words


def test_another_mesh_is_another_scene(own_mesh, tmp_path):
    shutil.copytree(own_mesh, tmp_path, dirs_exist_ok=True)
    goes_on = run("run", "s.toml", *sets(run__end_ms=8), "--resume", "r.h5", "-o", "on.h5", "--quiet", cwd=tmp_path)
    assert goes_on.status == 0, goes_on.err
    text = (tmp_path / "mesh.msh").read_text()
    place = text.index("$Nodes") + 40
    digit = re.compile(r"[1-8]").search(text, place).start()
    (tmp_path / "mesh.msh").write_text(text[:digit] + str(int(text[digit]) + 1) + text[digit + 1:])
    outcome = run("run", "s.toml", *sets(run__end_ms=8), "--resume", "r.h5", cwd=tmp_path)
    assert outcome.status == 2 and "another scene" in outcome.err and "content of mesh.msh" in outcome.err


@pytest.mark.parametrize("entry, change, said", [("checkpoint/body", {3: np.nan}, "is nan"), ("checkpoint/body", 50, "ends early"),
                                                 ("checkpoint/run", {0: -1.0}, "negative"), ("checkpoint/run", 2, "ends after"),
                                                 ("time", 3, "are wanted"), ("body/calcium", {0: np.inf}, "is inf")])
@pytest.mark.parametrize("sealed", [True, False])
def test_a_body_without_sense_is_refused(own_mesh, tmp_path, entry, change, said, sealed):
    shutil.copytree(own_mesh, tmp_path, dirs_exist_ok=True)
    with h5py.File(tmp_path / "r.h5", "a") as file:
        old = file[entry][()]
        if isinstance(change, dict):
            for at, value in change.items():
                file[entry][at] = value
        else:
            del file[entry]
            file[entry] = old[:change]
        if sealed:
            reseal(file, entry)
    outcome = run("run", "s.toml", "--resume", "r.h5", "-o", "o.h5", cwd=tmp_path)
    assert outcome.status == 2, outcome.err
    assert "r.h5" in outcome.err and (said if sealed else f"/{entry}") in outcome.err


def test_a_body_killed_at_random_moments(own_mesh, tmp_path):
    shutil.copy(own_mesh / "mesh.msh", tmp_path)
    (tmp_path / "s.toml").write_text(OWN_MESH.replace('"mesh.msh"', f'"{tmp_path / "mesh.msh"}"'))
    assert kill_until(tmp_path / "runs", max(1, KILLS // 4), tmp_path / "s.toml", []) > 0


def test_a_cavity_sucked_inside_out_is_no_result(wiggers, tmp_path):
    outcome = wiggers("run", SCENES / "filling_3d.toml", "--set", "body.size_mm=10", "--set", "body.load.LV.pressure_mmHg=-100",
                      "--quiet", "-o", tmp_path / "b.h5")
    assert outcome.status == 1
    assert "volume" in outcome.err
    assert "LV" in outcome.err
