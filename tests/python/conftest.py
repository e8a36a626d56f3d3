"""Runs the command as a user does and reads what it says."""

import importlib.util
import json
import os
import shutil
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


# --- what may be left out ---

# Reasons for which a test may be skipped, and whether they hold here. Any other skip is a failure: a test that is never
# run is none.
MAY_SKIP = {
    "root may write everywhere": os.geteuid() == 0,
    "some minutes": "WIGGERS_NIGHTLY" not in os.environ,
    "full reference not at hand": not REFERENCE.exists(),
    "built without this verb": True,
    "no mpirun": shutil.which("mpirun") is None and shutil.which("mpiexec") is None,
    "could not import 'pandas'": importlib.util.find_spec("pandas") is None,
    "could not import 'polars'": importlib.util.find_spec("polars") is None,
    "could not import 'dask": importlib.util.find_spec("dask") is None,
    "could not import 'wiggers'": True,  # built without bindings
}


def pytest_terminal_summary(terminalreporter, exitstatus, config):
    skipped = [str(report.longrepr[2]).removeprefix("Skipped: ") for report in terminalreporter.stats.get("skipped", [])]
    for reason in sorted(set(skipped)):
        terminalreporter.write_line(f"skipped {skipped.count(reason)}: {reason}")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    report = outcome.get_result()
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = str(report.longrepr[2]).removeprefix("Skipped: ")
        if not any(reason.startswith(known) and holds for known, holds in MAY_SKIP.items()):
            report.outcome = "failed"
            report.longrepr = f"{item.nodeid} is skipped for a reason that does not hold here: {reason}"
