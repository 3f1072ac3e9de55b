"""Codes of the states of a map sample; pages and pictures index their words and patterns by them."""

from __future__ import annotations

import enum

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason


class PlaceCode(enum.IntEnum):
    """A place's state; ``assets/heatmap.js`` and :func:`machopt.report.svg.chart_elements.compute_hatching` have a
    pattern a number."""

    OK = 0
    UNREACHABLE = 1
    LIMIT = 2
    SINGULAR_WRIST = 3
    SINGULAR_ELBOW = 4
    SINGULAR_SHOULDER = 5
    COLLIDING = 6
    NOT_CHECKED = 7  # feasible, but not checked for collisions
    BOUNDS = 8
    UNSTABLE = 9
    NO_PATH = 10

    @property
    def reason(self) -> InfeasibilityReason | None:
        """Its reason code; None for a place that was not evaluated."""
        return InfeasibilityReason.__members__.get(self.name)


def convert_to_place_codes(reasons: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the codes of an array of :class:`InfeasibilityReason`, in its shape.

    Args:
        reasons: Reason of each sample.

    Raises:
        ValueError: a reason that no place of a map has.
    """
    out, known = np.zeros(reasons.shape, np.uint8), np.zeros(reasons.shape, bool)
    for code in PlaceCode:
        if code.reason is not None:
            here = reasons == code.reason
            out[here], known = code, known | here
    if not known.all():
        raise ValueError(f"no place of a map can be {InfeasibilityReason(int(reasons[~known][0])).word}")
    return out
