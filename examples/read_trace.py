"""Save a run and read its trace: what every column is called, and who used how much grip.

    python examples/read_trace.py

`lpvmpc track` leaves the same files in runs/SCENARIO-CONTROLLER. Units are in the names of the
columns; those of a wheel end in fl, fr, rl, rr.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from lpvmpc import Plant, load_controller, load_scenario, simulate

if __name__ == "__main__":
    folder = Path("example-run")
    folder.mkdir(exist_ok=True)
    log = simulate(Plant(), load_controller("lpv-mpc"), load_scenario("slalom"))
    log.write(folder)

    table = pq.read_table(folder / "trace.parquet")
    # with pandas: trace = pandas.read_parquet(folder / "trace.parquet")
    print(f"{table.num_rows} control periods, {table.num_columns} columns:")
    print(", ".join(table.column_names[:8]), "...")
    facts = {key.decode(): value for key, value in table.schema.metadata.items()}
    version, seed = json.loads(facts["versions"])["lpvmpc"], json.loads(facts["seed"])
    print(f"made by lpvmpc {version} with seed {seed}")

    ey = table["ey_m"].to_numpy()
    worst = int(np.argmax(np.abs(ey)))
    print(f"largest lateral error: {1e3 * ey[worst]:.2f} mm at {table['s_m'][worst]} m")
    for wheel in ("fl", "fr", "rl", "rr"):
        Fx, Fy, Fz, mu = (table[name].to_numpy() for name in (
            f"Fx_{wheel}_N", f"Fy_{wheel}_N", f"Fz_{wheel}_N", f"mu_{wheel}"))
        print(f"{wheel}: at most {100.0 * np.max(np.hypot(Fx, Fy) / (mu * Fz)):.0f} % of its grip")
