"""Units and types that every part shares: SI and radians, arrays of float64."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""An array of double precision; each docstring says its shape and unit."""

GRAVITY = 9.81
"""Gravitational acceleration of the paper's Table 2 [m/s2]."""
