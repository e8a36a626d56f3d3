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
from ._fit import Fit, Search, least_squares
from ._force import ForceCalcium
from ._outputs import Difference, Ratio
from ._problem import Free, Problem
from ._report import write_report
from ._samplers import Posterior, Screening, cma_es, mcmc, sobol
from ._targets import Missed, Target, TargetWarning, reference_targets
from ._ties import Tie

__all__ = [
    "Difference", "Explanation", "Fit", "ForceCalcium", "Free", "Missed", "Posterior", "Problem", "Ratio", "Screening",
    "Search", "Target", "TargetWarning", "Tie", "cma_es", "least_squares", "mcmc", "reference_targets", "sobol",
    "write_report",
]
