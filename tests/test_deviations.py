import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from lpvmpc.car import tire
from lpvmpc.errors import LPVMPCError, OptionError, UnknownNameError
from lpvmpc.interface import Command
from lpvmpc.plant.deviations import NOMINAL, Deviations, deviated, named
from lpvmpc.plant.mjcf import compile_model, parameters, tires
from lpvmpc.plant.plant import Plant
from lpvmpc.units import GRAVITY


@pytest.fixture(scope="module")
def model():
    return compile_model(visual=False)


@pytest.fixture(scope="module")
def nominal(model):
    return parameters(model)


def of(model, **values):
    return parameters(deviated(model, Deviations(**values)))


def bytes_of(model):
    binary = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, binary)
    return binary.tobytes()


def test_no_deviation_changes_nothing_and_a_deviation_only_the_copy(model):
    before = bytes_of(model)
    assert bytes_of(deviated(model, NOMINAL)) == before
    assert bytes_of(deviated(model, Deviations(mass=1.2, Cr=0.7))) != before
    assert bytes_of(model) == before


def test_more_mass_leaves_the_centre_of_mass_and_scales_the_inertia(model, nominal):
    car = of(model, mass=1.2)
    assert car.m == pytest.approx(1.2 * nominal.m, rel=1e-12)
    assert car.Iz == pytest.approx(1.2 * nominal.Iz, rel=1e-9)
    assert (car.lf, car.h) == pytest.approx((nominal.lf, nominal.h), abs=1e-9)


def test_a_load_moves_the_centre_of_mass_as_the_lever_rule_says(model, nominal):
    car = of(model, load=300.0, load_x=-0.7, load_z=0.9)
    share = 300.0 / (nominal.m + 300.0)
    assert car.m == pytest.approx(nominal.m + 300.0)
    assert car.lf == pytest.approx(nominal.lf + 0.7 * share, abs=1e-9)
    assert car.h == pytest.approx(nominal.h + (0.9 - nominal.h) * share, abs=1e-9)
    # Steiner: two masses a distance 0.7 apart
    assert car.Iz == pytest.approx(nominal.Iz + nominal.m * share * 0.7**2, rel=1e-9)
    # the air still pushes the same place of the body
    assert car.x_cy == pytest.approx(nominal.x_cy + 0.7 * share, abs=1e-9)


def test_height_and_yaw_inertia_change_alone(model, nominal):
    high = of(model, com_height=0.1)
    assert high.h == pytest.approx(nominal.h + 0.1, abs=1e-9)
    assert (high.m, high.Iz, high.lf) == pytest.approx((nominal.m, nominal.Iz, nominal.lf))
    slow = of(model, Iz=1.3)
    assert slow.Iz == pytest.approx(1.3 * nominal.Iz, rel=1e-9)
    assert (slow.m, slow.h) == pytest.approx((nominal.m, nominal.h))


def test_stiffness_scales_the_slope_and_keeps_the_peak(model):
    normal, soft = tires(model)[1], tires(deviated(model, Deviations(Cr=0.7)))[1]
    small = 1e-6
    slope = [tire.forces(c, 0.0, small, 3000.0, 1.0)[1] / small for c in (normal, soft)]
    assert slope[1] == pytest.approx(0.7 * slope[0], rel=1e-6)
    alpha = np.linspace(0.0, 1.0, 2001)
    peak = [max(tire.forces(c, 0.0, a, 3000.0, 1.0)[1] for a in alpha) for c in (normal, soft)]
    assert peak[1] == pytest.approx(peak[0], rel=1e-5)  # of the sampling


def test_friction_of_an_axle_is_that_of_a_road_under_it(model):
    normal, worn = tires(model)[0], tires(deviated(model, Deviations(mu_f=0.8)))[0]
    for slip, alpha in ((0.0, 0.02), (0.03, 0.05), (-0.2, 0.3), (0.1, 0.0)):
        road = tire.forces(normal, slip, alpha, 4000.0, 0.8)
        assert tire.forces(worn, slip, alpha, 4000.0, 1.0) == pytest.approx(road, rel=1e-12)


def test_factors_reach_servo_drive_wheels_and_air(model, nominal):
    car = of(model, relaxation=2.0, steer_lag=2.0, steer_rate=0.5, drive_lag=4.0,
             tire_radius=1.01, side_area=1.5, side_lever=-0.2)
    assert car.sigma_r == pytest.approx(2.0 * 1.01 * nominal.sigma_r)
    assert car.tau_delta == pytest.approx(2.0 * nominal.tau_delta)
    assert car.delta_rate_max == pytest.approx(0.5 * nominal.delta_rate_max)
    assert car.tau_ax == pytest.approx(4.0 * nominal.tau_ax)
    assert car.R_w == pytest.approx(1.01 * nominal.R_w)
    assert (car.CyA, car.x_cy) == pytest.approx((1.5 * nominal.CyA, -0.2))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"mass": -1.0}, "deviation mass is -1.0"),
        ({"load": -5.0}, "a mass from 0 to 1500 kg"),
        ({"Cr": math.nan}, "deviation Cr is nan"),
        ({"mu_f": "much"}, "deviation mu_f is 'much'"),
        ({"steer_offset": 0.5}, "an angle from -0.1 to 0.1 rad"),
    ],
)
def test_values_outside_their_domain_are_refused(values, text):
    with pytest.raises(OptionError, match="must be") as error:
        Deviations(**values)
    assert text in str(error.value)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"mass": 0.5, "load": 1500.0, "load_x": -3.0}, "a car whose mass lies between its axles"),
        ({"load": 500.0, "load_x": -2.0}, "a car that its springs carry off their stops"),
        ({"com_height": 1.5, "mass": 2.0}, "off their stops"),
        ({"Cf": 5.0, "Cr": 0.2}, "a car that is stable up to 15 m/s"),
        ({"Iz": 0.2}, "inertia that of a body"),
    ],
)
def test_a_car_that_cannot_be_driven_is_refused(model, values, text):
    with pytest.raises(OptionError, match="must be") as error:
        deviated(model, Deviations(**values))
    assert text in str(error.value)


def test_an_unknown_deviation_lists_those_there_are():
    with pytest.raises(UnknownNameError, match="Unknown deviation 'weight'; the choices are Cf"):
        named({"weight": 1.0})


def test_the_controller_keeps_its_nominal_car(nominal):
    plant = Plant()
    plant.deviations = Deviations(mass=1.2, Cr=0.8, load=100.0)
    assert plant.params == nominal
    plant.reset(vx=10.0)
    assert plant.wheels.Fz.sum() == pytest.approx((1.2 * nominal.m + 100.0) * GRAVITY, rel=1e-5)
    plant.deviations = NOMINAL
    fresh = Plant()
    assert plant.reset(vx=10.0)[:9] == fresh.reset(vx=10.0)[:9]


def test_a_steering_offset_bends_the_path_and_the_trim_knows_it():
    """Trimmed straight ahead, the car is commanded against its offset; commanded 0, it turns."""
    plant = Plant()
    plant.deviations = Deviations(steer_offset=0.01, steer_ratio=0.9)
    plant.reset(vx=10.0)
    assert plant.held.delta == pytest.approx(-0.01 / 0.9, abs=1e-6)
    for _ in range(30):
        state = plant.step(plant.held)
    assert abs(state.r) < 1e-6
    for _ in range(60):
        state = plant.step(Command(0.0, plant.held.ax))
    assert state.delta == pytest.approx(0.01, rel=1e-6)
    assert state.r > 0.02


def test_play_is_a_dead_band_of_its_width():
    plant = Plant()
    plant.deviations = Deviations(steer_play=0.01)
    plant.reset(vx=10.0)
    asked = (0.02, 0.012, 0.02, 0.008, 0.0)
    found = []
    for angle in asked:
        for _ in range(30):  # 1 s: the servo has settled
            state = plant.step(Command(angle, 0.0))
        found.append(state.delta)
    # pushed up to 0.02 - 0.005; held while the input stays within 0.01 below 0.02; then followed
    assert found == pytest.approx([0.015, 0.015, 0.015, 0.013, 0.005], abs=1e-7)


def test_brakes_and_mass_scale_the_deceleration():
    """The drive turns acceleration into the nominal car's torque; the brake gain multiplies it."""

    def braking(**values):
        plant = Plant()
        plant.deviations = Deviations(**values)
        plant.reset(vx=20.0)
        for _ in range(15):
            state = plant.step(Command(plant.held.delta, -3.0))
        resistances = plant.data.userdata[42] / plant.model.body_subtreemass[1] - 0.01 * GRAVITY
        return state.ax - resistances

    normal = braking(steer_ratio=0.9999)
    # 0.5 %: the tires' slip and the servo's lag are still settling
    assert braking(brake_gain=0.8) == pytest.approx(0.8 * normal, rel=5e-3)
    assert braking(mass=1.2) == pytest.approx(normal / 1.2, rel=5e-3)


def command_at(k):
    return Command(0.02 * math.sin(0.7 * k), 0.5 * math.cos(0.3 * k))


@pytest.mark.parametrize("periods", [1, 2])
def test_a_latency_of_whole_periods_is_a_delay_to_the_bit(periods):
    late, plain = Plant(), Plant()
    late.latency = 0.033 * periods
    late.reset(vx=15.0)
    plain.reset(vx=15.0)
    queue = [plain.held] * periods
    for k in range(20):
        queue.append(command_at(k))
        a, b = late.step(command_at(k)), plain.step(queue.pop(0))
        assert a[:9] == b[:9] and (late.data.qpos == plain.data.qpos).all()


def test_a_latency_between_two_instants_acts_between_them():
    """A pulse of the wheel comes 20 ms late: against the servo's exponential at each instant."""
    plant = Plant()
    plant.latency = 0.020
    plant.reset(vx=15.0)
    tau = plant.params.tau_delta
    assert plant.step(Command(0.01, 0.0)).delta == pytest.approx(
        0.01 * (1.0 - math.exp(-0.013 / tau)), rel=1e-9
    )
    assert plant.step(Command(0.0, 0.0)).delta == pytest.approx(
        0.01 * (1.0 - math.exp(-0.033 / tau)) * math.exp(-0.013 / tau), rel=1e-9
    )


def test_a_snapshot_holds_the_commands_on_their_way():
    plant = Plant()
    plant.latency, plant.deviations = 0.15, Deviations(steer_play=0.01)
    plant.reset(vx=15.0)
    for k in range(7):
        plant.step(command_at(k))
    saved = plant.save()
    ends = []
    for _ in range(2):
        plant.restore(saved)
        ends.append([plant.step(command_at(20 + k))[:9] for k in range(8)])
    assert ends[0] == ends[1]


@pytest.mark.parametrize("seconds", [-0.001, 0.201, 0.0005, math.nan])
def test_a_latency_that_cannot_be_is_refused(seconds):
    with pytest.raises(OptionError, match="latency is .*must be 0 to 0.2 s in whole physics steps"):
        Plant().latency = seconds


def test_a_rollout_of_what_it_does_not_know_is_refused():
    plant = Plant()
    plant.latency = 0.01
    with pytest.raises(LPVMPCError, match="step it instead"):
        plant.rollout(plant.save(), np.zeros((1, 2, 2)))


def test_every_deviation_is_a_field_that_replace_knows():
    assert replace(NOMINAL, mass=1.1).record() == {"mass": 1.1}
    assert NOMINAL.record() == {}
