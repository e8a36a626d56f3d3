"""The report of a run with 3D tissue: reader of the fields, surfaces and sections, pictures and what the page says.

The tissue is a made-up block beside the result of a run without tissue, so that the tests need no finite elements.
"""

import itertools
import json
import re
import shutil
import sys

import h5py
import numpy as np
import pytest
from conftest import ROOT, SCENES

sys.path.insert(0, str(ROOT / "heart" / "report"))

import surface  # noqa: E402
import vtu  # noqa: E402

PICTURES = ("activation", "deformation", "leads", "cost", "convergence")


def block(n=(4, 4, 6), size_m=(0.04, 0.04, 0.06)):
    """A block of tetrahedra around the z axis, tagged 1, its top layer 9."""
    axes = [np.linspace(-0.5 * s, 0.5 * s, k + 1) for k, s in zip(n, size_m)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape([k + 1 for k in n])
    cells, tag = [], []
    for i, j, k in itertools.product(*map(range, n)):
        for way in itertools.permutations(range(3)):  # six tetrahedra along the diagonal of each brick
            corner, path = [i, j, k], [number[i, j, k]]
            for axis in way:
                corner[axis] += 1
                path.append(number[tuple(corner)])
            a, b, c, d = points[path]
            if np.dot(np.cross(b - a, c - a), d - a) < 0:
                path[2], path[3] = path[3], path[2]
            cells.append(path)
            tag.append(9 if k == n[2] - 1 else 1)
    return points, np.array(cells, np.int32), np.array(tag, np.int32)


def write_vtu(path, points, cells, tag, fields):
    """As tissue/body/field_file.cpp writes it."""
    appended = b""

    def array(type_, name, values, components=1):
        nonlocal appended
        data = values.tobytes()
        line = (f'        <DataArray type="{type_}" Name="{name}" NumberOfComponents="{components}" format="appended" '
                f'offset="{len(appended)}"/>\n')
        appended += np.uint64(len(data)).tobytes() + data
        return line

    text = ('<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
            f'header_type="UInt64">\n  <UnstructuredGrid>\n    <Piece NumberOfPoints="{len(points)}" '
            f'NumberOfCells="{len(cells)}">\n      <PointData>\n')
    for name, values in fields.items():
        text += array("Float32", name, np.asarray(values, "<f4"), 3 if np.ndim(values) == 2 else 1)
    text += "      </PointData>\n      <CellData>\n" + array("Int32", "tag", tag)
    text += "      </CellData>\n      <Points>\n" + array("Float64", "Points", points, 3)
    text += "      </Points>\n      <Cells>\n" + array("Int32", "connectivity", cells)
    text += array("Int32", "offsets", 4 * np.arange(1, len(cells) + 1, dtype=np.int32))
    text += array("UInt8", "types", np.full(len(cells), 10, np.uint8))
    text += '      </Cells>\n    </Piece>\n  </UnstructuredGrid>\n  <AppendedData encoding="raw">\n_'
    path.write_bytes(text.encode() + appended + b"\n  </AppendedData>\n</VTKFile>\n")


def write_series(folder, period_s, beats=1, activation=lambda points: 0.2 + points[:, 2], frames_per_beat=8):
    """A block that shortens along z and thickens; in beats before the last nothing is activated."""
    folder.mkdir()
    points, cells, tag = block()
    index = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0">\n  <Collection>\n'
    for k in range(beats * frames_per_beat + 1):
        t = k * period_s / frames_per_beat
        shortening = 0.2 * np.sin(np.pi * t / period_s) ** 2
        stretch = 1 + 0.1 * np.cos(2 * np.pi * t / period_s)
        in_last_beat = t > (beats - 1) * period_s
        write_vtu(folder / f"frame_{k:06}.vtu", points, cells, tag, {
            "displacement_m": points * [0.5 * shortening, 0.5 * shortening, -shortening],
            "potential_mV": np.full(len(points), -80.0),
            "activation_s": activation(points) if in_last_beat else np.full(len(points), -1.0),
            "calcium_uM": np.full(len(points), 0.1),
            "active_tension_Pa": np.full(len(points), 1e4 * shortening),
            "fibre_stretch": stretch + points[:, 0]})
        index += f'    <DataSet timestep="{t!r}" part="0" file="frame_{k:06}.vtu"/>\n'
    (folder / "index.pvd").write_text(index + "  </Collection>\n</VTKFile>\n")


def put(file, name, value, unit="1", meaning="made up"):
    data = file.create_dataset(name, data=value)
    data.attrs["unit"], data.attrs["meaning"] = np.bytes_(unit), np.bytes_(meaning)


@pytest.fixture(scope="module")
def plain_result(tmp_path_factory):
    """A beat of a heart without tissue."""
    import subprocess

    from conftest import COMMAND

    path = tmp_path_factory.mktemp("plain") / "plain.h5"
    subprocess.run([COMMAND, "run", SCENES / "elastance_healthy.toml", "-o", path, "--quiet"], check=True, capture_output=True)
    return path


@pytest.fixture
def tissue_result(plain_result, tmp_path):
    """The same with figures and traces of a tissue wall, without fields. Returns the path and the period (s)."""
    path = tmp_path / "r.h5"
    shutil.copy(plain_result, path)
    with h5py.File(path, "a") as file:
        file["provenance"].pop("checksums", None)  # written by others: nothing to compare with
        t = file["time"][:]
        for key, value in {"electrophysiology": 8, "electrophysiology_ionic": 2, "electrophysiology_solve": 4,
                           "electrophysiology_right_side": 1, "electrophysiology_assembly": 0.5, "active_force": 1,
                           "mechanics_assembly": 3, "mechanics_solve": 6, "deformation": 0.25}.items():
            put(file, f"solver/walls/LV/{key}", 2.0 * value, "s")
        per_beat = file["solver/steps"][()]
        for key, value in {"tetrahedra": 576, "ranks": 2, "potential_nodes": 175, "displacement_unknowns": 525,
                           "steps": 2 * per_beat, "tangents": 4 * per_beat, "residuals": 6 * per_beat, "solves": 4 * per_beat,
                           "solver_iterations": 40 * per_beat, "rejected_steps": 0, "halved_updates": 0,
                           "a_new_count": 7}.items():
            put(file, f"solver/walls/LV/{key}", float(value))
        put(file, "solver/walls/LV/reference_smallest_angle", 12.5, "deg")
        put(file, "cells/LV/smallest_volume_ratio", 1 - 0.3 * np.sin(np.pi * t / t[-1]) ** 2)
        put(file, "cells/LV/lead_1", np.sin(2 * np.pi * t / t[-1]), "mV m")
        put(file, "cells/LV/lead_2", np.cos(2 * np.pi * t / t[-1]), "mV m")
        file["checkpoint/run"][0] = 2
    return path, float(t[-1])


def test_reader_returns_what_was_written(tmp_path):
    points, cells, tag = block()
    displacement = np.random.default_rng(1).normal(size=points.shape)
    write_vtu(tmp_path / "f.vtu", points, cells, tag, {"displacement_m": displacement, "activation_s": points[:, 0]})
    frame = vtu.Frame(tmp_path / "f.vtu")
    assert np.array_equal(frame.points, points) and np.array_equal(frame.cells, cells) and np.array_equal(frame.tag, tag)
    assert np.array_equal(frame.field("displacement_m"), displacement.astype("f4"))
    assert np.array_equal(frame.field("activation_s"), points[:, 0].astype("f4"))
    with pytest.raises(vtu.BrokenFields, match="no field potential_mV"):
        frame.field("potential_mV")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.95])
def test_reader_refuses_what_was_cut_off(tmp_path, share):
    write_vtu(tmp_path / "f.vtu", *block(), {})
    data = (tmp_path / "f.vtu").read_bytes()
    (tmp_path / "f.vtu").write_bytes(data[: int(share * len(data))])
    with pytest.raises(vtu.BrokenFields, match="f.vtu"):
        vtu.Frame(tmp_path / "f.vtu")


def area_vectors(patches):
    a, b, c = np.moveaxis(patches.corners[:, :, :3], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def volume_inside(patches):
    """By the divergence theorem; right only if the surface is closed and its normals point outwards."""
    return np.einsum("tx,tx->", area_vectors(patches), patches.corners[:, :, :3].mean(axis=1)) / 3


def test_surface_and_section_are_closed_and_look_outwards():
    points, cells, tag = block()
    everywhere = np.ones(len(cells), bool)
    whole = surface.outer_patches(points, cells, points[:, 0], everywhere)
    assert np.linalg.norm(area_vectors(whole), axis=1).sum() == pytest.approx(2 * (0.04 * 0.04 + 2 * 0.04 * 0.06))
    assert volume_inside(whole) == pytest.approx(0.04 * 0.04 * 0.06)
    for normal in ([0, 1, 0], [0.6, 0, 0.8], [-0.6, 0.64, 0.48]):
        normal = np.array(normal, float)
        for origin in (np.zeros(3), np.array([0.003, -0.002, 0.004])):
            volumes = []
            for side in (normal, -normal):
                half = surface.clipped(whole, origin, side)
                cut = surface.section(points, cells, points[:, 0], everywhere, origin, side)
                assert np.abs((cut.corners[:, :, :3] - origin) @ side).max() < 1e-15
                closed = surface.joined([half, cut])
                assert np.abs(area_vectors(closed).sum(axis=0)).max() < 1e-15
                assert np.allclose(closed.values(), closed.corners[:, :, 0], atol=1e-15)  # values were interpolated
                volumes.append(volume_inside(closed))
            assert sum(volumes) == pytest.approx(0.04 * 0.04 * 0.06)
            if not origin.any():
                assert volumes[0] == pytest.approx(volumes[1])


def test_splitting_keeps_the_surface():
    points, cells, _ = block()
    whole = surface.outer_patches(points, cells, points[:, 2], np.ones(len(cells), bool))
    levels = np.linspace(-0.03, 0.03, 8)
    bands = surface.split_at(whole, levels)
    fine = surface.refined(bands, 0.002)
    for patches in (bands, fine):
        assert volume_inside(patches) == pytest.approx(volume_inside(whole))
        middle = patches.values().mean(axis=1)
        band = np.clip(np.searchsorted(levels, middle) - 1, 0, 6)
        assert np.all(patches.values() >= levels[band, None] - 1e-12)
        assert np.all(patches.values() <= levels[band + 1, None] + 1e-12)
    edges = np.linalg.norm(fine.corners[:, :, :3] - np.roll(fine.corners[:, :, :3], 1, axis=1), axis=2)
    assert edges.max() <= 0.002 + 1e-12


def test_report_of_a_run_with_tissue(wiggers, tissue_result, tmp_path):
    path, period = tissue_result
    write_series(tmp_path / "r.LV.fields", period, beats=2)
    outcome = wiggers("report", path, "-o", "report")
    assert outcome.status == 0, outcome.err
    folder = tmp_path / "report"
    assert {p.name for p in folder.iterdir()} == {
        "index.html", "wiggers.png", "wiggers.svg", "pv_loops.png", "pv_loops.svg", *(f"LV_{kind}.png" for kind in PICTURES)}
    for kind in PICTURES:
        data = (folder / f"LV_{kind}.png").read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) > 10_000
    page = (folder / "index.html").read_text()
    assert page.count("<img") == page.count("data:image/png;base64,") == len(PICTURES)
    assert not re.search(r"(src|href)=[\"']https?://", page)
    assert "Tissue of LV" in page and "There is no folder" not in page
    # Counted over two beats.
    assert re.search(r"electrophysiology: ionic cells</td><td>2\.000</td><td>11\.0<", page)
    assert re.search(r"electrophysiology: rest</td><td>0\.500<", page)
    assert re.search(r"together</td><td>18\.250<", page)
    assert re.search(r"tetrahedra: made up</td><td>576<", page)
    assert "a new count" in page and "means over 2 beats" in page
    assert "2.00 tangents and 3.00 further residuals a step" in page and "10.0 iterations a linear system" in page
    assert "smallest volume ratio of an element 0.700" in page


def test_frames_of_the_last_beat_are_used(tissue_result, tmp_path):
    path, period = tissue_result
    write_series(tmp_path / "r.LV.fields", period, beats=2)
    from result import Result
    from tissue import tissue_walls

    (wall,) = tissue_walls(Result(path))
    assert [t for t, _ in wall.frames] == pytest.approx(np.linspace(0, period, 9))
    assert wall.frame_at(period)[1].field("activation_s").max() > 0
    assert wall.beats_measured() == 2


@pytest.mark.parametrize("activation", ["none", "half"])
def test_tissue_that_is_not_activated_is_grey(wiggers, tissue_result, tmp_path, activation):
    path, period = tissue_result
    late = -0.5 if activation == "none" else 0.0
    write_series(tmp_path / "r.LV.fields", period, beats=2, activation=lambda p: np.where(p[:, 2] < late, 0.2 + p[:, 0], -1.0))
    outcome = wiggers("report", path, "-o", "report")
    assert outcome.status == 0, outcome.err
    assert (tmp_path / "report" / "LV_activation.png").stat().st_size > 10_000


def test_without_fields_the_report_says_so_and_goes_on(wiggers, tissue_result, tmp_path):
    path, _ = tissue_result
    outcome = wiggers("report", path, "-o", "report")
    assert outcome.status == 0, outcome.err
    assert "no folder r.LV.fields" in outcome.out
    page = (tmp_path / "report" / "index.html").read_text()
    assert "There is no folder r.LV.fields beside the result file" in page
    assert page.count("<img") == 3 and not (tmp_path / "report" / "LV_activation.png").exists()


@pytest.mark.parametrize("damage", ["frames", "index", "one frame"])
def test_damaged_fields_do_not_stop_the_report(wiggers, tissue_result, tmp_path, damage):
    path, period = tissue_result
    folder = tmp_path / "r.LV.fields"
    write_series(folder, period, beats=2)
    if damage == "index":
        (folder / "index.pvd").unlink()
    for frame in sorted(folder.glob("frame_*.vtu"))[8 if damage == "one frame" else 0 :]:
        if damage == "frames":
            frame.write_bytes(frame.read_bytes()[:1500])
        elif damage == "one frame":
            frame.unlink()
    outcome = wiggers("report", path, "-o", "report")
    assert outcome.status == 0, outcome.err
    page = (tmp_path / "report" / "index.html").read_text()
    assert "cannot be read" in page and page.count("<img") == 3


def test_without_tissue_nothing_is_added(wiggers, plain_result, tmp_path):
    assert wiggers("report", plain_result, "-o", "report").status == 0
    assert {p.name for p in (tmp_path / "report").iterdir()} == {
        "index.html", "wiggers.png", "wiggers.svg", "pv_loops.png", "pv_loops.svg"}
    page = (tmp_path / "report" / "index.html").read_text()
    assert "Tissue" not in page and "<img" not in page


SEVERAL = {"ventricles": ("LV", "RV"), "heart": ("LV", "RV", "LA", "RA")}


@pytest.fixture
def part_of_beat(plain_result, tmp_path):
    """Makes a result that was ended within a beat, of a body around several cavities. Returns the path and its end (s)."""

    def make(wall, beats_before=0, rows=101):
        path = tmp_path / "part.h5"
        shutil.copy(plain_result, path)
        with h5py.File(path, "a") as file:
            file["provenance"].pop("checksums", None)  # written by others: nothing to compare with
            for name in ("reference_ranges", "phases", "indexes", "cells"):
                if name in file:
                    del file[name]
            tables = []
            file.visititems(lambda name, item: tables.append(name) if isinstance(item, h5py.Dataset) and item.shape else None)
            for name in tables:
                if name.startswith("checkpoint"):
                    continue
                attributes, values = dict(file[name].attrs), file[name][:rows]
                del file[name]
                file.create_dataset(name, data=values).attrs.update(attributes)
            summary = json.loads(file["summary"][()].decode())
            del summary["indexes"], file["summary"]
            summary["limit_cycle"]["beats"] = beats_before
            summary["audits"]["volume_mismatch_mL"] = 0.0
            summary["warnings"] = ["the run was ended within a beat: there are no indexes", "another warning"]
            file["summary"] = np.bytes_(json.dumps(summary))
            file["checkpoint/run"][0] = beats_before
            t = file["time"][:]
            put(file, f"solver/walls/{wall}/electrophysiology", 3.0, "s")
            put(file, f"solver/walls/{wall}/mechanics_solve", 6.0, "s")
            put(file, f"solver/walls/{wall}/steps", 104.0)
            put(file, f"cells/{wall}/membrane_potential", np.full(rows, -80.0), "mV")
            put(file, f"cells/{wall}/smallest_volume_ratio", 1 - 0.1 * t / t[-1])
            put(file, f"cells/{wall}/lead_1", np.sin(2 * np.pi * t / t[-1]), "mV m^2/s")
        return path, float(t[-1])

    return make


@pytest.mark.parametrize("wall", SEVERAL)
def test_report_of_a_run_ended_within_its_first_beat(wiggers, part_of_beat, tmp_path, wall):
    path, end = part_of_beat(wall)
    write_series(tmp_path / f"part.{wall}.fields", end, frames_per_beat=4)
    outcome = wiggers("report", path, "-o", "report")
    assert outcome.status == 0, outcome.err
    assert {p.name for p in (tmp_path / "report").iterdir()} == {
        "index.html", "wiggers.png", "wiggers.svg", "pv_loops.png", "pv_loops.svg", *(f"{wall}_{kind}.png" for kind in PICTURES)}
    page = (tmp_path / "report" / "index.html").read_text()
    assert f"This run was ended within its first beat, at {1e3 * end:g} ms" in page
    assert page.index("ended within its first beat") < page.index("<svg")
    assert page.count("there are no indexes") == 1 and "another warning" in page
    for text in ("<h2>Indexes", "reference ranges", "<h2>Valves", "limit cycle: ", "phases", "ECG is", "last beat", "per beat",
                 "end of diastole", "energy: "):
        assert text not in page, text
    assert f"of the cavities {', '.join(SEVERAL[wall])}," in page
    assert re.search(r"mechanics: linear systems</td><td>6\.000</td><td>66\.7<", page)  # of what was run
    assert "sums over the run" in page


def test_views_of_a_part_of_a_beat_name_every_cavity(part_of_beat, tmp_path):
    path, end = part_of_beat("ventricles")
    write_series(tmp_path / "part.ventricles.fields", end, frames_per_beat=4)
    from figures import pv_loops
    from result import Result
    from tissue import lead_chart, tissue_walls

    result = Result(path)
    (wall,) = tissue_walls(result)
    names, times = zip(*wall.moments())
    assert names[0] == "start of the beat" and names[-1] == "end of the run" and times[0] == 0 and times[-1] == end
    first = [f"{chamber} {result.volume[chamber][0]:.0f} mL, {result.pressure[chamber][0]:.0f} mmHg" for chamber in ("LV", "RV")]
    assert wall.heading("start", 0.0).split("\n") == ["start, 0 ms", *first]
    assert "[mV m²/s, no absolute scale]" in lead_chart(wall, "leads", wall.lead_unit())._suptitle.get_text()
    curve = pv_loops(result).axes[0].lines[0]
    assert np.array_equal(curve.get_xdata(), result.volume["LV"])  # open, all that was run
    assert result.ecg_surrogate() is None  # the ventricles have no trace of their own


def test_run_ended_within_a_later_beat(part_of_beat, tmp_path):
    path, end = part_of_beat("ventricles", beats_before=2)
    from result import Result
    from tissue import tissue_walls

    result = Result(path)
    period = result.period
    assert period > 1.5 * end
    write_series(tmp_path / "part.ventricles.fields", period, beats=3, frames_per_beat=16)
    (wall,) = tissue_walls(result)
    assert wall.frames[0][0] == pytest.approx(0) and wall.frames[-1][0] <= end + 1e-6
    assert f"within beat 3, at {1e3 * (2 * period + end):g} ms ({1e3 * end:g} ms into the beat)" in result.what_is_missing()


def test_fields_of_another_run_are_not_drawn(part_of_beat, tmp_path):
    path, end = part_of_beat("ventricles")
    with h5py.File(path, "a") as file:
        file["provenance"].pop("checksums", None)  # written by others: nothing to compare with
        scene = file["provenance/scene"][()].decode() + '\n[walls.ventricles]\nkind = "tissue"\nfields_every_ms = 0\n'
        del file["provenance/scene"]
        file["provenance/scene"] = np.bytes_(scene)
    write_series(tmp_path / "part.ventricles.fields", end, frames_per_beat=4)
    from result import Result
    from tissue import tissue_walls

    (wall,) = tissue_walls(Result(path))
    assert not wall.frames and "part.ventricles.fields are of another run" in wall.trouble
