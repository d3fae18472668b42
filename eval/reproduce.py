"""Put every number and figure of the paper beside ours; the same as `lpvmpc reproduce`."""

import sys

from lpvmpc.commands.reproduce import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
