import json
import math

import numpy as np
import pytest

from lpvmpc.errors import DataError, EstimatorError, LPVMPCError, OptionError, UnknownNameError
from lpvmpc.interface import Command, State
from lpvmpc.kit.provenance import model_sha256
from lpvmpc.plant.deviations import NOMINAL, Deviations, deviated
from lpvmpc.plant.plant import Plant
from lpvmpc.road.path import Path as Road
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.road.surface import Slope, Surface
from lpvmpc.road.wind import Wind
from lpvmpc.sensing.channels import RTK
from lpvmpc.sim.ground import Ground
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import load_controller, load_scenario
from lpvmpc.sim.perception import ESTIMATED, MEASURED
from lpvmpc.sim.values import Normal, Uniform
from lpvmpc.sim.world import WORLDS, World, children, load_world
from lpvmpc.sim.world_names import WORLD_NAMES
from lpvmpc.units import GRAVITY


def sample(world, seed=0):
    return load_world(world).sample(next(children(seed)))


# Descriptions -------------------------------------------------------------------------------------


def test_the_presets_are_those_that_the_help_lists():
    assert list(WORLDS) == list(WORLD_NAMES)
    assert WORLDS["ideal"].ideal and not WORLDS["rtk"].ideal
    assert sample("ideal").record() == {}


def test_a_seed_draws_one_world_and_another_seed_another():
    for name in WORLDS:
        assert sample(name, 3) == sample(name, 3)
        json.dumps(sample(name, 3).record(), allow_nan=False)
    assert sample("fleet", 3) != sample("fleet", 4)
    latencies = [sample("production", seed).latency for seed in range(200)]
    assert 0.04 <= min(latencies) < 0.045 and 0.075 < max(latencies) <= 0.08
    assert all(round(1000 * t, 9) == round(1000 * t) for t in latencies)


def test_every_car_of_the_fleet_can_be_driven(plant):
    for seed in range(60):
        deviated(plant.nominal_model, sample("fleet", seed).deviations)
    light, heavy = dict(load=450.0, load_x=-0.9, load_z=0.9), dict(load=0.0)
    for load in (light, heavy):
        deviated(plant.nominal_model, Deviations(Cf=1.2, Cr=0.8, **load))


def test_ranges_are_uniform_pairs_or_normal_and_cut():
    world = World(name="w", car={"Cf": [0.8, 1.2], "Cr": {"mean": 1.0, "std": 0.1}, "mass": 1.1})
    assert world.car == {"Cf": Uniform(0.8, 1.2), "Cr": Normal(1.0, 0.1), "mass": 1.1}
    drawn = [world.sample(np.random.default_rng(seed)).deviations for seed in range(400)]
    Cr = np.array([one.Cr for one in drawn])
    # 400 samples: the mean is known to 0.005, the spread to 0.0035; three of each
    assert abs(Cr.mean() - 1.0) < 0.015 and abs(Cr.std() - 0.1) < 0.011
    assert 0.7 <= Cr.min() and Cr.max() <= 1.3
    assert {one.mass for one in drawn} == {1.1}


OWN = """
about = "heavy and slow"
base = "rtk"
latency = 0.02
[sensing]
scale = 2.0
position = {std = 0.05, rate = 10.0}
[car]
load = [0.0, 300.0]
[road]
friction = [0.8, 1.0]
bank = [-0.04, 0.04]
wavelength = 100.0
[air]
wind_scale = 1.5
density = 1.1
"""


def test_a_file_makes_a_world_from_a_preset(tmp_path):
    file = tmp_path / "heavy.toml"
    file.write_text(OWN)
    world = load_world(file)
    assert (world.name, world.about, world.latency) == ("heavy", "heavy and slow", 0.02)
    assert world.sensing.position.std == 0.05 and world.sensing.position.rate == 10.0
    assert world.sensing.psi.std == pytest.approx(2.0 * RTK.psi.std)
    draw = world.sample(np.random.default_rng(1))
    assert draw.deviations.air_density == 1.1
    assert len(set(draw.surface.bank.values)) == len(draw.surface.bank.values) > 1
    assert draw.surface.bank.spacing == 50.0
    assert draw.wind(Wind(speeds=(4.0,), scale=2.0)).speed(0.0, 0.0) == 12.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise = 1", "Unknown name in a world 'noise'; the choices are about"),
        ("base = 'mars'", "Unknown world 'mars'; the choices are fleet"),
        ("sensing = 'eyes'", "Unknown set of sensors 'eyes'; the choices are exact"),
        ("latency = -0.01", "world latency is -0.01, but must be from 0 to 0.2 s"),
        ("latency = [0.1, 0.3]", "world latency is 0.3, but must be from 0 to 0.2 s"),
        ("latency = [0.2, 0.1]", "must be a number, [low, high] or {mean, std}"),
        ("car = {weight = 2.0}", "Unknown deviation 'weight'; the choices are Cf"),
        ("car = {mass = [0.9, -1.0]}", "must be a number, [low, high]"),
        ("car = {mass = [-1.0, 1.0]}", "deviation mass is -1.0"),
        ("car = {Cf = {mean = 1.0, std = 3.0}}", "deviation Cf is -8.0"),
        ("road = {friction = 0.0}", "world road friction is 0.0, but must be from 0.05 to 2"),
        ("road = {ice = 1.0}", "Unknown name in a world's road 'ice'"),
        ("road = {wavelength = [1.0, 2.0]}", "world road wavelength"),
        ("air = {side_wind = nan}", "world air side_wind is nan"),
        ("patches = [[20.0, 10.0, 0.5]]", "0 <= start < end in m"),
        ("patches = [[0.0, 10.0, 0.0]]", "world patches friction is 0.0"),
        ("patches = 3", "world patches is 3"),
        ("steering_sensor = 'knee'", "must be wheel or servo"),
        ("[sensing]\nposition = {measured = false}", "the state ey cannot be observed"),
        ("[sensing]\nposition = {noise = 1.0}", "Unknown name in sensing position 'noise'"),
        ("[sensing]\nvelocity = 1", "Unknown name in a world's sensing 'velocity'"),
        ("[sensing]\nposition = {std = -1.0}", "sensing position.std is -1.0"),
        ("[sensing]\nscale = -1.0", "world sensing scale is -1.0"),
        ("[car", "is no TOML file"),
    ],
)
def test_a_wrong_file_gives_one_sentence(tmp_path, text, message):
    file = tmp_path / "own.toml"
    file.write_text(text)
    with pytest.raises(DataError) as error:
        load_world(file)
    assert message in str(error.value) and "own.toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_an_unknown_or_unreadable_world_says_so(tmp_path):
    with pytest.raises(UnknownNameError, match="Unknown world 'venus'; the choices are FILE.toml"):
        load_world("venus")
    with pytest.raises(DataError, match="The world .* cannot be read"):
        load_world(tmp_path / "none.toml")


# The road -----------------------------------------------------------------------------------------


def tilted(**slopes):
    plant = Plant()
    plant.tilt(**slopes)
    return plant


def test_a_bank_asks_the_tires_for_its_side_force():
    """Straight ahead on 4 %: the tires hold m g sin(atan 0.04), to 1 % (the bar)."""
    plant = tilted(bank=0.04)
    state = plant.reset(vx=15.0, align="course")
    side = plant.wheels.Fy[:2].sum() * math.cos(state.delta) + plant.wheels.Fy[2:].sum()
    expected = -plant.params.m * GRAVITY * math.sin(math.atan(0.04))
    assert side == pytest.approx(expected, rel=0.01)
    for _ in range(60):
        state = plant.step(plant.held)
    assert abs(state.y) < 0.01 and abs(state.r) < 1e-5


def test_a_grade_changes_the_speed_as_its_pull_does():
    """Rolling for 2 s up 6 % and on the level: the difference is g sin m / m_eff, to 1 %."""
    speeds = []
    for grade in (0.0, 0.06):
        plant = tilted()
        state = plant.reset(vx=20.0)
        plant.tilt(grade=grade)
        held = plant.held
        before = state.vx
        for _ in range(60):
            state = plant.step(held)
        speeds.append(state.vx - before)
    p, T = plant.params, 60 * plant.Ts
    expected = -GRAVITY * math.sin(math.atan(0.06)) * p.m / p.m_eff * T
    # the drag falls with the speed: 1.1 m/s less than 20 m/s, integrated by its slope
    drag = p.rho_air * p.CdA * 20.0 / p.m_eff
    expected *= (1.0 - math.exp(-drag * T)) / (drag * T)
    assert speeds[1] - speeds[0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("psi", [0.7, -2.0])
def test_a_slope_turns_with_the_road(psi):
    """The same trim whichever way the road goes, and gravity keeps its size."""
    straight, turned = tilted(bank=0.03, grade=0.05), tilted(bank=0.03, grade=0.05)
    a, b = straight.reset(vx=12.0), turned.reset(vx=12.0, psi=psi)
    assert np.linalg.norm(turned.model.opt.gravity) == pytest.approx(GRAVITY)
    for _ in range(30):
        a, b = straight.step(straight.held), turned.step(turned.held)
    along = b.x * math.cos(psi) + b.y * math.sin(psi)
    left = b.y * math.cos(psi) - b.x * math.sin(psi)
    assert (along, left, b.vx, b.vy) == pytest.approx((a.x, a.y, a.vx, a.vy), abs=1e-6)


def test_split_friction_turns_a_braking_car_to_its_good_side():
    """Left on ice: the right wheels brake alone, and their force turns the car to the right."""
    plant = Plant()
    plant.reset(vx=20.0)
    straight = Road.from_curvature(np.zeros(2), 500.0)
    scenario = Scenario(name="s", path=straight, speed=SpeedProfile.constant(20.0, straight))
    Ground(plant, scenario, Surface(friction_left=0.3)).lay(0.0, 0.0)
    assert plant.friction == pytest.approx([0.3, 1.0, 0.3, 1.0])
    r = plant.state.r
    for _ in range(5):
        state = plant.step(Command(0.0, -5.0))
    w, p = plant.wheels, plant.params
    before = state.r
    moment = (w.Fx[1] + w.Fx[3] - w.Fx[0] - w.Fx[2]) * p.track_f / 2.0  # of the braking
    side = p.lf * w.Fy[:2].sum() - p.lr * w.Fy[2:].sum()
    for _ in range(1):
        state = plant.step(Command(0.0, -5.0))
    assert moment < -1500.0 and state.r < r - 0.02
    # its yaw acceleration over one period, less the side forces' moment; 10 %: they are growing
    after = plant.wheels
    side = 0.5 * (side + p.lf * after.Fy[:2].sum() - p.lr * after.Fy[2:].sum())
    moment = 0.5 * (moment + (after.Fx[1] + after.Fx[3] - after.Fx[0] - after.Fx[2]) * 1.51 / 2.0)
    assert (state.r - before) / plant.Ts == pytest.approx((moment + side) / p.Iz, rel=0.1)


def test_a_slope_is_smooth_bounded_and_closes_on_a_lap():
    values = tuple(np.random.default_rng(0).uniform(-0.06, 0.06, 32))
    slope = Slope(values=values, spacing=100.0).around(1930.0)
    s = np.linspace(0.0, 3860.0, 7721)
    y = np.array([slope(one) for one in s])
    assert np.abs(y).max() <= 0.06
    assert y[: 3861] == pytest.approx(y[3860:], abs=1e-9)
    # half a cosine over 100 m: at most pi/2 times the mean slope between the knots
    assert np.abs(np.diff(y)).max() < 0.5 * math.pi / 2 * 0.12 / 96.0
    with pytest.raises(OptionError, match="slope is"):
        Slope(values=(0.7,))


# The loop -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bend():
    """150 m with a bend, at 12 m/s."""
    road = Road.from_curvature(np.array([0.0, 0.0, 0.02, 0.02, 0.0, 0.0]), 30.0)
    return Scenario(name="bend", path=road, speed=SpeedProfile.constant(12.0, road))


def drive(plant, scenario, **options):
    return simulate(plant, load_controller("stanley"), scenario, **options)


def test_the_ideal_world_has_no_columns_more_and_no_other_numbers(plant, bend):
    log = drive(plant, bend)
    assert not set(log.columns) & {*MEASURED, *ESTIMATED}
    result = metrics(log)
    assert result["world"] == {"name": "ideal", "drawn": {}}
    assert result["estimator"] == "none" and result["estimate_ey_rmse_m"] is None
    assert log.meta["options"] == {"delay": 0}
    again = drive(plant, bend, world="ideal", seed=5)
    assert (again.columns["ey_m"] == log.columns["ey_m"]).all()


def test_errors_are_scored_from_the_truth_and_the_estimate_lies_beside_it(plant, bend):
    log = drive(plant, bend, world="rtk", estimator="none", seed=2)
    c = log.columns
    s, ey = bend.path.project(c["x_m"][40], c["y_m"][40], c["s_m"][40])
    assert (s, ey) == pytest.approx((c["s_m"][40], c["ey_m"][40]), abs=1e-9)
    error = c["est_ey_m"] - c["ey_m"]
    # 1 cm white at each of n instants: the rms is known to 1 / sqrt(2 n), three of it
    assert abs(math.sqrt(np.mean(error**2)) / 0.01 - 1.0) < 3.0 / math.sqrt(2.0 * len(error))
    result = metrics(log)
    assert result["estimate_ey_rmse_m"] == pytest.approx(math.sqrt(np.mean(error**2)))
    assert result["estimator"] == "none" and result["world"]["name"] == "rtk"
    assert set(result["world"]["drawn"]["sensors"]) == {"ax_bias_mps2", "ay_bias_mps2"}
    assert np.isnan(c["meas_vy_mps"]).all() and np.isfinite(c["est_vy_mps"]).all()


def test_a_seed_gives_a_run_again_and_leaves_the_plant_as_it_was(bend):
    plant = Plant(friction=0.9)
    runs = [drive(plant, bend, world="fleet", estimator="none", seed=s) for s in (1, 1, 2)]
    rows = [run.columns["ey_m"] for run in runs]
    assert (rows[0] == rows[1]).all() and not (rows[0][:50] == rows[2][:50]).any()
    assert plant.deviations == NOMINAL and plant.latency == 0.0
    assert plant.friction == pytest.approx(np.full(4, 0.9))
    assert model_sha256(plant.model) == model_sha256(Plant().model)  # gravity too
    first = drive(Plant(friction=0.9), bend).columns["ey_m"]
    assert (drive(plant, bend).columns["ey_m"] == first).all()


def test_the_controllers_own_generator_does_not_depend_on_the_world(plant, bend):
    class Rolling:
        def reset(self, rng):
            self.first = rng.uniform()

        def command(self, state, preview):
            return Command(0.0, 0.0)

    firsts = []
    for world in ("ideal", "fleet"):
        controller = Rolling()
        simulate(plant, controller, bend, world=world, estimator="none", seed=7)
        firsts.append(controller.first)
    assert firsts == [np.random.default_rng(7).uniform()] * 2


def test_a_sensor_at_the_servo_does_not_see_offset_and_ratio(plant, bend):
    car = {"steer_offset": 0.01, "steer_ratio": 0.95}
    seen = {}
    for place in ("wheel", "servo"):
        world = World(name="w", sensing=RTK, car=car, steering_sensor=place)
        c = drive(plant, bend, world=world, estimator="none").columns
        seen[place] = c["meas_delta_rad"], c["delta_rad"]
    noise = RTK.delta.std
    measured, true = seen["wheel"]
    assert np.std(measured - true) == pytest.approx(noise, rel=0.2)
    assert abs(np.mean(measured - true)) < noise
    measured, true = seen["servo"]
    assert np.mean(0.95 * measured + 0.01 - true) == pytest.approx(0.0, abs=noise)
    assert np.mean(true - measured) > 0.008


def test_wind_and_friction_of_a_world_reach_the_car(plant, bend):
    calm = drive(plant, bend)
    blown = drive(plant, bend, world=World(name="w", air={"side_wind": 10.0}))
    assert (blown.columns["wind_mps"] == 10.0).all()
    assert abs(blown.columns["ey_m"][5] - calm.columns["ey_m"][5]) > 1e-6
    icy = drive(plant, bend, world=World(name="w", road={"friction": 0.5, "friction_left": 0.8}))
    assert icy.columns["mu_fl"][5] == pytest.approx(0.4 * calm.columns["mu_fl"][5], rel=0.01)
    assert icy.columns["mu_rr"][5] == pytest.approx(0.5 * calm.columns["mu_rr"][5], rel=0.01)


def test_a_patch_lies_where_it_was_laid(plant, bend):
    """Each axle is on it while its wheels are between 50 and 70 m."""
    world = World(name="w", patches=[[50.0, 70.0, [0.4, 0.5]]])
    log = drive(plant, bend, world=world)
    ((start, end, factor),) = log.meta["world"]["drawn"]["road"]["patches"]
    assert (start, end) == (50.0, 70.0) and 0.4 <= factor <= 0.5
    c, car = log.columns, plant.params
    # what a row shows was set at the instant before: 12 m/s, 0.4 m; peak friction falls with load
    for wheel, ahead in (("fl", car.lf), ("rr", -car.lr)):
        s, mu = c["s_m"] + ahead, c[f"mu_{wheel}"]
        on, off = (s > 50.5) & (s < 69.5), (s < 49.5) | (s > 70.5)
        assert mu[on].max() < 0.6 * mu[off].min()
        assert mu[on].mean() == pytest.approx(factor * mu[off].mean(), rel=0.05)


@pytest.mark.parametrize("periods", [0, 1, 2])
def test_a_latency_of_whole_periods_gives_the_trace_of_a_delay(plant, bend, periods):
    late = drive(plant, bend, latency=0.033 * periods).columns
    delayed = drive(plant, bend, delay=periods).columns
    for name in late:
        assert np.array_equal(late[name], delayed[name], equal_nan=True), name


def test_an_option_replaces_what_the_world_draws(plant, bend):
    log = drive(plant, bend, world="fleet", estimator="none", latency=0.01,
                deviations=Deviations(mass=1.1))
    drawn = log.meta["world"]["drawn"]
    assert drawn["latency"] == 0.01 and drawn["car"] == {"mass": 1.1}


class Doubtful:
    """An estimator that passes the truth on, and now and then says nothing."""

    events = 3

    def __init__(self, Ts):
        self.resets = self.calls = 0

    def reset(self, first, rng):
        self.resets += 1

    def update(self, measured, command):
        self.calls += 1
        x = math.nan if self.calls == 20 else measured.x
        m = measured
        return State(x, m.y, m.psi, m.vx, m.vy, m.r, m.delta, m.ax, m.ay, m.wheel_speed)


def test_an_estimator_without_a_state_is_an_event_counted_and_reset(plant, bend, user_module):
    import inspect

    source = "import math\nfrom lpvmpc.interface import State\n" + inspect.getsource(Doubtful)
    user_module(source, "guess")
    log = drive(plant, bend, estimator="guess:Doubtful")
    assert log.meta["completed"] and log.meta["estimator_events"] == 3 + 1
    assert np.isfinite(log.columns["est_x_m"]).all()
    assert metrics(log)["estimate_ey_rmse_m"] < 1e-12
    user_module(source.replace("self.calls == 20", "self.calls >= 20"), "lost")
    log = drive(plant, bend, estimator="lost:Doubtful")
    assert "'lost:Doubtful' returned at t = 0.627 s, twice" in log.meta["reason"]
    assert len(log) == 20 and not log.meta["completed"]
    user_module(source.replace("self.calls += 1", "1 / 0"), "broken")
    with pytest.raises(EstimatorError, match="raised in update at t = 0.000 s: ZeroDivision"):
        drive(plant, bend, estimator="broken:Doubtful")


def test_a_car_that_cannot_be_driven_is_said_and_the_plant_is_whole(plant, bend):
    world = World(name="w", car={"load": 1000.0, "load_x": -2.5})
    with pytest.raises(OptionError, match="off their stops"):
        drive(plant, bend, world=world)
    assert plant.deviations == NOMINAL
    with pytest.raises(LPVMPCError, match="Unknown world"):
        drive(plant, bend, world="moon")


def test_the_adaptive_controller_drives_a_noisy_world():
    """It runs at all, with the package's adaptive MPC, on measurements alone."""
    scenario = load_scenario("double-lane-change")
    log = simulate(Plant(), load_controller("lpv-mpc"), scenario, world="rtk", estimator="none")
    assert len(log) > 100 and metrics(log)["estimate_ey_rmse_m"] < 0.02
