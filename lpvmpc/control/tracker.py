"""What every tracker on a QP does alike."""

from __future__ import annotations

import numpy as np

from lpvmpc.control.qp import QPResult

BRAKING = -3.0
"""Acceleration of the last fallback [m/s2]."""
NOT_FINITE = QPResult(np.empty(0), False, "NOT_FINITE", np.nan, 0.0, 0.0)
"""Outcome of a period whose measurement is not a number."""
