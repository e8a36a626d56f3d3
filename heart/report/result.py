"""One result file of `wiggers run`, read into arrays by name."""

import json
import tomllib
from pathlib import Path

import h5py
import numpy as np

CHAMBERS = ("LA", "LV", "RA", "RV")
VALVES = ("MV", "AV", "TV", "PV")


WALL_CHAMBERS = {"ventricles": ("LV", "RV"), "heart": ("LV", "RV", "LA", "RA")}  # of walls around several


class ResultFile(h5py.File):
    """A file whose missing entries are told by name."""

    def __init__(self, path):
        super().__init__(path, "r")

    def __getitem__(self, name):
        try:
            return super().__getitem__(name)
        except KeyError:
            raise KeyError(f"entry {name}") from None


class Result:
    span = "the beat in the result"  # that its fields should cover

    def __init__(self, path):
        self.path = Path(path)
        with ResultFile(path) as file:
            self.time = file["time"][:]
            self.volume = {c: file[f"cavities/{c}/volume"][:] for c in CHAMBERS}
            self.pressure = {c: file[f"cavities/{c}/pressure"][:] for c in CHAMBERS}
            self.flow = {v: file[f"valves/{v}/flow"][:] for v in VALVES}
            self.ends = {v: [file[f"network/{v}/{end}"][()].decode() for end in ("from", "to")] for v in VALVES}
            self.circulation = {name: data[:] for name, data in file["circulation"].items()}
            self.cells, self.cell_units = {}, {}
            for chamber, group in file.get("cells", {}).items():
                self.cells[chamber] = {name: data[:] for name, data in group.items()}
                self.cell_units[chamber] = {name: _text(data.attrs.get("unit", b"")) for name, data in group.items()}
            self.phases = {
                side: {name: tuple(data[:]) for name, data in group.items()}
                for side, group in file.get("phases", {}).items()
            }
            self.summary = json.loads(file["summary"][()].decode())
            self.ranges = {
                name: {key: float(value[()]) for key, value in group.items()}
                | {"unit": _text(group["mean"].attrs["unit"])}
                for name, group in file.get("reference_ranges", {}).items()
            }
            solver = file.get("solver", {})
            self.solver = {name: float(data[()]) for name, data in solver.items() if name != "walls" and data.shape == ()}
            self.walls = wall_figures(file)
            # Complete beats so far; the result holds the last of them, or the part of the next that was run.
            self.beats = int(file["checkpoint/run"][0]) if "checkpoint/run" in file else 1
            self.scene, self.title, self.version, self.status = provenance(file)
            self.body_surface_area = _body_surface_area(self.scene)
        self.period = float(self.time[-1])
        of_scene = float(tomllib.loads(self.scene).get("heart", {}).get("period_s", self.period))
        self.is_whole_beat = self.period > (1 - 1e-6) * of_scene
        if not self.is_whole_beat:
            self.period = of_scene
            self.span = "the part of the beat in the result"
        self.has_indexes = "indexes" in self.summary

    @property
    def start(self):
        """Time (s) since the start of the run at the first row."""
        return (self.beats - 1 if self.is_whole_beat else self.beats) * self.period

    @property
    def end_ms(self):
        """Time within the beat at the last row."""
        return f"{1e3 * self.time[-1]:g} ms"

    def what_is_missing(self):
        """Why there are no indexes; None where there are."""
        if self.has_indexes:
            return None
        if self.is_whole_beat:
            return f"This file was saved within beat {self.beats + 1}: it holds the last whole beat, but no indexes."
        if self.beats == 0:
            where = f"its first beat, at {self.end_ms}"
        else:
            where = f"beat {self.beats + 1}, at {1e3 * (self.start + self.time[-1]):g} ms ({self.end_ms} into the beat)"
        shown = "the pictures show the part of the beat that was run, and there are no indexes"
        return f"This run was ended within {where}: {shown}."

    def tissue_settings(self, wall):
        """The table of a wall in the scene."""
        return tomllib.loads(self.scene).get("walls", {}).get(wall, {})

    def tissue_names(self):
        """Walls of 3D tissue. A run that was stopped has no figures of them yet, but its scene names them."""
        in_scene = tomllib.loads(self.scene).get("walls", {})
        return sorted({name for name, wall in in_scene.items() if wall.get("kind") == "tissue"} | set(self.walls))

    def open_spans(self, valve):
        """Spans of time in which a valve is open, from its pressure difference (openings above 1.5 ms)."""
        upstream, downstream = (
            self.pressure[node] if node in self.pressure else self.circulation[f"p_{node}"] for node in self.ends[valve]
        )
        is_open = upstream > downstream
        edges = np.flatnonzero(np.diff(is_open.astype(int)))
        bounds = np.concatenate(([0], edges + 1, [len(is_open)]))
        spans = []
        for begin, end in zip(bounds[:-1], bounds[1:]):
            last = min(end, len(self.time) - 1)
            if is_open[begin] and self.time[last] - self.time[begin] > 1.5e-3:
                spans.append((self.time[begin], self.time[last]))
        return spans

    def phase_at(self, side):
        """Name of the phase at every sample of one side ('left' or 'right'); None where there are no phases."""
        names = np.full(len(self.time), None, dtype=object)
        for name, (begin, end) in self.phases.get(side, {}).items():
            length = (end - begin) % self.period
            names[(self.time - begin) % self.period < length] = name
        return names

    def _cells_by_chamber(self):
        """Cell traces of each chamber, if they have any; of TriSeg ventricles the free walls stand for theirs."""
        for name, data in self.cells.items():
            if name in CHAMBERS:
                yield name, data
                continue
            if name != "ventricles":
                continue  # tissue of several chambers has no trace for each
            for chamber, wall in (("LV", "left_"), ("RV", "right_")):
                yield chamber, {key[len(wall):]: values for key, values in data.items() if key.startswith(wall)}

    def ecg_surrogate(self):
        """A surrogate of the surface ECG from the activation of the chambers; None without activation.

        None too where chambers in one body of tissue have no traces of their own: without them the shape means nothing.

        Each chamber contributes |V(t) - V(t - tau)|, the potential difference across a chamber that a wave
        crosses in tau; repolarisation runs the other way, so both deflections are upright. Elastance chambers
        contribute their activation in the place of V. Shape only: no torso, arbitrary amplitude.
        """
        crossing = {"RA": 0.045, "LA": 0.045, "LV": 0.040, "RV": 0.040}
        weight = {"RA": 0.14, "LA": 0.12, "LV": 1.0, "RV": -0.25}
        total = np.zeros_like(self.time)
        without_own = any(name in WALL_CHAMBERS and "membrane_potential" in data for name, data in self.cells.items())
        if len(self.time) < 2 or without_own:
            return None
        found = False
        for chamber, data in self._cells_by_chamber():
            if "membrane_potential" in data:
                wave, scale = data["membrane_potential"], 1 / 100
            elif "activation" in data:
                wave, scale = data["activation"], 0.5
            else:
                continue
            found = True
            lag = crossing[chamber]
            before = self.time - lag
            earlier = np.interp(before % self.period if self.is_whole_beat else before, self.time, wave)
            difference = np.abs(wave - earlier) * scale
            # A smooth lead field: the wave neither starts nor ends at one instant.
            width = max(1, int(round(1.3 * lag / (self.time[1] - self.time[0]))))
            kernel = np.hanning(width + 2)
            if self.is_whole_beat:
                difference = np.convolve(np.tile(difference[:-1], 3), kernel / kernel.sum(), "same")
                n = len(self.time) - 1
                difference = np.append(difference[n : 2 * n], difference[n])
            else:
                padded = np.pad(difference, len(kernel), mode="edge")
                difference = np.convolve(padded, kernel / kernel.sum(), "same")[len(kernel) : -len(kernel)]
            total += weight[chamber] * difference
        return total if found else None


def wall_figures(file):
    """What walls of 3D tissue cost: {wall: {figure: value, unit and meaning}}."""
    return {
        wall: {
            name: {"value": float(data[()]), "unit": _text(data.attrs["unit"]), "meaning": _text(data.attrs["meaning"])}
            for name, data in group.items()
        }
        for wall, group in file.get("solver", {}).get("walls", {}).items()
    }


def provenance(file):
    """Scene, title, version of the program and status of the run, as texts."""
    return [_text(file[f"provenance/{name}"][()]) for name in ("scene", "title", "version", "status")]


def _text(value):
    return value.decode() if isinstance(value, bytes) else str(value)


def _body_surface_area(scene):
    for line in scene.splitlines():
        if line.startswith("body_surface_area_m2"):
            return float(line.split("=")[1])
    return None
