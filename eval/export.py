"""Write a run for other tools, as CSV or MCAP; the same as `lpvmpc export`."""

import sys

from lpvmpc.commands.parts.export import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
