"""The option for effects of a user's own."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_effects(parser: argparse.ArgumentParser) -> None:
    """``--effects FILE.py``."""
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.py",
        help="effects of your own that stiffness.yaml or kinematics.yaml holds, as machopt diagnose --terms FILE.py "
        "found them, or that EFFECT@LOCATION names; runs the code in that file; may be repeated",
    )


def told_of_effects(args: argparse.Namespace) -> None:
    """Say that code is run."""
    for file in () if args.quiet else args.effects:
        print(f"machopt: --effects runs the code in {file} with your rights", file=sys.stderr)
