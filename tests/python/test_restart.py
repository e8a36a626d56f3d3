"""Kill a run at any moment; what is on the disk is whole, says it is incomplete, and resumes bit for bit."""

import os
import signal
import subprocess
import time

import h5py
import numpy as np
import pytest
from conftest import COMMAND, SCENES
from killing import KILLS, crc64, kill_until, reseal, same_results

# Small steps make the run long enough to be killed; checkpoints after every beat.
SETTINGS = ["--set", "solver.dt_s=1e-4", "--set", "run.checkpoint_every_s=0"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    path = tmp_path_factory.mktemp("undisturbed") / "r.h5"
    subprocess.run([COMMAND, "run", SCENES / "whole_heart.toml", *SETTINGS, "-o", path, "--quiet"], check=True, capture_output=True)
    return path


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_killed_and_resumed(tmp_path, undisturbed, how):
    result = tmp_path / "r.h5"
    process = subprocess.Popen([COMMAND, "run", SCENES / "whole_heart.toml", *SETTINGS, "-o", result, "--quiet"],
                               stderr=subprocess.PIPE, text=True)
    # Wait for a few beats on the disk, then strike.
    deadline = time.time() + 60
    while time.time() < deadline and process.poll() is None:
        try:
            with h5py.File(result) as file:
                if file["limit_cycle/beats"][()] >= 3:
                    break
        except OSError:
            pass
        time.sleep(0.02)
    assert process.poll() is None, "the run ended before it could be killed"
    process.send_signal(how)
    error = process.communicate(timeout=60)[1]
    if how == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 1 and "--resume" in error
    with h5py.File(result) as file:
        assert file["provenance/status"][()] == b"incomplete"
        beats = int(file["limit_cycle/beats"][()])
    assert beats >= 3
    subprocess.run([COMMAND, "run", SCENES / "whole_heart.toml", *SETTINGS, "--resume", result, "--quiet"], check=True,
                   capture_output=True)
    same_results(result, undisturbed)
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]  # what the kill left went with the next write


def test_another_scene_is_refused(wiggers, tmp_path, undisturbed):
    outcome = wiggers("run", SCENES / "whole_heart.toml", *SETTINGS, "--set", "walls.LV.activation_ms=150", "--resume", undisturbed)
    assert outcome.status == 2
    assert "another scene" in outcome.err and "activation_ms = 150" in outcome.err


def test_more_beats_after_a_finished_run_equal_one_long_run(wiggers, tmp_path):
    short = ["--set", "run.until=beats", "--set"]
    assert wiggers("run", SCENES / "mixed.toml", *short, "run.beats=2", "-o", "a.h5").status == 0
    assert wiggers("run", SCENES / "mixed.toml", *short, "run.beats=5", "--resume", "a.h5").status == 0
    assert wiggers("run", SCENES / "mixed.toml", *short, "run.beats=5", "-o", "b.h5").status == 0
    same_results(tmp_path / "a.h5", tmp_path / "b.h5")


def test_a_checkpoint_never_replaces_a_result_by_less(tmp_path):
    """Whatever instant is read, the file opens and holds whole arrays."""
    result = tmp_path / "r.h5"
    process = subprocess.Popen([COMMAND, "run", SCENES / "whole_heart.toml", "--set", "run.checkpoint_every_s=0", "-o", result, "--quiet"])
    seen = 0
    while process.poll() is None:
        if result.exists():
            with h5py.File(result) as file:
                if "time" in file:
                    assert len(file["time"]) == 801
                    seen += 1
        time.sleep(0.005)
    assert process.returncode == 0
    assert seen > 0
    assert os.listdir(tmp_path) == ["r.h5"]


@pytest.mark.parametrize("scene, settings", [
    ("elastance_healthy", ["solver.dt_s=1e-4"]),
    ("whole_heart", []),
    ("triseg", ["run.beats=6"]),
])
def test_killed_at_random_moments(tmp_path, scene, settings):
    words = [w for s in [*settings, "run.checkpoint_every_s=0"] for w in ("--set", s)]
    assert kill_until(tmp_path, max(1, KILLS // 3), SCENES / f"{scene}.toml", words) > 0


def test_the_checksums_are_crc64():
    assert crc64(b"123456789") == 0x995DC9BBDF1939FA


@pytest.fixture(scope="module")
def small_result(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "r.h5"
    subprocess.run([COMMAND, "run", SCENES / "mixed.toml", "--set", "run.beats=3", "--set", "solver.dt_s=2e-3", "-o", path,
                    "--quiet"], check=True, capture_output=True)
    return path


def resumed_from(wiggers, path, **more):
    return wiggers("run", SCENES / "mixed.toml", "--set", "run.beats=4", "--set", "solver.dt_s=2e-3", "--resume", path, "-o", "o.h5",
                   "--quiet", **more)


@pytest.mark.parametrize("entry, change, said", [
    ("checkpoint/driver", {0: np.nan}, "number 1 is nan"),
    ("checkpoint/driver", {0: 10.0}, "mL of blood"),
    ("checkpoint/driver", 5, "ends early"),
    ("checkpoint/search", {0: -1}, "no whole number"),
    ("checkpoint/search", {0: 77}, "no whole number"),
    ("checkpoint/search", {1: np.inf}, "is inf"),
    ("checkpoint/search", {11: 1e300}, "no whole number"),
    ("checkpoint/search", 14, "ends after"),
    ("checkpoint/run", {0: -3}, "no whole number"),
    ("checkpoint/run", {0: 2.5}, "no whole number"),
    ("checkpoint/run", {0: 77}, "77 beats, its search has seen 3"),
    ("checkpoint/run", 2, "ends after"),
    ("checkpoint/audit", {4: -1}, "no whole number"),
    ("checkpoint/cells/ventricles/facts", {0: 99}, "no whole number"),
    ("checkpoint/cells/ventricles/facts", 3, "ends after"),
    ("checkpoint/cells/ventricles/state_at_onset", {0: 4000.0}, "V = 4000"),
    ("checkpoint/cells/ventricles/state_at_onset", "K_i", "conserved charge"),
    ("checkpoint/cells/ventricles/state_at_onset", 7, "are wanted"),
    ("time", 100, "are wanted"),
    ("cavities/LV/volume", {7: np.nan}, "number 8 is nan"),
    ("checkpoint/driver", "text", "checksum is not that"),
    ("checkpoint/run", "group", "no row of numbers"),
    ("checkpoint/driver", "plane", "2 dimensions"),
    ("provenance/scene", "texts", "3 texts"),
    ("provenance/scene", "numbers", "does not hold text"),
])
@pytest.mark.parametrize("sealed", [True, False])
def test_a_checkpoint_without_sense_is_refused(wiggers, small_result, tmp_path, entry, change, said, sealed):
    """With the checksums right: by its sense. Without: by its checksum. By kind and rank in either case."""
    import shutil

    path = tmp_path / "r.h5"
    shutil.copy(small_result, path)
    kinds = {"text": lambda old: np.bytes_(b"words"), "plane": lambda old: np.ones((2, 2)),
             "texts": lambda old: np.array([b"a", b"bc", b"def"]), "numbers": lambda old: np.ones(3)}
    with h5py.File(path, "a") as file:
        old = file[entry][()]
        if isinstance(change, dict):
            for at, value in change.items():
                file[entry][at] = value
        elif change == "K_i":
            file[entry][np.argmax(old)] += 1.0  # mM, more than any other state
        else:
            del file[entry]
            if change == "group":
                file.create_group(entry)
            else:
                file[entry] = old[:change] if isinstance(change, int) else kinds[change](old)
        of_kind = isinstance(change, str) and change != "K_i"
        if sealed and not of_kind:
            reseal(file, entry)
    outcome = resumed_from(wiggers, path)
    assert outcome.status == 2, (outcome.out, outcome.err)
    assert "r.h5" in outcome.err and f"/{entry}" in outcome.err
    assert (said if sealed or of_kind else "checksum") in outcome.err
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]


def test_a_result_resealed_without_a_change_is_taken(wiggers, small_result, tmp_path):
    """The counterpart: reseal itself is right."""
    import shutil

    path = tmp_path / "r.h5"
    shutil.copy(small_result, path)
    with h5py.File(path, "a") as file:
        reseal(file, "checkpoint/driver", "checkpoint/run", "provenance/scene")
    assert resumed_from(wiggers, path).status == 0


def test_one_bit_of_a_result_is_seen(wiggers, small_result, tmp_path):
    """Whichever bit: refused in words, or what goes on is what would have gone on."""
    import random

    chance = random.Random(7)
    whole = small_result.read_bytes()
    assert resumed_from(wiggers, small_result).status == 0
    (tmp_path / "o.h5").rename(tmp_path / "right.h5")
    refused = 0
    for _ in range(30):
        changed = bytearray(whole)
        changed[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
        (tmp_path / "r.h5").write_bytes(changed)
        outcome = resumed_from(wiggers, "r.h5")
        assert outcome.status in (0, 2), outcome.err
        if outcome.status == 2:
            assert "r.h5" in outcome.err
            refused += 1
        else:
            same_results(tmp_path / "o.h5", tmp_path / "right.h5")
    assert refused > 15


def interrupted_after(words, folder, how=signal.SIGINT, wait=1.5):
    """Seconds from the signal to the end, status and what was said."""
    process = subprocess.Popen([COMMAND, *map(str, words)], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    time.sleep(wait)
    assert process.poll() is None, process.stderr.read()
    process.send_signal(how)
    begin = time.time()
    error = process.communicate(timeout=60)[1]
    return time.time() - begin, process.returncode, error


@pytest.mark.parametrize("words", [
    ["run", SCENES / "elastance_healthy.toml", "--set", "heart.period_s=20", "--set", "solver.dt_s=1e-6", "-o", "r.h5"],
    ["run", SCENES / "whole_heart.toml", "--set", "heart.period_s=20", "--set", "solver.dt_s=1e-6", "-o", "r.h5"],
    ["loop", "loop.toml", "--beats", 9, "--integrator", "runge-kutta-4", "--dt-s", 1e-7],
    ["loop", "loop.toml", "--beats", 9, "--integrator", "forward-euler", "--dt-s", 1e-7],
    ["loop", "loop.toml", "--beats", 1000000, "--rtol", 1e-13, "--atol", 1e-14],
    ["cell", "crn", "--beats", 9, "--period-ms", 1e5, "--integrator", "rush-larsen", "--dt-ms", 1e-3, "--sample-ms", 100],
    ["cell", "ttp06-endo", "--beats", 9, "--period-ms", 1e5, "--integrator", "odeint-dopri5", "--rtol", 1e-12],
])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_interrupts_are_seen_within_a_long_beat(tmp_path, words, how):
    (tmp_path / "loop.toml").write_text("period_s = 20\n")
    seconds, status, error = interrupted_after(words, tmp_path, how)
    assert status == 1 and "stopped on request" in error
    assert seconds < 1


def test_a_run_interrupted_within_a_beat_goes_on_bit_for_bit(wiggers, tmp_path):
    words = ["run", SCENES / "elastance_healthy.toml", "--set", "solver.dt_s=1e-5", "--set", "run.beats=20"]
    assert wiggers(*words, "-o", "whole.h5", "--quiet").status == 0
    process = subprocess.Popen([COMMAND, *map(str, words), "-o", "r.h5", "--quiet"], cwd=tmp_path, stderr=subprocess.PIPE)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 1
    assert wiggers(*words, "--resume", "r.h5", "--quiet").status == 0
    same_results(tmp_path / "r.h5", tmp_path / "whole.h5")
