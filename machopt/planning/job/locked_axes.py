"""Planning with fewer free external joints, for a job that has no complete motion with all of them free.

A plan with an external joint locked at its home value is one of the plans with that joint free. Where the search over
the larger set ends without a complete motion, the smaller sets are searched: each free joint locked alone, in the order
of the cell, then all of them. The first complete motion is selected. A job with external joints therefore never ends
without a motion where one of these subsets has one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.planning.external_axes.axis_modes import compute_axis_range, resolve_axis_options
from machopt.planning.job.joined_motion import DrivenToolSegment
from machopt.planning.motion.search_budget import EXTENSIONS


def iterate_locked_subsets(cell: Cell, options: PlanOptions) -> Iterator[tuple[tuple[str, ...], PlanOptions]]:
    """Yield the names of joints that are locked in addition, and the options with these locked at home.

    A joint with values or modes of single operations, a preferred value, or a range without its home is not locked.

    Args:
        cell: cell with the external joints.
        options: plan options.
    """
    names = []
    for k, axis in enumerate(resolve_axis_options(cell, options)):
        home = compute_axis_range(cell, k, replace(axis, at=None), locked=True)[0]
        low, high = compute_axis_range(cell, k, axis, locked=False)
        own = axis.operations or axis.at_operations or axis.preferred is not None
        if axis.mode != "locked" and not own and low <= home <= high:
            names.append(axis.joint)
    sets = [(name,) for name in names] + ([tuple(names)] if len(names) > 1 else [])
    if any(wish.joint for wish in options.steer):  # a request about an external joint fixes its position
        return
    for some in sets:
        locks = tuple(ExternalJointOptions(joint=name, mode="locked") for name in some)
        yield some, replace(options, external=(*options.external, *locks))


def has_trajectory(done: DrivenToolSegment) -> bool:
    """Return whether the whole stretch is planned and driven.

    Args:
        done: stretch of one tool.
    """
    return done.timeline is not None and done.timeline.trajectory is not None


def add_locked_axes_note(done: DrivenToolSegment, names: tuple[str, ...], options: PlanOptions) -> DrivenToolSegment:
    """Return the plan of a subset as the result of the user's request, with a note about the locked joints.

    Args:
        done: stretch with a motion.
        names: of the joints that were locked at home.
        options: as the user gave them.
    """
    assert done.timeline is not None
    plan = done.segment_plan.plan
    plan = replace(plan, options=replace(plan.options, external=options.external), over_external=None)
    note = (
        f"external joint{'s' if len(names) > 1 else ''} {', '.join(names)} locked at home: with "
        f"{'them' if len(names) > 1 else 'it'} free no complete motion was found (budget: {EXTENSIONS} extensions "
        "of search trees in vain)"
    )
    timeline = replace(done.timeline, detours=(*done.timeline.detours, note))
    return replace(done, segment_plan=replace(done.segment_plan, plan=plan), timeline=timeline)
