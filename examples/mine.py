"""A controller for the leaderboard, in one short file.

    cd examples
    lpvmpc benchmark --controllers mine:Mine stanley lpv-mpc --quick

docs/submit.md says what comes of it, and how a result is submitted.
"""

import numpy as np

from lpvmpc import Command, Preview, State


class Mine:
    """Steer by the road's curvature, against the errors and against what they leave."""

    preview_steps = 5

    def __init__(self, car):
        """`car` is given where it is asked for: the parameters of the nominal car."""
        self.wheelbase = car.wheelbase

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last run."""
        self.integral = 0.0

    def command(self, state: State, preview: Preview) -> Command:
        """A steering angle [rad] and an acceleration [m/s2], every 33 ms."""
        self.integral = float(np.clip(self.integral + 0.033 * preview.ey, -0.5, 0.5))
        steer = (self.wheelbase + 0.002 * state.vx**2) * preview.kappa[3]
        steer -= 0.2 * preview.ey + 0.6 * preview.epsi + 0.05 * self.integral
        return Command(delta=float(steer), ax=float(preview.vx_ref[3] - state.vx))
