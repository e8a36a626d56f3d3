"""What the Python package takes for numbers, states, samples and names, and what it refuses by name."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import wiggers
from conftest import SCENES

ROOT = Path(os.environ["WIGGERS_ROOT"])
SCENE = str(ROOT / "scenes" / "elastance_healthy.toml")
EA, R = "elastance.LV.EA", "circuit.SYS.R_AR"


@pytest.fixture(scope="module")
def loop():
    return wiggers.Loop()


@pytest.fixture(scope="module")
def heart():
    return wiggers.Heart(SCENE)


@pytest.fixture(scope="module")
def cell():
    return wiggers.Cell("ttp06-endo", dt_ms=0.1)


@pytest.fixture(scope="module")
def force():
    return wiggers.Force("fedele2023-ventricles")


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def refused(words, call):
    with pytest.raises(wiggers.InputError) as caught:
        call()
    assert words in str(caught.value) and len(str(caught.value)) < 4000
    assert "incompatible function arguments" not in str(caught.value)


NOT_STATES = [
    (None, "None"), (lambda y: y + 1j, "dtype complex128"), (lambda y: y > 0, "dtype bool"),
    (lambda y: y.astype(str), "dtype <U"), (lambda y: y.astype(object), "dtype object"),
    (lambda y: [None, *y[1:]], "[0] = None"), (lambda y: [True, *y[1:]], "[0] = True is a truth value"),
    (lambda y: np.where(np.arange(len(y)) == 2, np.nan, y), "[2] = nan is not finite"),
    (lambda y: np.where(np.arange(len(y)) == 2, np.inf, y), "[2] = inf is not finite"),
    (lambda y: y[:-1], "wanted is ("), (lambda y: y[None, :], "wanted is ("), (lambda y: y[:0], "(0"),
    (lambda y: np.ma.array(y, mask=np.arange(len(y)) == 1), "masked values"), (lambda y: "state", "dtype <U5"),
    (lambda y: np.array(len(y), dtype="datetime64[s]"), "dtype datetime64"), (lambda y: [[1.0], [1.0, 2.0]], ""),
    (lambda y: {"V_LV": 1.0}, "dtype object"),
]


@pytest.mark.parametrize(("make", "words"), NOT_STATES)
def test_states_are_refused_by_name(loop, cell, force, make, words):
    for model in (loop, cell):
        wrong = make and make(model.initial_state)
        for name, call in (
                ("y", lambda m, y: m.rhs(0.1, y)), ("y", lambda m, y: m.jacobian(0.1, y)),
                ("start", lambda m, y: m.run(1, y)), ("near", lambda m, y: m.to_limit_cycle(y)),
                ("state", lambda m, y: m.indexes(y)), ("cycle", lambda m, y: m.sensitivities(y))):
            if name == "y" and make is None:
                continue
            refused(words, lambda call=call, model=model, wrong=wrong: call(model, wrong))
            if "finite" not in words and "wanted is (" not in words and "(0" not in words:
                refused(name, lambda call=call, model=model, wrong=wrong: call(model, wrong))
    wrong = make and make(force.initial_state)
    refused(words if make else "y", lambda: force.rhs(wrong, 0.3, 2.0))
    refused(words if make else "y", lambda: force.jacobian(wrong, 0.3, 2.0))
    refused(words, lambda: force.run([0, 1], [0.3, 0.3], 2.0, wrong))


def test_none_is_no_start(loop, cell, heart, force):
    for call in (lambda: heart.run(1, None), lambda: loop.run(1, None), lambda: cell.run(1, start=None),
                 lambda: force.run([0, 1], [0.3, 0.3], 2.0, start=None),
                 lambda: force.run([0, 1], [0.3, 0.3], start=wiggers.Force().end_state)):
        refused("start = None is no state", call)
    for call in (lambda: loop.to_limit_cycle(None), lambda: heart.to_limit_cycle(near=None), lambda: cell.refined(None),
                 lambda: loop.batch({EA: [2.0]}, near=None), lambda: heart.batch({"walls.LV.EA": [2.0]}, near=None)):
        refused("near = None is no state", call)
    refused("state = None", lambda: heart.indexes(None))
    refused("cycle = None", lambda: heart.sensitivities(None))
    refused("start is a Trace: give its end_state", lambda: heart.run(1, loop.run(1)))
    # Said or left out is the same.
    assert np.array_equal(loop.run(1, wiggers.not_given)["V_LV"], loop.run(1)["V_LV"])


@pytest.mark.parametrize("wrong", [True, np.True_, "3", b"3", None, 3 + 0j, np.complex128(3), [3.0], np.array([3.0]),
                                   object(), np.datetime64("2020-01-01"), {}])
def test_numbers_are_refused_by_name(loop, cell, heart, force, wrong):
    for model, name in ((loop, EA), (heart, "walls.LV.EA"), (cell, "g_Kr"), (force, "Kd0")):
        before = model.parameters.array
        refused(name, lambda m=model, n=name: m.parameters.__setitem__(n, wrong))
        refused(name, lambda m=model, n=name: m.parameters.update({n: wrong}))
        assert np.array_equal(model.parameters.array, before)
    y, z = loop.initial_state, force.initial_state
    for name, call in (
            ("elastance.LV.EA", lambda: setattr(loop.parameters.elastance.LV, "EA", wrong)),
            ("g_Na", lambda: wiggers.Cell("crn", g_Na=wrong)), ("dt_ms", lambda: wiggers.Cell("crn", dt_ms=wrong)),
            (EA, lambda: wiggers.Loop(changes={EA: wrong})), ("dt_s", lambda: wiggers.Loop(dt_s=wrong)),
            ("rtol", lambda: wiggers.Loop(rtol=wrong)), ("Kd0", lambda: wiggers.Force(Kd0=wrong)),
            ("t = ", lambda: loop.rhs(wrong, y)), ("t = ", lambda: loop.jacobian(wrong, y)),
            ("sample_s", lambda: loop.run(1, sample_s=wrong)),
            ("distance", lambda: loop.to_limit_cycle(distance=wrong)),
            ("sample_ms", lambda: cell.run(1, sample_ms=wrong)), ("rtol", lambda: cell.run(1, rtol=wrong)),
            ("calcium_uM", lambda: force.rhs(z, wrong, 2.0)), ("SL_um", lambda: force.jacobian(z, 0.3, wrong)),
            ("dSL_dt_um_per_s", lambda: force.rhs(z, 0.3, 2.0, wrong)),
            ("calcium_uM", lambda: force.steady_state(wrong)), ("SL_um", lambda: force.steady_state(0.3, wrong)),
            ("SL_um", lambda: force.force_calcium([0.3], wrong))):
        refused(name, call)


@pytest.mark.parametrize("wrong", [True, "3", 1.5, 0, -1, None, np.nan, np.inf, 1e9, 2 + 0j, [1]])
def test_whole_numbers_are_refused_by_name(loop, cell, heart, wrong):
    for model in (loop, cell, heart):
        refused("beats = ", lambda m=model: m.run(wrong))
        refused("max_beats = ", lambda m=model: m.to_limit_cycle(max_beats=wrong))
    if wrong is not None:  # threads and chunk left out
        refused("threads = ", lambda: loop.batch({EA: [2.0]}, threads=wrong))
        if wrong != 1e9:
            from concurrent.futures import ThreadPoolExecutor
            with ThreadPoolExecutor(1) as pool:
                refused("chunk = ", lambda: loop.batch({EA: [2.0]}, executor=pool, chunk=wrong))


def test_whole_numbers_of_any_type(loop):
    assert len(loop.run(np.int64(2))) == len(loop.run(2.0)) == 1601


@pytest.mark.parametrize(("name", "call"), [
    ("model = 5", lambda l, h, f: wiggers.Cell(5)), ("parameters = None", lambda l, h, f: wiggers.Force(None)),
    ("scene = None", lambda l, h, f: wiggers.Heart(None)), ("source = 3", lambda l, h, f: wiggers.Loop(3)),
    ("integrator = 4", lambda l, h, f: wiggers.Loop(integrator=4)),
    ("method = 1", lambda l, h, f: l.to_limit_cycle(method=1)),
    ("accuracy = True", lambda l, h, f: wiggers.Heart(SCENE, accuracy=True)),
    ("walls.LV.EA = None", lambda l, h, f: wiggers.Heart(SCENE, set={"walls.LV.EA": None})),
    ("walls.LV.EA = 1j", lambda l, h, f: wiggers.Heart(SCENE, set={"walls.LV.EA": 1j})),
    ("column = 0", lambda l, h, f: l.run(1)[0]), ("column = None", lambda l, h, f: l.run(1).unit(None)),
    ("name of a parameter = 3", lambda l, h, f: l.parameters[3]),
    ("name of a parameter = 3", lambda l, h, f: l.parameters.__setitem__(3, 3.0)),
    ("[output, parameter]", lambda l, h, f: l.sensitivities(l.to_limit_cycle())["LV.EDV_mL"]),
    ("name of the output = 1", lambda l, h, f: l.sensitivities(l.to_limit_cycle())[1, EA]),
    ("parameters = 'walls.LV.EA'", lambda l, h, f: h.sensitivities(h.to_limit_cycle(), "walls.LV.EA")),
    ("parameters[0] = 3", lambda l, h, f: h.sensitivities(h.to_limit_cycle(), [3])),
    ("names = 'elastance.LV.EA'", lambda l, h, f: l.batch(np.ones((1, 1)), EA)),
    ("changes of parameters = None", lambda l, h, f: l.parameters.update(None)),
    ("changes of parameters = 3", lambda l, h, f: wiggers.Loop(changes=3)),
    ("progress = 'yes'", lambda l, h, f: l.to_limit_cycle(progress="yes")),
    ("executor = 3", lambda l, h, f: l.batch({EA: [2.0]}, executor=3)),
    ("t = nan", lambda l, h, f: l.rhs(np.nan, l.initial_state)),
])
def test_words_are_refused_by_name(loop, heart, force, name, call):
    refused(name, lambda: call(loop, heart, force))


@pytest.mark.parametrize(("words", "arguments"), [
    ("t_s has shape (0,)", ([], [])), ("t_s has shape (1,)", ([0.0], [0.3])), ("t_s has shape ()", (0.0, 0.3)),
    ("t_s has shape (2, 1)", ([[0.0], [1.0]], [[0.3], [0.3]])),
    ("t_s[2] = 0.1 does not increase", ([0, 0.2, 0.1], [0.3] * 3)),
    ("t_s[1] = 0 does not increase", ([0, 0], [0.3] * 2)),
    ("calcium_uM has shape (2,), t_s has (3,)", ([0, 1, 2], [0.3] * 2)),
    ("SL_um has shape (2,)", ([0, 1, 2], [0.3] * 3, [2.0, 2.0])), ("t_s[1] = nan", ([0, np.nan], [0.3] * 2)),
    ("calcium_uM[1]: Ca = -0.1 uM is outside", ([0, 1], [0.3, -0.1])),
    ("SL_um[1]: SL = 40", ([0, 1], [0.3] * 2, [2, 40])),
    ("calcium_uM has dtype complex128", ([0, 1], [0.3, 0.3j])),
    ("SL_um has dtype bool", ([0, 1], [0.3] * 2, np.array(True))),
    ("t_s[0] = True", ([True, 2], [0.3] * 2)),
])
def test_twitches_are_refused_by_name(force, words, arguments):
    refused(words, lambda: force.run(*arguments))


@pytest.mark.parametrize(("words", "call"), [
    ("calcium_uM has shape (0,)", lambda f: f.force_calcium([])),
    ("calcium_uM has shape ()", lambda f: f.force_calcium(0.3)),
    ("calcium_uM has dtype object", lambda f: f.force_calcium([0.3, None])),
    ("[0] = nan", lambda f: f.force_calcium([np.nan])),
    ("outside its range 0 to 1000 uM", lambda f: f.force_calcium([-1.0])),
    ("outside its range", lambda f: f.steady_state(np.nan)),
    ("calcium_uM: Ca = nan", lambda f: f.rhs(f.initial_state, np.nan, 2.0)),
    ("SL_um: SL = 0.1 um is outside", lambda f: f.jacobian(f.initial_state, 0.3, 0.1)),
    ("dSL_dt_um_per_s: dSL/dt = inf", lambda f: f.rhs(f.initial_state, 0.3, 2.0, np.inf)),
])
def test_force_is_refused_by_name(force, words, call):
    refused(words, lambda: call(force))


def test_force_goes_on(force):
    t = np.linspace(0, 0.4, 401)
    calcium = 0.1 + 0.6 * np.exp(-((t - 0.1) / 0.05) ** 2)
    whole = force.run(t, calcium, 1.9)
    first = force.run(t[:201], calcium[:201], 1.9)
    second = force.run(t[200:], calcium[200:], 1.9, start=force.end_state)
    assert np.allclose(np.concatenate([first, second[1:]]), whole, rtol=1e-5, atol=1e-6)


class Quacks:
    """What polars' data frames have in common with pandas': columns, and [name]."""

    def __init__(self, columns):
        self._held = columns

    @property
    def columns(self):
        return list(self._held)

    def __getitem__(self, name):
        return self._held[name]


TABLE = {EA: [2.0, 2.5, 3.0], R: [0.6, 0.7, 0.8]}


def tables():
    pandas = pytest.importorskip("pandas")
    rows = [dict(zip(TABLE, row, strict=True)) for row in zip(*TABLE.values(), strict=True)]
    structured = np.array(list(zip(*TABLE.values(), strict=True)), dtype=[(n, float) for n in TABLE])
    return {
        "pandas": pandas.DataFrame(TABLE), "pandas of objects": pandas.DataFrame(TABLE, index=list("abc")),
        "nullable": pandas.DataFrame(TABLE).convert_dtypes(), "float32": pandas.DataFrame(TABLE).astype("float32"),
        "quacks": Quacks({n: np.array(v) for n, v in TABLE.items()}), "dicts": rows, "tuples of dicts": tuple(rows),
        "structured": structured, "records": structured.view(np.recarray),
        "mapping of series": dict(pandas.DataFrame(TABLE)),
    }


@pytest.mark.parametrize("kind", ["pandas", "pandas of objects", "nullable", "float32", "quacks", "dicts",
                                  "tuples of dicts", "structured", "records", "mapping of series"])
def test_batches_take_tables(loop, kind):
    wanted = loop.batch(np.column_stack(list(TABLE.values())), list(TABLE))
    batch = loop.batch(tables()[kind])
    assert batch.parameters == list(TABLE) and batch.good.all()
    rtol = 1e-6 if kind == "float32" else 0
    assert np.allclose(batch.samples, wanted.samples, rtol=rtol, atol=0)
    assert np.allclose(batch.values, wanted.values, rtol=1e-4 if rtol else 0, atol=1e-4 if rtol else 0, equal_nan=True)


def test_tables_of_polars(loop):
    polars = pytest.importorskip("polars")
    batch = loop.batch(polars.DataFrame(TABLE))
    assert batch.parameters == list(TABLE) and batch.good.all()


def test_names_choose_among_columns(loop):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({**TABLE, "patient": ["a", "b", "c"]})
    batch = loop.batch(frame, [R, EA])
    assert batch.parameters == [R, EA] and np.array_equal(batch.samples[:, 1], TABLE[EA])
    refused("unknown column of the samples 'elastance.LV.EB'", lambda: loop.batch(frame, ["elastance.LV.EB"]))
    refused("patient", lambda: loop.batch(frame))
    # Holes are samples without a result.
    frame.loc[1, EA] = np.nan
    batch = loop.batch(frame[[EA]])
    assert list(batch.good) == [True, False, True] and "elastance.LV.EA" in batch.reasons[1]
    whole = pandas.DataFrame({EA: pandas.array([2, None, 3], dtype="Int64")})
    assert list(loop.batch(whole).good) == [True, False, True]
    assert len(loop.batch(pandas.DataFrame({EA: []}))) == len(loop.batch(frame[[EA]].iloc[:0])) == 0
    # One value goes with all others.
    assert np.array_equal(loop.batch({EA: [2.0, 3.0], R: 0.7}).samples[:, 1], [0.7, 0.7])


def frame_with(column, name=EA):
    return pytest.importorskip("pandas").DataFrame({name: column})


@pytest.mark.parametrize(("words", "make"), [
    ("elastance.LV.EA has dtype bool", lambda: frame_with([True, False])),
    ("elastance.LV.EA has dtype", lambda: frame_with(["2", "3"])),
    ("elastance.LV.EA has dtype complex128", lambda: frame_with([2j, 3])), ("[1] = None", lambda: {EA: [2.0, None]}),
    ("elastance.LV.EA[1] = True", lambda: {EA: [2.0, True]}), ("elastance.LV.EA has dtype object", lambda: {EA: None}),
    ("differ in their names: circuit.SYS.R_AR", lambda: [{EA: 2.0}, {EA: 2.0, R: 0.7}]),
    ("names of the samples[0] = 3", lambda: {3: [1.0]}),
    ("columns of the samples[0] = 0", lambda: frame_with([1.0], 0)),
    ("did you mean 'elastance.LV.EA'", lambda: frame_with([1.0], "elastance.LV.EAA")),
    ("names is missing", lambda: [[1.0]]),
    ("names is missing", lambda: np.ones(3)), ("samples", lambda: None), ("samples", lambda: "elastance.LV.EA"),
    ("one length", lambda: {EA: [1.0, 2.0], R: [1.0, 2.0, 3.0]}), ("one-dimensional", lambda: {EA: [[1.0], [2.0]]}),
])
def test_samples_are_refused_by_name(loop, words, make):
    refused(words, lambda: loop.batch(make()))


def test_columns_of_one_name_are_refused(loop):
    pandas = pytest.importorskip("pandas")
    refused("two columns of the samples are named 'elastance.LV.EA'",
            lambda: loop.batch(pandas.DataFrame(np.ones((2, 2)), columns=[EA, EA])))
    refused("two columns of the samples are named", lambda: loop.batch(np.ones((2, 2)), [EA, EA]))


def test_a_longer_period_keeps_steps_that_are_stable_and_comes_back():
    heart = wiggers.Heart(SCENES / "elastance_healthy.toml")
    def steps():
        return [line for line in heart.text.splitlines() if line.startswith(("dt_s", "regulatory_substep"))]

    first, before = steps(), heart.to_limit_cycle().indexes
    assert len(first) == 2
    heart.parameters["heart.period_s"] = 4.0  # in as many steps the circulation would be unstable
    assert heart.to_limit_cycle().indexes["LV.EDV_mL"] > before["LV.EDV_mL"]
    heart.parameters["heart.period_s"] = 0.8
    assert steps() == first
    after = heart.to_limit_cycle().indexes
    assert all(after[name] == before[name] for name in ("LV.EDV_mL", "aorta.pressure_max_mmHg"))


def test_messages_of_changed_numbers_name_the_file():
    heart = wiggers.Heart(SCENES / "elastance_healthy.toml")
    heart.parameters["walls.LA.TC"] = 0.2
    with pytest.raises(wiggers.InputError, match="elastance_healthy.toml: walls"):
        heart.parameters["walls.LA.TR"] = 0.79


def test_names_of_cells_are_parts_of_keys():
    text = (SCENES / "mixed.toml").read_text().replace("[cells.", '[cells."a.').replace('cells = "', 'cells = "a.')
    lines = [line.replace("]", '"]') if line.startswith('[cells."') else line for line in text.splitlines()]
    with pytest.raises(wiggers.InputError, match="no '\\.'"):
        wiggers.Heart("\n".join(lines))
