"""A reflector that does not sit where the record says, or two whose names are exchanged: a fault of the record.

Places are fitted in any case, so neither bends any physics; but what was written down is wrong, and is said.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Estimate, Finding
from machopt.diagnose.record.sessions import chance
from machopt.diagnose.resting.nominal_poses import First, Nominal
from machopt.domain.cell import Cell
from machopt.domain.location import column_at
from machopt.domain.recording import Recording, Target
from machopt.effects.record import COLUMNS
from machopt.model.robot import Masses, Robot

Flags = NDArray[np.bool_]
LOOSE = 1e3  # times the stated uncertainty: places that may be anything must not be held to what may be wrong


def mended(recording: Recording, cell: Cell, robot: Robot, masses: Masses | None) -> tuple[Recording, list[Finding]]:
    """Put right what ``targets_mm`` says of single reflectors, where the poses tell it.

    A plate that sits elsewhere as a whole is no such fault: that is what the fit of places is for.

    Args:
        recording: kind absolute, in base_link but for what is refitted.
        cell, robot, masses: the arm.
    """
    if len(recording.targets) < 2:
        return recording, []
    model = Nominal(recording, cell, robot, masses, frozenset())
    first = model.first_fit(LOOSE)
    far = calibrated.RECORD.misplaced * (recording.uncertainty.target or calibrated.RECORD.nest)
    found = first.target + np.array([t.place for t in recording.targets])  # (T, 3)
    pair = _exchanged(recording, first.target, found, far)
    if pair is not None:
        a, b = pair
        words = f"targets {recording.targets[a].name} and {recording.targets[b].name} are exchanged"
        targets = list(recording.targets)
        targets[a] = Target(targets[a].name, recording.targets[b].place)
        targets[b] = Target(targets[b].name, recording.targets[a].place)
        rows = np.isin(model.which, pair)
        return replace(recording, targets=tuple(targets)), [_said(model, first, rows, words, {}, words)]
    out, targets = [], list(recording.targets)
    for n in _wrong(first.target, far):
        off = 1e3 * first.target[n]
        name = recording.targets[n].name
        words = (
            f"target {name} sits ({', '.join(f'{v:.1f}' for v in off)}) mm from where targets_mm says, beyond the "
            "others; it was read at the place that the poses show"
        )
        sizes = {f"shift {a}": exact(float(v), "mm") for a, v in zip("xyz", off, strict=True)}
        x, y, z = (float(v) for v in found[n])
        targets[n] = Target(name, (x, y, z))
        out.append(_said(model, first, model.which == n, words, sizes, name))
    return replace(recording, targets=tuple(targets)), out


def _wrong(off: Array, far: float) -> list[int]:
    """Reflectors (T, 3) m that lie elsewhere than most of the others do; none where most would."""
    if len(off) == 2:
        apart = float(np.linalg.norm(off[1] - off[0]))
        return [int(np.argmax(np.linalg.norm(off, axis=1)))] if apart > far else []
    beyond = np.flatnonzero(np.linalg.norm(off - np.median(off, axis=0), axis=1) > far)
    return beyond.tolist() if 2 * len(beyond) < len(off) else []


def _exchanged(recording: Recording, off: Array, found: Array, far: float) -> tuple[int, int] | None:
    """Two reflectors each of which sits where the other should."""
    size = np.linalg.norm(off, axis=1)
    for a, b in combinations(range(len(off)), 2):
        there = found[a] - recording.targets[b].place, found[b] - recording.targets[a].place
        if min(size[a], size[b]) > far and max(np.linalg.norm(e) for e in there) < far:
            return a, b
    return None


def _said(model: Nominal, first: First, rows: Flags, words: str, sizes: dict[str, Estimate], name: str) -> Finding:
    nominal = replace(first, target=np.zeros_like(first.target))
    errors = []
    for each in (nominal, first):
        _, p, R = model.predict(each)
        errors.append(np.linalg.norm(model.residual(each, p, R)[rows, :3], axis=1))
    before, after = (float(np.median(e)) for e in errors)
    return repaired(
        COLUMNS.name,
        column_at("target"),
        words,
        1e3 * before,
        1e3 * after,
        chance(model.recording.pose[rows], *errors),
        sizes,
        stated={"message": words, "target": name},
    )
