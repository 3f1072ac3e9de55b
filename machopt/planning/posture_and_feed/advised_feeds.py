"""Feed advice of a plan as the feed of its path, so that the motion is timed with it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.random_draws import HOLE_DRAWS
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.tilt.tilt_planning import return_to_cam_axes
from machopt.planning.tolerance.cutting_dynamics import compute_cutting_dynamics
from machopt.planning.tolerance.point_errors import compute_point_errors
from machopt.planning.tolerance.process_results import find_driven_feed
from machopt.process.binding.job_binding import compute_loads

ROUNDING = 1e-3  # share of the feed kept for the rounding of the motion between its samples


@dataclass(frozen=True)
class AdvisedFeeds:
    """Largest feeds that keep the tolerance at the quantile, at N toolpath points."""

    feed: Array  # (N,) m/s; 0: no feed suffices; NaN: no tolerance, or the probability is not known
    unstable: int  # points at which chatter is predicted
    unknown_because: str = ""  # why no point has an advice
    target: NDArray[np.intp] | None = None  # (N,) point that states the tolerance: of a hole the deepest; None: itself
    needed: int = 0  # milled points and holes that are too fast at the feeds of the file, of a selected share

    @property
    def failing(self) -> int:
        """Number of points for which no feed suffices."""
        return int(np.sum(self.feed == 0.0))

    @property
    def is_known(self) -> bool:
        """Whether any point has an advice."""
        return bool(np.isfinite(self.feed).any())

    def limit_feeds(self) -> Array:
        """Return (N,) m/s, the feed limit of the move to each point; inf where there is no advice.

        Where no feed suffices, the limit is the least advice of all other points.
        """
        known = np.isfinite(self.feed) & (self.feed > 0.0)
        least = float(self.feed[known].min()) if known.any() else np.inf
        return np.where(known, (1.0 - ROUNDING) * self.feed, np.where(self.feed == 0.0, least, np.inf))

    @property
    def places(self) -> NDArray[np.intp]:
        """Milled points and deepest points of holes with an advice above zero, in order."""
        target = np.arange(len(self.feed)) if self.target is None else self.target
        return np.unique(target[np.isfinite(self.feed) & (self.feed > 0.0)])

    def select_share(self, reached: Array, passes: NDArray[np.bool_], share: float) -> AdvisedFeeds:
        """Return the advice of some of the points that are too fast, those that it slows least.

        A point that passes at the feeds of the file has no advice then; nor has one that no feed brings into tolerance.

        Args:
            reached: (N,) m/s, feeds that the motion reaches at the feeds of the file.
            passes: (N,) whether a milled point, or the deepest point of a hole, is in tolerance at them.
            share: Of the milled points and holes that are too fast.
        """
        target = np.arange(len(self.feed)) if self.target is None else self.target
        slower = np.isfinite(self.feed) & (self.feed > 0.0) & (self.feed < reached) & ~passes[target]
        slowing = np.where(slower, reached / np.where(slower, self.feed, 1.0), 0.0)
        places = np.unique(target[slower])
        worst = np.array([slowing[target == place].max() for place in places])
        count = math.ceil(share * len(places) - 1e-9)
        taken = places[np.argsort(worst, kind="stable")[:count]]
        feed = np.where(slower & np.isin(target, taken), self.feed, np.nan)
        return replace(self, feed=feed, needed=len(places))

    def lower_to(self, driven: AdvisedFeeds) -> AdvisedFeeds | None:
        """Return the advice lowered where that for the driven postures is lower; None where it is nowhere.

        Args:
            driven: Advice for the driven postures.
        """
        lower = np.isfinite(self.feed) & (driven.feed > 0.0) & (driven.feed < (1.0 - 0.5 * ROUNDING) * self.feed)
        return replace(self, feed=np.where(lower, driven.feed, self.feed)) if lower.any() else None


def advise_feeds(plan: Plan, toolpath: Toolpath) -> AdvisedFeeds:
    """Return the feed advice for a plan's postures.

    Args:
        plan: Plan of one tool.
        toolpath: Its toolpath, with the operations of the process.
    """
    none = np.full(len(toolpath), np.nan)
    loads = compute_loads(plan.setup.cell, toolpath, toolpath.feed)
    if loads is None:
        return AdvisedFeeds(none, 0, "the cell states no process")
    cam_plan = return_to_cam_axes(plan)
    dynamics = compute_cutting_dynamics(cam_plan, toolpath, loads)
    found = compute_point_errors(cam_plan, toolpath, loads, wall_force=dynamics.wall_force, is_full=True)
    unstable = sum(1 for word in dynamics.chatter if word and word not in ("stable", "unknown"))
    why = next(iter(found.unknown_because.values()), "no operation states a tolerance")
    feed, target = found.feed_max.copy(), np.arange(len(toolpath))
    for hole in loads.holes:
        rows = hole.rows[hole.is_cutting]
        feed[rows], target[rows] = feed[hole.deepest], hole.deepest
    return AdvisedFeeds(feed, unstable, why, target)


def apply_advised_feeds(plan: Plan, advised: AdvisedFeeds) -> Plan:
    """Return the plan whose path has the advised feeds where they are lower than those of the file.

    Args:
        plan: Plan of one tool.
        advised: Feeds of its toolpath points.
    """
    limit = advised.limit_feeds()[find_ending_points(plan.path)]
    feed = np.where(np.isnan(plan.path.feed), np.nan, np.minimum(plan.path.feed, limit))
    return replace(plan, path=replace(plan.path, feed=feed))


def restore_file_feeds(plan: Plan, toolpath: Toolpath) -> Plan:
    """Return the plan whose path has the feeds of the file.

    Args:
        plan: Plan of one tool.
        toolpath: Its toolpath.
    """
    return replace(plan, path=replace(plan.path, feed=toolpath.feed[find_ending_points(plan.path)]))


def compute_driven_outcomes(plan: Plan, toolpath: Toolpath, timeline: MotionTimeline | None) -> tuple[str, ...]:
    """Return (N,) the outcome of each point at the feeds that the motion reaches; empty where there is none.

    Args:
        plan: Plan of one tool, as driven.
        toolpath: Its toolpath.
        timeline: Its motion.
    """
    loads = compute_loads(plan.setup.cell, toolpath, find_driven_feed(toolpath, timeline))
    if loads is None:
        return ("",) * len(toolpath)
    cam_plan = return_to_cam_axes(plan)
    dynamics = compute_cutting_dynamics(cam_plan, toolpath, loads)
    found = compute_point_errors(cam_plan, toolpath, loads, wall_force=dynamics.wall_force, hole_draws=HOLE_DRAWS)
    return found.outcome


def find_ending_points(path: PlanningPath) -> NDArray[np.intp]:
    """Return (P,) the toolpath point at which the move to each planning point ends.

    Args:
        path: Planning points.
    """
    return np.ceil(path.index - 1e-9).astype(np.intp)
