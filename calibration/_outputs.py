"""What a target may be set on: an output of the model, a difference or a ratio of two, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import wiggers


@dataclass(frozen=True)
class Difference:
    """first - second, each an output's name, a difference or a ratio: Difference("LV.EDV_mL", "RV.EDV_mL")."""

    first: str | Difference | Ratio
    second: str | Difference | Ratio

    def __post_init__(self) -> None:
        _check(self.first, self.second)

    def __str__(self) -> str:
        second = f"({self.second})" if isinstance(self.second, Difference) else str(self.second)
        return f"{self.first} - {second}"


@dataclass(frozen=True)
class Ratio:
    """first / second, each an output's name, a difference or a ratio: Ratio("RV.EDV_mL", "LV.EDV_mL")."""

    first: str | Difference | Ratio
    second: str | Difference | Ratio

    def __post_init__(self) -> None:
        _check(self.first, self.second)

    def __str__(self) -> str:
        first = f"({self.first})" if isinstance(self.first, Difference) else str(self.first)
        second = str(self.second) if isinstance(self.second, str) else f"({self.second})"
        return f"{first} / {second}"


Output = str | Difference | Ratio


def _check(*outputs: Output) -> None:
    for output in outputs:
        if not isinstance(output, Output):
            raise wiggers.InputError(f"output {output!r} is of type {type(output).__name__}, wanted is a name, a "
                                     "Difference or a Ratio")


def names_in(output: Output) -> list[str]:
    """The model's outputs that it is made of."""
    return [output] if isinstance(output, str) else [*names_in(output.first), *names_in(output.second)]


def value_of(output: Output, outputs: Mapping[str, float]) -> float:
    if isinstance(output, str):
        return outputs[output]
    first, second = value_of(output.first, outputs), value_of(output.second, outputs)
    if isinstance(output, Difference):
        return first - second
    if second == 0:
        raise wiggers.NumericalFailure(f"{output}: {output.second} is 0 in this beat")
    return first / second


def slopes_of(output: Output, outputs: Mapping[str, float]) -> dict[str, float]:
    """Derivatives by the model's outputs."""
    if isinstance(output, str):
        return {output: 1.0}
    if isinstance(output, Difference):
        by_first, by_second = 1.0, -1.0
    else:
        second = value_of(output.second, outputs)
        by_first, by_second = 1 / second, -value_of(output, outputs) / second
    slopes: dict[str, float] = {}
    for part, factor in ((output.first, by_first), (output.second, by_second)):
        for name, slope in slopes_of(part, outputs).items():
            slopes[name] = slopes.get(name, 0.0) + factor * slope
    return slopes


def unit_of(output: Output, unit: Callable[[str], str]) -> str:
    """unit: of the model's outputs. Refuses a difference of unlike quantities."""
    if isinstance(output, str):
        return unit(output)
    first, second = unit_of(output.first, unit), unit_of(output.second, unit)
    if isinstance(output, Difference):
        if first != second:
            raise wiggers.InputError(f"{output}: {output.first} is in {first}, {output.second} in {second}")
        return first
    return "1" if first == second else f"{first}/{second}" if second != "1" else first
