"""The leaderboard of all controllers; the same as `lpvmpc benchmark`."""

import sys

from lpvmpc.commands.benchmark import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
