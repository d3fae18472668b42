"""Collect stiffness data; the same as `lpvmpc collect`."""

import sys

from lpvmpc.commands.collect import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
