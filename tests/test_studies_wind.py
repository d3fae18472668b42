import math
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.car import magic_formula as mf
from lpvmpc.interface import Command
from lpvmpc.plant.mjcf import compile_model, packaged_car, tires
from lpvmpc.studies import side_area, wind
from lpvmpc.studies.reference.broken_cars import break_car
from lpvmpc.studies.reference.circle_formulas import Linear, against, front_load, steady_track
from lpvmpc.studies.study import CarUnderTest
from lpvmpc.units import GRAVITY


@pytest.fixture(scope="module")
def params():
    return packaged_car()


@pytest.fixture(scope="module")
def rubber():
    return tires(compile_model(visual=False))


def unresisted(params):
    """Without drag and rolling resistance: the textbook's car."""
    return replace(params, CdA=0.0, c_roll=0.0)


def test_the_steady_state_balances_force_and_moment(params, rubber):
    s = steady_track(unresisted(params), rubber, 25.0, 0.0, 12.0)
    sideslip, steer, force = s.sideslip, s.delta, s.side_force
    Fyf, Fyr = params.Cf * (steer - sideslip), -params.Cr * sideslip
    assert Fyf + Fyr + force == pytest.approx(0.0, abs=1e-9)
    moment = (params.lf - params.trail_f) * Fyf - (params.lr + params.trail_r) * Fyr
    assert moment + params.x_cy * force == pytest.approx(0.0, abs=1e-9)
    assert force < 0.0  # from the left, so to the right


def test_a_wind_that_pushes_at_the_rear_force_asks_for_crab_angle_and_no_front_force(
    params, rubber
):
    car = replace(unresisted(params), x_cy=-params.lr - params.trail_r)
    s = steady_track(car, rubber, 20.0, 0.0, 10.0)
    assert s.sideslip == pytest.approx(s.side_force / car.Cr)
    assert s.delta == pytest.approx(s.sideslip)  # the front wheels roll straight along the course


def test_without_sideslip_the_force_is_that_of_the_formula(params, rubber):
    stiff = tuple(one._replace(c=one.c.copy()) for one in rubber)
    for one in stiff:
        one.c[mf.PKY1] *= 1e7
    force = steady_track(params, stiff, 20.0, 0.0, 10.0).side_force
    q = 0.5 * params.rho_air * params.CyA
    assert force == pytest.approx(-q * math.hypot(20.0, 10.0) * 10.0)


def test_drag_and_rolling_resistance_let_a_car_understeer_more(params, rubber):
    ay, vx = 0.1, 30.0
    plain, full = (steady_track(p, rubber, vx, ay) for p in (unresisted(params), params))
    linear = Linear.of(params)
    assert plain.delta == pytest.approx(
        params.wheelbase * ay / vx**2 + linear.understeer * ay, rel=0.01  # the side force's share
    )
    assert full.delta > plain.delta
    air = 0.5 * params.rho_air * params.CdA * vx**2
    load = front_load(params, air)
    assert load == pytest.approx(
        params.m * GRAVITY * params.lr / params.wheelbase - air * params.h / params.wheelbase
    )
    slower = against(params, rubber, air)
    assert slower.Cf < params.Cf and slower.Cr > params.Cr
    assert against(params, rubber, 0.0).Cf == pytest.approx(params.Cf)


def test_the_linear_answer_to_a_lasting_wind_ends_in_its_steady_state(params, rubber):
    vx = 20.0
    times = np.linspace(0.0, 6.0, 61)
    r, psi, _ = wind.linear_response(unresisted(params), rubber, vx, lambda t: 1.0, times)[-1]
    # steering held: vy' = r' = 0 for the wind across the car's axis at that heading
    a, b = params.lf - params.trail_f, params.lr + params.trail_r
    Cf, Cr, lf, lr = params.Cf / vx, params.Cr / vx, params.lf, params.lr
    A = [
        [-(Cf + Cr), -(lf * Cf - lr * Cr) - params.m * vx],
        [-(a * Cf - b * Cr), -(a * lf * Cf + b * lr * Cr)],
    ]
    force = -0.5 * params.rho_air * params.CyA * vx * math.cos(psi)  # of 1 m/s
    steady = np.linalg.solve(A, [-force, -params.x_cy * force])
    # the air's sideways speed is that of the car too: vy / 1 m/s, below 2 %
    assert r == pytest.approx(steady[1], rel=0.03)


@pytest.mark.parametrize("gust", wind.GUSTS, ids=lambda gust: gust.name)
def test_a_gust_begins_after_the_start_and_blows_from_the_left(gust):
    speeds = [gust.wind(t) for t in np.arange(0.0, gust.seconds, 0.01)]
    assert gust.wind(0.19) == 0.0 and min(speeds) >= 0.0
    assert f"{max(speeds):g} m/s" in gust.name


def test_a_real_side_area_takes_more_wind_and_its_roll_moment_lifts_the_windward_side():
    car = CarUnderTest.packaged()
    rolls = []
    for one in (car, side_area.real(car, roll=False), side_area.real(car, roll=True)):
        plant = one.plant()
        assert plant.params.CyA == car.params.CyA  # what a controller is told stays
        plant.reset(vx=20.0)
        for _ in range(60):  # wind from the left, to the right
            plant.step(Command(0.0, 0.2), wind=(0.0, -15.0))
        rolls.append(plant.roll)
    assert 0.0 < rolls[0] < rolls[1] < rolls[2]  # right side down
    p = car.params
    force = 0.5 * p.rho_air * side_area.AREA * math.hypot(20.0, 15.0) * 15.0
    # Springs and gravity hold it: K_phi. 15 %: the car drifts with the wind and turns from it.
    moment = force * (side_area.HEIGHT - p.h)
    assert rolls[2] - rolls[1] == pytest.approx(moment / p.K_phi, rel=0.15)


def test_the_wrong_car_of_a_study_keeps_what_is_wrong_with_it():
    wrong = break_car("late-forces")
    assert issubclass(side_area.real(wrong, roll=True).plant_class, wrong.plant_class)
