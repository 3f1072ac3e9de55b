"""Yaskawa: joint positions in pulses where the cell gives pulses_per_deg, else in degrees; RCONF of Cartesian ones.

RCONF, as the NX100's job format lists it: flip 0 or no-flip 1 (here by the sign of the B axis), upper arm 0 or lower
arm 1, front 0 or rear 1, then for R, T and S: 0 below 180°, 1 from 180°.

Positioning levels PL=0 … 8 are distances that parameters of the controller hold (S1CxG33 and on, as users describe
them), so a program cannot know them: the cell may state them (``controller.position_levels_mm``), and then the largest
that keeps to the tolerance is taken. Without them PL=1 is written only where rounding over half of the shorter line,
which no level exceeds, keeps to it; everywhere else PL=0, an exact stop. Joint moves state PL=0 too: without PL a
controller rounds their ends as it is set up.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.programs.writing.external_axes import build_external_fields
from machopt.programs.writing.maker_rules import CornerPassing, MakerRules
from machopt.programs.writing.post_errors import MissingControllerKeyError
from machopt.programs.writing.slowest_printable_feed import check_slowest_feed
from machopt.programs.writing.template_fields import PostJob

PRINTED = 4


def _list_rconf_words(job: PostJob) -> list[str]:
    a = np.round(job.axes_deg, PRINTED)
    p = job.program
    bits = [a[:, 4] < 0.0, ~np.asarray(p.elbow_up), np.asarray(p.wrist_behind)]
    bits += [np.abs(a[:, k]) >= 180.0 for k in (3, 5, 0)]
    return [",".join(map(str, row)) for row in np.column_stack(bits).astype(int).tolist()]


def compute_position_levels(job: PostJob) -> NDArray[np.int64]:
    """Compute the position level PL at the end of each move; the module docstring gives the rule.

    Args:
        job: Program, controller, axis values and blend zones.

    Returns:
        PL (M,).
    """
    zone, stated = job.zone, job.controller.position_levels
    if stated is None:
        return zone.free.astype(np.int64)
    limit = np.where(np.isfinite(zone.turn), np.where(zone.free, np.inf, zone.distance), 0.0)
    return np.asarray(np.searchsorted(stated, limit * (1.0 + 1e-9), side="right"), np.int64)


def _compute_rapid_levels(job: PostJob) -> NDArray[np.int64]:
    """(M,) PL of the joint moves; 0 where the plan stops, because without PL the controller rounds as it is set up."""
    limit, stated = job.zone.rapid, job.controller.position_levels
    if limit is None or stated is None:
        return np.zeros(len(job.program), np.int64)
    level = np.searchsorted(stated, limit * (1.0 + 1e-9), side="right")
    return np.where((job.blend > 0.0) & (limit > 0.0), level, 0).astype(np.int64)


def _find_reason_to_stop(job: PostJob) -> str:
    return "" if job.controller.position_levels is not None else "no controller.position_levels_mm in the cell"


def _compute_passing(job: PostJob, used: frozenset[str]) -> CornerPassing:
    level, stated = compute_position_levels(job), job.controller.position_levels
    room = job.zone.room
    size = room if stated is None else np.minimum(np.append(0.0, stated)[level], room)
    distance = np.where(level > 0, size, 0.0) if "pl" in used else np.zeros(len(level))
    return CornerPassing(distance, np.full(len(level), np.inf))


def _list_assumptions(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    c, out = job.controller, []
    if c.tool_number is None:
        out.append("no controller.tool_number in the cell: TOOL 0 is taken")
    if "x" in used and c.base_number is None:
        out.append("no controller.base_number in the cell: user frame 1 is taken")
    if c.pulses_per_deg is None:
        out.append("no controller.pulses_per_deg in the cell: joint positions stand in degrees, not in pulses")
    if job.program.external_axes and not build_external_fields(job.program, c)["external_pulses"]:
        out.append("no pulses under controller.external in the cell: base and station axes stand in mm and degrees")
    if job.program.part_rides:
        out.append("the station leads the robot: a coordinated group of both is set up")
    if c.position_levels is None and "pl" in used:
        out.append("no controller.position_levels_mm in the cell: PL=1 where any rounding would do, else PL=0")
    return out


def _check_job(job: PostJob, used: frozenset[str]) -> None:
    check_slowest_feed(job)
    if "rconf" in used and job.program.part_rides:
        raise MissingControllerKeyError(
            "Cartesian positions do not ride on a station here; use the post jbi, whose positions are axes",
            where="controller.post",
        )
    if "rconf" in used and job.program.wrist_behind is None:
        raise MissingControllerKeyError(
            "the posture of this arm is not known, so there is no RCONF; use the post jbi", where="controller.post"
        )


DIALECT = MakerRules(
    columns=lambda job: {
        "rconf": lambda: _list_rconf_words(job),
        "pl": lambda: compute_position_levels(job),
        "rapid_pl": lambda: _compute_rapid_levels(job),
    },
    values=lambda job: {
        "tool": job.controller.tool_number or 0,
        "user": job.controller.base_number or 1,
        "in_pulses": job.controller.pulses_per_deg is not None,
    },
    notes=lambda _, __: ("feeds are rounded to 0.1 mm/s",),
    assumptions=_list_assumptions,
    check=_check_job,
    passing=_compute_passing,
    rapid_stops=_find_reason_to_stop,
    coupled=True,
)
