"""The single tracks that the same steering is given to: linear tires, and the tire law."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from lpvmpc.car import bicycle
from lpvmpc.car.axle import Axle, lateral_force
from lpvmpc.car.bicycle import Bicycle
from lpvmpc.car.params import VehicleParams
from lpvmpc.units import Array


class SingleTrack:
    """The nonlinear single track at constant speed, with linear or Magic Formula axles."""

    def __init__(self, p: VehicleParams, law: tuple[Axle, Axle] | None):
        """Args: parameters of the car; constants of its axles, or None for linear tires."""
        self.p, self.law = p, law
        self.car = Bicycle.of(p)._replace(tau_delta=0.0, tau_ax=0.0)

    def axle_forces(self, alpha_f: float, alpha_r: float, phi: float) -> Array:
        """Affine axle forces (Cf, F0f, Cr, F0r) for `bicycle.derivative`."""
        if self.law is None:
            return np.array([self.p.Cf, 0.0, self.p.Cr, 0.0])
        forces = [
            lateral_force(axle, alpha, phi, 0.0, 1.0)
            for axle, alpha in zip(self.law, (alpha_f, alpha_r), strict=True)
        ]
        return np.array([0.0, forces[0], 0.0, forces[1]])

    def derivative(self, x: Array, delta: float) -> Array:
        """Of the eleven states of `bicycle`, the speed held."""
        forces = self.axle_forces(x[bicycle.AF], x[bicycle.AR], x[bicycle.PHI])
        dx: Array = bicycle.derivative(x, np.array([delta, 0.0]), 0.0, forces, self.car)
        dx[bicycle.VX] = 0.0
        return dx

    def steady(self, vx: float, delta: float) -> tuple[float, float]:
        """Yaw rate [rad/s] and sideslip angle [rad] at constant speed and steering."""
        rows = [bicycle.VY, bicycle.R, bicycle.AF, bicycle.AR, bicycle.P]

        def residual(unknown: Array, angle: float) -> Array:
            x = np.zeros(bicycle.NX)
            x[bicycle.VX] = vx
            x[[bicycle.VY, bicycle.R, bicycle.AF, bicycle.AR, bicycle.PHI]] = unknown
            return self.derivative(x, angle)[rows]

        unknown = np.zeros(5)
        for angle in np.linspace(0.0, delta, 9)[1:]:  # step by step: past the peak are other roots
            solution = root(residual, unknown, args=(angle,), tol=1e-12)
            unknown = solution.x
            assert np.abs(residual(unknown, angle)).max() < 1e-6, solution.message
        return float(unknown[1]), math.atan2(unknown[0], vx)

    def transient(self, vx: float, delta: Callable[[float], float], times: Array) -> Array:
        """Yaw rate [rad/s] and sideslip angle [rad] over time, shape (n, 2)."""
        start = np.zeros(bicycle.NX)
        start[bicycle.VX] = vx
        solution = solve_ivp(
            lambda t, x: self.derivative(x, delta(t)), (times[0], times[-1]), start,
            t_eval=times, rtol=1e-7, atol=1e-9, max_step=0.02,
        )
        vy, r = solution.y[bicycle.VY], solution.y[bicycle.R]
        return np.stack([r, np.arctan2(vy, vx)], axis=1)
