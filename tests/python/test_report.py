"""The report: pictures that are there and not empty, one self-contained page, honest about incomplete runs."""

import re

import pytest
from conftest import SCENES


@pytest.mark.parametrize("scene", ["whole_heart", "elastance_healthy", "mixed", "triseg", "no_stress_stabilisation"])
def test_report_of_a_scene(wiggers, tmp_path, scene):
    assert wiggers("run", SCENES / f"{scene}.toml", "-o", "r.h5", "--quiet").status == 0
    outcome = wiggers("report", "r.h5", "-o", "report")
    assert outcome.status == 0, outcome.err
    folder = tmp_path / "report"
    assert {p.name for p in folder.iterdir()} == {"index.html", "wiggers.png", "wiggers.svg", "pv_loops.png", "pv_loops.svg"}
    for name in ("wiggers.png", "pv_loops.png"):
        data = (folder / name).read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) > 40_000
    page = (folder / "index.html").read_text()
    assert page.count("<svg") == 2
    assert not re.search(r"(src|href)=[\"']https?://", page)  # self-contained (namespaces of SVG are no links)
    for text in ("end-diastolic volume", "reference", "limit cycle", "blood volume drift", "[walls.LA]"):
        assert text in page
    if scene == "no_stress_stabilisation":
        assert "oscillate" in page


def test_the_default_folder_stands_beside_the_result(wiggers, tmp_path):
    assert wiggers("run", SCENES / "elastance_healthy.toml", "-o", "heart.h5", "--quiet").status == 0
    assert wiggers("report", "heart.h5").status == 0
    assert (tmp_path / "heart-report" / "index.html").exists()
