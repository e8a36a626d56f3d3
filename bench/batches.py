"""Throughput of batches: PYTHONPATH=build/python .venv/bin/python bench/batches.py"""

import os
import time

import numpy as np
import wiggers


def rate(label, count, run):
    begun = time.perf_counter()
    result = run()
    seconds = time.perf_counter() - begun
    good = count if result is None else int(result.good.sum())
    print(f"{label:44} {count / seconds:9.1f} a second   ({good} of {count} good)")


def main():
    threads = sorted({1, 2, os.cpu_count() or 1})
    random = np.random.default_rng(1)

    loop = wiggers.Loop()
    n = 400
    samples = {name: loop.parameters[name] * np.exp(random.uniform(-0.2, 0.2, n))
               for name in ("elastance.LV.EA", "circuit.SYS.R_AR", "circuit.SYS.C_AR", "initial.total_volume")}

    def one_by_one():
        for k in range(100):
            model = loop.copy()
            model.parameters.update({name: values[k] for name, values in samples.items()})
            model.to_limit_cycle()

    rate("loop, one by one", 100, one_by_one)
    for t in threads:
        rate(f"loop, batch, threads {t}", n, lambda t=t: loop.batch(samples, threads=t))

    cell = wiggers.Cell("ttp06-endo")
    cycle = cell.to_limit_cycle()
    n = 32
    samples = {name: cell.parameters[name] * np.exp(random.uniform(-0.2, 0.2, n)) for name in ("g_Kr", "g_CaL")}
    for lanes in (False, True):
        cell._batch_options = {"lanes": lanes}
        for t in threads:
            rate(f"cell, {'SIMD lanes' if lanes else 'one by one'}, threads {t}", n,
                 lambda t=t: cell.batch(samples, near=cycle, threads=t))

    heart = wiggers.Heart(os.path.join(os.path.dirname(wiggers.__file__), "scenes", "whole_heart.toml"))
    cycle = heart.to_limit_cycle()
    n = 24
    samples = {"walls.LV.a_XB_kPa": heart.parameters["walls.LV.a_XB_kPa"] * np.exp(random.uniform(-0.2, 0.2, n))}
    for t in threads:
        rate(f"whole heart, batch, threads {t}", n, lambda t=t: heart.batch(samples, near=cycle, threads=t))


if __name__ == "__main__":
    main()
