"""Train a network on stiffness data; the same as `lpvmpc train`."""

import sys

from lpvmpc.commands.train import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
