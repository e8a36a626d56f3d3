"""Nightly: random hearts within the declared ranges. What ends well is a heart that can be, by its traces; every other
end is named. WIGGERS_RANDOM_HEARTS says how many (default 40)."""

import json
import os
import random
import subprocess

import h5py
import wiggers
from conftest import COMMAND, SCENES

HEARTS = ["elastance_healthy.toml", "whole_heart.toml", "mixed.toml", "triseg.toml", "atria_passive.toml"]


def numbers_of(scene):
    """Names, values and ranges of the numbers that a scene may set; a TriSeg wall's are those of the rest of the heart."""
    base = SCENES / ("whole_heart.toml" if scene == "triseg.toml" else scene)
    parameters = wiggers.Heart(base).parameters
    facts = [parameters.info(name) for name in parameters]
    if scene == "triseg.toml":
        facts = [f for f in facts if not f.name.startswith(("walls.LV", "walls.RV"))]
    return [f for f in facts if "ionic_changes" not in f.name]


def draw(dice, facts):
    settings = []
    for fact in dice.sample(facts, dice.randint(1, 6)):
        value = fact.value * 10 ** dice.uniform(-1, 1) if fact.value else dice.uniform(fact.lower, fact.upper) * 1e-3
        settings += ["--set", f"{fact.name}={min(max(value, fact.lower), fact.upper):.6g}"]
    return settings


def test_random_hearts(tmp_path):
    dice = random.Random(7)
    facts = {scene: numbers_of(scene) for scene in HEARTS}
    ends = {0: 0, 1: 0, 2: 0}
    for k in range(int(os.environ.get("WIGGERS_RANDOM_HEARTS", "40"))):
        scene = HEARTS[k % len(HEARTS)]
        words = [COMMAND, "run", str(SCENES / scene), "--quiet", "--json", "-o", "r.h5", *draw(dice, facts[scene])]
        run = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        say = " ".join(words[2:]) + "\n" + run.stderr[-400:]
        assert run.returncode in ends, say
        ends[run.returncode] += 1
        if run.returncode != 0:
            assert len(run.stderr.strip().splitlines()[-1]) > 40, say
            continue
        assert json.loads(run.stdout.strip().splitlines()[-1])["limit_cycle"]["verdict"] == "period-1", say
        with h5py.File(tmp_path / "r.h5") as file:
            for chamber, cavity in file["cavities"].items():
                V, p = cavity["volume"][:], cavity["pressure"][:]
                assert 0 < V.min() and V.max() < 2000, f"{chamber}: {say}"
                assert -50 <= p.min() and p.max() <= 400, f"{chamber}: {say}"
                assert 0 <= 100 * (V.max() - V.min()) / V.max() <= 100, f"{chamber}: {say}"
            for name, cells in file["cells"].items():
                if "stretch" in cells:
                    assert 0.3 < cells["stretch"][:].min() and cells["stretch"][:].max() < 2, f"{name}: {say}"
            forward = {v: float(file[f"indexes/valves/{v}/forward_volume_mL"][()]) -
                       float(file[f"indexes/valves/{v}/backward_volume_mL"][()]) for v in ("MV", "AV", "TV", "PV")}
            # What goes through one valve in a beat goes through all.
            assert max(forward.values()) - min(forward.values()) < 0.05 + 0.02 * abs(forward["AV"]), say
    print(ends)
