"""One weight of the LPV-MPC changed: what it costs to be lenient about the lateral error.

    python examples/change_a_weight.py

Weights have names (lpvmpc/control/cost.py lists them). From the command line they come from
a file: lpvmpc track --weights FILE.toml
"""

from dataclasses import replace

import numpy as np

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate

if __name__ == "__main__":
    plant, scenario = Plant(), load_scenario("double-lane-change")
    shipped = load_controller("lpv-mpc").weights  # a frozen dataclass: the tuned weights
    print("q_ey      RMSE of the lateral error   RMS of the steering rate")
    for factor in (1.0, 0.1, 0.01):
        weights = replace(shipped, q_ey=factor * shipped.q_ey)
        log = simulate(plant, load_controller("lpv-mpc", weights=weights), scenario)
        rate = np.diff(log.columns["delta_cmd_rad"]) / plant.Ts
        print(f"{weights.q_ey:9.3f} {1e3 * metrics(log)['lateral_rmse_m']:15.2f} mm "
              f"{np.sqrt(np.mean(rate**2)):24.4f} rad/s")
