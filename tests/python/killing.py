"""Runs that are killed again and again at random moments and resumed until they are done; results that are changed on
purpose."""

import os
import random
import subprocess
import time

import h5py
import numpy as np
from conftest import COMMAND

# The regular suite kills a few dozen times; the nightly set asks for hundreds.
KILLS = int(os.environ.get("WIGGERS_KILLS", "24"))
# What differs between a run and the same run with a break.
TIMINGS = {"solver/cost_cells", "solver/cost_heart", "provenance/wall_time", "checkpoint/run", "summary", "provenance/host",
           "provenance/checksums"}


def datasets(path):
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def same_results(a, b):
    first, second = datasets(a), datasets(b)
    assert set(first) == set(second)
    for name in sorted(set(first) - TIMINGS):
        if not name.startswith("solver/walls/"):  # work done and its wall time
            assert np.array_equal(first[name], second[name]), name


def kill_until(folder, kills, scene, settings):
    """Runs the scene undisturbed, then in one folder with `kills` kill -9 altogether, as often as it takes. Each time it
    must end with the same result and nothing beside it."""
    folder.mkdir(exist_ok=True)
    words = [COMMAND, "run", scene, *settings, "--quiet"]
    undisturbed = folder / "undisturbed.h5"
    begin = time.time()
    subprocess.run([*words, "-o", undisturbed], check=True, capture_output=True)
    whole = time.time() - begin
    chance = random.Random(kills)
    killed, rounds = 0, 0
    while killed < kills:
        rounds += 1
        place = folder / f"round{rounds}"
        place.mkdir()
        result = place / "r.h5"
        while True:
            more = ["--resume", result] if result.exists() else ["-o", result]
            process = subprocess.Popen([*words, *more], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            try:
                process.wait(timeout=chance.uniform(0.02, 0.9) * whole if killed < kills else None)
                break
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                killed += 1
                if result.exists():
                    datasets(result)  # whole, whatever the moment
        assert process.returncode == 0, process.stderr.read()
        same_results(result, undisturbed)
        left = {p.name for p in place.rglob("*") if p.name.endswith(".partial")}
        assert not left, left
    return rounds


def _crc64_of(byte):
    for _ in range(8):
        byte = byte >> 1 ^ (0xC96C5795D7870F42 if byte & 1 else 0)
    return byte


CRC64 = [_crc64_of(byte) for byte in range(256)]


def crc64(data):
    value = 2**64 - 1
    for byte in data:
        value = CRC64[(value ^ byte) & 255] ^ value >> 8
    return value ^ 2**64 - 1


def reseal(file, *changed):
    """The checksums of entries that were changed on purpose: what then refuses them is their sense."""
    lines = file["provenance/checksums"][()].decode().splitlines()[1:]
    for name in changed:
        data = file[name][()]
        data = data if isinstance(data, bytes) else np.asarray(data, dtype="<f8").tobytes()
        lines = [f"{crc64(data):016x} /{name}" if line.endswith(f" /{name}") else line for line in lines]
    text = "".join(f"{line}\n" for line in lines)
    del file["provenance/checksums"]
    file["provenance/checksums"] = np.bytes_(f"{crc64(text.encode()):016x}\n{text}".encode())
