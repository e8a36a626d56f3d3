"""What callers hand over, checked by type and name before it reaches the compiled part.

Real numbers are wanted almost everywhere. Truth values, texts, complex numbers, None and objects are refused, though
NumPy would turn most of them into some number without a word.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any, Final

import numpy as np

from ._core import InputError


class NotGiven(Enum):
    """The default of arguments that may be left out. None is no such default: it is what a failed search or a
    forgotten assignment hands over, and is refused."""

    not_given = "not given"

    def __repr__(self) -> str:
        return "not_given"


not_given: Final = NotGiven.not_given


def shown(value: Any) -> str:
    """A value for a message, of bounded length."""
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return text if len(text) <= 60 else text[:57] + "..."


def _kind(value: Any) -> str:
    return "None" if value is None else f"of type {type(value).__name__}"


def real(value: Any, what: str) -> float:
    """One real number: Python's, NumPy's, or anything that turns itself into one."""
    dtype = getattr(value, "dtype", None)
    wrong = isinstance(value, bool | str | bytes | bytearray | complex) or value is None
    if isinstance(value, np.ndarray | np.generic):
        wrong = value.ndim != 0 or getattr(dtype, "kind", "f") not in "fiu"
    if not wrong:
        try:
            return float(value)
        except (TypeError, ValueError, OverflowError):
            pass
    raise InputError(f"{what} = {shown(value)} is not a number; it is {_kind(value)}, wanted is one real number")


def whole(value: Any, what: str, lower: int = 1, upper: int | None = None) -> int:
    """A whole number; 3.0 is one, True and "3" are not."""
    try:
        number = real(value, what)
        good = number == int(number) and number >= lower and (upper is None or number <= upper)
    except (InputError, ValueError, OverflowError):
        good = False
    if not good:
        wanted = f"a whole number of at least {lower}" if upper is None else f"a whole number from {lower} to {upper}"
        raise InputError(f"{what} = {shown(value)} is not {wanted}")
    return int(number)


def text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"{what} = {shown(value)} is {_kind(value)}, wanted is text")
    return value


def texts(values: Any, what: str) -> list[str]:
    """A list of names; one text is not taken for the list of its letters."""
    if isinstance(values, str | bytes) or not hasattr(values, "__iter__"):
        raise InputError(f"{what} = {shown(values)} is {_kind(values)}, wanted is a list of names")
    return [text(value, f"{what}[{k}]") for k, value in enumerate(values)]


def reals(values: Any, what: str) -> np.ndarray:
    """An array of real numbers (NaN among them), in one block of memory; copied only where it must be."""
    if isinstance(values, list | tuple):
        _refuse_booleans(values, what)
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise InputError(f"{what} has masked values: fill or remove them")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: {error}") from None
    if array.dtype.kind not in "fiu":
        # A data frame's column of whole numbers with holes, and an empty one of no type in particular.
        if getattr(getattr(values, "dtype", None), "kind", "O") in "fiu" and hasattr(values, "to_numpy"):
            return np.ascontiguousarray(values.to_numpy(dtype=float, na_value=np.nan))
        if array.dtype.kind == "O" and array.size == 0 and values is not None:
            return np.empty(array.shape)
        raise InputError(f"{what} has dtype {array.dtype}, wanted are real numbers" + _first_wrong(array))
    return np.ascontiguousarray(array, dtype=float) if array.ndim else array.astype(float)


def _refuse_booleans(values: Sequence[Any], what: str) -> None:
    """A list of truth values and numbers becomes an array of numbers."""
    for k, value in enumerate(values):
        if isinstance(value, bool | np.bool_):
            raise InputError(f"{what}[{k}] = {value!r} is a truth value, wanted are real numbers")
        if isinstance(value, list | tuple):
            _refuse_booleans(value, f"{what}[{k}]")


def _first_wrong(array: np.ndarray) -> str:
    if array.ndim == 0:
        return f": could not convert {shown(array[()])}"
    for index, value in np.ndenumerate(array):
        try:
            real(value, "")
        except InputError:
            return f": could not convert [{', '.join(map(str, index))}] = {shown(value)}"
    return ""


def read_only(array: np.ndarray) -> np.ndarray:
    """The same numbers, which cannot be assigned; no copy."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


class Held:
    """A result whose arrays stay read-only when it is copied or comes out of a pickle."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update({k: read_only(v) if isinstance(v, np.ndarray) else v for k, v in state.items()})
