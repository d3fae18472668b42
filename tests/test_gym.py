import numpy as np
import pyarrow.parquet as pq
import pytest
from opengl import needs_opengl

gymnasium = pytest.importorskip("gymnasium")

import lpvmpc.gym  # noqa: E402
from lpvmpc import load_scenario  # noqa: E402
from lpvmpc.control.rivals import observation  # noqa: E402
from lpvmpc.errors import OptionError, UnknownNameError  # noqa: E402
from lpvmpc.gym.expert import demonstrate  # noqa: E402
from lpvmpc.gym.track import TrackEnv  # noqa: E402
from lpvmpc.gym.track_vec import TrackVecEnv  # noqa: E402
from lpvmpc.interface import Command  # noqa: E402
from lpvmpc.plant.plant import Plant  # noqa: E402
from lpvmpc.plant.rollout import Snapshot  # noqa: E402
from lpvmpc.sim.ground import Ground  # noqa: E402

ROADS = ("random-1", "random-2")


def test_gymnasium_makes_both_and_finds_nothing_wrong_with_one_car():
    from gymnasium.utils.env_checker import check_env

    lpvmpc.gym.register()
    env = gymnasium.make("lpvmpc/Track-v0", roads=ROADS, worlds=("rtk",))
    check_env(env.unwrapped, skip_render_check=True)
    many = gymnasium.make_vec("lpvmpc/TrackVec-v0", num_envs=3, roads=ROADS)
    assert isinstance(many.unwrapped, TrackVecEnv)
    assert many.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.NEXT_STEP


@pytest.mark.parametrize("world", ["ideal", "fleet"])
def test_each_of_many_cars_drives_as_one_alone(world):
    many = TrackVecEnv(3, roads=ROADS, worlds=(world,), max_steps=20, threads=2)
    alone = [TrackEnv(roads=ROADS, worlds=(world,), max_steps=20) for _ in range(3)]
    seen, _ = many.reset(seed=5)
    for i, env in enumerate(alone):
        assert np.array_equal(env.reset(seed=5 + i)[0], seen[i])
    rng = np.random.default_rng(0)
    ended = np.zeros(3, dtype=bool)
    for _ in range(45):
        actions = rng.uniform(-0.2, 0.2, (3, 2)).astype(np.float32)
        seen, reward, lost, over, _ = many.step(actions)
        for i, env in enumerate(alone):
            if ended[i]:  # next-step autoreset
                assert np.array_equal(env.reset()[0], seen[i]) and reward[i] == 0.0
                ended[i] = False
                continue
            own, gain, terminated, truncated, _ = env.step(actions[i])
            assert np.array_equal(own, seen[i])
            assert (gain, terminated, truncated) == (reward[i], lost[i], over[i])
            ended[i] = terminated or truncated
            assert many.observation_space.contains(seen)


def test_the_car_is_the_plant_and_the_errors_are_the_paths(plant):
    env = TrackEnv(roads=("random-3",), random_start=False)
    env.reset(seed=0)
    cars = env.cars
    state = cars.state(0)
    plant.friction = 1.0
    plant.reset(vx=round(state.vx))  # the settled state that the environment moved here
    scenario = load_scenario("random-3")
    # the same commands from the same state, moved: speeds and yaw rate agree to rounding
    for k in range(40):
        action = np.array([0.05 * np.sin(0.2 * k), 0.1], dtype=np.float32)
        seen, *_ = env.step(action)
        true = plant.step(observation.command_of(action, cars.delta_max))
        now = cars.state(0)
        assert np.allclose([now.vx, now.vy, now.r, now.delta, now.ay],
                           [true.vx, true.vy, true.r, true.delta, true.ay], atol=1e-7)
        s, ey = scenario.path.project(now.x, now.y, cars.where[0, 0])
        assert s == pytest.approx(cars.where[0, 0], abs=1e-9)
        assert seen[0] == pytest.approx(ey, abs=1e-6)


def test_same_step_reset_hands_over_the_last_observation():
    many = TrackVecEnv(2, roads=ROADS, max_steps=3, autoreset_mode="SameStep", threads=1)
    many.reset(seed=1)
    for _ in range(3):
        seen, _, _, over, info = many.step(np.zeros((2, 2), dtype=np.float32))
    assert over.all() and info["_final_obs"].all()
    assert not np.array_equal(info["final_obs"][0], seen[0])
    assert (many.cars.steps == 0).all()


def test_a_mask_begins_some_episodes_alone():
    many = TrackVecEnv(2, roads=ROADS, autoreset_mode="Disabled", threads=1)
    first, _ = many.reset(seed=1)
    many.step(np.zeros((2, 2), dtype=np.float32))
    before = many.cars.observations()
    again, _ = many.reset(seed=[1, None], options={"reset_mask": np.array([True, False])})
    assert np.array_equal(again[0], first[0]) and np.array_equal(again[1], before[1])


def test_what_reset_is_told_is_not_drawn():
    env = TrackEnv(roads=ROADS)
    own = {"road": "circuit", "world": "rtk", "s": 300.0, "ey": 0.3, "epsi": 0.0, "vx": 9.0}
    _, info = env.reset(seed=0, options=own)
    assert info["road"] == "circuit" and info["world"] == "rtk"
    assert info["s"] == pytest.approx(300.0, abs=0.1) and info["ey"] == pytest.approx(0.3, abs=1e-6)
    assert info["vx"] == pytest.approx(9.0, abs=1e-6)
    with pytest.raises(UnknownNameError, match="speed"):
        env.reset(options={"speed": 3.0})


def test_a_car_that_leaves_the_road_is_lost():
    env = TrackEnv(roads=ROADS, random_start=False)
    env.reset(seed=0)
    for _ in range(200):
        *_, reward, lost, over, _ = env.step(np.array([0.5, 0.5], dtype=np.float32))
        if lost:
            break
    assert lost and not over and reward == 0.0


def test_commands_and_actions_are_each_others_inverse():
    for given in ((0.2, -0.5), (-1.0, 1.0), (0.0, 0.0)):
        command = observation.command_of(np.array(given), 0.5)
        assert np.allclose(observation.action_of(command, 0.5), given)
    assert observation.command_of(np.array([9.0, -9.0]), 0.5) == Command(0.5, -8.0)


def test_a_car_of_the_fleet_is_the_plant_with_its_latency_deviations_and_road():
    env = TrackEnv(worlds=("fleet-production",), roads=("random-1",), observe="truth")
    env.reset(seed=4)
    cars, plant = env.cars, Plant()
    one = cars.ones[0]
    plant.deviations = one.draw.deviations
    plant.latency = round(one.draw.latency / plant.latency_step) * plant.latency_step
    assert plant.latency > 0.0 and not one.draw.surface.level
    plant.restore(Snapshot(cars.batch.state[0].copy(), float(cars.states[0, 2])))
    plant._actuation.start(*cars.ctrl[0, :2].tolist())
    ground = Ground(plant, one.scenario, one.draw.surface)
    rng = np.random.default_rng(4)
    for _ in range(20):
        action = np.clip(rng.normal(0.0, (0.1, 0.4)), -1.0, 1.0).astype(np.float32)
        ground.lay(cars.where[0, 0], cars.where[0, 4])
        state = plant.step(observation.command_of(action.astype(float), cars.delta_max))
        env.step(action)
        assert np.array_equal(state[:9], cars.states[0, :9])  # the same physics, bit for bit


def test_the_expert_stays_on_the_road_and_its_data_fit(tmp_path):
    out = tmp_path / "expert.parquet"
    data = demonstrate(90, roads=ROADS, worlds=("rtk",), seed=2, out=out)
    table = pq.read_table(out)
    assert table.num_rows == 90 and np.array_equal(table["ey"], data["observations"][:, 0])
    assert np.array_equal(table["action_acceleration"], data["actions"][:, 1])
    assert table.schema.metadata[b"controller"] == b'"lpv-mpc"'
    assert not data["terminated"].any() and np.abs(data["observations"][:, 0]).max() < 1.0
    assert np.abs(data["actions"]).max() <= 1.0 and data["actions"].std(axis=0).min() > 0.0
    again = demonstrate(90, roads=ROADS, worlds=("rtk",), seed=2)
    assert all(np.array_equal(data[name], again[name]) for name in data)


@needs_opengl
def test_pictures_show_the_car():
    env = TrackEnv("rgb_array", roads=ROADS, width=160, height=90)
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (90, 160, 3) and picture.std() > 10.0
    env.close()


@pytest.mark.parametrize("wrong", [
    {"roads": "circuit"}, {"worlds": []}, {"observe": "all"}, {"max_steps": 0},
    {"render_mode": "ansi"},
])
def test_wrong_settings_are_named(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        TrackEnv(**wrong)


def test_traffic_is_seen_and_a_contact_ends_the_episode(tmp_path):
    from gymnasium.utils.env_checker import check_env

    file = tmp_path / "town.toml"
    file.write_text('[[user]]\nname = "far"\ns = 70\ney = -3.0\n'
                    '[[user]]\nname = "near"\ns = 20\ney = 0.2\nspeed = 4\nlength = 4\nwidth = 2\n')
    road = ("double-lane-change",)  # straight for its first 40 m
    setting = {"roads": road, "traffic": file}
    check_env(TrackEnv(**setting), skip_render_check=True)
    env, plain = TrackEnv(**setting), TrackEnv(roads=road)
    own = {"s": 2.0, "epsi": 0.0}
    seen, _ = env.reset(seed=3, options=own)
    # nothing else changes
    assert np.array_equal(seen[:observation.SIZE], plain.reset(seed=3, options=own)[0])
    assert plain.observation_space.shape == (observation.SIZE,)
    car = env.cars.plant.params
    gap, offset, room, closing = seen[observation.SIZE:]
    ahead = 20.0 - 0.5 * (car.lf - car.lr) - 0.5 * (4.0 + car.length)
    assert gap == pytest.approx(ahead, abs=0.1)  # the start is found again within the grid
    assert offset == pytest.approx(0.2 - seen[0], abs=1e-5)
    assert room == pytest.approx(abs(offset) - 0.5 * (2.0 + car.width), abs=1e-5)
    assert closing == pytest.approx(seen[2] * np.cos(seen[1]) - 4.0, abs=0.1)
    gaps = []
    for _ in range(200):
        seen, reward, lost, over, info = env.step(np.array([0.0, 0.2], dtype=np.float32))
        assert env.observation_space.contains(seen)
        gaps.append(info["gap"])
        if lost or over:
            break
    assert lost and not over and reward == 0.0 and gaps[-1] == 0.0 < min(gaps[:-1])


def test_each_of_many_cars_in_traffic_sees_what_one_alone_does():
    setting = {"roads": ROADS, "traffic": "slow-car", "max_steps": 12}
    many = TrackVecEnv(2, threads=1, **setting)
    alone = [TrackEnv(**setting) for _ in range(2)]
    seen, _ = many.reset(seed=5)
    for i, env in enumerate(alone):
        assert np.array_equal(env.reset(seed=5 + i)[0], seen[i])
    for _ in range(11):
        seen, _, lost, _, info = many.step(np.zeros((2, 2), dtype=np.float32))
        for i, env in enumerate(alone):
            own, _, terminated, _, told = env.step(np.zeros(2, dtype=np.float32))
            assert np.array_equal(own, seen[i])
            assert (terminated, told["gap"]) == (lost[i], info["gap"][i])
    assert many.observation_space.contains(seen) and seen.shape == (2, observation.SIZE + 4)
    assert demonstrate(3, **setting)["observations"].shape == (3, observation.SIZE + 4)
    with pytest.raises(UnknownNameError, match="traffic 'tram'"):
        TrackEnv(traffic="tram").reset(seed=0)
    with pytest.raises(OptionError, match="traffic is 3"):
        TrackEnv(traffic=3)


@needs_opengl
def test_pictures_show_the_traffic():
    pictures = []
    for traffic in (None, "slow-car"):
        env = TrackEnv("rgb_array", roads=("double-lane-change",), traffic=traffic, width=160,
                       height=90, random_start=False)
        env.reset(seed=0)
        pictures.append(env.render().astype(int))
        env.close()
    changed = np.abs(pictures[1] - pictures[0]).max(axis=2) > 30
    assert 10 < changed.sum() < 2000  # a car some 30 m ahead, and nothing else
