"""What one session has that the others have not, at the very same poses: a tracker or reflector put down again, a zero.

Readings of one pose and reflector on two days differ by noise, and by what was moved in between. What the model lacks
cancels in the difference, so it needs no model to be seen; left in, it would count as noise, and hide everything.

Held against each other, by least absolute deviations: nothing, a frame (shift and turn), a reflector elsewhere in the
flange, one joint's encoder, and the growth of a warm arm. The last is physics and stays for the catalogue. A shift
alone may be either; where temperatures tell no difference the tracker is named, with the warmth beside it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Ints
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.reflectors import points, which
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Estimate, Finding
from machopt.diagnose.record.sessions import chance, equations, typical
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.effects.record import COLUMNS
from machopt.effects.sensor import DISPLACEMENT
from machopt.effects.thermal import THERMAL
from machopt.estimate.robust import start
from machopt.model.robot import Robot
from machopt.se3 import rotation_from_vector, skew

Flags = NDArray[np.bool_]
MOST_REPAIRS = 4  # sessions, and what they have


class _What(StrEnum):
    SHIFT = "shift"
    FRAME = "frame"
    HEAT = "heat"
    TARGET = "target"
    ENCODER = "encoder"


@dataclass(frozen=True)
class _Cause:
    """An explanation of what a session has for itself."""

    what: _What
    joint: int = -1  # 0-based, of an encoder

    @property
    def column(self) -> str:
        """Of the recording, for an encoder."""
        return f"q{self.joint + 1}_deg"

    @property
    def effect(self) -> tuple[str, str]:
        """What a finding calls it, and where."""
        if self.what is _What.ENCODER:
            return COLUMNS.name, column_at(self.column)
        return DISPLACEMENT.name, DISPLACEMENT.places[0]


SHIFT, FRAME, HEAT, TARGET = (_Cause(w) for w in (_What.SHIFT, _What.FRAME, _What.HEAT, _What.TARGET))


@dataclass(frozen=True, kw_only=True)
class _Differences:
    """Of one session from the others at the same poses and reflectors."""

    session: int
    d: Array  # (n, 3) m
    p: Array  # (n, 3) m, where
    R: Array  # (n, 3, 3) of the flange
    J: Array  # (n, 3, 6) m/rad
    pose: Ints
    rise: float  # K that the session was warmer; NaN where that is not known

    def columns(self) -> dict[_Cause, Array]:
        """(n, 3, P) of each explanation."""
        n = len(self.d)
        shift = np.broadcast_to(np.eye(3), (n, 3, 3))
        away = self.p - self.p.mean(axis=0)
        out = {
            SHIFT: shift,
            FRAME: np.concatenate([shift, -skew(away)], axis=2),
            HEAT: np.concatenate([shift, self.p[:, :, None]], axis=2),
            TARGET: self.R,
        }
        return out | {_Cause(_What.ENCODER, j): self.J[:, :, j : j + 1] for j in range(self.J.shape[2])}


@dataclass(frozen=True)
class _Taken:
    """What explains a session."""

    cause: _Cause
    x: Array
    of: _Differences
    left: Array  # (n, 3) m
    shift_alone: bool

    @property
    def worth(self) -> float:
        return typical(self.of.d) - typical(self.left)


def mended(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Take out what single sessions have for themselves; a frame that is fitted in any case becomes one of its own.

    Args:
        recording: kind absolute, in base_link but for what is refitted, its columns right.
        robot, T_flange_tcp: the arm.
        accept: effects that the user says are none.
    """
    out: list[Finding] = []
    if recording.position is None or len(np.unique(recording.session)) < 2:
        return recording, out
    for _ in range(MOST_REPAIRS):
        each = [_explained(d) for d in _differences(recording, robot, T_flange_tcp)]
        found = [t for t in each if t is not None and t.cause.effect[0] not in accept]
        if not found:
            break
        best = max(found, key=lambda t: t.worth)
        likely = [t for t in found if t.worth * calibrated.RECORD.moved_as_good > best.worth]
        read = [_put_right(recording, robot, T_flange_tcp, t) for t in likely]
        left = [_misfit(r, robot, T_flange_tcp) for r in read]
        # two sessions differ alike from each other: the model decides, or else it was the later one
        n = next(n for n, m in enumerate(left) if m < calibrated.RECORD.moved_as_good * min(left))
        recording = read[n]
        out.append(_said(likely[n]))
    return recording, out


def warmed(mended: Sequence[Finding], found: Sequence[Finding]) -> tuple[list[Finding], tuple[str, ...]]:
    """What was put right, without a shift that a drift which was found explains, too; and that in words.

    Args:
        mended: what was wrong with the record.
        found: in it, once that was put right.
    """
    drift = max((f.parameters["drift"].value for f in found if f.effect == THERMAL.name), default=0.0)
    kept, notes = [], []
    for f in mended:
        if (THERMAL.name, THERMAL.places[0]) in f.one_of and _shift(f) <= drift:
            notes.append(f"{f.note}: the drift that was found moves as much within a session, so no tracker is blamed")
        else:
            kept.append(f)
    return kept, tuple(notes)


def _shift(f: Finding) -> float:
    """mm of a frame that lay elsewhere."""
    return float(np.linalg.norm([f.parameters[f"shift {a}"].value for a in "xyz"]))


def _misfit(recording: Recording, robot: Robot, T: Array) -> float:
    whole = equations(recording, robot, T)
    return typical(whole.error(whole.fit()))


def _differences(recording: Recording, robot: Robot, T: Array) -> list[_Differences]:
    """Last session first."""
    p, R = points(recording, robot, T)
    whole = equations(recording, robot, T)
    e = whole.error(whole.fit())
    J = robot.state(recording.q, T).J
    beside = p - robot.fk(recording.q, T)[:, :3, 3]
    J = J[:, :3] + np.swapaxes(np.cross(np.swapaxes(J[:, 3:], 1, 2), beside[:, None]), 1, 2)
    kind = _kinds(recording)
    out = []
    for name in np.unique(recording.session)[::-1]:
        own = recording.session == name
        both = np.intersect1d(kind[own], kind[~own])
        rows = own & np.isin(kind, both)
        if len(np.unique(recording.pose[rows])) < calibrated.RECORD.part_readings:
            continue
        first = np.array([np.flatnonzero(rows & (kind == k))[0] for k in both])
        d = _mean(e, kind, rows, both) - _mean(e, kind, ~own, both)
        rise = np.nan
        if recording.temperature is not None:
            rise = float(np.mean(recording.temperature[own]) - np.mean(recording.temperature[~own]))
        out.append(
            _Differences(
                session=int(name), d=d, p=p[first], R=R[first], J=J[first], pose=recording.pose[first], rise=rise
            )
        )
    return out


def _kinds(recording: Recording) -> Ints:
    """(N,) readings of one pose, reflector and load have the same number."""
    key = [recording.pose.astype(float), which(recording).astype(float)]
    if recording.wrench is not None and recording.wrench.any():
        size = [max(float(np.abs(recording.wrench[:, a : a + 3]).max()), 1e-9) for a in (0, 3)]
        steps = recording.wrench / (calibrated.RECORD.same_force * np.repeat(size, 3))
        key += list(np.round(steps).T)
    return np.unique(np.stack(key, axis=1), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _mean(e: Array, kind: Ints, rows: Flags, of: Ints) -> Array:
    """(n, 3) of the rows of each kind; NaN never, since every kind has one."""
    at = np.searchsorted(of, kind[rows & np.isin(kind, of)])
    values = e[rows & np.isin(kind, of)]
    count = np.bincount(at, minlength=len(of))
    return np.stack([np.bincount(at, v, len(of)) / count for v in values.T], axis=1)


def _explained(of: _Differences) -> _Taken | None:
    """The explanation that leaves least for what it takes; None: noise, or what the catalogue is for."""
    limits = calibrated.RECORD
    load, left, x = np.ones(len(of.d)), {}, {}
    for cause, A in of.columns().items():
        x[cause] = start(A, of.d, load)
        e = of.d - A @ x[cause]
        left[cause] = e, float(np.abs(e).mean()) * e.size / max(e.size - A.shape[2], 1)
    plain = float(np.abs(of.d).mean())
    single = min((c for c in left if c.what is _What.ENCODER), key=lambda c: left[c][1])
    order = [single, SHIFT, TARGET, FRAME]  # fewest numbers first
    best = min(order, key=lambda c: left[c][1])
    best = next(c for c in order if left[c][1] < limits.moved_as_good * left[best][1])
    if left[best][1] > limits.moved_falls * plain:
        return None
    warm = left[HEAT][1] < limits.moved_as_good * left[best][1]
    shift_alone = best == SHIFT
    if warm and (not shift_alone or abs(of.rise) > limits.moved_warmer):
        return None
    taken = FRAME if shift_alone else best
    return _Taken(taken, x[taken], of, left[best][0], shift_alone)


def _put_right(recording: Recording, robot: Robot, T: Array, t: _Taken) -> Recording:
    rows = recording.session == t.of.session
    assert recording.position is not None  # mended looks for it
    if t.cause.what is _What.ENCODER:
        q = recording.q.copy()
        q[rows, t.cause.joint] += t.x[0]  # d = J x: the joint stood further by x than it says
        return replace(recording, q=q)
    position = recording.position.copy()
    if t.cause == TARGET:
        _, R = points(recording, robot, T)
        position[rows] -= R[rows] @ t.x
        return replace(recording, position=position)
    if recording.registration == "fit":  # fitted with everything else
        return replace(recording, frame=_own_frame(recording, rows))
    middle = t.of.p.mean(axis=0)
    turn = rotation_from_vector(t.x[3:])
    position[rows] = (position[rows] - middle - t.x[:3]) @ turn + middle
    return replace(recording, position=position)


def _own_frame(recording: Recording, rows: Flags) -> Ints:
    """(N,) labels of stands, of ``rows`` others than of the rest."""
    of = recording.session if recording.frame is None else recording.frame
    old = np.full(len(rows), int(of[~rows].min())) if recording.frame is None else recording.frame
    new = int(of[rows].min()) if recording.frame is None else int(old.max()) + 1
    return np.where(rows, new, old).astype(np.int64)


def _said(t: _Taken) -> Finding:
    effect, where = t.cause.effect
    sizes: Mapping[str, Estimate]
    if t.cause.what is _What.ENCODER:
        off = float(np.degrees(t.x[0]))
        what = f"{t.cause.column} reads {abs(off):.4f}° too {'little' if off > 0 else 'much'}"
        sizes = {"offset": exact(-off, "deg")}
    elif t.cause == TARGET:
        at = 1e3 * t.x
        what = f"the reflector sat ({_three(at)}) mm in the flange from where it sat in the other sessions"
        sizes = {f"shift {a}": exact(float(v), "mm") for a, v in zip("xyz", at, strict=True)}
    else:
        shift, turn = 1e3 * t.x[:3], 1e3 * t.x[3:]
        what = (
            f"the tracker's frame lies ({_three(shift)}) mm about the middle of the points and ({_three(turn)}) mrad "
            "from where it lay in the other sessions"
        )
        sizes = {
            "angle": exact(float(np.degrees(np.linalg.norm(t.x[3:]))), "deg"),
            **{f"shift {a}": exact(float(v), "mm") for a, v in zip("xyz", shift, strict=True)},
        }
    words = (
        f"session {t.of.session}: {what}, by the poses that they share; "
        "it was read that way, and no physics or noise made of it"
    )
    if t.shift_alone:
        words += "; a base that is warmer would look the same"
    before, after = (np.linalg.norm(v, axis=1) for v in (t.of.d, t.left))
    finding = repaired(
        effect,
        where,
        words,
        1e3 * typical(t.of.d),
        1e3 * typical(t.left),
        chance(t.of.pose, before, after),
        {**sizes, "session": exact(float(t.of.session))},
        stated={"message": words, "session": t.of.session},
    )
    warmth = ((THERMAL.name, THERMAL.places[0]),) if t.shift_alone else ()
    return replace(finding, one_of=(*finding.one_of, *warmth))


def _three(values: Array) -> str:
    return ", ".join(f"{v:.3f}" for v in values)
