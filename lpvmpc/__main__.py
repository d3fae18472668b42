"""`python -m lpvmpc` is the command `lpvmpc`."""

import sys

from lpvmpc.commands import main

if __name__ == "__main__":
    sys.exit(main())
