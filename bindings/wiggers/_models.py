"""The models: cells, force, loop and heart behind one manner of use."""

from __future__ import annotations

import os
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Self

import numpy as np

from . import _core
from ._parameters import Parameters
from ._progress import Progress, showing
from ._results import Batch, Cycle, Sensitivities, StateMismatch, Trace

Samples = np.ndarray | Mapping[str, Any]


class _Model:
    """What every model has: parameters, and copies."""

    _core: Any

    @property
    def parameters(self) -> Parameters:
        """The parameters: a mapping, and attributes (`model.parameters.elastance.LV.EA = 3`)."""
        return Parameters(self._core)

    def copy(self) -> Self:
        """An independent model with the same numbers."""
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._core = self._core.copy()
        return other


class _Stated(_Model):
    """A model whose state has named components."""

    @property
    def states(self) -> list[str]:
        return self._core.state_names()

    @property
    def initial_state(self) -> np.ndarray:
        return self._core.initial_state()


class _Periodic(_Model, ABC):
    """What cells, loops and hearts have in common: a limit cycle that depends on parameters."""

    _kind: str
    _batch_options: dict[str, Any] = {}

    def to_limit_cycle(self, near: Cycle | np.ndarray | None = None, *, distance: float = 1e-6,
                       max_beats: int = 1000, method: str = "anderson", progress: Progress = None) -> Cycle:
        """The limit cycle, from the model's own start or from a cycle nearby.

        distance: scaled distance at which to stop. Raises NumericalFailure if there is no cycle of one beat
        (alternans, drift): the message has the certificate. progress(beats, distance) is called after each beat.
        """
        with showing(progress, f"{self._kind}: limit cycle") as shown:
            state, certificate = self._core.to_limit_cycle(_state(near), distance, max_beats, method, shown.beats)
        if not certificate.converged:
            raise _core.NumericalFailure(
                f"{self._kind}: no limit cycle of one beat: {certificate}. Look at single beats with run(), or choose "
                "another period.")
        return self._cycle(state, certificate)

    def _cycle(self, state: np.ndarray, certificate: _core.Certificate) -> Cycle:
        return Cycle(state, certificate, dict(self._core.indexes(state)), self._kind, dict(self.parameters),
                     self._structure())

    @abstractmethod
    def _structure(self) -> str:
        """What a state depends on beside the parameters."""

    def indexes(self, state: Cycle | np.ndarray) -> dict[str, float]:
        """Indexes of the beat from a state; what the beat does not have (a valve that never opens) is absent."""
        return dict(self._core.indexes(_state(state)))

    def load(self, path: str | os.PathLike[str]) -> Cycle:
        """Reads a saved cycle; refuses one of another model or of other parameters (StateMismatch)."""
        cycle = Cycle.load(path)
        if cycle.model != self._kind:
            raise StateMismatch(f"{path}: saved by {cycle.model}, this is {self._kind}")
        if cycle.structure != self._structure():
            raise StateMismatch(f"{path}: saved by {cycle.structure}, this is {self._structure()}")
        mine = dict(self.parameters)
        names = _different(mine, cycle.parameters)
        if names:
            first = names[0]
            raise StateMismatch(
                f"{path}: saved with other parameters: {first} = {cycle.parameters.get(first)} there, "
                f"{mine.get(first)} here" + (f", and {len(names) - 1} more" if len(names) > 1 else "") +
                ". Assign them first, or start to_limit_cycle(near=...) from Cycle.load(path).")
        try:
            self._core.require_state(cycle.state)
        except _core.InputError as error:
            raise _core.InputError(f"{path}: {error}") from None
        return cycle

    def batch(self, samples: Samples, names: Sequence[str] | None = None, *, near: Cycle | np.ndarray | None = None,
              distance: float = 1e-6, max_beats: int = 500, threads: int | None = None,
              executor: Executor | None = None, chunk: int | None = None, progress: Progress = None) -> Batch:
        """Limit cycles and indexes of many parameter samples.

        samples: a mapping name -> values, or an array [sample, parameter] with `names`. One bad sample does not stop
        the others: its row is NaN and `batch.reasons` says why. threads: of this process (default: all cores).
        executor: any concurrent.futures.Executor (process pool, dask, mpi4py.futures); each task solves `chunk`
        samples with one thread.
        """
        names, values = _samples(samples, names)
        unknown = [n for n in names if n not in self.parameters]
        if unknown:
            self.parameters.info(unknown[0])
        start = _state(near)
        if executor is not None:
            size = chunk or max(1, len(values) // 64)
            # Each task has a model of its own, also where the executor's threads share this process.
            parts = [executor.submit(_solve_part, self.copy(), names, values[k:k + size], start, distance, max_beats)
                     for k in range(0, max(1, len(values)), size)]
            with showing(progress, f"{self._kind}: batch", 1) as shown:
                done = []
                for part in parts:
                    done.append(part.result())
                    if shown.share:
                        shown.share(len(done) / len(parts))
            return Batch.join(done)
        with showing(progress, f"{self._kind}: batch", 1) as shown:
            rows = self._core.batch(names, values, start, distance, max_beats, threads or os.cpu_count() or 1,
                                    shown.share, **self._batch_options)
        return Batch(rows.names, rows.units, rows.values, rows.states, rows.reasons, names, values)

    def _on_cycle(self, cycle: Cycle | np.ndarray) -> np.ndarray:
        """The state of a cycle that is this model's; refuses one of other parameters."""
        if isinstance(cycle, Cycle):
            names = _different(dict(self.parameters), cycle.parameters)
            if names:
                raise StateMismatch(f"the cycle is of other parameters: {names[0]} = {cycle.parameters.get(names[0])} "
                                    f"there, {dict(self.parameters).get(names[0])} here. Solve to_limit_cycle(near=cycle)")
        state = _state(cycle)
        assert state is not None
        return state

    def _sensitivities(self, table: _core.SensitivityTable) -> Sensitivities:
        values = dict(self.parameters)
        return Sensitivities(table, np.array([values[name] for name in table.parameters]))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._kind}): {len(self.parameters)} parameters"


class _Refinable(_Periodic):
    """A model whose cycle Newton brings to rounding."""

    def refined(self, near: Cycle | np.ndarray) -> Cycle:
        """The cycle to rounding, by Newton with exact derivatives, from one nearby."""
        # A few beats on the refined cycle certify it.
        return self.to_limit_cycle(self._core.refined(_state(near)), distance=1e-9, max_beats=30)


class _Equations(_Stated, _Periodic):
    """A model that is a system of ordinary differential equations."""

    def rhs(self, t: float, y: np.ndarray) -> np.ndarray:
        """Rates of the states at time t: per ms and ms for cells (the pacing's stimulus included), per s and s for loops."""
        return self._core.rhs(t, y)

    def jacobian(self, t: float, y: np.ndarray) -> np.ndarray:
        """Exact derivatives of rhs: [rate, state]."""
        return self._core.jacobian(t, y)


class Cell(_Equations, _Refinable):
    """A paced cell: "crn", "ttp06-endo", "ttp06-mid", "ttp06-epi" (see wiggers.models()).

    integrator: "rush-larsen-2" or "rush-larsen" with steps of dt_ms; run() also takes adaptive ones. Parameters are
    the model's and those of the pacing: period_ms, stimulus_A_per_F, stimulus_ms, charge_offset_mV.
    """

    def __init__(self, model: str, *, parameters: str = "default", integrator: str = "rush-larsen-2",
                 dt_ms: float = 0.05, **changes: float) -> None:
        self._core = _core.CellModel(model, parameters)
        self._core.set_integrator(integrator, dt_ms)
        self._kind = model
        self._settings = (model, integrator, dt_ms)
        # Batches pace cells that share their pacing in SIMD lanes.
        self._batch_options = {"lanes": True}
        if changes:
            self.parameters.update(changes)

    @property
    def index_units(self) -> dict[str, str]:
        """Units of every index a cell can have."""
        return dict(zip(self._core.index_names(), self._core.index_units(), strict=True))

    @property
    def title(self) -> str:
        return self._core.title

    @property
    def source(self) -> str:
        return self._core.source

    def run(self, beats: int = 1, start: Cycle | np.ndarray | None = None, *, sample_ms: float = 1.0,
            integrator: str = "cvode", rtol: float = 1e-8, atol: float = 1e-10, progress: Progress = None) -> Trace:
        """Paces a number of beats; columns t_ms, the states, the stimulus. trace.end_state continues it."""
        with showing(progress, f"{self._kind}: beats") as shown:
            columns, end = self._core.run(self.initial_state if start is None else _state(start), _whole(beats, "beats"),
                                          sample_ms, integrator, rtol, atol, shown.beats)
        return Trace(columns, end)

    def sensitivities(self, cycle: Cycle | np.ndarray, *, progress: Progress = None) -> Sensitivities:
        """Derivatives of every index on the limit cycle by every parameter."""
        with showing(progress, f"{self._kind}: sensitivities", 1) as shown:
            return self._sensitivities(self._core.sensitivities(self._on_cycle(cycle), shown.share))

    def _structure(self) -> str:
        model, integrator, dt_ms = self._settings
        return f"{model}, {integrator} at {dt_ms:g} ms"

    def __reduce__(self) -> Any:
        return _rebuild, (Cell, self._settings[:1], {"integrator": self._settings[1], "dt_ms": self._settings[2]},
                          self.parameters.array)


class Loop(_Equations):
    """The closed circulation with elastance chambers; a parameter set by name (wiggers.loop_sets()), a loop file
    (its name ends with .toml) or such a file's text.

    integrator: "runge-kutta-4" (steps of dt_s that end at valve events: what indexes, sensitivities and batches
    use), "cvode" or "forward-euler".
    """

    def __init__(self, source: str | os.PathLike[str] = "wiggers-healthy-0d", *, integrator: str = "runge-kutta-4",
                 dt_s: float = 1e-3, rtol: float = 1e-9, atol: float = 1e-9,
                 changes: Mapping[str, float] | None = None) -> None:
        text = str(source)
        if text.endswith(".toml"):
            text = _read(text)
        if "\n" in text:
            self._core = _core.LoopModel.from_text(text, Path(str(source)).name if text != str(source) else "loop")
        else:
            self._core = _core.LoopModel(text)
        self._core.set_integrator(integrator, dt_s, rtol, atol)
        self._kind = "loop"
        self._settings = (text, {"integrator": integrator, "dt_s": dt_s, "rtol": rtol, "atol": atol})
        if changes:
            self.parameters.update(changes)

    def run(self, beats: int = 1, start: Cycle | np.ndarray | None = None, *, sample_s: float = 1e-3,
            progress: Progress = None) -> Trace:
        """A number of beats; columns t_s, states, chamber pressures, valve flows. p_VEN_SYS of the start is moved so that
        the blood volume is this loop's."""
        with showing(progress, "loop: beats") as shown:
            columns, end = self._core.run(self.initial_state if start is None else _state(start), _whole(beats, "beats"),
                                          sample_s, shown.beats)
        return Trace(columns, end)

    def sensitivities(self, cycle: Cycle | np.ndarray, *, progress: Progress = None) -> Sensitivities:
        """Derivatives of every index on the limit cycle by every parameter, total volume held unless it is the
        parameter."""
        del progress  # a few hundredths of a second
        return self._sensitivities(self._core.sensitivities(self._on_cycle(cycle)))

    def _structure(self) -> str:
        options = self._settings[1]
        return f"loop with {self._core.valve_law} valves, {options['integrator']} at {options['dt_s']:g} s"

    def __reduce__(self) -> Any:
        return _rebuild, (Loop, self._settings[:1], self._settings[1], self.parameters.array)


class Heart(_Refinable):
    """The reduced whole heart of a scene file (or a scene's text), cells on their limit cycles.

    set: overrides by key, {"walls.LV.activation_ms": 150}; accuracy: draft | standard | reference | founding.
    """

    def __init__(self, scene: str | os.PathLike[str], *, set: Mapping[str, Any] | None = None,  # noqa: A002
                 accuracy: str = "") -> None:
        text = str(scene)
        overrides = [f"{k}={v}" for k, v in (set or {}).items()]
        self._core = _core.HeartModel(text if "\n" in text else "", "" if "\n" in text else text, overrides, accuracy)
        self._kind = "heart"

    @property
    def text(self) -> str:
        """The scene with all defaults filled in and the present numbers."""
        return self._core.text

    @property
    def title(self) -> str:
        return self._core.title

    @property
    def body_surface_area_m2(self) -> float:
        return self._core.body_surface_area_m2

    def run(self, beats: int = 1, start: Cycle | np.ndarray | None = None, *, progress: Progress = None) -> Trace:
        """One beat from a state (default: the limit cycle); columns as of a result file's traces."""
        if beats != 1:
            raise _core.InputError(f"beats = {beats}: a heart's trace is of one beat; use the wiggers command for more")
        if start is None:
            start = self.to_limit_cycle(progress=progress)
        return Trace(self._core.run(_state(start)))

    def sensitivities(self, cycle: Cycle | np.ndarray, parameters: Sequence[str] = (), *,
                      progress: Progress = None) -> Sensitivities:
        """Derivatives of every index on the limit cycle by the named parameters (none named: by all)."""
        with showing(progress, "heart: sensitivities", 1) as shown:
            return self._sensitivities(self._core.sensitivities(self._on_cycle(cycle), list(parameters), shown.share))

    def _structure(self) -> str:
        # The scene but for its numbers, and those that are no parameters.
        skeleton = re.sub(r"= -?[0-9.][^\n]*", "= #", self.text)
        solver = self.text.partition("\n[solver]")[2]
        return f"heart {zlib.crc32((skeleton + solver).encode()):08x}"

    def __reduce__(self) -> Any:
        return _rebuild, (Heart, (self.text,), {}, self.parameters.array)


class Force(_Stated):
    """RDQ20 active force: parameter sets "human37", "rat-room", "fedele2023-ventricles", "fedele2023-atria"."""

    def __init__(self, parameters: str = "human37", **changes: float) -> None:
        self._core = _core.ForceModel(parameters)
        if changes:
            self.parameters.update(changes)

    def __reduce__(self) -> Any:
        return _rebuild, (Force, (), {}, self.parameters.array)

    def rhs(self, y: np.ndarray, calcium_uM: float, SL_um: float, dSL_dt_um_per_s: float = 0.0) -> np.ndarray:
        """Rates of the states (per s)."""
        return self._core.rhs(y, calcium_uM, SL_um, dSL_dt_um_per_s)

    def jacobian(self, y: np.ndarray, calcium_uM: float, SL_um: float, dSL_dt_um_per_s: float = 0.0) -> np.ndarray:
        """Exact derivatives of rhs: [rate, state]."""
        return self._core.jacobian(y, calcium_uM, SL_um, dSL_dt_um_per_s)

    def steady_state(self, calcium_uM: float, SL_um: float = 2.2) -> np.ndarray:
        return self._core.steady_state(calcium_uM, SL_um)

    def force_calcium(self, calcium_uM: np.ndarray, SL_um: float = 2.2) -> tuple[np.ndarray, np.ndarray]:
        """Steady tension (kPa) at each calcium, and its derivatives [calcium, parameter]."""
        return self._core.steady_tension(calcium_uM, SL_um)

    def run(self, t_s: np.ndarray, calcium_uM: np.ndarray, SL_um: np.ndarray | float = 2.2,
            start: np.ndarray | None = None) -> np.ndarray:
        """Tension (kPa) at the given times for calcium and length given there (straight lines between)."""
        length = np.broadcast_to(np.asarray(SL_um, dtype=float), np.shape(t_s))
        if start is None:
            start = self.steady_state(float(np.asarray(calcium_uM)[0]), float(length[0]))
        tension, self.end_state = self._core.run(start, t_s, calcium_uM, np.ascontiguousarray(length))
        return tension


def _state(source: Cycle | np.ndarray | None) -> np.ndarray | None:
    if source is None:
        return None
    if isinstance(source, Cycle):
        return source.state
    array = np.asarray(source)
    if array.dtype.kind not in "fiu":
        raise _core.InputError(f"state has dtype {array.dtype}, wanted are real numbers")
    return np.ascontiguousarray(array, dtype=float)


def _different(mine: Mapping[str, float], theirs: Mapping[str, float]) -> list[str]:
    """Names whose values differ by more than rounding (a blood volume is a sum)."""
    return [n for n in {**mine, **theirs}
            if n not in mine or n not in theirs or abs(mine[n] - theirs[n]) > 1e-12 * abs(mine[n])]


def _whole(value: int, name: str) -> int:
    if int(value) != value or value < 1:
        raise _core.InputError(f"{name} = {value} is not a whole number of at least 1")
    return int(value)


def _samples(samples: Samples, names: Sequence[str] | None) -> tuple[list[str], np.ndarray]:
    if isinstance(samples, Mapping):
        if names is not None:
            raise _core.InputError("names: not with a mapping, which has its own")
        columns = [np.atleast_1d(_numbers(v, n)) for n, v in samples.items()]
        lengths = {len(c) for c in columns if c.ndim == 1}
        if any(c.ndim != 1 for c in columns) or len(lengths - {1}) > 1:
            shapes = ", ".join(f"{n}: {np.shape(v)}" for n, v in samples.items())
            raise _core.InputError(f"samples must be one-dimensional and of one length, they are {shapes}")
        n = max(lengths, default=0)
        values = np.column_stack([np.broadcast_to(c, n) for c in columns]) if columns else np.empty((0, 0))
        return list(samples), np.ascontiguousarray(values)
    values = np.ascontiguousarray(_numbers(samples, "samples"))
    if names is None:
        raise _core.InputError("names is missing: an array of samples needs the parameter of each column")
    if values.ndim != 2 or values.shape[1] != len(names):
        raise _core.InputError(f"samples has shape {values.shape}, wanted is (samples, {len(names)})")
    return list(names), values


def _numbers(values: Any, name: str) -> np.ndarray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise _core.InputError(f"{name}: {error}") from None


def _solve_part(model: _Periodic, names: list[str], values: np.ndarray, start: np.ndarray | None, distance: float,
                max_beats: int) -> Batch:
    return model.batch(values, names, near=start, distance=distance, max_beats=max_beats, threads=1)


def _rebuild(kind: Any, arguments: tuple[Any, ...], options: dict[str, Any], values: np.ndarray) -> Any:
    model = kind(*arguments, **options)
    model.parameters._assign(values)
    return model


def _read(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError as error:
        raise _core.ResourceError(f"{path}: {error.strerror}") from None
