"""wiggers: from a single heart cell to a full beat.

    >>> import wiggers
    >>> cell = wiggers.Cell("ttp06-endo")
    >>> cycle = cell.to_limit_cycle()
    >>> cycle.indexes["APD90_ms"]

Models: Cell, Force, Loop, Heart. All have `parameters` (a mapping that knows units, defaults, ranges and
meanings); Cell, Loop and Heart find their limit cycle (`to_limit_cycle`), give derivatives of its indexes by the
parameters (`sensitivities`), and solve many samples at once (`batch`). `wiggers.calibration` fits them to targets.
"""

from ._checks import not_given
from ._core import InputError, NumericalFailure, ResourceError, index_names, index_units, reference_ranges
from ._core import loop_sets, models
from ._core import version_text as _version_text
from ._models import Cell, Force, Heart, Loop
from ._parameters import Parameters
from ._results import Batch, Cycle, Sensitivities, StateMismatch, Trace

__version__ = _version_text.split()[1]

__all__ = [
    "Batch", "Cell", "Cycle", "Force", "Heart", "InputError", "Loop", "NumericalFailure", "Parameters", "ResourceError",
    "Sensitivities", "StateMismatch", "Trace", "index_names", "index_units", "loop_sets", "models", "not_given",
    "reference_ranges",
]
