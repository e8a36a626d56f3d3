"""The limit cycles of the ionic models over rates and current blocks, as `wiggers cell --until limit-cycle` certifies
them from the published start, written as a table: python docs/make_cell_cycles.py build/wiggers docs/cell-cycles.md
With --check N so many rows, drawn by --seed from the periods asked for, are compared with plain pacing instead.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
from pathlib import Path

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


def models(command):
    """The models that have the currents to be blocked."""
    names = subprocess.run([command, "models", "--names"], capture_output=True, text=True, check=True).stdout.split()
    return {name: found for name in names if len(found := defaults(command, name)) == 2}


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def cell(command, model, period, change, *words):
    """The summary of a run, or what it said instead."""
    words = [command, "cell", model, "--period-ms", str(period), "--quiet", "--json", *words]
    if change:
        words += ["--set", f"{change[0]}={change[1]:.17g}"]
    run = subprocess.run(words, capture_output=True, text=True)
    lines = [line for line in run.stdout.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else run.stderr.strip().splitlines()[-1]


def search(command, model, period, change):
    return cell(command, model, period, change, "--until", "limit-cycle", "--distance", "1e-4", "--max-beats", "4000")


def cycle(command, model, period, change):
    summary = search(command, model, period, change)
    if isinstance(summary, str):
        return {"text": summary[:60]}
    found = summary["limit_cycle"]
    if found["verdict"] == "not-converged":
        return {"text": f"not-converged: {found.get('reason', '')} {found['beats']} beats", "verdict": found["verdict"]}
    beats = summary.get("beats_of_cycle", [summary["features"]])
    peaks = ", ".join(f"{b['V_peak_mV']:.1f}" for b in beats)
    apd = ", ".join(f"{b['APD90_ms']:.0f}" if "APD90_ms" in b else "-" for b in beats)
    return {"text": f"{found['verdict']}: {peaks} mV; APD90 {apd} ms; {found['beats']} beats", "verdict": found["verdict"]}


# Rhythms up to this one are looked for in the beats of plain pacing.
LONGEST = 40


def paced(command, model, period, change, beats):
    """Features of the last beats of plain pacing."""
    with tempfile.TemporaryDirectory() as folder:
        state = str(Path(folder) / "0.csv")
        cell(command, model, period, change, "--beats", str(beats), "--final-state", state)
        features = []
        for n in range(2 * LONGEST):
            start, state = state, str(Path(folder) / f"{n + 1}.csv")
            beat = cell(command, model, period, change, "--beats", "1", "--start", start, "--final-state", state)
            if isinstance(beat, str):
                raise RuntimeError(beat)
            features.append(beat["features"])
        return features


def rhythm(beats):
    """After how many beats peaks of potential and calcium come back to 2e-4; 0: after none."""
    def differ(a, b):
        return max(abs(a["V_peak_mV"] - b["V_peak_mV"]) / (a["V_peak_mV"] - a["V_min_mV"]),
                   abs(a["calcium_peak_uM"] - b["calcium_peak_uM"]) / a["calcium_peak_uM"])
    for n in range(1, LONGEST + 1):
        if all(differ(a, b) < 2e-4 for a, b in zip(beats, beats[n:])):
            return n
    return 0


def largest_difference(certified, beats):
    """Of peaks and APD90, relative to the amplitude and to themselves, in the order that fits best."""
    def differ(a, b):
        d = abs(a["V_peak_mV"] - b["V_peak_mV"]) / (b["V_peak_mV"] - b["V_min_mV"])
        if ("APD90_ms" in a) != ("APD90_ms" in b):
            return 1
        return max(d, abs(a["APD90_ms"] / b["APD90_ms"] - 1)) if "APD90_ms" in a else d
    n = len(certified)
    return min(max(differ(certified[(k + shift) % n], beats[k]) for k in range(n)) for shift in range(n))


def check(options, known):
    """Rows that do not agree with plain pacing."""
    rows = [(m, p, b) for m in known for p in options.periods for b in BLOCKS]
    wrong = 0
    for model, period, block in random.Random(options.seed).sample(rows, min(options.check, len(rows))):
        change = (BLOCKS[block][0], BLOCKS[block][1] * known[model][BLOCKS[block][0]]) if BLOCKS[block] else None
        summary = search(options.command, model, period, change)
        beats = paced(options.command, model, period, change, options.beats * (4 if model == "crn" else 1))
        seen = rhythm(beats)
        text = f"{model} {period} {block}: pacing {seen or 'irregular'}"
        if isinstance(summary, str):
            good, text = False, f"{text}; {summary}"
        elif summary["limit_cycle"]["verdict"] == "not-converged":
            good = seen == 0 or seen > 8
            text += f"; not-converged, {summary['limit_cycle'].get('reason', '')}"
        else:
            certified = summary.get("beats_of_cycle", [summary["features"]])
            difference = largest_difference(certified, beats[-len(certified):])
            good = seen == len(certified) and difference < 0.01
            text += f"; {summary['limit_cycle']['verdict']}, {100 * difference:.3f} %"
        wrong += not good
        print("agrees" if good else "DIFFERS", text, flush=True)
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command")
    parser.add_argument("page", type=Path, nargs="?")
    parser.add_argument("--periods", type=int, nargs="*", default=PERIODS)
    parser.add_argument("--check", type=int, default=0, help="compare so many rows with plain pacing")
    parser.add_argument("--seed", type=int, default=1, help="of the rows drawn")
    parser.add_argument("--beats", type=int, default=2000, help="of plain pacing; four times as many for crn")
    options = parser.parse_args()
    known = models(options.command)
    if options.check:
        sys.exit(1 if check(options, known) else 0)
    if not options.page:
        parser.error("a page to write, or --check")
    out = ["# Limit cycles of the ionic models", "",
           "Made by `make cell-cycles`: `wiggers cell MODEL --period-ms T --until limit-cycle --distance 1e-4` from the published",
           "state, with cvode at its defaults. Highest potential and APD90 of each beat of the cycle; beats spent, the search's",
           "own included. A beat without APD90 is blocked, or has not repolarised by 90 % when the next stimulus comes. `not-converged`: no",
           "cycle of up to 8 beats within 4000, and what the beats do instead; most of these cells miss a calcium release now and then.",
           "`python docs/make_cell_cycles.py build/wiggers --check 20` compares rows with plain pacing of 2000 beats, crn, which is slower, of 8000.", ""]
    verdicts = {}
    for model in known:
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
    out.insert(8, "Of all: " + ", ".join(f"{n} {v}" for v, n in sorted(verdicts.items(), key=lambda x: -x[1])) + ".")
    out.insert(9, "")
    options.page.write_text("\n".join(out))


if __name__ == "__main__":
    main()
