"""Recordings of CommonRoad's multibody car: another car, others' equations, another tire.

`vehicle_dynamics_mb` of commonroad-vehicle-models (TU Munich, BSD-3; Althoff and Wuersching, 2020)
with its own parameters, number 2 being the BMW 320i. 29 states: roll, pitch, compliant axles, four
tires with camber and shifts; no relaxation, no load dependence.

    python -m lpvmpc.identify.evidence.multibody drive.csv

writes 40 s of the BMW, driven to its limit, as `lpvmpc adopt drive.csv --out cars/mine` reads it.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from lpvmpc.errors import LPVMPCError
from lpvmpc.identify.recording import Recording
from lpvmpc.kit import cli
from lpvmpc.kit.files import write_text

SAMPLE = 0.02
"""Time between two samples [s]."""
WAVES = ((0.31, 0.9, 0.0), (0.83, 0.7, 1.0), (1.37, 0.35, 2.0), (2.6, 0.15, 0.5))
"""Steering: frequency [Hz] of each wave at half speed, share, phase [rad]."""


def angle(t: float, top: float, phase: float) -> float:
    """Road-wheel angle [rad]: waves from zero on."""
    fade = min(t / 2.0, 1.0)
    return fade * top * sum(
        share * math.sin(math.pi * f * t + start + phase) for f, share, start in WAVES
    ) / 1.5


def record(
    top: float, *, number: int = 2, speed: float = 18.0, seconds: float = 20.0, phase: float = 0.0
) -> Recording:
    """Drive the car.

    Args:
        top: Amplitude of the steering [rad].
        number: Of the parameter set: 1 Ford Escort, 2 BMW 320i, 3 VW Vanagon.
        speed: Mean speed [m/s]; it varies by 2 m/s.
        seconds: How long.
        phase: Of all waves [rad]; another one is another drive.

    Raises:
        ImportError: commonroad-vehicle-models is not installed.
    """
    from importlib import import_module

    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    module = import_module(f"vehiclemodels.parameters_vehicle{number}")
    p = getattr(module, f"parameters_vehicle{number}")()

    def derivative(t: float, x: list[float]) -> list[float]:
        rate = (angle(t + 1e-4, top, phase) - angle(t - 1e-4, top, phase)) / 2e-4
        missing = speed + 2.0 * math.sin(0.5 * t + phase) - x[3]
        inputs = [rate, 2.0 * missing]
        return list(vehicle_dynamics_mb(list(x), inputs, p))

    start = init_mb([0.0, 0.0, angle(0.0, top, phase), speed, 0.0, 0.0, 0.0], p)
    times = np.arange(0.0, seconds, SAMPLE)
    solution = solve_ivp(
        derivative, (0.0, seconds), start, "LSODA", t_eval=times, rtol=1e-6, atol=1e-8,
        max_step=0.02,
    )
    assert solution.status == 0, solution.message
    y = solution.y
    return Recording(
        name=f"CommonRoad multibody {number}, {top:g} rad", t=times, delta=y[2], vx=y[3], vy=y[10],
        r=y[5],
    )


def main(words: list[str]) -> int:
    """Write a recording of the BMW, driven to its limit."""
    if len(words) != 1 or words[0].startswith("-"):
        print(__doc__)
        return 2 * (words not in (["-h"], ["--help"]))
    try:
        cli.result_file(Path(words[0]))
        one = record(0.065, seconds=40.0)
        assert one.vy is not None
        rows = np.column_stack([one.t, one.delta, one.vx, one.vy, one.r])
        lines = ["t_s,delta_rad,vx_mps,vy_mps,r_radps"]
        lines += [",".join(f"{value:.8g}" for value in row) for row in rows]
        write_text(words[0], "\n".join(lines) + "\n")
    except LPVMPCError as error:
        print("Error:", cli.one_line(str(error)), file=sys.stderr)
        return cli.BAD_INPUT
    return cli.DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
