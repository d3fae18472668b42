"""Two controllers on one road: the adaptive LPV-MPC and Stanley's law in a double lane change.

    python examples/compare_two.py

`lpvmpc compare --controllers lpv-mpc stanley --scenario double-lane-change --render` does the same
with pictures and a video.
"""

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate

NAMES = ("lpv-mpc", "stanley")

if __name__ == "__main__":
    # both get the same car, the same road and the same tuning budget behind their weights
    plant, scenario = Plant(), load_scenario("double-lane-change")
    results = {}
    for name in NAMES:
        log = simulate(plant, load_controller(name), scenario, name=name)
        results[name] = metrics(log)

    print(f"{scenario.name}, {scenario.path.length:.0f} m".ljust(32),
          *(name.rjust(12) for name in NAMES))
    for label, key, scale in (
        ("lateral error, RMSE [mm]", "lateral_rmse_m", 1e3),
        ("lateral error, largest [mm]", "lateral_max_m", 1e3),
        ("course error, RMSE [mrad]", "course_rmse_rad", 1e3),
        ("control step, median [us]", ("step_time_us", "p50"), 1.0),
    ):
        values = []
        for result in results.values():
            value = result[key[0]][key[1]] if isinstance(key, tuple) else result[key]
            values.append(f"{scale * value:12.2f}")
        print(label.ljust(32), *values)
