"""The report of a body of tissue that was run alone: electrophysiology, and mechanics under prescribed loads.

The results are made up (a block of tissue), as tissue/body/body_electrophysiology.cpp and tissue/body/body_mechanics.cpp write
them, so that the tests need no finite elements.
"""

import json
import re
import sys

import h5py
import numpy as np
import pytest
from conftest import ROOT
from test_report_tissue import block, put, write_vtu

sys.path.insert(0, str(ROOT / "heart" / "report"))

import body  # noqa: E402
import vtu  # noqa: E402

ELECTROPHYSIOLOGY_SCENE = """title = "Block"

[heart]
period_s = 0.4

[body]
physics = "electrophysiology"
fields_every_ms = {fields_every_ms}

[body.electrophysiology]
tau_ms = 0.1

[body.electrodes.foot]
z_mm = -250

[body.electrodes.left_side]
x_mm = -120
"""
MECHANICS_SCENE = """title = "Block"

[body]
physics = "mechanics"
fields = {fields}
"""


def write_frames(folder, places, fields_at):
    """Frames of the block at times or shares of the load; `fields_at(place, points)`: its fields."""
    folder.mkdir()
    points, cells, tag = block()
    index = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0">\n  <Collection>\n'
    for k, place in enumerate(places):
        write_vtu(folder / f"frame_{k:06}.vtu", points, cells, tag, fields_at(place, points))
        index += f'    <DataSet timestep="{float(place)!r}" part="0" file="frame_{k:06}.vtu"/>\n'
    (folder / "index.pvd").write_text(index + "  </Collection>\n</VTKFile>\n")


def write_common(file, scene, summary, status, figures):
    for name, text in {"provenance/scene": scene, "provenance/title": "Block", "provenance/version": "wiggers 0",
                       "provenance/status": status, "summary": json.dumps(summary)}.items():
        file[name] = np.bytes_(text)
    for name, (value, unit) in figures.items():
        put(file, f"solver/walls/body/{name}", float(value), unit)


def activation_s(points):
    """The wave starts at the bottom of the block and arrives at its top after 60 ms."""
    return 0.03 + points[:, 2]


def write_electrophysiology(path, end_s=0.3, status="complete", steps_counted=None, fields_every_ms=10):
    t = np.linspace(0, end_s, 1 + round(1e3 * end_s))
    points = block()[0]
    arrival = activation_s(points)
    share = (arrival[:, None] <= t).mean(axis=0)
    activation = np.where(arrival <= end_s, arrival, -1.0)
    reached = activation[activation >= 0]
    summary = {"title": "Block", "physics": "electrophysiology",
               "activation": {"share": share[-1], "first_ms": 1e3 * reached.min(), "last_ms": 1e3 * reached.max()},
               "time_ms": 1e3 * end_s, "cost": {"start_s": 1.25, "run_s": 8.0}, "warnings": ["made up"]}
    figures = {"tetrahedra": (576, "1"), "ranks": (2, "1"), "potential_nodes": (175, "1"),
               "electrophysiology_ionic": (2, "s"), "electrophysiology_solve": (4, "s"),
               "electrophysiology_right_side": (1, "s"), "electrophysiology_assembly": (0.5, "s"),
               "electrophysiology_steps": (steps_counted or 1e4 * end_s, "1"), "electrophysiology_iterations": (9000, "1")}
    with h5py.File(path, "w") as file:
        write_common(file, ELECTROPHYSIOLOGY_SCENE.format(fields_every_ms=fields_every_ms), summary, status, figures)
        put(file, "time", t, "s")
        put(file, "body/activated_share", share)
        put(file, "body/membrane_potential", -85 + 110 * share * np.cos(0.5 * np.pi * t / 0.3), "mV")
        put(file, "body/calcium", 0.1 + 0.7 * np.sin(np.pi * t / 0.3) ** 2, "uM")
        put(file, "body/activation", activation, "s")
        put(file, "body/lead_1", 1e-3 * np.sin(2 * np.pi * t / 0.3), "mV m^2/s")
        put(file, "body/lead_2", 1e-3 * np.cos(2 * np.pi * t / 0.3), "mV m^2/s")


def write_electrophysiology_frames(folder, end_s=0.3):
    def fields(t, points):
        arrival = activation_s(points)
        return {"potential_mV": np.where(arrival <= t, 20.0, -85.0), "activation_s": np.where(arrival <= t, arrival, -1.0),
                "calcium_uM": np.full(len(points), 0.1)}

    write_frames(folder, np.arange(0, end_s + 1e-9, 0.01), fields)


def write_mechanics(path, reached=1.0, status="complete", chambers=("LV", "RV"), fields="true", n_steps=10):
    load = np.linspace(0, 1, n_steps + 1)
    load = load[load <= reached + 1e-9]
    summary = {"title": "Block", "physics": "mechanics", "load": reached, "cavities": {},
               "smallest_volume_ratio": 1 - 0.25 * reached,
               "cost": {"start_s": 1.5, "run_s": 4.25, "newton_iterations": 42}, "warnings": []}
    with h5py.File(path, "w") as file:
        write_common(file, MECHANICS_SCENE.format(fields=fields), summary, status,
                     {"tetrahedra": (576, "1"), "ranks": (2, "1"), "displacement_unknowns": (525, "1")})
        put(file, "load", load)
        for k, chamber in enumerate(chambers):
            put(file, f"cavities/{chamber}/pressure", 20 / (1 + k) * load, "mmHg")
            put(file, f"cavities/{chamber}/volume", 80 + 60 * np.sqrt(load), "mL")
        put(file, "body/stretch", 1 + 0.16 * load)
        put(file, "body/myocardium_volume_ratio", 1 + 0.003 * load)
        put(file, "body/smallest_volume_ratio", 1 - 0.25 * load)


def write_mechanics_frames(folder, reached=1.0):
    write_frames(folder, np.arange(0, reached + 1e-9, 0.1), lambda share, points: {
        "displacement_m": points * [0.3 * share, 0.3 * share, 0.1 * share], "fibre_stretch": 1 + share * (0.1 + points[:, 0])})


@pytest.fixture
def report(wiggers, tmp_path):
    """Makes the report of r.h5 and returns (what the command said, text of the page, names of its pictures)."""

    def make():
        outcome = wiggers("report", "r.h5", "-o", "report")
        assert outcome.status == 0, outcome.err
        folder = tmp_path / "report"
        pictures = {p.name for p in folder.iterdir()} - {"index.html"}
        for name in pictures:
            data = (folder / name).read_bytes()
            assert data.startswith(b"\x89PNG") and len(data) > 8_000, name
        page = (folder / "index.html").read_text()
        assert page.count("<img") == page.count("data:image/png;base64,") == len(pictures)
        assert not re.search(r"(src|href)=[\"']https?://", page)
        return outcome.out, page, pictures

    return make


def pictures_of(*kinds):
    return {f"body_{kind}.png" for kind in kinds}


def test_electrophysiology(report, tmp_path):
    write_electrophysiology(tmp_path / "r.h5")
    write_electrophysiology_frames(tmp_path / "r.body.fields")
    _, page, pictures = report()
    assert pictures == pictures_of("activation", "curves", "leads", "potential", "cost")
    assert "activated: 100.0 % of the nodes, from 0.0 to 60.0 ms" in page
    assert "made up" in page and "not complete" not in page and "There is no folder" not in page
    assert re.search(r"mean potential \[mV\]</td><td>-85\.0</td>", page)
    assert re.search(r"mean calcium \[uM\]</td><td>0\.100</td><td>0</td><td>0\.800</td><td>150<", page)
    assert re.search(r"ionic cells</td><td>2\.000</td><td>25\.0<", page)
    assert re.search(r"rest</td><td>0\.500<", page) and re.search(r"together</td><td>8\.000<", page)
    assert "300 ms of the model in 8.00 s" in page and "was resumed" not in page
    assert re.search(r"potential nodes: made up</td><td>175<", page)
    assert "[body.electrodes.foot]" in page and "Valves" not in page


def test_electrophysiology_that_was_stopped(report, tmp_path):
    """Half of the block is activated; a frame was written after the last checkpoint."""
    write_electrophysiology(tmp_path / "r.h5", end_s=0.03, status="incomplete")
    write_electrophysiology_frames(tmp_path / "r.body.fields", end_s=0.04)
    _, page, pictures = report()
    assert pictures == pictures_of("activation", "curves", "leads", "potential", "cost")
    assert "this run is not complete" in page
    assert re.search(r"<span class='flag'>look</span> activated: 57\.1 % of the nodes, from 0\.0 to 30\.0 ms", page)


def test_costs_of_a_resumed_run_are_said_to_be_of_its_last_part(tmp_path):
    write_electrophysiology(tmp_path / "r.h5", steps_counted=1000)
    tissue = body.ElectrophysiologyBody(body.BodyResult(tmp_path / "r.h5"), "body")
    text = "".join(tissue.cost_parts({}))
    assert "The run was resumed" in text and "electrophysiology: rest" not in text and "linear systems" in text


def test_moments_of_electrophysiology_are_of_the_last_beat(tmp_path):
    write_electrophysiology(tmp_path / "r.h5", end_s=0.8)
    with h5py.File(tmp_path / "r.h5", "a") as file:  # two beats of 0.4 s, the second as the first
        for name in ("activated_share", "membrane_potential"):
            values = file[f"body/{name}"]
            values[401:] = values[1:401]
    tissue = body.ElectrophysiologyBody(body.BodyResult(tmp_path / "r.h5"), "body")
    assert tissue.start_of_last_beat() == pytest.approx(0.4)
    (first, half), (second, peak), (third, _) = tissue.moments()
    assert (first, second, third) == ("half activated", "highest mean potential", "half repolarised")
    assert half == pytest.approx(0.43, abs=2e-3) and peak == pytest.approx(0.46, abs=2e-3)


def test_mechanics(report, tmp_path):
    write_mechanics(tmp_path / "r.h5")
    write_mechanics_frames(tmp_path / "r.body.fields")
    _, page, pictures = report()
    assert pictures == pictures_of("pressure_volume", "load", "deformation")
    assert "load: 100 % of the whole" in page and "not complete" not in page
    assert "<span class='flag'>look</span> smallest volume ratio of an element 0.750, at 100 % of the load" in page
    for heading in ("load [%]", "LV pressure [mmHg]", "RV volume [mL]", "mean fibre stretch", "smallest J"):
        assert f"<th>{heading}</th>" in page
    assert "<tr><td>100.0</td><td>20.000</td><td>140.00</td><td>10.000</td><td>140.00</td><td>1.1600</td><td>1.0030</td><td>0.750</td></tr>" in page
    assert "loading 4.25 s with 42 Newton iterations in 10 steps" in page


def test_mechanics_that_was_stopped(report, tmp_path):
    write_mechanics(tmp_path / "r.h5", reached=0.1, status="incomplete", chambers=("LV",))
    write_mechanics_frames(tmp_path / "r.body.fields", reached=0.2)
    _, page, pictures = report()
    assert pictures == pictures_of("pressure_volume", "load", "deformation")
    assert "this run is not complete" in page and "load: 10 % of the whole" in page and "in 1 step." in page


def test_long_tables_of_the_load_are_thinned_out(tmp_path):
    write_mechanics(tmp_path / "r.h5", n_steps=200)
    table = body.MechanicsBody(body.BodyResult(tmp_path / "r.h5"), "body").rows_table()
    assert "25 of 201 rows" in table and table.count("<tr>") == 26
    assert "<td>0.0</td>" in table and "<td>100.0</td>" in table


@pytest.mark.parametrize(("physics", "off"), [("electrophysiology", True), ("mechanics", False), ("mechanics", True)])
def test_without_fields_the_report_says_so_and_goes_on(report, tmp_path, physics, off):
    if physics == "mechanics":
        write_mechanics(tmp_path / "r.h5", fields="false" if off else "true")
        left, setting = pictures_of("pressure_volume", "load"), "fields = false"
    else:
        write_electrophysiology(tmp_path / "r.h5", fields_every_ms=0 if off else 10)
        left, setting = pictures_of("curves", "leads", "cost"), "fields_every_ms = 0"
    out, page, pictures = report()
    assert pictures == left
    for text in (out, page):
        assert "There is no folder r.body.fields beside the result file" in text
        assert (f"the scene has {setting}" in text) == off


def test_damaged_fields_do_not_stop_the_report(report, tmp_path):
    write_electrophysiology(tmp_path / "r.h5")
    folder = tmp_path / "r.body.fields"
    write_electrophysiology_frames(folder)
    for frame in folder.glob("frame_*.vtu"):
        frame.write_bytes(frame.read_bytes()[:1500])
    _, page, pictures = report()
    assert "cannot be read" in page and pictures == pictures_of("curves", "leads", "cost")


def test_fields_of_another_mesh_are_refused(tmp_path):
    write_electrophysiology(tmp_path / "r.h5")
    write_electrophysiology_frames(tmp_path / "r.body.fields")
    tissue = body.ElectrophysiologyBody(body.BodyResult(tmp_path / "r.h5"), "body")
    tissue.traces["activation"] = np.zeros(7)
    with pytest.raises(vtu.BrokenFields, match="different meshes"):
        body.activation_map(tissue)
