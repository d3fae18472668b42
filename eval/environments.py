"""Measure how fast the gymnasium environments are, beside others."""

import sys

from lpvmpc.gym.speed import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
