"""``python -m machopt``: the command ``machopt``."""

import sys

from machopt.cli import main

if __name__ == "__main__":
    sys.exit(main())
