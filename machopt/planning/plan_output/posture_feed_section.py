"""Section ``joint`` of result.json: the joint optimisation of posture and feed."""

from __future__ import annotations

import math

from machopt.data_types.documents import optimize_document
from machopt.data_types.posture_feed_result import PostureFeedResult
from machopt.planning.pipeline.plan_data_types import Plan


def build_joint_section(plan: Plan) -> tuple[optimize_document.JointMethodEntry, ...] | None:
    """Return one entry a tool; None with another method, or where nothing is driven.

    Args:
        plan: plan of the job.
    """
    plans = [part.plan for part in plan.parts] if plan.parts else [plan]
    results = [one.posture_feed for one in plans if one.posture_feed is not None]
    return tuple(_build_entry(result) for result in results) or None


def _build_entry(result: PostureFeedResult) -> optimize_document.JointMethodEntry:
    return optimize_document.JointMethodEntry(
        accepted=result.is_accepted,
        reason=result.reason,
        fixed_path_s=_convert_nan_to_null(result.fixed_seconds),
        joint_s=_convert_nan_to_null(result.joint_seconds),
        windows=tuple(
            optimize_document.JointWindowEntry(
                window=window.window,
                nodes=window.nodes,
                accepted=window.is_accepted,
                reason=window.reason,
                run_before_s=_convert_nan_to_null(window.seconds_before),
                run_after_s=_convert_nan_to_null(window.seconds_after),
            )
            for window in result.windows
        ),
    )


def _convert_nan_to_null(value: float) -> float | None:
    return value if math.isfinite(value) else None
