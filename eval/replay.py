"""Replay a recording of a car on the simulated one; the same as `lpvmpc replay`."""

import sys

from lpvmpc.commands.recordings.replay import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
