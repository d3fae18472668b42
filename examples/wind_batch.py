"""Many runs at once: how the lateral error grows with the side wind, in two processes.

    python examples/wind_batch.py

A `Run` is plain names and numbers, so that it can be sent to another process, or to a Ray cluster
(backend="ray"). With cache=FOLDER the results are kept, and a second call drives only what is new.
"""

import numpy as np

from lpvmpc.sim.batch import Run, drive_all


def write_road(file: str) -> None:
    """A straight of 150 m at 15 m/s; from 60 m on, a side wind of 20 m/s from left to right."""
    x = np.arange(0.0, 151.0, 3.0)
    wind = np.where(x < 60.0, 0.0, 20.0)
    rows = np.column_stack([x, np.zeros_like(x), np.full_like(x, 15.0), wind])
    np.savetxt(file, rows, fmt="%.2f", delimiter=",", header="x_m,y_m,vx_mps,wind_mps")


if __name__ == "__main__":  # other processes import this file: what drives must stand below
    write_road("gust.csv")
    scales = (0.0, 0.5, 1.0, 1.5)
    controllers = ("lpv-mpc", "stanley")
    runs = [
        Run(scenario="gust.csv", scenario_options={"wind_scale": scale}, controller=name)
        for name in controllers
        for scale in scales
    ]
    results = iter(drive_all(runs, jobs=2))

    print("largest lateral error [mm] in a side wind of")
    print(" " * 12, *(f"{20.0 * scale:6.0f} m/s" for scale in scales))
    for name in controllers:
        errors = [1e3 * next(results)["lateral_max_m"] for _ in scales]
        print(name.ljust(12), *(f"{error:10.1f}" for error in errors))
