"""Feeds of one tool that differ from those of the file: ``advised_feed_share`` and ``--method joint``."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class WindowOutcome:
    """Outcome of one window of a run."""

    window: str  # which nodes of which run
    nodes: int
    is_accepted: bool
    reason: str  # why its result is not driven; empty where it is
    seconds_before: float  # of its run at the advised feeds; NaN: not driven
    seconds_after: float


@dataclass(frozen=True, kw_only=True)
class PostureFeedResult:
    """Outcome of a job, and the feeds that are driven."""

    feed: Array  # (N,) m/s of the move to each toolpath point: that of the file, or the advice where lower
    is_accepted: bool  # False: the path of the plan is driven, at its own advised feeds
    reason: str  # why it is not accepted; empty where it is
    fixed_seconds: float  # cycle time with the path of the plan at its own advised feeds; NaN: it cannot be driven
    joint_seconds: float  # cycle time of the joint result; NaN: there is none
    windows: tuple[WindowOutcome, ...]


@dataclass(frozen=True, kw_only=True)
class AdvisedFeedResult:
    """Feeds that are driven with ``advised_feed_share``, and their price in time."""

    feed: Array  # (N,) m/s of the move to each toolpath point: that of the file, or the advice where lower
    share: float
    slowed: int  # milled points and holes that are driven at an advice below the file's feed
    needed: int  # milled points and holes out of tolerance at the feeds of the file that an advice brings into it
    file_feed_seconds: float  # cycle time at the feeds of the file; NaN: it cannot be driven
