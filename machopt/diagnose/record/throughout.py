"""Signs, axes, joints and rows that are exchanged in the whole record: no session is there to say so, only the model.

Taken where one way to read the columns leaves far less than the stated one, and no other way does nearly as well.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.reflectors import registered
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Finding
from machopt.diagnose.record.rewritten import Way, turning_units, ways
from machopt.diagnose.record.sessions import Equations, chance, equations, typical
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.effects.record import COLUMNS, UNITS
from machopt.model.robot import Robot


def mended(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Read the columns of a whole record otherwise where that is sure; at most one such fault.

    Args:
        recording: kind deflection or absolute; units, frames and single sessions mended.
        robot, T_flange_tcp: the arm.
        accept: effects that the user says are none.
    """
    if "columns" in accept or (recording.kind == "absolute" and recording.position is None):
        return recording, []
    stated = equations(registered(recording, robot, T_flange_tcp), robot, T_flange_tcp)
    before = _error(stated)
    left = _share(stated, before)
    gate = calibrated.RECORD.whole_off if recording.kind == "deflection" else calibrated.RECORD.whole_pose_off
    if left < gate:
        return recording, []
    found: list[tuple[float, int, Way, Recording, Array]] = []
    for way in _ways(recording):
        changed = way.read(recording)
        now = equations(registered(changed, robot, T_flange_tcp), robot, T_flange_tcp)
        after = _error(now)
        if _share(now, after) < calibrated.RECORD.whole_falls * left:
            found.append((_share(now, after), len(found), way, changed, after))
    if not found:
        return recording, []
    least, _, way, changed, after = min(found, key=lambda f: f[:2])
    if typical(after) > calibrated.RECORD.whole_falls * typical(before):
        return recording, []
    as_good = [f for f in found if f[0] < calibrated.RECORD.part_as_good * least]
    if recording.registration == "fit" and {f[2].column for f in as_good} == {"x_mm"}:
        _, _, way, changed, after = as_good[0]  # a free frame: every mirror is the same one, turned
    elif len(as_good) > 1:  # which of them it is cannot be told: nothing is mended on a guess
        return recording, []
    return changed, [_said(way, least / left, stated, before, after)]


def moments(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Moments that are in another unit in every row, while forces are not.

    Numbers so small that a force sensor's uncertainty swallows them would count as noise, and what they do as a lever.
    Held against a model of the moments as stated and of none.

    Args:
        recording: kind deflection, single sessions mended.
        robot, T_flange_tcp: the arm.
        accept: effects that the user says are none.
    """
    if UNITS.name in accept or recording.wrench is None or not recording.wrench[:, 3:].any():
        return recording, []
    stated = equations(recording, robot, T_flange_tcp)
    if not stated.wrench[:, :3].any() or not stated.y.any() or len(recording) < calibrated.RECORD.part_readings:
        return recording, []
    before = _error(stated)
    left = _share(stated, before)
    silent = recording.wrench.copy()
    silent[:, 3:] = 0.0
    without = equations(replace(recording, wrench=silent), robot, T_flange_tcp)
    least = min(left, _share(without, _error(without)))
    found = []
    for way in turning_units():
        changed = way.read(recording)
        now = equations(changed, robot, T_flange_tcp)
        after = _error(now)
        found.append((_share(now, after), way, changed, after))
    found.sort(key=lambda f: f[0])
    (best, way, changed, after), (second, *_) = found[:2]
    if best > calibrated.RECORD.whole_falls * least or second < calibrated.RECORD.part_as_good * best:
        return recording, []
    return changed, [_said(way, best / left, stated, before, after)]


def _said(way: Way, share: float, stated: Equations, before: Array, after: Array) -> Finding:
    """The finding of columns read otherwise, which leave a ``share`` of what they left; errors (N, 3) m."""
    return repaired(
        way.effect,
        column_at(way.column),
        f"{way.words}, in the whole record: so read the model leaves {100 * share:.2g} % of what it left",
        1e3 * typical(before),
        1e3 * typical(after),
        chance(stated.pose, *(np.linalg.norm(e, axis=1) for e in (before, after))),
        {"factor": exact(1.0 / way.factor)} if way.factor != 1.0 else {},
    )


def _ways(recording: Recording) -> Iterator[Way]:
    """Without units, which have their own check, and without what turns the load as a whole."""
    for way in ways(recording):
        if way.effect == COLUMNS.name:
            yield way
    n = recording.q.shape[1]
    for a, b in combinations(range(n), 2):
        yield Way(
            effect=COLUMNS.name,
            column=f"q{a + 1}_deg",
            words=f"q{a + 1}_deg and q{b + 1}_deg are exchanged",
            read=lambda r, a=a, b=b: _exchanged(r, a, b),  # type: ignore[misc]
        )


def _exchanged(r: Recording, a: int, b: int) -> Recording:
    q = r.q.copy()
    q[:, [a, b]] = q[:, [b, a]]
    return replace(r, q=q)


def _error(e: Equations) -> Array:
    return e.error(e.fit())


def _share(e: Equations, error: Array) -> float:
    return float(np.abs(error).sum() / max(e.size.sum(), 1e-300))
