"""``python -m machopt.cli``."""

from machopt.cli.process import run

run()
