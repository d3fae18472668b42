"""A road of your own: a CSV file with the centre line, here a chicane, driven by the LPV-MPC.

    python examples/own_track.py

The file may also be given to the command: lpvmpc track --scenario chicane.csv
"""

from pathlib import Path

import numpy as np

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate


def write_chicane(file: Path) -> None:
    """A straight, a step of 4 m to the left within 60 m, a straight; a point every 5 m.

    Each line is a point: x and y [m], and how far the road reaches to the right and left [m]. Two
    more columns are possible, vx_mps and wind_mps; without a speed, one is planned.
    """
    x = np.arange(0.0, 201.0, 5.0)
    turn = np.clip((x - 60.0) / 60.0, 0.0, 1.0)
    y = 2.0 * (1.0 - np.cos(np.pi * turn))
    rows = np.column_stack([x, y, np.full_like(x, 3.0), np.full_like(x, 3.0)])
    header = "x_m,y_m,w_tr_right_m,w_tr_left_m"
    np.savetxt(file, rows, fmt="%.3f", delimiter=",", header=header)  # its header begins with "# "


if __name__ == "__main__":
    file = Path("chicane.csv")
    write_chicane(file)
    # the speed is planned: at most 15 m/s, and 60 % of the lateral acceleration the car can hold
    scenario = load_scenario(file, v_max=15.0, grip=0.6)
    print(scenario.source)  # how far the line was moved to make its curvature continuous
    print(f"{scenario.path.length:.0f} m, {scenario.reference_duration:.1f} s")

    log = simulate(Plant(), load_controller("lpv-mpc"), scenario)
    result = metrics(log)
    print(f"completed: {result['completed']}, largest lateral error "
          f"{1e3 * result['lateral_max_m']:.1f} mm, largest lateral acceleration "
          f"{result['lateral_acc_max_mps2']:.1f} m/s2")
