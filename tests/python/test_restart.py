"""Kill a run at any moment; what is on the disk is whole, says it is incomplete, and resumes bit for bit."""

import os
import signal
import subprocess
import time

import h5py
import numpy as np
import pytest
from conftest import COMMAND, SCENES

# Small steps make the run long enough to be killed; checkpoints after every beat.
SETTINGS = ["--set", "solver.dt_s=1e-4", "--set", "run.checkpoint_every_s=0"]


def datasets(path):
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def same_results(a, b):
    first, second = datasets(a), datasets(b)
    assert set(first) == set(second)
    timings = {"solver/cost_cells", "solver/cost_heart", "provenance/wall_time", "checkpoint/run", "summary", "provenance/host"}
    for name in sorted(set(first) - timings):
        assert np.array_equal(first[name], second[name]), name


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
    for leftover in tmp_path.iterdir():  # a kill may leave a partial neighbour, never a damaged result
        assert leftover.name == "r.h5" or leftover.name.endswith(".partial")


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
