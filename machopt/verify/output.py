"""One exported trajectory held against cell and toolpath, check by check."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify.arm import Arm
from machopt.verify.contact import contacts
from machopt.verify.encoder import true_angles
from machopt.verify.shift import Found, compare_shift, corners
from machopt.verify.table import Motion, Points, read_motion, read_points, read_shift

Array = NDArray[np.float64]

PATH_MM, AXIS_DEG = 0.02, 0.05  # how far the TCP may leave the toolpath while cutting
VELOCITY, ACCELERATION, JERK = 1.01, 1.03, 1.10  # differences over the limits: rounding grows with the order
SPARED, NEAR_M = 2.0, 1e-5  # ways of a sample that a cut may lack, one at either end; m, rounding of the index
FEED = 1.02  # of the programmed feed
JITTER_S = 5e-6  # of the control cycle: the time column is rounded
JOINT_DEG = (
    0.1  # points.csv against the samples around the point: corners are rounded by up to 15 µm, over a short lever
)


@dataclass(frozen=True)
class Check:
    """One promise and whether it is kept."""

    name: str
    passed: bool | None  # None: it could not be run, ``where`` says why
    value: float  # NaN where there was nothing to measure
    limit: float
    unit: str
    where: str  # sample, time and point of the worst value, or why nothing was measured


@dataclass(frozen=True)
class Verification:
    """All checks of one exported trajectory."""

    checks: tuple[Check, ...]
    samples: int
    duration: float  # s

    @property
    def ok(self) -> bool:
        return all(check.passed is not False for check in self.checks)

    @property
    def failed(self) -> tuple[Check, ...]:
        return tuple(check for check in self.checks if check.passed is False)


def verify_output(cell: Cell, toolpath: Toolpath, out: Path, *, options: PlanOptions | None = None) -> Verification:
    """Check ``out/trajectory.csv`` and ``out/points.csv``.

    Path and axis while cutting, every cutting point visited in order and every cut driven in one go, uniform time,
    joint limits by differences of the samples (at rest before the first and after the last), feed, contacts at and
    between the samples, and that points.csv tells the same story. Where points.csv holds a compensation, the commanded
    path is the toolpath shifted as compensation.csv says, and the shift is held against the deflection computed here.
    Joint columns are encoder angles, limits hold for them; where the arm stands follows with the cell's corrections.

    Args:
        cell: the robot cell.
        toolpath: what was to be followed.
        out: the output folder.
        options: with ``allow_gaps`` points that points.csv gives up need not be visited; without ``collision``
            contacts are not looked for.

    Raises:
        InputError: a table is missing or unreadable.
    """
    options = options or PlanOptions()
    out = Path(out)
    motion, points = read_motion(out / "trajectory.csv", cell), read_points(out / "points.csv")
    arm = Arm(cell)
    shift = read_shift(out / "compensation.csv") if points.shift is not None else None
    index, position = (np.arange(len(toolpath), dtype=float), toolpath.position) if shift is None else (
        corners(toolpath, shift))  # fmt: skip
    stands = replace(motion, q=true_angles(cell.kinematics, motion.q))
    stood = replace(points, q=true_angles(cell.kinematics, points.q))
    tcp = arm.tcp_in_workpiece(stands.q, motion.external)
    checks = [
        _time(motion),
        *_path(motion, toolpath, index, position, tcp, options),
        *_visited(motion, toolpath, points, options.allow_gaps),
        *_limits(motion, cell),
        _feed(motion, toolpath, tcp),
        *_points(motion, toolpath, points, stood, arm, cell),
    ]
    if shift is not None:
        checks += [_shift_check(f) for f in compare_shift(cell, toolpath, stands, stood, shift, arm, options)]
    if options.collision:
        checks.append(_contacts(stands, cell, arm))
    return Verification(tuple(checks), len(motion.time), float(motion.time[-1] - motion.time[0]))


def _at(motion: Motion, n: int | np.int64) -> str:
    point = f", point {motion.point[n]:.3f}" if np.isfinite(motion.point[n]) else ""
    return f"sample {n}, {motion.time[n]:.3f} s{point}"


def _worst(name: str, unit: str, values: Array, limit: float, where: list[str]) -> Check:
    """The greatest of ``values``; none at all is a failure."""
    if not len(values):
        return Check(name, False, np.nan, limit, unit, "nothing to measure")
    n = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    return Check(name, bool(values[n] <= limit), float(values[n]), limit, unit, where[n])


def _time(motion: Motion) -> Check:
    step = np.diff(motion.time)
    cycle = (motion.time[-1] - motion.time[0]) / len(step)
    off = np.abs(step - cycle) if cycle > 0 else np.full(len(step), np.inf)
    n = int(np.argmax(off))
    return Check("uniform time", bool(off[n] <= JITTER_S and (step > 0).all()), float(off[n]), JITTER_S, "s",
                 _at(motion, n + 1))  # fmt: skip


def _cuts(motion: Motion) -> NDArray[np.int64]:
    return np.flatnonzero(motion.move == Move.CUT)


def _shift_check(found: Found) -> Check:
    if found.not_run:
        return Check(found.name, None, np.nan, found.limit, found.unit, found.not_run)
    return _worst(found.name, found.unit, found.values, found.limit, list(found.where))


def _path(
    motion: Motion, toolpath: Toolpath, index: Array, position: Array, tcp: Array, options: PlanOptions
) -> list[Check]:
    """Distance from the polyline near the sample's own index, and angle from the axis there.

    ``index`` (P,) and ``position`` (P, 3) are the polyline's corners: the toolpath's points, or a shifted path's.
    """
    rows = _cuts(motion)
    where = [_at(motion, n) for n in rows]
    if not np.isfinite(motion.point[rows]).all():
        n = rows[np.flatnonzero(~np.isfinite(motion.point[rows]))[0]]
        return [Check("path", False, np.nan, PATH_MM, "mm", f"cutting without a point at {_at(motion, n)}")]
    axis, last, ends = toolpath.axis, len(toolpath) - 1, len(index) - 1
    s = np.clip(motion.point[rows], 0.0, last)
    k = np.minimum(s.astype(int), max(last - 1, 0))
    on = np.clip(np.searchsorted(index, s, side="right") - 1, 0, max(ends - 1, 0))
    away = np.full(len(rows), np.inf)
    for near in (on - 1, on, on + 1):
        a = np.clip(near, 0, ends)
        start, end = position[a], position[np.clip(near + 1, 0, ends)]
        along = end - start
        length = np.einsum("ij,ij->i", along, along)
        share = np.einsum("ij,ij->i", tcp[rows, :3, 3] - start, along) / np.where(length > 0, length, 1.0)
        foot = start + np.clip(share, 0.0, 1.0)[:, None] * along
        away = np.minimum(away, np.linalg.norm(tcp[rows, :3, 3] - foot, axis=1))
    part = (s - k)[:, None]
    wanted = (1 - part) * axis[k] + part * axis[np.minimum(k + 1, last)]
    shank = -tcp[rows, :3, 2]
    angle = np.arctan2(np.linalg.norm(np.cross(shank, wanted), axis=1), np.einsum("ij,ij->i", shank, wanted))
    return [
        _worst("path", "mm", away * 1e3, max(PATH_MM, 1e3 * options.path_tolerance), where),  # as wide as was asked for
        _worst("tool axis", "deg", np.degrees(angle), max(AXIS_DEG, float(np.degrees(options.axis_tolerance))), where),
    ]


def _visited(motion: Motion, toolpath: Toolpath, points: Points, allow_gaps: bool) -> list[Check]:
    wanted = toolpath.cutting.copy()
    if allow_gaps:
        for number, status in zip(points.point, points.status, strict=True):
            if status != "ok" and 0 <= number < len(wanted):
                wanted[number] = False
    rows = _cuts(motion)
    s = motion.point[rows]
    joined = np.diff(rows) == 1
    missed = []
    for k in np.flatnonzero(wanted):
        near = (np.abs(s - k) <= 0.51).any()
        passed = bool((joined & (s[:-1] <= k) & (s[1:] >= k)).any()) if len(s) > 1 else False
        if not (near or passed):
            missed.append(int(k))
    text = f"{len(missed)} of {int(wanted.sum())} missed, first point {missed[0]}" if missed else "all visited"
    throughout = _throughout(motion, toolpath, wanted)
    back = np.diff(s)
    n = int(np.argmin(back)) if len(back) else -1
    least = float(-back[n]) if n >= 0 else 0.0
    where = _at(motion, rows[n]) if n >= 0 else ""
    return [
        Check("cutting points visited", not missed, float(len(missed)), 0.0, "points", text),
        throughout,
        Check("in order", least <= 1e-6, max(0.0, least), 1e-6, "points back", where),
    ]


def _throughout(motion: Motion, toolpath: Toolpath, wanted: NDArray[np.bool_]) -> Check:
    """Every cut between two points is driven in one go: what no two successive cutting samples enclose is short.

    At either end of a cut the way of one sample may belong to the move before or after.
    """
    rows = _cuts(motion)
    s = motion.point[rows]
    both = np.flatnonzero((np.diff(rows) == 1) & (np.diff(s) >= 0))
    segments = 1 + np.flatnonzero(wanted[1:] & (wanted[:-1] | ~toolpath.cutting[:-1]))
    if not len(both) or not len(segments):
        return Check("cut throughout", not len(segments), np.nan, SPARED, "of a sample's way", "nothing to measure")
    knots = np.column_stack([s[both], s[both + 1]])
    driven = np.cumsum(np.column_stack([np.zeros(len(both)), knots[:, 1] - knots[:, 0]]).ravel())
    ends = np.maximum.accumulate(knots.ravel())
    share = np.interp(segments, ends, driven) - np.interp(segments - 1, ends, driven)
    length = np.linalg.norm(toolpath.position[segments] - toolpath.position[segments - 1], axis=1)
    cycle = (motion.time[-1] - motion.time[0]) / (len(motion.time) - 1)
    way = np.nan_to_num(toolpath.feed[segments]) * cycle + NEAR_M
    left = np.clip(1.0 - share, 0.0, 1.0) * length / way
    return _worst("cut throughout", "of a sample's way", left, SPARED, [f"the cut to point {k}" for k in segments])


def _limits(motion: Motion, cell: Cell) -> list[Check]:
    q = np.hstack([motion.q, motion.external])
    cycle = (motion.time[-1] - motion.time[0]) / (len(q) - 1)
    limits = cell.limits
    beyond = np.maximum(limits.lower - q, q - limits.upper)
    n, j = np.unravel_index(np.argmax(beyond), beyond.shape)
    where = f"axis {j + 1}, {_at(motion, int(n))}"
    out = [Check("joint positions", bool(beyond[n, j] <= 1e-8), float(np.degrees(beyond[n, j])), 0.0,
                 "deg beyond the limit", where)]  # fmt: skip
    x = np.vstack([np.repeat(q[:1], 3, axis=0), q, np.repeat(q[-1:], 3, axis=0)])
    orders = (
        ("velocity", limits.velocity, VELOCITY),
        ("acceleration", limits.acceleration, ACCELERATION),
        ("jerk", limits.jerk, JERK),
    )
    for name, limit, most in orders:
        x = np.diff(x, axis=0) / cycle
        ratio = np.abs(x) / limit
        n, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        where = f"axis {j + 1}, {_at(motion, int(np.clip(n - 2, 0, len(q) - 1)))}"
        out.append(Check(f"joint {name}", bool(ratio[n, j] <= most), float(ratio[n, j]), most, "of the limit", where))
    return out


def _feed(motion: Motion, toolpath: Toolpath, tcp: Array) -> Check:
    """Speed between two cutting samples over the feed of the fastest move it covers."""
    rows = _cuts(motion)
    rows = rows[(rows > 0)]
    rows = rows[motion.move[rows - 1] == Move.CUT]
    cycle = (motion.time[-1] - motion.time[0]) / (len(motion.time) - 1)
    speed = np.linalg.norm(tcp[rows, :3, 3] - tcp[rows - 1, :3, 3], axis=1) / cycle
    last = len(toolpath) - 1
    lowest = np.clip(np.nan_to_num(np.ceil(motion.point[rows - 1])), 0, last).astype(int)
    highest = np.clip(np.nan_to_num(np.ceil(motion.point[rows])), 0, last).astype(int)
    feed = np.nan_to_num(toolpath.feed)
    ratio = np.array([v / max(feed[min(a, b) : max(a, b) + 1].max(), 1e-9)
                      for v, a, b in zip(speed, lowest, highest, strict=True)])  # fmt: skip
    return _worst("feed", "of the programmed feed", ratio, FEED, [_at(motion, n) for n in rows])


def _points(
    motion: Motion, toolpath: Toolpath, points: Points, stood: Points, arm: Arm, cell: Cell
) -> list[Check]:  # fmt: skip
    """points.csv: the tool is on its point (``stood``: true angles), the joints are the trajectory's there."""
    known = np.isfinite(points.q).all(axis=1)
    inside = (points.point >= 0) & (points.point < len(toolpath))
    complete = len(points.point) == len(toolpath) and bool(inside.all())
    checks = [Check("points.csv complete", complete, float(len(points.point)), float(len(toolpath)), "rows",
                    "one row a toolpath point")]  # fmt: skip
    rows = np.flatnonzero(known & inside)
    rows = rows[toolpath.cutting[points.point[rows]]]
    if cell.external_joints or not len(rows):
        return checks  # points.csv tells the external axes in columns of its own; the trajectory check holds
    tcp = arm.tcp_in_workpiece(stood.q[rows], np.zeros((len(rows), 0)))
    number = points.point[rows]
    wanted = toolpath.position[number] + (0.0 if points.shift is None else points.shift[rows])
    away = np.linalg.norm(tcp[:, :3, 3] - wanted, axis=1) * 1e3
    checks.append(_worst("points.csv on the toolpath", "mm", away, PATH_MM, [f"point {k}" for k in number]))
    cuts = _cuts(motion)
    off = []
    for row, k in zip(rows, number, strict=True):
        after = cuts[np.searchsorted(motion.point[cuts], k, side="left") :][:1]
        before = cuts[: np.searchsorted(motion.point[cuts], k, side="right")][-1:]
        around = np.concatenate([before, after])
        if len(around):
            low, high = motion.q[around].min(axis=0), motion.q[around].max(axis=0)
            off.append(float(np.degrees(np.maximum(low - points.q[row], points.q[row] - high).max())))
        else:
            off.append(np.nan)
    checks.append(_worst("points.csv as driven", "deg", np.array(off), JOINT_DEG, [f"point {k}" for k in number]))
    return checks


def _contacts(motion: Motion, cell: Cell, arm: Arm) -> Check:
    found = contacts(cell, arm, motion.q, motion.external, motion.move == Move.RAPID)
    text = "; ".join(f"{c.pair} first at {_at(motion, c.sample)}" for c in found[:5])
    return Check("contacts", not found, float(len(found)), 0.0, "pairs", text or "none")
