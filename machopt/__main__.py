"""``python -m machopt``: the command ``machopt``."""

from machopt.cli.process_entry import run_command_and_exit

if __name__ == "__main__":
    run_command_and_exit()
