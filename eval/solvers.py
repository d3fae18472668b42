"""Have other solvers solve the programs of our laps; the same as `lpvmpc solvers`."""

import sys

from lpvmpc.commands.solvers import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
