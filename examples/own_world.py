"""A world of your own: what reality does and the controller is not told, drawn by the seed.

    python examples/own_world.py

A range is drawn once a run. The same table as a TOML file goes to the command line, as
`--world slippery.toml`; docs/worlds.md has all names.
"""

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate

SLIPPERY = {
    "name": "slippery",
    "base": "rtk",  # the sensors of a test car, and a Kalman filter behind them
    "latency": [0.0, 0.04],  # of the commands [s]
    "road": {"friction": [0.5, 0.8]},  # factor on what the tires hold
    "car": {"load": [0.0, 450.0]},  # kg
}

if __name__ == "__main__":
    plant, scenario = Plant(), load_scenario("double-lane-change")
    print("seed  friction   load  latency  largest lateral error")
    for seed in range(3):
        log = simulate(plant, load_controller("lpv-mpc"), scenario, world=SLIPPERY, seed=seed)
        drawn, result = log.meta["world"]["drawn"], metrics(log)
        print(f"{seed:4} {drawn['road']['friction']:9.2f} {drawn['car']['load']:4.0f} kg "
              f"{1e3 * drawn['latency']:5.0f} ms {1e3 * result['lateral_max_m']:19.1f} mm")
