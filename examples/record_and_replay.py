"""Record a drive, and replay the recording on two cars: which of them has made it?

    python examples/record_and_replay.py

The recording is a CSV file with time, steering angle, speed and yaw rate, as a test car's logger
writes it. `lpvmpc replay --recording drive.csv` scores the packaged car on yours, `--fit` finds the
car behind it.
"""

from pathlib import Path

import numpy as np

from lpvmpc import Plant, load_controller, load_scenario, simulate
from lpvmpc.identify.candidate import Candidate
from lpvmpc.identify.follow import replay
from lpvmpc.identify.recording import read_recording

COLUMNS = ("t_s", "delta_rad", "vx_mps", "r_radps", "vy_mps")

if __name__ == "__main__":
    plant = Plant()
    log = simulate(plant, load_controller("stanley"), load_scenario("double-lane-change"))
    rows = np.column_stack([log.columns[name] for name in COLUMNS])
    file = Path("drive.csv")
    np.savetxt(file, rows, delimiter=",", header=",".join(COLUMNS), comments="")

    recording = read_recording(file)
    itself = Candidate.of(plant.nominal_model)
    softer = itself.with_values({"Cf": 0.7 * itself.value("Cf")})  # N/rad, of the front axle
    motion = replay([itself.model(), softer.model()], recording)
    for name, r in zip(("the car itself", "softer in front"), motion.r, strict=True):
        error = float(np.sqrt(np.mean((r - recording.r) ** 2)))
        print(f"{name:16} yaw rate off by {error:.4f} rad/s of {np.ptp(recording.r):.2f}")
