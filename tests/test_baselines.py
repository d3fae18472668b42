"""The baselines: laws, closed forms and messages; their closed loops are in test_simulation.py."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from lpvmpc.car.bicycle import CORRECTED, Bicycle, lpv
from lpvmpc.car.bicycle import NU as FULL_NU
from lpvmpc.car.bicycle import NX as FULL_NX
from lpvmpc.control.cost import UNITS
from lpvmpc.control.geometric import (
    PurePursuit,
    PurePursuitWeights,
    Stanley,
    StanleyWeights,
    led_back,
    pursuit_angle,
    stanley_angle,
)
from lpvmpc.control.lmpc import EULER_FROM, LMPC, LMPCWeights, _held, lateral
from lpvmpc.control.pid import PIDGains, ProtectedPID, SpeedPID
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.weights_file import shipped_file
from lpvmpc.errors import OptionError
from lpvmpc.interface import State
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.road.path import Path as Road
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.sim.names import load_controller

TS = 0.033
BASELINES = {"lmpc-pso-pid": LMPC, "stanley": Stanley, "pure-pursuit": PurePursuit}
WEIGHTS = {"lmpc-pso-pid": LMPCWeights, "stanley": StanleyWeights,
           "pure-pursuit": PurePursuitWeights}
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def made(name, car, **options):
    """A baseline with the weights set by hand, whatever the package ships."""
    options.setdefault("weights", WEIGHTS[name]())
    return BASELINES[name](car, **options)


def seen(kappa=0.0, vx=12.0, vy=0.0, r=0.0, ey=0.0, epsi=0.0, delta=0.0, steps=60, x0=50.0):
    """State and preview at a place beside a circle (or straight) through the origin."""
    road = Road.from_curvature([kappa, kappa], 400.0)
    px, py, psi, _ = (float(value) for value in road.at(x0))
    x, y = px - ey * math.sin(psi), py + ey * math.cos(psi)
    state = State(x, y, psi + epsi, vx, vy, r, delta, 0.0, 0.0, np.zeros(4))
    speed = SpeedProfile.constant(vx, road)
    return state, road.preview(x, y, psi + epsi, x0, speed.vx, speed.spacing, steps, TS)


def command(controller, **where):
    controller.reset(RNG)
    return controller.command(*seen(**where))


# Laws that hold for all of them -----------------------------------------------------------------


@pytest.mark.parametrize("name", BASELINES)
def test_a_car_on_a_straight_path_is_left_alone(car, name):
    delta, ax = command(made(name, car))
    assert delta == pytest.approx(0.0, abs=1e-9)  # rounding of the path, and of the QP
    assert ax == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", BASELINES)
def test_the_car_is_steered_towards_the_path(car, name):
    controller = made(name, car)
    assert command(controller, ey=0.2).delta < -0.005 < 0.005 < command(controller, ey=-0.2).delta
    assert command(controller, epsi=0.05).delta < -0.01
    assert command(controller, kappa=0.02).delta > 0.01


@pytest.mark.parametrize("name", BASELINES)
def test_a_mirrored_situation_gets_the_mirrored_command(car, name):
    controller = made(name, car)
    where = {"kappa": 0.015, "vy": 0.1, "r": 0.15, "ey": 0.1, "epsi": -0.04, "delta": 0.02}
    left = command(controller, **where)
    right = command(controller, **{key: -value for key, value in where.items()})
    # exact but for rounding in the path; ProxQP's iterates are symmetric to its tolerance
    assert left.delta == pytest.approx(-right.delta, abs=1e-8)
    assert left.ax == pytest.approx(right.ax, abs=1e-12)


@pytest.mark.parametrize("name", BASELINES)
def test_commands_stay_within_what_the_car_can_do(car, name):
    controller = made(name, car)
    for ey, epsi in ((-4.0, -1.2), (4.0, 1.2)):
        for vx in (3.0, 30.0):
            state, preview = seen(vx=vx, ey=ey, epsi=epsi)
            for vx_ref in (0.5, 60.0):
                faster = preview._replace(vx_ref=np.full_like(preview.vx_ref, vx_ref))
                delta, ax = controller.command(state, faster)
                # QP bounds hold to its tolerance of 1e-7 in units of 0.1 rad
                assert abs(delta) <= car.delta_max + 1e-8
                assert car.ax_min <= ax <= car.ax_max(vx)


@pytest.mark.parametrize("name", BASELINES)
def test_a_measurement_that_is_no_number_is_survived(car, name):
    controller = made(name, car)
    state, preview = seen(ey=0.1)
    controller.reset(RNG)
    controller.command(state, preview)
    for broken in ({"vx": np.nan}, {"psi": np.nan, "vy": np.inf}):
        held = controller.command(state._replace(**broken), preview._replace(epsi=np.nan))
        assert np.isfinite(held).all()
    again = controller.command(state._replace(vx=11.0), preview)
    assert np.isfinite(again).all() and again.ax != held.ax  # nothing broken is remembered


@pytest.mark.parametrize("name", BASELINES)
def test_reset_gives_the_same_commands_again(car, name):
    controller = made(name, car)
    runs = []
    for _ in range(2):
        controller.reset(RNG)
        places = ({"ey": 0.1, "vx": 11.0}, {"epsi": 0.05}, {"kappa": 0.02, "r": 0.1})
        runs.append([controller.command(*seen(**where)) for where in places])
    assert runs[0] == runs[1]


# The PID ----------------------------------------------------------------------------------------


def test_the_pid_is_its_closed_form(car):
    gains = PIDGains(kp=2.0, ki=0.5, kd=0.3)
    pid = SpeedPID(car, gains, TS)
    # a constant error: proportional, and an integral that grows by ki e Ts each period
    for k in range(10):
        assert pid.command(10.0, 10.4) == pytest.approx(0.4 * (2.0 + 0.5 * k * TS), rel=1e-12)
    # a ramp: the filtered derivative tends to its slope
    pid = SpeedPID(car, PIDGains(kp=0.0, ki=0.0, kd=0.3), TS)
    answers = [pid.command(10.0, 10.0 + 1.5 * k * TS) for k in range(60)]
    share = TS / (0.05 + TS)
    assert answers[1] == pytest.approx(0.3 * 1.5 * share, rel=1e-12)
    assert answers[-1] == pytest.approx(0.3 * 1.5, rel=1e-9)


def test_the_pid_does_not_wind_up(car):
    """After a minute at full throttle the error changes its sign, and so does the command.

    An integral without care would hold 1800 m/s2 by then.
    """
    pid = SpeedPID(car, PIDGains(kp=2.0, ki=1.0, kd=0.0), TS)
    for _ in range(1800):
        assert pid.command(10.0, 40.0) == car.ax_max(10.0)
    assert pid.command(10.0, 9.5) == pytest.approx(-1.0, abs=1e-12)


def test_the_pid_sees_the_speed_at_which_its_command_arrives(car):
    """Against a delay of 6 periods gains that want an answer within 50 ms swing up without it."""
    gains, n = PIDGains(kp=20.0, ki=20.0, kd=0.0), 6
    ends = []
    for known in (n, 0):
        pid, vx, queue = ProtectedPID(car, gains, TS, known), 15.0, [0.4] * n
        track = []
        for k in range(300):
            still = State(0, 0, 0, vx, 0, 0, 0, 0, 0, np.full(4, vx / car.R_w))
            queue.append(pid.command(still, np.full(n + 1, 15.0 if k < 100 else 15.5)))
            vx += TS * (queue.pop(0) - 0.4)  # against a constant resistance
            track.append(vx)
        ends.append(np.abs(np.array(track[200:]) - 15.5).max())
    assert ends[0] < 0.02 < 0.5 < ends[1]


def test_the_pid_is_held_where_wheels_spin_or_lock(car):
    pid = ProtectedPID(car, PIDGains(kp=20.0), TS, 0)
    for spin, vx_ref in ((1.5, 30.0), (0.5, 0.0)):
        pid.reset()
        free = State(0, 0, 0, 10.0, 0, 0, 0, 0, 0, np.full(4, 10.0 / car.R_w))
        asked = pid.command(free, np.full(1, vx_ref))
        slipping = free._replace(wheel_speed=np.full(4, spin * 10.0 / car.R_w))
        held = pid.command(slipping, np.full(1, vx_ref))
        assert abs(held) < 0.5 * abs(asked) and held * asked > 0.0


def test_the_pid_leaves_no_speed_error_against_a_constant_resistance(car):
    pid, vx = SpeedPID(car, PIDGains(), TS), 15.0
    for _ in range(400):
        vx += TS * (pid.command(vx, 15.0) - 0.4)
    assert vx == pytest.approx(15.0, abs=1e-6)


# Geometry ---------------------------------------------------------------------------------------


def test_pure_pursuit_steers_the_circle_through_its_point():
    for radius in (8.0, 50.0, -20.0):
        for angle in (0.05, 0.3):  # any point of the circle gives the same steering
            forward, left = abs(radius) * math.sin(angle), radius * (1.0 - math.cos(angle))
            assert pursuit_angle(forward, left, 2.8) == pytest.approx(math.atan(2.8 / radius))


def test_pure_pursuit_on_a_circle_gives_the_geometric_angle(car):
    """The rear axle on the circle and along it, where the law has no error to correct."""
    R = 30.0
    centre = math.hypot(R, car.lr)  # then the rear axle runs on R, and the path is followed by it
    state, preview = seen(1.0 / R, ey=R - centre, epsi=-math.atan2(car.lr, R))
    delta, _ = made("pure-pursuit", car).command(state, preview)
    # straight pieces of 0.4 m between the previewed points: 0.7 mm in a lookahead of 3.6 m
    assert delta == pytest.approx(math.atan(car.wheelbase / R), rel=2e-3)


def test_pure_pursuit_looks_further_when_faster(car):
    controller = made("pure-pursuit", car)
    angles = [command(controller, vx=vx, ey=0.14).delta for vx in (2.0, 8.0, 15.0, 25.0)]
    # up to 10 m/s the smallest lookahead holds; beyond it the same error is answered more gently
    assert angles[0] == pytest.approx(angles[1], rel=0.02)
    assert angles[1] < 1.5 * angles[2] < 2.0 * angles[3] < 0.0


def test_the_stanley_law_is_its_closed_form(car):
    w = StanleyWeights(k_e=4.0, softening=1.5, yaw_damping=0.1, slip_share=0.8)
    angle = stanley_angle(0.03, 0.1, 10.0, 0.05, 0.02, w)
    assert angle == pytest.approx(0.8 * 0.02 - 0.03 - math.atan(0.4 / 11.5) - 0.005, rel=1e-12)
    # and the controller asks it at the front axle, 1.2 m ahead of the centre of mass
    delta, _ = command(made("stanley", car, weights=w), ey=0.1, epsi=0.03, vx=10.0, r=0.05)
    front = 0.1 + car.lf * math.sin(0.03)
    assert delta == pytest.approx(stanley_angle(0.03, front, 10.0, 0.05, 0.0, w), rel=1e-9)


def test_stanley_needs_no_error_on_a_circle(car):
    """Front axle on the circle: its wheels point along it, plus the slip that the bend takes."""
    R, vx = 40.0, 10.0
    rear = math.sqrt(R**2 - car.wheelbase**2)  # kinematic car: the rear axle cuts the bend
    centre = math.hypot(rear, car.lr)
    where = {"kappa": 1.0 / R, "vx": vx, "r": vx / R, "ey": R - centre,
             "epsi": -math.atan2(car.lr, rear)}
    delta, _ = command(made("stanley", car), **where)
    slip = car.m * car.lr / (car.wheelbase * car.Cf) * vx**2 / R
    # straight pieces of 0.33 m between the points: 0.3 mm of error, times k_e / (1 + vx)
    assert delta == pytest.approx(math.atan(car.wheelbase / rear) + slip, abs=3e-4)


def test_stanley_finds_the_front_axle_on_a_reference_that_barely_moves(car):
    state, preview = seen(vx=5.0, ey=0.1)
    still = preview._replace(x=np.full(61, preview.x[0]), y=np.full(61, preview.y[0]))
    controller = made("stanley", car)
    assert controller.command(state, still).delta == controller.command(state, preview).delta


def test_a_car_far_beside_is_led_back_with_its_time_constant():
    for error in (0.0, 0.1, -0.15):
        assert led_back(error, 10.0) == (0.0, 0.0)
    vx, ey, track = 10.0, -1.15, []
    for _ in range(150):  # it moves as it is told to
        aside, towards = led_back(ey, vx)
        assert aside == pytest.approx(ey + 0.15)
        ey += 0.01 * vx * math.tan(towards)
        track.append(ey)
    assert track[-1] == pytest.approx(-0.15 - math.exp(-1.5 / 1.5), abs=4e-3)


@pytest.mark.parametrize("name", ["stanley", "pure-pursuit"])
def test_geometry_is_asked_where_the_car_will_be(car, name):
    """On a circle of 60 m, steadily, the law sees after 5 periods what it sees now."""
    R, vx = 60.0, 12.0
    L = car.wheelbase
    steady = (L + car.m / L * (car.lr / car.Cf - car.lf / car.Cr) * vx * vx) / R
    vy = vx / R * (car.lr - car.m * car.lf / (L * car.Cr) * vx * vx)
    where = {"kappa": 1 / R, "vx": vx, "vy": vy, "r": vx / R, "delta": steady, "steps": 80,
             "epsi": -math.atan2(vy, vx)}
    now, late = (command(made(name, car, delay=delay), **where).delta for delay in (0, 5))
    assert late == pytest.approx(now, abs=2e-3)
    # and an error of heading becomes one beside the path until then
    where = {"vx": vx, "epsi": 0.02, "steps": 80}
    now, late = (command(made(name, car, delay=delay), **where).delta for delay in (0, 5))
    assert late < now - 1e-3 < 0.0


# LMPC -------------------------------------------------------------------------------------------


def test_the_linear_bicycle_is_the_lpv_model_driving_straight(car):
    """Two models of one thing: rows and columns of (vy, r, ey, epsi) at zero errors."""
    bicycle = Bicycle.of(car).simplified(lags=False, relaxation=False, roll=False, trail=False)
    x = np.zeros(FULL_NX)
    x[0] = 14.0
    A, B, c = np.empty((FULL_NX, FULL_NX)), np.empty((FULL_NX, FULL_NU)), np.empty(FULL_NX)
    lpv(x, 0.01, np.array([car.Cf, 0.0, car.Cr, 0.0]), bicycle, CORRECTED, A, B, c)
    A4, B4 = np.empty((4, 4)), np.empty((4, 1))
    lateral(14.0, np.array([car.m, car.Iz, car.lf, car.lr, car.Cf, car.Cr, car.vx_min]), A4, B4)
    np.testing.assert_allclose(A4, A[1:5, 1:5], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(B4[:, 0], B[1:5, 0], rtol=1e-12)
    assert A[4, 0] == -0.01  # the curvature's column, which the linear bicycle has as -vx kappa


@pytest.mark.parametrize("delay", [0, 2])
def test_without_active_bounds_lmpc_is_a_least_squares_problem(car, delay):
    w = LMPCWeights(q_vy=0.3, q_r=0.2, q_ey=20.0, q_epsi=300.0, r_delta=0.5)
    controller = made("lmpc-pso-pid", car, weights=w, delay=delay)
    controller.reset(RNG)
    state, preview = seen(0.008, vx=13.0, vy=0.05, r=0.1, ey=0.04, epsi=-0.01, delta=0.03)
    answer = controller.command(state, preview)
    prediction = controller.diagnostics.prediction

    A, B = np.empty((4, 4)), np.empty((4, 1))
    lateral(13.0, np.array([car.m, car.Iz, car.lf, car.lr, car.Cf, car.Cr, car.vx_min]), A, B)
    N, x, before = 10, np.array([0.05, 0.1, preview.ey, preview.epsi]), 0.03

    def roll_out(plan):
        states, z = [], x.copy()
        for k, delta in enumerate([before] * delay + list(plan)):
            z = z + TS * (A @ z + B[:, 0] * delta)
            z[3] -= TS * 13.0 * preview.kappa[k]
            states.append(z)
        return np.array(states)[delay:]  # (N, 4)

    sizes = np.array([UNITS[name] for name in ("vy", "r", "ey", "epsi")])
    q = np.sqrt(TS * np.array([0.3, 0.2, 20.0, 300.0])) / sizes
    r = np.sqrt(0.5 / TS) / UNITS["delta"]

    def residual(plan):
        return np.concatenate([(q * roll_out(plan)).ravel(), r * np.diff([before, *plan])])

    at_zero = residual(np.zeros(N))
    J = np.stack([residual(e) - at_zero for e in np.eye(N)], axis=1)
    plan = np.linalg.lstsq(J, -at_zero, rcond=None)[0]
    assert np.abs(roll_out(plan)[:, 2]).max() < 0.3 and np.abs(np.diff(plan)).max() < 0.033
    assert answer.delta == pytest.approx(plan[0], abs=1e-7)  # the QP's tolerance, units of 0.1 rad
    np.testing.assert_allclose(prediction[1:, 1:], roll_out(plan), atol=1e-6)
    np.testing.assert_array_equal(prediction[:, 0], 13.0)


def test_the_steering_rate_of_lmpc_is_that_of_the_servo(car):
    controller = made("lmpc-pso-pid", car, protect=False)
    controller.reset(RNG)
    commands = [0.0] + [controller.command(*seen(epsi=0.4)).delta for _ in range(25)]
    steps = np.diff(commands)
    assert steps.min() == pytest.approx(-car.delta_rate_max * TS, abs=1e-7)  # below pi/12
    assert commands[-1] == pytest.approx(-np.pi / 6.0, abs=1e-7)
    assert controller.diagnostics.solved


def test_lmpc_steers_the_front_tires_to_their_cap_and_no_further(car):
    controller = made("lmpc-pso-pid", car, weights=LMPCWeights(slip_cap=0.12))
    controller.reset(RNG)
    for _ in range(25):
        delta, _ = controller.command(*seen(epsi=0.4))
    assert delta == pytest.approx(-0.12, abs=1e-7)  # the car does not turn: its flow is 0
    # while it turns right the same slip is further to the right
    controller.command(*seen(epsi=0.4, r=-0.5))
    assert controller.horizon.u_lo[0, 0] == pytest.approx(-0.12 - car.delta_rate_max * TS)
    assert controller.horizon.u_lo[9, 0] < -0.12


@pytest.mark.parametrize("vx", [1.5, 4.9])
def test_a_slow_lmpc_predicts_with_the_exact_hold(car, vx):
    h = made("lmpc-pso-pid", car).horizon
    _held(h.handle, vx)
    A, B = np.empty((4, 4)), np.empty((4, 1))
    lateral(vx, h.car, A, B)
    M = np.zeros((6, 6))
    M[:4, :4], M[:4, 4], M[3, 5] = A, B[:, 0], 1.0
    np.testing.assert_allclose(_held(h.handle, vx), expm(M * TS), atol=1e-9)
    fast = _held(h.handle, 2.0 * EULER_FROM)
    lateral(2.0 * EULER_FROM, h.car, A, B)
    np.testing.assert_array_equal(fast[:4, :4], np.eye(4) + A * TS)
    lateral(EULER_FROM, h.car, A, B)  # where it takes over Euler's rule is stable
    assert np.abs(np.linalg.eigvals(np.eye(2) + A[:2, :2] * TS)).max() < 1.0


def test_a_refused_solve_follows_the_plan_and_then_drives_on(car):
    controller = made("lmpc-pso-pid", car)
    state, preview = seen(ey=0.2)
    controller.reset(RNG)
    controller.command(state, preview)
    plan = controller.horizon.plan.copy()  # already shifted
    refusal = QPResult(np.empty(0), False, "MAX_ITER_REACHED", np.nan, 0.0, 0.0)
    controller.solver.solve = lambda *arrays: refusal
    for k, expected in enumerate(("shifted", "shifted", "shifted", "driving", "driving")):
        delta, ax = controller.command(state, preview)
        assert controller.diagnostics.fallback == expected
        if expected == "shifted":
            assert delta == plan[k, 0]
    assert delta < 0.0 and ax == 0.0  # to the path on the right, at the reference's speed


# Names and messages -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", BASELINES)
def test_each_baseline_is_known_by_its_name(name):
    controller = load_controller(name, delay=1)
    assert type(controller) is BASELINES[name] and controller.name == name
    assert controller.weights == load_controller(name).weights
    if not shipped_file(name).exists():
        assert controller.weights == WEIGHTS[name]()


@pytest.mark.parametrize("name", BASELINES)
def test_tuning_starts_inside_its_ranges(name):
    weights = WEIGHTS[name]()
    for field, (low, high) in weights.RANGES.items():
        value = getattr(weights, field)
        assert 0.0 < low < high
        assert low <= value <= high or value == 0.0  # left out by hand


@pytest.mark.parametrize("name", BASELINES)
def test_some_weights_may_be_named(name):
    assert load_controller(name, weights={"kp": 1.25}).weights == WEIGHTS[name](kp=1.25)
    with pytest.raises(OptionError, match="weight is 'kq', but must be one of"):
        load_controller(name, weights={"kq": 1.0})


@pytest.mark.parametrize("name", BASELINES)
def test_a_stiffness_model_is_refused_by_those_that_adapt_to_nothing(name):
    sentence = f"stiffness is 'network', but must be left out for {name}, which adapts to nothing"
    with pytest.raises(OptionError, match=sentence):
        load_controller(name, stiffness="network")
    assert load_controller(name, stiffness=None) and load_controller(name, stiffness="constant")


@pytest.mark.parametrize(
    ("weights", "name", "value"),
    [(LMPCWeights, "q_ey", -1.0), (LMPCWeights, "r_delta", 0.0), (LMPCWeights, "kp", "ten"),
     (StanleyWeights, "k_e", float("nan")), (PurePursuitWeights, "lookahead_min", 0.0),
     (PIDGains, "ki", float("inf"))],
)
def test_impossible_weights_are_named(weights, name, value):
    with pytest.raises(OptionError, match=f"weight {name} is"):
        weights(**{name: value})


@pytest.mark.parametrize("name", BASELINES)
def test_impossible_delays_are_named(car, name):
    with pytest.raises(OptionError, match="delay is -1"):
        made(name, car, delay=-1)


def test_a_preview_that_is_too_short_is_named(car):
    with pytest.raises(OptionError, match="preview length is 11, but must be at least 13 points"):
        made("lmpc-pso-pid", car, delay=2).command(*seen(steps=10))
