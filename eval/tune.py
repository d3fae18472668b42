"""Tune a controller's weights; the same as `lpvmpc tune`."""

import sys

from lpvmpc.commands.tune import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
