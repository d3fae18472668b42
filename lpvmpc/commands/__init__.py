"""The command line: `lpvmpc NAME`, each name a module with `Options` and `main`.

The scripts in eval/ and data_gen/ are the same commands.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from lpvmpc.errors import UnknownNameError
from lpvmpc.kit.streams import lasting

COMMANDS = {
    "track": "drive a scenario: table, trace, figures, video",
    "view": "replay a run in MuJoCo's viewer, or as a page for the browser",
    "export": "write a run as CSV, or as MCAP for Foxglove and PlotJuggler",
    "compare": "drive a scenario with two or more controllers, side by side",
    "tune": "tune a controller's weights within a budget",
    "collect": "collect tire data: random manoeuvres up to the grip limit",
    "train": "train a network of the tires on such data",
    "benchmark": "the leaderboard: all controllers over roads, worlds and seeds",
    "stiffness": "say what networks tell of the tires along driven laps, by seed",
    "ablation": "compare stiffness models in closed loop: accuracy, robustness",
    "worlds": "drive in worlds that controllers are not told of: margins, draws",
    "fidelity": "run the fidelity studies of the simulated car",
    "replay": "drive the car by a recording of a real one; identify it",
    "adopt": "identify a recorded car, train, tune and drive for it",
    "reliability": "try wrong inputs, damaged files, roads nobody tuned for",
    "reproduce": "put the paper's numbers and figures beside ours",
    "solvers": "have other QP solvers solve the programs of our laps",
    "speed": "measure how fast the package is on this machine",
}
"""Commands by name, in the order of the help. Each is the module of its name, with underscores."""
FOLDERS = {
    "view": "parts.",
    "export": "parts.",
    "stiffness": "parts.",
    "replay": "recordings.",
    "adopt": "recordings.",
}
"""Folders of those whose modules lie in one."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the first word names; the rest are its options.

    Only that command's module is imported.

    Args:
        arguments: Command line without the program's name (default: that of the process).

    Returns:
        The exit code: the command's, or 2 where there is no such command.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        with lasting() as printed:
            print(_help())
            printed.flush()
            if printed.lost:
                print(f"Error: Cannot write to standard output: {printed.lost}.", file=sys.stderr)
                return 2
        return 0
    name = words[0]
    if name not in COMMANDS:
        with lasting():
            print("Error:", UnknownNameError("command", name, COMMANDS), file=sys.stderr)
        return 2
    from lpvmpc.kit import cli

    command = import_module(module_of(name))
    sys.argv = [f"lpvmpc {name}", *words[1:]]  # what the command's help calls itself
    return cli.run(command.Options, command.main)


def module_of(name: str) -> str:
    """The module of a command."""
    return f"lpvmpc.commands.{FOLDERS.get(name, '')}{name.replace('-', '_')}"


def _help() -> str:
    """The commands, a line each."""
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:{width}}  {about}" for name, about in COMMANDS.items())
    return (
        f"usage: lpvmpc COMMAND [OPTIONS]\n\n{lines}\n\n"
        "lpvmpc COMMAND --help lists the options of one."
    )
