import math
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.bicycle import CORRECTED, NX, Bicycle, lpv
from lpvmpc.errors import LPVMPCError, UnknownNameError
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.plant.mjcf import parameters
from lpvmpc.plant.plant import Plant
from lpvmpc.studies import report, runner, straight
from lpvmpc.studies.names import BROKEN, STUDIES
from lpvmpc.studies.parts import braking, steering
from lpvmpc.studies.parts.circle import slope_at_zero
from lpvmpc.studies.reference import golden_tire, suspension
from lpvmpc.studies.reference.broken_cars import break_car
from lpvmpc.studies.reference.circle_formulas import Linear
from lpvmpc.studies.reference.lateral_model import frequency_response, lateral_model, response
from lpvmpc.studies.study import CarUnderTest, StudyFinding, StudyResult, load_study, relative_error


@pytest.fixture(scope="module")
def car():
    return CarUnderTest.packaged()


def failed(result):
    return [finding.figure for finding in result.findings if not finding.ok]


# --- limits and findings ---


@pytest.mark.parametrize(
    "limit, inside, outside",
    [
        (Limit.at_most(2.0), [2.0, -1e9], [2.0001, math.inf, math.nan]),
        (Limit.at_least(2.0), [2.0, 1e9], [1.9999, -math.inf, math.nan]),
        (Limit.between(-1.0, 1.0), [-1.0, 0.0, 1.0], [-1.001, 1.001, math.nan]),
        (Limit.near(5.0, 0.5), [4.5, 5.5], [4.49, 5.51]),
        (Limit.percent(200.0, 3.0), [194.0, 206.0], [193.9, 206.1]),
        (Limit.percent(-200.0, 3.0), [-194.0, -206.0], [-193.9, -206.1, 200.0]),
    ],
)
def test_a_limit_holds_from_both_sides(limit, inside, outside):
    assert all(limit.allows(value) for value in inside)
    assert not any(limit.allows(value) for value in outside)


def test_a_limit_says_what_it_is():
    assert Limit.at_most(1e-6).text == "<= 1e-06"
    assert Limit.at_least(0.9).text == ">= 0.9"
    assert Limit.near(2.45, 0.25).text == "2.45 +- 0.25"
    assert Limit.percent(4.39, 4.0).text == "4.39 +- 4 %"
    assert Limit.between(4.5, 7.5).text == "4.5 to 7.5"


def test_the_verdict_follows_from_value_and_limit():
    result = StudyResult("tire")
    result.find("good", 1.0, "m", Limit.at_most(1.0), "why")
    assert result.ok
    result.find("bad", 1.1, "m", Limit.at_most(1.0), "why")
    assert failed(result) == ["bad"] and not result.ok


def test_a_figure_that_does_not_fit_the_table_is_refused():
    with pytest.raises(AssertionError):
        StudyFinding(study="tire", figure="x" * 39, value=1.0, unit="m", limit=Limit.at_most(1.0))
    with pytest.raises(AssertionError):
        StudyFinding(  # it would split the cell
            study="tire", figure="a | b", value=1.0, unit="m", limit=Limit.at_most(1.0)
        )


def test_every_study_has_its_module():
    for name in STUDIES:
        assert callable(load_study(name)), name


def test_an_unknown_study_is_answered_with_the_list():
    with pytest.raises(UnknownNameError, match="Unknown study 'tires'; the choices are .*tire"):
        load_study("tires")


# --- report ---


@pytest.fixture
def result():
    result = StudyResult("tire", "How it was done.", seconds=1.2)
    result.find("some length", 1.23456789, "m", Limit.near(1.2, 0.1), "a book", target=True)
    result.find("another length", math.nan, "m", Limit.percent(123456.0, 0.25), "a book")
    result.tables.append(Table("t", "Numbers", ("a", "b"), [("x", 0.123456), ("y", 3)]))
    return result


def test_the_printed_table_has_80_columns(result):
    lines = report.table([result]).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0] == "Tire: slip characteristics (tire): 1 of 2 FAILED, 1 s CPU"
    assert lines[1].split() == ["some", "length", "1.235", "m", "1.2", "+-", "0.1", "ok"]
    assert " ".join(lines[2:]).split()[-5:] == ["1.235e+05", "+-", "0.25", "%", "FAIL"]


def test_the_report_lists_what_failed_and_why_the_limits_are(result):
    text = report.markdown([result], "fidelity", "python eval/fidelity.py tire", None)
    assert "Outside: another length (tire)." in text
    assert "- some length; another length: a book." in text
    assert "| some length | 1.235 |    m | 1.2 +- 0.1 |      ok |  tire |" in text  # the targets
    assert "not validation" in text and "How it was done." in text
    assert "broken on purpose: late" in report.markdown([result], "f", "how", "late-forces")


def test_json_holds_every_figure_and_no_nan(result):
    first, second = report.as_json([result])
    assert (first["study"], first["figure"], first["ok"]) == ("tire", "some length", True)
    assert first["value"] == pytest.approx(1.23456789) and first["limit"] == "1.2 +- 0.1"
    assert (first["low"], first["high"]) == pytest.approx((1.1, 1.3))
    assert second["value"] is None and second["ok"] is False


def test_a_study_that_cannot_drive_the_car_fails(monkeypatch, tmp_path):
    def stops(car):
        raise LPVMPCError("The simulation has diverged.")

    monkeypatch.setattr(runner, "load_study", lambda name: stops)
    (result,) = runner.conduct(["tire"], tmp_path)
    assert failed(result) == ["study came to its end"]
    assert "diverged" in result.method


# --- cars broken on purpose: a study that passes every car says nothing ---


@pytest.mark.parametrize(
    "broken, study, figures",
    [
        ("wrong-trail", "tire", {"pneumatic trail of the front tire"}),
        ("double-friction", "tire", {"lateral peak friction", "golden forces, rear tire, error"}),
        ("narrow-track", "static", {"load moved across the slope", "roll frequency"}),
    ],
)
def test_a_broken_car_fails_a_study(broken, study, figures):
    result = load_study(study)(break_car(broken))
    assert figures <= set(failed(result))


def test_forces_one_step_late_are_found(car):
    limit = Limit.near(0.0, 0.05)  # that of the study
    assert limit.allows(straight.lag_of_forces(car))
    late = straight.lag_of_forces(break_car("late-forces"))
    assert late == pytest.approx(1.0, abs=1e-3)
    assert not limit.allows(late)


@pytest.mark.slow
@pytest.mark.parametrize(
    "broken, study",
    [("late-forces", "straight"), ("wrong-trail", "steady-state"),
     ("double-friction", "steady-state"), ("narrow-track", "load-transfer")],
)
def test_a_broken_car_fails_on_the_road_too(broken, study):
    assert failed(load_study(study)(break_car(broken)))


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES)
def test_the_packaged_car_passes(car, study):
    assert failed(load_study(study)(car)) == []


def test_a_broken_car_keeps_the_expectations_of_the_sound_one(car):
    for name in BROKEN:
        broken = break_car(name)
        assert broken.params == car.params, name
        pairs = zip(broken.coefficients, car.coefficients, strict=True)
        assert all((a == b).all() for a, b in pairs), name
        assert parameters(broken.documented) == car.params, name


def test_an_unknown_broken_car_is_answered_with_the_list():
    with pytest.raises(UnknownNameError, match="wrong-trail"):
        break_car("square-wheels")


def test_late_forces_are_the_only_difference(car):
    """At rest nothing changes, so that late forces are the same forces."""
    sound, late = car.plant(), break_car("late-forces").plant()
    for plant in (sound, late):
        plant.reset()
        for _ in range(3):
            plant.step(Command(0.0, 0.0))
    assert late.data.qpos == pytest.approx(sound.data.qpos, abs=1e-12)


# --- closed forms ---


def test_golden_values_are_those_of_the_package_they_name():
    pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed")
    computed, stored = golden_tire.compute(), golden_tire.read()
    assert stored["coefficients"] == computed["coefficients"]  # else: the car's tires have changed
    for mine, theirs in zip(computed["rows"], stored["rows"], strict=True):
        assert mine[0] == theirs[0]
        # rounding of the mathematics library of another machine
        assert mine[1:] == pytest.approx(theirs[1:], rel=1e-12, abs=1e-9)


def test_golden_values_belong_to_the_cars_tires(car):
    stored = golden_tire.read()["coefficients"]
    for name, c in zip(("front", "rear"), car.coefficients, strict=True):
        # else: python -m lpvmpc.studies.reference.golden_tire
        assert (mf.coefficients(stored[name]) == c).all()


def test_the_transfer_function_is_the_controllers_model(car):
    """Two derivations of one model: the study's, and the LPV form the MPC predicts with."""
    p, vx = car.params, 20.0
    bicycle = Bicycle.of(p)._replace(tau_delta=0.0)  # from the real wheel angle
    tires = np.array([p.Cf, 0.0, p.Cr, 0.0])
    A, B, c = np.zeros((NX, NX)), np.zeros((NX, 2)), np.zeros(NX)
    x = np.zeros(NX)
    x[0] = vx
    lpv(x, 0.0, tires, bicycle, CORRECTED, A, B, c)
    mine, b, _ = lateral_model(replace(p, J_w=1e-15), vx)  # its wheels do not spin
    states = [1, 2, 7, 8, 9, 10]  # vy, r, alpha_f, alpha_r, phi, p
    assert A[np.ix_(states, states)] == pytest.approx(mine, rel=1e-12, abs=1e-12)
    assert B[states, 0] == pytest.approx(b, rel=1e-12, abs=1e-12)


def test_the_transfer_function_ends_in_the_steady_state(car):
    p, vx = car.params, 20.0
    model = lateral_model(p, vx)
    gain = frequency_response(model, 1e-6)[0].real
    linear = Linear.of(p)
    assert gain[0] == pytest.approx(linear.yaw_gain(vx), rel=1e-9)
    assert gain[1] == pytest.approx(vx * gain[0], rel=1e-9)
    assert gain[2] == pytest.approx(linear.roll * gain[1], rel=1e-9)
    end = response(model, np.full(10000, 0.01), 1e-3)[-1]
    assert end == pytest.approx(0.01 * gain, rel=1e-6)  # e^-10 of the transient is left


def test_understeer_of_a_car_without_trail_is_the_textbooks(car):
    p = replace(car.params, trail_f=0.0, trail_r=0.0)
    textbook = p.m / p.wheelbase * (p.lr / p.Cf - p.lf / p.Cr)
    assert Linear.of(p).understeer == pytest.approx(textbook, rel=1e-12)


def test_the_suspensions_linear_model_knows_heave_and_roll(car):
    M, C, K = suspension.linear_model(car.documented)
    p = car.params
    assert M[2, 2] == pytest.approx(p.m) and np.allclose(M, M.T) and np.allclose(K, K.T)
    assert M[5, 5] == pytest.approx(p.Iz, rel=1e-6)
    # Springs, bars and tires in series, less gravity: as `parameters` says in another way.
    assert suspension.stiffness(K, suspension.ROLL) == pytest.approx(p.K_phi, rel=1e-9)
    start = np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    motion = suspension.free_motion(M, C, K, start, np.array([0.0, 30.0]))
    assert motion[0, :7] == pytest.approx(start, abs=1e-12)
    assert np.abs(motion[1]).max() < 1e-12


# --- what the studies measure with ---


def test_a_first_order_lag_has_its_response_times():
    times = steering.DT * np.arange(5000.0)
    found = steering.step_response(1.0 - np.exp(-times / 0.2))
    assert found.t50 == pytest.approx(0.2 * math.log(2.0), rel=1e-4)
    assert found.t90 == pytest.approx(0.2 * math.log(10.0), rel=1e-4)
    assert found.overshoot == pytest.approx(0.0, abs=1e-9)


def test_a_sine_is_found_in_drift_and_noise():
    times = steering.DT * np.arange(3000.0)
    wave = 2.0 * math.pi * 1.5 * times
    values = 3.0 + 0.1 * times + 2.0 * np.cos(wave - 0.5) + 0.02 * np.cos(3.0 * wave)
    amplitude, rest = steering.fit_sine(values, 1.5)
    # drift, sine and third harmonic are orthogonal but for the ends of the record
    assert abs(amplitude) == pytest.approx(2.0, rel=1e-3)
    assert np.angle(amplitude) == pytest.approx(-0.5, abs=1e-3)
    assert rest == pytest.approx(0.01, rel=0.01)


def test_a_coast_down_gives_its_resistance_back(car):
    times = np.arange(0.0, 100.0, 0.01)
    speeds = straight.rolling_out(times, 36.0, car)
    p = car.params
    _, _, (f0, f1, f2) = straight.road_load(times, speeds, p.m_eff)
    assert f0 == pytest.approx(p.c_roll * p.m * 9.81, rel=1e-3)  # intervals of 0.5 s
    assert f2 == pytest.approx(0.5 * p.rho_air * p.CdA, rel=1e-3)
    assert abs(f1) < 1e-2


def test_deceleration_is_taken_between_80_and_10_percent():
    speed = braking.V0 - 6.0 * np.arange(0.0, 4.6, 0.001)
    distance = (braking.V0**2 - speed**2) / 12.0
    assert braking.Stop(speed, distance, False, 0.0).mfdd == pytest.approx(6.0, rel=1e-6)


def test_the_slope_at_zero_ignores_the_cubic():
    x = [-2.0, -1.0, 1.0, 2.0]
    assert slope_at_zero(x, [3.0 * v + 0.5 * v**3 for v in x]) == pytest.approx(3.0)


def test_relative_error_is_the_largest():
    assert relative_error([1.0, -2.2], [1.0, -2.0]) == pytest.approx(0.1)


def test_a_plant_of_the_car_is_a_plant(car):
    plant = car.plant(Ts=0.01, timestep=0.0005, friction=0.5)
    assert isinstance(plant, Plant) and plant.nstep == 20
    plant.model.numeric("tire_f").data[mf.QDZ1] = 7.0
    assert car.plant_coefficients()[0][mf.QDZ1] != 7.0  # each plant has its own copy
