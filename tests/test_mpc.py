"""The LPV-MPC on a stand-in plant: the nonlinear bicycle, which shares its tires with the model."""

import numpy as np
import pytest

from lpvmpc.car.bicycle import DELTA, NX, Bicycle, derivative
from lpvmpc.control import weights_file
from lpvmpc.control.cost import PAPER_WEIGHTS, Weights
from lpvmpc.control.formulation import EY_MAX, PAPER, Formulation
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.stiffness.models import ConstantStiffness
from lpvmpc.errors import OptionError
from lpvmpc.interface import Preview, State
from lpvmpc.plant.mjcf import packaged_car

TS, NP = 0.033, 13  # the horizon, and three periods of unknown latency


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def linear_tires(car, **options):
    """The controller for the stand-in plant, whose tires are linear; weights set by hand."""
    options.setdefault("weights", Weights())
    return LPVMPC(car, stiffness=ConstantStiffness(car), **options)


def state_of(x, dx):
    """State of the nonlinear bicycle as a controller sees it."""
    ax, ay = dx[0] - x[2] * x[1], dx[1] + x[2] * x[0]
    return State(0.0, 0.0, 0.0, x[0], x[1], x[2], x[DELTA], ax, ay, np.zeros(4))


def preview_of(x, kappa, vx, n=NP):
    """Constant curvature and speed."""
    flat = np.zeros(n + 1)
    return Preview(0.0, x[3], x[4], flat + kappa, flat + vx, flat, flat, flat)


def start(vx, vy=0.0, r=0.0, ey=0.0, epsi=0.0, delta=0.0, a=0.0):
    """State of the nonlinear bicycle with unloaded tires."""
    return np.array([vx, vy, r, ey, epsi, delta, a, 0.0, 0.0, 0.0, 0.0])


def drive(car, controller, kappa, vx, periods, push=(0.0, 0.0, 0.0), x=None, n_preview=NP):
    """Closed loop on the nonlinear bicycle with unmodelled accelerations `push`."""
    bicycle, tires = Bicycle.of(car), np.array([car.Cf, 0.0, car.Cr, 0.0])
    x = start(vx, r=kappa * vx) if x is None else x.copy()
    controller.reset(np.random.default_rng(0))
    states, commands, u = [], [], np.zeros(2)

    def rate():
        dx = derivative(x, u, kappa, tires, bicycle)
        dx[:3] += push
        # the real servo's rate limit
        dx[DELTA] = np.clip(dx[DELTA], -car.delta_rate_max, car.delta_rate_max)
        return dx

    for _ in range(periods):
        u = np.array(controller.command(state_of(x, rate()), preview_of(x, kappa, vx, n_preview)))
        states.append(x.copy())
        commands.append(u)
        for _ in range(33):
            x = x + 0.001 * rate()
    return np.array(states), np.array(commands)


@pytest.mark.parametrize("vx", [5.0, 20.0])
def test_a_constant_disturbance_leaves_no_offset(car, vx):
    states, _ = drive(car, linear_tires(car), 0.005, vx, 200, push=(-0.2, 0.8, 0.1))
    # explicit Euler of the stand-in at 1 ms and the hold disagree at the micrometre level
    assert abs(states[-1, 3]) < 2e-5
    assert abs(states[-1, 0] - vx) < 1e-4


def test_without_the_observer_the_same_disturbance_leaves_an_offset(car):
    form = Formulation(observer=False)
    controller = linear_tires(car, formulation=form)
    states, _ = drive(car, controller, 0.005, 20.0, 200, push=(-0.2, 0.8, 0.1))
    assert abs(states[-1, 3]) > 1e-3


def test_the_papers_formulation_drives_the_same_road_less_exactly(car):
    push = (0.0, 0.8, 0.0)  # the side wind of the paper's road is of this size
    full, _ = drive(car, linear_tires(car), 0.01, 15.0, 150, push)
    paper, _ = drive(
        car, linear_tires(car, formulation=PAPER, weights=PAPER_WEIGHTS), 0.01, 15.0, 150, push
    )
    assert abs(full[-1, 3]) < 2e-5 < 1e-3 < abs(paper[-1, 3]) < EY_MAX


@pytest.mark.parametrize("vx", [2.0, 5.0, 10.0, 20.0, 30.0])
@pytest.mark.parametrize("ay", [0.0, 2.0])
def test_no_limit_cycle_on_a_straight_and_on_a_circle(car, vx, ay):
    kappa = min(ay / vx**2, 0.1)
    _, commands = drive(car, linear_tires(car), kappa, vx, 300)
    assert np.ptp(commands[-150:, 0]) < 1e-3


def test_an_initial_error_is_driven_to_zero_within_the_bounds(car):
    x = start(15.0, ey=0.25, a=0.1)
    controller = linear_tires(car)
    states, commands = drive(car, controller, 0.0, 15.0, 150, x=x)
    assert abs(states[-1, 3]) < 1e-4
    assert np.abs(commands[:, 0]).max() <= controller.horizon.delta_max + 1e-6
    # the servo's rate: tighter than the paper's pi/12 per period; 1e-6 is the KKT tolerance
    assert np.abs(np.diff(commands[:, 0])).max() <= car.delta_rate_max * TS + 1e-6


def test_mirrored_situations_get_mirrored_commands(car):
    mirror = np.array([1, -1, -1, -1, -1, -1, 1, -1, -1, -1, -1])
    x = start(12.0, 0.1, 0.2, 0.05, -0.02, 0.03, 0.2)
    _, left = drive(car, linear_tires(car), 0.02, 12.0, 40, x=x)
    _, right = drive(car, linear_tires(car), -0.02, 12.0, 40, x=mirror * x)
    # ProxQP's iterates are not symmetric to the last bit: its tolerance, fed back 40 times
    np.testing.assert_allclose(left[:, 0], -right[:, 0], atol=1e-5)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-4)


def test_the_slip_cap_bounds_the_commanded_front_slip(car):
    """Asked for a bend far too tight, the wheel is turned to the cap, not beyond."""
    cap = 0.08
    controller = linear_tires(car, weights=Weights(slip_cap=cap))
    states, commands = drive(car, controller, 0.08, 15.0, 25)
    flow = np.arctan2(states[:, 1] + car.lf * states[:, 2], states[:, 0])
    # the cap is placed along the previous prediction, which the car follows within a few mrad
    assert (commands[1:, 0] - flow[1:]).max() < cap + 0.02
    free = linear_tires(car, weights=Weights(slip_cap=0.4))
    states, commands = drive(car, free, 0.08, 15.0, 25)
    flow = np.arctan2(states[:, 1] + car.lf * states[:, 2], states[:, 0])
    assert (commands[1:, 0] - flow[1:]).max() > cap + 0.05


def test_a_known_delay_is_compensated(car):
    """Commands arrive one period late; the controller predicts over it."""

    class Late:
        def __init__(self, inner):
            self.inner, self.pending = inner, []

        def reset(self, rng):
            self.inner.reset(rng)
            self.pending = []

        def command(self, state, preview):
            self.pending.append(self.inner.command(state, preview))
            return self.pending.pop(0) if len(self.pending) > 1 else self.pending[0]

    x = start(25.0, ey=0.2, a=0.3)
    known, _ = drive(car, Late(linear_tires(car, delay=1)), 0.0, 25.0, 120, x=x, n_preview=NP + 1)
    unknown, _ = drive(car, Late(linear_tires(car)), 0.0, 25.0, 120, x=x)
    assert abs(known[-1, 3]) < 1e-3
    assert np.abs(known[30:, 3]).max() < 0.8 * np.abs(unknown[30:, 3]).max()


def test_a_refused_solve_follows_the_plan_and_then_drives_on(car):
    controller = linear_tires(car, formulation=Formulation(steering=False))
    x = start(15.0, ey=0.2, a=0.1)
    seen, commands = state_of(x, np.zeros(NX)), []
    controller.reset(np.random.default_rng(0))
    controller.command(seen, preview_of(x, 0.0, 15.0))
    plan = controller.horizon.plan.copy()  # already shifted
    refusal = QPResult(np.empty(0), False, "MAX_ITER_REACHED", np.nan, 0.0, 0.0)
    solve, controller.solver.solve = controller.solver.solve, lambda *arrays: refusal
    for expected in ("shifted", "shifted", "shifted", "driving", "driving"):
        commands.append(controller.command(seen, preview_of(x, 0.0, 15.0)))
        assert controller.diagnostics.fallback == expected
    np.testing.assert_array_equal(commands[:3], plan[:3])
    assert commands[3].ax == commands[4].ax == 0.0  # it has the reference's speed
    assert commands[4].delta < 0.0  # the path lies to the right
    assert abs(commands[3].delta - commands[2].delta) <= car.delta_rate_max * TS + 1e-12
    controller.solver.solve = solve
    controller.command(seen, preview_of(x, 0.0, 15.0))
    assert controller.diagnostics.fallback == ""


def test_geometry_alone_brings_the_car_back(car):
    """Nothing can be solved, from the first period to the last."""
    controller = linear_tires(car)
    refusal = QPResult(np.empty(0), False, "MAX_ITER_REACHED", np.nan, 0.0, 0.0)
    controller.solver.solve = lambda *arrays: refusal
    for vx, kappa in ((3.0, 0.03), (20.0, 0.005)):
        states, _ = drive(car, controller, kappa, vx, 400, x=start(vx - 1.0, ey=0.5))
        assert np.abs(states[-50:, 3]).max() < 0.25 and abs(states[-1, 0] - vx) < 0.5


def test_a_measurement_that_is_no_number_is_survived(car):
    """The period falls back, nothing is learned from it, and the next one is as good as before."""
    controller = linear_tires(car)
    x = start(15.0, ey=0.2, a=0.1)
    good = state_of(x, np.zeros(NX))
    controller.reset(np.random.default_rng(0))
    for _ in range(3):
        controller.command(good, preview_of(x, 0.0, 15.0))
    for broken in (good._replace(vy=np.nan), good._replace(r=np.inf), good._replace(ay=np.nan)):
        command = controller.command(broken, preview_of(x, 0.0, 15.0))
        assert np.isfinite(command).all()
        assert controller.diagnostics.fallback == "shifted"
        assert controller.diagnostics.status == "NOT_FINITE"
        controller.command(good, preview_of(x, 0.0, 15.0))
        assert controller.diagnostics.solved
    assert np.isfinite(controller.disturbance).all()


def test_a_preview_that_is_too_short_is_named(car):
    controller = linear_tires(car, delay=2)
    x = start(15.0, a=0.1)
    with pytest.raises(OptionError, match="preview length is 14, but must be at least 16 points"):
        controller.command(state_of(x, np.zeros(NX)), preview_of(x, 0.0, 15.0))


def test_reset_gives_the_same_commands_again(car):
    controller = linear_tires(car)
    runs = [drive(car, controller, 0.01, 15.0, 30, push=(0, 0.5, 0))[1] for _ in range(2)]
    assert runs[0].tobytes() == runs[1].tobytes()


@pytest.mark.parametrize(
    ("name", "value"),
    [("q_ey", -1.0), ("q_vx", float("nan")), ("r_delta", 0.0), ("observer_gain", 1.5),
     ("slip_cap", 0.0), ("q_epsi", "ten")],
)
def test_impossible_weights_are_named(name, value):
    with pytest.raises(OptionError, match=name):
        Weights(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"), [("hold", "rk4"), ("Np", 1), ("Ts", 0.0), ("matrices", "guessed")]
)
def test_impossible_formulations_are_named(name, value):
    with pytest.raises(OptionError, match=name):
        Formulation(**{name: value})


def test_impossible_delays_are_named(car):
    with pytest.raises(OptionError, match="delay"):
        linear_tires(car, delay=-1)


def test_without_options_it_adapts_with_the_shipped_network_and_weights(car):
    controller = LPVMPC(car)
    assert controller.stiffness.name == "network"
    assert controller.weights == weights_file.shipped("lpv-mpc", Weights())


def test_some_weights_may_be_given_by_name(car):
    controller = LPVMPC(car, weights={"q_ey": 5.0})
    assert controller.weights == Weights(q_ey=5.0)


def spinning(slip, vx=10.0):
    """A car that drives straight on, its front wheels faster than the road by a slip ratio."""
    R_w = packaged_car().R_w
    wheels = np.array([1.0 + slip, 1.0, 1.0, 1.0]) * vx / R_w
    return State(0.0, 0.0, 0.0, vx, 0.0, 0.0, 0.0, 2.0, 0.0, wheels)


def test_the_command_obeys_traction_control(car):
    fast = preview_of(start(10.0), 0.0, 14.0)  # 4 m/s too slow: all the drive there is
    free, held = (linear_tires(car, formulation=Formulation(traction=on)) for on in (False, True))
    for _ in range(10):
        asked = [c.command(spinning(0.2), fast).ax for c in (free, held)]
    assert asked[0] > 2.0 > 1.0 > asked[1] > -0.5
