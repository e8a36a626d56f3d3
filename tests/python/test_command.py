"""The command, checked from outside: formats, names, numbers, JSON."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from conftest import COMMAND, DATA, REFERENCE, SCENES, read_csv

BASELINE = """
period_s = 0.8
valve_law = "log-arctan"
[elastance]
LA = { EA = 0.07, EB = 0.18, tC = 0.72, TC = 0.136, TR = 0.136, V0 = 4 }
LV = { EA = 3.35, EB = 0.20, tC = 0.08, TC = 0.2, TR = 0.32, V0 = 42 }
RA = { EA = 0.06, EB = 0.07, tC = 0.72, TC = 0.136, TR = 0.136, V0 = 4 }
RV = { EA = 0.55, EB = 0.05, tC = 0.08, TC = 0.2, TR = 0.32, V0 = 16 }
[valves]
MV = { Rmin = 0.0075, Rmax = 75006.2 }
AV = { Rmin = 0.0075, Rmax = 75006.2 }
TV = { Rmin = 0.0075, Rmax = 75006.2 }
PV = { Rmin = 0.0075, Rmax = 75006.2 }
[circuit]
SYS = { R_AR = 0.84, C_AR = 1.2, L_AR = 0.005, R_VEN = 0.32, C_VEN = 60, L_VEN = 0.0005 }
PUL = { R_AR = 0.032, C_AR = 10, L_AR = 0.0005, R_VEN = 0.035, C_VEN = 16, L_VEN = 0.0005 }
[initial]
V_LA = 80
V_LV = 110
V_RA = 80
V_RV = 110
p_AR_SYS = 70
p_VEN_SYS = 40
p_AR_PUL = 25
p_VEN_PUL = 20
Q_AR_SYS = 0
Q_VEN_SYS = 0
Q_AR_PUL = 0
Q_VEN_PUL = 0
"""


@pytest.mark.parametrize(
    "model, parameters, file",
    [
        ("crn", None, "crn_rhs.csv"),
        ("ttp06-endo", None, "ttp06_endo_rhs.csv"),
        ("ttp06-mid", None, "ttp06_mid_rhs.csv"),
        ("ttp06-epi", None, "ttp06_epi_rhs.csv"),
        ("rdq20", "human37", "rdq20_human37_rhs.csv"),
        ("rdq20", "fedele2023-ventricles", "rdq20_ventricle_rhs.csv"),
        ("rdq20", "fedele2023-atria", "rdq20_atrium_rhs.csv"),
    ],
)
def test_right_hand_sides_from_outside(wiggers, tmp_path, model, parameters, file):
    words = ["cell", model, "--rhs", DATA / "cell" / file, "-o", "out.csv"]
    if parameters:
        words += ["--parameters", parameters]
    outcome = wiggers(*words)
    assert outcome.status == 0, outcome.err
    mine, headings = read_csv(tmp_path / "out.csv")
    reference, reference_headings = read_csv(DATA / "cell" / file)
    derivatives = [h for h in reference_headings if h.startswith("d") and "/dt [" in h and h not in ("dSL/dt [um/s]",)]
    assert len(derivatives) >= 19
    assert headings[0] == "case"
    for heading in derivatives:
        assert heading in headings  # same names, same units
    for row in range(len(reference["case"])):
        largest = max(abs(reference[h.split(" [")[0]][row]) for h in derivatives)
        for heading in derivatives:
            name = heading.split(" [")[0]
            bound = 1e-9 * abs(reference[name][row]) + 1e-13
            if model == "rdq20":
                bound = 1e-11 if row == 1 else 1e-12 * largest
            assert abs(mine[name][row] - reference[name][row]) <= bound, (row, heading)


def test_cell_writes_time_states_and_observables_of_the_last_beat(wiggers, tmp_path):
    outcome = wiggers("cell", "ttp06-endo", "--period-ms", 800, "--beats", 2, "--sample-ms", 1, "-o", "ap.csv", "--json")
    assert outcome.status == 0, outcome.err
    columns, headings = read_csv(tmp_path / "ap.csv")
    assert headings[:3] == ["t [ms]", "V [mV]", "Xr1 [1]"]
    assert "i_CaL [A/F]" in headings and "i_rel [mM/ms]" in headings
    assert len(columns["t"]) == 801 and columns["t"][-1] == 800
    assert max(columns["V"]) > 20
    summary = outcome.json()
    assert summary["beats"] == 2 and 250 < summary["APD90_ms"] < 350


def test_cell_to_its_limit_cycle_and_on_from_the_saved_state(wiggers, tmp_path):
    outcome = wiggers("cell", "ttp06-endo", "--period-ms", 800, "--until", "limit-cycle", "--integrator", "rush-larsen",
                      "--dt-ms", 0.05, "--final-state", "state.csv", "--json")
    assert outcome.status == 0, outcome.err
    cycle = outcome.json()["limit_cycle"]
    assert cycle["verdict"] == "period-1" and cycle["distance"] <= 1e-6
    again = wiggers("cell", "ttp06-endo", "--period-ms", 800, "--beats", 1, "--integrator", "rush-larsen", "--dt-ms", 0.05,
                    "--start", "state.csv", "--json")
    before, after = outcome.json()["end_state"], again.json()["end_state"]
    for name in ("V", "Na_i", "Ca_SR"):
        assert abs(before[name] - after[name]) <= 1e-3 * (abs(before[name]) + 1e-3)


@pytest.mark.skipif(not REFERENCE.exists(), reason="full reference not at hand")
def test_first_action_potential_against_the_reference(wiggers, tmp_path):
    for model, folder in (("crn", "crn"), ("ttp06-epi", "ttp06_epi")):
        wiggers("cell", model, "--period-ms", 1000, "--beats", 1, "--integrator", "cvode", "--rtol", "1e-9", "-o", "ap.csv")
        mine, _ = read_csv(tmp_path / "ap.csv")
        reference, _ = read_csv(REFERENCE / "cell" / folder / f"{folder}_ap_1hz_beat1.csv")
        assert max(abs(a - b) for a, b in zip(mine["V"], reference["V"])) < 1e-3


def test_loop_file_gives_the_reference_beat(wiggers, tmp_path):
    (tmp_path / "loop.toml").write_text(BASELINE)
    for words, file in ((["--beats", 1], "baseline75_beat1.csv"), (["--until", "limit-cycle"], "baseline75_limit.csv")):
        outcome = wiggers("loop", "loop.toml", *words, "--rtol", "1e-10", "--sample-ms", 25, "-o", "beat.csv", "--json")
        assert outcome.status == 0, outcome.err
        mine, headings = read_csv(tmp_path / "beat.csv")
        reference, reference_headings = read_csv(DATA / "circulation" / file)
        assert headings == reference_headings
        for name in reference_headings[:13]:
            spread = max(reference[name]) - min(reference[name])
            assert max(abs(a - b) for a, b in zip(mine[name], reference[name])) <= 1e-5 * spread + 1e-9, name
    summary = outcome.json()
    assert summary["limit_cycle"]["verdict"] == "period-1"
    assert summary["audits"]["blood_volume_drift_mL"] < 1e-8
    assert summary["audits"]["energy_imbalance"] < 1e-3  # from 1 ms samples, whatever the output
    assert summary["indexes"]["LV"]["EF_percent"] == pytest.approx(48.37, abs=0.05)


def test_rows_at_multiples_of_the_sample_and_at_the_end(wiggers, tmp_path):
    (tmp_path / "loop.toml").write_text(BASELINE)
    wiggers("loop", "loop.toml", "--beats", 1, "--sample-ms", 300, "-o", "beat.csv")
    columns, _ = read_csv(tmp_path / "beat.csv")
    assert columns["t_s"] == pytest.approx([0, 0.3, 0.6, 0.8])


def test_names_of_sets_stand_for_tables(wiggers, tmp_path):
    (tmp_path / "loop.toml").write_text(
        'valve_law = "log-arctan"\nelastance = "baseline75"\nvalves = "baseline75"\ncircuit = "baseline75"\ninitial = "baseline75"\n'
    )
    (tmp_path / "full.toml").write_text(BASELINE)
    for name in ("loop", "full"):
        wiggers("loop", f"{name}.toml", "--beats", 1, "--sample-ms", 50, "-o", f"{name}.csv")
    named, full = read_csv(tmp_path / "loop.csv")[0], read_csv(tmp_path / "full.csv")[0]
    for name in named:  # 0.9 * 0.8 and 0.72 differ by rounding
        assert named[name] == pytest.approx(full[name], rel=1e-9, abs=1e-9)


def test_steady_force(wiggers):
    reference, _ = read_csv(DATA / "cell" / "rdq20_human37_force_calcium.csv")
    for row in (0, 30, 60):
        outcome = wiggers("force", "--calcium", reference["Ca"][row], "--sarcomere-length", reference["SL"][row], "--steady",
                          "--json")
        assert outcome.json()["Ta_kPa"] == pytest.approx(reference["Ta"][row], rel=1e-5)
    rat = wiggers("force", "--parameters", "fedele2023-ventricles", "--set", "a_XB=10.5e5", "--calcium", 0.5,
                  "--sarcomere-length", 1.9, "--steady", "--json")
    assert rat.status == 0 and rat.json()["Ta_kPa"] > 0


@pytest.mark.skipif(not REFERENCE.exists(), reason="full reference not at hand")
def test_force_along_a_ramp_and_a_periodic_twitch(wiggers, tmp_path):
    folder = REFERENCE / "cell" / "rdq20mf"
    for name, words in (
        ("rdq20mf_ventricle_ramp_m1p0", ["--parameters", "fedele2023-ventricles"]),
        ("rdq20mf_atrium_twitch_ionic_SL2p2", ["--parameters", "fedele2023-atria", "--beats", 6]),
    ):
        outcome = wiggers("force", *words, "--calcium", folder / f"{name}.csv", "--sarcomere-length", folder / f"{name}.csv",
                          "-o", "force.csv")
        assert outcome.status == 0, outcome.err
        mine, headings = read_csv(tmp_path / "force.csv")
        reference, _ = read_csv(folder / f"{name}.csv")
        peak = max(reference["Ta"])
        assert max(abs(a - b) for a, b in zip(mine["Ta"], reference["Ta"])) <= 1e-4 * peak
        assert headings[0] == "t [s]" and "P0000 [1]" in headings and "Ka [kPa]" in headings


def test_run_json_has_every_promised_key(wiggers, tmp_path):
    outcome = wiggers("run", SCENES / "whole_heart.toml", "-o", "r.h5", "--json", "--quiet")
    assert outcome.status == 0 and outcome.err == ""
    s = outcome.json()
    assert set(s) >= {"title", "indexes", "limit_cycle", "audits", "flips", "cost", "warnings"}
    i = s["indexes"]
    ventricle = {"EDV_mL", "ESV_mL", "SV_mL", "EF_percent", "pressure_max_mmHg", "pressure_min_mmHg", "stroke_work_J"}
    atrium = {"Vmax_mL", "VpreAC_mL", "Vmin_mL", "PassEF_percent", "ActEF_percent", "TotEF_percent", "pressure_mean_mmHg"}
    for name in ("LV", "RV"):
        assert set(i[name]) >= ventricle
    for name in ("LA", "RA"):
        assert set(i[name]) >= atrium
    for name in ("aorta", "pulmonary_artery"):
        assert set(i[name]) >= {"pressure_max_mmHg", "pressure_min_mmHg"}
    for name in ("MV", "AV", "TV", "PV"):
        assert set(i["valves"][name]) >= {"opens_s", "closes_s", "peak_flow_mL_per_s"}
    assert set(i["E_over_A"]) == {"MV", "TV"}
    assert set(s["limit_cycle"]) >= {"verdict", "distance", "beats"}
    assert set(s["audits"]) >= {"blood_volume_drift_mL", "energy_imbalance"}
    assert set(s["flips"]) == {"p_LV_mmHg", "Q_AV_mL_per_s"}
    assert set(s["cost"]) >= {"wall_s", "beats"}
    assert s["warnings"] == []


def test_result_file_is_described(wiggers, tmp_path):
    outcome = wiggers("run", SCENES / "mixed.toml", "-o", "r.h5", "--json", "--quiet")
    assert outcome.status == 0, outcome.err
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["provenance/status"][()] == b"complete"
        assert file["cavities/LV/volume"].attrs["unit"] == b"mL"
        assert len(file["time"]) == 801
        assert file["cells/LV/active_tension"].attrs["unit"] == b"kPa"
        assert "LA" not in file["cells"] or "calcium" not in file["cells/LA"]  # a scene pays only for what it names
        assert json.loads(file["summary"][()]) ["indexes"] == outcome.json()["indexes"]
        assert file["indexes/LV/EF_percent"].attrs["unit"] == b"%"
        assert set(file["phases/left"]) == {"AC", "IVC", "VE", "IVR", "VPF"}

        def described(name, item):
            if isinstance(item, h5py.Dataset) and not name.startswith(("provenance", "network", "summary", "limit_cycle/verdict")):
                assert item.attrs["unit"] and item.attrs["meaning"], name

        file.visititems(described)


def test_nothing_is_written_without_o(wiggers, tmp_path):
    outcome = wiggers("run", SCENES / "elastance_healthy.toml")
    assert outcome.status == 0 and "nothing was written" in outcome.out
    assert list(tmp_path.iterdir()) == []


def test_models_check_doctor_and_help(wiggers):
    listing = wiggers("models").out
    for name in wiggers("models", "--names").out.split():
        assert name in listing
    crn = wiggers("models", "crn").out
    assert "g_CaL" in crn and "nS/pF" in crn and "0.12375" in crn and "1998" in crn
    assert "fedele2023-atria" in wiggers("models", "rdq20", "--sets").out
    assert "wiggers-healthy-0d" in wiggers("models", "circulation", "--sets").out
    assert wiggers("check", SCENES / "whole_heart.toml").status == 0
    full = wiggers("check", SCENES / "no_rate_feedback.toml", "--full").out
    assert 'stretch_rate = "none"' in full and "electrophysiology_substep_ms = 0.1" in full
    doctor = wiggers("doctor")
    assert doctor.status == 0 and "healthy" in doctor.out
    for verb in ("run", "check", "cell", "force", "loop", "models", "report", "doctor", "trade", "extremes"):
        assert wiggers(verb, "--help").status == 0


@pytest.fixture
def command_beside(tmp_path, wiggers):
    """The command, copied beside a wiggers-3d of the given words (none: of nothing)."""
    folder = tmp_path / "bin"
    folder.mkdir()
    shutil.copy(COMMAND, folder / "wiggers")

    def run(script, *words):
        if script is not None:
            (folder / "wiggers-3d").write_text("#!/bin/sh\n" + script)
            (folder / "wiggers-3d").chmod(0o755)
        return subprocess.run([folder / "wiggers", *words], capture_output=True, text=True, timeout=120)

    return run


def test_doctor_says_of_the_tissue_what_is_true(wiggers, command_beside):
    doctor = wiggers("doctor").out
    line = next(line for line in doctor.splitlines() if "3D tissue" in line)
    if (Path(COMMAND).parent / "wiggers-3d").exists():
        assert "good" in line and "affine patch test" in line
        assert wiggers("doctor", "--tissue").out.count("\n") == 1
    else:
        assert "absent" in line
    version = wiggers("--version").out.strip()
    alone = command_beside(None, "doctor")
    assert alone.returncode == 0 and "absent" in alone.stdout and "no wiggers-3d" in alone.stdout
    assert command_beside(None, "doctor", "--tissue").returncode == 1
    for script, said in (
        ("echo wiggers 0.0.9 '(0000000)'", "of another build, wiggers 0.0.9 (0000000)"),
        ("echo 'libpetsc.so: cannot open shared object file' >&2; exit 127", "cannot be started"),
        ("kill -11 $$", "status 139"),
        (f"[ $1 = --version ] && echo '{version}' || {{ echo 'wiggers: failed: off by 1e-2' >&2; exit 1; }}", "off by 1e-2"),
    ):
        ill = command_beside(script, "doctor")
        assert ill.returncode == 1, script
        line = next(line for line in ill.stdout.splitlines() if "3D tissue" in line)
        assert "BAD" in line and said in line and "not healthy" in ill.stderr
    well = command_beside(f"[ $1 = --version ] && echo '{version}' || echo 'off by 1e-15'", "doctor")
    assert well.returncode == 0 and "off by 1e-15" in well.stdout


def test_reference_pages_are_in_step(wiggers):
    names = wiggers("models", "--names").out.split()
    assert len(names) >= 6
    for model in names:
        text = wiggers("models", model).out
        if model == "circulation":
            text += wiggers("models", model, "--sets").out
        assert (SCENES.parent / "docs" / "reference" / f"{model}.txt").read_text() == text, "run make reference"


def test_trade_of_a_cell_without_tables(wiggers, tmp_path):
    outcome = wiggers("trade", "cell", "aliev-panfilov", "--quiet", "-o", "study")
    assert outcome.status == 0
    rows = json.loads((tmp_path / "study" / "trade.json").read_text())["rows"]
    assert any("batch" in row["method"] for row in rows) and not any("tables" in row["setting"] for row in rows)


def test_trade_of_a_force_model_is_found_by_its_set(wiggers):
    wrong = wiggers("trade", "force", "intact", "--model", "rdq20")
    assert wrong.status == 2 and "human37" in wrong.err and "skinned" not in wrong.err
    assert wiggers("trade", "force", "no-such-set").status == 2
    right = wiggers("trade", "force", "skinned", "--quiet")
    assert right.status == 0 and "land2017, skinned" in right.out


def test_trade_writes_table_picture_and_recommendation(wiggers, tmp_path):
    outcome = wiggers("trade", "loop", "--quiet", "--tolerance", "pressure=0.01mmHg", "-o", "study")
    assert outcome.status == 0
    assert "recommended: runge-kutta-4" in outcome.out
    study = json.loads((tmp_path / "study" / "trade.json").read_text())
    rows = [row for row in study["rows"] if "errors" in row]
    chosen = [row for row in rows if row["recommended"]]
    assert len(chosen) == 1 and chosen[0]["errors"][0] <= 0.01
    cheaper = [row for row in rows if row["cost_s"] < chosen[0]["cost_s"]]
    assert all(row["errors"][0] > 0.01 for row in cheaper)
    assert any("failure" in row for row in study["rows"])
    assert (tmp_path / "study" / "trade.png").stat().st_size > 10_000
    assert "| runge-kutta-4 |" in (tmp_path / "study" / "trade.md").read_text()
    # A row without a value, as of an activation that never came, does not spoil the picture.
    study["rows"][study["rows"].index(rows[0])]["errors"][0] = None
    (tmp_path / "study" / "trade.json").write_text(json.dumps(study))
    program = SCENES.parent / "heart" / "report" / "make_trade.py"
    answer = subprocess.run([sys.executable, program, tmp_path / "study" / "trade.json", tmp_path / "study", "1"], check=True,
                            capture_output=True).stdout
    assert b"file trade.png " in answer and answer.endswith(b"end - 0\n")
    unmet = wiggers("trade", "loop", "--quiet", "--tolerance", "pressure=1e-12")
    assert unmet.status == 1 and "no setting" in unmet.err


def test_extremes_maps_steps_and_draws(wiggers, tmp_path):
    outcome = wiggers("extremes", "loop", "--quiet", "--beats", 2, "--draws", 40, "-o", "map.json")
    assert outcome.status == 0 and " 0 unexplained" in outcome.out
    study = json.loads((tmp_path / "map.json").read_text())
    base = {row["scheme"]: row for row in study["rows"] if row["condition"] == "as given"}
    # 2 L/R of the systemic veins, 3.85 ms; Runge-Kutta 4 divides steps that are too long for it.
    assert 3.3 < base["forward-euler"]["stable"] < 4.3
    assert base["runge-kutta-4"]["stable"] > 5.8
    assert base["forward-euler"]["accurate"] < base["forward-euler"]["stable"]
    assert study["draws"]["draws"] == 40
    again = wiggers("extremes", "loop", "--quiet", "--beats", 2, "--draws", 40)
    assert again.out.splitlines()[-3:] == outcome.out.splitlines()[-4:-1]  # seeded


def test_accuracies_state_what_to_expect(wiggers, tmp_path):
    apd = {}
    for accuracy in ("draft", "standard", "reference"):
        outcome = wiggers("cell", "ttp06-endo", "--beats", 1, "--sample-ms", 0.1, "--accuracy", accuracy, "--json")
        assert outcome.status == 0 and f"accuracy {accuracy}: " in outcome.out
        apd[accuracy] = json.loads(outcome.out.splitlines()[-1])["APD90_ms"]
    assert abs(apd["draft"] - apd["reference"]) < 0.05
    assert abs(apd["standard"] - apd["reference"]) < 1e-4


def test_certificate_of_a_cell_and_monolithic_run(wiggers, tmp_path):
    outcome = wiggers("cell", "crn", "--until", "limit-cycle", "--period-ms", 800, "--integrator", "rush-larsen-2",
                      "--dt-ms", 0.1, "--json")
    assert outcome.status == 0
    cycle = json.loads(outcome.out.splitlines()[-1])["limit_cycle"]
    assert cycle["verdict"] == "period-1" and cycle["distance"] <= 1e-6 and cycle["beats"] <= 40
    assert 0.99 < cycle["multiplier"] < 1
    assert cycle["charge_mV"] != 0 and abs(cycle["charge_drift_mV"]) > 0
    assert 1e-5 < cycle["integrator_shift"] < 0.1
    outcome = wiggers("run", SCENES / "whole_heart.toml", "--monolithic", "--quiet", "-o", "beat.csv")
    assert outcome.status == 0 and "monolithic by CVODE" in outcome.out
    rows = (tmp_path / "beat.csv").read_text().splitlines()
    assert len(rows) == 3202 and rows[0].startswith("t_s")
