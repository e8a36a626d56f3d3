"""The limit cycles of the ionic models over rates and current blocks, as `wiggers cell --until limit-cycle` certifies
them from the published start, written as a table: python docs/make_cell_cycles.py build/wiggers docs/cell-cycles.md
"""

import argparse
import json
import subprocess
from pathlib import Path

MODELS = ("crn", "ttp06-endo", "ttp06-mid", "ttp06-epi")
BLOCKS = {"none": None, "half of g_Kr": ("g_Kr", 0.5), "half of g_CaL": ("g_CaL", 0.5)}
PERIODS = sorted({round(250 * 8 ** (k / 29) / 5) * 5 for k in range(30)})


def defaults(command, model):
    """Default of each parameter, from the model's own fact sheet."""
    text = subprocess.run([command, "models", model], capture_output=True, text=True, check=True).stdout
    values = {}
    for line in text.splitlines():
        words = line.split()
        for name in ("g_Kr", "g_CaL"):
            if words and words[0] == name:
                values[name] = float(next(w for w in words[1:] if _is_number(w)))
    return values


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def cycle(command, model, period, change):
    words = [command, "cell", model, "--period-ms", str(period), "--until", "limit-cycle", "--distance", "1e-4",
             "--max-beats", "4000", "--quiet", "--json"]
    if change:
        words += ["--set", f"{change[0]}={change[1]:.17g}"]
    run = subprocess.run(words, capture_output=True, text=True)
    lines = [line for line in run.stdout.splitlines() if line.startswith("{")]
    if not lines:
        return {"text": run.stderr.strip().splitlines()[-1][:60]}
    summary = json.loads(lines[-1])
    found = summary["limit_cycle"]
    beats = summary.get("beats_of_cycle", [summary["features"]])
    peaks = ", ".join(f"{b['V_peak_mV']:.1f}" for b in beats)
    apd = ", ".join(f"{b['APD90_ms']:.0f}" if "APD90_ms" in b else "-" for b in beats)
    return {"text": f"{found['verdict']}: {peaks} mV; APD90 {apd} ms; {found['beats']} beats", "verdict": found["verdict"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command")
    parser.add_argument("page", type=Path)
    parser.add_argument("--periods", type=int, nargs="*", default=PERIODS)
    options = parser.parse_args()
    known = {model: defaults(options.command, model) for model in MODELS}
    out = ["# Limit cycles of the ionic models", "",
           "Made by `make cell-cycles`: `wiggers cell MODEL --period-ms T --until limit-cycle --distance 1e-4` from the published",
           "state, with cvode at its defaults. Highest potential and APD90 of each beat of the cycle; beats spent, the search's",
           "own included. A beat without APD90 is blocked, or has not repolarised by 90 % when the next stimulus comes. `not-converged`: no",
           "rhythm of up to 8 beats was found in 4000; most of these cells miss a calcium release now and then, after more beats.", ""]
    verdicts = {}
    for model in MODELS:
        out += [f"## {model}", "", "| period, ms | " + " | ".join(BLOCKS) + " |", "|" + "---|" * (len(BLOCKS) + 1)]
        for period in options.periods:
            cells = []
            for block in BLOCKS.values():
                change = (block[0], block[1] * known[model][block[0]]) if block else None
                entry = cycle(options.command, model, period, change)
                verdicts[entry.get("verdict", "failed")] = verdicts.get(entry.get("verdict", "failed"), 0) + 1
                cells.append(entry["text"])
            out.append(f"| {period} | " + " | ".join(cells) + " |")
            print(model, out[-1], flush=True)
        out.append("")
    out.insert(7, "Of all: " + ", ".join(f"{n} {v}" for v, n in sorted(verdicts.items(), key=lambda x: -x[1])) + ".")
    out.insert(8, "")
    options.page.write_text("\n".join(out))


if __name__ == "__main__":
    main()
