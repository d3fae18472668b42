"""Run the fidelity studies of the simulated car; the same as `lpvmpc fidelity`."""

import sys

from lpvmpc.commands.fidelity import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
