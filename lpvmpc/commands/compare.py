"""Drive one scenario with two or more controllers: table, pictures and a video side by side.

    lpvmpc compare --controllers lpv-mpc lmpc-pso-pid --scenario paper --render

Exit codes: 0 compared, also where a car was lost, which is a result; 2 bad input, one line on
stderr; 130 interrupted.
"""

from __future__ import annotations

import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.control.registry import CONTROLLERS
from lpvmpc.errors import LPVMPCError, OptionError, RenderError
from lpvmpc.kit import cli
from lpvmpc.kit.files import replacing, write_json
from lpvmpc.kit.provenance import commit, machine
from lpvmpc.road.names import SCENARIOS

if TYPE_CHECKING:
    from lpvmpc.interface import Controller
    from lpvmpc.sim.log import Log

RESULTS = ("comparison.json", "comparison.md", "errors.png", "signals.png", "path.png")
"""What a comparison leaves in its folder, replaced all together."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Drive the same scenario with two or more controllers and lay the results side by side."""

    controllers: Annotated[
        tuple[str, ...],
        cli.Option(help=(
            f"Two to six of {', '.join(CONTROLLERS)}, or your own module:Class; lpv-mpc/constant "
            "is the lpv-mpc with another stiffness model."
        )),
    ] = ("lpv-mpc", "lmpc-pso-pid")
    scenario: Annotated[
        str, cli.Option(help=f"{', '.join(SCENARIOS)}, or your own FILE.csv.")
    ] = "paper"
    wind_scale: float = 1.0
    """Factor on the scenario's wind speed."""
    friction: float = 1.0
    """Factor on the peak friction of the road."""
    v_max: float | None = None
    """Top speed of a planned speed profile [m/s]."""
    ay_max: float | None = None
    """Lateral acceleration of a planned speed profile [m/s2]."""
    grip: float | None = None
    """The same as a fraction of what the car can hold."""
    seed: int = 0
    """Seed of everything random."""
    delay: int = 0
    """Control periods after which a command reaches the car."""
    out: Path | None = None
    """Folder for the results (default: runs/SCENARIO-CONTROLLER-vs-CONTROLLER)."""
    render: bool = False
    """Make a video of up to four, videos/SCENARIO-CONTROLLER-vs-CONTROLLER.mp4."""
    car: CarPlace = None
    json: Path | None = None
    """Write the metrics of all to this file as well."""


@with_car()
def main(options: Options) -> int:
    """Drive, print, save; returns the exit code."""
    check(options)
    cli.check_opengl()
    from lpvmpc import Plant, load_scenario, simulate
    from lpvmpc.picture import comparison
    from lpvmpc.sim.metrics import metrics

    what = {name: getattr(options, name)
            for name in ("wind_scale", "friction", "v_max", "ay_max", "grip")}
    scenario = load_scenario(options.scenario, **what)
    for sentence in scenario.warnings:
        print("Warning:", sentence, file=sys.stderr)
    made = {name: load(name, options.delay) for name in options.controllers}
    whose = f"-{options.car.stem}" if options.car else ""
    title = f"{scenario.name}-{'-vs-'.join(options.controllers)}{whose}"
    title = re.sub(r"[^\w.-]+", "-", title)
    out = cli.results_folder(options.out or Path("runs") / title)
    video = None
    if options.render:
        video = cli.results_folder(Path("videos"), f"{title}.mp4") / f"{title}.mp4"
    cli.result_file(options.json)
    plant, runs = Plant(), dict[str, Any]()
    for name, controller in made.items():
        if sys.stderr.isatty():
            print(f"driving {name} ...", file=sys.stderr)
        runs[name] = simulate(
            plant, controller, scenario, seed=options.seed, delay=options.delay, name=name,
            step_timeout=60.0 if ":" in name else None, options=what,
        )
        if runs[name].meta["reason"] == "interrupted":
            raise KeyboardInterrupt
    results = {name: metrics(log) for name, log in runs.items()}
    given = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(options).items()}
    weights = {name: log.weights for name, log in runs.items()}
    record = {"options": given, "weights": weights, "commit": commit(), "machine": machine()}
    failed = None
    with replacing(out, RESULTS) as new:
        write_json(new / "comparison.json", {"runs": results, "record": record})
        try:
            comparison.save_all(runs, new)
        except Exception as error:  # the pictures are given up, the measurements are not
            failed = error
    if failed is not None:
        raise failed
    if options.json is not None:
        write_json(options.json, {"runs": results, "record": record})
    show(runs)
    print(f"Saved {out}/ (comparison.md, comparison.json, errors.png, signals.png, path.png)")
    if video is not None:
        film(runs, video)
    return cli.DONE


def check(options: Options) -> None:
    """Refuse what only a driven run would refuse otherwise."""
    cli.check_number("--seed", options.seed, 0, 2**63)
    cli.check_number("--delay", options.delay, 0, 30, "periods")
    count, most = len(options.controllers), 4 if options.render else 6
    if not 2 <= count <= most:
        with_video = " with --render" if options.render else ""
        raise LPVMPCError(f"--controllers needs 2 to {most} names{with_video}, but got {count}.")
    for name in options.controllers:
        if options.controllers.count(name) > 1:
            raise OptionError("--controllers", name, "given once")


def load(name: str, delay: int) -> Controller:
    """A controller by NAME, NAME/STIFFNESS or module:Class."""
    from lpvmpc import load_controller

    if ":" in name:
        return load_controller(name)
    controller, slash, stiffness = name.partition("/")
    return load_controller(controller, delay=delay, stiffness=stiffness if slash else None)


def show(runs: dict[str, Log]) -> None:
    """The table on the terminal."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from lpvmpc.picture import comparison

    console = Console(width=80 if not sys.stdout.isatty() else None, highlight=False)
    header, rows = comparison.summary(runs)
    first = next(iter(runs.values()))
    table = Table(title=escape(f"Controllers on {first.meta['scenario']}"), title_style="bold",
                  title_justify="left")
    for n, name in enumerate(header):
        table.add_column(escape(name), justify="right" if n else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)
    for name, log in runs.items():
        if not log.meta["completed"]:
            console.print(escape(f"{name} did not complete: {log.meta['reason']}."), style="red")
    used = first.meta["versions"]
    console.print(f"Seed {first.meta['seed']}, MuJoCo {used['mujoco']}, ProxQP "
                  f"{used['proxsuite']}; {machine()}.", style="dim")


def film(runs: dict[str, Log], video: Path) -> None:
    """Make the video; a machine that cannot draw is a warning."""
    try:
        from lpvmpc.picture.video.comparison import compare_video

        compare_video(runs, video)
    except RenderError as error:
        print("Warning: no video:", " ".join(str(error).split()), file=sys.stderr)
    else:
        print(f"Saved {video}")
