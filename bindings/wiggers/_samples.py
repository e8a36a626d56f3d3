"""Samples of a batch, from whatever has named columns: mappings, data frames, structured arrays, lists of mappings;
or an array with names beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._checks import reals, shown, texts
from ._core import InputError


def samples_of(samples: Any, names: Sequence[str] | None) -> tuple[list[str], np.ndarray]:
    """Parameter names, and values [sample, parameter] that are nobody else's."""
    if names is not None:
        names = _distinct(texts(names, "names"))
    if isinstance(samples, Mapping):
        if names is not None:
            raise InputError("names: not with a mapping, which has its own")
        return _stacked({name: samples[name] for name in samples})
    columns = _columns(samples)
    if columns is None:
        return _plain(samples, names)
    for name in names or ():
        if name not in columns:
            from ._results import _position

            _position(list(columns), name, "column of the samples")
    return _stacked({name: columns[name] for name in names or columns})


def _columns(samples: Any) -> dict[str, Any] | None:
    """The columns of a table by name; None if it is an array."""
    fields = getattr(getattr(samples, "dtype", None), "names", None)
    if fields:  # a structured array
        return {name: samples[name] for name in fields}
    # Data frames of pandas, polars and their like; tables of Arrow.
    for listing in ("column_names", "columns"):
        found = getattr(samples, listing, None)
        if found is not None and not callable(found) and hasattr(samples, "__getitem__"):
            names = _distinct(texts(found, "columns of the samples"))
            try:
                return {name: samples[name] for name in names}
            except (KeyError, TypeError) as error:
                raise InputError(f"samples of type {type(samples).__name__} give no columns by name: {error}") from None
    if isinstance(samples, Sequence) and not isinstance(samples, str) and len(samples) and all(
            isinstance(row, Mapping) for row in samples):
        first = list(samples[0])
        for k, row in enumerate(samples):
            if set(row) != set(first):
                odd = sorted(map(str, set(row) ^ set(first)))
                raise InputError(f"samples[{k}] and samples[0] differ in their names: {', '.join(odd)}")
        return {name: [row[name] for row in samples] for name in first}
    return None


def _stacked(columns: dict[str, Any]) -> tuple[list[str], np.ndarray]:
    names = texts(columns, "names of the samples")
    arrays = [np.atleast_1d(reals(values, name)) for name, values in columns.items()]
    lengths = {len(a) for a in arrays if a.ndim == 1}
    if any(a.ndim != 1 for a in arrays) or len(lengths - {1}) > 1:
        shapes = ", ".join(f"{n}: {a.shape}" for n, a in zip(names, arrays, strict=True))
        raise InputError(f"samples must be one-dimensional and of one length, they are {shapes}")
    # One value goes with any number of others, none among them.
    n = next(iter(lengths - {1}), 1) if lengths else 0
    values = np.empty((n, len(arrays)))
    for k, array in enumerate(arrays):
        values[:, k] = array
    return names, values


def _plain(samples: Any, names: list[str] | None) -> tuple[list[str], np.ndarray]:
    values = np.array(reals(samples, "samples"))
    if names is None:
        raise InputError("names is missing: an array of samples needs the parameter of each column")
    if values.ndim != 2 or values.shape[1] != len(names):
        raise InputError(f"samples has shape {values.shape}, wanted is (samples, {len(names)})")
    return names, values


def _distinct(names: list[str]) -> list[str]:
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two columns of the samples are named {shown(name)}")
    return names
