"""Targets: what an output should be, or the range it should lie in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import wiggers

_PHYSICAL = {"mL": (0.0, 1e4), "%": (0.0, 100.0), "s": (0.0, 20.0), "ms": (0.0, 2e4), "mL/s": (-1e5, 1e5),
             "mmHg": (-200.0, 1000.0), "L/min": (0.0, 100.0), "uM": (0.0, 1e3), "mV": (-150.0, 150.0)}


@dataclass(frozen=True)
class Target:
    """A value with its standard deviation, or a range.

    name: an output of the model ("LV.EDV_mL"); unit: refused if it is not the output's; sd: of a value (default:
    `relative_sd` of it); within: a range (lower, upper), inside which nothing is to be gained, outside which the
    distance counts in quarters of the range's width; weight: multiplies the residual.
    """

    name: str
    value: float | None = None
    sd: float | None = None
    within: tuple[float, float] | None = None
    weight: float = 1.0
    unit: str | None = None
    relative_sd: float = 0.02

    def __post_init__(self) -> None:
        if (self.value is None) == (self.within is None):
            raise wiggers.InputError(f"target {self.name}: give either a value or within=(lower, upper)")
        numbers = [("value", self.value), ("sd", self.sd), ("weight", self.weight)]
        for k, end in enumerate(self.within or ()):
            numbers.append((f"within[{k}]", end))
        for what, number in numbers:
            if number is not None and not math.isfinite(number):
                raise wiggers.InputError(f"target {self.name}: {what} = {number} is not finite")
        if self.sd is not None and self.sd <= 0:
            raise wiggers.InputError(f"target {self.name}: sd = {self.sd} must be positive")
        if self.weight < 0:
            raise wiggers.InputError(f"target {self.name}: weight = {self.weight} must not be negative")
        if self.within is not None and not self.within[0] < self.within[1]:
            raise wiggers.InputError(f"target {self.name}: within = {self.within} has no width")
        if self.value == 0 and self.sd is None:
            raise wiggers.InputError(f"target {self.name}: a value of 0 needs an sd of its own")

    @property
    def scale(self) -> float:
        """The residual's unit."""
        if self.within is not None:
            return (self.within[1] - self.within[0]) / 4
        if self.sd is not None:
            return self.sd
        assert self.value is not None
        return self.relative_sd * abs(self.value)

    def check(self, unit: str) -> None:
        """Refuses a wrong unit and values that no body has."""
        if self.unit is not None and self.unit != unit:
            raise wiggers.InputError(f"target {self.name}: unit {self.unit}, but this output is in {unit}")
        lower, upper = _PHYSICAL.get(unit, (-math.inf, math.inf))
        for number in (self.value, *(self.within or ())):
            if number is not None and not lower <= number <= upper:
                raise wiggers.InputError(
                    f"target {self.name} = {number} {unit} is out of physical reach ({lower:g} to {upper:g} {unit})")

    def residual(self, output: float) -> float:
        if self.within is not None:
            lower, upper = self.within
            off = min(output - lower, 0.0) + max(output - upper, 0.0)
        else:
            assert self.value is not None
            off = output - self.value
        return self.weight * off / self.scale

    def slope(self, output: float) -> float:
        """Derivative of the residual by the output."""
        inside = self.within is not None and self.within[0] <= output <= self.within[1]
        return 0.0 if inside else self.weight / self.scale

    @property
    def text(self) -> str:
        if self.within is not None:
            return f"{self.within[0]:g} to {self.within[1]:g}"
        return f"{self.value:g} ± {self.scale:.2g}"


def reference_targets(body_surface_area_m2: float, *, to: str = "founding_paper",
                      relative_sd: float = 0.02) -> list[Target]:
    """The twenty volumetric indexes as targets for a body of this surface: to = "founding_paper" (the whole-heart
    paper's values) or "range" (reference ranges of men)."""
    if to not in ("founding_paper", "range"):
        raise wiggers.InputError(f"to = {to!r}: choose founding_paper or range")
    targets = []
    for row in wiggers.reference_ranges():
        volume = row["unit"] == "mL/m2"
        name = row["index"] + ("_mL" if volume else "_percent")
        factor = body_surface_area_m2 if volume else 1.0
        if to == "range":
            targets.append(Target(name, within=(row["lower"] * factor, row["upper"] * factor)))
        else:
            targets.append(Target(name, row["founding_paper"] * factor, relative_sd=relative_sd))
    return targets
