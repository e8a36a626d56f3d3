"""What Python gives of every ionic model of the list."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import wiggers


@pytest.mark.parametrize("name", wiggers.models("ionic"))
def test_every_ionic_model(name):
    cell = wiggers.Cell(name, dt_ms=0.05)
    cycle = cell.to_limit_cycle(distance=1e-4)
    indexes = cycle.indexes
    assert 100 < indexes["APD90_ms"] < 500 and indexes["V_peak_mV"] > 0
    assert set(indexes) <= set(cell.index_units)
    # By itself and in lanes.
    parameter = next(p for p in cell.parameters if not p.startswith(("R", "T", "F")))
    value = cell.parameters[parameter]
    batch = cell.batch({parameter: np.array([value, 1.01 * value, 0.99 * value])}, distance=1e-4)
    assert batch.good.all()
    assert batch["APD90_ms"][0] == pytest.approx(indexes["APD90_ms"], rel=1e-3)
    table = cell.sensitivities(cycle)
    slope = (batch["APD90_ms"][1] - batch["APD90_ms"][2]) / (0.02 * value)
    assert table["APD90_ms", parameter] == pytest.approx(slope, rel=0.05, abs=1e-3 * indexes["APD90_ms"] / value)


@pytest.mark.parametrize("name", wiggers.models("force"))
def test_every_force_model(name):
    force = wiggers.Force(model=name)
    calcium = np.array([0.1, 0.5, 1.0, 5.0])
    tension, derivatives = force.force_calcium(calcium, SL_um=2.0)
    assert (np.diff(tension) > 0).all() and tension[-1] > 50
    assert derivatives.shape == (4, len(force.parameters))
    t = np.linspace(0, 0.3, 31)
    assert force.run(t, np.full(31, 1.0), 2.0)[-1] == pytest.approx(tension[2], rel=1e-5)
    again = pickle.loads(pickle.dumps(force))
    assert list(again.parameters) == list(force.parameters)
    with pytest.raises(wiggers.InputError, match="no force model"):
        wiggers.Force(model="crn")


@pytest.mark.parametrize("name", wiggers.models("force"))
@pytest.mark.parametrize("samples", [5, 21, 81])
def test_tension_along_a_length_with_kinks(name, samples):
    # Straight lines between the samples: whether the line's own points are given too makes no difference.
    force = wiggers.Force(model=name)
    t = np.linspace(0, 0.4, samples)
    calcium = 0.1 + 0.4 * np.sin(np.pi * t / 0.4) ** 2
    length = 2.0 * (1 - 0.1 * np.sin(2 * np.pi * t / 0.4))
    fine = np.linspace(0, 0.4, 4 * (samples - 1) + 1)
    tension = force.run(t, calcium, length)
    assert tension == pytest.approx(force.run(fine, np.interp(fine, t, calcium), np.interp(fine, t, length))[::4],
                                    rel=1e-5, abs=1e-4)


def test_a_length_that_a_model_does_not_describe():
    force = wiggers.Force(model="land2017", Ca50=0.0805)
    y = force.initial_state
    for call in (lambda: force.run([0, 0.1], [0.5, 0.5], [1.9, 2.2]), lambda: force.rhs(y, 0.5, 2.2),
                 lambda: force.jacobian(y, 0.5, 2.2), lambda: force.steady_state(0.5, 2.2)):
        with pytest.raises(wiggers.InputError, match="calcium at half binding, -0.29.* uM, is not positive"):
            call()


def test_hearts_with_another_force_model():
    heart = wiggers.Heart(str(Path(os.environ["WIGGERS_ROOT"]) / "scenes/whole_heart_land2017.toml"))
    cycle = heart.to_limit_cycle()
    assert cycle.indexes["LV.EF_percent"] == pytest.approx(63.6, abs=0.3)
    assert cycle.indexes["LV.pressure_max_mmHg"] == pytest.approx(125, abs=0.5)
    with pytest.raises(wiggers.InputError, match="unknown parameter of the heart"):
        heart.parameters["walls.LV.a_XB_kPa"] = 1e5


def test_kinds_of_models():
    assert wiggers.models() == wiggers.models("ionic") + wiggers.models("force")
    assert "rdq20" in wiggers.models("force") and "crn" in wiggers.models("ionic")
    with pytest.raises(wiggers.InputError, match="did you mean 'ionic'"):
        wiggers.models("ionics")
