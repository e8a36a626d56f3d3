"""Runs the command as a user does and reads what it says."""

import json
import os
import subprocess
from pathlib import Path

import pytest

COMMAND = os.environ["WIGGERS"]
ROOT = Path(os.environ["WIGGERS_ROOT"])
SCENES = ROOT / "scenes"
DATA = ROOT / "tests" / "data"
REFERENCE = Path(os.environ.get("WIGGERS_REFERENCE", "/nowhere"))


class Outcome:
    def __init__(self, process):
        self.status = process.returncode
        self.out = process.stdout
        self.err = process.stderr

    def json(self):
        return json.loads(self.out.strip().splitlines()[-1])


@pytest.fixture
def wiggers(tmp_path):
    def run(*words, cwd=tmp_path, timeout=300, **more):
        process = subprocess.run(
            [COMMAND, *map(str, words)], cwd=cwd, capture_output=True, text=True, timeout=timeout, **more
        )
        return Outcome(process)

    return run


def read_csv(path):
    """Columns by name (without unit) and the headings as they stand."""
    lines = Path(path).read_text().strip().splitlines()
    headings = lines[0].split(",")
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    return {h.split(" [")[0]: [row[k] for row in rows] for k, h in enumerate(headings)}, headings
