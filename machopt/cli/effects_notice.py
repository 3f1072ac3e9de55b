"""What a command says of the option ``--effects``."""

from __future__ import annotations

import argparse
import sys


def warn_of_effect_code(args: argparse.Namespace) -> None:
    """Say that code is run."""
    for file in () if args.quiet else args.effects:
        print(f"machopt: --effects runs the code in {file} with your rights", file=sys.stderr)
