"""A calibration problem: a model, its free parameters, its targets; residuals and their exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import wiggers

from ._targets import Target

PENALTY = 1e3  # least residual of every target where there is no limit cycle


@dataclass(frozen=True)
class Free:
    """A parameter to be found between two bounds; transform "log" (positive quantities) or "linear"."""

    lower: float
    upper: float
    transform: str = "log"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.lower) and np.isfinite(self.upper) and self.lower < self.upper):
            raise wiggers.InputError(f"bounds {self.lower} to {self.upper} must be finite and have a width")
        if self.transform not in ("log", "linear"):
            raise wiggers.InputError(f"transform = {self.transform!r}: choose log or linear")
        if self.transform == "log" and self.lower <= 0:
            raise wiggers.InputError(f"bounds {self.lower} to {self.upper}: transform \"log\" needs positive ones")

    def inward(self, value: float) -> float:
        return float(np.log(value)) if self.transform == "log" else float(value)

    def outward(self, x: float) -> float:
        return float(np.clip(np.exp(x) if self.transform == "log" else x, self.lower, self.upper))

    def slope(self, value: float) -> float:
        """d(value) / dx."""
        return value if self.transform == "log" else 1.0


@dataclass
class Point:
    """A solved point of the problem."""

    x: np.ndarray
    cycle: Any
    outputs: np.ndarray  # of the targets
    residuals: np.ndarray


class Problem:
    """model: Loop, Heart, Cell or ForceCalcium (a copy is used; its other parameters are held). free: name -> Free.
    held: values to assign first. distance: how close each limit cycle is solved."""

    def __init__(self, model: Any, free: Mapping[str, Free], targets: Sequence[Target], *,
                 held: Mapping[str, float] | None = None, distance: float = 1e-8) -> None:
        self.model = model.copy()
        if held:
            self.model.parameters.update(held)
        self.free = dict(free)
        self.targets = list(targets)
        self.distance = distance
        self.names = list(self.free)
        self.solves = 0
        self.penalty = PENALTY  # grows with the worst good point, so that no search prefers a failure
        self.failures: list[tuple[dict[str, float], str]] = []
        if not self.names:
            raise wiggers.InputError("free is empty: nothing to calibrate")
        if not self.targets:
            raise wiggers.InputError("targets is empty: nothing to calibrate to")
        for name, bounds in self.free.items():
            info = self.model.parameters.info(name)
            if bounds.lower < info.lower or bounds.upper > info.upper:
                raise wiggers.InputError(f"{name}: bounds {bounds.lower} to {bounds.upper} {info.unit} leave its range, "
                                         f"{info.lower} to {info.upper} {info.unit}")
        self.base = self._solve_model(None)
        names = list(self.base.indexes)
        for target in self.targets:
            if target.name not in names:
                wiggers._results._position(names, target.name, "output of this model")
            target.check(self.unit_of(target.name))
        values = self.model.parameters
        self._start = np.array([f.inward(float(np.clip(values[n], f.lower, f.upper))) for n, f in self.free.items()])
        self._near = self.base
        self._last: Point | None = None
        self._last_jacobian: tuple[np.ndarray, np.ndarray] | None = None

    def unit_of(self, output: str) -> str:
        unit = getattr(self.model, "output_unit", None)
        if unit:
            return unit(output)
        known = dict(zip(wiggers.index_names(), wiggers.index_units(), strict=True))
        if isinstance(self.model, wiggers.Cell):
            known = self.model.index_units
        return known.get(output, "1")

    @property
    def start(self) -> np.ndarray:
        """The model's values when the problem was posed, as the search's coordinates, inside the bounds."""
        return self._start.copy()

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([f.inward(f.lower) for f in self.free.values()]),
                np.array([f.inward(f.upper) for f in self.free.values()]))

    def values(self, x: np.ndarray) -> dict[str, float]:
        return {n: f.outward(v) for (n, f), v in zip(self.free.items(), x, strict=True)}

    def _solve_model(self, near: Any) -> Any:
        self.solves += 1
        return self.model.to_limit_cycle(near, distance=self.distance)

    def point(self, x: np.ndarray) -> Point | None:
        """Solves at x from the last good cycle; None, with the reason in `failures`, if that fails."""
        x = np.array(x, dtype=float)
        if self._last is not None and np.array_equal(x, self._last.x):
            return self._last
        values = self.values(x)
        try:
            self.model.parameters.update(values)
            try:
                cycle = self._solve_model(self._near)
            except wiggers.NumericalFailure:
                cycle = self._solve_model(None)
            outputs = np.array([cycle.indexes.get(t.name, np.nan) for t in self.targets])
            missing = [t.name for t, v in zip(self.targets, outputs, strict=True) if np.isnan(v)]
            if missing:
                raise wiggers.NumericalFailure(f"this beat has no {', '.join(missing)}")
        except (wiggers.NumericalFailure, wiggers.InputError) as error:
            self.failures.append((values, str(error)))
            return None
        self._near = cycle
        residuals = np.array([t.residual(v) for t, v in zip(self.targets, outputs, strict=True)])
        self.penalty = max(self.penalty, 10 * float(np.abs(residuals).max()))
        self._last = Point(x, cycle, outputs, residuals)
        return self._last

    def residuals(self, x: np.ndarray) -> np.ndarray:
        point = self.point(x)
        return np.full(len(self.targets), self.penalty) if point is None else point.residuals

    def output_jacobian(self, x: np.ndarray) -> np.ndarray:
        """Exact derivatives of the targets' outputs by the coordinates x, through the limit cycle."""
        if self._last_jacobian is not None and np.array_equal(x, self._last_jacobian[0]):
            return self._last_jacobian[1]
        point = self.point(x)
        if point is None:
            return np.zeros((len(self.targets), len(self.names)))
        values = self.values(x)
        self.model.parameters.update(values)
        if isinstance(self.model, wiggers.Heart):
            table = self.model.sensitivities(point.cycle, self.names)
        else:
            table = self.model.sensitivities(point.cycle)
        derivatives = table.rows([t.name for t in self.targets])[:, table.columns(self.names)]
        slopes = np.array([f.slope(values[n]) for n, f in self.free.items()])
        self._last_jacobian = (np.array(x, dtype=float), derivatives * slopes[None, :])
        return self._last_jacobian[1]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals."""
        outputs = self.output_jacobian(x)
        point = self.point(x)
        if point is None:
            return outputs
        slopes = np.array([t.slope(v) for t, v in zip(self.targets, point.outputs, strict=True)])
        return outputs * slopes[:, None]

    def residuals_of_many(self, xs: np.ndarray, *, threads: int | None = None, executor: Any = None) -> np.ndarray:
        """Residuals of many points [point, target] as one batch; infinite where there is no cycle."""
        samples = np.array([list(self.values(x).values()) for x in xs])
        batch = self.model.batch(samples, self.names, near=self.base if executor is None else None,
                                 distance=self.distance, threads=threads, executor=executor)
        self.solves += len(samples)
        rows = np.full((len(samples), len(self.targets)), np.inf)
        outputs = np.column_stack([batch[t.name] for t in self.targets])
        for k, row in enumerate(outputs):
            if batch.reasons[k] or np.isnan(row).any():
                self.failures.append((dict(zip(self.names, samples[k], strict=True)),
                                      batch.reasons[k] or "an output of the targets is missing in this beat"))
            else:
                rows[k] = [t.residual(v) for t, v in zip(self.targets, row, strict=True)]
        good = np.isfinite(rows).all(axis=1)
        if good.any():
            self.penalty = max(self.penalty, 10 * float(np.abs(rows[good]).max()))
        return rows
