"""Outcome of ``--method joint`` for the report."""

from __future__ import annotations

import math

from machopt.data_types.posture_feed_result import PostureFeedResult
from machopt.planning.pipeline.plan import Plan
from machopt.report.page_types.joint_method import JointMethodRow, JointMethodWindowRow


def build_joint_method_rows(plan: Plan) -> tuple[JointMethodRow, ...]:
    """Return one row a tool; empty with another method.

    Args:
        plan: The plan.
    """
    plans = [part.plan for part in plan.parts] if plan.parts else [plan]
    return tuple(
        _build_row(one.posture_feed, str(one.setup.cell.tool_name) if plan.parts else "")
        for one in plans
        if one.posture_feed is not None
    )


def _build_row(result: PostureFeedResult, tool: str) -> JointMethodRow:
    return JointMethodRow(
        tool=tool,
        accepted=result.is_accepted,
        reason=result.reason,
        fixed_path=_convert_nan(result.fixed_seconds),
        joint=_convert_nan(result.joint_seconds),
        windows=tuple(
            JointMethodWindowRow(
                name=window.window,
                nodes=window.nodes,
                accepted=window.is_accepted,
                reason=window.reason,
                run_before=_convert_nan(window.seconds_before),
                run_after=_convert_nan(window.seconds_after),
            )
            for window in result.windows
        ),
    )


def _convert_nan(value: float) -> float | None:
    return value if math.isfinite(value) else None
