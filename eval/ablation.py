"""Measure what adapting the cornering stiffness is worth; the same as `lpvmpc ablation`."""

import sys

from lpvmpc.commands.ablation import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
