import json

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from lpvmpc.control import weights_file
from lpvmpc.control.cost import PAPER_WEIGHTS, Weights, _doubled
from lpvmpc.control.registry import CONTROLLERS, TUNABLE
from lpvmpc.errors import DataError, OptionError, OutputError
from lpvmpc.sim.names import load_controller


def test_what_is_written_is_read_to_the_last_bit(tmp_path):
    values = {"q_ey": 1.0 / 3.0, "q_epsi": 1e-300, "r_delta": 12345678.9}
    record = {"seed": 3, "scenarios": ["tuning-a"], "note": 'a "quoted" word'}
    weights_file.write_weights(tmp_path / "w.toml", "lpv-mpc", values, record)
    assert weights_file.read_weights(tmp_path / "w.toml", "lpv-mpc") == values


WRONG = {
    "weights = [": "is no TOML",
    'controller = "lpv-mpc"': "has no table [weights]",
    'controller = "lpv-mpc"\n[weights]': "has no table [weights]",
    "[weights]\nq_ey = 1.0": "does not say for which controller",
    'controller = "stanley"\n[weights]\nk = 1.0': "is for controller 'stanley', but 'lpv-mpc'",
    'controller = "lpv-mpc"\n[weights]\nq_ey = "much"': "q_ey is 'much', but must be a number",
    'controller = "lpv-mpc"\n[weights]\nq_ey = true': "q_ey is True, but must be a number",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_file_is_one_sentence(tmp_path, text):
    (tmp_path / "w.toml").write_text(text)
    with pytest.raises(DataError) as error:
        weights_file.read_weights(tmp_path / "w.toml", "lpv-mpc")
    assert WRONG[text] in str(error.value) and "w.toml" in str(error.value)


def test_a_number_changed_in_a_written_file_is_refused(tmp_path):
    file = tmp_path / "w.toml"
    weights_file.write_weights(file, "lpv-mpc", {"q_ey": 80.0, "q_r": 0.5}, {"seed": 3})
    whole = file.read_text()
    for old, new in (("80.0", "81.0"), ("seed = 3", "seed = 4"), ("q_r", "q_x"), ("sha", "sho")):
        assert old in whole
        file.write_text(whole.replace(old, new))
        with pytest.raises(DataError, match="its checksum is another|may hold only"):
            weights_file.read_weights(file)
    by_hand = [line for line in whole.splitlines() if not line.startswith("sha256")]
    file.write_text("\n".join(by_hand).replace("80.0", "81.0"))
    assert weights_file.read_weights(file) == {"q_ey": 81.0, "q_r": 0.5}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_the_files_of_the_package_carry_their_checksum(name):
    file = weights_file.shipped_file(name)
    assert not file.exists() or "\nsha256 = " in file.read_text()


@pytest.mark.parametrize("value", [0.0, 1e-12, 1e6])
@pytest.mark.parametrize("name", ["q_vx", "q_vy", "q_r", "q_ey", "q_epsi", "terminal"])
def test_every_weight_of_the_domain_makes_a_controller(name, value):
    load_controller("lpv-mpc", weights={name: value})


def test_a_cost_that_no_eigenvalues_tell_is_that_of_doubled_horizons():
    # an error of weight 0 that nothing brings back, beside one that a regulator exists for
    step, push = np.diag([1.0, 0.9]), np.array([[0.0], [1.0]])
    stage, rate = np.diag([0.0, 2.0]), np.array([0.5])
    cost = _doubled(step, push, stage, rate)
    ours = solve_discrete_are(step[1:, 1:], push[1:], stage[1:, 1:], np.diag(rate))
    np.testing.assert_allclose(cost, np.diag([0.0, ours[0, 0]]), rtol=1e-10)


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(DataError, match="nowhere.toml' cannot be read: No such file"):
        weights_file.read_weights(tmp_path / "nowhere.toml")


def test_an_unwritable_place_is_one_sentence(tmp_path):
    with pytest.raises(OutputError, match="Cannot write"):
        weights_file.write_weights(tmp_path / "no" / "w.toml", "lpv-mpc", {"q_ey": 1.0}, {})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"q_y": 1.0}, "weight is 'q_y', but must be one of q_vx, q_vy"),
        ({"q_ey": -1.0}, "weight q_ey is -1.0, but must be a number of at least 0"),
        ({"q_ey": np.nan}, "weight q_ey is nan"),
        ({"q_ey": 1e7}, "q_ey is 10000000.0, but must be a number of at least 0 and at most 1e+06"),
        ({"r_ax": 0.0}, "r_ax is 0.0, but must be a number of at least 1e-09"),
        ({"observer_gain": 1.5}, "weight observer_gain is 1.5, but must be a number from 0 to 1"),
    ],
)
def test_weights_without_meaning_are_refused(changes, sentence):
    with pytest.raises(OptionError) as error:
        weights_file.apply(Weights(), changes)
    assert sentence in str(error.value)


def test_weights_that_a_file_leaves_out_stay_as_set_by_hand():
    assert weights_file.chosen("lpv-mpc", {"q_ey": 7.0}, PAPER_WEIGHTS).q_epsi == 800.0


@pytest.mark.parametrize("name", TUNABLE)
def test_every_controller_says_what_is_tuned_and_between_which_bounds(name):
    weights = load_controller(name).weights
    values = weights_file.as_dict(weights)
    for tuned, (low, high) in weights.RANGES.items():
        assert tuned in values and 0.0 <= low < high
        weights_file.apply(weights, {tuned: low})
        weights_file.apply(weights, {tuned: high})


@pytest.mark.parametrize("name", CONTROLLERS)
def test_shipped_weights_can_be_read(name):
    file = weights_file.shipped_file(name)
    if file.exists():  # a controller may ship with the weights set by hand
        values = weights_file.read_weights(file, name)
        assert json.loads(json.dumps(values)) == values
