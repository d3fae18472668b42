"""Adopt a recorded car, end to end; the same as `lpvmpc adopt`."""

import sys

from lpvmpc.commands.recordings.adopt import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
