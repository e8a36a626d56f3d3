"""Runs of 3D tissue, on one rank or several, and what their results are compared by."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import COMMAND, SCENES, Outcome

SCENE = SCENES / "left_ventricle_3d.toml"
THREE_D = Path(COMMAND).parent / "wiggers-3d"
# Open MPI refuses root and more ranks than cores unless told otherwise, and spins while it waits.
ENVIRONMENT = os.environ | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMP_NUM_THREADS": "1",
                            "OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}


def sets(**keys):
    return [word for key, value in keys.items() for word in ("--set", f"{key.replace('__', '.')}={value}")]


# Conduction fails on meshes as coarse as this one: a faster one carries the front from element to element.
QUICK = sets(heart__period_s=0.4, solver__dt_s=0.002, cells__atria__start="published", cells__ventricles__start="published",
             walls__LV__reference__recover="false", walls__LV__electrophysiology__tau_ms=0.1,
             walls__LV__electrophysiology__order=1, run__beats=1, run__checkpoint_every_ms=20)
for direction in ("fibre", "sheet", "normal"):
    QUICK += ["--set", f"walls.LV.electrophysiology.conductivity.{direction}_mm2_per_ms=0.8"]
COARSE = [*QUICK, "--set", "walls.LV.size_mm=12"]
for place in ("septum", "free_wall", "apex"):
    COARSE += ["--set", f"walls.LV.stimuli.{place}.radius_mm=12"]
# The ranks' sums differ by round-off alone where the solvers are not stopped early.
TIGHT = sets(walls__LV__mechanics__residual_tolerance="1e-9", walls__LV__mechanics__linear_tolerance="1e-6",
             walls__LV__electrophysiology__relative_tolerance="1e-12")
# A front that is well above failing does not amplify round-off.
for direction in ("fibre", "sheet", "normal"):
    TIGHT += ["--set", f"walls.LV.electrophysiology.conductivity.{direction}_mm2_per_ms=1.6"]

# A wall with its mesh from a file.
FROM_FILE = f"""
base = "{SCENES / 'whole_heart.toml'}"
[walls.LV]
kind = "tissue"
cells = "ventricles"
a_XB_kPa = 15e5
mesh = "lv.msh"
fields_every_ms = 0
[walls.LV.stimuli.apex]
z_mm = -66
radius_mm = 12
[walls.LV.materials.caps]
mu_Pa = 1e5
kappa_Pa = 5e5
[walls.LV.supports.base]
full_stiffness_Pa_per_m = 1e5
full_damping_Pa_s_per_m = 1e3
[run]
until = "beats"
"""


def words_for(ranks, *words):
    if ranks == 1:
        return [COMMAND, *map(str, words)]
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if launcher is None:
        pytest.skip("no mpirun")
    return [launcher, "-n", str(ranks), "--bind-to", "none", str(THREE_D), *map(str, words)]


def run(*words, ranks=1, cwd=None, timeout=400):
    return Outcome(subprocess.run(words_for(ranks, *words), cwd=cwd, capture_output=True, text=True, timeout=timeout,
                                  env=ENVIRONMENT))


def datasets(path):
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def frames(result):
    """Times and files of the fields beside a result; every file there is listed, once."""
    folder = Path(str(result).removesuffix(".h5") + ".LV.fields")
    listed = re.findall(r'timestep="([^"]+)" part="0" file="([^"]+)"', (folder / "index.pvd").read_text())
    assert sorted(p.name for p in folder.iterdir()) == sorted([file for _, file in listed] + ["index.pvd"])
    return [float(t) for t, _ in listed], [folder / file for _, file in listed]


TIMINGS = {"summary", "checkpoint/run", "provenance/wall_time", "provenance/host", "provenance/checksums", "solver/cost_cells", "solver/cost_heart"}


def same_bits(path, other):
    a, b = datasets(path), datasets(other)
    assert set(a) == set(b)
    for name in sorted(set(a) - TIMINGS):
        if not name.startswith("solver/walls"):  # costs, of the last part of the run alone
            assert np.array_equal(a[name], b[name]), name


def same_but_round_off(path, other, bound=1e-6, wall="LV"):
    a, b = datasets(path), datasets(other)
    compared = [name for name in a if name == "time" or name.startswith(("cavities/", "cells/", "valves/", "circulation/"))]
    assert {"cavities/LV/pressure", "cavities/LV/volume", f"cells/{wall}/membrane_potential", f"cells/{wall}/active_tension"} <= set(compared)
    for name in compared:
        assert a[name].shape == b[name].shape, name
        largest = np.abs(a[name]).max()
        assert np.abs(a[name] - b[name]).max() <= bound * largest, (name, np.abs(a[name] - b[name]).max() / largest)
