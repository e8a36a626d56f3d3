"""Calibration: twin experiments, refusals, what is known, the adapters, the report."""

import os
import warnings

import numpy as np
import pytest
import wiggers
from wiggers.calibration import (Difference, ForceCalcium, Free, Problem, Ratio, Target, TargetWarning, Tie, cma_es,
                                 least_squares, mcmc, reference_targets, sobol, write_report)

HEART = os.path.join(os.environ["WIGGERS_ROOT"], "scenes", "elastance_healthy.toml")
PARAMETERS = ["circuit.SYS.R_AR", "circuit.SYS.C_AR", "circuit.PUL.R_AR", "circuit.PUL.C_AR", "circuit.SYS.R_VEN",
              "elastance.LV.EA", "elastance.LV.EB", "elastance.RV.EA", "elastance.RV.EB", "elastance.LA.EB",
              "elastance.RA.EB", "initial.total_volume"]
OUTPUTS = ["LV.EDV_mL", "LV.ESV_mL", "RV.EDV_mL", "RV.ESV_mL", "LA.Vmax_mL", "LA.Vmin_mL", "RA.Vmax_mL", "RA.Vmin_mL",
           "LV.pressure_max_mmHg", "RV.pressure_max_mmHg", "LV.pressure_min_mmHg", "RV.pressure_min_mmHg",
           "aorta.pressure_max_mmHg", "aorta.pressure_min_mmHg", "pulmonary_artery.pressure_max_mmHg",
           "pulmonary_artery.pressure_min_mmHg", "LA.pressure_mean_mmHg", "RA.pressure_mean_mmHg",
           "LV.dpdt_max_mmHg_per_s", "valves.AV.opens_s"]


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(scope="module")
def truth():
    loop = wiggers.Loop()
    return loop, loop.to_limit_cycle(distance=1e-10).indexes


def bounds(loop):
    return {n: Free(0.5 * loop.parameters[n], 2 * loop.parameters[n]) for n in PARAMETERS}


def test_twin_experiment(truth):
    loop, indexes = truth
    start = loop.copy()
    random = np.random.default_rng(1)
    start.parameters.update({n: loop.parameters[n] * np.exp(random.uniform(-0.3, 0.3)) for n in PARAMETERS})
    fit = least_squares(Problem(start, bounds(loop), [Target(o, indexes[o]) for o in OUTPUTS], distance=1e-10))
    for name in PARAMETERS:
        assert fit.parameters[name] == pytest.approx(loop.parameters[name], rel=1e-3), name
    assert fit.success and not fit.at_bound
    # Resistance, venous resistance and volume are seen by these outputs almost only together: it must say so.
    explained = fit.explain()
    assert ["circuit.SYS.R_AR", "circuit.SYS.R_VEN", "initial.total_volume"] in explained.groups
    assert explained.unidentified and "cannot be identified" in str(explained)
    assert explained.widths["elastance.LV.EA"] < 0.1 < explained.widths["circuit.SYS.R_VEN"]


def coverage(truth, trials):
    """Shares of noisy trials whose 95 % interval holds the true value, by parameter."""
    loop, indexes = truth
    held = np.zeros(len(PARAMETERS))
    for seed in range(trials):
        random = np.random.default_rng(seed)
        targets = [Target(o, indexes[o] * (1 + 0.02 * random.standard_normal()), sd=0.02 * abs(indexes[o]))
                   for o in OUTPUTS]
        intervals = least_squares(Problem(loop, bounds(loop), targets), tolerance=1e-6).intervals
        held += [intervals[n][0] <= loop.parameters[n] <= intervals[n][1] for n in PARAMETERS]
    return held / trials


@pytest.mark.skipif("WIGGERS_NIGHTLY" not in os.environ, reason="some minutes: a hundred calibrations")
def test_intervals_hold_the_truth(truth):
    shares = coverage(truth, 100)
    print(dict(zip(PARAMETERS, shares, strict=True)))
    assert shares.mean() >= 0.9 and shares.min() >= 0.85


def test_ranges_and_held(truth):
    loop, indexes = truth
    problem = Problem(loop, {"elastance.LV.EA": Free(1, 8), "circuit.SYS.R_AR": Free(0.3, 2)},
                      [Target("LV.EF_percent", within=(50, 55)), Target("aorta.pressure_max_mmHg", within=(140, 145))],
                      held={"circuit.SYS.C_AR": 1.0})
    fit = least_squares(problem)
    assert 49.9 <= fit.outputs["LV.EF_percent"] <= 55.1 and 139.9 <= fit.outputs["aorta.pressure_max_mmHg"] <= 145.1
    assert problem.model.parameters.circuit.SYS.C_AR == 1.0 and loop.parameters.circuit.SYS.C_AR == 1.3
    assert indexes["LV.EF_percent"] > 60


def test_jacobian_against_differences(truth):
    loop, indexes = truth
    problem = Problem(loop, bounds(loop), [Target(o, 0.95 * indexes[o]) for o in OUTPUTS], distance=1e-11)
    x = problem.start
    exact = problem.jacobian(x)
    for k in range(len(x)):
        h = np.zeros_like(x)
        h[k] = 1e-4
        quotient = (problem.residuals(x + h) - problem.residuals(x - h)) / 2e-4
        assert quotient == pytest.approx(exact[:, k], rel=2e-3, abs=2e-3 * np.abs(exact).max())


@pytest.mark.parametrize(("make", "words"), [
    (lambda m: Target("LV.EDV_mL"), "give either a value or within"),
    (lambda m: Target("LV.EDV_mL", float("nan")), "not finite"),
    (lambda m: Target("LV.EDV_mL", 100, sd=-1), "must be positive"),
    (lambda m: Target("LV.EDV_mL", within=(120, 100)), "no width"),
    (lambda m: Free(2, 1), "have a width"),
    (lambda m: Free(-1, 1), "needs positive ones"),
    (lambda m: Free(0, 1, "cube"), "choose log or linear"),
    (lambda m: Problem(m, {}, [Target("LV.EDV_mL", 100)]), "nothing to calibrate"),
    (lambda m: Problem(m, {"elastance.LV.EX": Free(1, 2)}, [Target("LV.EDV_mL", 100)]), "did you mean"),
    (lambda m: Problem(m, {"elastance.LV.EA": Free(1, 1e6)}, [Target("LV.EDV_mL", 100)]), "leave its range"),
    (lambda m: Problem(m, {"elastance.LV.EA": Free(1, 2)}, [Target("LV.EDV", 100)]), "did you mean 'LV.EDV_mL'"),
    (lambda m: Problem(m, {"elastance.LV.EA": Free(1, 2)}, [Target("LV.EDV_mL", 0.1, unit="L")]), "is in mL"),
    (lambda m: Problem(m, {"elastance.LV.EA": Free(1, 2)}, [Target("LV.EF_percent", 140)]), "physical reach"),
    (lambda m: reference_targets(1.9, to="mean"), "choose founding_paper or range"),
])
def test_refusals(truth, make, words):
    with pytest.raises(wiggers.InputError, match=words):
        make(truth[0])


def test_points_without_a_cycle_are_reported(truth):
    loop, _ = truth
    # Long contractions do not fit into the period: those points count as bad, and the fit goes on.
    problem = Problem(loop, {"elastance.LV.TC": Free(0.1, 0.79, "linear"), "elastance.LV.EA": Free(1, 8)},
                      [Target("LV.EF_percent", 60, sd=1), Target("aorta.pressure_max_mmHg", 120, sd=1)])
    rows = problem.residuals_of_many(np.array([problem.start, [0.7, np.log(2.0)]]))
    assert np.all(np.abs(rows[0]) < 100) and np.all(np.isinf(rows[1]))
    assert "longer than the period" in problem.failures[-1][1]
    assert least_squares(problem).outputs["LV.EF_percent"] == pytest.approx(60, abs=0.1)


def words_of(fit, tmp_path):
    """All that a fit says, in its three forms; none of them shows what is no number."""
    page = write_report(fit, tmp_path / "fit.html").read_text()
    said = f"{fit!r}\n{fit.explain()}\n{page}"
    for wrong in ("nan", "inf ", "to inf", "0 to inf"):
        assert f" {wrong}" not in said
    assert all(np.isfinite(ends).all() for ends in fit.intervals.values())
    return said


def test_missed_targets_are_said(truth, tmp_path):
    loop, indexes = truth
    # The stroke volumes of one cycle are equal: 10 mL apart, each is missed by five sd, however good the optimum.
    fit = least_squares(Problem(loop, {"elastance.LV.EA": Free(1, 8), "initial.total_volume": Free(2000, 3000)},
                                [Target("LV.SV_mL", 70, sd=1), Target("RV.SV_mL", 80, sd=1),
                                 Target("LV.EF_percent", indexes["LV.EF_percent"], sd=1)]))
    assert fit.converged and fit.success
    assert [m.name for m in fit.missed] == ["LV.SV_mL", "RV.SV_mL"]
    assert [m.by_sd for m in fit.missed] == pytest.approx([5, -5], abs=0.01)
    said = words_of(fit, tmp_path)
    assert "2 of 3 targets missed" in said and "the optimiser converged" in said
    assert "LV.SV_mL = 75 mL, wanted 70 ± 1 mL: 5 sd above" in said
    assert "RV.SV_mL = 75 mL, wanted 80 ± 1 mL: 5 sd below" in said
    # A weight says how much a target counts, not how far off it is.
    light = least_squares(Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [
        Target("LV.SV_mL", 70, sd=1, weight=0), Target("LV.EF_percent", indexes["LV.EF_percent"], sd=1)]))
    assert [m.name for m in light.missed] == ["LV.SV_mL"]
    assert light.missed[0].by_sd == pytest.approx(indexes["LV.SV_mL"] - 70, rel=1e-6)
    # A range: counted in quarters of its width from the nearer end.
    wide = least_squares(Problem(loop, {"elastance.LV.EA": Free(2, 3)}, [Target("LV.EF_percent", within=(20, 40))]))
    assert wide.missed[0].by_sd == pytest.approx((wide.outputs["LV.EF_percent"] - 40) / 5) and wide.missed[0].by_sd > 1
    assert "wanted 20 to 40 %" in str(wide.missed[0]) and wide.at_bound == ["elastance.LV.EA"]
    met = least_squares(Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [Target("LV.EF_percent", 60.0)]))
    assert not met.missed and "the target is met" in repr(met)


@pytest.mark.parametrize(("target", "words"), [
    (Target("LV.EF_percent", 0.38), ["LV.EF_percent: 0.38 ± 0.0076 is taken in %", "a share of 1", 'unit="%"']),
    (Target("LV.EF_percent", within=(0.5, 0.7)), ["taken in %", "a share of 1"]),
    (Target("LV.EDV_mL", 0.12), ["taken in mL", "given as L?"]),
    (Target("aorta.pressure_max_mmHg", 16.0), ["taken in mmHg", "given as kPa?"]),
    (Target("LV.dpdt_max_mmHg_per_s", 1.6), ["taken in mmHg/s", "in another unit?"]),
])
def test_doubtful_units_are_warned_about(truth, target, words, tmp_path):
    loop, indexes = truth
    with pytest.warns(TargetWarning) as caught:
        problem = Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [target])
    assert len(caught) == 1 and all(w in str(caught[0].message) for w in words)
    assert f"own is {indexes[target.name]:.4g}" in str(caught[0].message)
    fit = least_squares(problem)
    assert len(fit.missed) == 1 and "doubtful: target" in repr(fit) and "doubtful: target" in words_of(fit, tmp_path)


def test_meant_units_are_not_warned_about(truth):
    loop, indexes = truth
    problem = Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [
        Target("LV.EF_percent", 0.9, unit="%"), Target("LV.EDV_mL", within=(0, 1e4)),
        Target("LV.ESV_mL", within=(0, 40)), Target("RA.pressure_mean_mmHg", 1.5 * indexes["RA.pressure_mean_mmHg"]),
        Target("LV.pressure_min_mmHg", 0.0, sd=2), Target(Difference("LV.SV_mL", "RV.SV_mL"), 0.1, sd=1)])
    assert problem.doubts == []


def test_undetermined_parameters_are_said(truth, tmp_path):
    loop, indexes = truth
    # The right atrium's contraction hardly shows in the aorta; without a word of the targets nothing does.
    free = {"elastance.LV.EA": Free(1, 8), "elastance.RA.EA": Free(0.02, 0.2), "valves.PV.Rmax": Free(1e3, 1e6)}
    fit = least_squares(Problem(loop, free, [Target("LV.EF_percent", indexes["LV.EF_percent"])]))
    assert fit.undetermined == list(free)  # one target, three parameters: only a combination is known
    said = words_of(fit, tmp_path)
    assert said.count("not determined by these targets") >= 9
    assert fit.intervals["elastance.RA.EA"] == (0.02, 0.2)
    # What is tied is as little known as what it follows; the others are known.
    part = least_squares(Problem(loop, {n: f for n, f in free.items() if n != "elastance.RA.EA"},
                                 [Target(n, indexes[n]) for n in ("LV.EF_percent", "LV.SV_mL")],
                                 ties={"valves.TV.Rmax": Tie("valves.PV.Rmax")}))
    assert part.undetermined == ["valves.PV.Rmax", "valves.TV.Rmax"]
    low, high = part.intervals["elastance.LV.EA"]
    assert low < 2.75 < high < 2 * low
    words_of(part, tmp_path)


@pytest.mark.parametrize("inside", [True, False])
def test_ranges_alone(truth, tmp_path, inside):
    loop, indexes = truth
    free = {"elastance.LV.EA": Free(1, 8), "circuit.SYS.R_AR": Free(0.3, 2)}
    off = 0 if inside else 8
    targets = [Target(n, within=(indexes[n] - 5 + off, indexes[n] + 5 + off))
               for n in ("LV.EF_percent", "aorta.pressure_max_mmHg")]
    fit = least_squares(Problem(loop, free, targets))
    # Met ranges measure nothing, also where the search stopped on their edge.
    assert fit.converged and not fit.missed and fit.undetermined == list(free)
    assert not fit.jacobian.any()
    said = words_of(fit, tmp_path)
    assert "all 2 targets are met" in said and said.count("not determined by these targets") >= 6
    if inside:
        assert fit.parameters == pytest.approx({n: loop.parameters[n] for n in free}, rel=1e-6)


def test_a_range_on_its_edge_measures_nothing(truth):
    loop, indexes = truth
    # A weak pull holds the search a little outside: met, and no knowledge of a quarter of the width's precision.
    fit = least_squares(Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [
        Target("LV.EF_percent", within=(50, 58)), Target("LV.ESV_mL", indexes["LV.ESV_mL"], sd=100)]))
    assert 58 < fit.outputs["LV.EF_percent"] < 58.2 and not fit.missed
    assert fit.point.residuals[0] > 0 and not fit.jacobian[0].any() and fit.jacobian[1].any()
    assert fit.undetermined == ["elastance.LV.EA"] and fit.intervals["elastance.LV.EA"] == (1, 8)


def test_differences_and_ratios(truth):
    loop, indexes = truth
    outputs = [Difference("LV.EDV_mL", "RV.EDV_mL"), Ratio("RV.EDV_mL", "LV.EDV_mL"),
               Ratio(Difference("aorta.pressure_max_mmHg", "aorta.pressure_min_mmHg"), "LV.SV_mL"),
               Difference(Ratio("LV.SV_mL", "LV.EDV_mL"), Ratio("RV.SV_mL", "RV.EDV_mL"))]
    a, b = indexes["LV.EDV_mL"], indexes["RV.EDV_mL"]
    pulse = (indexes["aorta.pressure_max_mmHg"] - indexes["aorta.pressure_min_mmHg"]) / indexes["LV.SV_mL"]
    ejected = 0.01 * (indexes["LV.EF_percent"] - indexes["RV.EF_percent"])
    targets = [Target(o, v, sd=s) for o, v, s in zip(outputs, (a - b, b / a, pulse, ejected), (1, 0.01, 0.01, 0.01),
                                                     strict=True)]
    assert [t.label for t in targets] == [
        "LV.EDV_mL - RV.EDV_mL", "RV.EDV_mL / LV.EDV_mL",
        "(aorta.pressure_max_mmHg - aorta.pressure_min_mmHg) / LV.SV_mL", "LV.SV_mL / LV.EDV_mL - RV.SV_mL / RV.EDV_mL"]
    free = {n: Free(0.6 * loop.parameters[n], 1.6 * loop.parameters[n])
            for n in ("elastance.LV.EB", "elastance.RV.EB", "circuit.SYS.C_AR", "elastance.LV.EA")}
    problem = Problem(loop, free, targets, distance=1e-11)
    assert [problem.unit_of(t) for t in targets] == ["mL", "1", "mmHg/mL", "1"]
    point = problem.point(problem.start)
    assert point.outputs == pytest.approx([a - b, b / a, pulse, ejected], rel=1e-6, abs=1e-8)
    exact = problem.jacobian(problem.start).copy()
    for k in range(len(free)):
        h = np.zeros(len(free))
        h[k] = 1e-4
        quotient = (problem.residuals(problem.start + h) - problem.residuals(problem.start - h)) / 2e-4
        assert quotient == pytest.approx(exact[:, k], rel=2e-4, abs=2e-5 * np.abs(exact).max())
    # They find the parameters again.
    start = problem.start + np.array([0.2, -0.2, 0.15, -0.1])
    fit = least_squares(problem, start=start)
    assert fit.parameters == pytest.approx({n: loop.parameters[n] for n in free}, rel=1e-4)
    assert fit.outputs["LV.EDV_mL - RV.EDV_mL"] == pytest.approx(a - b, abs=1e-3)
    rows = problem.residuals_of_many(np.array([problem.start]))
    assert np.abs(rows).max() < 1e-3


def test_ties_of_a_loop(truth, tmp_path):
    loop, _ = truth
    free = {"elastance.LV.EA": Free(1, 8), "elastance.LV.tC": Free(0.01, 0.1, "linear"),
            "circuit.SYS.R_AR": Free(0.3, 2)}
    ties = {"elastance.RV.EA": Tie("elastance.LV.EA", times=0.2, plus=0.01),
            "elastance.RV.tC": Tie("elastance.LV.tC", plus=0.005),
            "elastance.LV.EB": Tie("elastance.LV.EA", times=0.03)}
    assert str(ties["elastance.RV.tC"]) == "elastance.LV.tC + 0.005"
    true = loop.copy()
    true.parameters.update({"elastance.LV.EA": 3.0, "elastance.RV.EA": 0.61, "elastance.LV.EB": 0.09,
                            "elastance.LV.tC": 0.03, "elastance.RV.tC": 0.035})
    indexes = true.to_limit_cycle(distance=1e-11).indexes
    wanted = ["LV.EDV_mL", "LV.ESV_mL", "RV.EDV_mL", "aorta.pressure_max_mmHg", "RV.pressure_max_mmHg",
              "valves.AV.opens_s", "valves.PV.opens_s"]
    problem = Problem(loop, free, [Target(n, indexes[n]) for n in wanted], ties=ties, distance=1e-11)
    x = problem.start + np.array([0.05, 0.007, 0.1])
    exact = problem.jacobian(x).copy()
    for k, h in enumerate((1e-4, 1e-5, 1e-4)):
        step = np.zeros(3)
        step[k] = h
        quotient = (problem.residuals(x + step) - problem.residuals(x - step)) / (2 * h)
        assert quotient == pytest.approx(exact[:, k], rel=2e-3, abs=1e-4 * np.abs(exact[:, k]).max())
    fit = least_squares(problem)
    for name in (*free, *ties):
        assert fit.parameters[name] == pytest.approx(true.parameters[name], rel=1e-5), name
    low, high = fit.intervals["elastance.LV.tC"]
    assert fit.intervals["elastance.RV.tC"] == pytest.approx((low + 0.005, high + 0.005))
    said = words_of(fit, tmp_path)
    assert "= elastance.LV.tC + 0.005" in said and "= 0.2 * elastance.LV.EA + 0.01" in said
    rows = problem.residuals_of_many(np.array([fit.x]))
    assert np.abs(rows).max() < 1e-3
    posterior = mcmc(problem, around=fit.x, steps=4, burn_in=0, walkers=8)
    assert posterior.samples[:, 4] == pytest.approx(posterior.samples[:, 1] + 0.005)


def test_ties_of_a_heart():
    heart = wiggers.Heart(HEART)
    free = {"walls.LV.tC": Free(0.1, 0.25, "linear"), "walls.LV.EA": Free(1, 6)}
    problem = Problem(heart, free, [Target("LV.EDV_mL", 110), Target("RV.EDV_mL", 110), Target("LV.SV_mL", 70)],
                      ties={"walls.RV.tC": Tie("walls.LV.tC", plus=0.005),
                            "walls.RV.EA": Tie("walls.LV.EA", times=0.2)},
                      distance=1e-10)
    x = problem.start + np.array([0.0004, 0.03])
    exact = problem.output_jacobian(x).copy()
    for k, h in enumerate((1e-5, 1e-4)):
        step = np.zeros(2)
        step[k] = h
        quotient = (problem.point(x + step).outputs - problem.point(x - step).outputs) / (2 * h)
        assert quotient == pytest.approx(exact[:, k], rel=1e-2, abs=1e-3 * np.abs(exact[:, k]).max())
    values = problem.values(x)
    assert values["walls.RV.tC"] == values["walls.LV.tC"] + 0.005
    assert values["walls.RV.EA"] == 0.2 * values["walls.LV.EA"]


def test_many_starts(truth, tmp_path):
    loop, indexes = truth
    # Long contractions do not fit into the period: starts there are reported, and the others go on.
    free = {"elastance.LV.TC": Free(0.15, 1.2, "linear"), "elastance.LV.EA": Free(1, 8)}
    targets = [Target(n, indexes[n]) for n in ("LV.EF_percent", "aorta.pressure_max_mmHg", "LV.EDV_mL")]
    problem = Problem(loop, free, targets)
    fit = least_squares(problem, starts=6, seed=3)
    assert len(fit.searches) == 6 and fit.converged and not fit.missed
    bad = [s for s in fit.searches if s.cost is None]
    assert 0 < len(bad) < 6
    for search in bad:
        assert search.end is None and search.start["elastance.LV.TC"] > 0.6
        assert "longer than the period" in search.message
    good = [s for s in fit.searches if s.cost is not None]
    assert fit.cost == min(s.cost for s in good)
    assert fit.parameters == pytest.approx({n: loop.parameters[n] for n in free}, rel=1e-4)
    again = least_squares(Problem(loop, free, targets), starts=6, seed=3)
    assert [s.start for s in again.searches] == [s.start for s in fit.searches]
    assert least_squares(Problem(loop, free, targets), starts=2, seed=4).searches[1].start != fit.searches[1].start
    assert "6 starts: " in words_of(fit, tmp_path) and "longer than the period" in repr(fit)
    # The first start without a cycle is a point with a reason: another one is found.
    lost = least_squares(problem, start=np.array([1.1, np.log(3)]))
    assert lost.searches[0].cost is None and "longer than the period" in lost.searches[0].message
    assert lost.parameters == pytest.approx({n: loop.parameters[n] for n in free}, rel=1e-4)
    nowhere = Problem(loop, {"elastance.LV.TC": Free(0.8, 1.2)}, targets)
    assert nowhere.base is None and len(nowhere.failures) == 1
    with pytest.raises(wiggers.NumericalFailure, match=r"no limit cycle at 11 points.*longer than the period"):
        least_squares(nowhere)
    with pytest.raises(wiggers.NumericalFailure, match="no walker has a limit cycle"):
        mcmc(nowhere, steps=2, burn_in=0)
    with pytest.raises(wiggers.NumericalFailure, match="no sample has LV.EF_percent"):
        sobol(nowhere, samples=4)


def test_steps_without_a_cycle_are_rejected(truth, monkeypatch):
    loop, indexes = truth
    # The targets pull towards contractions that do not fit into the period.
    problem = Problem(loop, {"elastance.LV.TC": Free(0.15, 1.2, "linear"), "elastance.LV.EA": Free(1, 8)},
                      [Target("valves.AV.closes_s", indexes["valves.AV.closes_s"] + 0.45, sd=0.01),
                       Target("aorta.pressure_max_mmHg", 110, sd=5)])
    fit = least_squares(problem)
    assert fit.failures and all("longer than the period" in reason for _, reason in fit.failures)
    assert 0.5 < fit.parameters["elastance.LV.TC"] <= 0.8 - loop.parameters["elastance.LV.TR"] + 1e-9
    assert "points without a limit cycle were rejected" in repr(fit) and fit.missed
    # A beat that has no such output is such a point too.
    silent = Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [Target("E_over_A.MV", indexes["E_over_A.MV"])])
    solve = silent.model.to_limit_cycle

    def without_waves(*arguments, **options):
        cycle = solve(*arguments, **options)
        if silent.model.parameters["elastance.LV.EA"] < 2:
            del cycle.indexes["E_over_A.MV"]
        return cycle

    monkeypatch.setattr(silent.model, "to_limit_cycle", without_waves)
    fit = least_squares(silent, start=np.array([np.log(1.5)]))
    assert fit.searches[0].cost is None and fit.searches[0].message == "this beat has no E_over_A.MV"
    assert fit.parameters["elastance.LV.EA"] == pytest.approx(2.75, rel=1e-3)


def test_no_derivatives_end_a_search_with_a_reason(truth, monkeypatch):
    loop, indexes = truth
    problem = Problem(loop, {"elastance.LV.EA": Free(1, 8)}, [Target("LV.EF_percent", 40.0)])
    solve, calls = problem.model.sensitivities, []

    def sensitivities(cycle):
        calls.append(cycle)
        if len(calls) == 3:
            raise wiggers.NumericalFailure("a multiplier of its beat map is one")
        return solve(cycle)

    monkeypatch.setattr(problem.model, "sensitivities", sensitivities)
    fit = least_squares(problem)
    assert not fit.converged and "a multiplier of its beat map is one" in fit.message and fit.gradients == 2
    assert abs(fit.outputs["LV.EF_percent"] - 40) < abs(indexes["LV.EF_percent"] - 40)
    assert "did not converge" in repr(fit)


@pytest.mark.parametrize(("make", "words"), [
    (lambda m: Tie(3), "tie's to = 3"), (lambda m: Tie("elastance.LV.EA", times="2"), "times = '2' is not a number"),
    (lambda m: Tie("elastance.LV.EA", times=0), "ties nothing"),
    (lambda m: Tie("elastance.LV.EA", plus=float("nan")), "not finite"),
    (lambda m: tied(m, {"elastance.RV.EA": 0.2}), "wanted is a Tie"),
    (lambda m: tied(m, {"elastance.RV.EX": Tie("elastance.LV.EA")}), "did you mean 'elastance.RV.EA'"),
    (lambda m: tied(m, {"elastance.RV.EA": Tie("elastance.LV.EX")}), "did you mean 'elastance.LV.EA'"),
    (lambda m: tied(m, {"elastance.RV.EA": Tie("elastance.LA.EA")}), "which is not free"),
    (lambda m: tied(m, {"elastance.LV.EA": Tie("elastance.LV.EA", 0.2)}), "is free and tied"),
    (lambda m: tied(m, {"elastance.RV.EA": Tie("elastance.LV.EA")}, held={"elastance.RV.EA": 1.0}), "is held and tied"),
    (lambda m: tied(m, {"elastance.RV.tC": Tie("elastance.LV.EA")}), "units differ, so say times"),
    (lambda m: tied(m, {"elastance.RV.EA": Tie("elastance.LV.EA", plus=-2)}), "leave its range"),
    (lambda m: Difference("LV.EDV_mL", 3), "wanted is a name"), (lambda m: Target(3, 1.0), "name of a target = 3"),
    (lambda m: tied(m, {}, [Target(Difference("LV.EDV_mL", "LV.EF_percent"), 3)]),
     "LV.EDV_mL is in mL, LV.EF_percent in %"),
    (lambda m: tied(m, {}, [Target(Ratio("LV.EDV", "RV.EDV_mL"), 3)]), "did you mean 'LV.EDV_mL'"),
    (lambda m: tied(m, {}, [Target(Ratio("LV.EDV_mL", "RV.EDV_mL"), 1, unit="mL")]),
     "unit mL, but this output is in 1"),
    (lambda m: Target("LV.EDV_mL", "100"), "value = '100' is not a number"),
    (lambda m: Target("LV.EDV_mL", True), "is not a number"),
    (lambda m: Target("LV.EDV_mL", within=5), "wanted is"),
    (lambda m: Target("LV.EDV_mL", 5, sd=1j), "sd = 1j is not a number"),
    (lambda m: Free("1", 2), "lower bound = '1'"), (lambda m: Free(True, 2), "lower bound = True"),
    (lambda m: Problem(m, {"elastance.LV.EA": (1, 2)}, [Target("LV.EDV_mL", 100)]), "wanted is a Free"),
    (lambda m: Problem(m, {"elastance.LV.EA": Free(1, 6)}, ["LV.EDV_mL"]), "wanted is a Target"),
    (lambda m: least_squares(tied(m, {}), start=None), "start has dtype object"),
    (lambda m: least_squares(tied(m, {}), start=np.ones(2)), r"start has shape \(2,\)"),
    (lambda m: least_squares(tied(m, {}), start=np.array([np.nan])), "finite coordinates"),
    (lambda m: least_squares(tied(m, {}), starts=0), "starts = 0"),
    (lambda m: least_squares(tied(m, {}), starts=True), "starts = True"),
])
def test_refusals_of_ties_and_outputs(truth, make, words):
    with pytest.raises(wiggers.InputError, match=words):
        make(truth[0])


def tied(loop, ties, targets=(Target("LV.EDV_mL", 110),), held=None):
    return Problem(loop, {"elastance.LV.EA": Free(1, 6)}, targets, ties=ties, held=held)


def test_adapters(truth):
    loop, indexes = truth
    names = ["elastance.LV.EA", "circuit.SYS.R_AR"]
    problem = Problem(loop, {n: Free(0.6 * loop.parameters[n], 1.6 * loop.parameters[n]) for n in names},
                      [Target(o, indexes[o]) for o in ("LV.ESV_mL", "aorta.pressure_max_mmHg", "LV.EDV_mL")],
                      distance=1e-6)
    found, cost = cma_es(problem, max_evaluations=250)
    assert cost < 1e-2 and found["elastance.LV.EA"] == pytest.approx(2.75, rel=0.02)
    posterior = mcmc(problem, steps=60, burn_in=30, walkers=12)
    fit = least_squares(problem)
    for name in names:
        low, high = posterior.interval(name)
        linear = fit.intervals[name]
        assert low < loop.parameters[name] < high
        assert 0.4 < (high - low) / (linear[1] - linear[0]) < 2.5
    assert 0.2 < posterior.acceptance < 0.95
    screening = sobol(problem, samples=32)
    row = screening.targets.index("aorta.pressure_max_mmHg")
    assert screening.total[row].sum() == pytest.approx(1, abs=0.3) and not any(screening.failures.values())


def test_force_calcium():
    force = wiggers.Force("fedele2023-ventricles")
    calcium = [0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2]
    curve = ForceCalcium(force, calcium, 1.9)
    wanted = curve.to_limit_cycle().indexes
    start = force.copy()
    start.parameters.update({"Kd0": 0.45, "gamma": 24.0, "a_XB": 1.2e6})
    fit = least_squares(Problem(ForceCalcium(start, calcium, 1.9),
                                {"Kd0": Free(0.1, 1), "gamma": Free(10, 60), "a_XB": Free(2e5, 2.2e6)},
                                [Target(n, v) for n, v in wanted.items()]))
    for name in ("Kd0", "gamma", "a_XB"):
        assert fit.parameters[name] == pytest.approx(force.parameters[name], rel=1e-4)


def test_report(truth, tmp_path):
    loop, indexes = truth
    fit = least_squares(Problem(loop, {"elastance.LV.EA": Free(1, 8)},
                                [Target("LV.EF_percent", 55.0), Target("LV.EDV_mL", 60.0)]))
    page = write_report(fit, tmp_path / "fit.html").read_text()
    assert "elastance.LV.EA" in page and "<span class='flag'>" in page and "http" not in page
    assert any(name == "LV.EDV_mL" for name, _, _ in fit.explain().outside)
    assert "not met: LV.EDV_mL" in str(fit.explain())
