"""Thin adapters: CMA-ES for rough problems, MCMC for uncertainty, Sobol indices for screening."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import wiggers
from wiggers._checks import NotGiven, not_given, reals

from ._problem import Problem


def cma_es(problem: Problem, *, sigma: float = 0.2, max_evaluations: int = 2000, population: int | None = None,
           seed: int = 1, threads: int | None = None, executor: Any = None) -> tuple[dict[str, float], float]:
    """Minimises the sum of squared residuals by CMA-ES (package cma) over the bounds scaled to [0, 1], each generation
    as one batch. Returns the parameters found and half the sum of squares."""
    import cma

    lower, upper = problem.bounds
    start = (problem.start - lower) / (upper - lower)
    options: dict[str, Any] = {"bounds": [0, 1], "seed": seed, "verbose": -9, "maxfevals": max_evaluations}
    if population:
        options["popsize"] = population
    search = cma.CMAEvolutionStrategy(np.clip(start, 0.01, 0.99), sigma, options)
    while not search.stop():
        points = search.ask()
        xs = np.array([lower + np.asarray(p) * (upper - lower) for p in points])
        rows = problem.residuals_of_many(xs, threads=threads, executor=executor)
        worst = 0.5 * len(problem.targets) * problem.penalty**2  # ranks points without a cycle last
        search.tell(points, [0.5 * float(r @ r) if np.isfinite(r).all() else worst for r in rows])
    best = lower + np.asarray(search.result.xbest) * (upper - lower)
    return problem.values(best), float(search.result.fbest)


@dataclass
class Posterior:
    """Samples [sample, parameter] of the posterior: a flat prior between the bounds (of the transformed
    parameters), Gaussian targets. Check acceptance (0.2 to 0.6) and autocorrelation before use."""

    names: list[str]
    samples: np.ndarray
    acceptance: float
    autocorrelation: np.ndarray

    def interval(self, name: str, share: float = 0.95) -> tuple[float, float]:
        column = self.samples[:, self.names.index(name)]
        low, high = np.quantile(column, [(1 - share) / 2, (1 + share) / 2])
        return float(low), float(high)


def mcmc(problem: Problem, *, around: np.ndarray | NotGiven = not_given, walkers: int | None = None, steps: int = 500,
         burn_in: int = 200, seed: int = 1, threads: int | None = None, executor: Any = None) -> Posterior:
    """Affine-invariant ensemble sampling (package emcee), each move of the ensemble as one batch."""
    import emcee

    lower, upper = problem.bounds
    n = len(problem.names)
    walkers = walkers or max(2 * n + 2, 16)
    random = np.random.default_rng(seed)
    centre = problem.start if around is not_given else reals(around, "around")
    first = np.clip(centre + 1e-3 * (upper - lower) * random.standard_normal((walkers, n)),
                    lower + 1e-6 * (upper - lower), upper - 1e-6 * (upper - lower))

    def log_probability(xs: np.ndarray) -> np.ndarray:
        result = np.full(len(xs), -np.inf)
        inside = np.all((xs >= lower) & (xs <= upper), axis=1)
        if inside.any():
            rows = problem.residuals_of_many(xs[inside], threads=threads, executor=executor)
            result[inside] = -0.5 * np.einsum("ij,ij->i", rows, rows)  # minus infinity without a cycle
        return result

    # Walkers without a limit cycle start beside one that has it.
    good = np.flatnonzero(np.isfinite(log_probability(first)))
    if not len(good):
        raise wiggers.NumericalFailure(f"no walker has a limit cycle at its start: {problem.failures[-1][1]}")
    for k in set(range(walkers)) - set(good.tolist()):
        first[k] = first[good[k % len(good)]] + 1e-5 * (upper - lower) * random.standard_normal(n)
    sampler = emcee.EnsembleSampler(walkers, n, log_probability, vectorize=True)
    sampler._random = np.random.RandomState(seed)
    sampler.run_mcmc(first, burn_in + steps)
    chain = sampler.get_chain(discard=burn_in, flat=True)
    return Posterior(problem.set_names, problem.samples(chain), float(np.mean(sampler.acceptance_fraction)),
                     np.asarray(sampler.get_autocorr_time(quiet=True)))


@dataclass
class Screening:
    """Sobol indices [target, parameter]: first order and total, with their confidence widths."""

    targets: list[str]
    names: list[str]
    first: np.ndarray
    total: np.ndarray
    first_width: np.ndarray
    total_width: np.ndarray
    failures: dict[str, int]  # samples without this target's output


def sobol(problem: Problem, *, samples: int = 256, seed: int = 1, threads: int | None = None,
          executor: Any = None) -> Screening:
    """Sobol indices of the targets' outputs over the bounds (package SALib), all samples as one batch. Samples
    without an output (no limit cycle, a valve that never opens) count with the mean of the others; `failures` has their
    number."""
    from SALib.analyze import sobol as analyse
    from SALib.sample import sobol as draw

    lower, upper = problem.bounds
    description = {"num_vars": len(problem.names), "names": problem.names,
                   "bounds": np.column_stack([lower, upper]).tolist()}
    xs = draw.sample(description, samples, calc_second_order=False, seed=seed)
    table, reasons = problem.outputs_of_many(xs, threads=threads, executor=executor)
    rows = []
    failures = {}
    nothing = {key: np.zeros(len(problem.names)) for key in ("S1", "ST", "S1_conf", "ST_conf")}
    for target, outputs in zip(problem.targets, table.T, strict=True):
        good = np.isfinite(outputs)
        if not good.any():
            raise wiggers.NumericalFailure(f"no sample has {target.label}; the first: {reasons[0]}")
        failures[target.label] = int((~good).sum())
        outputs[~good] = outputs[good].mean()
        # What does not vary depends on nothing.
        rows.append(analyse.analyze(description, outputs, calc_second_order=False, seed=seed)
                    if np.ptp(outputs) > 1e-12 * np.abs(outputs).max() else nothing)
    return Screening([t.label for t in problem.targets], problem.names, np.array([r["S1"] for r in rows]),
                     np.array([r["ST"] for r in rows]), np.array([r["S1_conf"] for r in rows]),
                     np.array([r["ST_conf"] for r in rows]), failures)
