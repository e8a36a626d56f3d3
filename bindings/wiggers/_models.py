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
from ._checks import NotGiven, not_given, read_only, real, reals, shown, text, texts, whole
from ._parameters import Parameters
from ._progress import Progress, showing
from ._results import Batch, Cycle, Indexes, Sensitivities, StateMismatch, Trace
from ._samples import samples_of

# Arrays with names beside them, mappings, data frames, structured arrays, lists of mappings.
Samples = Any
State = Cycle | np.ndarray


class _Model(ABC):
    """What every model has: parameters, and copies."""

    _core: Any

    @property
    def parameters(self) -> Parameters:
        """The parameters: a mapping, and attributes (`model.parameters.elastance.LV.EA = 3`)."""
        return Parameters(self)

    def copy(self) -> Self:
        """An independent model with the same numbers."""
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._core = self._core.copy()
        return other

    @abstractmethod
    def _made_by(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Arguments that make this model, but for its parameters."""

    def __reduce__(self) -> Any:
        arguments, options = self._made_by()
        return _rebuild, (type(self), arguments, options, self.parameters.array)


class _Stated(_Model):
    """A model whose state has named components."""

    @property
    def states(self) -> list[str]:
        return self._core.state_names()

    @property
    def initial_state(self) -> np.ndarray:
        return self._core.initial_state()


class _Periodic(_Model):
    """What cells, loops and hearts have in common: a limit cycle that depends on parameters."""

    _kind: str
    _batch_options: dict[str, Any] = {}

    def to_limit_cycle(self, near: State | NotGiven = not_given, *, distance: float = 1e-6,
                       max_beats: int = 1000, method: str = "anderson", progress: Progress = None) -> Cycle:
        """The limit cycle, from the model's own start (near left out) or from a cycle nearby.

        distance: scaled distance at which to stop. Raises NumericalFailure if there is no cycle of one beat
        (alternans, drift) or no heart or cell can be in it: the message says what was seen. progress(beats,
        distance) is called after each beat.
        """
        with showing(progress, f"{self._kind}: limit cycle") as bar:
            state, certificate = self._core.to_limit_cycle(
                None if near is not_given else _state(near, "near"), real(distance, "distance"),
                _beats_allowed(max_beats),
                text(method, "method"), bar.beats)
        if not certificate.converged:
            raise _core.NumericalFailure(f"{self._kind}: {certificate.failure}")
        return self._cycle(state, certificate)

    def _cycle(self, state: np.ndarray, certificate: _core.Certificate) -> Cycle:
        return Cycle(state, certificate, self._indexes(state), self._kind, dict(self.parameters), self._structure())

    def _indexes(self, state: np.ndarray) -> Indexes:
        return Indexes(self._core.indexes(state))

    @abstractmethod
    def _structure(self) -> str:
        """What a state depends on beside the parameters."""

    def indexes(self, state: State) -> Indexes:
        """Indexes of the beat from a state; what the beat does not have (a valve that never opens, the duration of what is
        no action potential) is absent. A cycle of other parameters is refused: its state begins no cycle here."""
        return self._indexes(self._on_cycle(state) if isinstance(state, Cycle) else _state(state, "state"))

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

    def batch(self, samples: Samples, names: Sequence[str] | None = None, *, near: State | NotGiven = not_given,
              distance: float = 1e-6, max_beats: int = 500, threads: int | None = None,
              executor: Executor | None = None, chunk: int | None = None, progress: Progress = None) -> Batch:
        """Limit cycles and indexes of many parameter samples.

        samples: what has columns named by parameters (a mapping name -> values, a data frame, a structured array, a
        list of mappings), or an array [sample, parameter] with `names`; names also choose among a frame's columns.
        One bad sample does not stop the others: its row is NaN and `batch.reasons` says why. threads: of this
        process (default: all cores). executor: any concurrent.futures.Executor (process pool, dask,
        mpi4py.futures); each task solves `chunk` samples with one thread.
        """
        names, values = samples_of(samples, names)
        unknown = [n for n in names if n not in self.parameters]
        if unknown:
            self.parameters.info(unknown[0])
        options: dict[str, Any] = {"distance": real(distance, "distance"), "max_beats": _beats_allowed(max_beats)}
        if near is not not_given:
            options["near"] = _state(near, "near")
        workers = (os.cpu_count() or 1) if threads is None else whole(threads, "threads", 1, 1024)
        if executor is not None:
            if not hasattr(executor, "submit"):
                raise _core.InputError(f"executor = {shown(executor)} has no submit(): wanted is an Executor of "
                                       "concurrent.futures or its like")
            size = max(1, len(values) // 64) if chunk is None else whole(chunk, "chunk")
            # Each task has a model of its own, also where the executor's threads share this process.
            parts = [executor.submit(_solve_part, self.copy(), names, values[k:k + size], options)
                     for k in range(0, max(1, len(values)), size)]
            with showing(progress, f"{self._kind}: batch", 1) as bar:
                done = []
                for part in parts:
                    done.append(part.result())
                    if bar.share:
                        bar.share(len(done) / len(parts))
            return Batch.join(done)
        with showing(progress, f"{self._kind}: batch", 1) as bar:
            rows = self._core.batch(names, values, options.get("near"), options["distance"], options["max_beats"],
                                    workers, bar.share, **self._batch_options)
        return Batch(rows.names, rows.units, rows.values, rows.states, rows.reasons, names, values, rows.notes)

    def _on_cycle(self, cycle: State) -> np.ndarray:
        """The state of a cycle that is this model's; refuses one of other parameters."""
        if isinstance(cycle, Cycle):
            names = _different(dict(self.parameters), cycle.parameters)
            if names:
                raise StateMismatch(f"the cycle is of other parameters: {names[0]} = {cycle.parameters.get(names[0])} "
                                    f"there, {dict(self.parameters).get(names[0])} here. Solve to_limit_cycle(near=cycle)")
        return _state(cycle, "cycle")

    def _sensitivities(self, table: _core.SensitivityTable) -> Sensitivities:
        values = dict(self.parameters)
        return Sensitivities(table, np.array([values[name] for name in table.parameters]))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._kind}): {len(self.parameters)} parameters"


class _Refinable(_Periodic):
    """A model whose cycle Newton brings to rounding."""

    def refined(self, near: State) -> Cycle:
        """The cycle to rounding, by Newton with exact derivatives, from one nearby."""
        # A few beats on the refined cycle certify it.
        return self.to_limit_cycle(self._core.refined(_state(near, "near")), distance=1e-9, max_beats=30)


class _Equations(_Stated, _Periodic):
    """A model that is a system of ordinary differential equations."""

    def rhs(self, t: float, y: np.ndarray) -> np.ndarray:
        """Rates of the states at time t: per ms and ms for cells (the pacing's stimulus included), per s and s for loops."""
        return self._core.rhs(_time(t), reals(y, "y"))

    def jacobian(self, t: float, y: np.ndarray) -> np.ndarray:
        """Exact derivatives of rhs: [rate, state]."""
        return self._core.jacobian(_time(t), reals(y, "y"))


class Cell(_Equations, _Refinable):
    """A paced cell: "crn", "ttp06-endo", "ttp06-mid", "ttp06-epi" (see wiggers.models()).

    integrator: "rush-larsen-2" or "rush-larsen" with steps of dt_ms: what has exact derivatives. `wiggers cell` paces by
    cvode unless told otherwise; with --integrator rush-larsen-2 --dt-ms 0.05 it gives the digits of this class's default.
    run() also takes adaptive ones. Parameters are the model's and those of the pacing: period_ms, stimulus_A_per_F, stimulus_ms, charge_offset_mV.
    """

    def __init__(self, model: str, *, parameters: str = "default", integrator: str = "rush-larsen-2",
                 dt_ms: float = 0.05, **changes: float) -> None:
        self._core = _core.CellModel(text(model, "model"), text(parameters, "parameters"))
        dt_ms = real(dt_ms, "dt_ms")
        self._core.set_integrator(text(integrator, "integrator"), dt_ms)
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

    def _indexes(self, state: np.ndarray) -> Indexes:
        return Indexes(*self._core.indexes(state))

    def __repr__(self) -> str:
        return f"Cell({self._structure()}): {len(self.parameters)} parameters"

    def run(self, beats: int = 1, start: State | NotGiven = not_given, *, sample_ms: float = 1.0,
            integrator: str = "cvode", rtol: float = 1e-8, atol: float = 1e-10, progress: Progress = None) -> Trace:
        """Paces a number of beats from a state (left out: the initial one); columns t_ms, the states, the stimulus.
        trace.end_state continues it."""
        first = self.initial_state if start is not_given else _state(start, "start")
        with showing(progress, f"{self._kind}: beats") as bar:
            columns, end = self._core.run(first, whole(beats, "beats", 1, MOST_BEATS), real(sample_ms, "sample_ms"),
                                          text(integrator, "integrator"), real(rtol, "rtol"), real(atol, "atol"),
                                          bar.beats)
        return Trace(columns, end)

    def sensitivities(self, cycle: State, *, progress: Progress = None) -> Sensitivities:
        """Derivatives of every index on the limit cycle by every parameter."""
        with showing(progress, f"{self._kind}: sensitivities", 1) as bar:
            return self._sensitivities(self._core.sensitivities(self._on_cycle(cycle), bar.share))

    def _structure(self) -> str:
        model, integrator, dt_ms = self._settings
        return f"{model}, {integrator} at {dt_ms:g} ms"

    def _made_by(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        model, integrator, dt_ms = self._settings
        return (model,), {"integrator": integrator, "dt_ms": dt_ms}


class Loop(_Equations):
    """The closed circulation with elastance chambers; a parameter set by name (wiggers.loop_sets()), a loop file
    (its name ends with .toml) or such a file's text.

    integrator: "runge-kutta-4" (steps of dt_s that end at valve events: what indexes, sensitivities and batches
    use), "cvode" or "forward-euler".
    """

    def __init__(self, source: str | os.PathLike[str] = "wiggers-healthy-0d", *, integrator: str = "runge-kutta-4",
                 dt_s: float = 1e-3, rtol: float = 1e-9, atol: float = 1e-9,
                 changes: Mapping[str, float] | None = None) -> None:
        given = _path_or_text(source, "source")
        content = _read(given) if given.endswith(".toml") else given
        if "\n" in content:
            self._core = _core.LoopModel.from_text(content, Path(given).name if content != given else "loop")
        else:
            self._core = _core.LoopModel(content)
        numbers = {"dt_s": real(dt_s, "dt_s"), "rtol": real(rtol, "rtol"), "atol": real(atol, "atol")}
        self._core.set_integrator(text(integrator, "integrator"), **numbers)
        self._kind = "loop"
        self._settings = (content, {"integrator": integrator, **numbers})
        if changes:
            self.parameters.update(changes)

    def run(self, beats: int = 1, start: State | NotGiven = not_given, *, sample_s: float = 1e-3,
            progress: Progress = None) -> Trace:
        """A number of beats from a state (left out: the initial one); columns t_s, states, chamber pressures, flows of
        valves and shunts. p_VEN_SYS of the start is moved so that the blood volume is this loop's. trace.end_state continues it."""
        first = self.initial_state if start is not_given else _state(start, "start")
        with showing(progress, "loop: beats") as bar:
            columns, end = self._core.run(first, whole(beats, "beats", 1, MOST_BEATS), real(sample_s, "sample_s"),
                                          bar.beats)
        return Trace(columns, end)

    def sensitivities(self, cycle: State, *, progress: Progress = None) -> Sensitivities:
        """Derivatives of every index on the limit cycle by every parameter, total volume held unless it is the
        parameter."""
        del progress  # a few hundredths of a second
        return self._sensitivities(self._core.sensitivities(self._on_cycle(cycle)))

    def _structure(self) -> str:
        options = self._settings[1]
        return f"loop with {self._core.valve_law} valves, {options['integrator']} at {options['dt_s']:g} s"

    def _made_by(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return self._settings[:1], self._settings[1]

    def __reduce__(self) -> Any:
        return _rebuild_loop, (type(self), *self._made_by(), self.parameters.array, self.initial_state)


class Heart(_Refinable):
    """The reduced whole heart of a scene file (or a scene's text), cells on their limit cycles.

    set: overrides by key, {"walls.LV.activation_ms": 150}; accuracy: draft | standard | reference | founding.
    """

    def __init__(self, scene: str | os.PathLike[str], *, set: Mapping[str, Any] | None = None,  # noqa: A002
                 accuracy: str = "") -> None:
        given = _path_or_text(scene, "scene")
        overrides = [f"{key}={_override(key, value)}" for key, value in (set or {}).items()]
        inline, path = (given, "") if "\n" in given else ("", given)
        self._core = _core.HeartModel(inline, path, overrides, text(accuracy, "accuracy"))
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

    def run(self, beats: int = 1, start: State | NotGiven = not_given, *, progress: Progress = None) -> Trace:
        """A number of beats from a state (left out: the limit cycle, which is solved first); columns as of a result
        file's traces. trace.end_state continues it, bit by bit as more beats here would."""
        beats = whole(beats, "beats", 1, MOST_BEATS)
        first = self.to_limit_cycle(progress=progress).state if start is not_given else _state(start, "start")
        with showing(progress, "heart: beats") as bar:
            columns, end = self._core.run(first, beats, bar.beats)
        return Trace(columns, end)

    def sensitivities(self, cycle: State, parameters: Sequence[str] = (), *,
                      progress: Progress = None) -> Sensitivities:
        """Derivatives of every index on the limit cycle by the named parameters (none named: by all)."""
        with showing(progress, "heart: sensitivities", 1) as bar:
            return self._sensitivities(
                self._core.sensitivities(self._on_cycle(cycle), texts(parameters, "parameters"), bar.share))

    def _structure(self) -> str:
        # The scene but for its numbers, and those that are no parameters.
        skeleton = re.sub(r"= -?[0-9.][^\n]*", "= #", self.text)
        solver = self.text.partition("\n[solver]")[2]
        return f"heart {zlib.crc32((skeleton + solver).encode()):08x}"

    def _made_by(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (self.text,), {}


class Force(_Stated):
    """Active force of a muscle: model "rdq20" (parameter sets "human37", "rat-room", "fedele2023-ventricles",
    "fedele2023-atria") or "land2017" ("intact", "skinned", "margara2021"). Sets left out are the first."""

    end_state: np.ndarray | None = None
    """The state at the end of the last run(), to go on from; None before the first."""

    def __init__(self, parameters: str = "", *, model: str = "rdq20", **changes: float) -> None:
        self._core = _core.ForceModel(text(parameters, "parameters"), text(model, "model"))
        if changes:
            self.parameters.update(changes)

    def _made_by(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        return (), {"model": self._core.name}

    def __reduce__(self) -> Any:
        return (*super().__reduce__(), self.end_state)

    def __setstate__(self, end_state: np.ndarray) -> None:
        self.end_state = read_only(end_state)

    def rhs(self, y: np.ndarray, calcium_uM: float, SL_um: float, dSL_dt_um_per_s: float = 0.0) -> np.ndarray:
        """Rates of the states (per s)."""
        return self._core.rhs(reals(y, "y"), *self._inputs(calcium_uM, SL_um, dSL_dt_um_per_s))

    def jacobian(self, y: np.ndarray, calcium_uM: float, SL_um: float, dSL_dt_um_per_s: float = 0.0) -> np.ndarray:
        """Exact derivatives of rhs: [rate, state]."""
        return self._core.jacobian(reals(y, "y"), *self._inputs(calcium_uM, SL_um, dSL_dt_um_per_s))

    def steady_state(self, calcium_uM: float, SL_um: float = 2.2) -> np.ndarray:
        return self._core.steady_state(real(calcium_uM, "calcium_uM"), real(SL_um, "SL_um"))

    def force_calcium(self, calcium_uM: np.ndarray, SL_um: float = 2.2) -> tuple[np.ndarray, np.ndarray]:
        """Steady tension (kPa) at each calcium, and its derivatives [calcium, parameter]."""
        levels = reals(calcium_uM, "calcium_uM")
        if levels.ndim != 1 or levels.size == 0:
            raise _core.InputError(f"calcium_uM has shape {levels.shape}, wanted is one or more levels in a row")
        return self._core.steady_tension(levels, real(SL_um, "SL_um"))

    def run(self, t_s: np.ndarray, calcium_uM: np.ndarray, SL_um: np.ndarray | float = 2.2,
            start: np.ndarray | NotGiven = not_given) -> np.ndarray:
        """Tension (kPa) at the given times for calcium and length given there (straight lines between), from a state
        (left out: the steady one of the first calcium and length). `end_state` then continues it."""
        t = reals(t_s, "t_s")
        if t.ndim != 1 or t.size < 2:
            raise _core.InputError(f"t_s has shape {t.shape}, wanted are at least two samples in a row")
        calcium, length = reals(calcium_uM, "calcium_uM"), reals(SL_um, "SL_um")
        if calcium.shape != t.shape:
            raise _core.InputError(f"calcium_uM has shape {calcium.shape}, t_s has {t.shape}")
        if length.ndim != 0 and length.shape != t.shape:
            raise _core.InputError(f"SL_um has shape {length.shape}, wanted is one length or {t.shape}, as t_s has")
        length = np.ascontiguousarray(np.broadcast_to(length, t.shape))
        first = self.steady_state(calcium[0], length[0]) if start is not_given else _state(start, "start")
        tension, end = self._core.run(first, t, calcium, length)
        self.end_state = read_only(end)
        return tension

    @staticmethod
    def _inputs(calcium_uM: float, SL_um: float, dSL_dt_um_per_s: float) -> tuple[float, float, float]:
        return real(calcium_uM, "calcium_uM"), real(SL_um, "SL_um"), real(dSL_dt_um_per_s, "dSL_dt_um_per_s")


MOST_BEATS = 1_000_000


def _state(source: Any, what: str) -> np.ndarray:
    """The numbers of a state; its length and values are the model's to check."""
    if source is None:
        raise _core.InputError(f"{what} = None is no state: give a cycle or an array, or leave {what} out")
    if isinstance(source, Cycle):
        return reals(source.state, f"state of {what}")
    if isinstance(source, Trace):
        raise _core.InputError(f"{what} is a Trace: give its end_state to go on from its end")
    return reals(source, what)


def _beats_allowed(max_beats: int) -> int:
    return whole(max_beats, "max_beats", 3, MOST_BEATS)


def _time(t: float) -> float:
    time = real(t, "t")
    if not np.isfinite(time):
        raise _core.InputError(f"t = {time} is not finite")
    return time


def _path_or_text(source: Any, what: str) -> str:
    if not isinstance(source, str | os.PathLike):
        raise _core.InputError(f"{what} = {shown(source)} is of type {type(source).__name__}, wanted is a path or text")
    return os.fsdecode(source)


def _override(key: Any, value: Any) -> str:
    """A scene's value as the scene's text has it."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple):
        return f"[{', '.join(_override(key, v) for v in value)}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(real(value, text(key, "key of set")))


def _different(mine: Mapping[str, float], theirs: Mapping[str, float]) -> list[str]:
    """Names whose values differ by more than rounding (a blood volume is a sum)."""
    return [n for n in {**mine, **theirs}
            if n not in mine or n not in theirs or abs(mine[n] - theirs[n]) > 1e-12 * abs(mine[n])]


def _solve_part(model: _Periodic, names: list[str], values: np.ndarray, options: dict[str, Any]) -> Batch:
    return model.batch(values, names, threads=1, **options)


def _rebuild(kind: Any, arguments: tuple[Any, ...], options: dict[str, Any], values: np.ndarray) -> Any:
    model = kind(*arguments, **options)
    model.parameters._assign(values)
    return model


def _rebuild_loop(kind: Any, arguments: tuple[Any, ...], options: dict[str, Any], values: np.ndarray,
                  initial: np.ndarray) -> Any:
    loop = kind(*arguments, **options)
    loop._core.take(values, initial)
    return loop


def _read(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError as error:
        raise _core.ResourceError(f"{path}: {error.strerror}") from None
