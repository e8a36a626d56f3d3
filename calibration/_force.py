"""Steady force-calcium curves of RDQ20 as a model to calibrate."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

import wiggers
from wiggers._checks import reals


class ForceCalcium:
    """Outputs: the steady tension at each calcium, "tension_kPa@0.3uM", at one sarcomere length."""

    def __init__(self, force: wiggers.Force, calcium_uM: Sequence[float], SL_um: float = 2.2) -> None:
        self.force = force
        self.calcium_uM = reals(calcium_uM, "calcium_uM")
        self.SL_um = SL_um
        self.outputs = [f"tension_kPa@{c:g}uM" for c in self.calcium_uM]

    def copy(self) -> ForceCalcium:
        return ForceCalcium(self.force.copy(), self.calcium_uM, self.SL_um)

    @property
    def parameters(self) -> wiggers.Parameters:
        return self.force.parameters

    @property
    def output_units(self) -> dict[str, str]:
        return dict.fromkeys(self.outputs, "kPa")

    def to_limit_cycle(self, near: Any = None, *, distance: float = 0) -> Any:
        """The curve (there is no cycle to find): `.indexes` and, kept for sensitivities, its derivatives."""
        del near, distance
        tension, derivatives = self.force.force_calcium(self.calcium_uM, self.SL_um)
        return SimpleNamespace(indexes=dict(zip(self.outputs, tension.tolist(), strict=True)), derivatives=derivatives)

    def sensitivities(self, curve: Any) -> Any:
        names = self.parameters.names
        return SimpleNamespace(
            rows=lambda outputs: curve.derivatives[[self.outputs.index(o) for o in outputs], :],
            columns=lambda wanted: [names.index(n) for n in wanted])

    def batch(self, samples: np.ndarray, names: Sequence[str], **options: Any) -> wiggers.Batch:
        """Curves of many parameter samples, one after another."""
        del options
        values = np.full((len(samples), len(self.outputs)), np.nan)
        reasons = []
        for k, sample in enumerate(samples):
            try:
                model = self.copy()
                model.parameters.update(dict(zip(names, sample, strict=True)))
                values[k] = list(model.to_limit_cycle().indexes.values())
                reasons.append("")
            except (wiggers.InputError, wiggers.NumericalFailure) as error:
                reasons.append(str(error))
        return wiggers.Batch(self.outputs, ["kPa"] * len(self.outputs), values, np.empty((len(samples), 0)), reasons,
                             list(names), np.asarray(samples))
