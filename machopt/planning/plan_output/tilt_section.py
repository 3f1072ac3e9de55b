"""Section ``tilt`` of result.json: the tilts in use, and lower bounds over the grid of tilts."""

from __future__ import annotations

import numpy as np

from machopt.data_types.documents import optimize_document
from machopt.planning.pipeline.plan_data_types import Plan, TiltBound
from machopt.planning.plan_output.point_table import PointResults


def build_tilt_section(plan: Plan, points: PointResults) -> optimize_document.TiltSection | None:
    """Return the tilts at the cut points and the bounds; None where the tool axis is that of the CAM file.

    Args:
        plan: plan of the job.
        points: results at the points of the toolpath.
    """
    lead, side = points.table.lead, points.table.side
    if lead is None or side is None:
        return None
    cut = plan.path.counted[points.rows] & np.isfinite(lead)
    used = [np.degrees(tilt[cut]) if cut.any() else np.zeros(1) for tilt in (lead, side)]
    bound = _join_bounds(plan)
    return optimize_document.TiltSection(
        lead_deg=(float(used[0].min()), float(used[0].max())),
        side_deg=(float(used[1].min()), float(used[1].max())),
        bound=None
        if bound is None
        else optimize_document.TiltBoundEntry(
            mean=bound.mean,
            worst=bound.worst,
            stations=bound.stations,
            tilts=bound.tilts,
            rotation_step_deg=float(np.degrees(bound.step)),
        ),
    )


def _join_bounds(plan: Plan) -> TiltBound | None:
    """Return the bound of a job; of one that changes tools only where every tool has one."""
    if not plan.parts:
        return plan.tilt_bound
    bounds = [part.plan.tilt_bound for part in plan.parts]
    known = [bound for bound in bounds if bound is not None]
    if len(known) < len(bounds):
        return None
    return TiltBound(
        mean=float(sum(part.share * bound.mean for part, bound in zip(plan.parts, known, strict=True))),
        worst=max(bound.worst for bound in known),
        stations=sum(bound.stations for bound in known),
        tilts=max(bound.tilts for bound in known),
        step=max(bound.step for bound in known),
    )
