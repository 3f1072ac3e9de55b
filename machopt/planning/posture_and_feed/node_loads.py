"""Loads at the nodes of a window, and the nominal error that the tolerance permits at each.

The feed advice contains every uncertainty and every term of the stiffness; the program has the joints' springs alone.
At each iterate the two are matched: the limit t of a node is the nominal error |n·C(f₀ + f₁ v)| by the springs at the
advised feed v, so that the program's largest feed at the iterate is the advice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import CuttingMaterial, CuttingProcess, ProcessOperation
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.error_probability.toleranced_points import SurfaceTargets, list_surface_targets
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.posture_and_feed.advised_feeds import AdvisedFeeds
from machopt.planning.posture_and_feed.symbolic_machine import SymbolicMachine
from machopt.planning.posture_and_feed.window_data import NodeLoads
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.binding.job_binding import compute_loads
from machopt.process.binding.point_loads import PointLoads
from machopt.stiffness.joint_stiffness import compute_joint_stiffness

LEAST_ERROR = 1e-6  # m, smallest limit of the nominal error
AT_LIMIT = 1e-3  # share: an advice nearer than this to the largest permitted feed is that feed
ROOM = 1.2  # times the nominal error at the largest permitted feed, where no node shows what the tolerance allows


@dataclass(frozen=True, kw_only=True)
class MilledTargets:
    """Milled points with a tolerance and a known surface, and their loads."""

    targets: SurfaceTargets
    loads: PointLoads
    process: CuttingProcess
    teeth: int
    usable: NDArray[np.intp]  # which of the targets
    edge_force: Array  # (N, 3) N along travel, normal and axis at a feed of zero
    slope_force: Array  # (N, 3) N per m/s of feed
    edge_moment: Array  # (N,) N·m about the axis at a feed of zero
    slope_moment: Array  # (N,) N·m per m/s

    @classmethod
    def build(cls, plan: Plan, toolpath: Toolpath) -> MilledTargets | None:
        """Return the milled points with a tolerance; None where there is none.

        Milling loads are affine in the feed, so that those at two feeds give both parts, whatever the contact is.

        Args:
            plan: Plan of one tool.
            toolpath: Its toolpath.
        """
        cell = plan.setup.cell
        loads = compute_loads(cell, toolpath, toolpath.feed)
        if loads is None or cell.process is None or cell.tool.cutter is None:
            return None
        targets = list_surface_targets(cell.process, toolpath, loads, cell.tool.cutter)
        milled = np.array([one.kind == "milling" for one in cell.process.operations], bool)
        usable = np.flatnonzero(targets.is_known & milled[targets.operation]) if len(targets.row) else np.zeros(0, int)
        if not len(usable):
            return None
        half = compute_loads(cell, toolpath, 0.5 * toolpath.feed)
        assert half is not None
        return cls(
            targets=targets,
            loads=loads,
            process=cell.process,
            teeth=build_milling_cutter(cell.tool.cutter).teeth,
            usable=usable.astype(np.intp),
            edge_force=2.0 * half.force - loads.force,
            slope_force=(loads.force - half.force) / (0.5 * toolpath.feed)[:, None],
            edge_moment=2.0 * half.moment - loads.moment,
            slope_moment=(loads.moment - half.moment) / (0.5 * toolpath.feed),
        )

    @property
    def is_known(self) -> bool:
        """Whether there is a target."""
        return bool(len(self.usable))


@dataclass(frozen=True, kw_only=True)
class _NodeTargets:
    """Targets of M nodes."""

    node: NDArray[np.intp]  # (M,) node
    target: NDArray[np.intp]  # (M,) the target nearest to it
    advice: Array  # (M,) m/s, least advice around it; 0: no feed suffices


def build_node_loads(
    plan: Plan,
    points: NDArray[np.intp],
    cap: Array,
    milled: MilledTargets | None,
    advised: AdvisedFeeds,
    machine: SymbolicMachine,
) -> NodeLoads:
    """Return loads, surface normals and limits of the nominal error at some nodes of an iterate.

    Args:
        plan: The iterate.
        points: (N,) planning points of the nodes.
        cap: (N − 1,) m/s, largest speed of the tip between the nodes.
        milled: Points with a tolerance.
        advised: Feed advice of the iterate.
        machine: Symbolic kinematics.
    """
    path, count = plan.path, len(points)
    place = plan.setup.arm.places(path.external[points], path.position[points])
    compliance = np.asarray(1.0 / compute_joint_stiffness(plan.setup.elasticity.stiffness, place).k)
    edge, slope, normal = np.zeros((count, 6)), np.zeros((count, 6)), np.zeros((count, 3))
    highest, limit = np.full(count, np.inf), np.full(count, np.inf)
    found = None if milled is None else _assign_targets(path.index[points], milled, advised)
    if milled is None or found is None:
        return NodeLoads(compliance=compliance, edge=edge, slope=slope, normal=normal, highest=highest, limit=limit)
    n = found.node
    edge[n], slope[n], normal[n], chip_limit = _build_wrenches(plan, points[n], milled, found.target)
    fastest = np.maximum(np.r_[cap[:1], cap], np.r_[cap, cap[-1:]])[n]
    highest[n] = chip_limit
    permitted = np.minimum(chip_limit, fastest)
    tolerance = np.array([milled.process.operations[k].tolerance.surface for k in milled.targets.operation])
    x = path.whole(plan.chosen.assignment.q)[points[n]]
    advice = np.minimum(found.advice, permitted)
    error = machine.compute_deflections(x, compliance[n], edge[n] + slope[n] * advice[:, None], normal[n])
    limit[n] = _match_limits(np.abs(error), advice, permitted, tolerance[found.target])
    return NodeLoads(compliance=compliance, edge=edge, slope=slope, normal=normal, highest=highest, limit=limit)


def _get_largest_chip(materials: Mapping[str, CuttingMaterial], one: ProcessOperation) -> float:
    """Return the largest chip thickness in m for which the coefficients of an operation hold; inf for no milling."""
    milling = materials[one.material].milling if one.kind == "milling" and one.material is not None else None
    return np.inf if milling is None else milling.h_range_m[1]


def _match_limits(error: Array, advice: Array, permitted: Array, tolerance: Array) -> Array:
    """Return (M,) m, the nominal error that each node may have.

    Where the advice is the largest permitted feed, the tolerance allows more than the error shows: the median share of
    the tolerance at the other nodes counts. The same holds where no feed suffices.

    Args:
        error: (M,) m, nominal error at the advice.
        advice: (M,) m/s; 0: no feed suffices.
        permitted: (M,) m/s, largest feed by file and chip thickness.
        tolerance: (M,) m.
    """
    is_free = advice >= (1.0 - AT_LIMIT) * permitted
    is_limited = ~is_free & (advice > 0.0)
    share = float(np.median(error[is_limited] / tolerance[is_limited])) if is_limited.any() else 0.0
    by_share = share * tolerance
    room = ROOM if not is_limited.any() else 1.0
    found = np.where(is_free, np.maximum(room * error, by_share), np.where(is_limited, error, by_share))
    return np.maximum(found, LEAST_ERROR)


def _assign_targets(index: Array, milled: MilledTargets, advised: AdvisedFeeds) -> _NodeTargets | None:
    """Return the target nearest to each node within half of either segment; None where no node has one."""
    middle = 0.5 * (index[1:] + index[:-1])
    low, high = np.r_[index[0] - 0.5, middle], np.r_[middle, index[-1] + 0.5]
    usable = milled.usable[np.isfinite(advised.feed[milled.targets.row[milled.usable]])]
    rows = milled.targets.row[usable]
    nodes, targets, advice = [], [], []
    for n in range(len(index)):
        some = np.flatnonzero((rows >= low[n]) & (rows <= high[n]))
        if len(some):
            nodes.append(n)
            targets.append(usable[some[np.argmin(np.abs(rows[some] - index[n]))]])
            advice.append(float(advised.feed[rows[some]].min()))
    if not nodes:
        return None
    return _NodeTargets(node=np.array(nodes, np.intp), target=np.array(targets, np.intp), advice=np.array(advice))


def _build_wrenches(
    plan: Plan, points: NDArray[np.intp], milled: MilledTargets, target: NDArray[np.intp]
) -> tuple[Array, Array, Array, Array]:
    """Return (M, 6) load without feed, (M, 6) its change by the feed, (M, 3) normal, all in the workpiece frame; and
    (M,) m/s, the feed at the largest chip thickness for which the coefficients hold.
    """
    axis = plan.path.programmed.axis[points]
    across = compute_sideways_directions(plan.path)[points]
    beside = np.cross(axis, across)
    rows, operation = milled.targets.row[target], milled.targets.operation[target]
    edge, slope = np.zeros((len(points), 6)), np.zeros((len(points), 6))
    frame = np.stack([across, beside, axis], axis=1)
    for out, force, moment in (
        (edge, milled.edge_force[rows], milled.edge_moment[rows]),
        (slope, milled.slope_force[rows], milled.slope_moment[rows]),
    ):
        out[:, :3], out[:, 3:] = np.einsum("nk,nki->ni", force, frame), moment[:, None] * axis
    materials = milled.process.materials
    chip = np.array([_get_largest_chip(materials, one) for one in milled.process.operations])
    highest = chip[operation] * milled.teeth * milled.loads.spindle_speed[rows]
    cam_axes = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    normal = milled.targets.choose_normal(target, cam_axes, axis, beside)
    return edge, slope, np.asarray(normal), highest
