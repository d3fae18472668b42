"""Drive a scenario with a controller: table, metrics, trace, figures and video.

    lpvmpc track --scenario paper --render

Exit codes: 0 done; 2 bad input, one line on stderr; 3 the car did not complete the scenario;
130 interrupted, with what was measured until then saved.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lpvmpc.commands.parts.pages import REPORT, film_of, write_page
from lpvmpc.commands.parts.the_car import CarPlace, TireFile, with_car
from lpvmpc.commands.parts.track_table import print_table
from lpvmpc.commands.parts.traffic import TrafficName, told_of, traffic_options, with_traffic
from lpvmpc.commands.parts.windows import check_display
from lpvmpc.control.registry import CONTROLLERS, STIFFNESS_MODELS
from lpvmpc.errors import LPVMPCError, OptionError, RenderError
from lpvmpc.export.names import FILES, FORMATS, check_format, export
from lpvmpc.kit import cli
from lpvmpc.kit.files import readable, replacing, write_json
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.provenance import commit, machine
from lpvmpc.road.names import SCENARIOS
from lpvmpc.sim.world_names import WORLD_NAMES

if TYPE_CHECKING:
    from lpvmpc.picture.video.viewer import Viewer
    from lpvmpc.plant.plant import Plant
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.sim.log import Log
    from lpvmpc.traffic.users import Traffic


USER_TIMEOUT = 60.0
"""Longest time of one call of a user's controller or estimator, by default [s]."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Drive a scenario with a controller on the MuJoCo car and report how well it went."""

    scenario: Annotated[
        str, cli.Option(help=f"{', '.join(SCENARIOS)}, or your own FILE.csv.")
    ] = "paper"
    controller: Annotated[
        str, cli.Option(help=f"{', '.join(CONTROLLERS)}, or your own module:Class.")
    ] = "lpv-mpc"
    stiffness: Annotated[
        str | None,
        cli.Option(metavar="NAME", help=(
            f"What the LPV-MPC knows of its tires: {', '.join(STIFFNESS_MODELS)}; network-secant "
            "is the paper's, the oracles are told the plant's own (default: network, and constant "
            "for lpv-mpc-paper)."
        )),
    ] = None
    wind_scale: float = 1.0
    """Factor on the scenario's wind speed."""
    friction: float = 1.0
    """Factor on the peak friction of the road."""
    seed: int = 0
    """Seed of everything random."""
    out: Path | None = None
    """Folder for the results (default: runs/SCENARIO-CONTROLLER)."""
    render: bool = False
    """Make a video: videos/SCENARIO-CONTROLLER.mp4."""
    view: bool = False
    """Watch the run live in MuJoCo's interactive viewer."""
    report: bool = False
    """Write report.html beside the results: film (with --render), linked plots, map, settings."""
    export: Annotated[
        str | None,
        cli.Option(metavar="FORMAT", help=(
            f"Write the trace for other tools as well: {', '.join(FORMATS)} (Foxglove, "
            "PlotJuggler)."
        )),
    ] = None
    v_max: float | None = None
    """Top speed of a planned speed profile [m/s]."""
    ay_max: float | None = None
    """Lateral acceleration of a planned speed profile [m/s2]."""
    grip: float | None = None
    """The same as a fraction of what the car can hold."""
    closed: bool = False
    """Treat a CSV track as closed (default: decided by its ends)."""
    no_closed: bool = False
    """Treat a CSV track as open."""
    smoothing: float | None = None
    """Wavelength below which the points of a CSV track are smoothed [m] (default: 25, and less
    where that would cut a corner)."""
    start_offset: Annotated[tuple[float, float] | None, cli.Option(metavar="EY EPSI")] = None
    """Start beside the reference: distance to its left [m] and turn to the left [rad]."""
    laps: int = 1
    """Laps of a closed track."""
    weights: Path | None = None
    """Weights of the controller, a TOML file as eval/tune.py writes it (default: the package's)."""
    world: Annotated[
        str, cli.Option(help=(
            f"What reality does that the controller is not told: {', '.join(WORLD_NAMES)}, or your "
            "own FILE.toml; --seed draws it."
        )),
    ] = "ideal"
    estimator: Annotated[
        str | None,
        cli.Option(metavar="NAME", help=(
            "What makes a state of the sensors: ekf, none, or your own module:Class (default: ekf, "
            "and none where the sensors are exact)."
        )),
    ] = None
    latency: float | None = None
    """Time until a command reaches the car, told to nobody [ms] (default: the world's)."""
    delay: int = 0
    """Control periods after which a command reaches the car, told to the controller."""
    step_timeout: float | None = None
    """Longest time of one call of the controller, or of your own estimator, compiling included,
    before the run is given up [s] (default: 60 for your own, no limit for the package's)."""
    solver: str | None = None
    """Who solves the QPs of lpv-mpc and lpv-mpc-paper first: proxqp (default), or active-set, which
    is faster at the same checks; lpvmpc solvers compares more of them."""
    isolate: bool = False
    """Let the controller live in a process of its own: what it does there reaches neither plant nor
    record, hangs in compiled code end in time, and its memory is limited (1.5 GiB)."""
    traffic: TrafficName = None
    detour: bool = False
    """Plan the reference round the traffic."""
    car: CarPlace = None
    tire: TireFile = None
    json: Path | None = None
    """Write the metrics to this file as well."""


@with_car()
def main(options: Options) -> int:
    """Drive, print, save; returns the exit code."""
    check(options)
    cli.check_opengl()
    from lpvmpc import Isolated, Plant, load_controller, load_scenario, simulate
    from lpvmpc.sim.ending import check_start
    from lpvmpc.sim.metrics import metrics
    from lpvmpc.traffic.watch import encounters

    scenario = load_scenario(options.scenario, **scenario_options(options))
    traffic, scenario = with_traffic(options.traffic, options.detour, scenario)
    offset = options.start_offset or (0.0, 0.0)
    check_start(scenario, options.laps, offset)
    own = ":" in options.controller
    limit = USER_TIMEOUT if own or ":" in (options.estimator or "") else None
    plant, given = Plant(), controller_options(options, own)
    controller: Any = None
    if not (own and options.isolate):  # a user's code is not even imported here
        controller = load_controller(options.controller, **given)
        warn_of_another_car(controller, plant)
    if options.isolate:
        controller = Isolated(options.controller, **given)
    name = re.sub(r"[^\w.-]+", "-", "-".join(
        [scenario.name, options.controller,
         *(place.stem for place in (options.car, options.tire) if place is not None)]
    ))
    for sentence in scenario.warnings:
        print("Warning:", sentence, file=sys.stderr)
    out = cli.results_folder(options.out or Path("runs") / name)
    video = None
    if options.render:
        video = cli.results_folder(Path("videos"), f"{name}.mp4") / f"{name}.mp4"
    cli.result_file(options.json)
    viewer = open_viewer(plant, scenario, traffic) if options.view else None
    here = os.getcwd()
    with Watch(viewer) as watch:
        log = simulate(
            plant,
            controller,
            scenario,
            seed=options.seed,
            laps=options.laps,
            start_offset=offset,
            world=options.world,
            estimator=options.estimator,
            delay=options.delay,
            latency=None if options.latency is None else options.latency / 1000.0,
            step_timeout=options.step_timeout or limit,
            progress=watch,
            name=options.controller,
            options={**scenario_options(options),
                     **traffic_options(options.traffic, options.detour)},
            traffic=traffic,
        )
    os.chdir(here)  # a controller may have gone elsewhere
    if len(log) == 0 and log.meta["reason"] == "interrupted":
        raise KeyboardInterrupt  # before the first instant: nothing to save
    result = metrics(log)
    met = [asdict(one) for one in encounters(log)]
    content = {**result, **({"traffic": met} if met else {}), "record": record_of(options, log)}
    interrupted = not save(options, log, content, out)
    if scenario.path.largest_shift > 0.0:
        print(f"Road: {scenario.source}")
    print_table(result, log)
    for one in met:
        print(told_of(one))
    print(f"Saved {out}/ (metrics.json, trace.parquet, timing.parquet, figures/)")
    if video is not None and len(log) > 1 and not interrupted:
        interrupted = not film(log, video)
    if options.report and len(log) > 1 and not interrupted:
        filmed = video and film_of(out.absolute(), name, out / "trace.parquet")
        print(f"Saved {write_page(log, content, out, filmed)}")
    if interrupted:
        return cli.INTERRUPTED
    return cli.DONE if result["completed"] else cli.NOT_COMPLETED


def check(options: Options) -> None:
    """Refuse what only a running simulation would refuse otherwise."""
    cli.check_number("--seed", options.seed, 0, 2**63)
    cli.check_number("--delay", options.delay, 0, 30, "periods")
    cli.check_number("--latency", options.latency, 0.0, 200.0, "ms")
    if options.latency is not None and options.latency != round(options.latency):
        raise OptionError("--latency", options.latency, "a whole number of milliseconds")
    cli.check_number("--step-timeout", options.step_timeout, 0.001, 86400.0, "s")
    cli.check_choice("--stiffness", options.stiffness, STIFFNESS_MODELS)
    if options.detour and options.traffic is None:
        raise OptionError("--detour", "given", "left out without --traffic")
    if options.closed and options.no_closed:
        raise LPVMPCError("--closed and --no-closed exclude each other; give only one.")
    cli.check_choice("--export", options.export, FORMATS)
    check_format(options.export)
    if options.view:
        check_display("--view", "--render makes a video without one.")


def scenario_options(options: Options) -> dict[str, Any]:
    """The options that change what is driven."""
    given = {} if options.smoothing is None else {"smoothing": options.smoothing}
    return {
        **given,
        "wind_scale": options.wind_scale,
        "friction": options.friction,
        "v_max": options.v_max,
        "ay_max": options.ay_max,
        "grip": options.grip,
        "closed": True if options.closed else False if options.no_closed else None,
    }


def controller_options(options: Options, own: bool) -> dict[str, Any]:
    """What a controller is made with; a user's own is told the delay where it asks for it."""
    if own:
        for name, value in (("--weights", options.weights), ("--stiffness", options.stiffness),
                            ("--solver", options.solver)):
            if value is not None:
                raise LPVMPCError(f"{name} is {str(value)!r}, but the controller "
                                  f"{options.controller!r} is your own: it has only what its "
                                  "constructor sets.")
        return {"delay": options.delay}
    from lpvmpc.control.weights_file import check_car, read_weights

    known: dict[str, Any] = {"delay": options.delay, "stiffness": options.stiffness}
    if options.solver is not None:
        known["solver"] = options.solver
    if options.weights is not None:
        known["weights"] = read_weights(options.weights, options.controller)
        check_car(options.weights)
    return known


def warn_of_another_car(controller: Any, plant: Plant) -> None:
    """A line on stderr where the network was trained on another vehicle.xml than the one driven."""
    kind = getattr(getattr(controller, "stiffness", None), "name", None)
    if kind not in ("network", "network-secant"):
        return
    from lpvmpc.control.stiffness.network_file import load_weights
    from lpvmpc.sim.names import warn_of_another_car as check

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check(load_weights(kind), plant.model)
    for warning in caught:
        print(f"Warning: {warning.message}", file=sys.stderr)


class Watch:
    """What goes on while the car drives: a bar on a terminal and, asked for, the live viewer."""

    def __init__(self, viewer: Viewer | None = None):
        self.viewer = viewer
        self.bar = Bar("starting (the first run compiles)")
        self.calls = 0

    def __enter__(self) -> Watch:
        self.bar.__enter__()
        return self

    def __call__(self, fraction: float) -> None:
        """Called at every control instant with the driven fraction of the path."""
        self.calls += 1
        if self.calls % 30 == 0:
            self.bar.at(fraction, "driving")
        if self.viewer is not None:
            self.viewer.show()

    def __exit__(self, *error: object) -> None:
        self.bar.__exit__(*error)
        if self.viewer is not None:
            self.viewer.close()


def open_viewer(plant: Plant, scenario: Scenario, traffic: Traffic | None) -> Viewer:
    """The live viewer, whose libraries are imported for it alone."""
    from lpvmpc.picture.video.viewer import Viewer

    return Viewer(plant, scenario.path if traffic is None else traffic.path, traffic)


RESULTS = ("metrics.json", "figures/*.png", "timing.parquet", "trace.parquet", REPORT, *FILES)
"""What a run leaves in its folder; the last run's results stay until all of these are there."""


def record_of(options: Options, log: Log) -> dict[str, Any]:
    """What led to the run's numbers."""
    given = {k: readable(v) if isinstance(v, Path | str) else v for k, v in asdict(options).items()}
    return {
        "options": given,
        "weights": log.weights,
        "clamped_inputs": log.meta["clamped_inputs"],
        "footprint_m": log.meta["footprint_m"],
        "estimator_events": log.meta["estimator_events"],
        "estimator_unknowns": log.meta["estimator_unknowns"],
        "warnings": log.scenario.warnings,
        "commit": commit(),
        "machine": machine(),
    }


def save(options: Options, log: Log, content: dict[str, Any], out: Path) -> bool:
    """Write trace, timing, figures, export and metrics.json, all together.

    An error of figures or export is raised in the end: what was measured is saved without them.

    Returns:
        False after an interrupt.
    """
    from lpvmpc.export.stored import sealed

    whole, failed = log.meta["reason"] != "interrupted", None
    with replacing(out, RESULTS) as new:
        log.write(new)
        content = sealed(content, new)
        try:
            if options.export is not None:
                export(log, content, new, options.export)
            if whole and len(log) > 1:
                from lpvmpc.picture.figures import save_all

                save_all(log, new / "figures")
        except KeyboardInterrupt:  # the figures are given up, the measurements are not
            whole = False
        except Exception as error:
            failed = error
        write_json(new / "metrics.json", content)
    if failed is not None:
        raise failed
    if options.json is not None:
        write_json(options.json, {k: v for k, v in content.items() if k != "record"})
    return whole


def film(log: Log, video: Path) -> bool:
    """Make the video; False after an interrupt. A machine that cannot draw is a warning."""
    try:
        from lpvmpc.picture.video.render import render_video

        render_video(log, video)
    except RenderError as error:
        print("Warning: no video:", " ".join(str(error).split()), file=sys.stderr)
    except KeyboardInterrupt:
        return False
    else:
        print(f"Saved {video}")
    return True
