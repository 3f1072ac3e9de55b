"""``python -m machopt.cli``."""

from machopt.cli.process_exit import run_command_and_exit

run_command_and_exit()
