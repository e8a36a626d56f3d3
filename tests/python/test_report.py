"""The report: pictures that are there and not empty, one self-contained page, honest about incomplete runs."""

import json
import re
import shutil
import subprocess

import h5py
import numpy as np
import pytest
from conftest import COMMAND, SCENES


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


@pytest.fixture(scope="module")
def heart(tmp_path_factory):
    path = tmp_path_factory.mktemp("heart") / "r.h5"
    subprocess.run([COMMAND, "run", SCENES / "elastance_healthy.toml", "-o", path, "--quiet"], check=True, capture_output=True)
    return path


def report(folder, *words, before="", **more):
    process = subprocess.run(["bash", "-c", f'{before} exec "$0" report "$@"', COMMAND, *map(str, words)], cwd=folder,
                             capture_output=True, text=True, timeout=120, **more)
    assert "Traceback" not in process.stderr + process.stdout
    return process


def test_a_full_disk_leaves_the_earlier_page(heart, tmp_path):
    """A limit on file size stands for a full disk."""
    assert report(tmp_path, heart, "-o", "page").returncode == 0
    before = {p.name: p.read_bytes() for p in (tmp_path / "page").iterdir()}
    process = report(tmp_path, heart, "-o", "page", before="ulimit -f 16;")
    assert process.returncode == 1 and "cannot write" in process.stderr and "Free some space" in process.stderr
    assert (tmp_path / "page" / "index.html").read_bytes() == before["index.html"]
    assert {p.name for p in (tmp_path / "page").iterdir()} == set(before)
    process = report(tmp_path, heart, "-o", "new", before="ulimit -f 16;")
    assert process.returncode == 1 and not (tmp_path / "new" / "index.html").exists()


@pytest.mark.parametrize("damage, said", [
    (lambda f: f.__delitem__("cavities/LV"), "cavities/LV"),
    (lambda f: f.__delitem__("summary"), "summary"),
    (lambda f: (f.__delitem__("summary"), f.__setitem__("summary", b"{ no json")), "JSON"),
    (lambda f: (f.__delitem__("time"), f.__setitem__("time", b"words")), "damaged"),
    (lambda f: (f.__delitem__("provenance/scene"), f.__setitem__("provenance/scene", b"= no toml")), "TOML"),
])
def test_a_damaged_result_is_told_in_one_line(heart, tmp_path, damage, said):
    shutil.copy(heart, tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "a") as file:
        damage(file)
        file["provenance"].pop("checksums", None)  # as written by others: what it says is looked at all the same
    process = report(tmp_path, "r.h5")
    assert process.returncode == 2, process.stderr
    assert "r.h5" in process.stderr and said in process.stderr and process.stderr.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["r.h5"]


def test_a_truncated_result(heart, tmp_path):
    data = heart.read_bytes()
    (tmp_path / "r.h5").write_bytes(data[: len(data) // 2])
    process = report(tmp_path, "r.h5")
    assert process.returncode == 2 and "damaged" in process.stderr


def test_what_python_does_not_have_is_named(heart, tmp_path):
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "h5py.py").write_text("raise ModuleNotFoundError(\"No module named 'h5py'\", name='h5py')\n")
    process = report(tmp_path, heart, before=f"export PYTHONPATH={tmp_path}/modules;")
    assert process.returncode == 1 and "no module h5py" in process.stderr and process.stderr.count("\n") == 1
    process = report(tmp_path, heart, before="export WIGGERS_PYTHON=/no/python;")
    assert process.returncode == 1 and "/no/python" in process.stderr


def test_texts_of_a_file_are_no_code(wiggers, heart, tmp_path):
    """Titles, names, units, meanings and warnings; nor do dollars make a title a formula."""
    evil = "<script>alert('x')</script> $\\frac{1$"
    shutil.copy(heart, tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "a") as file:
        file["provenance"].pop("checksums", None)  # as written by others
        summary = json.loads(file["summary"][()])
        summary["title"] = evil
        summary["warnings"] = [evil]
        summary["limit_cycle"]["verdict"] = evil
        summary["cells"] = {evil: {"limit_cycle": summary["limit_cycle"], "calcium_min_uM": 0.1, "calcium_max_uM": 1.0}}
        for name, text in (("summary", json.dumps(summary)), ("provenance/title", evil), ("provenance/version", evil),
                           ("provenance/status", evil)):
            del file[name]
            file[name] = np.bytes_(text.encode())
        for item in file["reference_ranges"].values():
            item["value"].attrs["unit"] = np.bytes_(evil.encode())
        figure = file.create_dataset("solver/walls/LV/tetrahedra", data=7.0)
        figure.attrs["unit"] = figure.attrs["meaning"] = np.bytes_(evil.encode())
        scene = file["provenance/scene"][()].decode().replace('title = "', 'title = "<script>', 1)
        del file["provenance/scene"]
        file["provenance/scene"] = np.bytes_(scene.encode())
    process = report(tmp_path, "r.h5", "-o", "page")
    assert process.returncode == 0, process.stderr
    for path in (tmp_path / "page").iterdir():
        if path.suffix in (".html", ".svg"):
            text = path.read_text()
            assert "<script" not in text and "script" in text, path


def test_the_result_is_not_replaced_by_its_report(heart, tmp_path):
    for name in ("index.html", "wiggers.png"):
        shutil.copy(heart, tmp_path / name)
        process = report(tmp_path, name, "-o", ".")
        assert process.returncode == 2 and "name another file" in process.stderr
        assert (tmp_path / name).read_bytes() == heart.read_bytes()
        assert [p.name for p in tmp_path.iterdir()] == [name]
        (tmp_path / name).unlink()



def test_a_result_that_was_changed_since_is_not_drawn(heart, tmp_path):
    shutil.copy(heart, tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "a") as file:
        file["cavities/LV/volume"][0:400] = -500
    process = report(tmp_path, "r.h5")
    assert process.returncode == 2 and "cavities/LV/volume" in process.stderr and "checksum" in process.stderr


def test_sizes_that_a_file_only_claims_are_refused_before_memory_is_taken(wiggers, heart, tmp_path):
    """Files of others have no checksums: what their entries claim is looked at all the same."""

    def changed(change):
        path = tmp_path / "r.h5"
        shutil.copy(heart, path)
        with h5py.File(path, "r+") as file:
            del file["provenance/checksums"]
            change(file)
        return wiggers("report", path, "-o", tmp_path / "page")

    def claim(file):
        del file["time"]
        file.create_dataset("time", shape=(1 << 45,), dtype="f8", chunks=(1000,))

    def link(file):
        del file["time"]
        file["time"] = h5py.ExternalLink("elsewhere.h5", "/time")

    for change, words in ((claim, "entry /time claims"), (link, "entry /time is a link to another place")):
        outcome = changed(change)
        assert outcome.status == 2, outcome.err
        assert words in outcome.err
        assert not (tmp_path / "page").exists()
