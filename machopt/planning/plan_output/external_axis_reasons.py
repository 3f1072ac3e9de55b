"""Messages about the influence of the external joints on a point without a configuration."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from machopt.data_types.plan_options import ExternalJointOptions
from machopt.data_types.steering_rules import find_external_joint, format_steering_rule
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import invert_transform
from machopt.planning.external_axes.axis_modes import compute_axis_range, resolve_axis_options
from machopt.planning.external_axes.position_constraints import MET
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.stations.planning_path import compute_tcp_poses

VALUES = 13  # number of values tried of one joint, over its whole range
TOGETHER = 5  # the same per joint for several joints
ROTATIONS = np.radians(np.arange(0.0, 360.0, 45.0))
AT_END = 0.02  # of a range: a joint that moves along the path keeps half of it (moving_axes.ROOM)


@dataclass(frozen=True)
class ExternalAxisReason:
    """Messages for one point."""

    position_text: str  # position of the external joints, and the range end or lock that limits them; "" without any
    elsewhere: str  # position at which the wrist would be in reach; "" if unknown
    help: str  # limiting option; "" where there is none


def explain_external_axes(plan: Plan, point: int, *, out_of_reach: bool) -> ExternalAxisReason:
    """Return the influence of the external joints on a planning point.

    Args:
        plan: the plan; its joints at the point are ``plan.path.external[point]``.
        point: planning point without a configuration.
        out_of_reach: also search for joint values that reach the point; only reach is checked, not limits or contacts.
    """
    cell = plan.setup.cell
    if not cell.external_joints:
        return ExternalAxisReason("", "", "")
    axes = resolve_axis_options(cell, plan.options)
    at = plan.path.external[point]
    positions = "with " + " and ".join(_stands(plan, k, axis, float(at[k])) for k, axis in enumerate(axes))
    if not out_of_reach:
        return ExternalAxisReason(positions, "", "")
    others = np.array(list(_iterate_other_values(plan, at)))
    within = np.flatnonzero(_find_reached(plan, point, others))
    if not len(within):
        names = " and ".join(_format_range(plan, k) for k in range(len(at)))
        return ExternalAxisReason(positions, f"out of reach at every value tried of {names}", "")
    found = others[within[0]]
    moved = [k for k in range(len(at)) if abs(found[k] - at[k]) > 1e-9]
    there = " and ".join(f"{cell.external_joints[k]} at {_format_value(plan, k, float(found[k]))}" for k in moved)
    limiting_options = [_find_option(plan, k, axes[k], float(found[k])) for k in moved]
    return ExternalAxisReason(
        positions, f"with {there} it would be in reach", " and ".join(dict.fromkeys(h for h in limiting_options if h))
    )


def list_overruled_pins(plan: Plan) -> list[str]:
    """Return messages for pins that override the locked position or the range of their joint in the options.

    Args:
        plan: plan of one tool.
    """
    cell, out = plan.setup.cell, []
    axes = resolve_axis_options(cell, plan.options) if cell.external_joints else ()
    for wish in plan.options.steer:
        k = find_external_joint(wish.joint, cell.external_joints) if wish.joint and wish.at is not None else None
        if k is None or wish.at is None:
            continue
        low, high = compute_axis_range(cell, k, axes[k], locked=not axes[k].moves)
        if not low - MET <= wish.at <= high + MET:
            range_text = (
                f"the range {_format_value(plan, k, low)} to {_format_value(plan, k, high)}" if high > low else ""
            )
            range_text = range_text or f"its lock at {_format_value(plan, k, low)}"
            out.append(
                f"The pin of {format_steering_rule(wish)} (steer) goes before {range_text} "
                f"(external.{cell.external_joints[k]})."
            )
    return out


def _stands(plan: Plan, k: int, axis: ExternalJointOptions, at: float) -> str:
    cell = plan.setup.cell
    name, value = cell.external_joints[k], _format_value(plan, k, at)
    if not axis.moves:
        return f"{name} locked at {value}"
    low, high = compute_axis_range(cell, k, axis, locked=False)
    if min(at - low, high - at) <= AT_END * (high - low):
        return f"{name} at {value}, an end of its range {_format_value(plan, k, low)} to {_format_value(plan, k, high)}"
    return f"{name} at {value}"


def _find_option(plan: Plan, k: int, axis: ExternalJointOptions, value: float) -> str:
    """Return the option that keeps a joint from a value."""
    if not axis.moves:
        return f"external.{plan.setup.cell.external_joints[k]}.mode other than locked"
    low, high = compute_axis_range(plan.setup.cell, k, axis, locked=False)
    unit = "mm" if plan.setup.cell.external_prismatic[k] else "deg"
    return "" if low <= value <= high else f"a wider external.{plan.setup.cell.external_joints[k]}.range_{unit}"


def _iterate_other_values(plan: Plan, at: Array) -> Iterator[Array]:
    """Values (E,) over the joints' own limits, nearest first: of one joint alone, then of all together."""
    limits, n = plan.setup.cell.limits, len(at)
    span = np.maximum(limits.upper[6:] - limits.lower[6:], 1e-12)
    for k in range(n):
        ends = np.linspace(limits.lower[6 + k], limits.upper[6 + k], VALUES)
        for value in sorted(ends.tolist(), key=lambda v: abs(v - at[k])):
            yield np.where(np.arange(n) == k, value, at)
    if n > 1:
        each = [np.linspace(limits.lower[6 + k], limits.upper[6 + k], TOGETHER) for k in range(n)]
        grid = [np.array(e) for e in itertools.product(*each)]
        yield from sorted(grid, key=lambda e: float(np.abs((e - at) / span).sum()))


def _find_reached(plan: Plan, point: int, external: Array) -> Bools:
    """Return (M,) whether the wrist is in reach at some rotation with the external joints at (M, E)."""
    arm, n = plan.setup.arm, len(ROTATIONS)
    poses = compute_tcp_poses(plan.path, np.array([point], np.int32), ROTATIONS[None, :])[0]
    there = arm.in_base(np.repeat(external, n, axis=0), np.tile(poses, (len(external), 1, 1)))
    short = arm.solver.solve(there @ invert_transform(arm.T_flange_tcp)).shortfall
    return np.asarray((short.reshape(-1, n) <= 0.0).any(axis=1))


def _format_range(plan: Plan, k: int) -> str:
    limits = plan.setup.cell.limits
    low, high = (_format_value(plan, k, float(v[6 + k])) for v in (limits.lower, limits.upper))
    return f"{plan.setup.cell.external_joints[k]} ({low} to {high})"


def _format_value(plan: Plan, k: int, value: float) -> str:
    if plan.setup.cell.external_prismatic[k]:
        return f"{1e3 * value:,.0f} mm"
    return f"{np.degrees(value) + 0.0:.1f}°"
