import math

import mujoco
import numpy as np
import pytest

from lpvmpc.interface import Command
from lpvmpc.plant.plant import Plant
from lpvmpc.studies import numerics
from lpvmpc.studies.parts import chatter, energy
from lpvmpc.studies.parts.energy import Ledger
from lpvmpc.studies.study import CarUnderTest


def test_order_of_a_made_up_method():
    h = np.array(numerics.STEPS)
    assert numerics.orders(3.0 * h**2)[-1] == pytest.approx(2.0)
    assert numerics.orders(3.0 * h) == pytest.approx(np.ones(len(h) - 1))


def test_drives_are_apart_by_position_and_velocity():
    a, b = np.zeros((5, 4)), np.zeros((5, 4))
    b[:, 0], b[:, 3] = 3.0, 4.0
    assert numerics.apart(a, b) == pytest.approx(5.0)


def test_the_onset_is_found_between_two_steps():
    found = chatter.onset(lambda h: h, 0.0123, 1e-3, 0.05, 1.001)
    assert found == pytest.approx(0.0123, rel=1e-3)
    assert chatter.onset(lambda h: 0.0, 1.0, 1e-3, 0.05, 1.01) == math.inf


def test_only_what_alternates_is_chatter():
    h, radius, k = 0.001, 0.3, np.arange(100)
    smooth = 10.0 + 2.0 * h * k
    shaking = smooth + 0.005 * (-1.0) ** k
    speeds = np.stack([smooth] * 3 + [shaking], axis=1)
    # +-0.005 rad/s: accelerations of +-10 rad/s2
    assert chatter.alternating(speeds, radius, h) == pytest.approx(3.0)
    assert chatter.alternating(speeds[:, :3], radius, h) < 1e-9


def test_an_undamped_wheel_chatters_at_two_over_its_frequency():
    car = CarUnderTest.packaged()
    p, c = car.params, car.coefficients[0]

    def growth(h):
        return chatter.spin_growth(p, c, np.array([2.5, 0.0]), 0.0, h)

    onset = chatter.onset(growth, 1.0 + 1e-6, 1e-3, 0.05, 1.0001)
    Fz = p.m * 9.81 * p.lr / (2 * p.wheelbase)
    sigma = 1.9021 * 0.31 * Fz / 4414.5
    omega = math.sqrt((p.R_w**2 / p.J_w + 4 / p.m) * Fz * 19.733 / sigma)
    assert onset == pytest.approx(2.0 / omega, rel=1e-3)


# --- energy ---


def test_a_ledger_that_balances_has_no_residual():
    t = np.linspace(0.0, 2.0, 201)
    speed = 3.0 * t  # 2 kg under 6 N
    middle = 0.5 * (speed[1:] + speed[:-1])
    books = Ledger(t, {"kinetic": speed**2}, {"drive": 6.0 * middle})
    assert np.abs(books.residual()).max() < 1e-12
    assert books.work("drive") == pytest.approx(36.0)
    assert books.change("kinetic") == pytest.approx(36.0)
    wrong = Ledger(t, {"kinetic": speed**2}, {"drive": 5.0 * middle})
    assert wrong.residual()[-1] == pytest.approx(6.0)


@pytest.fixture(scope="module")
def turn():
    """A second of braking in a turn: the plant and its ledger."""
    plant = Plant(Ts=0.001)
    plant.reset(psi=0.7, vx=18.0, kappa=0.015)
    commands = [(0.06, -3.0)] * 15 + [(0.02, 1.0)] * 15
    recording = energy.record(plant, np.array(commands), 33)
    return plant, recording, energy.ledger(plant, recording)


def test_the_energy_of_a_turn_under_braking_balances(turn):
    _, _, books = turn
    throughput = abs(books.work("brakes"))
    assert throughput > 1e4
    # a midpoint rule at 1 ms; 2e-6 measured
    assert np.abs(books.residual()).max() < 1e-4 * throughput
    assert books.flows["tire slip"].max() < 0.0
    assert set(books.flows) == set(energy.FLOWS) and set(books.stores) == set(energy.STORES)


def test_the_ledger_notices_a_force_that_it_does_not_know():
    plant = Plant(Ts=0.001)
    plant.reset(psi=0.7, vx=18.0, kappa=0.015)
    plant.data.qfrc_applied[0] = 100.0  # along x in the world
    pushed = energy.record(plant, np.array([(0.06, -3.0)] * 15), 33)
    books = energy.ledger(plant, pushed)
    way = pushed.qpos[len(books.t) - 1, 0] - pushed.qpos[0, 0]
    assert books.residual()[-1] == pytest.approx(100.0 * way, rel=1e-3)


def test_wheel_centres_move_as_the_engine_says(turn):
    plant, recording, _ = turn
    body = energy._Body(plant.model, recording)
    k = 500
    data = mujoco.MjData(plant.model)
    data.qpos[:] = recording.qpos[k]
    data.qvel[:] = 0.5 * (recording.qvel[k] + recording.qvel[k + 1])
    mujoco.mj_kinematics(plant.model, data)
    mujoco.mj_comPos(plant.model, data)
    mujoco.mj_comVel(plant.model, data)
    velocity = np.zeros(6)
    for i, name in enumerate(("fl", "fr", "rl", "rr")):
        wheel = body.wheel(i)
        knuckle = plant.model.body(f"knuckle_{name}").id
        assert wheel.height[k] == pytest.approx(data.xpos[knuckle][2], abs=1e-12)
        kind = mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(plant.model, data, kind, knuckle, velocity, 1)  # knuckle's axes
        # the contact point lies straight below the centre in the wheel's plane
        lean = math.sqrt(1.0 - wheel.upright[k] ** 2)
        assert lean < 0.08
        along = velocity[3] - velocity[1] * wheel.height[k] / wheel.upright[k]
        assert wheel.Vx[k] == pytest.approx(along, abs=0.01)  # pitch tilts the axes by 0.01


def test_a_car_at_steady_speed_spends_what_its_motor_gives():
    plant = Plant(Ts=0.001)
    plant.reset(vx=20.0)
    held = Command(*plant.data.ctrl[:2])
    recording = energy.record(plant, np.array([held] * 10), 33)
    books = energy.ledger(plant, recording)
    p = plant.params
    seconds = books.t[-1]
    air = 0.5 * p.rho_air * p.CdA * 20.0**3 * seconds
    assert books.work("air") == pytest.approx(-air, rel=1e-6)
    assert books.work("rolling") == pytest.approx(-p.c_roll * p.m * 9.81 * 20.0 * seconds, rel=5e-3)
    out = sum(books.work(name) for name in energy.FLOWS if name != "drive")
    assert books.work("drive") == pytest.approx(-out, rel=1e-6)
