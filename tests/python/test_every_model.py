"""What Python gives of every ionic model of the list."""

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


def test_kinds_of_models():
    assert wiggers.models() == wiggers.models("ionic") + wiggers.models("force")
    assert "rdq20" in wiggers.models("force") and "crn" in wiggers.models("ionic")
    with pytest.raises(wiggers.InputError, match="did you mean 'ionic'"):
        wiggers.models("ionics")
