import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvmpc.sim import batch
from lpvmpc.sim.world import WORLDS
from lpvmpc.tune import driving, genetic, pso, tuning
from lpvmpc.tune.tuning import Space, Task


def fake_log(vx=10.0, vy=0.0, epsi=0.003, steer=0.0, reached=100.0, completed=True):
    """A straight run of 50 periods at constant errors, its steering alternating by +-`steer`."""
    n = 50
    columns = {name: np.zeros(n) for name in ("x_m", "y_m", "ay_mps2", "kkt_residual")}
    columns |= {
        "vx_mps": np.full(n, vx),
        "vy_mps": np.full(n, vy),
        "vx_ref_mps": np.full(n, 10.0),
        "ey_m": np.full(n, 0.02),
        "epsi_rad": np.full(n, epsi),
        "delta_cmd_rad": steer * (-1.0) ** np.arange(n),
        "solved": np.ones(n, bool),
        "fallback": np.zeros(n, np.int8),
    }
    meta = dict.fromkeys(("scenario", "controller", "stiffness", "seed", "versions", "wall_s"))
    meta |= {"completed": completed, "reason": "", "s_end_m": reached, "Ts": 0.033}
    meta |= dict.fromkeys(("duration_s", "reference_duration_s", "realtime_factor"), 1.0)
    meta["model_sha256"] = ""
    scenario = SimpleNamespace(path=SimpleNamespace(length=100.0, closed=False))
    return SimpleNamespace(
        columns=columns, meta=meta, timing={"step_us": np.ones(n)}, scenario=scenario
    )


# What it costs ----------------------------------------------------------------------------------


def plain(log, scale=1.0):
    """The cost of a run without its saturation."""
    cost = driving.cost(log, scale)
    return cost / (1.0 - cost / driving.LOST)


def test_the_cost_is_the_sum_of_three_rmse_over_the_worlds_scale():
    expected = 0.02 + driving.COURSE * 0.003 + driving.SPEED * 0.5
    # the sum of three numbers of this size, to rounding
    assert plain(fake_log(vx=10.5)) == pytest.approx(expected, rel=1e-12)
    assert plain(fake_log(vx=10.5), 0.005) == pytest.approx(expected / 0.005, rel=1e-12)


def test_an_angle_that_side_wind_asks_for_costs_nothing():
    crab = math.atan2(0.3, 10.0)  # the car drifts to the left and so looks to the right
    assert plain(fake_log(vy=0.3, epsi=-crab)) == pytest.approx(0.02, rel=1e-12)


def test_steering_and_a_nervous_command_are_charged():
    # +-1 mrad from period to period: first differences of 2 mrad and second ones of 4 in 33 ms
    calm, nervous = plain(fake_log()), plain(fake_log(steer=0.001))
    expected = (driving.STEERING * 0.002 + driving.NERVOUS * 0.004) / 0.033
    assert nervous - calm == pytest.approx(expected, rel=1e-9)


def test_a_lost_car_costs_more_than_any_that_arrives_and_less_the_further_it_came():
    early, late = (
        driving.cost(fake_log(completed=False, reached=reached), 0.001) for reached in (10.0, 90.0)
    )
    worst = driving.cost(fake_log(vx=1000.0), 0.001)
    assert 2.0 * driving.LOST > early > late > driving.LOST > worst


def test_each_preset_world_has_a_scale_and_others_that_of_the_fleet():
    assert set(driving.SCALES) == set(WORLDS)
    assert driving.scale(batch.Run(world="ideal")) < driving.scale(batch.Run(world="fleet"))
    own = batch.Run(world={"name": "own", "latency": 0.01})
    assert driving.scale(own) == driving.OTHER_SCALE


# The risk ---------------------------------------------------------------------------------------


def test_the_risk_is_the_mean_of_the_worst_fifth_and_a_share_of_the_mean():
    ten = [1.0, 9.0, 2.0, 3.0, 4.0, 7.0, 5.0, 6.0, 8.0, 5.0]
    assert driving.risk(ten) == 8.5 + driving.PLAIN * 5.0
    assert driving.risk([3.0, 1.0]) == 3.0 + driving.PLAIN * 2.0  # at least one run


def test_the_risk_never_falls_as_runs_come_in():
    costs = np.random.default_rng(0).exponential(size=23).tolist()
    so_far = [driving.risk(costs[:k], len(costs)) for k in range(1, 24)]
    assert so_far == sorted(so_far) and so_far[-1] == driving.risk(costs)


@dataclass(frozen=True)
class Parts:
    """A cost of five parts that stops where it may; counts the parts that it looked at."""

    seen: list
    limit: float = math.inf

    def up_to(self, limit):
        return replace(self, limit=limit)

    def __call__(self, x):
        total = 0.0
        for part in (x - 0.3) ** 2:
            self.seen.append(part)
            total += part
            if total > self.limit:
                break
        return total


@pytest.mark.parametrize(
    ("search", "settings"), [(genetic, genetic.GeneticSettings), (pso, pso.SwarmSettings)]
)
def test_stopping_early_spares_work_and_changes_nothing(search, settings):
    stopped, whole = Parts([]), Parts([])
    how = {"seed": 3, "settings": settings(generations=12, population=8)}
    one = search.minimise(stopped, np.zeros(5), np.ones(5), **how)
    other = search.minimise(lambda x: whole(x), np.zeros(5), np.ones(5), **how)
    assert one.best.tolist() == other.best.tolist() and one.cost == other.cost  # bit for bit
    assert [g.mean for g in one.history] == [g.mean for g in other.history]
    assert len(stopped.seen) < 0.95 * len(whole.seen)


def test_a_weight_set_is_not_driven_on_once_it_is_certain_to_be_too_bad(monkeypatch):
    log = fake_log(completed=False, reached=50.0)
    driven = []
    monkeypatch.setattr(batch, "drive", lambda run: driven.append(run) or log)
    runs = tuning.runs(Task(), {"q_ey": 1.0})
    cost = driving.DrivingCost("lpv-mpc", runs, Space({"q_ey": (1.0, 2.0)}))
    whole = cost(np.zeros(1))
    assert whole == driving.risk([driving.cost(log, 1.0)] * len(runs))
    assert [run.seed for run in driven] == [run.seed for run in reversed(runs)]
    driven.clear()
    assert 10.0 < cost.up_to(10.0)(np.zeros(1)) < whole and len(driven) == 1
    assert cost.up_to(whole)(np.zeros(1)) == whole  # as good as the worst: it may stay
