"""Least squares with the exact Jacobian from one or many starts, and what it tells."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import wiggers
from wiggers._checks import NotGiven, not_given, reals, whole

from ._explain import Explanation, explain
from ._problem import Point, Problem
from ._targets import Missed

NOT_DETERMINED = "not determined by these targets"
_MORE_STARTS = 10  # tried where none of those asked for has a limit cycle


@dataclass
class Search:
    """What became of one start. cost and end: None where the start has no limit cycle; `message` then has the reason,
    otherwise the optimiser's word."""

    start: dict[str, float]
    end: dict[str, float] | None
    cost: float | None
    converged: bool
    message: str


@dataclass
class Fit:
    """A solved problem, the best of its searches. `converged` is the optimiser's word alone: that no small step
    improves the fit. `missed` tells whether the targets are met."""

    problem: Problem
    x: np.ndarray
    point: Point
    output_jacobian: np.ndarray  # derivatives of the targets' outputs by the coordinates
    message: str
    converged: bool
    seconds: float = 0
    solves: int = 0
    gradients: int = 0
    failures: list[tuple[dict[str, float], str]] = field(default_factory=list)  # points without a cycle, and why
    searches: list[Search] = field(default_factory=list)
    at_bound: list[str] = field(default_factory=list)

    @property
    def success(self) -> bool:
        """The same as `converged`."""
        return self.converged

    @property
    def parameters(self) -> dict[str, float]:
        """All that the fit sets: free parameters, and those tied to them."""
        return self.problem.values(self.x)

    @property
    def outputs(self) -> dict[str, float]:
        return {t.label: float(v) for t, v in zip(self.problem.targets, self.point.outputs, strict=True)}

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals."""
        return 0.5 * float(self.point.residuals @ self.point.residuals)

    @property
    def missed(self) -> list[Missed]:
        """Targets that are not met: values by more than two sd, ranges by more than a fortieth of their width."""
        return [Missed(t.label, float(v), t.text, self.problem.unit_of(t), t.off(v))
                for t, v in zip(self.problem.targets, self.point.outputs, strict=True) if not t.met(v)]

    @property
    def jacobian(self) -> np.ndarray:
        """Derivatives of the residuals by the coordinates. Ranges that are met measure nothing, wherever in them (or on
        their edge) the search ended."""
        slopes = [0.0 if t.within is not None and t.met(v) else t.slope(v)
                  for t, v in zip(self.problem.targets, self.point.outputs, strict=True)]
        return self.output_jacobian * np.array(slopes)[:, None]

    @property
    def covariance(self) -> np.ndarray:
        """Of the coordinates x, from the targets' sd (weights shift the estimate, they do not sharpen the data);
        infinite along directions the targets do not see."""
        lower, upper = self.problem.bounds
        weights = np.array([t.weight for t in self.problem.targets])
        return _covariance(self.jacobian, weights, upper - lower)

    @property
    def undetermined(self) -> list[str]:
        """Parameters of which the targets say no more than their bounds: the 95 % interval would be wider."""
        lower, upper = self.problem.bounds
        wide = 2 * 1.959964 * np.sqrt(np.diag(self.covariance)) > upper - lower
        names = [n for n, is_wide in zip(self.problem.names, wide, strict=True) if is_wide]
        return names + [n for n, tie in self.problem.ties.items() if tie.to in names]

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % from the linearised problem, as honest as the targets' sd; of `undetermined` parameters the bounds,
        which are all that is known."""
        widths = 1.959964 * np.sqrt(np.diag(self.covariance))
        undetermined = self.undetermined
        result = {}
        for k, (name, free) in enumerate(self.problem.free.items()):
            if name in undetermined:
                result[name] = (free.lower, free.upper)
            elif free.transform == "log":
                result[name] = (float(np.exp(self.x[k] - widths[k])), float(np.exp(self.x[k] + widths[k])))
            else:
                result[name] = (float(self.x[k] - widths[k]), float(self.x[k] + widths[k]))
        return result | {n: tie.interval(*result[tie.to]) for n, tie in self.problem.ties.items()}

    def explain(self) -> Explanation:
        return explain(self)

    @property
    def verdict(self) -> list[str]:
        """In words: how the optimiser ended, which targets are missed, what became of the starts, what is doubtful."""
        missed = self.missed
        n = len(self.problem.targets)
        lines = [f"the optimiser {'converged' if self.converged else 'did not converge'}: {self.message}",
                 f"{len(missed)} of {n} targets missed:" if missed else
                 "the target is met" if n == 1 else f"all {n} targets are met"]
        lines += [f"  {m}" for m in missed]
        lines += self._words_on_starts()
        if self.failures:
            values, reason = self.failures[-1]
            lines.append(f"{len(self.failures)} points without a limit cycle were rejected; the last "
                         f"({_short(values)}): {reason}")
        return lines + [f"doubtful: {words}" for words in self.problem.doubts]

    def _words_on_starts(self) -> list[str]:
        if len(self.searches) < 2:
            return []
        costs = [s.cost for s in self.searches if s.cost is not None]
        same = sum(cost <= 1.01 * self.cost + 1e-9 for cost in costs)
        lines = [f"{len(self.searches)} starts: {same} ended at the best cost"
                 + (f", {len(costs) - same} at others" if len(costs) > same else "")]
        for k, search in enumerate(self.searches):
            if search.cost is None:
                lines.append(f"  start {k + 1} ({_short(search.start)}): {search.message}")
        return lines

    def __repr__(self) -> str:
        lines = self.verdict
        lines.append(f"cost {self.cost:.4g}, {self.solves} limit cycles, {self.gradients} gradients, "
                     f"{self.seconds:.2f} s")
        undetermined, intervals = self.undetermined, self.intervals
        for name, value in self.parameters.items():
            low, high = intervals[name]
            known = NOT_DETERMINED if name in undetermined else f"95 %: {low:.6g} to {high:.6g}"
            tie = f"   = {self.problem.ties[name]}" if name in self.problem.ties else ""
            bound = "   at its bound" if name in self.at_bound else ""
            lines.append(f"  {name:<34} {value:>12.6g}   {known}{tie}{bound}")
        return "\n".join(lines)


def _short(values: dict[str, float]) -> str:
    shown = [f"{n} = {v:.4g}" for n, v in list(values.items())[:4]]
    return ", ".join(shown) + (", ..." if len(values) > 4 else "")


def _covariance(jacobian: np.ndarray, weights: np.ndarray, width: np.ndarray) -> np.ndarray:
    """jacobian: of weighted residuals; width: the bounds', which make the parameters comparable."""
    u, s, vt = np.linalg.svd(jacobian * width[None, :], full_matrices=True)
    n = vt.shape[0]
    seen = int(np.sum(s > 1e-10 * s[0])) if len(s) and s[0] > 0 else 0
    # The estimate moves by pinv(J) times a noise that has the weights for its deviations.
    gain = vt[:seen].T / s[:seen] @ (u[:, :seen].T * weights[None, :])
    covariance = gain @ gain.T
    # A direction that no target sees: infinite for the parameters that have a part in it.
    blind = np.abs(vt[seen:]).max(axis=0, initial=0.0) > 1e-3 if seen < n else np.zeros(n, dtype=bool)
    covariance[blind, :] = covariance[:, blind] = 0.0
    covariance[blind, blind] = np.inf
    return covariance * np.outer(width, width)


class _NoDerivatives(Exception):
    """An accepted point where the cycle cannot be differentiated: the search ends there."""


def _search(problem: Problem, x0: np.ndarray, tolerance: float, max_gradients: int,
            verbose: int) -> tuple[Search, Fit | None]:
    """One search. A point without a cycle has infinite residuals, which scipy takes for a step too long."""
    from scipy.optimize import least_squares as scipy_least_squares

    lower, upper = problem.bounds
    x0 = np.clip(x0, lower + 1e-9 * (upper - lower), upper - 1e-9 * (upper - lower))
    start = problem.values(x0)
    if problem.point(x0) is None:
        return Search(start, None, None, False, problem.failures[-1][1]), None
    best: list[tuple[np.ndarray, Point, np.ndarray]] = []  # accepted points: scipy differentiates no other

    def jacobian(x: np.ndarray) -> np.ndarray:
        point = problem.point(x)
        try:
            outputs = problem.output_jacobian(x)
        except wiggers.NumericalFailure as error:
            problem.failures.append((problem.values(x), str(error)))
            raise _NoDerivatives(str(error)) from None
        assert point is not None
        best.append((np.array(x), point, outputs))
        return problem.jacobian(x)

    try:
        result: Any = scipy_least_squares(problem.residuals, x0, jac=jacobian, bounds=(lower, upper), method="trf",
                                          x_scale="jac", xtol=tolerance, ftol=tolerance, gtol=tolerance,
                                          max_nfev=max_gradients, verbose=verbose)
        message, converged = str(result.message), bool(result.status > 0)
    except _NoDerivatives as error:
        message, converged = f"ended where there are no derivatives: {error}", False
    if not best:
        return Search(start, None, None, False, message), None
    x, point, outputs = best[-1]
    near = 1e-6 * (upper - lower)
    at_bound = [n for n, v, a, b, w in zip(problem.names, x, lower, upper, near, strict=True) if v - a < w or b - v < w]
    fit = Fit(problem, x, point, outputs, message, converged, gradients=len(best), at_bound=at_bound)
    return Search(start, fit.parameters, fit.cost, converged, message), fit


def _starts(problem: Problem, first: np.ndarray, seed: int) -> Iterator[np.ndarray]:
    """The first, then points spread evenly over the bounds."""
    from scipy.stats import qmc

    yield first
    lower, upper = problem.bounds
    spread = qmc.Halton(len(problem.names), seed=seed)
    while True:
        yield lower + spread.random(1)[0] * (upper - lower)


def least_squares(problem: Problem, *, start: np.ndarray | NotGiven = not_given, starts: int = 1, seed: int = 1,
                  max_gradients: int = 60, tolerance: float = 1e-10, verbose: int = 0) -> Fit:
    """scipy's trust-region least squares with the exact Jacobian. start: coordinates (left out: the model's values).

    starts: searches from so many points, the first one from `start`, the others spread over the bounds by `seed`; the
    best is kept, `fit.searches` reports all. A start without a limit cycle is reported with its reason. Where none has
    one, up to ten more points of the bounds are tried.
    """
    begun = time.perf_counter()
    starts = whole(starts, "starts", 1, 10_000)
    first = problem.start if start is not_given else reals(start, "start")
    if first.shape != problem.start.shape or not np.isfinite(first).all():
        raise wiggers.InputError(f"start has shape {first.shape} and must be {len(problem.names)} finite coordinates: "
                                 f"{', '.join(problem.names)}")
    solves, failures = problem.solves, len(problem.failures)
    searches: list[Search] = []
    fits: list[Fit] = []
    for x0 in _starts(problem, first, whole(seed, "seed", 0)):
        if len(searches) >= starts and (fits or len(searches) >= starts + _MORE_STARTS):
            break
        search, fit = _search(problem, x0, tolerance, whole(max_gradients, "max_gradients"), verbose)
        searches.append(search)
        if fit:
            fits.append(fit)
    if not fits:
        reasons = "; ".join(dict.fromkeys(s.message for s in searches))
        raise wiggers.NumericalFailure(f"no limit cycle at {len(searches)} points of the bounds, the first one "
                                       f"{_short(searches[0].start)}: {reasons[:1000]}")
    best = min(fits, key=lambda fit: fit.cost)
    best.gradients = sum(fit.gradients for fit in fits)
    best.solves = problem.solves - solves
    best.failures = problem.failures[failures:]
    best.searches = searches
    best.seconds = time.perf_counter() - begun
    return best
