"""Makes the report of one result file: pictures (PNG, of a heart SVG too) and one self-contained HTML file.

Usage: make_report.py RESULT FOLDER DESCRIPTOR      (started by `wiggers report`, which writes what comes; see answer.py)
"""

import io
import sys
import warnings

from answer import answer_with


def make(result_path, answer):
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["text.parse_math"] = False  # texts of the file are shown as they stand
    warnings.filterwarnings("ignore", message="Glyph")  # of a title that the font lacks: an empty box is drawn
    from body import is_body, report_body

    if not is_body(result_path):
        report_heart(result_path, answer)
        return
    page, pictures, trouble = report_body(result_path, answer)
    if trouble:
        answer.say(trouble)
    answer.say(f"report: {page}")
    answer.say(f"pictures: {', '.join(map(str, pictures))}")


def report_heart(result_path, answer):
    from figures import pv_loops, wiggers_diagram
    from page import write_page
    from result import Result
    from tissue import make_tissue_pictures, tissue_walls
    from tissue_page import tissue_section

    result = Result(result_path)
    pictures = {}
    for name, draw in (("wiggers", wiggers_diagram), ("pv_loops", pv_loops)):
        figure = draw(result)
        for ending in ("png", "svg"):
            drawn = io.BytesIO()
            figure.savefig(drawn, dpi=160, format=ending)
            pictures[name, ending] = answer.file(f"{name}.{ending}", drawn.getvalue())
    sections, tissue_pictures = [], []
    for wall in tissue_walls(result):
        made = make_tissue_pictures(wall, answer)
        sections.append(tissue_section(wall, made))
        tissue_pictures += made.values()
        if wall.trouble:
            answer.say(wall.trouble)
    drawings = {name: pictures[name, "svg"] for name in ("wiggers", "pv_loops")}
    page = write_page(answer, result, drawings, sections)
    answer.say(f"report: {page}")
    answer.say(f"pictures: {pictures['wiggers', 'png']}, {pictures['pv_loops', 'png']} (and .svg)")
    if tissue_pictures:
        answer.say(f"pictures of the tissue: {', '.join(map(str, tissue_pictures))}")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    answer_with(make, *sys.argv[1:])
