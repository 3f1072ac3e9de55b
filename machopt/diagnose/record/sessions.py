"""A fault of one session, or of one pose, is not physics: each is held against the others, and mended where sure.

What the others say of a part of the record: springs ≥ 0 (load tests) or forward kinematics with a tracker frame
(poses), by least absolute deviations, plus what the very same pose and load left there (replicates), so that physics
the model lacks does not count. The ways a part may have been written otherwise: :mod:`.rewritten`.
One is taken only where the misfit falls by a wide margin, down to the level of the others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.reflectors import nuisance, points
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Finding
from machopt.diagnose.record.rewritten import Way, put, taken, ways
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.estimate.experiment import experiment
from machopt.estimate.robust import start
from machopt.identify.rivals import bounded_absolute
from machopt.model.robot import Robot

Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]
MOST_REPAIRS = 4  # parts of one record


@dataclass(frozen=True, kw_only=True)
class Equations:
    """What a model that is linear in few unknowns says of N translations; base_link axes, SI."""

    y: Array  # (N, 3) m
    A: Array  # (N, 3, P)
    load: Array  # (N,) size of what drives each reading
    wrench: Array  # (N, 6) N, N·m; zeros where none is recorded
    size: Array  # (N,) m, what a misfit of the whole is counted per
    pose: Ints  # (N,)
    springs: bool  # the unknowns are compliances, ≥ 0

    def fit(self) -> Array:
        """(P,) by least absolute deviations."""
        if self.springs:
            return bounded_absolute(self.A, self.y, self.load)
        out, seen = np.zeros(self.A.shape[2]), self.A.any(axis=(0, 1))  # not a frame that no reading is in
        if seen.any():
            out[seen] = start(self.A[:, :, seen], self.y, self.load)
        return out

    def error(self, x: Array) -> Array:
        """(N, 3) m."""
        return np.asarray(self.y - self.A @ x)


@dataclass(frozen=True, kw_only=True)
class _Repair:
    part: int  # label
    way: Way
    recording: Recording  # the whole one, mended
    before: float  # m, median misfit of the part
    after: float
    left: float  # unexplained share of the whole record
    twins: float  # share of the part's readings that have a replicate elsewhere, mended
    far: float  # |log| of the arm's compliance per the cell's
    p_value: float


def mended(
    recording: Recording, robot: Robot, T_flange_tcp: Array, prior: Array | None, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Mend sessions, then poses (of load tests), that were written otherwise than the rest.

    Args:
        recording: kind deflection or absolute, as read.
        robot, T_flange_tcp: the arm.
        prior: (6,) N·m/rad of the cell; None where it has none. It decides only which of two sessions is the odd one.
        accept: effects ("units", "columns") that the user says are none.

    Returns:
        the recording as it should have been (itself where nothing is wrong), a finding per repair.
    """
    out: list[Finding] = []
    if recording.kind == "absolute" and recording.position is None:
        return recording, out
    if recording.kind == "deflection" and (recording.wrench is None or recording.displacement is None):
        return recording, out
    if recording.kind == "deflection" and not (np.any(recording.wrench) and np.any(recording.displacement)):
        return recording, out  # says nothing, which is refused where it is looked at
    _, session = np.unique(recording.session, return_inverse=True)
    levels: list[tuple[str, Ints, Ints]] = [("session", session.reshape(-1).astype(np.int64), recording.session)]
    if recording.kind == "deflection":
        _, pose = np.unique(recording.pose, return_inverse=True)
        levels.append(("pose", pose.reshape(-1).astype(np.int64), recording.pose))
    for level, label, name in levels:
        if level == "pose" and label.max() + 1 < calibrated.RECORD.poses_to_compare:
            continue
        for _ in range(MOST_REPAIRS):
            best = _best(
                [r for r in _repairs(recording, robot, T_flange_tcp, prior, label, level) if r.way.effect not in accept]
            )
            if best is None:
                break
            recording = best.recording
            out += [_said(best, way, level, int(name[label == best.part][0])) for way in (best.way, *best.way.beside)]
    return recording, out


def equations(recording: Recording, robot: Robot, T_flange_tcp: Array) -> Equations:
    """Of a recording or a part of it."""
    if recording.kind == "deflection":
        tests = experiment(recording, robot, T_flange_tcp)
        w, y = tests.wrench, tests.measured[:, :3]
        load = np.linalg.norm(w[:, :3], axis=1) + np.linalg.norm(w[:, 3:], axis=1)
        return Equations(
            y=y,
            A=tests.response()[:, :3],
            load=load,
            wrench=w,
            size=np.abs(y).sum(axis=1),
            pose=recording.pose,
            springs=True,
        )
    assert recording.position is not None  # mended checks it
    p, R = points(recording, robot, T_flange_tcp)
    A = nuisance(recording, p, R)
    w = np.zeros((len(p), 6)) if recording.wrench is None else recording.wrench
    return Equations(
        y=recording.position - p,
        A=A,
        load=np.ones(len(p)),
        wrench=w,
        size=np.abs(p).sum(axis=1),
        pose=recording.pose,
        springs=False,
    )


def _repairs(
    recording: Recording, robot: Robot, T: Array, prior: Array | None, label: Ints, level: str
) -> Iterable[_Repair]:
    """Every way that puts one part right, part by part."""
    limits = calibrated.RECORD
    whole = equations(recording, robot, T)
    parts = int(label.max()) + 1
    sigma = recording.uncertainty.displacement or 0.0
    for k in range(parts):
        rows = label == k
        if parts < 2 or rows.sum() < limits.part_readings:
            continue
        others = _rows(whole, ~rows)
        x = others.fit()
        rest = others.error(x)
        level_of_others = max(typical(rest), sigma)
        known = others, rest, level == "session"
        seen, _ = _misfit(_rows(whole, rows), x, *known)
        before = typical(seen)
        if before < limits.part_stands_out * level_of_others:
            continue
        part = taken(recording, rows)
        falls = limits.session_falls if level == "session" else limits.pose_falls
        for way in ways(part):
            changed = way.read(part)
            whole_again = put(recording, changed, rows)
            now = (
                equations(changed, robot, T)
                if recording.kind == "deflection"
                else _rows(equations(whole_again, robot, T), rows)  # with the frames and reflectors of the others too
            )
            e, twins = _misfit(now, x, *known)
            after = typical(e) * way.scale
            if after > falls * before or typical(e) > limits.part_level * level_of_others:
                continue
            every = equations(whole_again, robot, T)
            left = _left(every, label)
            if left > limits.session_falls**0.5 * _left(whole, label):
                continue
            by_chance = chance(now.pose, np.linalg.norm(seen, axis=1), np.linalg.norm(e, axis=1) * way.scale)
            yield _Repair(
                part=k,
                way=way,
                recording=whole_again,
                before=before,
                after=after,
                left=left,
                twins=twins,
                far=_far(every, prior),
                p_value=by_chance,
            )


def _best(found: list[_Repair]) -> _Repair | None:
    """The least misfit of the whole; among equals the one whose loads repeat others, then the one nearest the cell."""
    if not found:
        return None
    least = min(r.left for r in found)
    near = [r for r in found if r.left <= calibrated.RECORD.part_as_good * least]
    return min(near, key=lambda r: (-round(r.twins, 1), round(r.far, 1), r.left))


def _misfit(part: Equations, x: Array, others: Equations, rest: Array, replicates: bool) -> tuple[Array, float]:
    """(n, 3) m, how far a part is from what the others say, and the share of its readings that repeat one of them."""
    e, twins = part.error(x), 0
    if not replicates:
        return e, 0.0
    for pose in np.unique(part.pose):
        here, there = np.flatnonzero(part.pose == pose), np.flatnonzero(others.pose == pose)
        if not len(there):
            continue
        a, b = part.wrench[here, :3], others.wrench[there, :3]
        apart = np.linalg.norm(a[:, None] - b[None], axis=2)
        near = apart <= calibrated.RECORD.same_force * np.linalg.norm(b, axis=1).max()
        count = near.sum(axis=1)
        has = count > 0
        mean = (near[has].astype(float) @ rest[there]) / count[has, None]
        e[here[has]] -= mean
        twins += int(has.sum())
    return e, twins / max(len(e), 1)


def _left(whole: Equations, label: Ints) -> float:
    """Unexplained share of the whole record, every part counting the same."""
    e = np.abs(whole.error(whole.fit())).sum(axis=1)
    n = int(label.max()) + 1
    return float(np.mean(np.bincount(label, e, n) / np.maximum(np.bincount(label, whole.size, n), 1e-300)))


def _far(whole: Equations, prior: Array | None) -> float:
    if prior is None or not whole.springs:
        return 0.0
    predicted = whole.A @ (1.0 / prior)
    ratio = float(start(predicted[:, :, None], whole.y, whole.load)[0])
    return abs(float(np.log(max(ratio, 1e-12))))


def _rows(e: Equations, rows: Flags) -> Equations:
    return replace(
        e, y=e.y[rows], A=e.A[rows], load=e.load[rows], wrench=e.wrench[rows], size=e.size[rows], pose=e.pose[rows]
    )


def typical(e: Array) -> float:
    """Median size of (N, 3) errors."""
    return float(np.median(np.linalg.norm(e, axis=1)))


def chance(pose: Ints, before: Array, after: Array) -> float:
    """That so many poses come nearer by accident: a sign test."""
    each = [np.median(after[pose == g]) < np.median(before[pose == g]) for g in np.unique(pose)]
    better = int(np.sum(each))
    return float(bdtrc(better - 1, len(each), 0.5)) if better > 0 else 1.0


def _said(r: _Repair, way: Way, level: str, name: int) -> Finding:
    words = f"{level} {name}: {way.words}; the other {level}s say so, and it was read that way"
    factor = {"factor": exact(1.0 / way.factor)} if way.factor != 1.0 else {}
    return repaired(
        way.effect,
        column_at(way.column),
        words,
        1e3 * r.before,
        1e3 * r.after,
        r.p_value,
        {**factor, level: exact(float(name))},
        stated={"message": words, level: name},
    )
