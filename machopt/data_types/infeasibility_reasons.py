"""Reason codes of infeasible configurations, points and rotations; they are data, never an exception."""

from __future__ import annotations

import enum


class InfeasibilityReason(enum.IntEnum):
    """Ordered by how far a candidate came: a higher code got further through the checks."""

    OK = 0
    UNREACHABLE = 1
    LIMIT = 2
    SINGULAR_WRIST = 3
    SINGULAR_ELBOW = 4
    SINGULAR_SHOULDER = 5
    UNSTABLE = 6  # the stable depth of cut over the planned one is below min_stability_ratio
    COLLIDING = 7
    BOUNDS = 8  # outside the user's rotation range
    NO_PATH = 9  # feasible by itself, but not joined to its neighbours without a jump
    GAP = 10  # feasible, but the cut to it is left out: it lies at a gap that the user allowed
    SHIFT = 11  # feasible as programmed, but the shift against the deflection is refused
    GOUGING = 12  # the CAM file itself drives the cutter into the finished part, whatever the robot does

    @property
    def word(self) -> str:
        return self.name.lower()
