"""`--traffic` and `--detour` of `lpvmpc track`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from lpvmpc.kit import cli
from lpvmpc.kit.files import readable

if TYPE_CHECKING:
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.traffic.users import Traffic

TrafficName = Annotated[str | None, cli.Option(metavar="NAME|FILE", help=(
    "Other road users: parked-car, braking-lead, slow-car, or your own FILE.toml; the controller "
    "is told nothing of them, and a contact ends the run."
))]
"""Type of the option."""


def with_traffic(
    name: str | None, round_it: bool, scenario: Scenario
) -> tuple[Traffic | None, Scenario]:
    """The traffic of a run, and its scenario, round that traffic where it is asked for."""
    if name is None:
        return None, scenario
    from lpvmpc.plant.mjcf import packaged_car
    from lpvmpc.traffic.detour import detour
    from lpvmpc.traffic.users import load_traffic

    traffic = load_traffic(name, scenario)
    return traffic, detour(scenario, traffic, packaged_car()) if round_it else scenario


def traffic_options(name: str | None, round_it: bool) -> dict[str, Any]:
    """What is recorded of the traffic, where there is any."""
    return {} if name is None else {"traffic": readable(name), "detour": round_it}


def told_of(met: dict[str, Any]) -> str:
    """A line on how near the car came to somebody."""
    if met["contact"]:
        return f"Traffic: contact with {met['name']} at {met['gap_min_t_s']:.1f} s."
    headway = met["headway_min_s"]
    behind = "" if headway is None else f"; smallest headway {headway:.2f} s"
    return (f"Traffic: {met['gap_min_m']:.2f} m from {met['name']} at {met['gap_min_t_s']:.1f} s"
            f"{behind}.")
