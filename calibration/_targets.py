"""Targets: what an output should be, or the range it should lie in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import wiggers
from wiggers._checks import real, text

from ._outputs import Difference, Output, Ratio, unit_of

_PHYSICAL = {"mL": (0.0, 1e4), "%": (0.0, 100.0), "s": (0.0, 20.0), "ms": (0.0, 2e4), "mL/s": (-1e5, 1e5),
             "mmHg": (-200.0, 1000.0), "L/min": (0.0, 100.0), "uM": (0.0, 1e3), "mV": (-150.0, 150.0)}

# Other units in which an output's number is often given, and what one of them is in the output's.
_MISTAKEN = {"%": (("a share of 1", 100.0),), "mL": (("L", 1e3),), "s": (("ms", 1e-3),), "ms": (("s", 1e3),),
             "mmHg": (("kPa", 7.50062), ("Pa", 7.50062e-3)), "L/min": (("mL/min", 1e-3), ("mL/s", 0.06)),
             "mL/s": (("L/min", 1 / 0.06), ("L/s", 1e3)), "uM": (("mM", 1e3), ("nM", 1e-3)), "mV": (("V", 1e3),),
             "kPa": (("mmHg", 1 / 7.50062), ("Pa", 1e-3))}
_FAR = 20.0  # times the model's own output, or less than a twentieth of it: hardly the same unit
_MISSED_SD = 2.0  # a value farther off than this is missed
_MISSED_RANGE = 0.1  # the same for an output outside its range (a quarter of the range's width is one sd)


class TargetWarning(UserWarning):
    """A target that is hardly meant as it is written."""


@dataclass(frozen=True)
class Missed:
    """A target that the fit does not meet. by_sd: how far off, with its sign; a range's sd is a quarter of its width,
    counted from its nearer end."""

    name: str
    value: float
    wanted: str
    unit: str
    by_sd: float

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (f"{self.name} = {self.value:.4g}{unit}, wanted {self.wanted}{unit}: {abs(self.by_sd):.3g} sd "
                f"{'above' if self.by_sd > 0 else 'below'}")


@dataclass(frozen=True)
class Target:
    """A value with its standard deviation, or a range.

    name: an output of the model ("LV.EDV_mL"), or a Difference or Ratio of two; unit: refused if it is not the
    output's; sd: of a value (default: `relative_sd` of it); within: a range (lower, upper), inside which nothing is to
    be gained, outside which the distance counts in quarters of the range's width; weight: multiplies the residual.
    """

    name: Output
    value: float | None = None
    sd: float | None = None
    within: tuple[float, float] | None = None
    weight: float = 1.0
    unit: str | None = None
    relative_sd: float = 0.02

    def __post_init__(self) -> None:
        if not isinstance(self.name, Difference | Ratio):
            text(self.name, "name of a target")
        if (self.value is None) == (self.within is None):
            raise wiggers.InputError(f"target {self.name}: give either a value or within=(lower, upper)")
        if self.within is not None and not (isinstance(self.within, tuple | list) and len(self.within) == 2):
            raise wiggers.InputError(f"target {self.name}: within = {self.within!r}, wanted is (lower, upper)")
        numbers = [("weight", self.weight), ("relative_sd", self.relative_sd)]
        numbers += [(what, number) for what, number in (("value", self.value), ("sd", self.sd)) if number is not None]
        numbers += [(f"within[{k}]", end) for k, end in enumerate(self.within or ())]
        for what, number in numbers:
            if not math.isfinite(real(number, f"target {self.name}: {what}")):
                raise wiggers.InputError(f"target {self.name}: {what} = {number} is not finite")
        if self.unit is not None:
            text(self.unit, f"target {self.name}: unit")
        if self.sd is not None and self.sd <= 0:
            raise wiggers.InputError(f"target {self.name}: sd = {self.sd} must be positive")
        if self.relative_sd <= 0:
            raise wiggers.InputError(f"target {self.name}: relative_sd = {self.relative_sd} must be positive")
        if self.weight < 0:
            raise wiggers.InputError(f"target {self.name}: weight = {self.weight} must not be negative")
        if self.within is not None and not self.within[0] < self.within[1]:
            raise wiggers.InputError(f"target {self.name}: within = {self.within} has no width")
        if self.value == 0 and self.sd is None:
            raise wiggers.InputError(f"target {self.name}: a value of 0 needs an sd of its own")

    @property
    def label(self) -> str:
        """The output's name as it is written in lists."""
        return str(self.name)

    @property
    def scale(self) -> float:
        """The residual's unit."""
        if self.within is not None:
            return (self.within[1] - self.within[0]) / 4
        if self.sd is not None:
            return self.sd
        assert self.value is not None
        return self.relative_sd * abs(self.value)

    def check(self, unit_of_output: Callable[[str], str]) -> None:
        """Refuses a wrong unit and values that no body has."""
        unit = unit_of(self.name, unit_of_output)
        if self.unit is not None and self.unit != unit:
            raise wiggers.InputError(f"target {self.name}: unit {self.unit}, but this output is in {unit}")
        if isinstance(self.name, Ratio):
            return
        lower, upper = _PHYSICAL.get(unit, (-math.inf, math.inf))
        if isinstance(self.name, Difference):
            lower, upper = lower - upper, upper - lower
        for number in (self.value, *(self.within or ())):
            if number is not None and not lower <= number <= upper:
                raise wiggers.InputError(
                    f"target {self.name} = {number} {unit} is out of physical reach ({lower:g} to {upper:g} {unit})")

    def doubt(self, unit_of_output: Callable[[str], str], output: float | None) -> str:
        """Words where the number seems to be in another unit: it is of another order than the model's own output (None:
        unknown), or a percentage of at most one."""
        if not isinstance(self.name, str) or self.unit is not None:
            return ""  # a difference may be small, and who names the unit means it
        unit = unit_of_output(self.name)
        number = self.value
        if self.within is not None:  # the end that is nearer to the model's own; a range that holds it is no surprise
            if output is not None and self.within[0] <= output <= self.within[1]:
                return ""
            number = min(self.within, key=lambda end: -abs(end) if output is None else abs(end - output))
        assert number is not None
        share = unit == "%" and 0 < number <= 1
        ratio = abs(number / output) if output else 1.0
        others = [name for name, factor in _MISTAKEN.get(unit, ())
                  if output and not 0.2 < ratio < 5 and abs(factor * number / output - 1) < 0.25]
        if number == 0 or not (share or others or ratio > _FAR or ratio < 1 / _FAR):
            return ""
        own = f"; the model's own is {output:.4g} {unit}" if output else ""
        guess = "a share of 1" if share else others[0] if others else ""
        return (f"target {self.name}: {self.text} is taken in {unit}, the unit of this output{own}. "
                + (f"Is it given as {guess}? " if guess else "Is it in another unit? ")
                + f"If it is meant, say unit=\"{unit}\".")

    def off(self, output: float) -> float:
        """How far the output is off, in sd (a range's: a quarter of its width)."""
        if self.within is not None:
            lower, upper = self.within
            return (min(output - lower, 0.0) + max(output - upper, 0.0)) / self.scale
        assert self.value is not None
        return (output - self.value) / self.scale

    def met(self, output: float) -> bool:
        """Within two sd of the value; in the range, a tenth of an sd to spare."""
        return abs(self.off(output)) <= (_MISSED_SD if self.within is None else _MISSED_RANGE)

    def residual(self, output: float) -> float:
        return self.weight * self.off(output)

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
