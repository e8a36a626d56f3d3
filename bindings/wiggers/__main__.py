"""python -m wiggers report RESULT.h5 [-o FOLDER]: the report of a result file, as the wiggers command makes it."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from . import __version__


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m wiggers", description=__doc__)
    parser.add_argument("--version", action="version", version=f"wiggers {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True)
    report = verbs.add_parser("report", help="Wiggers diagram, PV loops and index table of a result, one HTML file")
    report.add_argument("result", help="result file (HDF5)")
    report.add_argument("-o", "--output", help="folder of the report (default: the result's name)")
    given = parser.parse_args(arguments)
    result = Path(given.result)
    if not result.is_file():
        print(f"error: {result}: no such file", file=sys.stderr)
        return 2
    program = Path(__file__).parent / "report" / "make_report.py"
    folder = given.output or str(result.with_suffix(""))
    return subprocess.run([sys.executable, str(program), str(result), folder], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
