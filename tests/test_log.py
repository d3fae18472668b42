import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from lpvmpc.errors import OutputError
from lpvmpc.interface import Command
from lpvmpc.kit.files import write_json, write_table, write_text
from lpvmpc.sim.log import MOTION, PER_WHEEL, WHEELS
from lpvmpc.sim.loop import simulate


class Noisy:
    """Steers at random, plans at random and takes any time it likes: what a trace must survive."""

    Np = 4

    class Diagnostics:
        solved, fallback, kkt_residual = True, "shifted", 1e-9
        build_us, solve_us, check_us = 1.0, 2.0, 3.0

    def reset(self, rng):
        self.rng, self.diagnostics = rng, self.Diagnostics()

    def command(self, state, preview):
        self.diagnostics.prediction = self.rng.normal(size=(5, 5))
        return Command(1e-4 * self.rng.normal(), 0.0)


def test_the_same_run_gives_the_same_bytes(point_plant_class, straight, tmp_path):
    contents = []
    for i in range(2):
        folder = tmp_path / str(i)
        folder.mkdir()
        simulate(point_plant_class(), Noisy(), straight, seed=3).write(folder)
        contents.append((folder / "trace.parquet").read_bytes())
    assert contents[0] == contents[1]


def test_another_seed_gives_other_bytes(point_plant_class, straight, tmp_path):
    contents = []
    for seed in (3, 4):
        simulate(point_plant_class(), Noisy(), straight, seed=seed).write(tmp_path)
        contents.append((tmp_path / "trace.parquet").read_bytes())
    assert contents[0] != contents[1]


def test_the_trace_has_the_columns_of_the_contract(point_plant, straight, tmp_path):
    log = simulate(point_plant, Noisy(), straight, seed=1)
    log.write(tmp_path)
    table = pq.read_table(tmp_path / "trace.parquet")
    wheels = [name.format(wheel) for name in PER_WHEEL for wheel in WHEELS]
    plan = [f"pred_{axis}_m_{k}" for k in range(5) for axis in "xy"]
    qpos = [f"qpos_{i}" for i in range(7)]
    expected = {*MOTION, "wind_mps", "solved", "fallback", *wheels, *plan, *qpos}
    assert set(table.column_names) == expected
    assert str(table.schema.field("solved").type) == "bool"
    assert str(table.schema.field("fallback").type) == "int8"
    for name, column in log.columns.items():
        assert np.array_equal(table[name].to_numpy(), column, equal_nan=column.dtype.kind == "f")


def test_the_prediction_is_in_world_coordinates(point_plant, straight, tmp_path):
    log = simulate(point_plant, Noisy(), straight, seed=1)
    rng = np.random.default_rng(1)
    ey = rng.normal(size=(5, 5))[:, 3]
    rng.normal()
    # On a straight along x at 10 m/s, the plan's points are 0.33 m apart and ey to the left.
    assert [log.columns[f"pred_y_m_{k}"][0] for k in range(5)] == pytest.approx(ey)
    assert [log.columns[f"pred_x_m_{k}"][0] for k in range(5)] == pytest.approx(
        0.33 * np.arange(5)
    )


def test_the_trace_says_how_it_was_made_and_not_when(point_plant, straight, tmp_path):
    simulate(point_plant, Noisy(), straight, seed=1, options={"wind_scale": 0.5}).write(tmp_path)
    metadata = pq.read_schema(tmp_path / "trace.parquet").metadata
    assert json.loads(metadata[b"seed"]) == 1
    assert json.loads(metadata[b"options"]) == {"delay": 0, "wind_scale": 0.5}
    assert {"numpy", "mujoco", "lpvmpc"} <= set(json.loads(metadata[b"versions"]))
    assert b"wall_s" not in metadata


def test_times_are_in_their_own_file(point_plant, straight, tmp_path):
    simulate(point_plant, Noisy(), straight).write(tmp_path)
    table = pq.read_table(tmp_path / "timing.parquet")
    assert table.column_names == ["t_s", "step_us", "build_us", "solve_us", "check_us", "wall_us"]
    assert table["solve_us"][0].as_py() == 2.0


def test_a_failed_write_leaves_nothing_under_the_name(tmp_path):
    blocked = tmp_path / "trace.parquet"
    blocked.mkdir()  # a folder in the way makes the last step fail
    with pytest.raises(OutputError, match=r"Cannot write .*trace\.parquet"):
        write_table(blocked, {"a": np.zeros(3)}, {})
    assert blocked.is_dir()
    with pytest.raises(OutputError, match="Cannot write"):
        write_table(tmp_path / "absent" / "trace.parquet", {"a": np.zeros(3)}, {})
    with pytest.raises(OutputError, match="Cannot write"):
        write_json(tmp_path / "absent" / "metrics.json", {})


def test_json_refuses_nan(tmp_path):
    with pytest.raises(ValueError, match="Out of range float"):
        write_json(tmp_path / "metrics.json", {"a": float("nan")})
    assert not (tmp_path / "metrics.json").exists()


def test_a_text_is_written_whole_and_one_that_cannot_be_is_one_sentence(tmp_path):
    write_text(tmp_path / "a.md", "R\N{SUPERSCRIPT TWO}\n")
    assert (tmp_path / "a.md").read_bytes() == b"R\xc2\xb2\n"  # whatever the locale
    assert [file.name for file in tmp_path.iterdir()] == ["a.md"]
    with pytest.raises(OutputError, match=r"^Cannot write '.*nowhere/a\.md': No such file"):
        write_text(tmp_path / "nowhere" / "a.md", "lost")
