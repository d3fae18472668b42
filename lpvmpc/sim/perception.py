"""From the true state to what the controller is given: sensors, estimator, and the road from there.

Where the sensors are exact and no estimator is asked for, none of this exists, and the
controller gets the true state.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lpvmpc.errors import EstimatorError, LPVMPCError, OptionError
from lpvmpc.interface import Command, Estimator, Measurement, Preview, State, shown
from lpvmpc.plant.deviations import Deviations
from lpvmpc.road.scenario import Scenario
from lpvmpc.sensing.sensors import Sensors
from lpvmpc.sim.guard import Guard, checked_state, own_copy

WHEELS = ("fl", "fr", "rl", "rr")
MEASURED = (
    "meas_x_m", "meas_y_m", "meas_psi_rad", "meas_pose_age_s", "meas_vx_mps", "meas_vy_mps",
    "meas_r_radps", "meas_ax_mps2", "meas_ay_mps2", "meas_delta_rad",
    *(f"meas_wheel_speed_{wheel}_radps" for wheel in WHEELS),
)
"""Columns of the trace with what was measured; NaN where nothing was."""
ESTIMATED = (
    "est_x_m", "est_y_m", "est_psi_rad", "est_vx_mps", "est_vy_mps", "est_r_radps",
    "est_delta_rad", "est_ax_mps2", "est_ay_mps2", "est_s_m", "est_ey_m", "est_epsi_rad",
)
"""Columns with what the controller was given."""


class Perception:
    """The sensors and the estimator of one run."""

    def __init__(
        self,
        scenario: Scenario,
        sensors: Sensors,
        estimator: Estimator,
        guard: Guard,
        servo: Deviations | None,
        steps: int,
        rows: int,
    ) -> None:
        """Put them together.

        Args:
            scenario: The road that is previewed.
            sensors: What measures.
            estimator: What makes a state of it.
            guard: What calls the estimator, and knows its name.
            servo: The car's deviations, where the steering sensor sits at the servo and so before
                offset and ratio.
            steps: Periods of preview.
            rows: Largest number of control instants.
        """
        self.scenario, self.sensors, self.estimator = scenario, sensors, estimator
        self.guard, self.servo, self.steps = guard, servo, steps
        # compiled for writable arrays; what it writes to is its own copy as well
        self._ours = type(estimator).__module__.startswith("lpvmpc.sensing.")
        self.diverged = 0
        """How often the estimator returned what is no state, and was reset."""
        self._s = 0.0
        self._last: State | None = None
        self._rng = np.random.default_rng(0)
        self._measured = np.full((rows, len(MEASURED)), np.nan)
        self._estimated = np.full((rows, len(ESTIMATED)), np.nan)
        self._n = 0

    def start(self, first: State, rng: np.random.Generator) -> None:
        """Reset the estimator on the start line.

        Raises:
            EstimatorError: It raised.
        """
        self._rng, self._last = rng, first
        self._reset(first)

    def look(
        self, state: State, psi_path: float, t: float, command: Command
    ) -> tuple[State, Preview]:
        """The state and the road that the controller is given at a control instant.

        Args:
            state: The true state.
            psi_path: Heading of the path beside the car [rad].
            t: Time of this instant [s].
            command: The command of the period that just ended.

        Raises:
            EstimatorError: The estimator raised, or has no state even after a reset.
        """
        seen = state
        if self.servo is not None:
            delta = (state.delta - self.servo.steer_offset) / self.servo.steer_ratio
            seen = state._replace(delta=delta)
        measured = self.sensors.measure(seen, psi_path, t)
        k = self._n
        self._measured[k] = (*measured[:-1], *measured.wheel_speed)
        found = self._update(measured, command, t)
        if found is None:
            self.diverged += 1
            assert self._last is not None
            self._reset(self._last)
            found = self._update(measured, command, t)
            if found is None:
                raise EstimatorError(
                    f"Estimator {self.guard.name!r} returned at t = {t:.3f} s, twice and after "
                    "a reset, what is no State of finite numbers."
                )
        self._last = found
        speed = self.scenario.speed
        preview = self.scenario.path.preview(
            found.x, found.y, found.psi, self._s, speed.vx, speed.spacing, self.steps,
            self.sensors.Ts,
        )
        self._s = preview.s
        self._estimated[k] = (*found[:9], preview.s, preview.ey, preview.epsi)
        self._n = k + 1
        return found, preview

    def told(self) -> tuple[int, dict[str, float], str]:
        """What is to be told of the estimator after the run.

        Returns:
            How often it diverged and was reset, by itself or here; the slow unknowns that it says
            it has found; and what is wrong with what it says, or "".
        """
        try:
            events, unknowns = self.guard.call("its attributes", 0.0, _told, self.estimator)
        except LPVMPCError as error:
            return self.diverged, {}, str(error)
        return self.diverged + events, unknowns, ""

    def columns(self, n: int) -> dict[str, Any]:
        """What was measured and estimated at the first n instants, by column."""
        found = {name: self._measured[:n, i].copy() for i, name in enumerate(MEASURED)}
        found.update({name: self._estimated[:n, i].copy() for i, name in enumerate(ESTIMATED)})
        return found

    def _reset(self, first: State) -> None:
        self.guard.call("reset", 0.0, self.estimator.reset, own_copy(first, writable=True),
                        self._rng)

    def _update(self, measured: Measurement, command: Command, t: float) -> State | None:
        """The estimator's answer, None where it is no state."""
        given = own_copy(measured, writable=self._ours)
        answer: State | None = self.guard.call("update", t, self._checked, given, command)
        return answer

    def _checked(self, measured: Measurement, command: Command) -> State | None:
        return checked_state(self.estimator.update(measured, command))


def _told(estimator: Estimator) -> tuple[int, dict[str, float]]:
    """Events and unknowns as an estimator tells them, checked."""
    events = getattr(estimator, "events", 0)
    if type(events) is not int:
        raise OptionError("estimator events", shown(events), "a whole number")
    unknowns = getattr(estimator, "unknowns", {})
    if not isinstance(unknowns, dict):
        raise OptionError("estimator unknowns", shown(unknowns), "numbers by name")
    found = {str(name): float(value) for name, value in unknowns.items()}
    for name, value in found.items():
        if not math.isfinite(value):
            raise OptionError(f"estimator unknown {name}", value, "a finite number")
    return events, found
