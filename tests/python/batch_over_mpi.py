"""A batch over MPI: mpirun -n 2 python -m mpi4py.futures batch_over_mpi.py"""

import numpy as np
import wiggers
from mpi4py.futures import MPIPoolExecutor

if __name__ == "__main__":
    loop = wiggers.Loop()
    samples = {"elastance.LV.EA": np.linspace(2, 4, 12)}
    here = loop.batch(samples, distance=1e-9)
    with MPIPoolExecutor() as pool:
        there = loop.batch(samples, executor=pool, chunk=3, distance=1e-9)
    assert np.allclose(here.values, there.values, rtol=1e-12, equal_nan=True)
    print(f"over MPI: {there}")
