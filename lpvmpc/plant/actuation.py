"""What lies between a command and the car: latency, steering ratio, offset and play, brake gain.

The servo and the drive themselves, with their lags and limits, are in the model (`callbacks`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from lpvmpc.interface import Command
from lpvmpc.plant.deviations import Deviations

MAX_LATENCY = 0.2
"""Longest latency of a command [s]."""

Pending = tuple[tuple[int, float, float], ...]
"""Commands on their way: physics steps until each arrives, and its two numbers."""


class Actuation:
    """The way of a command into the car, for one plant.

    delta_servo = play(ratio * delta + offset),   ax_drive = drive_gain * ax * (brake_gain if < 0)

    The play is a dead band of full width b: the output moves only where the input pushes it,
    p = min(max(p, u - b/2), u + b/2). `drive_gain` is the share of the commanded acceleration that
    the nominal car's torque gives this one, of another mass and wheel radius.
    """

    def __init__(self, deviations: Deviations, drive_gain: float, latency: int) -> None:
        """Args: the car's deviations, gain of the drive [-], latency [physics steps]."""
        self.ratio, self.offset = deviations.steer_ratio, deviations.steer_offset
        self.half_play = 0.5 * deviations.steer_play
        self.drive = drive_gain
        self.brake = drive_gain * deviations.brake_gain
        self.latency = latency
        self._queue: deque[tuple[int, float, float]] = deque()
        self._now: tuple[float, float] = (0.0, 0.0)
        self._steer = 0.0

    def start(self, delta: float, ax: float) -> Command:
        """Forget past commands: servo and drive hold these values; returns the command for them."""
        self._queue.clear()
        self._now, self._steer = (delta, ax), delta
        gain = self.brake if ax < 0.0 else self.drive
        return Command((delta - self.offset) / self.ratio, ax / gain)

    def segments(self, command: Command, steps: int) -> Iterator[tuple[int, float, float]]:
        """The next period: numbers of physics steps, and what servo and drive get during them."""
        delta, ax = command
        self._queue.append((self.latency, delta, ax))
        done = 0
        while done < steps:
            while self._queue and self._queue[0][0] <= done:
                _, delta, ax = self._queue.popleft()
                self._now = self._through(delta, ax)
            until = min(self._queue[0][0], steps) if self._queue else steps
            yield until - done, *self._now
            done = until
        self._queue = deque((due - steps, delta, ax) for due, delta, ax in self._queue)

    def _through(self, delta: float, ax: float) -> tuple[float, float]:
        """Servo angle [rad] and drive acceleration [m/s2] of a command that arrives."""
        wanted = self.ratio * delta + self.offset
        if self.half_play:
            low, high = wanted - self.half_play, wanted + self.half_play
            wanted = self._steer = min(max(self._steer, low), high)
        return wanted, ax * (self.brake if ax < 0.0 else self.drive)

    def save(self) -> tuple[Pending, tuple[float, float], float]:
        """What is on its way, what the car holds, and where the play is."""
        return tuple(self._queue), self._now, self._steer

    def restore(self, saved: tuple[Pending, tuple[float, float], float]) -> None:
        """Go back to what `save` gave."""
        pending, self._now, self._steer = saved
        self._queue = deque(pending)
