"""One toolpath's best plan, whether the robot's base and the part stand still or can move.

What chooses external joints is loaded only where a cell has some.
"""

from __future__ import annotations

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.plan.external.axes import axes_of
from machopt.plan.external.stands import refuse_strangers
from machopt.plan.pipeline.planned import ExternalBound, Plan
from machopt.plan.pipeline.run import plan
from machopt.plan.pipeline.setup import Timings


def best_plan(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: Timings | None = None,
    before: Plan | None = None,
    *,
    scale: float | None = None,
) -> Plan:
    """Plan one toolpath, the external joints where they serve it best by their modes.

    Args:
        before: a plan of the same but for the user's wishes (:func:`machopt.plan.pipeline.run.plan`).
        scale: c₀ of a plan that this one belongs to; None: of its own.

    Raises:
        InputError: an option names no external joint or asks for what is not planned.
    """
    if cell.external_joints:
        from machopt.plan.best import external

        return external.best_plan(cell, toolpath, options, timings, before, scale=scale)
    axes_of(cell, options)
    refuse_strangers(cell, options.steer)
    return plan(cell, toolpath, options, timings, scale=scale, before=before)


def over_external(plan: Plan, toolpath: Toolpath, timings: Timings) -> ExternalBound | None:
    """The bound of a plan of one tool over the external joints' values; None where no external joint was free."""
    if not plan.setup.cell.external_joints:
        return None
    from machopt.plan.best import bound

    return bound.over_external(plan, toolpath, timings)
