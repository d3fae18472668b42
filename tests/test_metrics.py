import json
import math

import numpy as np
import pytest

import lpvmpc
from lpvmpc.interface import Command
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import (
    DETAILS,
    KEYS,
    details,
    jerk_rms,
    largest,
    metrics,
    rms,
    step_times,
    wrap,
)


class Straight:
    def reset(self, rng): ...

    def command(self, state, preview):
        return Command(0.0, 0.0)


@pytest.fixture
def log(point_plant, straight):
    return simulate(point_plant, Straight(), straight)


def test_the_keys_are_those_of_the_contract(log):
    assert tuple(metrics(log)) == KEYS


def test_the_result_is_json_without_nan(log):
    json.dumps(metrics(log), allow_nan=False)


def test_errors_are_taken_over_every_instant(log):
    n = len(log)
    log.columns["ey_m"] = np.zeros(n)
    log.columns["ey_m"][0] = -0.3  # the first instant counts like any other
    result = metrics(log)
    assert result["lateral_max_m"] == pytest.approx(0.3)
    assert result["lateral_rmse_m"] == pytest.approx(0.3 / math.sqrt(n))


def test_details_hold_what_a_comparison_needs_beside_the_metrics(log):
    n, Ts = len(log), log.meta["Ts"]
    log.columns["ey_m"] = np.where(np.arange(n) < 0.04 * n, 1.0, -0.01)  # 4 % of the instants
    log.columns["ax_cmd_mps2"] = np.where(np.arange(n) % 2, 0.33, 0.0)
    log.timing["step_us"] = np.full(n, 0.5e6 * Ts)
    log.timing["step_us"][:3] = 1.5e6 * Ts
    found = details(log)
    assert tuple(found) == DETAILS
    assert found["lateral_p95_m"] == pytest.approx(0.01)
    assert found["drive_rate_rms_mps3"] == pytest.approx(0.33 / Ts)
    assert (found["steps"], found["late_steps"]) == (n, 3)
    json.dumps(found, allow_nan=False)


def test_the_hash_of_a_trace_is_that_of_its_columns_and_of_no_times(log):
    first = details(log)["trace_sha256"]
    log.timing["step_us"] += 1.0
    assert details(log)["trace_sha256"] == first
    log.columns["vx_mps"][5] += 1e-12
    assert details(log)["trace_sha256"] != first


def test_course_adds_the_sideslip_to_the_heading(log):
    n = len(log)
    log.columns["epsi_rad"] = np.full(n, -0.02)
    log.columns["vy_mps"] = log.columns["vx_mps"] * math.tan(0.02)
    result = metrics(log)
    assert result["heading_rmse_rad"] == pytest.approx(0.02)
    assert result["course_rmse_rad"] == pytest.approx(0.0, abs=1e-12)


def test_distance_is_the_length_of_the_driven_line(log):
    # The last control instant lies up to one period (0.33 m) before the end.
    assert 99.6 < metrics(log)["distance_m"] <= 100.0


def test_largest_lateral_acceleration_has_no_sign(log):
    log.columns["ay_mps2"][3] = -4.2
    assert metrics(log)["lateral_acc_max_mps2"] == pytest.approx(4.2)


def test_solver_record_counts_solved_and_refused(log):
    log.meta["has_qp"] = True
    log.columns["solved"][:] = True
    log.columns["solved"][5] = False
    log.columns["fallback"][5] = 1
    log.columns["kkt_residual"][:] = 1e-9
    log.columns["kkt_residual"][5] = 1.0  # a refused solve does not count as an answer
    record = metrics(log)["qp"]
    assert record == {"solved": len(log) - 1, "fallback": 1, "max_kkt_residual": 1e-9}


def test_a_controller_without_qp_has_no_solver_record(log):
    assert metrics(log)["qp"] == {"solved": 0, "fallback": 0, "max_kkt_residual": None}


def test_an_empty_run_measures_nothing(log):
    log.columns = {name: column[:0] for name, column in log.columns.items()}
    log.timing = {name: column[:0] for name, column in log.timing.items()}
    result = metrics(log)
    assert result["lateral_rmse_m"] is None and result["distance_m"] == 0.0
    assert result["step_time_us"] == {"mean": None, "p50": None, "p99": None, "max": None}


def test_step_times_are_those_of_numpy():
    times = np.arange(1.0, 101.0)
    assert step_times(times) == pytest.approx(
        {"mean": 50.5, "p50": 50.5, "p99": np.percentile(times, 99), "max": 100.0}
    )


def test_angles_wrap_to_half_a_turn():
    angles = np.array([0.0, 3.0, 4.0, -4.0, 7.0])
    expected = np.arctan2(np.sin(angles), np.cos(angles))
    assert np.allclose(wrap(angles), expected, rtol=0.0, atol=1e-12)


def test_rms_and_largest_of_nothing_are_none():
    assert rms(np.zeros(0)) is None and largest(np.zeros(0)) is None


def test_jerk_is_the_change_of_the_lateral_acceleration(log):
    n, Ts = len(log), log.meta["Ts"]
    log.columns["ay_mps2"] = np.where(np.arange(n) % 2, 0.3, -0.3)
    assert jerk_rms(log) == pytest.approx(0.6 / Ts)
    log.columns["ay_mps2"] = np.full(1, 0.3)
    assert jerk_rms(log) is None


def test_the_public_name_metrics_is_the_function():
    assert lpvmpc.metrics is metrics
