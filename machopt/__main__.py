"""``python -m machopt``: the command ``machopt``."""

from machopt.cli.process import run

if __name__ == "__main__":
    run()
