"""Notice of the option ``--effects``, which runs code."""

from __future__ import annotations

import argparse
import sys


def warn_of_effect_code(args: argparse.Namespace) -> None:
    """Print a notice for each file whose code is run.

    Args:
        args: The parsed command line.
    """
    for file in () if args.quiet else args.effects:
        print(f"machopt: --effects runs the code in {file} with your rights", file=sys.stderr)
