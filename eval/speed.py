"""Measure how fast the package is on this machine; the same as `lpvmpc speed`."""

import sys

from lpvmpc.commands.speed import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
