"""Number of examples of a property: its own number, or twenty times as many in ``make nightly``."""

from __future__ import annotations

import os

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"


def scale_example_count(number: int) -> int:
    return 20 * number if NIGHTLY else number
