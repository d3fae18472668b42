"""Learn a driver by proximal policy optimisation; needs the extra `rl`."""

import sys

from lpvmpc.gym.learn import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
