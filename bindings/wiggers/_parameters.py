"""A model's parameters: a mapping by full name, and attributes by its parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any

import numpy as np

from ._checks import real, reals, shown, text
from ._core import InputError, Parameter


class Parameters(MutableMapping):
    """`p["elastance.LV.EA"]`, `p.elastance.LV.EA`; assigning checks name and range and may refuse.

    `info(name)` gives unit, default, range and meaning; `update({...})` changes several at once, so that what must hold
    between them is checked once. The order is that of `names` and of `array`.
    """

    def __init__(self, model: Any) -> None:
        object.__setattr__(self, "_model", model)

    @property
    def _core(self) -> Any:
        return self._model._core

    def __reduce__(self) -> Any:
        # What is pickled or copied deeply is of a model of its own.
        return Parameters, (self._model,)

    def _list(self) -> list[Parameter]:
        return self._core.parameters()

    @property
    def names(self) -> list[str]:
        return [p.name for p in self._list()]

    @property
    def array(self) -> np.ndarray:
        """All values, in order."""
        return np.array([p.value for p in self._list()])

    def info(self, name: str) -> Parameter:
        text(name, "name of a parameter")
        for parameter in self._list():
            if parameter.name == name:
                return parameter
        self._core.set_parameter(name, 0.0)  # refuses, with the nearest name
        raise KeyError(name)

    def __getitem__(self, name: str) -> float:
        return self.info(name).value

    def __setitem__(self, name: str, value: float) -> None:
        self._core.set_parameter(text(name, "name of a parameter"), real(value, name))

    def __delitem__(self, name: str) -> None:
        raise InputError(f"{name}: a parameter cannot be removed; assign its default, {self.info(name).default}")

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def get(self, name: str, default: Any = None) -> Any:
        return self[name] if name in self else default

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self._list())

    def update(self, other: Mapping[str, float] = {}, /, **more: float) -> None:  # noqa: B006
        """Changes several at once."""
        names = self.names
        values = self.array
        try:
            changes = {**dict(other), **more}
        except (TypeError, ValueError):
            raise InputError(f"changes of parameters = {shown(other)}: wanted is a mapping from names to values") from None
        for name, value in changes.items():
            if name not in names:
                self.info(name)
            values[names.index(name)] = real(value, name)
        self._core.set_parameters(values)

    def _assign(self, values: np.ndarray) -> None:
        self._core.set_parameters(reals(values, "values"))

    def __getattr__(self, part: str) -> Any:
        if part.startswith("_"):
            raise AttributeError(part)
        return _Part(self, part)._resolve()

    def __setattr__(self, part: str, value: float) -> None:
        self[part] = value

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *{name.split(".")[0] for name in self.names}]

    def __repr__(self) -> str:
        rows = self._list()
        width = max((len(p.name) for p in rows), default=0)
        return "\n".join(f"{p.name:<{width}}  {p.value:>12.6g} {p.unit:<12} {p.meaning}" for p in rows)

    def to_pandas(self) -> Any:
        """A data frame with one row a parameter: value, unit, default, lower, upper, meaning."""
        import pandas

        fields = ("value", "unit", "default", "lower", "upper", "meaning")
        rows = self._list()
        return pandas.DataFrame({f: [getattr(p, f) for p in rows] for f in fields}, index=[p.name for p in rows])


class _Part:
    """The part of a mapping under a prefix, for attribute access."""

    def __init__(self, parameters: Parameters, prefix: str) -> None:
        object.__setattr__(self, "_parameters", parameters)
        object.__setattr__(self, "_prefix", prefix)

    def __reduce__(self) -> Any:
        return _Part, (self._parameters, self._prefix)

    def _resolve(self) -> Any:
        names = self._parameters.names
        if self._prefix in names:
            return self._parameters[self._prefix]
        if any(name.startswith(self._prefix + ".") for name in names):
            return self
        raise AttributeError(f"no parameter {self._prefix}; see `parameters.names`")

    def __getattr__(self, part: str) -> Any:
        if part.startswith("_"):
            raise AttributeError(part)
        return _Part(self._parameters, f"{self._prefix}.{part}")._resolve()

    def __setattr__(self, part: str, value: float) -> None:
        self._parameters[f"{self._prefix}.{part}"] = value

    def __dir__(self) -> list[str]:
        start = self._prefix + "."
        return [name[len(start):].split(".")[0] for name in self._parameters.names if name.startswith(start)]

    def __repr__(self) -> str:
        start = self._prefix + "."
        return "\n".join(repr(p) for p in self._parameters._list() if p.name.startswith(start))
