"""What the environments are given: wrong options, actions, seeds, and calls out of turn."""

import math

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from lpvmpc.errors import LPVMPCError, OptionError, PathError, UnknownNameError  # noqa: E402
from lpvmpc.gym.track import TrackEnv  # noqa: E402
from lpvmpc.gym.track_vec import TrackVecEnv  # noqa: E402

ROAD = ("random-1",)
STILL = np.zeros(2, dtype=np.float32)


def sentence(raised):
    """The message, if it is one sentence."""
    text = str(raised.value)
    assert text[0].isupper() or " is " in text, text
    assert text.endswith(".") and "\n" not in text, text
    return text


@pytest.fixture(scope="module")
def env():
    made = TrackEnv(roads=ROAD)
    made.reset(seed=0)
    return made


@pytest.fixture(scope="module")
def many():
    made = TrackVecEnv(2, roads=ROAD, threads=1)
    made.reset(seed=0)
    return made


# What it is made of -------------------------------------------------------------------------------


@pytest.mark.parametrize(("given", "error", "text"), [
    ({"roads": ()}, OptionError, "roads is (), but must be one or more names"),
    ({"roads": "paper"}, OptionError, "roads is 'paper', but must be one or more names"),
    ({"roads": (3,)}, OptionError, "roads is (3,), but must be names"),
    ({"roads": ("nowhere",)}, UnknownNameError, "Unknown scenario 'nowhere'"),
    ({"roads": ("random-1", "nowhere")}, UnknownNameError, "Unknown scenario 'nowhere'"),
    ({"roads": ("gone.csv",)}, PathError, "gone.csv"),
    ({"worlds": "rtk"}, OptionError, "worlds is 'rtk', but must be one or more worlds"),
    ({"worlds": (3,)}, OptionError, "worlds is (3,), but must be names"),
    ({"worlds": ("mars",)}, UnknownNameError, "Unknown world 'mars'"),
    ({"observe": "all"}, OptionError, "observe is 'all', but must be estimate or truth"),
    ({"random_start": "yes"}, OptionError, "random_start is 'yes', but must be True or False"),
    ({"max_steps": 1.5}, OptionError, "max_steps is 1.5, but must be a whole number"),
    ({"max_steps": True}, OptionError, "max_steps is True, but must be a whole number"),
    ({"traffic": "tram"}, UnknownNameError, "Unknown traffic 'tram'"),
    ({"scenario_options": 3}, OptionError, "scenario_options is 3, but must be a dictionary"),
    ({"scenario_options": {"grip": -1.0}}, OptionError, "grip is -1.0"),
    ({"width": 1.5}, OptionError, "width is 1.5, but must be a whole number from 16 to 4,096"),
    ({"height": 0}, OptionError, "height is 0, but must be a whole number from 16 to 4,096"),
    ({"render_mode": "film"}, OptionError, "render_mode is 'film', but must be None"),
    ({"world": "rtk"}, UnknownNameError, "Unknown option of the environment 'world'"),
])
def test_what_no_environment_can_be_made_of_is_told_at_once(given, error, text):
    for make in (TrackEnv, lambda **more: TrackVecEnv(2, **more)):
        with pytest.raises(error) as raised:
            make(**{"roads": ROAD, **given})
        assert text in sentence(raised)


@pytest.mark.parametrize(("given", "text"), [
    ({"num_envs": 0}, "num_envs is 0, but must be a whole number from 1 to 100,000"),
    ({"num_envs": 2.0}, "num_envs is 2.0, but must be a whole number"),
    ({"threads": -1}, "threads is -1, but must be a whole number from 0 to 1,024"),
    ({"threads": "two"}, "threads is 'two', but must be a whole number"),
    ({"autoreset_mode": "Never"}, "autoreset_mode is 'Never', but must be one of NextStep"),
    ({"render_mode": "human"}, "render_mode is 'human', but must be None or 'rgb_array'"),
])
def test_what_many_cannot_be_made_of_is_told_at_once(given, text):
    with pytest.raises(OptionError) as raised:
        TrackVecEnv(**{"num_envs": 2, "roads": ROAD, **given})
    assert text in sentence(raised)


# Reset --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("options", "error", "text"), [
    (3, OptionError, "options is 3, but must be a dictionary"),
    ("road", OptionError, "options is 'road', but must be a dictionary"),
    ({"speed": 3.0}, UnknownNameError, "Unknown option of reset 'speed'"),
    ({1: 2}, UnknownNameError, "Unknown option of reset '1'"),
    ({"road": None}, OptionError, "road is None, but must be the name"),
    ({"road": "nowhere"}, UnknownNameError, "Unknown scenario 'nowhere'"),
    ({"world": 3}, OptionError, "world is 3, but must be a name"),
    ({"world": "mars"}, UnknownNameError, "Unknown world 'mars'"),
    ({"s": math.nan}, OptionError, "s is nan, but must be a number from 0 on"),
    ({"s": math.inf}, OptionError, "s is inf, but must be a number from 0 on"),
    ({"s": -0.1}, OptionError, "s is -0.1, but must be a number from 0 on"),
    ({"s": 1e9}, OptionError, "s is 1000000000.0, but must be at most the length of random-1"),
    ({"ey": "left"}, OptionError, "ey is 'left', but must be a number from -20 to 20"),
    ({"ey": 1e9}, OptionError, "ey is 1000000000.0, but must be a number from -20 to 20"),
    ({"epsi": math.nan}, OptionError, "epsi is nan, but must be a number from -3.14159"),
    ({"vx": -3.0}, OptionError, "vx is -3.0, but must be a number from 2 to 40"),
    ({"vx": [1, 2]}, OptionError, "vx is [1, 2], but must be a number from 2 to 40"),
    ({"vx": True}, OptionError, "vx is True, but must be a number from 2 to 40"),
])
def test_what_an_episode_cannot_begin_with_is_one_sentence(env, many, options, error, text):
    for made in (env, many):
        with pytest.raises(error) as raised:
            made.reset(options=options)
        assert text in sentence(raised)
    env.reset(seed=0)  # they go on
    many.reset(seed=0)


def test_an_episode_whose_reset_failed_has_not_begun():
    made = TrackEnv(roads=ROAD)
    made.reset(seed=0)
    with pytest.raises(OptionError):
        made.reset(options={"s": 1e9})
    with pytest.raises(LPVMPCError, match="must be reset before its first step"):
        made.step(STILL)
    several = TrackVecEnv(2, roads=ROAD, threads=1)
    several.reset(seed=0)
    with pytest.raises(OptionError):
        several.reset(options={"s": 1e9})
    with pytest.raises(LPVMPCError, match="must be reset before its first step"):
        several.step(np.zeros((2, 2)))


@pytest.mark.parametrize("seed", [-1, 1.5, "one", [1], [1, "two"]])
def test_what_is_no_seed_is_one_sentence(env, many, seed):
    errors = (LPVMPCError, gymnasium.error.Error)
    with pytest.raises(errors, match=r"(?i)seed"):
        many.reset(seed=seed)
    if not isinstance(seed, list):
        with pytest.raises(errors, match=r"(?i)seed"):
            env.reset(seed=seed)


@pytest.mark.parametrize("mask", [np.zeros(2, bool), np.ones(3, bool), "all", [1, 0]])
def test_what_is_no_mask_is_one_sentence(many, mask):
    with pytest.raises(OptionError, match=r"reset_mask is .*, but must be a mask of shape \(2,\)"):
        many.reset(options={"reset_mask": mask})


# Steps --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("action", [
    [math.nan, 0.0], [0.0, math.inf], [0.0], [0.0] * 3, [[0.0, 0.0]], 0.0, None, "ab", ["a", "b"],
    [1j, 0.0], [None, None], {}, [[0.0, 0.0], [0.0]], [1e400, 0.0],
])
def test_what_is_no_action_is_one_sentence_and_moves_nothing(env, many, action):
    before = env.reset(seed=3)[0]
    with pytest.raises(LPVMPCError) as raised:
        env.step(action)
    assert sentence(raised).startswith("Actions must be finite numbers of shape (2,), steering")
    assert np.array_equal(env.cars.observations()[0], before)
    with pytest.raises(LPVMPCError) as raised:
        many.step([action, [0.0, 0.0]] if isinstance(action, list) else action)
    assert sentence(raised).startswith("Actions must be finite numbers of shape (2, 2), steering")


def test_an_action_beyond_its_bounds_is_cut(env):
    cut = []
    for action in ([5.0, -7.0], [1.0, -1.0], np.array([1, -1])):
        env.reset(seed=3)
        seen, reward, *_ = env.step(action)
        cut.append((seen.tobytes(), reward))
    assert cut[0] == cut[1] == cut[2]


def test_a_long_action_is_quoted_shortly():
    with pytest.raises(LPVMPCError) as raised:
        TrackVecEnv(64, roads=ROAD, threads=1).step(np.zeros((63, 2)))
    assert len(sentence(raised)) < 220


# Out of turn --------------------------------------------------------------------------------------


def test_nothing_works_before_the_first_reset():
    made = TrackEnv("rgb_array", roads=ROAD)
    several = TrackVecEnv(2, "rgb_array", roads=ROAD, threads=1)
    for call in (lambda: made.step(STILL), made.render, lambda: made.sight(3),
                 lambda: several.step(np.zeros((2, 2))), several.render):
        with pytest.raises(LPVMPCError) as raised:
            call()
        assert sentence(raised) == "An environment must be reset before its first step."


def test_an_episode_that_has_ended_is_not_driven_on():
    made = TrackEnv(roads=ROAD, max_steps=2)
    made.reset(seed=0)
    assert not made.step(STILL)[3] and made.step(STILL)[3]
    state, _ = made.sight(3)  # what is seen at its end may be asked for
    assert math.isfinite(state.vx)
    with pytest.raises(LPVMPCError) as raised:
        made.step(STILL)
    assert sentence(raised) == "The episode has ended; reset the environment before its next step."
    made.reset()
    made.step(STILL)


def test_a_closed_environment_says_so_and_may_be_closed_again():
    made, several = TrackEnv(roads=ROAD), TrackVecEnv(2, roads=ROAD, threads=1)
    for closing in (made, several):
        closing.reset(seed=0)
        closing.close()
        closing.close()
    for call in (lambda: made.step(STILL), made.reset, lambda: made.sight(3),
                 lambda: several.step(np.zeros((2, 2))), several.reset):
        with pytest.raises(LPVMPCError) as raised:
            call()
        assert sentence(raised) == "The environment is closed; make another one."
