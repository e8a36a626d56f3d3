"""Nightly: results and saved states that a disk or a person has changed, read by a command with address sanitizer. Each
ends in a result without a number that is none, or in words. WIGGERS_CHANGED_RESULTS says how many (default 60); seeded."""

import csv
import json
import math
import os
import random
import re
import subprocess

import h5py
import numpy as np
import pytest
from conftest import COMMAND, SCENES
from killing import reseal

COUNT = int(os.environ.get("WIGGERS_CHANGED_RESULTS", "60"))
NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e300, 1e-300, 2.5, 1e9, 77.0]
SETTINGS = ["--set", "solver.dt_s=2e-3", "--quiet", "--json"]
# gcc and clang both: a finding ends with a status of its own.
SANITIZED = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0:exitcode=99:allocator_may_return_null=1:max_allocation_size_mb=4000",
             "UBSAN_OPTIONS": "halt_on_error=1:exitcode=99"}


def call(*words, cwd):
    return subprocess.run([COMMAND, *map(str, words)], cwd=cwd, capture_output=True, text=True, errors="replace", timeout=300,
                          env=SANITIZED)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    for scene in ("mixed", "elastance_healthy"):
        made = call("run", SCENES / f"{scene}.toml", "--set", "run.until=beats", "--set", "run.beats=2", *SETTINGS, "-o", f"{scene}.h5",
                    cwd=folder)
        assert made.returncode == 0, made.stderr
    for cell in ("crn", "ttp06-epi"):
        made = call("cell", cell, "--beats", "1", "--quiet", "--final-state", f"{cell}.csv", cwd=folder)
        assert made.returncode == 0, made.stderr
    return folder


def bend_bytes(chance, data):
    data = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 8, 64])):
        if not data:
            break
        at = chance.randrange(len(data))
        kind = chance.random()
        if kind < 0.6:
            data[at] ^= 1 << chance.randrange(8)
        elif kind < 0.8:
            data[at : at + 8] = chance.randbytes(8)
        elif kind < 0.9:
            del data[at : at + chance.randint(1, 4000)]
        else:
            data = data[: max(1, at)]
    return bytes(data)


def bend_entries(chance, path):
    """Entries with other numbers, kinds, ranks and lengths; most with their checksums made again."""
    with h5py.File(path, "a") as file:
        names = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        names = [n for n in names if n != "provenance/checksums"]
        weights = [20 if n.startswith("checkpoint") else 1 for n in names]
        changed = []
        for name in {chance.choices(names, weights)[0] for _ in range(chance.choice([1, 1, 2, 4]))}:
            old = file[name][()]
            kind = chance.random()
            if kind < 0.6 and isinstance(old, np.ndarray) and old.size and old.dtype.kind == "f":
                at = chance.randrange(old.size)
                old[at] = chance.choice([*NUMBERS, old[at] * 10 ** chance.uniform(-2, 2), -old[at], old[at] + 1])
                file[name][...] = old
            elif kind < 0.7 and isinstance(old, bytes):
                file[name][()] = np.bytes_(bend_bytes(chance, old)[: len(old)])
            else:
                del file[name]
                new = chance.choice([None, np.ones(3), np.ones((2, 3)), b"words", np.array([b"a", b"b"]), 1.0, np.zeros(0), np.arange(5),
                                     "group", h5py.Empty("f8"), h5py.SoftLink("/time"), h5py.ExternalLink("/etc/passwd", "/a"),
                                     np.ones(3, dtype=[("a", "f8"), ("b", "i4")]), np.ones(3) * 1j])
                if isinstance(new, str):
                    file.create_group(name)
                elif new is not None:
                    file[name] = new
                continue
            changed.append(name)
        if chance.random() < 0.9:
            reseal(file, *changed)


def must_end_in_words(outcome, result, say):
    assert outcome.returncode in (0, 1, 2), f"{say}: {outcome.returncode}\n{outcome.stderr[-3000:]}"
    if outcome.returncode == 0:
        assert not re.search(r"\b(nan|inf|infinity)\b", outcome.stdout, re.IGNORECASE), f"{say}: {outcome.stdout}"
        numbers_of(result, say)
    else:
        assert outcome.stderr.startswith("wiggers: ") and 30 < len(outcome.stderr) < 4000, f"{say}: {outcome.stderr}"


def numbers_of(result, say):
    if result.suffix == ".csv":
        with open(result) as file:
            for row in list(csv.reader(file))[1:]:
                assert all(math.isfinite(float(x)) for x in row), f"{say}: {row}"
        return

    def look(name, item):
        if isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
            # What a run does not know of itself (a multiplier after two beats) may be missing, never a trace or a state.
            if name.startswith(("time", "cavities", "circulation", "valves", "checkpoint/driver")) or "state_at_onset" in name:
                assert np.isfinite(item[()]).all(), f"{say}: {name}"

    with h5py.File(result) as file:
        file.visititems(look)


@pytest.mark.parametrize("seed", range(COUNT))
def test_a_bent_result_ends_in_words(seed, small, tmp_path):
    chance = random.Random(seed)
    scene = chance.choice(["mixed", "elastance_healthy"])
    path = tmp_path / "r.h5"
    whole = (small / f"{scene}.h5").read_bytes()
    if chance.random() < 0.3:
        path.write_bytes(bend_bytes(chance, whole))
    else:
        path.write_bytes(whole)
        bend_entries(chance, path)
    outcome = call("run", SCENES / f"{scene}.toml", "--set", "run.until=beats", "--set", "run.beats=3", *SETTINGS, "--resume", "r.h5",
                   "-o", "o.h5", cwd=tmp_path)
    must_end_in_words(outcome, tmp_path / "o.h5", f"seed {seed}")
    if outcome.returncode == 0:
        assert json.loads(outcome.stdout.strip().splitlines()[-1])["cost"]["beats"] == 3, f"seed {seed}"
    if seed % 10 == 0:
        drawn = call("report", "r.h5", "-o", "report", cwd=tmp_path)
        assert drawn.returncode in (0, 1, 2) and "Traceback" not in drawn.stderr, f"seed {seed}: {drawn.stderr}"


@pytest.mark.parametrize("seed", range(COUNT // 4))
def test_a_bent_state_ends_in_words(seed, small, tmp_path):
    chance = random.Random(seed)
    cell = chance.choice(["crn", "ttp06-epi"])
    data = (small / f"{cell}.csv").read_text()
    if chance.random() < 0.4:
        (tmp_path / "s.csv").write_bytes(bend_bytes(chance, data.encode()))
    else:
        head, values = data.strip().splitlines()
        values = values.split(",")
        for _ in range(chance.choice([1, 2, 5])):
            at = chance.randrange(len(values))
            values[at] = chance.choice(["nan", "inf", "-1", "1e300", "", "x", "0", f"{float(values[at] or 0) * 10 ** chance.uniform(-1, 1):.6g}"
                                        if values[at].replace(".", "").replace("-", "").isdigit() else "1"])
        (tmp_path / "s.csv").write_text(f"{head}\n{','.join(values)}\n")
    outcome = call("cell", cell, "--start", "s.csv", "--beats", "2", "--quiet", "--json", "--final-state", "o.csv", cwd=tmp_path)
    must_end_in_words(outcome, tmp_path / "o.csv", f"seed {seed}")
