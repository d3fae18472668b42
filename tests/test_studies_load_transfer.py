import math
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.studies import load_transfer
from lpvmpc.studies.parts import rollover
from lpvmpc.studies.parts.rollover import Springs
from lpvmpc.studies.study import CarUnderTest, StudyResult
from lpvmpc.units import GRAVITY


@pytest.fixture(scope="module")
def params():
    return packaged_car()


@pytest.fixture(scope="module")
def springs():
    return Springs.of(CarUnderTest.packaged().documented)


def test_lateral_transfer_balances_the_moment_about_the_road(params):
    front, rear, phi = load_transfer.lateral_transfer(params, 3.0)
    outward = 3.0 * (params.m * params.h + 4 * params.J_w / params.R_w)
    leaning = params.m * GRAVITY * params.h * phi
    assert front * params.track_f + rear * params.track_r == pytest.approx(outward + leaning)
    assert front / (front + rear) == pytest.approx(params.roll_share_front)


def test_longitudinal_transfer_of_a_stiff_car_is_the_textbooks(params):
    stiff = Springs(1e12, 1e12, 0.29)
    gained = load_transfer.longitudinal_transfer(params, stiff, -4.0 * params.m, 0.0)
    assert gained == pytest.approx(4.0 * params.m * params.h / params.wheelbase)
    soft = Springs(23e3, 21e3, 0.29)  # pitch carries the centre of mass forward
    assert load_transfer.longitudinal_transfer(params, soft, -4.0 * params.m, 0.0) > gained


def test_springs_are_read_in_series_with_the_tires(springs):
    assert springs.front == pytest.approx(27e3 * 200e3 / 227e3)
    assert springs.rear == pytest.approx(24e3 * 200e3 / 224e3)
    assert 0.28 < springs.wheel_height < 0.30  # below the free radius of 0.31 m


def test_a_rigid_car_tips_at_half_its_track_over_its_height(params):
    stiff = replace(params, K_phi=1e12)
    rigid = params.track_f / (2.0 * params.h)
    lifts = rollover.lift_thresholds(stiff, Springs(1e12, 1e12, 0.29))
    assert list(lifts) == ["rear", "front"]
    (first, _), (last, _) = lifts.values()
    assert last == pytest.approx(rigid)
    # the rear axle lifts when its share of the moment is its load times half the track
    share = 1.0 - params.roll_share_front
    assert first == pytest.approx(params.lf / params.wheelbase * rigid / share, rel=1e-6)


def test_a_soft_car_tips_earlier(params, springs):
    (first, _), (last, phi) = rollover.lift_thresholds(params, springs).values()
    assert 0.08 < phi < rollover.SECOND_ORDER  # the closed form holds
    assert first < last < params.track_f / (2.0 * params.h)


def test_the_axle_that_takes_more_of_the_roll_lifts_first(params):
    stiff = replace(params, K_phi=1e12, roll_share_front=0.9)
    lifts = rollover.lift_thresholds(stiff, Springs(1e12, 1e12, 0.29))
    assert list(lifts) == ["front", "rear"]
    rigid = params.track_f / (2.0 * params.h)
    assert lifts["front"][0] == pytest.approx(params.lr / params.wheelbase * rigid / 0.9, rel=1e-6)
    assert lifts["rear"][0] == pytest.approx(rigid)  # equal tracks


def test_lift_is_found_between_samples():
    pull = np.linspace(0.0, 2.0, 21)
    load = np.maximum(1000.0 * (1.234 - pull), 0.0)
    assert rollover.lift_pull(pull, load) == pytest.approx(1.234)
    assert math.isnan(rollover.lift_pull(pull, load + 1.0))


def test_a_car_that_never_lifts_fails(params, springs):
    ramp = np.ones((50, 7))
    ramp[:, 0] = np.linspace(0.0, 1.5, 50)
    result = StudyResult("load-transfer")
    rollover.judge(params, springs, ramp, result)
    assert not any(finding.ok for finding in result.findings)


def test_the_standing_car_is_pulled_over_but_does_not_slide():
    car = CarUnderTest.packaged()
    ramp = rollover.pull_over(car)
    on_road = ramp[:, 0] < 1.1
    assert ramp[on_road, 6].max() < 0.1  # the tires' own compliance; sliding was 0.3 m
    assert ramp[on_road, 1:5].sum(axis=1) == pytest.approx(car.params.m * GRAVITY, rel=2e-3)
    assert ramp[-1, 5] > 0.25
