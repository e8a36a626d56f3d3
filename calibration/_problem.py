"""A calibration problem: a model, its free parameters, its targets; residuals and their exact derivatives."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import wiggers
from wiggers._checks import real

from ._outputs import names_in, slopes_of, unit_of, value_of
from ._targets import Target, TargetWarning
from ._ties import Tie, check_ties

PENALTY = 1e3  # least residual of every target where there is no limit cycle


@dataclass(frozen=True)
class Free:
    """A parameter to be found between two bounds; transform "log" (positive quantities) or "linear"."""

    lower: float
    upper: float
    transform: str = "log"

    def __post_init__(self) -> None:
        for what in ("lower", "upper"):
            real(getattr(self, what), f"{what} bound")
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
    ties: name -> Tie, parameters that follow a free one. held: values to assign first. distance: how close each limit
    cycle is solved. `failures` lists the points without a limit cycle, each with its parameters and the reason;
    `doubts` what was warned about."""

    def __init__(self, model: Any, free: Mapping[str, Free], targets: Sequence[Target], *,
                 ties: Mapping[str, Tie] | None = None, held: Mapping[str, float] | None = None,
                 distance: float = 1e-8) -> None:
        self.model = model.copy()
        if held:
            self.model.parameters.update(held)
        self.free = dict(free)
        self.ties = dict(ties or {})
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
        parameters = self.model.parameters
        for name, bounds in self.free.items():
            info = parameters.info(name)
            if not isinstance(bounds, Free):
                raise wiggers.InputError(f"free: {name} = {bounds!r} is of type {type(bounds).__name__}, wanted is a "
                                         "Free")
            if bounds.lower < info.lower or bounds.upper > info.upper:
                raise wiggers.InputError(f"{name}: bounds {bounds.lower} to {bounds.upper} {info.unit} leave its "
                                         f"range, {info.lower} to {info.upper} {info.unit}")
        check_ties(self.ties, self.free, held or {}, parameters)
        self._units = _units_of_outputs(self.model)
        for target in self.targets:
            if not isinstance(target, Target):
                raise wiggers.InputError(f"targets: {target!r} is of type {type(target).__name__}, wanted is a Target")
            for name in names_in(target.name):
                if name not in self._units:
                    wiggers._results._position(list(self._units), name, "output of this model")
            target.check(self._units.__getitem__)
        self._outputs = list(dict.fromkeys(name for t in self.targets for name in names_in(t.name)))
        values = dict(parameters)
        self._start = np.array([f.inward(float(np.clip(values[n], f.lower, f.upper))) for n, f in self.free.items()])
        self.base: Any = None  # the cycle at the start, where there is one
        self._near: Any = None
        self._last: Point | None = None
        self._last_jacobian: tuple[np.ndarray, np.ndarray] | None = None
        self.point(self._start)
        self.base = self._near
        indexes = self.base.indexes if self.base is not None else {}
        self.doubts = [words for t in self.targets if (words := t.doubt(
            self._units.__getitem__, indexes.get(t.name) if isinstance(t.name, str) else None))]
        for words in self.doubts:
            warnings.warn(words, TargetWarning, stacklevel=2)

    def unit_of(self, target: Target) -> str:
        return unit_of(target.name, self._units.__getitem__)

    @property
    def start(self) -> np.ndarray:
        """The model's values when the problem was posed, as the search's coordinates, inside the bounds."""
        return self._start.copy()

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([f.inward(f.lower) for f in self.free.values()]),
                np.array([f.inward(f.upper) for f in self.free.values()]))

    @property
    def set_names(self) -> list[str]:
        """The parameters that a point sets: the free ones, and those tied to them."""
        return [*self.free, *self.ties]

    def values(self, x: np.ndarray) -> dict[str, float]:
        """The parameters that a point sets, by name."""
        values = {n: f.outward(v) for (n, f), v in zip(self.free.items(), x, strict=True)}
        return values | {n: tie.value(values[tie.to]) for n, tie in self.ties.items()}

    def samples(self, xs: np.ndarray) -> np.ndarray:
        """Values of set_names at many points: [point, parameter]."""
        return np.array([list(self.values(x).values()) for x in xs]).reshape(len(xs), len(self.set_names))

    def _solve(self, values: dict[str, float]) -> Any:
        """The cycle with these parameters, from the last good one, or else from the model's own start."""
        self.model.parameters.update(values)
        if self._near is not None:
            self.solves += 1
            try:
                return self.model.to_limit_cycle(self._near, distance=self.distance)
            except wiggers.NumericalFailure:
                pass
        self.solves += 1
        return self.model.to_limit_cycle(distance=self.distance)

    @staticmethod
    def _output(target: Target, indexes: Mapping[str, float]) -> float:
        missing = [n for n in names_in(target.name) if not np.isfinite(indexes.get(n, np.nan))]
        if missing:
            raise wiggers.NumericalFailure(f"this beat has no {', '.join(missing)}")
        return value_of(target.name, indexes)

    def point(self, x: np.ndarray) -> Point | None:
        """Solves at x from the last good cycle; None, with the reason in `failures`, if that fails."""
        x = np.array(x, dtype=float)
        if self._last is not None and np.array_equal(x, self._last.x):
            return self._last
        values = self.values(x)
        try:
            cycle = self._solve(values)
            self._near = cycle
            outputs = np.array([self._output(t, cycle.indexes) for t in self.targets])
        except (wiggers.NumericalFailure, wiggers.InputError) as error:
            self.failures.append((values, str(error)))
            return None
        residuals = np.array([t.residual(v) for t, v in zip(self.targets, outputs, strict=True)])
        self.penalty = max(self.penalty, 10 * float(np.abs(residuals).max()))
        self._last = Point(x, cycle, outputs, residuals)
        return self._last

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Infinite where there is no limit cycle."""
        point = self.point(x)
        return np.full(len(self.targets), np.inf) if point is None else point.residuals

    def output_jacobian(self, x: np.ndarray) -> np.ndarray:
        """Exact derivatives of the targets' outputs by the coordinates x, through the limit cycle and the ties; 0 where
        there is no cycle."""
        if self._last_jacobian is not None and np.array_equal(x, self._last_jacobian[0]):
            return self._last_jacobian[1]
        point = self.point(x)
        if point is None:
            return np.zeros((len(self.targets), len(self.names)))
        values = self.values(x)
        self.model.parameters.update(values)
        if isinstance(self.model, wiggers.Heart):
            table = self.model.sensitivities(point.cycle, self.set_names)
        else:
            table = self.model.sensitivities(point.cycle)
        by_set = table.rows(self._outputs)[:, table.columns(self.set_names)]
        n = len(self.names)
        by_free = by_set[:, :n].copy()
        for k, tie in enumerate(self.ties.values()):
            by_free[:, self.names.index(tie.to)] += tie.times * by_set[:, n + k]
        of_targets = np.zeros((len(self.targets), n))
        for row, target in zip(of_targets, self.targets, strict=True):
            for name, slope in slopes_of(target.name, point.cycle.indexes).items():
                row += slope * by_free[self._outputs.index(name)]
        of_targets *= np.array([f.slope(values[name]) for name, f in self.free.items()])[None, :]
        self._last_jacobian = (np.array(x, dtype=float), of_targets)
        return of_targets

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals."""
        outputs = self.output_jacobian(x)
        point = self.point(x)
        if point is None:
            return outputs
        slopes = np.array([t.slope(v) for t, v in zip(self.targets, point.outputs, strict=True)])
        return outputs * slopes[:, None]

    def outputs_of_many(self, xs: np.ndarray, *, threads: int | None = None,
                        executor: Any = None) -> tuple[np.ndarray, list[str]]:
        """The targets' outputs at many points [point, target] as one batch: NaN where there is no cycle or it has no
        such output, and the reason for each point of which something is missing."""
        samples = self.samples(xs)
        options: dict[str, Any] = {"near": self.base} if executor is None and self.base is not None else {}
        batch = self.model.batch(samples, self.set_names, distance=self.distance, threads=threads, executor=executor,
                                 **options)
        self.solves += len(samples)
        rows = np.full((len(samples), len(self.targets)), np.nan)
        reasons = list(batch.reasons)
        columns = {name: batch[name] for name in self._outputs}
        for k in range(len(samples)):
            indexes = {name: float(column[k]) for name, column in columns.items()}
            for j, target in enumerate(self.targets if not reasons[k] else ()):
                try:
                    rows[k, j] = self._output(target, indexes)
                except wiggers.NumericalFailure as error:
                    reasons[k] = str(error)
            if reasons[k]:
                self.failures.append((dict(zip(self.set_names, samples[k].tolist(), strict=True)), reasons[k]))
        return rows, reasons

    def residuals_of_many(self, xs: np.ndarray, *, threads: int | None = None, executor: Any = None) -> np.ndarray:
        """Residuals of many points [point, target] as one batch; infinite where there is no cycle."""
        outputs, reasons = self.outputs_of_many(xs, threads=threads, executor=executor)
        rows = np.full(outputs.shape, np.inf)
        for k, row in enumerate(outputs):
            if not reasons[k]:
                rows[k] = [t.residual(v) for t, v in zip(self.targets, row, strict=True)]
                self.penalty = max(self.penalty, 10 * float(np.abs(rows[k]).max()))
        return rows


def _units_of_outputs(model: Any) -> dict[str, str]:
    """Every output that a model can have, with its unit."""
    if isinstance(model, wiggers.Cell):
        return model.index_units
    if hasattr(model, "output_units"):
        return model.output_units
    return dict(zip(wiggers.index_names(), wiggers.index_units(), strict=True))
