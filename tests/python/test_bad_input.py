"""Bad input is refused with status 2, in words, before any work and without a file."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import COMMAND, DATA, SCENES

CASES = [
    # words, what the message must contain
    (["rum"], "did you mean 'run'"),
    (["run"], "scene"),
    (["run", "missing.toml"], "missing.toml"),
    (["run", "."], "folder"),
    (["run", SCENES / "whole_heart.toml", "--set", "walls.LV.activation=3"], "activation_ms"),
    (["run", SCENES / "whole_heart.toml", "--set", "walls.LV.kind=tissue"], "tissue"),
    (["run", SCENES / "whole_heart.toml", "--set", "nonsense"], "key=value"),
    (["run", SCENES / "whole_heart.toml", "--set", "walls.LV.wall_volume_mL=0"], "wall_volume_mL = 0"),
    (["run", SCENES / "whole_heart.toml", "--set", "circulation.circuit.SYS.C_AR=-1.5"], "C_AR = -1.5"),
    (["run", SCENES / "whole_heart.toml", "--set", "heart.period_s=0.05", "--set", "cells.atria.stimulus_ms=19"], "period"),
    (["run", SCENES / "whole_heart.toml", "--set", "cells.atria.force_changes.Kd0=1e-4"], "Kd0"),
    (["run", SCENES / "elastance_healthy.toml", "--set", "walls.LV.TC=0.7"], "TC + TR"),
    (["run", SCENES / "elastance_healthy.toml", "-o", "no/such/folder/r.h5"], "no/such/folder"),
    (["run", SCENES / "elastance_healthy.toml", "--resume", "missing.h5"], "missing.h5"),
    (["check", SCENES / "elastance_healthy.toml", "--ful"], "--ful"),
    (["cell", "crm", "--beats", "1"], "did you mean 'crn'"),
    (["cell", "crn"], "--beats N or --until limit-cycle"),
    (["cell", "crn", "--beats", "0"], "--beats"),
    (["cell", "crn", "--beats", "three"], "three"),
    (["cell", "crn", "--beats", "1", "--until", "limit-cycle"], "not both"),
    (["cell", "crn", "--until", "limitcycle"], "limit-cycle"),
    (["cell", "crn", "--beats", "1", "--set", "g_na=3"], "did you mean 'g_Na'"),
    (["cell", "crn", "--beats", "1", "--set", "g_Na=-3"], "g_Na = -3"),
    (["cell", "crn", "--beats", "1", "--set", "g_Na=lots"], "not a number"),
    (["cell", "crn", "--beats", "1", "--parameters", "human37"], "parameter set of crn"),
    (["cell", "crn", "--beats", "1", "--integrator", "rk4"], "integrator"),
    (["cell", "crn", "--beats", "1", "--period-ms", "1.5"], "not longer than the stimulus"),
    (["cell", "crn", "--beats", "1", "--rtol", "-1"], "rtol"),
    (["cell", "crn", "--beats", "1", "--integrator", "rush-larsen", "--dt-ms", "0"], "dt"),
    (["cell", "crn", "--beats", "1", "-o", "no/such/a.csv"], "no/such"),
    (["cell", "crn", "--until", "limit-cycle", "--parameters", "stimulus-uncarried"], "no limit cycle"),
    (["cell", "rdq20", "--beats", "1"], "wiggers force"),
    (["cell", "crn", "--rhs", "missing.csv", "-o", "x.csv"], "missing.csv"),
    (["cell", "crn", "--rhs", DATA / "cell" / "ttp06_endo_rhs.csv", "-o", "x.csv"], "unknown column"),
    (["force", "--calcium", "0.3", "--sarcomere-length", "2.9", "--steady"], "below 2.817"),
    (["force", "--calcium", "0.3", "--sarcomere-length", "2.2"], "--duration-s"),
    (["force", "--calcium", "-1", "--sarcomere-length", "2.2", "--steady"], "Ca = -1"),
    (["force", "--calcium", "no.csv", "--sarcomere-length", "2.2", "--steady"], "no.csv"),
    (["loop", "missing.toml", "--beats", "1"], "missing.toml"),
    (["loop", SCENES / "whole_heart.toml", "--beats", "1"], "unknown key"),
    (["run", SCENES / "whole_heart.toml", "--set", "run.beat=5"], "did you mean 'beats'"),
    (["loop", SCENES / "whole_heart.toml", "--beats", "1", "--rtol", "nan"], "--rtol"),
    (["cell", "crn", "--beats", "1", "--period-ms", "1e9"], "--period-ms"),
    (["cell", "crn", "--beats", "1", "--period-ms", "nan"], "--period-ms"),
    (["cell", "crn", "--until", "limit-cycle", "--max-beats", "-5"], "--max-beats"),
    (["cell", "crn", "--until", "limit-cycle", "--distance", "nan"], "--distance"),
    (["cell", "crn", "--beats", "1", "-o", "a" * 300], "cannot be written"),
    (["cell", "crn", "--beats", "1", "-o", "/proc/x.csv"], "cannot be written"),
    (["force", "--calcium", "0.3", "--sarcomere-length", "2", "--duration-s", "inf"], "--duration-s"),
    (["force", "--calcium", "0.3", "--sarcomere-length", "2", "--duration-s", "1", "--sample-ms", "1e-12"], "--sample-ms"),
    (["models", "cnr"], "did you mean 'crn'"),
    (["report", "missing.h5"], "missing.h5"),
    (["report", SCENES / "whole_heart.toml"], "not an HDF5 file"),
]


@pytest.mark.parametrize("words, expected", CASES, ids=lambda value: " ".join(map(str, value))[-60:] if isinstance(value, list) else "")
def test_refused(wiggers, tmp_path, words, expected):
    outcome = wiggers(*words)
    assert outcome.status == 2, (outcome.status, outcome.out, outcome.err)
    assert expected in outcome.err, outcome.err
    assert list(tmp_path.iterdir()) == []


def test_broken_files_are_refused_with_the_place(wiggers, tmp_path):
    (tmp_path / "a.toml").write_text('title = "x"\n[walls.LV\nkind = "elastance"\n')
    outcome = wiggers("check", "a.toml")
    assert outcome.status == 2 and "a.toml" in outcome.err and "2" in outcome.err
    (tmp_path / "b.csv").write_text("t [s],Ca [uM]\n0,0.1\n0.001\n")
    outcome = wiggers("force", "--calcium", "b.csv", "--sarcomere-length", 2)
    assert outcome.status == 2 and "line 3" in outcome.err
    (tmp_path / "c.csv").write_text("t [s],Ca [uM]\n0,0.1\n0.002,0.2\n0.001,0.3\n")
    outcome = wiggers("force", "--calcium", "c.csv", "--sarcomere-length", 2)
    assert outcome.status == 2 and "time does not increase" in outcome.err
    (tmp_path / "d.toml").write_text('base = "d.toml"\n')
    outcome = wiggers("check", "d.toml")
    assert outcome.status == 2 and "circle" in outcome.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_unwritable_folder(wiggers, tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    outcome = wiggers("run", SCENES / "elastance_healthy.toml", "-o", folder / "r.h5")
    assert outcome.status == 2 and "cannot be written" in outcome.err


def test_a_full_disk_keeps_the_earlier_file(tmp_path):
    """A limit on file size stands for a full disk: the write fails half-way."""
    target = tmp_path / "r.h5"
    earlier = b"\x89HDF\r\n\x1a\n an earlier result with its provenance and checksums"
    target.write_bytes(earlier)
    words = f"ulimit -f 16; exec {COMMAND} run {SCENES / 'elastance_healthy.toml'} -o {target}"
    process = subprocess.run(["bash", "-c", words], capture_output=True, text=True, timeout=120)
    assert process.returncode == 1
    assert "cannot write" in process.stderr
    assert target.read_bytes() == earlier
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]


def test_a_device_that_takes_nothing(wiggers):
    outcome = wiggers("cell", "ttp06-endo", "--beats", 1, "--integrator", "rush-larsen", "-o", "/dev/full")
    assert outcome.status == 1 and "cannot write" in outcome.err


def test_a_run_that_breaks_down_says_where_and_keeps_the_last_good_state(wiggers, tmp_path):
    outcome = wiggers("run", SCENES / "whole_heart.toml", "--accuracy", "founding", "--set", "solver.dt_s=2e-3",
                      "--set", "solver.stabilise.volumes=false", "--set", "run.until=beats", "--set", "run.beats=4",
                      "-o", "r.h5", "--json")
    assert outcome.status == 1
    assert "diverged" in outcome.err and "last good state" in outcome.err
    import h5py

    with h5py.File(tmp_path / "r.h5") as file:
        assert file["provenance/status"][()] == b"incomplete"
    assert '"indexes"' not in outcome.out


def test_an_output_never_replaces_an_input(wiggers, tmp_path):
    (tmp_path / "l.toml").write_text("period_s = 0.8\n")
    (tmp_path / "s.toml").write_text((SCENES / "elastance_healthy.toml").read_text())
    (tmp_path / "st.csv").write_text((DATA / "cell" / "crn_rhs.csv").read_text())
    for words in (["loop", "l.toml", "--beats", 1, "-o", "l.toml"], ["run", "s.toml", "-o", "./s.toml"],
                  ["cell", "crn", "--rhs", "st.csv", "-o", "st.csv"],
                  ["cell", "crn", "--beats", 1, "-o", "e.csv", "--final-state", "e.csv"]):
        before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
        outcome = wiggers(*words)
        assert outcome.status == 2 and "name another file" in outcome.err, words
        assert before == {p.name: p.read_bytes() for p in tmp_path.iterdir()}


def test_hostile_files(wiggers, tmp_path):
    (tmp_path / "deep.toml").write_text("x = " + "[" * 200_000)
    (tmp_path / "dots.toml").write_text(".".join(["a"] * 100_000) + " = 1")
    for name in ("deep.toml", "dots.toml"):
        outcome = wiggers("check", name)
        assert outcome.status == 2 and "nested too deeply" in outcome.err
    (tmp_path / "n.csv").write_text("t [s],Ca [uM]\n0,0.1\nnan,0.2\n0.3,0.3\n")
    outcome = wiggers("force", "--calcium", "n.csv", "--sarcomere-length", 2)
    assert outcome.status == 2 and "row 2" in outcome.err
    text = (DATA / "cell" / "crn_rhs.csv").read_text()
    (tmp_path / "u.csv").write_text(text.replace("V [mV]", "V [V]", 1))
    outcome = wiggers("cell", "crn", "--rhs", "u.csv", "-o", "x.csv")
    assert outcome.status == 2 and "must be in mV" in outcome.err
    lines = text.splitlines()
    cells = lines[1].split(",")
    cells[1] = "nan"
    (tmp_path / "i.csv").write_text("\n".join([lines[0], ",".join(cells)]))
    outcome = wiggers("cell", "crn", "--rhs", "i.csv", "-o", "x.csv")
    assert outcome.status == 2 and "i_stim" in outcome.err
    (tmp_path / "bom.csv").write_bytes(b"\xef\xbb\xbft [s],Ca [uM]\r\n0,0.1\r\n0.01,0.2\r\n")
    assert wiggers("force", "--calcium", "bom.csv", "--sarcomere-length", 2).status == 0


def test_a_limit_cycle_that_was_not_reached_is_a_failure(wiggers, tmp_path):
    outcome = wiggers("run", SCENES / "elastance_healthy.toml", "--set", "run.max_beats=4", "-o", "r.h5", "--json")
    assert outcome.status == 1 and "limit cycle was not reached" in outcome.err
    assert outcome.json()["limit_cycle"]["verdict"] == "not-converged"
    (tmp_path / "l.toml").write_text("")
    outcome = wiggers("loop", "l.toml", "--until", "limit-cycle", "--rtol", "0.1")
    assert outcome.status == 1 and "tolerance" in outcome.err


def test_titles_and_text_survive_the_full_listing(wiggers, tmp_path):
    scene = (SCENES / "elastance_healthy.toml").read_text().replace('title = "', 'title = "a\\nb\\t[run] ', 1)
    (tmp_path / "s.toml").write_text(scene)
    full = wiggers("check", "s.toml", "--full").out
    (tmp_path / "f.toml").write_text(full)
    again = wiggers("check", "f.toml", "--full")
    assert again.status == 0 and again.out == full


def test_silent_cells_are_reported(wiggers):
    outcome = wiggers("run", SCENES / "mixed.toml", "--set", "cells.ventricles.stimulus_A_per_F=0", "--set", "run.beats=1", "--json")
    assert outcome.status == 0 and any("do not fire" in w for w in outcome.json()["warnings"])


def test_another_kind_of_wall_replaces_the_table(wiggers):
    outcome = wiggers("check", SCENES / "whole_heart.toml", "--set", "walls.LV.kind=elastance")
    assert outcome.status == 0 and "LV: elastance" in outcome.out


def test_trade_extremes_and_accuracies_refuse_what_they_cannot_do(wiggers, tmp_path):
    (tmp_path / "file").write_text("")
    for words, hint in (
        (["run", SCENES / "whole_heart.toml", "--set", "solver.dt_s=8e-3"], "3.85 ms"),
        (["run", SCENES / "whole_heart.toml", "--accuracy", "standart"], "did you mean 'standard'"),
        (["run", SCENES / "triseg.toml", "--monolithic"], "triseg"),
        (["run", SCENES / "whole_heart.toml", "--monolithic", "-o", "x.h5"], ".csv"),
        (["cell", "crn", "--beats", 1, "--accuracy", "founding"], "reference"),
        (["cell", "crn", "--until", "limit-cycle", "--method", "neuton"], "did you mean 'newton'"),
        (["trade", "cell", "rdq20"], "wiggers trade force"),
        (["trade", "cell", "crm"], "did you mean 'crn'"),
        (["trade", "force", "fedele"], "fedele2023"),
        (["trade", "loop", "--quiet", "--tolerance", "presure=1"], "did you mean 'pressure'"),
        (["trade", "force", "-o", "file"], "is a file"),
        (["extremes", "ttp06"], "ttp06-endo"),
        (["extremes", "loop", "--draws", -1], "--draws"),
    ):
        outcome = wiggers(*words)
        assert outcome.status == 2, words
        assert hint in outcome.err, (words, outcome.err)


def test_a_saved_state_knows_its_model_and_parameters(wiggers, tmp_path):
    fast = ["--beats", 1, "--period-ms", 300, "--accuracy", "draft"]
    assert wiggers("cell", "crn", *fast, "--final-state", "end.csv").status == 0
    assert wiggers("cell", "crn", *fast, "--start", "end.csv").status == 0
    other = wiggers("cell", "crn", *fast, "--start", "end.csv", "--set", "g_CaL=0.1")
    assert other.status == 2 and "other parameters" in other.err
    assert wiggers("cell", "crn", *fast, "--start", "end.csv", "--set", "g_CaL=0.1", "--other-parameters").status == 0
    wrong = wiggers("cell", "ttp06-endo", *fast, "--start", "end.csv")
    assert wrong.status == 2 and "of model crn" in wrong.err
    text = (tmp_path / "end.csv").read_text()
    (tmp_path / "unit.csv").write_text(text.replace("V [mV]", "V [V]"))
    unit = wiggers("cell", "crn", *fast, "--start", "unit.csv")
    assert unit.status == 2 and "mV" in unit.err


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_no_input_of_any_kind_is_overwritten(wiggers, tmp_path):
    """The scene, its base scenes, series, states, loop files and studies, also through links."""
    shutil.copytree(SCENES, tmp_path, dirs_exist_ok=True)
    (tmp_path / "l.toml").write_text("period_s = 0.8\n")
    (tmp_path / "second.toml").write_text('base = "atria_passive.toml"\n')
    (tmp_path / "ca.csv").write_text("t [s],Ca [uM]\n0,0.1\n0.01,0.2\n")
    (tmp_path / "sl.csv").write_text("t [s],SL [um]\n0,2.1\n0.01,2.2\n")
    assert wiggers("cell", "crn", "--beats", 1, "--accuracy", "draft", "--final-state", "start.csv").status == 0
    assert wiggers("run", "elastance_healthy.toml", "--quiet", "-o", "index.html").status == 0
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "trade.md").write_text("period_s = 0.8\n")
    for name in ("whole_heart.toml", "start.csv", "ca.csv"):
        os.link(tmp_path / name, tmp_path / f"hard-{name}")
        (tmp_path / f"soft-{name}").symlink_to(name)
    force = ["force", "--calcium", "ca.csv", "--sarcomere-length", "sl.csv"]
    pace = ["cell", "crn", "--beats", 1, "--start", "start.csv"]
    before = contents(tmp_path)
    for words in (
        ["run", "atria_passive.toml", "-o", "whole_heart.toml", "--set", "run.beats=1"],
        ["run", "second.toml", "-o", "whole_heart.toml"],
        ["run", "second.toml", "-o", "atria_passive.toml"],
        ["run", "second.toml", "-o", "hard-whole_heart.toml"],
        ["run", "second.toml", "-o", "soft-whole_heart.toml"],
        ["run", "second.toml", "-o", tmp_path / "study" / ".." / "whole_heart.toml"],
        ["run", "second.toml", "--accuracy", "draft", "-o", "whole_heart.toml"],
        ["run", "second.toml", "--resume", "index.html", "-o", "whole_heart.toml"],
        [*force, "-o", "ca.csv"], [*force, "-o", "sl.csv"], [*force, "-o", "hard-ca.csv"],
        [*pace, "--final-state", "start.csv"], [*pace, "-o", "soft-start.csv"], [*pace, "-o", "hard-start.csv"],
        ["loop", "l.toml", "--beats", 1, "-o", "./l.toml"],
        ["extremes", "second.toml", "-o", "whole_heart.toml"],
        ["trade", "loop", "study/trade.md", "-o", "study"],
        ["report", "index.html", "-o", "."],
    ):
        outcome = wiggers(*words)
        assert outcome.status == 2 and "name another file" in outcome.err, (words, outcome.err)
        assert contents(tmp_path) == before, words


def test_a_planted_link_is_not_followed_and_a_device_not_replaced(wiggers, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("kept")
    words = [COMMAND, "run", SCENES / "elastance_healthy.toml", "--quiet", "-o", tmp_path / "r.h5"]
    process = subprocess.Popen(["bash", "-c", 'ln -s victim "r.h5.$$.partial"; exec "$0" "$@"', *map(str, words)], cwd=tmp_path,
                               stdout=subprocess.DEVNULL)
    assert process.wait() == 0
    assert victim.read_text() == "kept"
    (tmp_path / "null").symlink_to("/dev/null")
    assert wiggers("run", SCENES / "elastance_healthy.toml", "--quiet", "-o", "null").status == 0
    assert (tmp_path / "null").is_symlink() and Path("/dev/null").is_char_device()
    (tmp_path / "r.h5").chmod(0o640)
    assert wiggers("run", SCENES / "elastance_healthy.toml", "--quiet", "-o", "r.h5").status == 0
    assert (tmp_path / "r.h5").stat().st_mode & 0o777 == 0o640


def test_a_scene_from_a_pipe_is_read_once(tmp_path):
    """Also where it is needed twice; a pipe that nobody fills is refused and does not hang."""
    words = f"exec {COMMAND} run <(cat {SCENES / 'elastance_healthy.toml'}) --accuracy draft --quiet -o r.h5"
    process = subprocess.run(["bash", "-c", words], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stderr
    assert (tmp_path / "r.h5").exists()
    for words, said in ((["check", "/dev/zero"], "does not end"), (["run", "/dev/null"], "walls.LA is missing"),
                        (["run", SCENES / "elastance_healthy.toml", "--resume", "/dev/zero", "-o", "x.h5"], "does not end")):
        process = subprocess.run([COMMAND, *map(str, words)], cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert process.returncode == 2 and said in process.stderr, process.stderr
    os.mkfifo(tmp_path / "pipe")
    process = subprocess.run([COMMAND, "check", "pipe"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert process.returncode == 2 and "nothing was written to it" in process.stderr


@pytest.mark.parametrize("words, nearest", [
    (["trade", "lop"], "'loop'"),
    (["run", "x.toml", "--resum", "y"], "'--resume'"),
    (["cell", "crn", "--beat", 1], "'--beats'"),
    (["cell", "crn", "--beats", 1, "--perod-ms=500"], "'--period-ms'"),
    (["trade", "loop", "--tolerence", "pressure=1"], "'--tolerance'"),
    (["doctr"], "'doctor'"),
    (["run", "whole_haert.toml"], "'whole_heart.toml'"),
    (["check", "by_base.toml"], "'whole_heart.toml'"),
    (["report", "heart.h"], "'heart.h5'"),
])
def test_the_nearest_name_is_given(wiggers, tmp_path, words, nearest):
    (tmp_path / "by_base.toml").write_text('base = "whole_haert.toml"\n')
    for name in ("whole_heart.toml", "heart.h5"):
        (tmp_path / name).write_text("")
    outcome = wiggers(*words)
    assert outcome.status == 2 and f"did you mean {nearest}?" in outcome.err, outcome.err


@pytest.mark.parametrize("name", ["atria/facts", ".", "..", "", "a b", "a" * 101, "a/../b"])
def test_names_of_cells_that_collide_in_the_result_are_refused(wiggers, tmp_path, name):
    scene = (SCENES / "whole_heart.toml").read_text().replace("[cells.atria]", f'[cells."{name}"]').replace('"atria"', f'"{name}"')
    (tmp_path / "s.toml").write_text(scene)
    outcome = wiggers("check", "s.toml")
    assert outcome.status == 2 and "names their group" in outcome.err


def test_messages_are_bounded(wiggers, tmp_path):
    scene = (SCENES / "elastance_healthy.toml").read_text()
    long = "k" * 1_000_000
    for text in (f"{long} = 1\n" + scene, scene + f"\n[walls.{long}]\nkind = 1\n", scene.replace('"elastance"', f'"{long}"', 1),
                 f"x = {long}\n", f'base = "{long}"\n', scene + f"\n[solver]\ndt_s = \"{long}\"\n"):
        (tmp_path / "s.toml").write_text(text)
        outcome = wiggers("check", "s.toml")
        assert outcome.status == 2 and 0 < len(outcome.err) < 5000, len(outcome.err)
    (tmp_path / "c.csv").write_text("t [s],Ca [uM]\n0," + long + "\n")
    outcome = wiggers("force", "--calcium", "c.csv", "--sarcomere-length", 2)
    assert outcome.status == 2 and len(outcome.err) < 5000


@pytest.mark.parametrize("words", [
    ["cell", "crn", "--beats", 1, "--sample-ms", 1e-3, "--period-ms", 1e5],
    ["cell", "crn", "--until", "limit-cycle", "--sample-ms", 1e-3, "--period-ms", 1e5],
    ["loop", "l.toml", "--beats", 1, "--sample-ms", 1e-3, "--set", "period_s=20"],
    ["force", "--calcium", 0.3, "--sarcomere-length", 2, "--duration-s", 1e4, "--sample-ms", 1e-3],
])
def test_more_rows_than_the_memory_holds_are_refused(tmp_path, words):
    """Asked for on a machine with 4 GB to give."""
    (tmp_path / "l.toml").write_text("period_s = 0.8\n")
    limited = f"ulimit -v 4000000; exec {COMMAND} {' '.join(map(str, words))}"
    process = subprocess.run(["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert process.returncode == 2, process.stderr
    assert "rows" in process.stderr and "GB" in process.stderr
