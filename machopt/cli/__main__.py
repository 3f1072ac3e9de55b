"""``python -m machopt.cli``."""

from machopt.cli.process_entry import run_command_and_exit

run_command_and_exit()
