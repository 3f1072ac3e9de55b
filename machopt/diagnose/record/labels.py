"""One weight that is not what is stamped on it: loads of one size read otherwise than all others at the same poses.

Springs bend in proportion, gears that do not bend more or less with their torque, which is another at every pose. A
size of load whose readings alone are off by the same share at every pose, with larger and smaller ones on either side
of it that agree, is none of that. Nor is one that is off in one session, and put right becomes a size that another
session has. Left in, its rows would pass for gross errors.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Ints
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.noise import robust_sigma
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Finding
from machopt.diagnose.record.shares import gain, predicted
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.effects.record import COLUMNS
from machopt.estimate.experiment import Experiment, experiment
from machopt.model.robot import Robot

Flags = NDArray[np.bool_]
MOST = 4  # labels of one record


@dataclass(frozen=True, kw_only=True)
class _Size:
    """Loads of one size in one session."""

    session: int
    force: float  # N, as recorded
    rows: Flags
    each: Array  # (K,) by pose, what its forces read per what the arm did, per the middle one of all sizes there

    @property
    def factor(self) -> float:
        return float(np.median(self.each))

    @property
    def spread(self) -> float:
        return robust_sigma(self.each - self.factor)


def mended(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Read the loads of such sizes as the others say.

    Args:
        recording: load tests, its units and axes right.
        robot, T_flange_tcp: the arm.
        accept: effects that the user says are none.

    Returns:
        the recording (itself where nothing is wrong), a finding for each size.
    """
    out: list[Finding] = []
    if recording.kind != "deflection" or recording.wrench is None or COLUMNS.name in accept:
        return recording, out
    for _ in range(MOST):
        found = _wrong(experiment(recording, robot, T_flange_tcp))
        if found is None:
            break
        out.append(_said(found, len(np.unique(recording.session)) > 1))
        wrench = recording.wrench.copy()
        wrench[found.rows] /= found.factor
        recording = replace(recording, wrench=wrench)
    return recording, out


def _wrong(tests: Experiment) -> _Size | None:
    """The size that is off by most and by nothing that an arm does; None: there is none."""
    every = _sizes(tests)
    odd = [s for s in every if _off(s) and _alone(s, every) and (_between(s, every) or _elsewhere(s, every))]
    return max(odd, key=lambda s: abs(np.log(s.factor)), default=None)


def _off(s: _Size) -> bool:
    least = calibrated.RECORD.gain_far * max(calibrated.RESTING.force_gain, s.spread / np.sqrt(len(s.each)))
    alike = np.mean(np.sign(np.log(s.each)) == np.sign(np.log(s.factor))) >= calibrated.RECORD.label_alike
    return abs(s.factor - 1.0) > least and bool(alike)


def _alone(s: _Size, every: list[_Size]) -> bool:
    """Whether the other sizes of its session agree: their shares are of one another and of this one."""
    others = [o for o in every if o.session == s.session and o is not s]
    most = calibrated.RECORD.label_others * abs(np.log(s.factor))
    return len(others) + 1 >= calibrated.RECORD.label_sizes and all(abs(np.log(o.factor)) < most for o in others)


def _between(s: _Size, every: list[_Size]) -> bool:
    """Whether its session has smaller and larger loads: what grows with the load would show in either of them too."""
    others = [o.force for o in every if o.session == s.session and o is not s]
    return min(others) < s.force < max(others)


def _elsewhere(s: _Size, every: list[_Size]) -> bool:
    """Whether another session has loads of the size that this is, which agree with its others."""
    return any(
        o.session != s.session
        and not _off(o)
        and abs(np.log(o.force * s.factor / s.force)) < calibrated.RECORD.label_same
        for o in every
    )


def _sizes(tests: Experiment) -> list[_Size]:
    """Of all sessions whose loads come in a few sizes."""
    force = np.linalg.norm(tests.wrench[:, :3], axis=1)
    by_springs = predicted(tests)
    read, moved = np.sum(by_springs**2, axis=1), np.sum(by_springs * tests.measured[:, :3], axis=1)
    out = []
    for session in np.unique(tests.session).tolist():
        own = tests.session == session
        label = _labels(force[own])
        if label is None:
            continue
        size = np.full(len(force), -1)
        size[own] = label
        share = _shares(tests.pose[own], label, read[own], moved[own])
        for k in range(int(label.max()) + 1):
            each = share[k][np.isfinite(share[k])]
            if len(each) < calibrated.RECORD.label_poses:
                continue
            rows = own.copy()
            rows[own] = label == k
            out.append(_Size(session=session, force=float(np.median(force[rows])), rows=rows, each=each))
    return out


def _labels(force: Array) -> Ints | None:
    """(N,) the size of each load, from 0; None where they do not come in a few."""
    order = np.argsort(force)
    if force[order[-1]] <= 0.0:
        return None
    step = np.diff(force[order]) > calibrated.RECORD.label_gap * force[order[-1]]
    label = np.empty(len(force), np.int64)
    label[order] = np.concatenate([[0], np.cumsum(step)])
    wide = [np.ptp(force[label == k]) for k in range(int(label.max()) + 1)]
    return label if max(wide) < calibrated.RECORD.label_wide * force[order[-1]] else None


def _shares(pose: Ints, label: Ints, read: Array, moved: Array) -> Array:
    """(sizes, poses) what forces of each size read per what the arm did, per the middle one of the pose's sizes."""
    _, at = np.unique(pose, return_inverse=True)
    poses, sizes = int(at.max()) + 1, int(label.max()) + 1
    cell = label * poses + at.reshape(-1)
    above, below = (np.bincount(cell, v, sizes * poses).reshape(sizes, poses) for v in (read, moved))
    out = np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.nan)
    out[:, np.isfinite(out).sum(axis=0) < calibrated.RECORD.label_sizes] = np.nan
    some = np.isfinite(out).any(axis=0)
    out[:, some] /= np.nanmedian(out[:, some], axis=0)
    return np.asarray(out)


def _said(s: _Size, several: bool) -> Finding:
    found, p_value = gain(s.each, s.factor, s.spread)
    over = found.value
    words = (
        (f"session {s.session}: " if several else "")
        + f"loads recorded as about {s.force:.4g} N read {abs(over):.3g} % too {'much' if over > 0 else 'little'} for "
        f"what the arm does under them, at every pose alike, and larger and smaller ones do not: a weight with a wrong "
        f"label; they were read as {s.force / s.factor:.4g} N"
    )
    session = {"session": exact(float(s.session))} if several else {}
    return repaired(
        COLUMNS.name,
        column_at("fx_N"),
        words,
        float("nan"),
        float("nan"),
        p_value,
        {
            "gain": found,
            "force": exact(s.force, "N"),
            **session,
        },
        beside=(column_at("fy_N"), column_at("fz_N")),
        stated={"message": words, "force_N": s.force} | ({"session": s.session} if several else {}),
    )
