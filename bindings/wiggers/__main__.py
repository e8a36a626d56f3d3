"""python -m wiggers report RESULT.h5 [-o FOLDER]: the report of a result file, as the wiggers command makes it."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from . import __version__
from ._core import InputError, kind_of_report_file, require_replaceable, write_file


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
    try:
        for line in write_report(result, Path(given.output or result.with_suffix(""))):
            print(line)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def write_report(result: Path, folder: Path) -> list[str]:
    """Lets the report's program draw and writes what it sends, the page last (report/answer.py). Returns its lines."""
    read, write = os.pipe()
    program = Path(__file__).parent / "report" / "make_report.py"
    with subprocess.Popen([sys.executable, str(program), str(result), str(folder), str(write)], pass_fds=[write]) as process:
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            parts = [*_parts(pipe)]
    if process.returncode != 0 or not parts or parts[-1][0] != "end":
        raise OSError(f"the report program ended with status {process.returncode} before its answer")
    for kind, _, data in parts:
        if kind == "refuse":
            raise InputError(data.decode())
        if kind == "fail":
            raise OSError(data.decode())
    files = sorted(((name, data) for kind, name, data in parts if kind == "file"), key=lambda file: file[0] == "index.html")
    folder.mkdir(parents=True, exist_ok=True)
    for name, _ in files:
        if "/" in name or (folder / name).exists() and (folder / name).samefile(result):
            raise InputError(f"'{folder / name}' cannot be written: it is the result, or no name of a file")
        require_replaceable(str(folder / name), kind_of_report_file(name))
    for name, data in files:
        write_file(str(folder / name), data, kind_of_report_file(name))
    return [data.decode().rstrip() for kind, _, data in parts if kind == "say"]


def _parts(pipe: IO[bytes]) -> Iterator[tuple[str, str, bytes]]:
    for line in pipe:
        words = line.decode().split(" ")
        yield words[0], " ".join(words[1:-1]), pipe.read(int(words[-1]))


if __name__ == "__main__":
    sys.exit(main())
