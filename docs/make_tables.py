"""Writes docs/trade.md and docs/extremes.md from `wiggers trade` and `wiggers extremes`, measured here and now.

Usage: make_tables.py WIGGERS DOCS
"""

import subprocess
import sys
import tempfile
from pathlib import Path

TRADE = (
    (("cell", "ttp06-endo"), ["--tolerance", "apd90=0.01ms"]),
    (("cell", "crn"), ["--tolerance", "apd90=0.01ms"]),
    (("force", "fedele2023-ventricles"), ["--tolerance", "tension=0.5%"]),
    (("force", "fedele2023-atria"), ["--tolerance", "tension=0.5%"]),
    (("loop",), ["--tolerance", "pressure=0.01mmHg"]),
    (("heart", "scenes/whole_heart.toml"), ["--tolerance", "p_LV=0.1mmHg", "--tolerance", "Q_AV=5mL/s"]),
)
EXTREMES = ("ttp06-endo", "crn", "rdq20", "loop", "scenes/whole_heart.toml")


def run(*words):
    print(" ".join(map(str, words)), flush=True)
    return subprocess.run([*map(str, words)], check=True, capture_output=True, text=True).stdout


def main(wiggers, docs):
    docs = Path(docs)
    text = [
        "# Error against cost\n",
        "Written by `make trade`; every table by one command, on one core of one machine. Costs are of that machine, "
        "ratios and errors travel. `--accuracy` picks from these tables (heart/scene/accuracy.cpp).\n",
    ]
    for words, tolerances in TRADE:
        with tempfile.TemporaryDirectory() as folder:
            run(wiggers, "trade", *words, *tolerances, "--quiet", "-o", folder)
            text.append(f"## `wiggers trade {' '.join(words)} {' '.join(tolerances)}`\n")
            text.append((Path(folder) / "trade.md").read_text())
    (docs / "trade.md").write_text("\n".join(text))
    text = [
        "# Stability at the extremes\n",
        "Written by `make trade` from `wiggers extremes`. A large stable step says little: exponential and implicit "
        "schemes survive steps at which they are wrong by tens of milliseconds; hence the columns beside it.\n",
    ]
    for subject in EXTREMES:
        text.append(f"## `wiggers extremes {subject}`\n")
        text.append(run(wiggers, "extremes", subject, "--quiet"))
    (docs / "extremes.md").write_text("\n".join(text))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2])
