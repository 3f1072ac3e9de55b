"""Data of the steering panel of ``machopt view``: the user's decisions, and the comparison with the previous plan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class PlanComparison:
    """One figure of the plan and of the previous plan."""

    name: str
    unit: str
    before: float  # NaN where there is none
    now: float
    decimals: int
    less_is_better: bool = True


@dataclass(frozen=True)
class SteeringAxis:
    """External joint that can be set for an operation."""

    name: str
    unit: str  # mm or deg
    lower: float
    upper: float


@dataclass(frozen=True, kw_only=True)
class SteeringData:
    """Steering rules of a plan, as a plan file has them, and the available choices."""

    operations: tuple[tuple[str, tuple[tuple[int, int], ...]], ...]  # label, and the points it cuts, first to last
    points: int
    branches: int  # 0: branch numbers are not stable, so none can be chosen
    axes: tuple[SteeringAxis, ...]
    wishes: dict[str, Any]  # fixed, steer, external: keys of a plan file
    compared: tuple[PlanComparison, ...]
    message: str  # what came of the last re-planning, a sentence
    has_motion: bool
    file: str  # where the plan file will be saved
    command: str  # that plans the same anew
    has_tolerances: bool = False  # the server sends the outcome of a point while its rotation is dragged
    verified: dict[str, Any] | None = None  # the answer of verify on the very plan shown; None: it is not verified


def build_steering_spec(s: SteeringData) -> dict[str, Any]:
    """Return the steering data as JSON for ``assets/steer.js``.

    Args:
        s: The steering data.
    """
    return {
        "operations": [{"label": label, "points": [list(p) for p in points]} for label, points in s.operations],
        "points": s.points,
        "branches": s.branches,
        "axes": [vars(a) for a in s.axes],
        "wishes": s.wishes,
        "before": any(math.isfinite(c.before) for c in s.compared),
        "file": s.file,
        "command": s.command,
        "live": s.has_tolerances,
        "message": s.message,
        "good": s.has_motion,
        "verified": s.verified,
    }
