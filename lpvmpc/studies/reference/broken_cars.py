"""Cars broken on purpose, to see which studies notice.

A study that passes every car says nothing. Each of these has one error of the kind that slips into
vehicle models; `tests/test_studies.py` demands that the studies find it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.errors import LPVMPCError, UnknownNameError
from lpvmpc.interface import Command, State
from lpvmpc.plant.mjcf import WHEELS, model_path
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import DRIVE, STEER, WIND_X, WIND_Y
from lpvmpc.studies.names import BROKEN
from lpvmpc.studies.study import CarUnderTest
from lpvmpc.units import Array

KNUCKLES = (7, 10)
"""Columns of qvel of the two steered hinges."""


def break_car(name: str) -> CarUnderTest:
    """A car with one error; its expectations are those of the sound one.

    Args:
        name: One of `names.BROKEN`.

    Raises:
        UnknownNameError: There is no such error; the message lists those there are.
    """
    if name not in BROKEN:
        raise UnknownNameError("broken car", name, BROKEN)
    broken: CarUnderTest = globals()[name.replace("-", "_")](CarUnderTest.packaged())
    return broken


class WrongTrail(Plant):
    """The lateral force acts ahead of the wheel centre instead of behind it."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """See Plant; the sign is changed in the plant's own copy of the model."""
        super().__init__(*args, **kwargs)
        for axle in "fr":
            self.model.numeric(f"tire_{axle}").data[mf.QDZ1] *= -1.0


class LateForces(Plant):
    """The forces of the tires move the body one physics step after they were computed.

    The forces of this step are taken away and those of the last one put in their place. The
    steering rack is left alone: late, it would shake by itself.
    """

    _last: Array | None = None

    def reset(self, *args: Any, **kwargs: Any) -> State:
        """See Plant."""
        self._last = None
        self.data.qfrc_applied[:] = 0.0
        return super().reset(*args, **kwargs)

    def step(self, command: Command, wind: tuple[float, float] = (0.0, 0.0)) -> State:
        """See Plant."""
        d = self.data
        d.ctrl[STEER], d.ctrl[DRIVE] = command
        d.ctrl[WIND_X], d.ctrl[WIND_Y] = wind
        if not np.isfinite(d.ctrl).all():
            raise LPVMPCError(f"A command or wind is not finite: {command}, wind {tuple(wind)}.")
        for _ in range(self.nstep):
            mujoco.mj_forward(self.model, d)
            now = d.qfrc_passive - d.qfrc_spring - d.qfrc_damper
            now[list(KNUCKLES)] = 0.0
            last = now if self._last is None else self._last
            d.qfrc_applied[:] = last - now
            mujoco.mj_step(self.model, d)
            self._last = now
        return self.state


def wrong_trail(car: CarUnderTest) -> CarUnderTest:
    """Turn the sign of the pneumatic trail."""
    return replace(car, plant_class=WrongTrail)


def double_friction(car: CarUnderTest) -> CarUnderTest:
    """Double the friction of the tires."""
    for axle in "fr":
        for name in (mf.PDX1, mf.PDX2, mf.PDY1, mf.PDY2):
            car.model.numeric(f"tire_{axle}").data[name] *= 2.0
    return car


def narrow_track(car: CarUnderTest) -> CarUnderTest:
    """Make the track narrower by a tenth."""
    spec = mujoco.MjSpec.from_file(str(model_path("vehicle")))
    spec.compiler.discardvisual = True
    for wheel in WHEELS:
        spec.body(f"knuckle_{wheel}").pos[1] *= 0.9
    return replace(car, model=spec.compile())


def late_forces(car: CarUnderTest) -> CarUnderTest:
    """Delay the tires' forces by one physics step."""
    return replace(car, plant_class=LateForces)
