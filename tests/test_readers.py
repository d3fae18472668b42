"""Readers against inputs that nobody thought of: content, or one sentence, and nothing else."""

import hashlib
import json
import math
import tomllib

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from lpvmpc.car.tir import read_tir
from lpvmpc.control.stiffness.network_file import load_weights
from lpvmpc.control.weights_file import read_weights, write_weights
from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.cli import one_line
from lpvmpc.learn import dataset
from lpvmpc.road.track_file import read_csv
from lpvmpc.sim.values import value_of
from lpvmpc.sim.world import World, load_world
from lpvmpc.tune.checkpoint import SearchState

EASY = settings(
    max_examples=60, deadline=None, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
NUMBER = st.one_of(
    st.integers(-10, 10), st.integers(), st.floats(), st.sampled_from([0.0, 1e300, 10**30])
)
PLAIN = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBER, st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=4),
                            st.dictionaries(st.text(max_size=6), inner, max_size=4)),
    max_leaves=8,
)
CELL = st.one_of(
    st.floats(-200, 200).map(str), st.sampled_from(["x_m", "y_m", "#", "", "nan", "1e9", "\x00"]),
    st.text(max_size=5),
)


def refused(read, *given_):
    """What was read; None where it was refused in one printable sentence."""
    try:
        return read(*given_)
    except LPVMPCError as error:
        assert len(str(error)) > 10 and one_line(str(error)).isprintable()
        return None


@EASY
@given(raw=st.binary(max_size=400))
@example(raw=b"\xff\xfe")
@pytest.mark.parametrize("read", [read_csv, read_weights, load_world, read_tir, dataset.read])
def test_bytes_are_content_or_one_sentence(tmp_path, read, raw):
    file = tmp_path / "file.toml"
    file.write_bytes(raw)
    refused(read, file)
    refused(load_weights, "network", file)


@EASY
@given(rows=st.lists(st.lists(CELL, max_size=5), max_size=12),
       mark=st.sampled_from([",", ";", "\t"]))
def test_a_table_is_a_track_of_finite_numbers_or_one_sentence(tmp_path, rows, mark):
    file = tmp_path / "road.csv"
    text = "\n".join(["# x_m,y_m".replace(",", mark), *(mark.join(row) for row in rows)])
    file.write_text(text, encoding="utf-8", newline="")
    track = refused(read_csv, file)
    assert track is None or (np.isfinite(track.xy).all() and track.xy.shape[1] == 2)


@EASY
@given(xy=st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=1, max_size=20))
def test_what_was_written_as_a_track_is_read_to_the_last_bit(tmp_path, xy):
    file = tmp_path / "road.csv"
    file.write_text("# x_m,y_m\n" + "\n".join(f"{x!r},{y!r}" for x, y in xy))
    np.testing.assert_array_equal(read_csv(file).xy, xy)


@EASY
@given(table=st.dictionaries(
    st.sampled_from(["base", "latency", "sensing", "car", "road", "air", "patches", "about"]),
    st.one_of(PLAIN, st.dictionaries(
        st.sampled_from(["friction", "Cf", "load", "density", "scale", "r", "position", "lane"]),
        PLAIN, max_size=3)),
    max_size=4,
))
def test_a_table_is_a_world_or_one_sentence(table):
    world = refused(load_world, table)
    if world is not None:
        assert isinstance(world, World)
        world.sample(np.random.default_rng(0))


@EASY
@given(value=PLAIN)
def test_a_value_of_a_world_is_finite_or_one_sentence(value):
    found = refused(value_of, "car Cf", value)
    assert found is None or math.isfinite(getattr(found, "low", found))


@EASY
@given(weights=st.dictionaries(st.from_regex(r"[a-z_]{1,8}", fullmatch=True),
                               st.floats(allow_nan=False, allow_infinity=False), min_size=1,
                               max_size=4),
       note=st.text(st.characters(max_codepoint=0x7E), max_size=20))
def test_weights_are_read_as_they_were_written(tmp_path, weights, note):
    file = tmp_path / "w.toml"
    write_weights(file, "stanley", weights, {"note": note, "seeds": [1, 2]})
    assert read_weights(file) == weights
    assert tomllib.loads(file.read_text())["record"]["note"] == note


@EASY
@given(value=PLAIN)
def test_a_saved_search_is_a_search_or_one_sentence(value):
    refused(SearchState.from_json, value)
    body = {"format": 1, "state": value}
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()
    refused(SearchState.from_json, {**body, "sha256": digest})
