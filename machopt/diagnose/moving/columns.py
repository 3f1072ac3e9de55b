"""Torque channels of a motion that stand under another joint's name, or are of one motor before its gear.

Both leave a torque that no arm has: it follows the rigid body of another joint, or is a small share of its own. What a
balancer, a payload or friction does to a joint leaves it its own inertia, and no second joint that fits as well.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.moving.checks import by_stretch, column, sign_test, slope
from machopt.diagnose.moving.friction import rest_of
from machopt.diagnose.nouns.motion_signals import Motion
from machopt.diagnose.nouns.repaired import repaired
from machopt.diagnose.nouns.result import Finding
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.effects.record import COLUMNS
from machopt.errors import InputError


def mended(recording: Recording, motion: Motion, predicted: Array) -> tuple[Recording, list[Finding]]:
    """Exchange torque channels that were recorded under each other's names.

    Args:
        recording: of kind motion.
        motion: its signals.
        predicted: (M, n) N·m that the rigid arm needs.

    Raises:
        InputError: one torque is of the motor before its gear, whose ratio nothing says.
    """
    if recording.torque is None:
        return recording, []
    out: list[Finding] = []
    for i, j in combinations(range(predicted.shape[1]), 2):
        tau = recording.torque[motion.index, : predicted.shape[1]]
        stated = [_left(motion, tau, predicted, a, a) for a in (i, j)]
        other = [_left(motion, tau, predicted, a, b) for a, b in ((i, j), (j, i))]
        # each fits the other's name far better than its own, and each at about the size that the arm needs there
        falls = all(
            o is not None and s is not None and o[0] < calibrated.RECORD.whole_falls * s[0]
            for s, o in zip(stated, other, strict=True)
        )
        if not falls or not all(_whole(o[1]) for o in other if o is not None):
            continue
        torque = recording.torque.copy()
        torque[:, [i, j]] = torque[:, [j, i]]
        recording = replace(recording, torque=torque)
        out.append(_exchanged(recording, motion, tau, predicted, (i, j)))
    _refuse_motor_side(recording, motion, predicted)
    return recording, out


def _left(motion: Motion, tau: Array, predicted: Array, i: int, j: int) -> tuple[float, float, float] | None:
    """Share of channel i's variance that the rigid body of joint j leaves, friction refitted; slope and correlation.

    None where the joint needs too little for any answer.
    """
    if np.ptp(predicted[:, j]) < calibrated.RECORD.loaded * np.ptp(predicted, axis=0).max():
        return None
    v = motion.v[:, j]
    rubbing = np.stack([np.ones(len(v)), np.sign(v), v], axis=1)
    need, seen = (rest_of(x, rubbing)[0] for x in (predicted[:, j], tau[:, i]))
    s, r = slope(need, seen)
    return float(np.sum((seen - s * need) ** 2) / max(np.sum((tau[:, i] - tau[:, i].mean()) ** 2), 1e-300)), s, r


def _whole(s: float) -> bool:
    return 1.0 / calibrated.RECORD.alike_factor < s < calibrated.RECORD.alike_factor


def _exchanged(recording: Recording, motion: Motion, tau: Array, predicted: Array, of: tuple[int, int]) -> Finding:
    i, j = of
    now = tau.copy()
    now[:, [i, j]] = tau[:, [j, i]]
    before, after = (
        np.sqrt(np.mean([by_stretch(_off(x[:, k] - predicted[:, k])) ** 2 for k in of], axis=0)) for x in (tau, now)
    )
    one, two = (column(recording, "torque", k) for k in of)
    return repaired(
        COLUMNS.name,
        column_at(one),
        f"{one} and {two} stand under each other's names: each is what the other joint needs",
        float(np.median(before)),
        float(np.median(after)),
        sign_test(before, after),
        beside=(column_at(two),),
    )


def _refuse_motor_side(recording: Recording, motion: Motion, predicted: Array) -> None:
    """Raise where one joint's torque is a small share of what it needs and the others' is not."""
    assert recording.torque is not None  # the caller looked
    tau = recording.torque[motion.index, : predicted.shape[1]]
    each = {j: _left(motion, tau, predicted, j, j) for j in range(predicted.shape[1])}
    slopes = {j: x[1] for j, x in each.items() if x is not None and x[2] > calibrated.RECORD.slope_sure}
    whole = [j for j, s in slopes.items() if _whole(s)]
    small = [
        j
        for j, s in slopes.items()
        if 0.0 < s < calibrated.RECORD.geared
        and np.ptp(tau[:, j]) < calibrated.RECORD.motor_side * np.ptp(predicted[:, j])
    ]
    if small and len(whole) >= len(small):
        j = small[0]
        raise InputError(
            f"{recording.source}: {column(recording, 'torque', j)} is {100 * slopes[j]:.2g} % of what the arm needs "
            f"there, and the torque of joints {', '.join(str(k + 1) for k in whole)} is whole: torque of the motor "
            f"before its gear, of about 1:{1 / slopes[j]:.0f}? Torque at the joint (times the gear ratio) would work"
        )


def _off(x: Array) -> Array:
    return np.asarray(x - np.median(x))
