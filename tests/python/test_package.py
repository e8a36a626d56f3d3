"""The Python package: parameters, cycles, sensitivities, batches, saved states, refusals, stubs."""

import ast
import copy
import importlib
import json
import multiprocessing
import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import wiggers

ROOT = Path(os.environ["WIGGERS_ROOT"])
PACKAGE = Path(wiggers.__file__).parent
SCENE = str(ROOT / "scenes" / "elastance_healthy.toml")


@pytest.fixture(scope="module")
def loop():
    return wiggers.Loop()


@pytest.fixture(scope="module")
def loop_cycle(loop):
    return loop.to_limit_cycle(distance=1e-9)


def test_every_stubbed_name_imports():
    stub = PACKAGE / "_core.pyi"
    assert (PACKAGE / "py.typed").exists()
    names = {node.name for node in ast.parse(stub.read_text()).body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    assert {"CellModel", "HeartModel", "InputError", "models"} <= names
    core = importlib.import_module("wiggers._core")
    for name in names:
        assert hasattr(core, name), name
    for module in ("wiggers", "wiggers.calibration"):
        loaded = importlib.import_module(module)
        for name in loaded.__all__:
            assert hasattr(loaded, name), name


def test_parameters_are_mapping_and_attributes(loop):
    model = loop.copy()
    p = model.parameters
    assert len(p) == len(p.names) == len(p.array) == 46
    info = p.info("elastance.LV.EA")
    assert (info.unit, info.default, info.lower) == ("mmHg/mL", 2.75, 0) and "amplitude" in info.meaning
    p.elastance.LV.EA = 3
    assert p["elastance.LV.EA"] == p.elastance.LV.EA == 3
    p.update({"elastance.LV.TC": 0.3, "elastance.LV.TR": 0.2})
    assert p.to_pandas().loc["elastance.LV.TR", "value"] == 0.2
    assert loop.parameters.elastance.LV.EA == 2.75  # the copy is a copy
    # The blood volume stays when a compliance changes.
    volume = p.initial.total_volume
    p["circuit.SYS.C_VEN"] = 50
    assert p.initial.total_volume == pytest.approx(volume, rel=1e-14)


@pytest.mark.parametrize(("name", "value", "words"), [
    ("elastance.LV.EX", 1, "did you mean 'elastance.LV.EA'"),
    ("elastance.LV.EB", -1, "outside its range 0.001 to 20 mmHg/mL"),
    ("elastance.LV.EA", float("nan"), "nan"),
    ("elastance.LV.EA", "big", "is not a number"),
    ("elastance.LV.TC", 0.7, "longer than the period"),
])
def test_parameters_refuse(loop, name, value, words):
    model = loop.copy()
    before = model.parameters.array
    with pytest.raises(wiggers.InputError, match=words.replace("(", r"\(")):
        model.parameters[name] = value
    assert np.array_equal(model.parameters.array, before)


@pytest.mark.parametrize("make", [
    lambda: wiggers.Loop(), lambda: wiggers.Cell("ttp06-epi", dt_ms=0.1), lambda: wiggers.Cell("crn", dt_ms=0.1),
])
def test_rhs_and_jacobian(make):
    model = make()
    y = model.initial_state
    jacobian = model.jacobian(0.3, y)
    assert jacobian.shape == (len(y), len(y)) == (len(model.states),) * 2
    for k in range(len(y)):
        h = 1e-6 * max(abs(y[k]), 1e-3)
        up, down = y.copy(), y.copy()
        up[k] += h
        down[k] -= h
        quotient = (model.rhs(0.3, up) - model.rhs(0.3, down)) / (2 * h)
        scale = np.abs(jacobian).max(axis=1) + 1e-9
        assert np.all(np.abs(quotient - jacobian[:, k]) < 1e-4 * scale)


def test_force():
    force = wiggers.Force("fedele2023-ventricles")
    tension, derivatives = force.force_calcium(np.array([0.2, 0.5]), 1.9)
    for name in ("Kd0", "gamma", "a_XB", "r0"):
        value, h = force.parameters[name], 1e-4
        curves = []
        for factor in (1 - h, 1 + h):
            changed = force.copy()
            changed.parameters[name] = value * factor
            curves.append(changed.force_calcium(np.array([0.2, 0.5]), 1.9)[0])
        quotient = (curves[1] - curves[0]) / (2 * h * value)
        assert derivatives[:, force.parameters.names.index(name)] == pytest.approx(quotient, rel=1e-5)
    t = np.linspace(0, 0.5, 501)
    twitch = force.run(t, 0.1 + 0.6 * np.exp(-((t - 0.1) / 0.05) ** 2), 1.9)
    assert 0 < twitch[0] < twitch.max() < 3 * tension[1]
    assert force.jacobian(force.steady_state(0.3, 1.9), 0.3, 1.9).shape == (20, 20)
    with pytest.raises(wiggers.InputError, match="does not increase"):
        force.run(t[::-1], t, 1.9)
    with pytest.raises(wiggers.InputError, match="nan"):
        force.run(t, np.full_like(t, np.nan), 1.9)


def test_cycle_and_trace(loop, loop_cycle):
    assert loop_cycle.certificate.converged and loop_cycle.certificate.distance < 1e-9
    trace = loop.run(2, loop_cycle)
    assert trace["t_s"][-1] == pytest.approx(1.6) and len(trace) == 1601
    assert trace["V_LV"].max() == pytest.approx(loop_cycle.indexes["LV.EDV_mL"], rel=1e-4)
    assert trace.unit("p_LV") == "mmHg"
    assert trace["V_LV"][800] == pytest.approx(trace["V_LV"][0], abs=1e-5)
    frame, dataset = trace.to_pandas(), trace.to_xarray()
    assert frame.attrs["units"]["V_LV"] == "mL" and dataset["V_LV"].attrs["units"] == "mL"
    with pytest.raises(wiggers.InputError, match="unknown column 'V_LW'; did you mean"):
        trace["V_LW"]


def test_no_hidden_copies():
    cell = wiggers.Cell("ttp06-endo")
    trace = cell.run(1, sample_ms=1e-3, integrator="rush-larsen-2")  # a million rows, 21 columns
    assert len(trace) == 1_000_001
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    views = [trace[name] for name in trace.names]
    assert sum(v.nbytes for v in views) > 1.6e8
    assert all(not v.flags.owndata for v in views)
    address = views[1].__array_interface__["data"][0]
    assert trace["V"].__array_interface__["data"][0] == address
    del trace
    assert np.isfinite(views[1]).all()  # the views keep the memory
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000  # kB


def test_saved_states(loop, loop_cycle, tmp_path):
    path = tmp_path / "cycle.json"
    loop_cycle.save(path)
    again = loop.load(path)
    assert np.array_equal(again.state, loop_cycle.state) and again.indexes == loop_cycle.indexes
    other = loop.copy()
    other.parameters.elastance.LV.EA = 2.8
    with pytest.raises(wiggers.StateMismatch, match="elastance.LV.EA = 2.75 there, 2.8 here"):
        other.load(path)
    warm = other.to_limit_cycle(wiggers.Cycle.load(path))
    assert warm.certificate.beats <= loop_cycle.certificate.beats
    with pytest.raises(wiggers.StateMismatch, match="saved by loop"):
        wiggers.Cell("crn").load(path)
    path.write_text(path.read_text()[:100])
    with pytest.raises(wiggers.InputError, match="not a saved limit cycle"):
        loop.load(path)


def test_sensitivities_and_warm_start(loop, loop_cycle):
    table = loop.sensitivities(loop_cycle)
    assert table.derivatives.shape == (75, 46)
    changed = loop.copy()
    changed.parameters.circuit.SYS.R_AR *= 1.001
    moved = changed.to_limit_cycle(distance=1e-9).indexes["aorta.pressure_max_mmHg"]
    slope = (moved - loop_cycle.indexes["aorta.pressure_max_mmHg"]) / (0.001 * loop.parameters.circuit.SYS.R_AR)
    assert table["aorta.pressure_max_mmHg", "circuit.SYS.R_AR"] == pytest.approx(slope, rel=1e-2)
    assert table.to_pandas().shape == table.to_xarray().shape == (75, 46)
    assert len(table.strongest("LV.EF_percent", 3)) == 3
    with pytest.raises(wiggers.InputError, match="unknown output 'LV.EDV'"):
        table["LV.EDV", "circuit.SYS.R_AR"]


def test_heart(tmp_path):
    heart = wiggers.Heart(SCENE)
    cycle = heart.to_limit_cycle()
    assert cycle.certificate.converged
    trace = heart.run(start=cycle)
    assert {"t_s", "V_LV", "p_LV", "Q_AV"} <= set(trace.names)
    table = heart.sensitivities(cycle, ["walls.LV.EA", "circulation.circuit.SYS.R_AR"])
    assert table.derivatives.shape[1] == 2
    heart.parameters["walls.LV.EA"] *= 1.01
    assert "EA" in heart.text
    batch = heart.batch({"walls.LV.EA": [2.0, -1.0, 3.0]}, near=cycle)
    assert list(batch.good) == [True, False, True] and "outside its range" in batch.reasons[1]
    with pytest.raises(wiggers.InputError, match="elastance_missing.toml"):
        wiggers.Heart(str(tmp_path / "elastance_missing.toml"))


def test_cell_without_cycle():
    cell = wiggers.Cell("ttp06-epi", dt_ms=0.1, period_ms=150)
    with pytest.raises(wiggers.NumericalFailure, match="limit cycle was not reached: not-converged"):
        cell.to_limit_cycle(max_beats=60)
    assert "APD90_ms" in wiggers.Cell("ttp06-epi", dt_ms=0.1).to_limit_cycle().indexes


def test_batch_is_the_same_one_by_one(loop, loop_cycle):
    samples = {"elastance.LV.EA": np.linspace(2, 4, 7), "circuit.SYS.R_AR": np.linspace(0.5, 1.1, 7)}
    batch = loop.batch(samples, distance=1e-9, threads=2)
    assert batch.good.all()
    for k in range(7):
        one = loop.copy()
        one.parameters.update({n: v[k] for n, v in samples.items()})
        indexes = one.to_limit_cycle(distance=1e-9).indexes
        assert batch["LV.EDV_mL"][k] == pytest.approx(indexes["LV.EDV_mL"], rel=1e-7)
    assert batch.to_pandas().shape[0] == batch.to_xarray().sizes["sample"] == 7


def test_a_bad_sample_does_not_stop_a_batch(loop):
    batch = loop.batch({"elastance.LV.EA": [2.75, 1e9, 2.75], "elastance.LV.TC": [0.272, 0.272, 0.79]})
    assert list(batch.good) == [True, False, False]
    assert "outside its range" in batch.reasons[1] and "longer than the period" in batch.reasons[2]
    assert np.isnan(batch["LV.EDV_mL"][1:]).all()
    with pytest.raises(wiggers.InputError, match="did you mean"):
        loop.batch({"elastance.LV.EAA": [1.0]})
    with pytest.raises(wiggers.InputError, match="shape"):
        loop.batch(np.ones((3, 2)), ["elastance.LV.EA"])
    with pytest.raises(wiggers.InputError, match="one length"):
        loop.batch({"elastance.LV.EA": [1.0, 2.0], "elastance.LV.EB": [1.0, 2.0, 3.0]})


def test_cell_batch():
    cell = wiggers.Cell("ttp06-endo", dt_ms=0.1)
    cycle = cell.to_limit_cycle()
    batch = cell.batch({"g_Kr": np.array([0.8, 1.0, 1.2]) * cell.parameters.g_Kr}, near=cycle)
    assert batch.good.all() and np.all(np.diff(batch["APD90_ms"]) < 0)
    assert batch["APD90_ms"][1] == pytest.approx(cycle.indexes["APD90_ms"], rel=1e-4)


def test_executors(loop):
    samples = {"elastance.LV.EA": np.linspace(2, 4, 6)}
    here = loop.batch(samples, distance=1e-9)
    with ProcessPoolExecutor(2) as pool:
        there = loop.batch(samples, executor=pool, chunk=2, distance=1e-9)
    assert np.allclose(here.values, there.values, rtol=1e-12, equal_nan=True)
    distributed = pytest.importorskip("dask.distributed")
    with distributed.Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        there = loop.batch(samples, executor=client.get_executor(), chunk=3, distance=1e-9)
    assert np.allclose(here.values, there.values, rtol=1e-12, equal_nan=True)


def test_models_pickle():
    for model in (wiggers.Loop(changes={"elastance.LV.EA": 3.1}), wiggers.Cell("crn", g_Na=8.0),
                  wiggers.Heart(SCENE, set={"walls.LV.EA": 2.2})):
        again = pickle.loads(pickle.dumps(model))
        assert np.array_equal(again.parameters.array, model.parameters.array)


def same(a, b):
    """Equal in every number and word, whatever the class."""
    if isinstance(a, np.ndarray):
        return (isinstance(b, np.ndarray) and np.array_equal(a, b, equal_nan=True)
                and a.flags.writeable == b.flags.writeable)
    if isinstance(a, wiggers.Trace):
        return a.names == b.names and all(same(a[n], b[n]) and (a.unit(n), a.meaning(n)) == (b.unit(n), b.meaning(n))
                                          for n in a.names) and same(a.end_state, b.end_state)
    if isinstance(a, wiggers.Sensitivities):
        return all(same(getattr(a, f), getattr(b, f)) for f in (
            "outputs", "output_units", "parameters", "parameter_units", "parameter_values", "values", "derivatives",
            "state_derivatives", "elasticities"))
    if isinstance(a, wiggers.Cycle | wiggers.Batch):
        return vars(a).keys() == vars(b).keys() and all(same(vars(a)[k], vars(b)[k]) for k in vars(a))
    return type(a) is type(b) and a == b


@pytest.fixture(scope="module")
def held(loop, loop_cycle):
    """One of everything that a user keeps."""
    cell = wiggers.Cell("ttp06-endo", dt_ms=0.1)
    return {
        "trace": loop.run(2, loop_cycle), "cell's trace": cell.run(1, sample_ms=10), "cycle": loop_cycle,
        "sensitivities": loop.sensitivities(loop_cycle), "certificate": loop_cycle.certificate,
        "batch": loop.batch({"elastance.LV.EA": [2.0, -1.0]}), "parameters": loop.parameters,
        "part": loop.parameters.elastance.LV, "info": loop.parameters.info("elastance.LV.EA"),
    }


KEPT = ["trace", "cell's trace", "cycle", "sensitivities", "certificate", "batch", "parameters", "info"]


@pytest.mark.parametrize("name", KEPT)
def test_results_copy_and_pickle(held, name):
    kept = held[name]
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        assert same(kept, pickle.loads(pickle.dumps(kept, protocol)))
    assert same(kept, copy.copy(kept)) and same(kept, copy.deepcopy(kept))


def test_copied_facts_and_parts(held):
    info, again = held["info"], pickle.loads(pickle.dumps(held["info"]))
    assert repr(again) == repr(info) and (again.unit, again.default, again.upper) == ("mmHg/mL", 2.75, info.upper)
    assert pickle.loads(pickle.dumps(held["part"])).EA == 2.75
    other = copy.deepcopy(held["parameters"])
    other.elastance.LV.EA = 3.3  # of a model of its own
    assert held["parameters"].elastance.LV.EA == 2.75 and other != held["parameters"]
    assert held["certificate"] != wiggers.Loop().to_limit_cycle(distance=1e-3).certificate


def beat_of(loop):
    return loop.run(1)


def everything_of(cell_parameters):
    force = wiggers.Force("fedele2023-ventricles")
    force.run(np.linspace(0, 0.1, 11), np.full(11, 0.3), 1.9)
    return cell_parameters, force


def test_results_pass_between_processes(loop):
    cell = wiggers.Cell("crn", g_Na=8.0)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        beats = pool.map(beat_of, [loop])
    with ProcessPoolExecutor(1) as pool:
        beats += pool.map(beat_of, [loop])
        parameters, force = pool.submit(everything_of, cell.parameters).result()
    assert all(same(beat, loop.run(1)) for beat in beats)
    assert parameters == cell.parameters and parameters.g_Na == 8.0
    assert np.array_equal(force.end_state, everything_of(None)[1].end_state)


def test_models_copy_bit_by_bit():
    loop = wiggers.Loop(changes={"elastance.LV.EA": 3.1})
    heart = wiggers.Heart(SCENE)
    for factor in (1.0137, 0.77, 1.31):  # the blood volume is a sum, which rounds
        loop.parameters["circuit.SYS.C_VEN"] *= factor
        heart.parameters["circulation.circuit.SYS.C_VEN"] *= factor
    force = wiggers.Force("fedele2023-atria", Kd0=0.4)
    assert force.end_state is None and copy.deepcopy(force).end_state is None
    for model in (loop, heart, force, wiggers.Cell("ttp06-mid", dt_ms=0.1, period_ms=700)):
        for again in (pickle.loads(pickle.dumps(model)), copy.copy(model), copy.deepcopy(model)):
            assert np.array_equal(again.parameters.array, model.parameters.array)
            if hasattr(model, "initial_state"):
                assert np.array_equal(again.initial_state, model.initial_state)
            again.parameters[again.parameters.names[-1]] += 0.01
            assert not np.array_equal(again.parameters.array, model.parameters.array)
    force.run(np.linspace(0, 0.1, 11), np.full(11, 0.3), 1.9)
    for again in (pickle.loads(pickle.dumps(force)), copy.deepcopy(force), force.copy()):
        assert same(again.end_state, force.end_state)


def test_views_cannot_be_assigned(loop, loop_cycle, held):
    arrays = [held["trace"]["V_LV"], held["trace"].end_state, held["cycle"].state, held["batch"].values,
              held["batch"].states, held["batch"].samples, held["batch"]["LV.EDV_mL"], held["sensitivities"].values,
              held["sensitivities"].derivatives, held["sensitivities"].state_derivatives,
              held["sensitivities"].parameter_values]
    for array in arrays + [pickle.loads(pickle.dumps(held["cycle"])).state, copy.deepcopy(held["cycle"]).state]:
        assert not array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    column = held["trace"]["V_LV"]
    assert np.shares_memory(column, held["trace"]["V_LV"])
    with pytest.raises(ValueError, match="WRITEABLE"):
        column.flags.writeable = True
    # A batch does not hold the caller's memory, and does not lock it.
    mine = np.array([[2.0], [3.0]])
    batch = loop.batch(mine, ["elastance.LV.EA"])
    mine[0] = 9
    assert batch.samples[0, 0] == 2
    # A read-only state is a start like any other.
    assert np.array_equal(loop.run(1, loop_cycle.state).end_state, loop.run(1, np.array(loop_cycle.state)).end_state)
    assert loop.to_limit_cycle(held["trace"].end_state).certificate.converged
    frame = held["sensitivities"].to_pandas()
    frame.iloc[0, 0] = 1.0  # tables are copies


@pytest.mark.parametrize("scene", [SCENE, str(ROOT / "scenes" / "whole_heart.toml")])
def test_heart_goes_on(scene):
    heart = wiggers.Heart(scene)
    away = heart.run(1, heart.to_limit_cycle()).end_state.copy()
    away[[0, 2]] += 5, -5  # mL of blood from one atrium to the other
    # The search's own plain beats, which are the driver's one after another.
    paced = heart.to_limit_cycle(away, method="pacing", distance=1e-2)
    start = away.copy()
    n = paced.certificate.beats
    whole = heart.run(n, start)
    assert n >= 3 and np.allclose(whole.end_state, paced.state, rtol=1e-11, atol=1e-11)
    # One by one, in another heart, through a pickle: the same bits.
    other = pickle.loads(pickle.dumps(heart))
    state, steps = start, round((len(whole) - 1) / n)
    for beat in range(n):
        trace = other.run(1, state)
        for name in trace.names[1:]:
            here = whole[name][beat * steps:(beat + 1) * steps]
            assert np.array_equal(here, trace[name][:-1]), (beat, name)
        assert np.allclose(whole["t_s"][beat * steps:(beat + 1) * steps], trace["t_s"][:-1] + beat * 0.8, atol=1e-12)
        state = trace.end_state
    assert np.array_equal(state, whole.end_state) and whole["t_s"][-1] == pytest.approx(0.8 * n)
    assert np.all(np.diff(whole["t_s"]) > 0)
    # Left out, the start is the limit cycle.
    assert heart.run()["V_LV"].max() == pytest.approx(heart.to_limit_cycle().indexes["LV.EDV_mL"], abs=0.05)


@pytest.mark.parametrize("make", [wiggers.Loop, lambda: wiggers.Cell("ttp06-endo")])
def test_runs_go_on(make):
    model = make()
    both, one = model.run(2), model.run(1)
    two = model.run(1, one.end_state)
    assert all(np.array_equal(both[n], np.concatenate([one[n][:-1], two[n]])) for n in one.names[1:])
    assert np.array_equal(both.end_state, two.end_state)


def test_progress_is_called_and_may_stop(loop):
    seen = []
    loop.to_limit_cycle(progress=lambda beats, distance: seen.append(beats))
    assert seen == list(range(1, len(seen) + 1))

    class Enough(Exception):
        pass

    def stop(beats, distance):
        raise Enough

    with pytest.raises(Enough):
        loop.to_limit_cycle(progress=stop)
    assert loop.to_limit_cycle().certificate.converged  # still usable


def test_threads_run_beside(loop):
    """The interpreter's lock is free during runs: two threads of Python both get on."""
    ticks = []
    done = threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    begun = time.perf_counter()
    loop.batch({"elastance.LV.EA": np.linspace(2, 4, 100)}, threads=1)
    spent = time.perf_counter() - begun
    done.set()
    thread.join()
    assert len(ticks) > 20 * spent


def test_interrupt_leaves_a_usable_object():
    program = """
import os, signal, sys, threading, time, wiggers
cell = wiggers.Cell("crn", dt_ms=0.02)
threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    cell.to_limit_cycle(distance=1e-13)
except KeyboardInterrupt:
    print("interrupted", cell.run(1)["V"].max() > 0)
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert result.stdout.strip() == "interrupted True", result.stderr


def test_report_from_python(tmp_path):
    command = os.environ["WIGGERS"]
    result = tmp_path / "run.h5"
    subprocess.run([command, "run", SCENE, "-o", str(result), "--quiet"], check=True, capture_output=True)
    subprocess.run([sys.executable, "-m", "wiggers", "report", str(result), "-o", str(tmp_path / "report")], check=True)
    assert (tmp_path / "report" / "index.html").stat().st_size > 10_000
    refused = subprocess.run([sys.executable, "-m", "wiggers", "report", "nothing.h5"], capture_output=True, text=True,
                             check=False)
    assert refused.returncode == 2 and "no such file" in refused.stderr


def test_one_heart_runs_at_a_time():
    heart = wiggers.Heart(SCENE)
    with pytest.raises(wiggers.InputError, match="this heart is running"):
        heart.to_limit_cycle(progress=lambda beats, distance: heart.parameters.__setitem__("walls.LV.EA", 2.5))
    cold = heart.to_limit_cycle()
    with ThreadPoolExecutor(4) as pool:
        batch = heart.batch({"walls.LV.EA": np.linspace(2, 3, 8)}, executor=pool, chunk=1)
    assert batch.good.all()
    # A start from the scene owes nothing to what ran before, failed calls included.
    with pytest.raises((wiggers.NumericalFailure, wiggers.InputError)):
        heart.indexes(np.full_like(cold.state, 1e5))
    assert np.array_equal(heart.to_limit_cycle().state, cold.state)
    # Samples do not depend on whether the base point has a cycle.
    heart.parameters.update({"walls.LV.EB": 20.0, "walls.LV.EA": 0.0})
    batch = heart.batch({"walls.LV.EB": [0.08, 0.09], "walls.LV.EA": [2.75, 2.75]}, near=cold)
    assert batch.good.all()


@pytest.mark.parametrize(("call", "words"), [
    (lambda: wiggers.Cell("crn", dt_ms=0.0), "dt = 0 ms is outside"),
    (lambda: wiggers.Cell("crn", integrator="cvode"), "unknown integrator"),
    (lambda: wiggers.Cell("crn2"), "did you mean 'crn'"),
    (lambda: wiggers.Loop().run(1, sample_s=0.0), "sample_s = 0 s is outside"),
    (lambda: wiggers.Loop().run(1, sample_s=float("nan")), "sample_s = nan s is outside"),
    (lambda: wiggers.Loop().run(0), "beats = 0"),
    (lambda: wiggers.Loop().to_limit_cycle(np.ones(11)), r"shape \(11\), wanted is \(12,\)"),
    (lambda: wiggers.Loop().to_limit_cycle(np.array(["a"] * 12)), "dtype"),
    (lambda: wiggers.Heart(SCENE).refined(np.array([])), "the state has 0 numbers"),
    (lambda: wiggers.Heart(SCENE).indexes(np.ones(40)), "the state has 40 numbers"),
    (lambda: wiggers.Loop().batch({"elastance.LV.EA": ["big"]}), "could not convert"),
])
def test_calls_refuse(call, words):
    with pytest.raises(wiggers.InputError, match=words):
        call()


def test_states_of_other_structure_are_refused(loop, loop_cycle, tmp_path):
    path = tmp_path / "cycle.json"
    loop_cycle.save(path)
    with pytest.raises(wiggers.StateMismatch, match="runge-kutta-4 at 0.001 s"):
        wiggers.Loop(dt_s=5e-4).load(path)
    changed = loop.copy()
    changed.parameters.circuit.SYS.C_VEN = 50.3
    with pytest.raises(wiggers.StateMismatch, match="C_VEN"):
        changed.sensitivities(loop_cycle)
    # Rounding in the blood volume, which is a sum, is no difference.
    changed.parameters.circuit.PUL.C_AR = 3.3
    cycle = changed.to_limit_cycle()
    cycle.save(path)
    again = wiggers.Loop()
    again.parameters.update(wiggers.Cycle.load(path).parameters)
    assert np.array_equal(again.load(path).state, cycle.state)
    assert pickle.loads(pickle.dumps(cycle)).certificate.beats == cycle.certificate.beats


def test_other_integrators_find_the_cycle(loop_cycle):
    cycle = wiggers.Loop(integrator="cvode").to_limit_cycle()
    assert cycle.indexes["LV.EDV_mL"] == pytest.approx(loop_cycle.indexes["LV.EDV_mL"], rel=1e-5)


def test_no_cycle_where_charge_is_not_kept():
    cell = wiggers.Cell("ttp06-endo", dt_ms=0.1)
    batch = cell.batch({"stimulus_K_fraction": [0.5, 0.5, 1.0]})
    assert list(batch.good) == [False, False, True] and "stimulus_K_fraction" in batch.reasons[0]


def test_refined_certifies_what_it_did():
    cell = wiggers.Cell("ttp06-endo", dt_ms=0.1)
    cycle = cell.to_limit_cycle()
    refined = cell.refined(cycle)
    assert refined.certificate.residual < 1e-11 < cycle.certificate.residual
    with pytest.raises(wiggers.NumericalFailure):
        wiggers.Cell("crn", dt_ms=0.1, period_ms=400).refined(wiggers.Cell("crn").initial_state)


def test_empty_batches(loop):
    assert len(loop.batch({"elastance.LV.EA": []})) == 0
    with ThreadPoolExecutor(1) as pool:
        assert len(loop.batch({"elastance.LV.EA": []}, executor=pool)) == 0
    shares = []
    loop.batch({"elastance.LV.EA": [2.5, 2.6]}, progress=shares.append)
    assert shares[-1] == 1.0


@pytest.mark.parametrize("key, value, words", [
    ("state", [], "state has 0 numbers"),
    ("state", 5, "state is 5, wanted is a list"),
    ("state", ["0x1p0", "nan"], r"state\[1\] is not finite"),
    ("state", ["0x1p0", "inf"], r"state\[1\] is not finite"),
    ("state", ["0x1p99999"], "state"),
    ("state", ["one"], "not a number in hexadecimal"),
    ("state", [1.5], "not a number in hexadecimal"),
    ("state", ["0x1p0"], "checksum is not that of the content"),
    ("model", 3, "model is 3, wanted is a text"),
    ("model", None, "model is missing"),
    ("parameters", [], "parameters is a list"),
    ("parameters", {"period_s": "fast"}, "parameters.period_s is 'fast', not a number"),
    ("parameters", {"period_s": True}, "parameters.period_s is True, not a number"),
    ("parameters", {"period_s": 10**400}, "parameters.period_s is not finite"),
    ("indexes", {"LV.EDV_mL": None}, "indexes.LV.EDV_mL is missing"),
    ("certificate", "period-1", "certificate is 'period-1'"),
    ("certificate.verdict", "banana", "banana"),
    ("certificate.verdict", "period1", "did you mean 'period-1'"),
    ("certificate.verdict", 1, "verdict is 1"),
    ("certificate.distance", -1, "distance is -1"),
    ("certificate.beats", -1, "beats is -1"),
    ("certificate.beats", 2.5, "beats is 2.5"),
    ("certificate.beats", 2**40, "beats"),
    ("format", "1", "format is '1'"),
    ("structure", 1, "structure is 1"),
])
def test_a_saved_cycle_is_believed_in_nothing(loop, loop_cycle, tmp_path, key, value, words):
    path = tmp_path / "cycle.json"
    loop_cycle.save(path)
    content = json.loads(path.read_text())
    place = content
    *tables, last = key.split(".")
    for table in tables:
        place = place[table]
    place[last] = value
    path.write_text(json.dumps(content))
    with pytest.raises(wiggers.InputError, match=words) as refusal:
        loop.load(path)
    assert "cycle.json" in str(refusal.value)


@pytest.mark.parametrize("text", ["", "[]", "7", "{", '{"format": NaN}', '{"format": 1}', "[" * 100_000, "\x00", "null"])
def test_files_that_are_no_saved_cycle(tmp_path, text):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(wiggers.InputError, match="c.json"):
        wiggers.Cycle.load(tmp_path / "c.json")


def test_cycles_are_saved_as_the_command_saves(loop_cycle, tmp_path):
    """Through links, into devices, with the mode kept, and whole or not at all."""
    path = tmp_path / "cycle.json"
    victim = tmp_path / "victim"
    victim.write_text("kept")
    (tmp_path / "cycle.json.part").symlink_to(victim)
    loop_cycle.save(path)
    assert victim.read_text() == "kept" and (tmp_path / "cycle.json.part").is_symlink()
    path.chmod(0o600)
    (tmp_path / "link").symlink_to(path)
    loop_cycle.save(tmp_path / "link")
    assert (tmp_path / "link").is_symlink() and path.stat().st_mode & 0o777 == 0o600
    assert np.array_equal(wiggers.Cycle.load(path).state, loop_cycle.state)
    (tmp_path / "null").symlink_to("/dev/null")
    loop_cycle.save(tmp_path / "null")
    assert (tmp_path / "null").is_symlink() and Path("/dev/null").is_char_device()
    with pytest.raises(wiggers.ResourceError, match="cannot write"):
        loop_cycle.save("/dev/full")
    with pytest.raises(wiggers.ResourceError, match="cannot create"):
        loop_cycle.save(tmp_path / "no" / "folder.json")
    assert {p.name for p in tmp_path.iterdir()} == {"cycle.json", "cycle.json.part", "victim", "link", "null"}


@pytest.mark.parametrize("call", [
    "wiggers.Loop(dt_s=1e-7).run(beats=5, sample_s=1e-3)",
    "wiggers.Loop(dt_s=1e-7).to_limit_cycle()",
    "wiggers.Cell('crn', period_ms=2e4).run(beats=500, sample_ms=100, integrator='rush-larsen')",
    f"wiggers.Heart({str(SCENE)!r}, set={{'heart.period_s': 20, 'solver.dt_s': 1e-6}}).to_limit_cycle()",
])
def test_ctrl_c_is_seen_within_a_long_beat(call):
    program = f"import wiggers\nprint('begun', flush=True)\n{call}\n"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    time.sleep(1.5)
    assert process.poll() is None, process.stderr.read()
    process.send_signal(signal.SIGINT)
    begin = time.time()
    error = process.communicate(timeout=60)[1]
    assert time.time() - begin < 1 and "KeyboardInterrupt" in error and process.returncode != 0


@pytest.mark.parametrize("call, words", [
    (lambda: wiggers.Loop().run(beats=10**6, sample_s=1e-7), "sample_s = 1e-07 asks for .* rows of .* GB"),
    (lambda: wiggers.Cell("crn").run(beats=10**6, sample_ms=1e-4), "sample_ms = 0.0001 asks for .* rows"),
])
def test_more_rows_than_the_memory_holds_are_refused(call, words):
    with pytest.raises(wiggers.InputError, match=words):
        call()


def test_a_cycle_that_breaks_its_models_rules_is_not_loaded(loop_cycle, tmp_path):
    """Also where the checksum fits: charge and blood volume are those of the model that the file names."""
    from wiggers._results import _checksum

    cell = wiggers.Cell("crn")
    cell_cycle = cell.to_limit_cycle(distance=1e-3)
    for cycle, place, change, words in ((loop_cycle, 0, 1.2, "mL of blood"), (loop_cycle, 0, -1.0, "V_LA"),
                                        (cell_cycle, cell.states.index("K_i"), 1.01, "conserved charge"),
                                        (cell_cycle, cell.states.index("Na_i"), 100.0, "Na_i")):
        path = tmp_path / "cycle.json"
        path.unlink(missing_ok=True)
        cycle.save(path)
        assert np.array_equal(wiggers.Cycle.load(path).state, cycle.state)
        content = json.loads(path.read_text())
        content["state"][place] = float(change * cycle.state[place]).hex()
        del content["checksum"]
        content["checksum"] = _checksum(content)
        path.write_text(json.dumps(content))
        with pytest.raises(wiggers.InputError, match=words):
            wiggers.Cycle.load(path)


def test_a_cycle_is_not_saved_over_somebodys_file(loop_cycle, tmp_path):
    (tmp_path / "package.json").write_text('{"name": "mine"}')
    with pytest.raises(wiggers.InputError, match="is not a saved limit cycle"):
        loop_cycle.save(tmp_path / "package.json")
    assert (tmp_path / "package.json").read_text() == '{"name": "mine"}'


def test_why_there_is_no_duration_is_said(tmp_path):
    cell = wiggers.Cell("ttp06-endo", stimulus_A_per_F=-5)
    cycle = cell.to_limit_cycle(distance=1e-3)
    why = "did not depolarise: the stimulus is below threshold"
    assert "APD90_ms" not in cycle.indexes
    assert cycle.indexes.no_action_potential == why
    assert why in repr(cycle)
    with pytest.raises(KeyError, match="APD90_ms: no action potential: did not depolarise"):
        cycle.indexes["APD90_ms"]
    cycle.save(tmp_path / "c.json")
    for same in (wiggers.Cycle.load(tmp_path / "c.json"), pickle.loads(pickle.dumps(cycle)), copy.deepcopy(cycle)):
        assert same.indexes.no_action_potential == why and same.indexes == cycle.indexes
    batch = cell.batch({"stimulus_A_per_F": [-5.0, -52.0]}, distance=1e-3)
    assert batch.good.all()
    assert batch.notes == [f"no action potential: {why}", ""]
    assert np.isnan(batch["APD90_ms"][0]) and np.isfinite(batch["APD90_ms"][1])
    assert "rush-larsen-2 at 0.05 ms" in repr(cell)


def test_cells_and_hearts_that_cannot_be_good_say_so_in_python():
    dead = {"k_NaCa": 10.0, "g_pCa": 0.0, "Ca_o": 10.0}
    cell = wiggers.Cell("ttp06-epi", **dead)
    with pytest.raises(wiggers.NumericalFailure, match="no living cell"):
        cell.to_limit_cycle(distance=1e-4)
    batch = wiggers.Cell("ttp06-epi").batch({name: [value] * 2 for name, value in dead.items()}, distance=1e-4)
    assert all("no living cell" in reason for reason in batch.reasons)
    loop = wiggers.Loop(changes={"elastance.LV.EA": 0.01})
    cycle = loop.to_limit_cycle()
    assert cycle.certificate.converged and cycle.certificate.verdict == "period-1"
    assert "period-1, with warnings: LV" in repr(cycle.certificate)
    assert "LV" in loop.batch({"elastance.LV.EA": [0.01]}).notes[0]
    heart = wiggers.Heart(SCENE, set={"walls.LV.EA": 0.01})
    assert "period-1, with warnings: LV" in repr(heart.to_limit_cycle().certificate)
    notes = wiggers.Heart(SCENE).batch({"walls.LV.EA": [0.01, 2.75]}).notes
    assert "LV" in notes[0] and notes[1] == ""
    assert pickle.loads(pickle.dumps(cycle.certificate)) == cycle.certificate
