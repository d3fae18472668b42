"""Show a run again, in the viewer or as a page; the same as `lpvmpc view`."""

import sys

from lpvmpc.commands.parts.view import Options, main
from lpvmpc.kit import cli

if __name__ == "__main__":
    sys.exit(cli.run(Options, main))
