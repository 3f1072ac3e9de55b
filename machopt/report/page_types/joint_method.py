"""What the report shows of ``--method joint``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class JointMethodWindowRow:
    """One window of a run."""

    name: str  # which nodes of which run
    nodes: int
    accepted: bool
    reason: str  # why it is not driven
    run_before: float | None  # s, the run on the path of the plan at its own advised feeds
    run_after: float | None  # s, with the window


@dataclass(frozen=True, kw_only=True)
class JointMethodRow:
    """Outcome for one tool."""

    tool: str  # empty with one tool
    accepted: bool
    reason: str  # why the path of the plan is driven
    fixed_path: float | None  # s, cycle time with the path of the plan at its own advised feeds
    joint: float | None  # s, cycle time of the joint result
    windows: tuple[JointMethodWindowRow, ...]
