"""What a fit knows: which parameter each target constrains, what goes together, what cannot be known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ._targets import Missed

if TYPE_CHECKING:
    from ._fit import Fit

COLLINEAR = 0.95


@dataclass
class Explanation:
    """constrained_by: target -> [(parameter, residual's change over a tenth of the parameter's bounds)], strongest
    first. widths: half of the 95 % interval as a share of the bounds (0.5 and more: not determined). groups:
    parameters that the targets see only together (correlation above 0.95). unidentified: directions in which a step
    across the bounds moves no target by one sd, each as [(parameter, share)]. singular_values: of the residuals'
    Jacobian over the bounds."""

    constrained_by: dict[str, list[tuple[str, float]]]
    widths: dict[str, float]
    groups: list[list[str]]
    unidentified: list[list[tuple[str, float]]]
    singular_values: np.ndarray
    missed: list[Missed]
    undetermined: list[str]  # parameters of which the targets say no more than their bounds

    @property
    def outside(self) -> list[tuple[str, float, str]]:
        """Missed targets: (name, output, wanted)."""
        return [(m.name, m.value, m.wanted) for m in self.missed]

    def __str__(self) -> str:
        lines = ["what each target constrains (change of its residual over a tenth of the bounds):"]
        for target, rows in self.constrained_by.items():
            lines.append(f"  {target:<28} " + (", ".join(f"{n} {v:+.2g}" for n, v in rows[:4]) or "nothing"))
        lines.append("how well each parameter is known (half its 95 % interval, share of the bounds):")
        for name, width in sorted(self.widths.items(), key=lambda item: item[1]):
            lines.append(f"  {name:<34} " + ("not determined by these targets" if name in self.undetermined
                                             else f"{100 * width:.3g} %"))
        for group in self.groups:
            lines.append("seen only together: " + ", ".join(group))
        for direction in self.unidentified:
            lines.append("cannot be identified: " + ", ".join(f"{v:+.2f} {n}" for n, v in direction))
        lines += [f"not met: {m}" for m in self.missed]
        return "\n".join(lines)


def explain(fit: Fit) -> Explanation:
    problem = fit.problem
    lower, upper = problem.bounds
    width = upper - lower
    # Ranges count as if they were values at their middle: what they could constrain.
    scales = np.array([t.weight / t.scale for t in problem.targets])
    scaled = fit.output_jacobian * scales[:, None] * width[None, :]
    names = problem.names
    constrained = {}
    for target, row in zip(problem.targets, scaled, strict=True):
        order = np.argsort(-np.abs(row))
        constrained[target.label] = [(names[k], 0.1 * float(row[k])) for k in order if abs(row[k]) > 1e-12]
    from ._fit import _covariance

    known = np.sqrt(np.diag(fit.covariance)) / width
    widths = {n: float(1.96 * d) for n, d in zip(names, known, strict=True)}
    # For what goes together and what cannot be known, ranges count as values at their middle.
    covariance = _covariance(scaled / width[None, :], np.ones(len(scales)), width) / np.outer(width, width)
    deviation = np.sqrt(np.diag(covariance))
    groups: list[list[str]] = []
    taken: set[str] = set()
    for k, name in enumerate(names):
        if name in taken or not np.isfinite(deviation[k]):
            continue
        together = [name]
        for j in range(k + 1, len(names)):
            if np.isfinite(deviation[j]) and abs(covariance[k, j]) > COLLINEAR * deviation[k] * deviation[j]:
                together.append(names[j])
        if len(together) > 1:
            groups.append(together)
            taken.update(together)
    _, s, vt = np.linalg.svd(scaled, full_matrices=True)
    values = np.zeros(len(names))
    values[: len(s)] = s
    directions = []
    for k in range(len(names)):
        if values[k] < 1:
            order = np.argsort(-np.abs(vt[k]))
            directions.append([(names[j], float(vt[k, j])) for j in order if abs(vt[k, j]) > 0.1])
    return Explanation(constrained, widths, groups, directions, values, fit.missed, fit.undetermined)
