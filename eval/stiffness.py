"""Say what the networks tell along driven laps; the same as `lpvmpc stiffness`."""

import sys

from lpvmpc.commands.parts.stiffness import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
