"""Formats that print speeds in tenths of mm/s."""

from __future__ import annotations

import numpy as np

from machopt.data_types.robot_program import LIN
from machopt.errors import PostError
from machopt.programs.writing.template_fields import PostJob

SLOWEST = 1e-4  # m/s


def check_slowest_feed(job: PostJob) -> None:
    """Refuse a feed that would be printed as another value.

    Args:
        job: Program, controller, axis values and blend zones.

    Raises:
        PostError: a feed is below a tenth of a mm/s.
    """
    least = np.nanmin(job.program.feed) if (job.program.kind == LIN).any() else 1.0
    if least < SLOWEST:
        raise PostError(
            f"a feed of {least * 6e4:.3g} mm/min cannot be written: the format has steps of 6 mm/min", where="post"
        )
