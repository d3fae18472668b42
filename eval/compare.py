"""Drive one scenario with two or more controllers; the same as `lpvmpc compare`."""

import sys

from lpvmpc.commands.compare import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
