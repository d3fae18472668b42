"""The tracker: what every controller on a QP does in one control period, whatever its model.

Check the preview and the measurement; estimate where the plan begins; write the QP; solve it;
accept the solution, or fall back; keep plan and prediction for the next period. A controller of
this kind is a subclass with a `Horizon` and one hook, `write_qp`.
"""

from __future__ import annotations

import math
import time

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.period import accept, shift
from lpvmpc.control.solver.checked import QPResult, QPSolver
from lpvmpc.errors import OptionError
from lpvmpc.interface import Command, Diagnostics, Preview, State
from lpvmpc.units import Array

BRAKING = -3.0
"""Acceleration while nothing is measured [m/s2]."""
REFUSALS = 3
"""So many refused solves in a row are answered by the plan before; then geometry drives."""
DELAY_MAX = 30
"""Longest delay that is compensated [periods]."""
NOT_FINITE = QPResult(np.empty(0), False, "NOT_FINITE", np.nan, 0.0, 0.0)
"""Outcome of a period whose measurement is not a number."""


APPROACH = 0.8
"""How hard the path is approached: rate at which the lateral error falls at low speed [1/s]."""
SOFTENING = 1.0
"""Speed added to the car's, so that standing still divides by something [m/s]."""
DAMPING = 0.05
"""Angle per yaw rate beyond the path's [s]."""
SPEED_GAIN = 1.0
"""Acceleration per speed error [1/s]."""
AX_MIN, AX_MAX = -3.0, 2.0
"""Hardest braking and driving [m/s2]."""


def checked_delay(delay: int) -> int:
    """A known delay between command and effect [periods].

    Raises:
        OptionError: It is none.
    """
    if not (isinstance(delay, int) and 0 <= delay <= DELAY_MAX):
        raise OptionError("delay", delay, f"a whole number of periods from 0 to {DELAY_MAX}")
    return delay


class Tracker:
    """A controller that plans by a QP; subclasses say which.

    A subclass has a `name` and `weights`, and writes the QP of each period into `horizon`.
    """

    name: str
    """Name of the controller."""
    drives_on = True
    """Whether geometry drives after `REFUSALS` refused solves in a row; else the car brakes."""
    informed: bool | None
    """Whether the period before was measured; None before the first measured one."""

    def __init__(
        self,
        car: VehicleParams,
        horizon: Horizon,
        tolerance: float = 1e-6,
        solver: str = "proxqp",
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            horizon: Arrays and constants of a period.
            tolerance: KKT tolerance of the QP.
            solver: Who solves it first, one of `solver.checked.SOLVERS`.

        Raises:
            UnknownNameError: No such solver.
        """
        self.car, self.horizon = car, horizon
        self.Np, self.Ts = len(horizon.plan), horizon.Ts
        """Prediction horizon [periods], control period [s]."""
        self.delay = horizon.delay
        """Known delay between command and effect [periods]."""
        self.least_preview = self.preview_steps = self.Np + len(horizon.queue) - 1
        """Periods of preview needed: the horizon, and the longest delay before it begins. A
        controller may ask for more than it needs."""
        rows, columns = horizon.C.shape
        self.solver = QPSolver(columns, rows, tolerance, first=solver)
        self._warm_up()

    # what a subclass says -----------------------------------------------------------------

    def estimate(self, state: State, preview: Preview) -> None:
        """Write the state from which the plan begins into `horizon.schedule[0]`.

        Here the measured (vx, vy, r, ey, epsi), as if there were no delay.

        Args:
            state: The car's state now; it is finite.
            preview: Reference along the horizon and the delay before it.
        """
        measured = state.vx, state.vy, state.r, preview.ey, preview.epsi
        self.horizon.schedule[0] = measured

    def write_qp(self, state: State, preview: Preview) -> None:
        """Write the QP of this period into `horizon`: H, g, C, lo, hi, free and forced.

        Args:
            state: The car's state now; `horizon.schedule[0]` is where the plan begins.
            preview: Reference along the horizon and the delay before it.
        """
        raise NotImplementedError

    def solve(self) -> QPResult:
        """Solve what `write_qp` wrote; one that solves something else overrides it."""
        h = self.horizon
        return self.solver.solve(h.H, h.g, h.C, h.lo, h.hi)

    # one period ---------------------------------------------------------------------------

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        self.solver.reset()
        self.horizon.forget()
        self.diagnostics = Diagnostics()
        self.informed, self._refused = None, 0

    def command(self, state: State, preview: Preview) -> Command:
        """Command of one control period.

        Args:
            state: The car's state now.
            preview: Reference over at least `least_preview` periods.

        Returns:
            Steering angle [rad] and acceleration [m/s2], within the hard bounds.

        Raises:
            OptionError: The preview is too short.
        """
        start = time.thread_time_ns()
        if len(preview.kappa) <= self.least_preview:
            raise OptionError(
                "preview length", len(preview.kappa), f"at least {self.least_preview + 1} points"
            )
        h = self.horizon
        if math.isfinite(
            state.vx + state.vy + state.r + state.delta + state.ax + state.ay
            + preview.ey + preview.epsi
        ):
            self.estimate(state, preview)
            self.write_qp(state, preview)
            self.informed = True
            built = time.thread_time_ns()
            result = self.solve()
        else:  # nothing is learned from it; the plan of the period before goes on
            if self.informed is not None:
                self.informed = False
            built, result = time.thread_time_ns(), NOT_FINITE
        if result.solved:
            self.accept(result.z)
            self._refused, fallback = 0, ""
        else:
            fallback = self._fall_back(state, preview)
        shift(h.handle)
        delta, ax = h.queue[-1].tolist()
        self.diagnostics = Diagnostics(
            result.solved,
            fallback,
            result.status,
            result.residual,
            (built - start) * 1e-3,
            result.solve_us,
            result.check_us,
            h.prediction[:, :5].copy(),
            h.disturbance.copy(),
        )
        return Command(*self.ask(delta, ax))

    def ask(self, delta: float, ax: float) -> tuple[float, float]:
        """What to ask for, so that the car does this; here the same.

        Args:
            delta: Angle that the wheels are to have [rad].
            ax: Acceleration that it is to have [m/s2].
        """
        return delta, ax

    def accept(self, z: Array) -> None:
        """Make a solution of the QP the plan and the prediction.

        Args:
            z: Inputs in units of `horizon.scale`, period by period, and the slack; shape (n,).
        """
        accept(self.horizon.handle, z)

    def _fall_back(self, state: State, preview: Preview) -> str:
        """A refused solve: keep to the previous plan, already shifted; after three, drive on.

        Without a measurement there is nothing to drive by: then, as in the paper's plain form, the
        plan is followed while braking.
        """
        self._refused += 1
        h = self.horizon
        h.prediction[:] = h.schedule
        if self._refused <= REFUSALS:
            return "shifted"
        if not (self.informed and self.drives_on):
            h.plan[:, 1] = BRAKING
            return "braking"
        last, step = float(h.queue[-1, 0]), float(h.du_max[0])
        h.plan[:] = drive_on(state, preview, self.car, last, step)
        h.prediction[:] = h.schedule[0]  # the next model is frozen where the car is
        return "driving"

    def _warm_up(self) -> None:
        """Load the compiled code, 50 ms, before the first period needs it; then start anew."""
        self.reset(np.random.default_rng(0))
        still = State(0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(4))
        flat = np.zeros(self.preview_steps + 1)
        preview = Preview(0.0, 0.0, 0.0, flat, flat + 10.0, flat, flat, flat)
        for _ in range(2):  # the second period also compares with the first
            self.command(still, preview)
        self.reset(np.random.default_rng(0))


def drive_on(
    state: State, preview: Preview, car: VehicleParams, last: float, step: float
) -> tuple[float, float]:
    """Steering angle and acceleration that keep the car on its path.

    delta = (L + K vx^2) kappa - epsi - atan(0.8 ey / (1 + vx)) - 0.05 (r - kappa vx),
    K = m / L (lr / Cf - lf / Cr), the steady single track's understeer

    Args:
        state: The car's state now, finite.
        preview: Reference from now on.
        car: Vehicle parameters.
        last: Angle of the period before [rad].
        step: Largest change of the angle in a period [rad].

    Returns:
        Angle [rad], acceleration [m/s2].

    Source: Hoffmann, Tomlin, Montemerlo, Thrun, Autonomous automobile trajectory tracking for
    off-road driving, ACC 2007, with the feed-forward of Rajamani, section 3.1.
    """
    ahead = min(3, len(preview.kappa) - 1)
    kappa, vx = float(preview.kappa[ahead]), max(state.vx, 0.0)
    L = car.wheelbase
    understeer = car.m / L * (car.lr / car.Cf - car.lf / car.Cr)
    delta = (L + understeer * vx * vx) * kappa - preview.epsi
    delta -= math.atan(APPROACH * preview.ey / (SOFTENING + vx))
    delta -= DAMPING * (state.r - kappa * vx)
    delta = min(max(delta, last - step), last + step)
    ax = min(max(SPEED_GAIN * (float(preview.vx_ref[ahead]) - state.vx), AX_MIN), AX_MAX)
    return min(max(delta, -car.delta_max), car.delta_max), ax
