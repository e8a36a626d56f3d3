"""Calibration: which parameters of a model meet given targets, how well they are known, and what cannot be known.

    >>> problem = Problem(wiggers.Loop(), {"circuit.SYS.R_AR": Free(0.3, 1.5), "elastance.LV.EA": Free(1, 6)},
    ...                   [Target("LV.EF_percent", 60, sd=2), Target("aorta.pressure_max_mmHg", within=(110, 130))])
    >>> fit = least_squares(problem)
    >>> print(fit.explain())

The limit cycle is solved inside the objective, from the last one nearby, so that no transient is fitted. Least
squares uses the exact derivatives; the other methods are thin adapters on their libraries: cma_es (cma), mcmc
(emcee), sobol (SALib).
"""

from ._explain import Explanation
from ._fit import Fit, least_squares
from ._force import ForceCalcium
from ._problem import Free, Problem
from ._report import write_report
from ._samplers import Posterior, Screening, cma_es, mcmc, sobol
from ._targets import Target, reference_targets

__all__ = [
    "Explanation", "Fit", "ForceCalcium", "Free", "Posterior", "Problem", "Screening", "Target", "cma_es", "least_squares",
    "mcmc", "reference_targets", "sobol", "write_report",
]
