"""ABB: confdata of robtargets.

cf1, cf4 and cf6 are the quarter turns of axes 1, 4 and 6, floor(a / 90°): 0…90° is 0, 90…180° is 1, 0…−90° is −1.
cfx of a six-axis arm is 4·(wrist root behind axis 1) + 2·(wrist root behind the lower arm) + (axis 5 below 0°).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.numerics.array_types import Array
from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.template_fields import PostJob

PRINTED = 4  # decimals: an axis printed as zero counts as zero


def compute_quarter_turn(axis_deg: Array) -> Array:
    """Compute the quarter-turn index of an axis.

    Args:
        axis_deg: Axis angle (...,), degrees.

    Returns:
        Index (...,): floor(angle / 90°).
    """
    return np.asarray(np.floor(np.round(axis_deg, PRINTED) / 90.0) + 0.0)


def _compute_cfx(job: PostJob) -> Array:
    p = job.program
    if p.wrist_behind is None or p.elbow_up is None:
        return np.zeros(len(p))
    flip = np.round(job.axes_deg[:, 4], PRINTED) < 0.0
    return np.asarray(4.0 * p.wrist_behind + 2.0 * ~p.elbow_up + flip)


def _list_notes(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    notes = []
    if "cfx" in used and job.program.wrist_behind is None:
        notes.append("cfx is not known for this arm: it stands as 0 and the configuration is not monitored")
    if "ptp_share" not in used:
        notes.append("rapid moves run at a TCP speed of 1000 mm/s, not at a share of the axis limits")
    return notes


def _list_assumptions(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    return [] if np.isfinite(job.program.tool_mass) else ["tooldata says 1 kg"]


DIALECT = MakerRules(
    columns=lambda job: {
        **{f"cf{k}": (lambda k=k: compute_quarter_turn(job.axes_deg[:, k - 1])) for k in (1, 4, 6)},  # type: ignore[misc]
        "cfx": lambda: _compute_cfx(job),
    },
    values=lambda job: {"monitored": job.program.wrist_behind is not None},
    notes=_list_notes,
    assumptions=_list_assumptions,
    coupled=True,
)
