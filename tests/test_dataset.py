import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lpvmpc.errors import DataError
from lpvmpc.learn import dataset, manoeuvres
from lpvmpc.learn.dataset import ALPHA_LARGE, ALPHA_SMALL, COLUMNS, secant_stiffness
from lpvmpc.plant.mjcf import car_sha256, compile_model


@pytest.fixture(scope="module")
def columns(plant):
    rows = manoeuvres.drive(plant, "sine-sweep", np.random.default_rng(3), friction=1.0)
    return dataset.table_of(
        rows, 7, "sine-sweep", model=plant.model, friction=1.0, mass=plant.params.m, Ts=plant.Ts
    )


@pytest.fixture
def write(tmp_path, columns):
    """Writes a data file, perhaps with changed columns or facts; returns its path."""

    def call(changes=None, facts=None, drop=()):
        values = {**columns, **(changes or {})}
        file = tmp_path / "data.parquet"
        fields = [f for f in dataset.schema() if f.name not in drop]
        meta = dataset.metadata({"seed": 1})
        meta |= {k: json.dumps(v) for k, v in (facts or {}).items()}
        schema = pa.schema(fields, metadata=meta)
        pq.write_table(pa.table([pa.array(values[f.name]) for f in fields], schema=schema), file)
        return file

    return call


# Labels -----------------------------------------------------------------------------------------


def test_the_label_is_force_over_slip_where_slip_is_large(columns):
    for axle in "fr":
        alpha, C = columns[f"alpha_{axle}_rad"], columns[f"C{axle}_Nprad"]
        large = np.abs(alpha) >= ALPHA_LARGE
        assert large.any()
        Fy = columns[f"Fy{axle}_N"][large]
        np.testing.assert_allclose(C[large] * alpha[large], Fy, rtol=1e-12)


def test_the_label_is_the_slope_where_slip_is_small(columns):
    for axle in "fr":
        small = np.abs(columns[f"alpha_{axle}_rad"]) <= ALPHA_SMALL
        assert small.any()
        slope = columns[f"slope_zero_{axle}_Nprad"][small]
        np.testing.assert_array_equal(columns[f"C{axle}_Nprad"][small], slope)


def test_the_label_is_continuous_in_the_slip():
    # a saturating tire: the label may change between neighbours no faster than the tire curve
    alpha = np.linspace(-0.02, 0.02, 40001)
    C = secant_stiffness(alpha, 6000.0 * np.sin(1.4 * np.arctan(15.0 * alpha)), 126000.0)
    assert np.abs(np.diff(C)).max() < 5.0  # N/rad per microradian step of 1e-6
    assert np.all((C > 118e3) & (C <= 126000.0 + 1e-6))


def test_the_label_survives_a_slip_of_zero():
    assert secant_stiffness(0.0, 0.0, 1e5) == 1e5
    assert np.isfinite(secant_stiffness([0.0, 1e-300, -1e-9], [0.0, 5.0, -5.0], 1e5)).all()


def test_labels_are_per_axle_and_of_the_size_of_the_car(columns, plant):
    for axle, nominal in (("f", plant.params.Cf), ("r", plant.params.Cr)):
        small = np.abs(columns[f"alpha_{axle}_rad"]) <= ALPHA_SMALL
        # 25 %: load transfer by braking and cornering
        np.testing.assert_allclose(columns[f"C{axle}_Nprad"][small], nominal, rtol=0.25)


def test_slip_angles_are_the_single_tracks_after_relaxation(columns, plant):
    # the kinematic angle belongs to one physics step earlier: 1 ms of at most 3 rad/s
    vx, vy, r = columns["vx_mps"], columns["vy_mps"], columns["r_radps"]
    front = columns["delta_rad"] - np.arctan2(vy + plant.params.lf * r, vx)
    assert np.abs(front - columns["alpha_kin_f_rad"]).max() < 4e-3
    # positive slip makes a force to the left
    sure = np.abs(columns["alpha_f_rad"]) > 0.01
    assert np.all(columns["alpha_f_rad"][sure] * columns["Fyf_N"][sure] > 0.0)


def test_local_slopes_are_the_derivative_of_the_force(columns):
    # along a run force follows slip: dF = slope dalpha, but for load and drive force
    dF, da = np.diff(columns["Fyf_N"]), np.diff(columns["alpha_f_rad"])
    slope = 0.5 * (columns["slope_f_Nprad"][1:] + columns["slope_f_Nprad"][:-1])
    assert np.corrcoef(dF, slope * da)[0, 1] > 0.99


# Files ------------------------------------------------------------------------------------------


def test_the_contracts_columns_come_first_and_carry_units():
    first = (
        "run, manoeuvre, t_s, vx_mps, vy_mps, delta_rad, ax_mps2, r_radps, Cf_Nprad, Cr_Nprad, "
        "Fyf_N, Fyr_N, alpha_f_rad, alpha_r_rad, Fzf_N, Fzr_N, mu, wind_mps"
    )
    assert list(COLUMNS)[:18] == first.split(", ")


def test_a_file_is_read_as_it_was_written(write, columns):
    data = dataset.read(write())
    assert len(data) == len(columns["run"]) and data.kinds == ["sine-sweep"]
    assert data.meta["seed"] == 1 and data.meta["columns"] == COLUMNS
    for name in COLUMNS:
        np.testing.assert_array_equal(data[name], columns[name])


def test_a_missing_file_says_how_to_make_it(tmp_path):
    with pytest.raises(DataError, match="no data file.*collect.py"):
        dataset.read(tmp_path / "none.parquet")


@pytest.mark.parametrize("kept", [0, 3, 1000, -20])
def test_a_truncated_file_is_refused(write, kept):
    file = write()
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(DataError, match="damaged or no Parquet file"):
        dataset.read(file)


def test_damage_inside_a_file_is_refused(write):
    file = write()
    raw = bytearray(file.read_bytes())
    raw[40:4000] = bytes(3960)
    file.write_bytes(raw)
    with pytest.raises(DataError, match="damaged"):
        dataset.read(file)


def test_another_version_is_refused(write):
    with pytest.raises(DataError, match="'lpvmpc-stiffness-0'.*must have 'lpvmpc-stiffness-1'"):
        dataset.read(write(facts={"format": "lpvmpc-stiffness-0"}))


def test_a_foreign_parquet_file_is_refused(tmp_path):
    file = tmp_path / "foreign.parquet"
    pq.write_table(pa.table({"x": [1.0]}), file)
    with pytest.raises(DataError, match="format None"):
        dataset.read(file)


def test_a_missing_column_is_named(write):
    with pytest.raises(DataError, match="lacks the column Fzr_N"):
        dataset.read(write(drop=("Fzr_N",)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_no_numbers_are_named_with_their_place(write, columns, bad):
    broken = columns["Cr_Nprad"].copy()
    broken[5] = bad
    with pytest.raises(DataError, match=f"hold {bad} in column Cr_Nprad, row 5"):
        dataset.read(write({"Cr_Nprad": broken}))


@pytest.mark.parametrize(
    ("name", "bad"),
    [("vx_mps", 1e300), ("mass_kg", 0.0), ("friction", 0.0), ("mu", -1.0), ("run", -1),
     ("alpha_f_rad", 2.0), ("Fzf_N", -1.0), ("Cf_Nprad", 1e12)],
)
def test_what_no_car_does_is_named_with_its_place(write, columns, name, bad):
    broken = columns[name].copy()
    broken[5] = bad
    with pytest.raises(DataError, match=f"in column {name}, row 5, but no road car is outside"):
        dataset.read(write({name: broken}))
    with pytest.raises(DataError, match=f"in column {name}, row 5"):
        list(dataset.batches(write({name: broken})))


def test_a_column_that_is_there_twice_is_refused(tmp_path, columns):
    fields = [*dataset.schema(), dataset.schema().field("vx_mps")]
    arrays = [pa.array(columns[field.name]) for field in fields]
    schema = pa.schema(fields, metadata=dataset.metadata({"seed": 1}))
    pq.write_table(pa.table(arrays, schema=schema), tmp_path / "twice.parquet")
    with pytest.raises(DataError, match="has the column vx_mps 2 times"):
        dataset.read(tmp_path / "twice.parquet")


def test_rows_without_a_value_are_refused(write, columns):
    kinds = columns["manoeuvre"].astype(object)
    kinds[3] = None
    with pytest.raises(DataError, match="column manoeuvre has rows without a value"):
        dataset.read(write({"manoeuvre": kinds}))


def test_no_damaged_byte_is_taken_for_the_whole_file(tmp_path, columns):
    file = tmp_path / "data.parquet"
    some = {name: values[:200] for name, values in columns.items()}
    dataset.write(file, some, {"seed": 1})
    raw, whole = file.read_bytes(), dataset.read(file)
    assert whole.checked
    rng, refused = np.random.default_rng(2), 0
    for _ in range(150):
        broken = bytearray(raw)
        broken[int(rng.integers(len(raw)))] ^= int(rng.integers(1, 256))
        file.write_bytes(broken)
        try:
            found = dataset.read(file)
        except DataError:
            refused += 1
            continue
        assert not found.checked or found.meta == whole.meta
        for name in COLUMNS:
            np.testing.assert_array_equal(found[name], whole[name])
    assert refused > 100


def test_an_empty_file_is_refused(write, columns):
    with pytest.raises(DataError, match="no rows"):
        dataset.read(write({name: values[:0] for name, values in columns.items()}))


def test_batches_of_a_large_file_take_no_more_memory_than_of_a_small_one(tmp_path, columns):
    peaks = []
    for groups in (4, 40):
        file = tmp_path / f"{groups}.parquet"
        fields = dataset.schema().with_metadata(dataset.metadata({"seed": 1}))
        arrays = [np.resize(columns[name], 2000) for name in COLUMNS]
        table = pa.table([pa.array(values) for values in arrays], schema=fields)
        with pq.ParquetWriter(file, fields) as writer:
            for _ in range(groups):
                writer.write_table(table)
        before, peak, rows = pa.total_allocated_bytes(), 0, 0
        for batch in dataset.batches(file, rows=1000):
            rows += len(batch["vx_mps"])
            peak = max(peak, pa.total_allocated_bytes() - before)
        assert rows == 2000 * groups
        peaks.append(peak)
    assert peaks[1] < 1.5 * peaks[0]


# The car ----------------------------------------------------------------------------------------


def test_the_cars_hash_sees_physics_and_nothing_else(plant):
    bare, drawn = compile_model(visual=False), compile_model(visual=True)
    assert car_sha256(bare) == car_sha256(drawn) == car_sha256(plant.model)
    bare.numeric("tire_f").data[13] *= 1.001
    assert car_sha256(bare) != car_sha256(drawn)
    drawn.jnt_stiffness[1] += 1.0
    assert car_sha256(drawn) != car_sha256(plant.model)
