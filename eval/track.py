"""Drive a scenario with a controller; the same as `lpvmpc track`."""

import sys

from lpvmpc.commands.track import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
