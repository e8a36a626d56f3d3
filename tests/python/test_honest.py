"""Nothing false is called good: inputs off the happy path give the right value, or say why there is none."""

import json

import pytest
from conftest import SCENES

LOOP = """
parameters = "wiggers-healthy-0d"
valve_law = "{law}"
"""


@pytest.fixture
def loop_file(tmp_path):
    def make(text):
        path = tmp_path / "loop.toml"
        path.write_text(text)
        return path

    return make


def last_json(outcome):
    return json.loads([line for line in outcome.out.splitlines() if line.startswith("{")][-1])


def test_stiff_valves_give_one_answer_by_all_integrators(wiggers, loop_file):
    file = loop_file(LOOP.format(law="diode"))
    by = {}
    for integrator in ("runge-kutta-4", "cvode"):
        outcome = wiggers("loop", file, "--until", "limit-cycle", "--integrator", integrator, "--quiet", "--json",
                          "--set", "valves.AV.Rmin=0.0012")
        assert outcome.status == 0, outcome.err
        by[integrator] = last_json(outcome)["indexes"]
    for group, name in (("LV", "EF_percent"), ("LV", "ESV_mL"), ("LV", "pressure_max_mmHg"), ("aorta", "pressure_mean_mmHg")):
        assert by["runge-kutta-4"][group][name] == pytest.approx(by["cvode"][group][name], rel=1e-3)


@pytest.mark.parametrize("words", [
    ["run", SCENES / "elastance_healthy.toml", "--set", "walls.LV.V0=-100"],
    ["run", SCENES / "elastance_healthy.toml", "--set", "walls.LV.V0=-100", "--set", "run.until=beats", "--set", "run.beats=9"],
    ["run", SCENES / "elastance_healthy.toml", "--set", "circulation.circuit.SYS.R_AR=9"],
])
def test_no_heart_is_good_that_cannot_be(wiggers, tmp_path, words):
    outcome = wiggers(*words, "--quiet", "--json", "-o", tmp_path / "r.h5")
    assert outcome.status == 1
    assert "unphysical" in outcome.err
    assert last_json(outcome)["limit_cycle"]["verdict"] == "unphysical"
    assert (tmp_path / "r.h5").exists()
    # A complete result that is resumed is no better for it.
    again = wiggers(*words, "--quiet", "--resume", tmp_path / "r.h5")
    assert again.status == 1
    assert "unphysical" in again.err


def test_a_loop_of_negative_volume_is_unphysical(wiggers, loop_file):
    file = loop_file(LOOP.format(law="diode"))
    for words in (["--until", "limit-cycle"], ["--beats", "20"]):
        outcome = wiggers("loop", file, *words, "--set", "elastance.LV.V0=-90", "--quiet")
        assert outcome.status == 1
        assert "volume of LV" in outcome.err


def test_features_do_not_depend_on_the_rows_asked_for(wiggers):
    seen = []
    for sampling in ([], ["--sample-ms", "0.1"], ["--sample-ms", "7.3"]):
        outcome = wiggers("cell", "ttp06-epi", "--period-ms", "1000", "--beats", "5", "--quiet", "--json", *sampling)
        seen.append(last_json(outcome)["features"])
    for features in seen:
        assert features["V_peak_mV"] == pytest.approx(38.746, abs=2e-3)
        assert features["APD90_ms"] == pytest.approx(307.598, abs=2e-3)
        assert features == pytest.approx(seen[0], rel=1e-12)


@pytest.mark.parametrize("words, why", [
    (["ttp06-epi", "--period-ms", "2000", "--set", "g_Kr=0", "--set", "g_Ks=0", "--beats", "4"], "did not repolarise"),
    (["ttp06-endo", "--stimulus-A-per-F", "-5", "--beats", "2"], "did not depolarise"),
    (["ttp06-epi", "--period-ms", "280", "--beats", "20"], "blocked"),
])
def test_what_is_no_action_potential_has_no_duration(wiggers, words, why):
    outcome = wiggers("cell", *words, "--quiet", "--json")
    summary = last_json(outcome)
    assert "APD90_ms" not in summary
    assert why in summary["no_action_potential"]
    assert why in outcome.out


def test_the_attractor_is_the_one_that_pacing_reaches(wiggers):
    words = ["cell", "ttp06-epi", "--period-ms", "300", "--until", "limit-cycle", "--distance", "1e-4", "--quiet", "--json"]
    paced = last_json(wiggers(*words))
    assert paced["limit_cycle"]["verdict"] == "period-2"
    beats = paced["beats_of_cycle"]
    peaks = sorted(b["V_peak_mV"] for b in beats)
    assert peaks == pytest.approx([-24.42, 33.66], abs=0.05)  # every second beat is blocked
    assert sum("no_action_potential" in b for b in beats) >= 1
    any_cycle = last_json(wiggers(*words, "--attractor", "any"))
    assert any_cycle["limit_cycle"]["verdict"] == "period-1"
    assert any_cycle["APD90_ms"] == pytest.approx(215.8, abs=0.2)


def test_drafts_find_their_cycles(wiggers):
    names = [line.split()[0] for line in wiggers("models").out.splitlines() if "force" not in line][:-1]
    assert len(names) >= 4
    for model in names:
        outcome = wiggers("cell", model, "--until", "limit-cycle", "--accuracy", "draft", "--quiet", "--json")
        assert outcome.status == 0, outcome.err
        assert last_json(outcome)["limit_cycle"]["verdict"] == "period-1"


def test_a_rate_that_does_not_suit_the_heart_is_told(wiggers):
    words = ["run", SCENES / "whole_heart.toml", "--quiet", "--json"]
    assert last_json(wiggers(*words))["warnings"] == []
    slow = " ".join(last_json(wiggers(*words, "--set", "heart.period_s=1.2"))["warnings"])
    assert "calcium_factor" in slow
    fast = " ".join(last_json(wiggers(*words, "--set", "heart.period_s=0.4"))["warnings"])
    assert "diastole" in fast or "cut short" in fast or "open at once" in fast


def test_each_atrium_has_its_own_kick(wiggers, tmp_path):
    # Shifting the right atrium alone leaves the left one's phases where they are.
    def kicks(*more):
        outcome = wiggers("run", SCENES / "whole_heart.toml", "--quiet", "--json", *more)
        return last_json(outcome)["indexes"]
    early, late = kicks(), kicks("--set", "walls.RA.activation_ms=30")
    assert late["phases"]["left"]["AC"]["begins_s"] == pytest.approx(early["phases"]["left"]["AC"]["begins_s"], abs=1e-9)
    assert late["phases"]["right"]["AC"]["begins_s"] == pytest.approx(early["phases"]["right"]["AC"]["begins_s"] + 0.03, abs=1e-9)
    passive = last_json(wiggers("run", SCENES / "atria_passive.toml", "--quiet", "--json"))["indexes"]
    assert "VpreAC_mL" not in passive["LA"]
    assert "atrial_kick_percent" not in passive
    assert "E_over_A" not in passive


def test_a_cell_full_of_calcium_is_unphysical(wiggers):
    words = ["cell", "ttp06-epi", "--set", "k_NaCa=10", "--set", "g_pCa=0", "--set", "Ca_o=10", "--integrator", "rush-larsen-2",
             "--dt-ms", "0.05", "--quiet", "--json"]
    for end in (["--beats", "400"], ["--until", "limit-cycle", "--distance", "1e-4"]):
        outcome = wiggers(*words, *end)
        assert outcome.status == 1, outcome.out
        assert "unphysical" in outcome.err and "no living cell" in outcome.err


def test_a_heart_that_hardly_ejects_says_so_beside_its_verdict(wiggers, loop_file):
    weak = wiggers("run", SCENES / "elastance_healthy.toml", "--set", "walls.LV.EA=0.01", "--quiet", "--json")
    assert weak.status == 0, weak.err
    cycle = last_json(weak)["limit_cycle"]
    assert cycle["verdict"] == "period-1"
    assert any("LV" in warning and "eject" in warning for warning in cycle["warnings"])
    assert f"limit cycle: period-1, with warnings: {'; '.join(cycle['warnings'])}, distance" in weak.out
    healthy = wiggers("run", SCENES / "elastance_healthy.toml", "--quiet", "--json")
    assert "warnings" not in last_json(healthy)["limit_cycle"]
    assert "with warnings" not in healthy.out
    together = wiggers("run", SCENES / "elastance_healthy.toml", "--set", "walls.LV.EA=0.01", "--monolithic", "--quiet")
    assert together.status == 0, together.err
    assert "limit cycle: period-1, with warnings: LV" in together.out
    file = loop_file("[elastance.LV]\nEA = 0.01\n")
    loop = wiggers("loop", file, "--until", "limit-cycle", "--quiet", "--json")
    assert loop.status == 0, loop.err
    assert "period-1, with warnings: LV" in loop.out
    # Beside any number of beats too.
    few = wiggers("loop", file, "--beats", "20", "--quiet", "--json")
    for outcome in (loop, few):
        assert any("LV" in warning and "eject" in warning for warning in last_json(outcome)["warnings"])


@pytest.mark.parametrize("words, other, name", [
    (["run", SCENES / "elastance_healthy.toml"], "title = 'somebody, else'\n", "r.h5"),
    (["run", SCENES / "elastance_healthy.toml", "--monolithic"], "my notes\n", "r.csv"),
    (["cell", "crn", "--beats", "1"], "title = 'a scene'\n", "r.csv"),
    (["cell", "crn", "--beats", "1"], "a,b\n1,2\n", "r.h5"),
    (["loop", "--beats", "1"], "\x89PNG a photograph", "r.csv"),
    (["mesh", "ellipsoid"], "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "r.msh"),
    (["extremes", "crn"], "{\"name\": 1}", "r.json"),
    (["cell", "crn", "--beats", "1", "--final-state"], "# notes\n", "s.csv"),
])
def test_what_is_of_another_kind_is_never_replaced(wiggers, tmp_path, words, other, name):
    file = tmp_path / name
    file.write_text(other)
    if words[0] == "loop":
        (tmp_path / "loop.toml").write_text('parameters = "wiggers-healthy-0d"\n')
        words = ["loop", tmp_path / "loop.toml", *words[1:]]
    outcome = wiggers(*words, *([] if words[-1] == "--final-state" else ["-o"]), file, *([] if words[0] == "mesh" else ["--quiet"]))
    if words[0] in ("mesh", "extremes") and "--help for more" in outcome.err:
        pytest.skip("built without this verb")
    assert outcome.status == 2, outcome.err
    assert "is there already and is not" in outcome.err and "name another file" in outcome.err
    assert file.read_text() == other
    assert [p.name for p in tmp_path.iterdir() if p.suffix == ".partial"] == []
