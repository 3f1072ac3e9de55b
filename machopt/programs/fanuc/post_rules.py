"""CONFIG of FANUC Cartesian positions.

Turn numbers count how often J1, J4 and J6 have passed ±180°: sign(a) · floor((|a| + 180°) / 360°). F or N is the
wrist flip by the sign of J5. Documents disagree on its direction, so the cell must give it
(``controller.nonflip_j5``). U or D is the elbow, T or B the side of the wrist root relative to J1. The post fanuc_joint
writes joint positions only and needs none of this.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.numerics.array_types import Array
from machopt.programs.writing.feed_model import compute_line_acceleration
from machopt.programs.writing.maker_rules import CornerPassing, MakerRules
from machopt.programs.writing.orientation_angles import convert_to_abc_deg
from machopt.programs.writing.post_errors import MissingControllerKeyError
from machopt.programs.writing.slowest_printable_feed import SLOWEST, check_slowest_feed
from machopt.programs.writing.template_fields import PostJob

PRINTED = 4


def compute_turn_number(axis_deg: Array) -> Array:
    """Compute the turn number of an axis.

    Args:
        axis_deg: Axis angle (...,), degrees.

    Returns:
        Turn number (...,).
    """
    a = np.round(axis_deg, PRINTED)
    return np.asarray(np.sign(a) * np.floor((np.abs(a) + 180.0) / 360.0) + 0.0)


def compute_cnt_values(job: PostJob) -> Array:
    """Compute n of CNTn at the end of each move; the module docstring gives the rule.

    Args:
        job: Program, controller, axis values and blend zones.

    Returns:
        n (M,); 0 for FINE.
    """
    p, zone = job.program, job.zone
    a = compute_line_acceleration(p)
    n = np.zeros(len(p))
    if a is not None:
        rows = np.flatnonzero((zone.distance > 0.0) & np.isfinite(zone.turn))
        speed = np.sqrt(2.0 * np.minimum(a[rows], a[rows + 1]) * zone.distance[rows])
        n[rows] = np.floor(100.0 * np.minimum(speed / np.maximum(p.feed[rows], SLOWEST), 1.0))
    n[zone.free] = 100.0
    return n


def _compute_passing(job: PostJob, used: frozenset[str]) -> CornerPassing:
    n, p, a = compute_cnt_values(job), job.program, compute_line_acceleration(job.program)
    if a is None or "cnt" not in used:
        return CornerPassing(np.zeros(len(p)), np.full(len(p), np.inf))
    speed = np.where(n > 0.0, n / 100.0 * np.nan_to_num(p.feed), 0.0)
    both = np.minimum(a, np.append(a[1:], np.inf))
    braking = speed**2 / np.maximum(
        2.0 * np.where(np.isnan(both), np.inf, both), 1e-12
    )  # a line of no length brakes nothing
    distance = np.where(n > 0.0, np.minimum(braking, job.zone.room), 0.0)
    return CornerPassing(distance, np.where(n > 0.0, speed, np.inf))


def _list_flip_words(job: PostJob) -> list[str]:
    negative = np.round(job.axes_deg[:, 4], PRINTED) < 0.0
    nonflip = negative if job.controller.nonflip_j5 == "negative" else ~negative
    return ["N" if v else "F" for v in nonflip.tolist()]


def _check_job(job: PostJob, used: frozenset[str]) -> None:
    check_slowest_feed(job)
    if not used & {"flip", "elbow", "front"}:
        return
    if job.controller.nonflip_j5 is None:
        raise MissingControllerKeyError(
            "FANUC's CONFIG needs to know which sign of J5 is N (non-flip) on this robot: give negative or positive, "
            "or use the post fanuc_joint, which needs no CONFIG",
            where="controller.nonflip_j5",
        )
    if job.program.wrist_behind is None:
        raise MissingControllerKeyError(
            "the posture of this arm is not known, so there is no CONFIG; use the post fanuc_joint",
            where="controller.post",
        )


def _list_notes(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    notes = [
        _format_frame("UFRAME", job.T_root_workpiece),
        _format_frame("UTOOL", job.T_mount_tcp),
        "feeds are rounded to 0.1 mm/sec",
    ]
    mass, com = job.program.tool_mass, job.com_mm
    if np.isfinite(mass):
        numbers = " ".join(f"{k} {v + 0.0:.1f}" for k, v in zip("XYZ", com, strict=True))
        notes.append(f"PAYLOAD must be {mass:.2f} kg at {numbers}")
    return notes


def _list_assumptions(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    c, out = job.controller, []
    if job.program.part_rides:
        out.append("group 2 is the positioner and leads group 1: a coordinated pair (CPAIR) is set up for both")
    if c.tool_number is None:
        out.append("no controller.tool_number in the cell: UTOOL 1 is taken")
    if c.base_number is None:
        out.append("no controller.base_number in the cell: UFRAME 1 is taken")
    if c.joint_map is None or not np.any(c.joint_map.coupling[2]):
        out.append("J3 is not coupled to J2 in the cell's joint_map: right only where this robot counts it so")
    return out


def _format_frame(name: str, T: Array) -> str:
    r, p, w = convert_to_abc_deg(T[:3, :3])
    numbers = [*(T[:3, 3] * 1e3), w, p, r]
    return f"{name} must be " + " ".join(f"{k} {v + 0.0:.3f}" for k, v in zip("XYZWPR", numbers, strict=True))


DIALECT = MakerRules(
    columns=lambda job: {
        **{f"t{k}": (lambda k=k: compute_turn_number(job.axes_deg[:, k - 1])) for k in (1, 4, 6)},  # type: ignore[misc]
        "flip": lambda: _list_flip_words(job),
        "elbow": lambda: ["U" if v else "D" for v in np.asarray(job.program.elbow_up).tolist()],
        "cnt": lambda: compute_cnt_values(job).astype(int),
        "continuous": lambda: list(compute_cnt_values(job) > 0.0),
        "front": lambda: ["B" if v else "T" for v in np.asarray(job.program.wrist_behind).tolist()],
    },
    values=lambda job: {"tool": job.controller.tool_number or 1, "base": job.controller.base_number or 1},
    notes=_list_notes,
    assumptions=_list_assumptions,
    check=_check_job,
    passing=_compute_passing,
    rapid_stops=lambda _: "CNT does not say how far before it the robot begins to round",
    coupled=True,
)
