"""3D tissue from outside: a beat, ranks, restarts within a beat, broken meshes and settings, the tissue's verbs.

Meshes are as coarse as they can be: nothing here says how right the mechanics is (tests/tissue does), but that what
is computed does not depend on how it is run.
"""

import itertools
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import COMMAND, ROOT, SCENES, Outcome
from killing import reseal

sys.path.insert(0, str(ROOT / "heart" / "report"))

import vtu  # noqa: E402

from tissue_runs import (  # noqa: E402
    COARSE, ENVIRONMENT, FROM_FILE, QUICK, SCENE, THREE_D, TIGHT, datasets, frames, run, same_bits, same_but_round_off, sets, words_for)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    path = tmp_path_factory.mktemp("undisturbed") / "r.h5"
    outcome = run("run", SCENE, *COARSE, *TIGHT, "-o", path, "--quiet", "--json")
    assert outcome.status == 0, outcome.err
    return path, outcome


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "lv.msh"
    outcome = run("mesh", "ellipsoid", "--size-mm", 12, "-o", path)
    assert outcome.status == 0, outcome.err
    return path, outcome


class Gmsh:
    """Nodes and elements of a file as words, to be broken."""

    def __init__(self, path):
        self.head, rest = Path(path).read_text().split("$Nodes\n")
        nodes, elements = rest.split("$EndNodes\n$Elements\n")
        self.nodes = [line.split() for line in nodes.splitlines()[1:]]
        elements = [line.split() for line in elements.split("$EndElements")[0].splitlines()[1:]]
        self.triangles = [e for e in elements if e[1] == "2"]
        self.cells = [e for e in elements if e[1] == "4"]

    def write(self, path):
        elements = [[str(k + 1), *e[1:]] for k, e in enumerate(self.triangles + self.cells)]
        Path(path).write_text("".join((self.head, f"$Nodes\n{len(self.nodes)}\n", *(" ".join(n) + "\n" for n in self.nodes),
                                       f"$EndNodes\n$Elements\n{len(elements)}\n", *(" ".join(e) + "\n" for e in elements),
                                       "$EndElements\n")))

    def points(self):
        return np.array([[float(x) for x in node[1:]] for node in self.nodes])


# --- a beat ---------------------------------------------------------------------------------------------------------


def test_a_whole_beat_ejects_and_is_audited(tmp_path, mesh):
    outcome = run("run", SCENE, *COARSE, *sets(heart__period_s=0.8), "-o", "r.h5", "--json", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    summary = outcome.json()
    assert summary["title"] == "3D left ventricle in the closed loop"
    assert summary["audits"]["volume_mismatch_mL"] <= 1e-4
    assert summary["audits"]["blood_volume_drift_mL"] < 1e-8
    assert 20 < summary["indexes"]["LV"]["SV_mL"] < 120
    assert summary["indexes"]["valves"]["AV"]["forward_volume_mL"] > 10  # it contracts
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["provenance/status"][()] == b"complete"
        for name, unit in (("cavities/LV/volume", b"mL"), ("cavities/LV/pressure", b"mmHg"), ("cells/LV/calcium", b"uM"),
                           ("cells/LV/active_tension", b"kPa"), ("cells/LV/membrane_potential", b"mV"), ("cells/LV/stretch", b"1")):
            assert len(file[name]) == 401 and file[name].attrs["unit"] == unit
            assert np.isfinite(file[name][()]).all()
        assert file["cells/LV/membrane_potential"][()].max() > 0
        assert 0 < file["cells/LV/smallest_volume_ratio"][()].min() <= file["cells/LV/smallest_volume_ratio"][()].max() < 1.5
        figures = file["solver/walls/LV"]
        assert {"tetrahedra", "ranks", "potential_nodes", "displacement_unknowns", "steps", "electrophysiology",
                "mechanics_assembly", "mechanics_solve", "active_force", "solver_iterations"} <= set(figures)
        for name, item in figures.items():
            assert item.attrs["unit"] and item.attrs["meaning"], name
            assert np.isfinite(item[()]), name
        assert figures["ranks"][()] == 1 and figures["steps"][()] == 400
        # Counts repeat, times do not: lost efficiency fails here. A count that falls by a lot is written down anew.
        for name, recorded in (("tangents", 844), ("residuals", 850), ("solves", 1244), ("solver_iterations", 17824),
                               ("electrophysiology_iterations", 18893)):
            assert 0.875 * recorded <= figures[name][()] <= 1.04 * recorded, name
        assert figures["direct_solves"][()] == figures["rejected_steps"][()] == 0
        volumes, when = file["cavities/LV/volume"][()], file["time"][()]
    times, files = frames(tmp_path / "r.h5")
    assert times == pytest.approx(np.arange(81) * 0.01, abs=1e-9)
    assert [f.name for f in files[:2]] == ["frame_000000.vtu", "frame_000001.vtu"]

    # The audit's volumes are the circulation's and the wall's; here is that of the deformed surface itself. The mesh of
    # the scene is that of the verb; fields are written in single precision.
    gmsh = Gmsh(mesh[0])
    inner = np.array([[int(n) - 1 for n in e[-3:]] for e in gmsh.triangles if e[3] == "24"])
    for k in (0, 16, 40, 80):
        frame = vtu.Frame(files[k])
        assert np.allclose(frame.points, 1e-3 * gmsh.points(), atol=1e-12)
        assert set(frame.fields) >= {"displacement_m", "potential_mV", "activation_s", "calcium_uM", "active_tension_Pa", "fibre_stretch"}
        x = frame.points + frame.fields["displacement_m"]
        a, b, c = (x[inner[:, k]] for k in range(3))
        enclosed = abs(np.einsum("ij,ij->", a, np.cross(b, c)) / 6) * 1e6
        assert enclosed == pytest.approx(np.interp(times[k], when, volumes), abs=1e-4), times[k]
    activation = frame.fields["activation_s"]
    assert activation.max() > 0.16


def test_nothing_is_written_without_o(tmp_path):
    outcome = run("run", SCENE, *COARSE, *sets(heart__period_s=0.2, walls__LV__stimuli__apex__start_ms=100), cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert "nothing was written" in outcome.out and list(tmp_path.iterdir()) == []


# --- ranks and restarts ---------------------------------------------------------------------------------------------


def test_two_ranks_compute_what_one_does(tmp_path, undisturbed):
    outcome = run("run", SCENE, *COARSE, *TIGHT, "-o", tmp_path / "r.h5", "--quiet", "--json", ranks=2)
    assert outcome.status == 0, outcome.err
    assert outcome.json()["audits"]["volume_mismatch_mL"] <= 1e-4
    same_but_round_off(tmp_path / "r.h5", undisturbed[0])
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["solver/walls/LV/ranks"][()] == 2
    one, two = frames(undisturbed[0]), frames(tmp_path / "r.h5")
    assert one[0] == two[0]
    for a, b in zip(one[1][::10], two[1][::10]):  # fields come in the file's order of points, whatever the partition
        first, second = vtu.Frame(a).fields, vtu.Frame(b).fields
        for name in first:
            assert np.abs(first[name] - second[name]).max() <= 1e-6 * np.abs(first[name]).max() + 1e-12, (a, name)


def struck(tmp_path, how, ranks, settings, beyond_s=0.1):
    """A run that was ended on its way; its result file."""
    result = tmp_path / "r.h5"
    process = subprocess.Popen(words_for(ranks, "run", SCENE, *settings, "-o", result, "--quiet"), stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True, env=ENVIRONMENT, start_new_session=True)
    deadline = time.time() + 200
    try:
        while time.time() < deadline and process.poll() is None:
            try:
                with h5py.File(result) as file:
                    if file["checkpoint/beat_under_way"][0] * 0.002 >= beyond_s:
                        break
            except (OSError, KeyError):
                pass
            time.sleep(0.01)
        assert process.poll() is None, "the run ended before it could be stopped: " + process.communicate()[1]
        if how == signal.SIGKILL:
            os.killpg(process.pid, how)  # the ranks, too
            assert process.wait(60) == -signal.SIGKILL
        else:
            process.send_signal(how)
            out, error = process.communicate(timeout=60)
            assert process.returncode == 1, (process.returncode, error)
            assert "stopped on request after" in error and f"--resume {result}" in error
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    with h5py.File(result) as file:
        assert file["provenance/status"][()] == b"incomplete"
        assert file["checkpoint/beat_under_way"][0] * 0.002 >= beyond_s
    return result


# From ranks to ranks.
@pytest.mark.parametrize("how, before, after", [(signal.SIGKILL, 1, 1), (signal.SIGINT, 1, 1), (signal.SIGTERM, 1, 2), (signal.SIGKILL, 2, 1),
                                                (signal.SIGINT, 2, 2)],
                         ids=["kill", "interrupt", "terminate-1-to-2", "kill-2-to-1", "interrupt-2-to-2"])
def test_stopped_and_resumed(tmp_path, undisturbed, how, before, after):
    result = struck(tmp_path, how, before, [*COARSE, *TIGHT])
    outcome = run("run", SCENE, *COARSE, *TIGHT, "--resume", result, "--quiet", "--json", ranks=after)
    assert outcome.status == 0, outcome.err
    # An interrupted run stops between two checkpoints: it goes on without the warm starts, and repeats the other one
    # only as well as its solvers are converged.
    if before == after == 1 and how == signal.SIGKILL:
        same_bits(result, undisturbed[0])
    else:
        same_but_round_off(result, undisturbed[0])
    assert outcome.json()["audits"]["blood_volume_drift_mL"] < 1e-8
    times, files = frames(result)
    assert times == frames(undisturbed[0])[0] and times == sorted(set(times))
    for a, b in zip(files, frames(undisturbed[0])[1]):
        first, second = vtu.Frame(a).fields, vtu.Frame(b).fields
        for name in first:
            assert np.abs(first[name] - second[name]).max() <= 1e-6 * np.abs(second[name]).max() + 1e-12, (a, name)
    for leftover in tmp_path.iterdir():
        assert leftover.name in ("r.h5", "r.LV.fields") or leftover.name.endswith(".partial")


@pytest.mark.parametrize("solver", ["gmres-ilu", "gmres-gamg", "direct"])
def test_default_tolerances_bear_a_kill_bit_for_bit_and_several_beats(tmp_path, solver):
    """Two kills, the second in the second beat; the resumed run is the undisturbed one, whatever factors it kept."""
    settings = [*COARSE, *sets(walls__LV__mechanics__solver=solver, heart__period_s=0.2, walls__LV__stimuli__apex__start_ms=20, walls__LV__stimuli__septum__start_ms=20,
                               walls__LV__stimuli__free_wall__start_ms=20, run__beats=2)]
    whole = tmp_path / "whole.h5"
    assert run("run", SCENE, *settings, "-o", whole, "--quiet").status == 0
    result = struck(tmp_path, signal.SIGKILL, 1, settings, beyond_s=0.06)
    process = subprocess.Popen(words_for(1, "run", SCENE, *settings, "--resume", result, "--quiet"), env=ENVIRONMENT,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        with h5py.File(result) as file:
            if file["checkpoint/run"][0] >= 1:
                break
        time.sleep(0.005)
    assert process.poll() is None
    process.kill()
    process.wait()
    outcome = run("run", SCENE, *settings, "--resume", result, "--quiet", "--json")
    assert outcome.status == 0, outcome.err
    assert outcome.json()["cost"]["beats"] == 2
    same_bits(result, whole)
    assert frames(result)[0] == frames(whole)[0]
    for a, b in zip(frames(result)[1], frames(whole)[1]):
        assert a.read_bytes() == b.read_bytes()


def test_a_finished_run_goes_on_and_elsewhere(tmp_path):
    """From one beat to two, in the same file and in another; frames at the seam are not doubled."""
    settings = [*COARSE, *sets(heart__period_s=0.2, walls__LV__stimuli__apex__start_ms=20, walls__LV__stimuli__septum__start_ms=20,
                               walls__LV__stimuli__free_wall__start_ms=20)]
    assert run("run", SCENE, *settings, "-o", "r.h5", cwd=tmp_path).status == 0
    more = [*settings, *sets(run__beats=2)]
    outcome = run("run", SCENE, *more, "--resume", "r.h5", "-o", "s.h5", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert frames(tmp_path / "r.h5")[0] == pytest.approx(np.arange(21) * 0.01, abs=1e-9)
    assert frames(tmp_path / "s.h5")[0] == pytest.approx(np.arange(20, 41) * 0.01, abs=1e-9)
    outcome = run("run", SCENE, *more, "--resume", "r.h5", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert frames(tmp_path / "r.h5")[0] == pytest.approx(np.arange(41) * 0.01, abs=1e-9)
    same_bits(tmp_path / "r.h5", tmp_path / "s.h5")


def test_a_beat_under_way_of_other_blood_is_not_resumed(tmp_path):
    """The blood that the beat began with, and V_LA where it began: each is looked at by itself."""
    result = struck(tmp_path, signal.SIGINT, 1, [*COARSE, *TIGHT], beyond_s=0.02)
    entry = "checkpoint/beat_under_way"
    with h5py.File(result) as file:
        as_it_was = file[entry][()]
    for number in (1, 11):
        with h5py.File(result, "a") as file:
            file[entry][...] = as_it_was
            file[entry][number] += 5.0  # mL
            reseal(file, entry)
        outcome = run("run", SCENE, *COARSE, *TIGHT, "--resume", result)
        assert outcome.status == 2, (number, outcome.out)
        assert f"/{entry}" in outcome.err and "mL of blood" in outcome.err, (number, outcome.err)


def test_another_scene_is_not_resumed(tmp_path, undisturbed):
    result = tmp_path / "r.h5"
    shutil.copy(undisturbed[0], result)
    before = result.read_bytes()
    outcome = run("run", SCENE, *COARSE, *TIGHT, *sets(walls__LV__size_mm=13), "--resume", result)
    assert outcome.status == 2 and "another scene" in outcome.err and "size_mm = 13" in outcome.err
    assert result.read_bytes() == before and list(tmp_path.iterdir()) == [result]


# --- refusals -------------------------------------------------------------------------------------------------------

REFUSED = [
    (sets(walls__LV__materials__ventricls__C_Pa=880), "did you mean 'ventricles'"),
    (sets(walls__LV__supports__epicard__fixed="true"), "did you mean 'epicardium'"),
    (sets(walls__LV__stimuli__apex__radius=3), "did you mean 'radius_mm'"),
    (sets(walls__LV__size_mm=0.1), "size_mm = 0.1 mm is outside its range 0.3 to 20 mm"),
    (sets(walls__LV__shape="elipsoid"), "did you mean 'ellipsoid'"),
    (sets(walls__LV__shape="heart"), "has 4 cavities, this wall encloses 1"),
    (sets(walls__LV__fibres__rule="streeter"), "bayer, doste, file"),
    (sets(walls__LV__fibres__rule="file"), "the mesh brings 0 fibre directions"),
    (sets(walls__LV__stimuli__apex__x_mm=500), "the stimulus at (500.00, 0.00, -66.00) mm touches no node"),
    (sets(walls__LV__stimuli__apex__start_ms=900), "does not end within the period of 0.4 s"),
    (sets(walls__LV__electrophysiology__tau_ms=3), "tau_ms = 3 ms"),
    (sets(solver__dt_s=0.0003, walls__LV__electrophysiology__tau_ms=0.5), "does not divide the period"),
    (sets(solver__dt_s=0.0002, walls__LV__electrophysiology__tau_ms=0.5), "longer than solver.dt_s"),
    (sets(solver__dt_s=0.003), "solver.dt_s = 0.003 s does not divide the period, 0.4 s"),
    (sets(run__checkpoint_every_ms=0), "checkpoint_every_ms = 0"),
    (sets(cells__ventricles__ionic="transient"), "walls.LV"),
    (["-o", "no/such/r.h5"], "there is no folder 'no/such'"),
    (["-o", "/proc/r.h5"], "cannot be written"),
    (["--resume", "missing.h5"], "missing.h5"),
    (["--monolithic"], "tissue"),
]


@pytest.mark.parametrize("words, expected", REFUSED, ids=[" ".join(words)[-50:] for words, _ in REFUSED])
def test_refused(tmp_path, words, expected):
    output = [] if words[0] in ("-o", "--resume", "--monolithic") else ["-o", "r.h5"]
    outcome = run("run", SCENE, *COARSE, *words, *output, cwd=tmp_path)
    assert outcome.status == 2, (outcome.status, outcome.out, outcome.err)
    assert expected in outcome.err, outcome.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words, expected", [(sets(walls__LV__fibres__rule="file"), "the mesh brings 0 fibre directions"),
                                             (sets(walls__LV__stimuli__apex__x_mm=500), "touches no node"),
                                             (sets(walls__LV__size="4"), "unknown key")], ids=["fibres", "stimulus", "key"])
def test_refusals_on_two_ranks_are_said_once(tmp_path, words, expected):
    outcome = run("run", SCENE, *COARSE, *words, "-o", "r.h5", cwd=tmp_path, ranks=2)
    assert outcome.status == 2
    assert outcome.err.count("wiggers:") == 1 and expected in outcome.err, outcome.err
    assert list(tmp_path.iterdir()) == []


def break_open(m):
    inner = [e for e in m.triangles if e[3] == "24"]
    m.triangles = [e for e in m.triangles if e not in inner[:3]]


def break_no_cavity(m):
    m.triangles = [e for e in m.triangles if e[3] != "24"]


def break_duplicate(m):
    m.cells.append(m.cells[7])


def break_tag(m):
    m.cells = [[*e[:3], "4", *e[4:]] if e[3] == "9" else e for e in m.cells]


def break_atrial(m):
    m.cells = [[*e[:3], "2", *e[4:]] if e[3] == "9" else e for e in m.cells]


def break_passive(m):
    m.cells = [[*e[:3], "9", *e[4:]] for e in m.cells]


def break_surface_only(m):
    m.cells = []


def break_nan(m):
    m.nodes[3][1] = "nan"


def break_corner(m):
    m.cells[5][-1] = "99999"


def break_flat(m):
    m.cells[5][-1] = m.cells[5][-2]


def break_stated_unit(m):
    m.nodes = [[n[0], *(repr(1000 * float(x)) for x in n[1:])] for n in m.nodes]


BROKEN = [
    (break_open, "surface 24 (endocardium-LV) is not closed"),
    (break_no_cavity, "no triangle has the surface tag 24 (endocardium-LV)"),
    (break_duplicate, "cells 7 and 1003"),
    (break_tag, "volume tag 4, which means nothing"),
    (break_atrial, "must be insulated from each other"),
    (break_passive, "the mesh has no tissue for cells ventricles"),
    (break_surface_only, "no tetrahedra"),
    (break_nan, "'nan' is no finite number"),
    (break_corner, "99999"),
    (break_flat, "uses a point twice"),
    (break_stated_unit, "no size of a heart. Remedy: give the unit"),
]


@pytest.mark.parametrize("breaking, expected", BROKEN, ids=[breaking.__name__ for breaking, _ in BROKEN])
def test_broken_meshes_are_refused(tmp_path, mesh, breaking, expected):
    gmsh = Gmsh(mesh[0])
    breaking(gmsh)
    gmsh.write(tmp_path / "lv.msh")
    (tmp_path / "s.toml").write_text(FROM_FILE)
    before = sorted(p.name for p in tmp_path.iterdir())
    outcome = run("run", "s.toml", *QUICK, "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 2, (outcome.status, outcome.out, outcome.err)
    assert expected in outcome.err, outcome.err
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    check = run("mesh", "check", "lv.msh", cwd=tmp_path)
    if breaking in (break_no_cavity, break_passive):  # a scene asks for more than a mesh
        assert check.status == 0
    else:
        assert check.status == 2 and expected in check.out + check.err


def test_missing_torn_and_foreign_mesh_files(tmp_path, mesh):
    (tmp_path / "s.toml").write_text(FROM_FILE)
    outcome = run("run", "s.toml", *QUICK, "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 2 and 'walls.LV.mesh = "lv.msh": there is no such file' in outcome.err
    text = mesh[0].read_text()
    (tmp_path / "lv.msh").write_text(text[: len(text) // 2])
    outcome = run("run", "s.toml", *QUICK, "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 2 and "is it whole?" in outcome.err and "line " in outcome.err
    (tmp_path / "lv.stl").write_text("solid\n")
    outcome = run("run", "s.toml", *QUICK, *sets(walls__LV__mesh="lv.stl"), "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 2 and "unknown kind of mesh file '.stl'" in outcome.err
    (tmp_path / "lv.msh").write_text("")
    outcome = run("run", "s.toml", *QUICK, "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 2 and "lv.msh" in outcome.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["lv.msh", "lv.stl", "s.toml"]


def test_what_a_reader_mends_or_assumes_is_said(tmp_path, mesh):
    """Left-handed cells and a file without unit, in um; then the same beat as from the sound file."""
    short = [*QUICK, *sets(heart__period_s=0.2, walls__LV__stimuli__apex__start_ms=20)]
    (tmp_path / "s.toml").write_text(FROM_FILE)
    shutil.copy(mesh[0], tmp_path / "lv.msh")
    outcome = run("run", "s.toml", *short, "-o", "sound.h5", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    notes = [line for line in outcome.out.splitlines() if line.startswith("note:")]
    assert len(notes) == 1 and "reach through the wall with one edge" in notes[0]  # so coarse a mesh deserves it
    gmsh = Gmsh(mesh[0])
    gmsh.cells = [[*e[:-2], e[-1], e[-2]] if k % 5 == 0 else e for k, e in enumerate(gmsh.cells)]
    gmsh.head = gmsh.head.replace("; unit: mm", "")
    break_stated_unit(gmsh)
    gmsh.write(tmp_path / "lv.msh")
    outcome = run("run", "s.toml", *short, "-o", "mended.h5", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert "note: lv.msh: 201 of 1003 cells were left-handed and are turned" in outcome.out
    assert "note: lv.msh: lengths taken as um: the mesh measures 69.96 x 69.38 x 95.5 mm" in outcome.out
    same_but_round_off(tmp_path / "mended.h5", tmp_path / "sound.h5", 1e-4)


def test_more_ranks_than_tetrahedra(tmp_path):
    """A tetrahedral shell of twelve."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    lines, n = [], 0
    for side, (a, b, c) in enumerate(itertools.combinations(range(1, 5), 3)):
        for tag, face in ((24, (a, b, c)), (31, (a + 4, b + 4, c + 4))):
            lines.append(f"{(n := n + 1)} 2 2 {tag} {tag} {face[0]} {face[1]} {face[2]}\n")
        for cell in ((a, b, c, c + 4), (a, b, b + 4, c + 4), (a, a + 4, b + 4, c + 4)):
            tag = 9 if side == 0 else 1
            lines.append(f"{(n := n + 1)} 4 2 {tag} {tag} {cell[0]} {cell[1]} {cell[2]} {cell[3]}\n")
    points = [*(25 * corners), *(60 * corners)]
    (tmp_path / "lv.msh").write_text("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n8\n" +
                                     "".join(f"{k + 1} {p[0]} {p[1]} {p[2]}\n" for k, p in enumerate(points)) +
                                     f"$EndNodes\n$Elements\n{n}\n" + "".join(lines) + "$EndElements\n")
    (tmp_path / "s.toml").write_text(FROM_FILE)
    outcome = run("run", "s.toml", *QUICK, *sets(walls__LV__stimuli__apex__radius_mm=90), "-o", "r.h5", ranks=13, cwd=tmp_path)
    assert outcome.status == 2 and "13 MPI ranks for a mesh of 12 tetrahedra: use at most 12" in outcome.err, outcome.err
    assert not (tmp_path / "r.h5").exists()


def test_the_light_wiggers_alone_refuses_tissue(tmp_path):
    shutil.copy(COMMAND, tmp_path / "wiggers")
    for words in (["run", SCENE, "-o", "r.h5"], ["check", SCENE], ["mesh", "check", "lv.msh"], ["fibres", "lv.msh"], ["benchmark", "slab"]):
        process = subprocess.run([tmp_path / "wiggers", *words], cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert process.returncode == 2, words
        assert "no 3D tissue" in process.stderr and 'kind = "reduced"' in process.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["wiggers"]


def test_a_device_that_takes_nothing(tmp_path):
    outcome = run("run", SCENE, *COARSE, "-o", "/dev/full", cwd=tmp_path)
    assert outcome.status == 1 and "cannot write '/dev/full'" in outcome.err
    assert list(tmp_path.iterdir()) == [] and list(Path("/dev").glob("full?*")) == []


def test_a_file_in_the_way_of_the_fields(tmp_path):
    (tmp_path / "r.LV.fields").write_text("mine")
    outcome = run("run", SCENE, *COARSE, "-o", "r.h5", cwd=tmp_path)
    assert outcome.status == 1 and "cannot make the folder 'r.LV.fields'" in outcome.err
    assert [p.name for p in tmp_path.iterdir()] == ["r.LV.fields"]
    assert (tmp_path / "r.LV.fields").read_text() == "mine"


@pytest.mark.parametrize("fields_every_ms, named", [(0, "r.h5"), (10, "frame_0000")], ids=["result", "fields"])
def test_a_disk_that_fills_up_keeps_the_last_checkpoint(tmp_path, fields_every_ms, named):
    """A limit on file size, set on the way, stands for a full disk."""
    result, settings = tmp_path / "r.h5", [*COARSE, *sets(walls__LV__fields_every_ms=fields_every_ms)]
    process = subprocess.Popen(words_for(1, "run", SCENE, *settings, "-o", result, "--quiet"), stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    while not result.exists() and process.poll() is None:
        time.sleep(0.01)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (2**14, 2**14))
    error = process.communicate(timeout=120)[1]
    assert process.returncode == 1, (process.returncode, error)
    assert "cannot write" in error and named in error, error
    with h5py.File(result) as file:
        assert file["provenance/status"][()] == b"incomplete"
    assert {p.name for p in tmp_path.iterdir()} == ({"r.h5", "r.LV.fields"} if fields_every_ms else {"r.h5"})
    outcome = run("run", SCENE, *settings, "--resume", result, "--quiet")
    assert outcome.status == 0, outcome.err
    if fields_every_ms:
        assert frames(result)[0] == pytest.approx(np.arange(41) * 0.01, abs=1e-9)


def test_a_run_that_breaks_down_says_where_and_keeps_what_was_saved(tmp_path):
    """A stimulus that no membrane bears."""
    outcome = run("run", SCENE, *COARSE, *sets(walls__LV__stimuli__apex__amplitude_V_per_s=10000), "-o", "r.h5", "--json",
                  cwd=tmp_path)
    assert outcome.status == 1, (outcome.status, outcome.err)
    assert "the computation failed: at 0.16" in outcome.err and "left its physical range" in outcome.err
    assert "last good state is in r.h5" in outcome.err
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["provenance/status"][()] == b"incomplete"
        assert file["checkpoint/beat_under_way"][0] * 0.002 >= 0.1


def test_python_studies_refuse_tissue():
    wiggers = pytest.importorskip("wiggers")
    with pytest.raises(wiggers.InputError, match="3D tissue"):
        wiggers.Heart(SCENE)


# --- verbs ----------------------------------------------------------------------------------------------------------


def test_mesh_and_check_print_the_same_sound_figures(tmp_path, mesh):
    path, made = mesh
    assert f"wrote {path}" in made.out
    check = run("mesh", "check", path)
    assert check.status == 0 and check.out.endswith("the mesh can be used\n")
    assert made.out.splitlines()[0] == check.out.splitlines()[0]
    assert "338 points, 1003 tetrahedra, 668 tagged triangles; 70.0 x 69.4 x 95.5 mm" in check.out
    cavity = float(re.search(r"endocardium-LV\).*closed, cavity ([\d.]+) mL", check.out)[1])
    gmsh = Gmsh(path)
    x = gmsh.points()
    a, b, c = (x[[int(e[-3 + k]) - 1 for e in gmsh.triangles if e[3] == "24"]] for k in range(3))
    assert cavity == pytest.approx(abs(np.einsum("ij,ij->", a, np.cross(b, c))) / 6e3, abs=1e-3)
    p = [x[[int(e[-4 + k]) - 1 for e in gmsh.cells if e[3] == "1"]] for k in range(4)]
    muscle = np.einsum("ij,ij->i", p[3] - p[0], np.cross(p[1] - p[0], p[2] - p[0]))
    assert (muscle > 0).all()
    volume = float(re.search(r"ventricles\) +\d+ cells +([\d.]+) mL", check.out)[1])
    assert volume == pytest.approx(muscle.sum() / 6e3, abs=1e-3)


def test_fibres_are_written_and_can_be_read_back(tmp_path, mesh):
    outcome = run("fibres", mesh[0], "-o", "f.vtu", cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert "309 of 338 vertices carry a frame" in outcome.out and "written: f.vtu" in outcome.out
    endo, epi = re.search(r"left ventricle +(\S+) +\S+ +(\S+)", outcome.out).groups()
    assert float(endo) == pytest.approx(60, abs=2) and float(epi) == pytest.approx(-60, abs=2)
    data = vtu.Frame(tmp_path / "f.vtu").fields
    carry = np.linalg.norm(data["fibre"], axis=1) > 0
    for name in ("fibre", "sheet", "sheet_normal"):
        assert np.abs(np.linalg.norm(data[name][carry], axis=1) - 1).max() < 1e-6
    assert np.abs(np.einsum("ij,ij->i", data["fibre"], data["sheet"])[carry]).max() < 1e-6
    assert data["transmural"].min() >= -1e-6 and data["transmural"].max() <= 1 + 1e-6


VERBS = [
    (["mesh", "ellipsoid", "--size-mm", 100, "-o", "x.msh"], "size-mm = 100 mm is outside its range"),
    (["mesh", "ellipsoid", "-o", "no/such/x.msh"], "there is no folder 'no/such'"),
    (["mesh", "ellipsoid"], "--output"),
    (["mesh", "check", "missing.msh"], "missing.msh: no such mesh file"),
    (["mesh", "check", "{mesh}", "--unit", "inch"], "unknown unit of length 'inch'"),
    (["fibres", "missing.msh", "-o", "f.vtu"], "missing.msh: no such mesh file"),
    (["fibres", "{mesh}", "-o", "f.vtk"], "must end in .vtu"),
    (["fibres", "{mesh}", "-o", "f.vtu", "--rule", "dost"], "did you mean 'doste'"),
    (["fibres", "{mesh}", "-o", "f.vtu", "--rule", "file"], "the mesh brings 0 fibre directions"),
    (["benchmark", "slab", "--dx-mm", 9], "--dx-mm"),
    (["benchmark", "slab", "--end-ms", -5], "--end-ms"),
    (["benchmark", "beam", "--bricks", 0, 1, 1], "at least 1 needed"),
    (["benchmark", "beam", "--bulk-kPa", -1], "--bulk-kPa"),
    (["benchmark", "sphere", "--size-mm", -1], "size-mm = -1 mm"),
    (["benchmark"], "subcommand"),
]


@pytest.mark.parametrize("words, expected", VERBS, ids=[" ".join(map(str, words))[-40:] for words, _ in VERBS])
def test_verbs_refuse(tmp_path, mesh, words, expected):
    outcome = run(*(str(w).format(mesh=mesh[0]) for w in words), cwd=tmp_path)
    assert outcome.status == 2 and expected in outcome.err, (outcome.status, outcome.err)
    assert list(tmp_path.iterdir()) == []


def test_benchmark_slab_prints_the_probes(tmp_path):
    outcome = run("benchmark", "slab", "--dx-mm", 1.5, "--dt-ms", 0.1, "--end-ms", 30, cwd=tmp_path)
    assert outcome.status == 0, outcome.err
    assert "slab: P2, dx 1.5 mm, dt 0.1 ms, 780 tetrahedra, 1485 nodes" in outcome.out
    rows = re.findall(r"^ +P(\d) +\(.*\) +(\S+) +(\S+) \+- \S+ +(\S+)$", outcome.out, re.M)
    assert [int(row[0]) for row in rows] == list(range(1, 10))
    assert 0.5 < float(rows[0][1]) < 2 and float(rows[0][2]) == 1.04
    assert rows[7][1] == "never" and rows[7][3] == "-"  # the farthest corner, on a mesh far too coarse
    assert list(tmp_path.iterdir()) == []


def test_benchmark_beam_on_one_and_two_ranks(tmp_path):
    tips = []
    for ranks in (1, 2):
        outcome = run("benchmark", "beam", "--bricks", 8, 1, 1, ranks=ranks, cwd=tmp_path)
        assert outcome.status == 0, outcome.err
        assert "8 x 1 x 1 bricks" in outcome.out and "48 tetrahedra" in outcome.out
        tips.append([float(x) for x in re.search(r"-> x (\S+), z (\S+) mm", outcome.out).groups()])
        assert re.search(r"^\d+ load steps, 0 failed, \d+ Newton iterations, smallest J 0\.9\d+", outcome.out, re.M)
    assert tips[0] == tips[1]
    assert 2.9 < tips[0][1] < 4.2  # stiffer than the incompressible one, 4.17 mm, as coarse as it is


def test_linear_tetrahedra_that_lock_are_told_at_the_start(wiggers, tmp_path):
    scene = tmp_path / "s.toml"

    def loaded(order, bulk):
        scene.write_text(f"""
title = "locking"
[body]
physics = "mechanics"
shape = "ellipsoid"
size_mm = 8
[body.mechanics]
order = {order}
[body.materials.ventricles]
law = "guccione"
C_Pa = 2000
bulk_Pa = {bulk}
[body.load.LV]
pressure_mmHg = 0.5
[body.reference]
recover = false
""")
        return wiggers("run", scene)

    locked = loaded(1, 1e7)
    assert "warning: body: linear tetrahedra lock in ventricles" in locked.out
    assert "mechanics.order = 2" in locked.out
    assert "tetrahedra lock" not in loaded(1, 5e4).out


def test_a_linked_folder_of_fields_and_frames_of_others_are_left_alone(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "frame_000000.vtu").write_text("somebody's")
    (tmp_path / "r.LV.fields").symlink_to(elsewhere)
    outcome = run("run", SCENE, *COARSE, "-o", tmp_path / "r.h5", "--quiet")
    assert outcome.status == 2 and "is a link" in outcome.err
    (tmp_path / "r.LV.fields").unlink()
    elsewhere.rename(tmp_path / "r.LV.fields")
    outcome = run("run", SCENE, *COARSE, "-o", tmp_path / "r.h5", "--quiet")
    assert outcome.status == 2 and "no folder of a run" in outcome.err
    assert [p.read_text() for p in (tmp_path / "r.LV.fields").iterdir()] == ["somebody's"]
