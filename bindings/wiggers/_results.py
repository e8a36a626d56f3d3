"""What the models give back: traces, cycles, sensitivities, batches."""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Iterable
from typing import Any, NoReturn

import numpy as np

from ._checks import Held, read_only, text
from ._core import Certificate, Columns, FileKind, InputError, SensitivityTable, read_file, write_file

STATE_FORMAT = 1


class StateMismatch(InputError):
    """A saved state belongs to another model, or to other parameters."""


class Trace(Held):
    """Named columns with units: `trace["V"]` is a read-only view of the computed memory, nothing is copied.
    end_state: the state at the last row, to go on from."""

    def __init__(self, columns: Columns, end_state: np.ndarray) -> None:
        self._columns = columns
        self.end_state = read_only(end_state)

    @property
    def names(self) -> list[str]:
        return self._columns.names

    def unit(self, name: str) -> str:
        return self._columns.unit(text(name, "column"))

    def meaning(self, name: str) -> str:
        return self._columns.meaning(text(name, "column"))

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[text(name, "column")]

    def __len__(self) -> int:
        return len(self._columns)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __repr__(self) -> str:
        return f"Trace of {len(self)} rows: {', '.join(self.names)}"

    def to_pandas(self) -> Any:
        """A data frame indexed by time; units are in `frame.attrs["units"]`."""
        import pandas

        time, *rest = self.names
        frame = pandas.DataFrame({name: self[name] for name in rest}, index=pandas.Index(self[time], name=time))
        frame.attrs["units"] = {name: self.unit(name) for name in self.names}
        return frame

    def to_xarray(self) -> Any:
        """A dataset over time; every variable carries its unit and meaning."""
        import xarray

        time, *rest = self.names
        return xarray.Dataset(
            {n: (time, self[n], {"units": self.unit(n), "long_name": self.meaning(n)}) for n in rest},
            coords={time: (time, self[time], {"units": self.unit(time)})},
        )


class Indexes(dict[str, float]):
    """Indexes of a beat by name. One that the beat does not have is absent; `no_action_potential` says why a cell's
    beat has no duration ("did not repolarise", "blocked: ...") and is empty otherwise."""

    def __init__(self, values: Iterable[tuple[str, float]] = (), no_action_potential: str = "") -> None:
        super().__init__(values)
        self.no_action_potential = no_action_potential

    def __missing__(self, name: str) -> NoReturn:
        why = f": no action potential: {self.no_action_potential}" if self.no_action_potential else ""
        raise KeyError(f"{name}{why}")

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        raise AttributeError(f"indexes are read by name: indexes[{name!r}]")

    def __repr__(self) -> str:
        why = f" (no action potential: {self.no_action_potential})" if self.no_action_potential else ""
        return super().__repr__() + why


class Cycle(Held):
    """A limit cycle: the state at the beat's start, the certificate of the search, the indexes of its beat."""

    def __init__(self, state: np.ndarray, certificate: Certificate, indexes: Indexes, model: str,
                 parameters: dict[str, float], structure: str = "") -> None:
        self.state = read_only(state)
        self.certificate = certificate
        self.indexes = indexes
        self.model = model
        self.parameters = parameters
        self.structure = structure

    def __repr__(self) -> str:
        why = self.indexes.no_action_potential
        return f"Cycle of {self.structure or self.model}: {self.certificate}" + (f"; no action potential: {why}" if why else "")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the state with everything needed to recognise it (JSON); a kill leaves the old file or the new."""
        c = self.certificate
        content = {
            "format": STATE_FORMAT,
            "model": self.model,
            "structure": self.structure,
            "parameters": self.parameters,
            "state": [float(x).hex() for x in self.state],
            "certificate": {f: getattr(c, f) for f in ("verdict", "distance", "residual", "multiplier", "beats")},
            "indexes": self.indexes,
        }
        if c.warnings:
            content["warnings"] = c.warnings
        if self.indexes.no_action_potential:
            content["no_action_potential"] = self.indexes.no_action_potential
        content["checksum"] = _checksum(content)
        write_file(os.fspath(path), json.dumps(content, indent=1).encode(), FileKind.state)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Cycle:
        """Reads what `save` wrote; whatever is not that is refused with the file and the key, and so is a state that
        breaks the rules of the model it names."""
        cycle = _SavedCycle(os.fspath(path)).cycle()
        _require_state_of_model(os.fspath(path), cycle)
        return cycle


class _SavedCycle:
    """A file of a cycle, believed in nothing: kind, length and finiteness of every entry are looked at."""

    LONGEST = 1_000_000  # of a state
    _unchanged = True

    def __init__(self, path: str) -> None:
        self.path = path
        try:
            content = json.loads(read_file(path), parse_constant=self._no_number)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: not a saved limit cycle: {error}") from None
        if not isinstance(content, dict):
            raise InputError(f"{path}: not a saved limit cycle: it is no table of entries")
        self.content = content
        if self.entry("format", int) != STATE_FORMAT:
            raise StateMismatch(f"{path}: format {content['format']}, this version reads {STATE_FORMAT}")
        if content.pop("checksum", None) != _checksum(content):
            self._unchanged = False

    def cycle(self) -> Cycle:
        state = self.entry("state", list)
        if not 0 < len(state) <= self.LONGEST:
            self.refuse("state", f"has {len(state)} numbers")
        numbers = [self.of_text(f"state[{k}]", x) for k, x in enumerate(state)]
        saved = self.entry("certificate", dict)
        facts = {f: self.number(f"certificate.{f}", saved.get(f)) for f in ("distance", "residual", "multiplier")}
        beats, verdict = saved.get("beats"), saved.get("verdict")
        if type(beats) is not int or not 0 <= beats < 2**31:
            self.refuse("certificate.beats", f"is {_short(beats)}, not a count")
        if not isinstance(verdict, str):
            self.refuse("certificate.verdict", f"is {_short(verdict)}, not a text")
        for name, value in facts.items():
            if value < 0:
                self.refuse(f"certificate.{name}", f"is {value}, which no search leaves")
        warnings = self.entry("warnings", list) if "warnings" in self.content else []
        if not all(isinstance(warning, str) for warning in warnings):
            self.refuse("warnings", "are no texts")
        why_not = self.entry("no_action_potential", str) if "no_action_potential" in self.content else ""
        try:
            certificate = Certificate(verdict=verdict, beats=beats, warnings=warnings, **facts)
        except InputError as error:
            self.refuse("certificate.verdict", f": {error}")
        for key in ("indexes", "parameters"):
            self.table(key)
        for key in ("model", "structure"):
            self.entry(key, str)
        if not self._unchanged:
            self.refuse("checksum", "is not that of the content: the file was changed after it was saved")
        return Cycle(np.array(numbers), certificate, Indexes(self.table("indexes").items(), why_not), self.entry("model", str),
                     self.table("parameters"), self.entry("structure", str))

    def entry(self, key: str, kind: type) -> Any:
        if key not in self.content:
            self.refuse(key, "is missing: not a saved limit cycle")
        value = self.content[key]
        if not isinstance(value, kind) or isinstance(value, bool):
            self.refuse(key, f"is {_short(value)}, wanted is {_KINDS[kind]}")
        return value

    def table(self, key: str) -> dict[str, float]:
        return {name: self.number(f"{key}.{name}", value) for name, value in self.entry(key, dict).items()}

    def number(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, f"is {_short(value)}, not a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse(key, "is not finite")
        return number

    def of_text(self, key: str, value: Any) -> float:
        if not isinstance(value, str) or len(value) > 64:
            self.refuse(key, f"is {_short(value)}, not a number in hexadecimal text")
        try:
            number = float.fromhex(value)
        except (ValueError, OverflowError):
            self.refuse(key, f"is {_short(value)}, not a number in hexadecimal text")
        if "0x" not in value and math.isfinite(number):
            self.refuse(key, f"is {_short(value)}, not a number in hexadecimal text")
        return self.number(key, number)

    def refuse(self, key: str, why: str) -> NoReturn:
        raise InputError(f"{self.path}: {key} {why}")

    def _no_number(self, text: str) -> NoReturn:
        raise InputError(f"{self.path}: {text} stands in the place of a number")


def _require_state_of_model(path: str, cycle: Cycle) -> None:
    """A cell's or loop's cycle is held against its model's ranges, charge and blood volume; a heart's scene is not here."""
    from ._models import Cell, Loop, _Model  # which need this file
    from ._core import models as names_of_cells

    model: _Model
    if cycle.model == "loop":
        model = Loop()
    elif cycle.model in names_of_cells():
        model = Cell(cycle.model)
    else:
        return
    if set(model.parameters) != set(cycle.parameters):
        return  # of another version: load() of the model itself says what differs
    try:
        model.parameters.update(cycle.parameters)
        model._core.require_state(cycle.state)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _checksum(content: dict[str, Any]) -> str:
    """Of all entries, whatever their order and spacing in the file."""
    return f"{zlib.crc32(json.dumps(content, sort_keys=True).encode()):08x}"


_KINDS = {int: "a whole number", str: "a text", list: "a list", dict: "a table of entries"}


def _short(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    return "missing" if value is None else repr(value)[:60]


class Sensitivities(Held):
    """Derivatives of outputs by parameters: `s["LV.EDV_mL", "elastance.LV.EA"]`, or arrays and tables of them."""

    def __init__(self, table: SensitivityTable, parameter_values: np.ndarray) -> None:
        self._table = table
        self.outputs: list[str] = table.outputs
        self.output_units: list[str] = table.output_units
        self.parameters: list[str] = table.parameters
        self.parameter_units: list[str] = table.parameter_units
        self.parameter_values = read_only(parameter_values)

    @property
    def values(self) -> np.ndarray:
        """Values of the outputs."""
        return self._table.values

    @property
    def derivatives(self) -> np.ndarray:
        """[output, parameter], in the output's unit per the parameter's."""
        return self._table.derivatives

    @property
    def state_derivatives(self) -> np.ndarray:
        """[state, parameter]: how the cycle's start moves (hearts: its circulation)."""
        return self._table.state_derivatives

    @property
    def elasticities(self) -> np.ndarray:
        """[output, parameter]: relative change of the output per relative change of the parameter; 0 where the
        output is 0."""
        values = np.where(self.values == 0, np.inf, self.values)
        return self.derivatives * self.parameter_values[None, :] / values[:, None]

    def _row(self, output: str) -> int:
        return _position(self.outputs, output, "output")

    def _column(self, parameter: str) -> int:
        return _position(self.parameters, parameter, "parameter")

    def __getitem__(self, key: tuple[str, str]) -> float:
        if not (isinstance(key, tuple) and len(key) == 2):
            raise InputError(f"sensitivities[{key!r}]: wanted is [output, parameter]")
        output, parameter = key
        return float(self.derivatives[self._row(output), self._column(parameter)])

    def rows(self, outputs: list[str]) -> np.ndarray:
        return self.derivatives[[self._row(o) for o in outputs], :]

    def columns(self, parameters: list[str]) -> list[int]:
        return [self._column(p) for p in parameters]

    def strongest(self, output: str, count: int = 5) -> list[tuple[str, float]]:
        """The parameters of largest elasticity for one output."""
        row = self.elasticities[self._row(output)]
        order = np.argsort(-np.abs(row))[:count]
        return [(self.parameters[k], float(row[k])) for k in order]

    def to_pandas(self) -> Any:
        import pandas

        return pandas.DataFrame(self.derivatives.copy(), index=self.outputs, columns=self.parameters)

    def to_xarray(self) -> Any:
        import xarray

        return xarray.DataArray(self.derivatives.copy(), dims=("output", "parameter"),
                                coords={"output": self.outputs, "parameter": self.parameters})

    def __repr__(self) -> str:
        return f"Sensitivities of {len(self.outputs)} outputs by {len(self.parameters)} parameters"


class Batch(Held):
    """Outputs of many samples. A sample without a result has NaN in its row and its reason in `reasons`; `notes` says of
    a good one why an output is missing ("no action potential: ...") or what it is like ("LV hardly ejects ...")."""

    def __init__(self, names: list[str], units: list[str], values: np.ndarray, states: np.ndarray,
                 reasons: list[str], parameters: list[str], samples: np.ndarray, notes: list[str] | None = None) -> None:
        self.names = names
        self.units = units
        self.values = read_only(values)
        self.states = read_only(states)
        self.reasons = reasons
        self.notes = [""] * len(reasons) if notes is None else notes
        self.parameters = parameters
        self.samples = read_only(samples)

    @property
    def good(self) -> np.ndarray:
        """Which samples have a result."""
        return np.array([not reason for reason in self.reasons], dtype=bool)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[:, _position(self.names, name, "output")]

    def __len__(self) -> int:
        return len(self.reasons)

    def __repr__(self) -> str:
        return f"Batch of {len(self)} samples, {int(self.good.sum())} good, {len(self.names)} outputs"

    def to_pandas(self) -> Any:
        import pandas

        frame = pandas.DataFrame(self.samples.copy(), columns=self.parameters).join(
            pandas.DataFrame(self.values.copy(), columns=self.names))
        frame["reason"] = self.reasons
        frame["note"] = self.notes
        return frame

    def to_xarray(self) -> Any:
        import xarray

        return xarray.Dataset(
            {n: ("sample", self.values[:, k], {"units": self.units[k]}) for k, n in enumerate(self.names)},
            coords={p: ("sample", self.samples[:, k]) for k, p in enumerate(self.parameters)})

    @staticmethod
    def join(parts: list[Batch]) -> Batch:
        first = parts[0]
        return Batch(first.names, first.units, np.concatenate([p.values for p in parts]),
                     np.concatenate([p.states for p in parts]), [r for p in parts for r in p.reasons],
                     first.parameters, np.concatenate([p.samples for p in parts]), [n for p in parts for n in p.notes])


def _position(names: list[str], name: str, kind: str) -> int:
    text(name, f"name of the {kind}")
    try:
        return names.index(name)
    except ValueError:
        import difflib

        close = difflib.get_close_matches(name, names, 1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise InputError(f"unknown {kind} '{name}'{hint} Known: {', '.join(names)}") from None
