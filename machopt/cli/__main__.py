"""``python -m machopt.cli``."""

import sys

from machopt.cli import main

sys.exit(main())
