"""A controller of your own: one class with two methods, driven on the slalom.

    python examples/own_controller.py

The same class can be named on the command line, from the folder it lies in:

    lpvmpc track --controller own_controller:Follow --scenario slalom
"""

import numpy as np

from lpvmpc import Command, Plant, Preview, State, load_scenario, metrics, simulate


class Follow:
    """Steer with the road's curvature, and against the errors.

    A controller sees the car's state and the road ahead, never MuJoCo. It must have these two
    methods; what else it may have (a name, weights, a longer preview) is in lpvmpc/interface.py.
    """

    name = "follow"

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last run. Whatever is random in a controller must come from `rng`."""
        self.integral = 0.0

    def command(self, state: State, preview: Preview) -> Command:
        """Called every 33 ms: a steering angle [rad], left positive, and acceleration [m/s2]."""
        self.integral += 0.033 * preview.ey
        # preview[k] is the road k periods ahead; a few of them make up for the servo's lag
        steer = 2.8 * preview.kappa[3] - 0.3 * preview.ey - 0.8 * preview.epsi
        steer -= 0.05 * self.integral
        return Command(delta=float(np.clip(steer, -0.5, 0.5)), ax=preview.vx_ref[3] - state.vx)


if __name__ == "__main__":
    log = simulate(Plant(), Follow(), load_scenario("slalom"))
    result = metrics(log)
    if not result["completed"]:
        print(f"Lost after {result['distance_m']:.0f} m: {result['reason']}")
    print(f"lateral error: RMSE {1e3 * result['lateral_rmse_m']:.0f} mm, "
          f"largest {1e3 * result['lateral_max_m']:.0f} mm")
