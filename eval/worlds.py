"""Measure what holds outside the perfect world; the same as `lpvmpc worlds`."""

import sys

from lpvmpc.commands.worlds import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
