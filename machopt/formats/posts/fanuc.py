"""FANUC: CONFIG of Cartesian positions.

Turn numbers count how often J1, J4 and J6 have passed ±180°: sign(a) · floor((|a| + 180°) / 360°). F or N is the
flip of the wrist by the sign of J5, which documents give either way: the cell must say it
(``controller.nonflip_j5``). U or D is the elbow, T or B the side of the wrist root to J1. The post fanuc_joint
writes joint positions only and needs none of this.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.arrays import Array
from machopt.domain.program import LIN
from machopt.errors import InputError
from machopt.formats.posts.columns import Job
from machopt.formats.posts.dialect import Dialect, Passing
from machopt.formats.posts.feedmodel import acceleration
from machopt.formats.posts.orientation import abc_deg
from machopt.formats.posts.problems import CellLacksError

PRINTED = 4
SLOWEST = 1e-4  # m/s: speeds are printed in tenths of mm/s


def turns(axis_deg: Array) -> Array:
    """Turn number of an axis (...,) deg."""
    a = np.round(axis_deg, PRINTED)
    return np.asarray(np.sign(a) * np.floor((np.abs(a) + 180.0) / 360.0) + 0.0)


def continuous(job: Job) -> Array:
    """(M,) n of CNTn at each move's end, 0 for FINE; see the head of this file."""
    p, zone = job.program, job.zone
    a = acceleration(p)
    n = np.zeros(len(p))
    if a is not None:
        rows = np.flatnonzero(zone.distance > 0.0)
        speed = np.sqrt(2.0 * np.minimum(a[rows], a[rows + 1]) * zone.distance[rows])
        n[rows] = np.floor(100.0 * np.minimum(speed / np.maximum(p.feed[rows], SLOWEST), 1.0))
    n[zone.free] = 100.0
    return n


def _passing(job: Job, used: frozenset[str]) -> Passing:
    n, p, a = continuous(job), job.program, acceleration(job.program)
    if a is None or "cnt" not in used:
        return Passing(np.zeros(len(p)), np.full(len(p), np.inf))
    speed = np.where(n > 0.0, n / 100.0 * np.nan_to_num(p.feed), 0.0)
    both = np.minimum(a, np.append(a[1:], np.inf))
    braking = speed**2 / np.maximum(2.0 * np.nan_to_num(both, nan=np.inf), 1e-12)  # a line of no length brakes nothing
    distance = np.where(n > 0.0, np.minimum(braking, job.zone.room), 0.0)
    return Passing(distance, np.where(n > 0.0, speed, np.inf))


def _flip(job: Job) -> list[str]:
    negative = np.round(job.axes_deg[:, 4], PRINTED) < 0.0
    nonflip = negative if job.controller.nonflip_j5 == "negative" else ~negative
    return ["N" if v else "F" for v in nonflip.tolist()]


def _check(job: Job, used: frozenset[str]) -> None:
    check_slowest(job)
    if not used & {"flip", "elbow", "front"}:
        return
    if job.controller.nonflip_j5 is None:
        raise CellLacksError(
            "FANUC's CONFIG needs to know which sign of J5 is N (non-flip) on this robot: give negative or positive, "
            "or use the post fanuc_joint, which needs no CONFIG",
            where="controller.nonflip_j5",
        )
    if job.program.behind is None:
        raise CellLacksError(
            "the posture of this arm is not known, so there is no CONFIG; use the post fanuc_joint",
            where="controller.post",
        )


def _notes(job: Job, used: frozenset[str]) -> Sequence[str]:
    notes = [
        _frame("UFRAME", job.T_root_workpiece),
        _frame("UTOOL", job.T_mount_tcp),
        "feeds are rounded to 0.1 mm/sec",
    ]
    mass, com = job.program.tool_mass, job.com_mm
    if np.isfinite(mass):
        numbers = " ".join(f"{k} {v + 0.0:.1f}" for k, v in zip("XYZ", com, strict=True))
        notes.append(f"PAYLOAD must be {mass:.2f} kg at {numbers}")
    return notes


def _assumed(job: Job, used: frozenset[str]) -> Sequence[str]:
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


def check_slowest(job: Job) -> None:
    """Refuse a feed that would be printed as another one.

    Raises:
        InputError: a feed below a tenth of a mm/s.
    """
    least = np.nanmin(job.program.feed) if (job.program.kind == LIN).any() else 1.0
    if least < SLOWEST:
        raise InputError(
            f"a feed of {least * 6e4:.3g} mm/min cannot be written: the format has steps of 6 mm/min", where="post"
        )


def _frame(name: str, T: Array) -> str:
    r, p, w = abc_deg(T[:3, :3])
    numbers = [*(T[:3, 3] * 1e3), w, p, r]
    return f"{name} must be " + " ".join(f"{k} {v + 0.0:.3f}" for k, v in zip("XYZWPR", numbers, strict=True))


DIALECT = Dialect(
    columns=lambda job: {
        **{f"t{k}": (lambda k=k: turns(job.axes_deg[:, k - 1])) for k in (1, 4, 6)},  # type: ignore[misc]
        "flip": lambda: _flip(job),
        "elbow": lambda: ["U" if v else "D" for v in np.asarray(job.program.elbow_up).tolist()],
        "cnt": lambda: continuous(job).astype(int),
        "continuous": lambda: list(continuous(job) > 0.0),
        "front": lambda: ["B" if v else "T" for v in np.asarray(job.program.behind).tolist()],
    },
    values=lambda job: {"tool": job.controller.tool_number or 1, "base": job.controller.base_number or 1},
    notes=_notes,
    assumed=_assumed,
    check=_check,
    passing=_passing,
    coupled=True,
)
