"""Least squares with the exact Jacobian, and what it tells."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ._explain import Explanation, explain
from ._problem import Point, Problem


@dataclass
class Fit:
    """A solved problem. intervals: 95 % from the linearised problem, honest where the targets' sd are; NaN where
    the targets leave a parameter free."""

    problem: Problem
    x: np.ndarray
    point: Point
    jacobian: np.ndarray
    message: str
    success: bool
    seconds: float
    solves: int
    gradients: int
    failures: int
    at_bound: list[str] = field(default_factory=list)

    @property
    def parameters(self) -> dict[str, float]:
        return self.problem.values(self.x)

    @property
    def outputs(self) -> dict[str, float]:
        return {t.name: float(v) for t, v in zip(self.problem.targets, self.point.outputs, strict=True)}

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals."""
        return 0.5 * float(self.point.residuals @ self.point.residuals)

    @property
    def covariance(self) -> np.ndarray:
        """Of the coordinates x, from the targets' sd (weights shift the estimate, they do not sharpen the data);
        infinite along directions the targets do not see."""
        lower, upper = self.problem.bounds
        weights = np.array([t.weight for t in self.problem.targets])
        return _covariance(self.jacobian, weights, upper - lower)

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        widths = 1.959964 * np.sqrt(np.diag(self.covariance))
        result = {}
        for k, (name, free) in enumerate(self.problem.free.items()):
            if not np.isfinite(widths[k]):
                result[name] = (float("nan"), float("nan"))
            elif free.transform == "log":
                result[name] = (float(np.exp(self.x[k] - widths[k])), float(np.exp(self.x[k] + widths[k])))
            else:
                result[name] = (float(self.x[k] - widths[k]), float(self.x[k] + widths[k]))
        return result

    def explain(self) -> Explanation:
        return explain(self)

    def __repr__(self) -> str:
        lines = [f"{'converged' if self.success else 'not converged'}: {self.message}",
                 f"cost {self.cost:.4g}, {self.solves} limit cycles, {self.gradients} gradients, {self.seconds:.2f} s"]
        for name, value in self.parameters.items():
            low, high = self.intervals[name]
            lines.append(f"  {name:<34} {value:>12.6g}   95 %: {low:.6g} to {high:.6g}"
                         + ("   at its bound" if name in self.at_bound else ""))
        return "\n".join(lines)


def _covariance(jacobian: np.ndarray, weights: np.ndarray, width: np.ndarray) -> np.ndarray:
    """jacobian: of weighted residuals; width: the bounds', which make the parameters comparable."""
    u, s, vt = np.linalg.svd(jacobian * width[None, :], full_matrices=True)
    n = vt.shape[0]
    seen = int(np.sum(s > 1e-10 * s[0])) if len(s) and s[0] > 0 else 0
    # The estimate moves by pinv(J) times a noise that has the weights for its deviations.
    gain = vt[:seen].T / s[:seen] @ (u[:, :seen].T * weights[None, :])
    covariance = gain @ gain.T
    # A direction that no target sees: infinite for the parameters that have a part in it.
    blind = np.abs(vt[seen:]).max(axis=0, initial=0.0) > 1e-3
    covariance[blind, :] = covariance[:, blind] = 0.0
    covariance[np.ix_(blind, blind)] = 0.0
    covariance[blind, blind] = np.inf
    with np.errstate(invalid="ignore"):
        return covariance * np.where(covariance == 0, 1.0, np.outer(width, width))


def least_squares(problem: Problem, *, start: np.ndarray | None = None, max_gradients: int = 60,
                  tolerance: float = 1e-10, verbose: int = 0) -> Fit:
    """scipy's trust-region least squares with the exact Jacobian. start: coordinates (default: the model's values)."""
    from scipy.optimize import least_squares as scipy_least_squares

    begun = time.perf_counter()
    solves, failures = problem.solves, len(problem.failures)
    lower, upper = problem.bounds
    x0 = np.clip(problem.start if start is None else np.asarray(start, dtype=float),
                 lower + 1e-9 * (upper - lower), upper - 1e-9 * (upper - lower))
    if problem.point(x0) is None:
        import wiggers

        raise wiggers.NumericalFailure(f"no limit cycle at the start {problem.values(x0)}: {problem.failures[-1][1]}")
    result: Any = scipy_least_squares(problem.residuals, x0, jac=problem.jacobian, bounds=(lower, upper), method="trf",
                                      x_scale="jac", xtol=tolerance, ftol=tolerance, gtol=tolerance,
                                      max_nfev=max_gradients, verbose=verbose)
    point = problem.point(result.x)
    if point is None:
        import wiggers

        raise wiggers.NumericalFailure(f"the search ended where there is no limit cycle: {problem.failures[-1]}")
    near = 1e-6 * (upper - lower)
    at_bound = [n for n, x, a, b, w in zip(problem.names, result.x, lower, upper, near, strict=True)
                if x - a < w or b - x < w]
    return Fit(problem, result.x, point, problem.jacobian(result.x), result.message, bool(result.status > 0),
               time.perf_counter() - begun, problem.solves - solves, int(result.njev),
               len(problem.failures) - failures, at_bound)
