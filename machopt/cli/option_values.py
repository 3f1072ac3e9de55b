"""Values of options that are lists of numbers."""

from __future__ import annotations

import argparse


def parse_floats(text: str) -> tuple[float, ...]:
    """Return the numbers of a list like ``1,2,3``.

    Args:
        text: Text of the option.

    Raises:
        argparse.ArgumentTypeError: another form.
    """
    try:
        return tuple(float(v) for v in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers like 1,2,3") from None


def parse_integers(text: str) -> tuple[int, ...]:
    """Return the whole numbers of a list like ``1,2,3``.

    Args:
        text: Text of the option.

    Raises:
        argparse.ArgumentTypeError: another form.
    """
    try:
        return tuple(int(v) for v in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of whole numbers like 1,2,3") from None
