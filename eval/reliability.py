"""Try what goes wrong; the same as `lpvmpc reliability`."""

import sys

from lpvmpc.commands.reliability import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
