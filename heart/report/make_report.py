"""Makes the report of one result file: pictures (PNG, of a heart SVG too) and one self-contained HTML file.

Usage: make_report.py RESULT.h5 FOLDER
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from body import is_body, report_body  # noqa: E402
from figures import pv_loops, wiggers_diagram  # noqa: E402
from page import write_page  # noqa: E402
from result import Result  # noqa: E402
from tissue import make_tissue_pictures, tissue_walls  # noqa: E402
from tissue_page import tissue_section  # noqa: E402


def main(result_path, folder):
    folder = Path(folder)
    if is_body(result_path):
        folder.mkdir(parents=True, exist_ok=True)
        page, pictures, trouble = report_body(result_path, folder)
        if trouble:
            print(trouble)
        print(f"report: {page}")
        print(f"pictures: {', '.join(map(str, pictures))}")
        return
    result = Result(result_path)
    folder.mkdir(parents=True, exist_ok=True)
    report_heart(result, folder)


def report_heart(result, folder):
    pictures = {}
    for name, make in (("wiggers", wiggers_diagram), ("pv_loops", pv_loops)):
        figure = make(result)
        for ending in ("png", "svg"):
            figure.savefig(folder / f"{name}.{ending}", dpi=160)
        pictures[name] = folder / f"{name}.svg"
    sections, tissue_pictures = [], []
    for wall in tissue_walls(result):
        made = make_tissue_pictures(wall, folder)
        sections.append(tissue_section(wall, made))
        tissue_pictures += made.values()
        if wall.trouble:
            print(wall.trouble)
    page = folder / "index.html"
    write_page(page, result, pictures, sections)
    print(f"report: {page}")
    print(f"pictures: {folder / 'wiggers.png'}, {folder / 'pv_loops.png'} (and .svg)")
    if tissue_pictures:
        print(f"pictures of the tissue: {', '.join(map(str, tissue_pictures))}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2])
