"""Draws error against cost of a trade study, with its Pareto front.

Usage: make_trade.py STUDY FOLDER DESCRIPTOR      (reads STUDY, trade.json; started by `wiggers trade`, which writes what
comes; see answer.py)
"""

import io
import json
import sys
from pathlib import Path

from answer import answer_with


def draw(study):
    import matplotlib.pyplot as plt
    from figures import STYLE

    measure = study["measures"][0]
    # Rows that failed have no errors; null is a measure that was not reached, as activation where conduction fails.
    rows = [row for row in study["rows"] if "errors" in row and row["errors"][0] is not None]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.5, 5))
        floor = 0.5 * min(row["errors"][0] for row in rows if row["errors"][0] > 0)
        for k, method in enumerate(methods):
            mine = sorted((row for row in rows if row["method"] == method), key=lambda row: row["cost_s"])
            axes.plot(
                [1e3 * row["cost_s"] for row in mine],
                [max(row["errors"][0], floor) for row in mine],
                marker="osD^v<>pP*"[k % 10],
                markersize=4,
                linewidth=0.8,
                color=plt.get_cmap("tab20")(k % 20),
                label=method,
            )
        front = [row for row in rows if row.get("pareto")]
        front.sort(key=lambda row: row["cost_s"])
        axes.plot(
            [1e3 * row["cost_s"] for row in front],
            [max(row["errors"][0], floor) for row in front],
            color="#bbbbbb",
            linewidth=6,
            alpha=0.6,
            zorder=0,
            label="Pareto front",
        )
        for row in rows:
            if row.get("recommended"):
                axes.annotate(
                    f"{row['method']}, {row['setting']}",
                    (1e3 * row["cost_s"], max(row["errors"][0], floor)),
                    textcoords="offset points",
                    xytext=(8, 8),
                    fontsize=8,
                )
        unit = "" if measure["unit"] == "1" else f" [{measure['unit']}]"
        axes.set(
            xscale="log",
            yscale="log",
            xlabel=f"cost of {study['costed']} [ms, one core]",
            ylabel=f"{measure['meaning']}: error{unit}",
            title=study["subject"],
        )
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
        figure.tight_layout()
    return figure


def make(study, answer):
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["text.parse_math"] = False
    figure = draw(json.loads(Path(study).read_text()))
    for ending in ("svg", "png"):
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=160, format=ending)
        picture = answer.file(f"trade.{ending}", drawn.getvalue())
    answer.say(f"picture: {picture}")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    answer_with(make, *sys.argv[1:])
