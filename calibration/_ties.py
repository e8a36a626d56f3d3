"""Ties: parameters that follow a free one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import wiggers
from wiggers._checks import real, text


@dataclass(frozen=True)
class Tie:
    """value = times * (value of `to`) + plus, in the tied parameter's unit: Tie("walls.LV.activation_ms", plus=5),
    Tie("elastance.LV.EB", times=0.6)."""

    to: str
    times: float = 1.0
    plus: float = 0.0

    def __post_init__(self) -> None:
        text(self.to, "tie's to")
        for what in ("times", "plus"):
            number = real(getattr(self, what), f"tie to {self.to}: {what}")
            if not abs(number) < float("inf"):
                raise wiggers.InputError(f"tie to {self.to}: {what} = {number} is not finite")
        if self.times == 0:
            raise wiggers.InputError(f"tie to {self.to}: times = 0 ties nothing; hold the parameter at {self.plus} "
                                     "instead")

    def value(self, source: float) -> float:
        return self.times * source + self.plus

    def interval(self, low: float, high: float) -> tuple[float, float]:
        ends = sorted((self.value(low), self.value(high)))
        return ends[0], ends[1]

    def __str__(self) -> str:
        factor = f"{self.times:g} * " if self.times != 1 else ""
        return f"{factor}{self.to}" + (f" {'+' if self.plus > 0 else '-'} {abs(self.plus):g}" if self.plus else "")


def check_ties(ties: Mapping[str, Tie], free: Mapping[str, Any], held: Mapping[str, float], parameters: Any) -> None:
    """Refuses ties to what is not free, of what is set otherwise, and those that leave the parameter's range."""
    for name, tie in ties.items():
        info = parameters.info(name)
        if not isinstance(tie, Tie):
            raise wiggers.InputError(f"ties: {name} = {tie!r} is of type {type(tie).__name__}, wanted is a Tie")
        for kind, names in (("free", free), ("held", held)):
            if name in names:
                raise wiggers.InputError(f"{name} is {kind} and tied to {tie.to}: choose one")
        if tie.to not in free:
            parameters.info(tie.to)  # refuses an unknown name with the nearest
            raise wiggers.InputError(f"{name} is tied to {tie.to}, which is not free: hold {name} at a value, or tie "
                                     f"it to a free parameter ({', '.join(free)})")
        unit = parameters.info(tie.to).unit
        if unit != info.unit and tie.times == 1:
            raise wiggers.InputError(f"{name} ({info.unit}) is tied to {tie.to} ({unit}): units differ, so say times")
        low, high = tie.interval(free[tie.to].lower, free[tie.to].upper)
        if low < info.lower or high > info.upper:
            raise wiggers.InputError(f"{name} = {tie}: {low:g} to {high:g} {info.unit} over the bounds of {tie.to} "
                                     f"leave its range, {info.lower} to {info.upper} {info.unit}")
