"""Scenes with keys, values and files bent at random: each ends in a result, a refusal or an explained failure.

Part of the nightly set (its name keeps it out of the ordinary run); seeded, so that a find can be repeated.
"""

import random
import re
import subprocess

import pytest
from conftest import COMMAND, SCENES

NAMES = ["whole_heart", "elastance_healthy", "mixed", "triseg", "atria_passive"]
VALUES = ["0", "-1", "1e-9", "1e9", "nan", "inf", '""', '"LV"', "[]", "true", "0.37", "1e-3", "12345678901234567890"]


def bent(text, chance):
    lines = text.splitlines()
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(lines))
        kind = chance.random()
        if kind < 0.45 and "=" in lines[at]:
            lines[at] = lines[at].split("=")[0] + "= " + chance.choice(VALUES)
        elif kind < 0.6 and "=" in lines[at]:
            number = re.search(r"[-+]?\d+\.?\d*(e[-+]?\d+)?", lines[at].split("=")[1])
            if number:
                value = float(number.group()) * 10 ** chance.uniform(-2, 2)
                lines[at] = lines[at].split("=")[0] + f"= {value:.4g}"
        elif kind < 0.7:
            del lines[at]
        elif kind < 0.8:
            lines.insert(at, lines[chance.randrange(len(lines))])
        elif kind < 0.9 and lines[at]:
            k = chance.randrange(len(lines[at]))
            lines[at] = lines[at][:k] + chance.choice("[]=\"'#{}\\x") + lines[at][k + 1 :]
        else:
            lines[at] = "".join(chance.sample(lines[at], len(lines[at])))
        if not lines:
            lines = [""]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("seed", range(300))
def test_a_bent_scene_ends_in_words(seed, tmp_path):
    chance = random.Random(seed)
    text = (SCENES / f"{chance.choice(NAMES)}.toml").read_text().replace('base = "', f'base = "{SCENES}/')
    (tmp_path / "scene.toml").write_text(bent(text, chance))
    words = [COMMAND, "run", "scene.toml", "--quiet", "--json", "--set", "run.until=beats", "--set", "run.beats=2"]
    outcome = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert outcome.returncode in (0, 1, 2), outcome.stderr
    assert "terminate called" not in outcome.stderr
    if outcome.returncode == 0:
        assert "nan" not in outcome.stdout.lower()
    else:
        assert outcome.stderr.startswith("wiggers: ") and len(outcome.stderr) < 2000
