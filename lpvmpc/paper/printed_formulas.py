"""The paper's controller with its formulas as printed, slip by slip.

`Printed` is the plain formulation (`formulation.PAPER`) with some of the printed slips put back. A
class with named slips has a name, so that a closed loop can be described by it:

    lpvmpc.paper.printed_formulas:Printed_signs_drag

Two slips have no place here, since no matrix contains them: the sign of lf r in the slip angle, and
the heading error's rate without the curvature.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import (
    CORRECTED,
    DELTA,
    EPSI,
    EY,
    NU,
    NX,
    PRINTED,
    VX,
    VY,
    A,
    R,
    lpv,
    unpack,
)
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import PAPER_WEIGHTS
from lpvmpc.control.formulation import PAPER
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.period import bounds
from lpvmpc.control.qp import condense
from lpvmpc.errors import LPVMPCError
from lpvmpc.interface import Preview, State
from lpvmpc.units import GRAVITY

SLIPS = {
    "dt": "x+ = x + A x + B u dt: the period multiplies B u only",
    "signs": "B21 and B31 negative: steering left pushes the car right",
    "bracket": "A32 with lf Cf cos(delta) + lr Cr instead of the difference",
    "drag": "mu m g with mu = 0.82 as the car's resistance, 12.7 kN",
    "bounds": "the acceleration within +-pi/6, as the steering angle",
    "terminal": "the terminal cost x'Qx, which pulls speed and errors to zero",
    "curvature": "A52 with a cosine instead of the sine",
    "error": "A41 = sin(epsi) and A45 = 0: the predicted ey ignores the heading",
}
"""Printed slips by name, in the order in which the ablation corrects them. What the closed bracket
of A32 would mean literally, the cosine of a number of newtons, is read as the sum it holds."""
MU = 0.82
"""The paper's friction coefficient, which its drag contains [-]."""
AX_MAX = np.pi / 6
"""The paper's bound on both inputs, here of the acceleration [m/s2]."""
DT, SIGNS, BRACKET, DRAG, BOUNDS, TERMINAL, CURVATURE, ERROR = range(len(SLIPS))


@njit(cache=True)
def matrices(x, kappa, axle_forces, car, slips, A_out, B_out, c_out):
    """Matrices of the paper's LPV form with some slips, written in place.

    Args:
        x: Scheduling state, shape (11,), as in `bicycle.lpv`.
        kappa: Path curvature [1/m].
        axle_forces: Affine axle forces (Cf, F0f, Cr, F0r) [N/rad, N], shape (4,).
        car: `Bicycle` constants, simplified: no lags, no relaxation, no roll.
        slips: Which slips, in the order of `SLIPS`, shape (8,).
        A_out: Receives A, shape (11, 11).
        B_out: Receives B, shape (11, 2).
        c_out: Receives c, shape (11,).

    Source: Kebbati et al., eqs. 7-8; docs/derivations.md, D1.
    """
    lpv(x, kappa, axle_forces, car, PRINTED if slips[ERROR] else CORRECTED, A_out, B_out, c_out)
    vx = max(x[VX], car.vx_min)
    if slips[SIGNS]:
        B_out[VY, 0] = -B_out[VY, 0]
        B_out[R, 0] = -B_out[R, 0]
    if slips[BRACKET]:
        moment = car.lf * axle_forces[0] * np.cos(x[DELTA]) + car.lr * axle_forces[2]
        A_out[R, VY] = -moment / (car.Iz * vx)
    if slips[DRAG]:
        A_out[VX, VX] = -MU * GRAVITY / vx - car.k_drag * vx / car.m
    if slips[CURVATURE]:
        A_out[EPSI, VY] = kappa * np.cos(x[EPSI]) / (1.0 - x[EY] * kappa)


@njit(cache=True)
def _write(h, kappa, vx_ref, slips):
    """Model, references, bounds and QP of one period, in place."""
    car = unpack(h.car)
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    for k in range(len(h.Ad)):
        matrices(h.schedule[k], kappa[k], h.axle_forces[k], car, slips, A_, B_, c_)
        for i in range(NX):
            for j in range(NX):
                h.Ad[k, i, j] = A_[i, j] * (1.0 if slips[DT] else h.Ts)
            h.Ad[k, i, i] += 1.0
            for m in range(NU):
                h.Bd[k, i, m] = B_[i, m] * h.Ts
            h.cd[k, i] = c_[i] * h.Ts
        for state, m in ((DELTA, 0), (A, 1)):  # steering and drive follow at once
            h.Ad[k, state, state], h.Bd[k, state, m] = 0.0, 1.0
        h.x_ref[k] = 0.0
        h.x_ref[k, VX] = vx_ref[k + 1]
    if slips[TERMINAL]:
        h.x_ref[-1, VX] = 0.0
    bounds(h, car, h.slip_cap, h.drive[1], -h.drive[0])
    if slips[BOUNDS]:
        h.u_lo[:, 1], h.u_hi[:, 1] = -AX_MAX, AX_MAX
    condense(h)


class Printed(LPVMPC):
    """The plain formulation with printed slips; without any it is `lpv-mpc-paper`, bit for bit."""

    name = "lpv-mpc-printed"
    slips: ClassVar[frozenset[str]] = frozenset(SLIPS)
    """Names of the slips; here all of them."""

    def __init__(self, car: VehicleParams) -> None:
        """Build the controller, on the weights set by hand for the plain formulation."""
        from lpvmpc.control.stiffness.models import ConstantStiffness

        self._slips = np.array([name in self.slips for name in SLIPS])
        super().__init__(
            car, stiffness=ConstantStiffness(car), weights=PAPER_WEIGHTS, formulation=PAPER
        )

    def write_qp(self, state: State, preview: Preview) -> None:
        """Write the QP."""
        h = self.horizon
        self.stiffness.horizon(state, h.knots, h.axle_forces)
        _write(h.handle, preview.kappa, preview.vx_ref, self._slips)
        if not math.isfinite(float(h.H.sum()) + float(h.g.sum())):
            raise LPVMPCError("The printed model has diverged: its prediction is not finite.")


def controller(slips: frozenset[str] | set[str]) -> str:
    """Name of the controller with some slips, as `load_controller` takes it."""
    named = [name for name in SLIPS if name in slips] or ["none"]
    return f"{__name__}:" + "_".join(["Printed", *named])


def __getattr__(name: str) -> type[Printed]:
    """The class `Printed_SLIP_SLIP...`; `Printed_none` has no slip."""
    first, _, rest = name.partition("_")
    slips = rest.split("_") if rest and rest != "none" else []
    if first != "Printed" or not rest or any(slip not in SLIPS for slip in slips):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    made = globals()[name] = type(name, (Printed,), {"slips": frozenset(slips)})
    return made  # kept: a class that is pickled must be found again, the same
