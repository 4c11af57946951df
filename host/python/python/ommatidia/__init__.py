"""Ommatidia: calibrate, simulate, reconstruct and close the loop for multi-aperture miniscopes.

Arrays are (row, col), stacks [n, rows, cols], float32. float32 arrays go in and out without copies. Work runs without
Python's global lock; Ctrl-C stops it. What the program would print as an error is raised as `OmmatidiaError`.
"""

from ._core import (
    Instrument,
    Network,
    OmmatidiaError,
    Session,
    Simulation,
    Stack,
    __version__,
    close,
    quantize,
    residual,
    set_threads,
    simulate,
)
from .operators import as_linear_operator as _as_linear_operator

# The libraries of linear operators are Python's, so the method is, too.
Instrument.as_linear_operator = _as_linear_operator

__all__ = [
    "Instrument",
    "Network",
    "OmmatidiaError",
    "Session",
    "Simulation",
    "Stack",
    "__version__",
    "close",
    "quantize",
    "residual",
    "set_threads",
    "simulate",
]
