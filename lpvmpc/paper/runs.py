"""What is driven: every controller on every road, and the ablation from the printed formulas on.

Nothing is driven here: the plan gives `batch.Run`s, described by names and numbers alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lpvmpc.control.registry import CORE
from lpvmpc.paper.printed_formulas import SLIPS, controller
from lpvmpc.sim.batch import Run

OURS, PLAIN, LMPC = "lpv-mpc", "lpv-mpc-paper", "lmpc-pso-pid-plain"
"""Our controller, the paper's plain formulation of it, and the paper's baseline, which has none of
the protections of `lmpc-pso-pid`: its own weights, not those tuned with protections."""
DRIVEN = tuple(name for core in CORE for name in ((core, LMPC) if core == PLAIN else (core,)))
"""All that are driven, in the order of the tables."""
PAPERS = "lpv-mpc-paper + network"
"""The paper's controller on the corrected formulas: the plain formulation, its network. A line of
the tables, not a name of a controller."""
AUTHORS_WIND = 1.0 / 3.0
"""Factor on the wind speed in the authors' published code."""


# Roads --------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class RoadCase:
    """A road and how it is driven."""

    key: str
    """Name in the files, unique."""
    title: str
    """Name in the tables."""
    scenario: str
    """Name of the scenario, or a CSV file."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `load_scenario`."""
    ablated: bool = False
    """Whether the ablation drives it."""


CASES = (
    RoadCase(key="paper", title="paper", scenario="paper", ablated=True),
    RoadCase(key="paper-third", title="paper, wind / 3", scenario="paper",
             options={"wind_scale": AUTHORS_WIND}),
    RoadCase(key="paper-loop", title="paper-loop", scenario="paper-loop", ablated=True),
    RoadCase(key="double-lane-change", title="lane change", scenario="double-lane-change",
             ablated=True),
    RoadCase(key="slalom", title="slalom", scenario="slalom"),
    RoadCase(key="skidpad", title="skidpad", scenario="skidpad"),
    RoadCase(key="circuit-0.5", title="circuit 50 %", scenario="circuit", options={"grip": 0.5},
             ablated=True),
    RoadCase(key="circuit-0.87", title="circuit 87 %", scenario="circuit", options={"grip": 0.87},
             ablated=True),
)
"""All roads; none of them tunes the weights."""
QUICK = ("paper", "paper-third", "double-lane-change")
"""Keys of the roads of a quick look."""


# With what ----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """Weights and networks that the controllers drive with."""

    by_hand: Mapping[str, Mapping[str, float]]
    """Weights set by hand, by controller."""
    tuned: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Tuned weights, by controller; a controller may have none."""
    networks: Mapping[str, str] = field(default_factory=dict)
    """Files of networks trained anew, by kind; the shipped ones drive where none is named."""

    def weights(self, name: str) -> dict[str, float]:
        """The weights a controller is reported with: tuned, or set by hand where none are tuned."""
        return dict(self.tuned.get(name, self.by_hand[name]))

    def options(
        self,
        name: str,
        *,
        by_hand: bool = False,
        stiffness: str | None = None,
        formulation: Mapping[str, Any] | None = None,
        **changes: float,
    ) -> dict[str, Any]:
        """Options of a controller for a run.

        Args:
            name: Name of the controller.
            by_hand: Whether with the weights set by hand.
            stiffness: Stiffness model (default: `network` for ours, none for the others).
            formulation: What differs from the controller's own formulation.
            changes: Weights that differ.
        """
        weights = dict(self.by_hand[name]) if by_hand else self.weights(name)
        options: dict[str, Any] = {"weights": {**weights, **changes}}
        stiffness = stiffness or ("network" if name == OURS else None)
        if stiffness is not None:
            options["stiffness"] = stiffness
            if stiffness in self.networks:
                options["stiffness_file"] = self.networks[stiffness]
        if formulation:
            options["formulation"] = dict(formulation)
        return options


def run_of(case: RoadCase, name: str, options: Mapping[str, Any], label: str = "") -> Run:
    """One closed loop on a road."""
    return Run(
        label=f"{case.key} {label or name}",
        scenario=case.scenario,
        scenario_options=dict(case.options),
        controller=name,
        controller_options=dict(options),
    )


# Who drives ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One line of a table: a controller as it is made."""

    group: str
    """Table that it belongs to, a key of `GROUPS`."""
    key: str
    """Name in the tables and files, unique in its group."""
    text: str
    """What it is, or what changes from the line above."""
    controller: str
    """Name of the controller, for `load_controller`."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Its options."""


GROUPS = {
    "tuned": "Controllers with tuned weights",
    "by hand": "Controllers with weights set by hand",
    "printed": "From the printed formulas to the corrected ones",
    "alone": "One printed slip alone in the plain formulation",
    "corrected": "From the plain formulation to the full controller",
    "without": "The full controller without one part",
}
"""Groups of entries and their titles."""
ABLATION = ("printed", "alone", "corrected", "without")
"""Groups that drive the ablation's roads."""

PARTS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "hold": ("exact hold instead of Euler", {"hold": "exact"}, {"hold": "euler", "span": 1}),
    "span": ("one frozen model for two periods", {"span": 2}, {"span": 1}),
    "reference": ("steady cornering as reference", {"reference": "steady"},
                  {"reference": "plain"}),
    "lags": ("servo lags", {"lags": True}, {"lags": False}),
    "relaxation": ("relaxation of the tires", {"relaxation": True}, {"relaxation": False}),
    "roll": ("roll of the body", {"roll": True}, {"roll": False}),
    "trail": ("pneumatic trail", {"trail": True}, {"trail": False}),
    "observer": ("disturbance observer", {"observer": True}, {"observer": False}),
    "slip cap": ("front slip cap", {"slip_cap": True}, {"slip_cap": False}),
    "traction": ("traction control", {"traction": True}, {"traction": False}),
    "decoupled": ("speed errors never steer", {"decoupled": True}, {"decoupled": False}),
    "approach": ("led back from afar", {"approach": True}, {"approach": False}),
    "steering": ("learned steering", {"steering": True}, {"steering": False}),
    "drive on": ("driving on unsolved", {"drive_on": True}, {"drive_on": False}),
    "noise": ("observer follows noise", {"noise": True}, {"noise": False}),
    "damped": ("damped linearisation", {"damped": True}, {"damped": False}),
}
"""Parts of the formulation in the order in which they are added: what they are, what adds them to
the plain formulation, what takes them from the full one. Euler holds the paper's one model per
period."""


def entries(equipment: Equipment) -> list[Entry]:
    """Every line of every table."""
    return [
        *_controllers(equipment),
        *_printed(equipment),
        *_corrected(equipment),
        *_without(equipment),
    ]


def _controllers(equipment: Equipment) -> Iterable[Entry]:
    """All controllers; those without tuned weights drive by hand in both groups."""
    for group, by_hand in (("tuned", False), ("by hand", True)):
        for name in DRIVEN:
            yield Entry(group=group, key=name, text=name, controller=name,
                        options=equipment.options(name, by_hand=by_hand))
            if name == PLAIN:
                options = equipment.options(PLAIN, by_hand=by_hand, stiffness="network-secant")
                yield Entry(group=group, key=PAPERS, text=PAPERS, controller=PLAIN,
                            options=options)


def _printed(equipment: Equipment) -> Iterable[Entry]:
    """The slips, corrected one after the other, and each alone."""
    plain = equipment.options(PLAIN, by_hand=True)
    left = dict(SLIPS)
    yield Entry(group="printed", key="as printed", text="all formulas as printed",
                controller=controller(set(left)))
    for name in SLIPS:
        left.pop(name)
        if left:
            yield Entry(group="printed", key=f"{name} corrected", text=f"corrected: {SLIPS[name]}",
                        controller=controller(set(left)))
        else:
            yield Entry(group="printed", key=PLAIN, text=f"corrected: {SLIPS[name]}",
                        controller=PLAIN, options=plain)
    yield Entry(group="alone", key="none", text="the plain formulation, lpv-mpc-paper",
                controller=PLAIN, options=plain)
    for name, text in SLIPS.items():
        yield Entry(group="alone", key=name, text=text, controller=controller({name}))


def _corrected(equipment: Equipment) -> Iterable[Entry]:
    """The parts, added one after the other; then weights, terminal cost and adaptation."""
    group, formulation = "corrected", dict[str, Any]()
    yield Entry(group=group, key=PLAIN, text="the plain formulation",
                controller=PLAIN, options=equipment.options(PLAIN, by_hand=True))
    for name, (text, added, _) in PARTS.items():
        formulation |= added
        options = equipment.options(PLAIN, by_hand=True, formulation=formulation)
        yield Entry(group=group, key=f"+ {name}", text=text, controller=PLAIN, options=options)
    for key, text, options in (
        ("+ weights", "the full controller's weights, but no terminal cost",
         equipment.options(OURS, stiffness="constant", terminal=0.0)),
        ("+ terminal", "terminal cost", equipment.options(OURS, stiffness="constant")),
        ("+ secant", "stiffness by the paper's network",
         equipment.options(OURS, stiffness="network-secant")),
        ("+ network", "stiffness by our network instead: the full controller",
         equipment.options(OURS)),
    ):
        yield Entry(group=group, key=key, text=text, controller=OURS, options=options)


def _without(equipment: Equipment) -> Iterable[Entry]:
    """The full controller, each part taken away alone."""
    group = "without"
    yield Entry(group=group, key="full", text="the full controller", controller=OURS,
                options=equipment.options(OURS))
    for name, (text, _, taken) in PARTS.items():
        yield Entry(group=group, key=f"- {name}", text=f"without: {text}", controller=OURS,
                    options=equipment.options(OURS, formulation=taken))
    for key, text, options in (
        ("- matrices", "A41 = sin(epsi), A45 = 0 as printed",
         equipment.options(OURS, formulation={"matrices": "printed"})),
        ("- terminal", "without: terminal cost", equipment.options(OURS, terminal=0.0)),
        ("- adaptation", "constant stiffness instead of the network",
         equipment.options(OURS, stiffness="constant")),
        ("- our network", "the paper's network instead of ours",
         equipment.options(OURS, stiffness="network-secant")),
        ("- weights", "weights set by hand", equipment.options(OURS, by_hand=True)),
    ):
        yield Entry(group=group, key=key, text=text, controller=OURS, options=options)


def cases_of(entry: Entry, cases: Sequence[RoadCase]) -> list[RoadCase]:
    """The roads that an entry drives."""
    return [case for case in cases if case.ablated or entry.group not in ABLATION]


def quick(entries: Iterable[Entry]) -> list[Entry]:
    """The entries of a quick look: no part is taken away alone."""
    return [entry for entry in entries if entry.group not in ("alone", "without")]
