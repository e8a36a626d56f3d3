"""The whole heart as one body of 3D tissue: its scene on a coarse mesh."""

import re

import h5py
import numpy as np
import pytest
from conftest import SCENES
from tissue_runs import run, same_but_round_off, sets

SCENE = SCENES / "whole_heart_3d.toml"
CHAMBERS = ("LA", "LV", "RA", "RV")
# A draft of the draft: its front is carried by a better conductor, its cells start from their published states.
COARSE = sets(walls__heart__size_mm=9, cells__atria__start="published", cells__ventricles__start="published", run__beats=1,
              run__stop_after_ms=30, walls__heart__fields_every_ms=10)
for kind in ("conductivity", "atrial_conductivity"):
    for direction in ("fibre", "sheet", "normal"):
        COARSE += ["--set", f"walls.heart.electrophysiology.{kind}.{direction}_mm2_per_ms=1.5"]


@pytest.fixture(scope="module")
def beginning(tmp_path_factory):
    """The first 30 ms on two ranks."""
    folder = tmp_path_factory.mktemp("heart")
    outcome = run("run", SCENE, *COARSE, "-o", "r.h5", ranks=2, cwd=folder)
    assert outcome.status in (0, 1), outcome.err  # a part of a beat is no limit cycle
    return folder / "r.h5", outcome


def test_the_atria_begin_and_no_linear_system_is_left(beginning):
    path, outcome = beginning
    sites = re.findall(r"stimulus \d at \(([-\d.]+), ([-\d.]+), ([-\d.]+)\) mm", outcome.out)
    assert len(sites) == 6
    with h5py.File(path) as file:
        figures = {name: item[()] for name, item in file["solver/walls/heart"].items()}
        assert figures["direct_solves"] == figures["rejected_steps"] == 0
        assert figures["solver_iterations"] <= 25 * figures["solves"]
        assert figures["steps"] == 30
        traces = {name: item[()] for name, item in file["cells/heart"].items()}
        volumes = {chamber: file[f"cavities/{chamber}/volume"][()] for chamber in CHAMBERS}
        pressures = {chamber: file[f"cavities/{chamber}/pressure"][()] for chamber in CHAMBERS}
    for chamber in CHAMBERS:
        assert {f"{name}_{chamber}" for name in ("active_tension", "stretch", "smallest_volume_ratio", "wall_volume")} <= set(traces)
        assert 0.5 < traces[f"smallest_volume_ratio_{chamber}"].min() <= 1.0
        wall = traces[f"wall_volume_{chamber}"]
        assert 0.9 * wall[0] < wall.min() <= wall.max() < 1.1 * wall[0]
        assert np.isfinite(volumes[chamber]).all() and np.isfinite(pressures[chamber]).all()
    # The smallest of all is that of a chamber or of what is no muscle; tensions are of the chambers alone.
    assert traces["smallest_volume_ratio"].min() <= min(traces[f"smallest_volume_ratio_{c}"].min() for c in CHAMBERS) + 1e-9
    rise = {chamber: np.ptp(traces[f"active_tension_{chamber}"]) for chamber in CHAMBERS}
    assert rise["RA"] > 10 * max(rise["LV"], rise["RV"])  # the ventricles wait
    # Walls of the left ventricle are the thickest.
    assert traces["wall_volume_LV"][0] > 1.5 * traces["wall_volume_RV"][0] > traces["wall_volume_RA"][0]
    assert abs(traces["base_motion"]).max() < 20 and abs(traces["apex_motion"]).max() < 20


def test_ranks_agree(tmp_path):
    """From one unloaded shape: what recovery settles for differs by more between partitions, within its tolerance."""
    for ranks in (1, 2):
        outcome = run("run", SCENE, *COARSE, *sets(walls__heart__reference__recover="false"), "-o", f"{ranks}.h5", ranks=ranks, cwd=tmp_path)
        assert outcome.status in (0, 1), outcome.err
    same_but_round_off(tmp_path / "1.h5", tmp_path / "2.h5", 1e-4, wall="heart")


@pytest.mark.parametrize("change, words", [
    (("walls.heart.stimuli.sinus_node.site=sinus-nod",), "did you mean 'sinus-node'"),
    (("walls.heart.stimuli.sinus_node.x_mm=3",), "x_mm"),
    (("walls.heart.stimuli.sinus_node.height=0.5",), "height"),
    (("walls.heart.stimuli.LV_septum.height=1.5",), "0 to 1"),
])
def test_wrong_sites_are_refused_before_any_work(change, words, tmp_path):
    refused = run("run", SCENE, *[word for key in change for word in ("--set", key)], cwd=tmp_path)
    assert refused.status == 2
    assert words in refused.err + refused.out


def test_a_site_that_the_mesh_does_not_have_is_named(tmp_path):
    refused = run("run", SCENES / "left_ventricle_3d.toml", *sets(walls__LV__size_mm=12, cells__atria__start="published",
                  cells__ventricles__start="published"), "--set", "walls.LV.stimuli.more.site=LV-septum", cwd=tmp_path)
    assert refused.status == 2
    assert "one ventricle alone" in refused.err and "walls.LV.stimuli" in refused.err
