"""Collisions of the chosen path, and what to forbid when there are some. Lazy: only what the choice needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.model.collision import CollisionModel
from machopt.plan.candidates import Candidates
from machopt.plan.choose import Choice
from machopt.plan.path import Path

Array = NDArray[np.float64]
STATIONS_PER_ROUND = 48  # colliding stations whose whole rotation row is checked before choosing again


@dataclass(frozen=True)
class PathCheck:
    """Contacts of one assignment at and between the planning points of each run."""

    hit: NDArray[np.bool_]  # (P,) at the point or on the way to it
    pair: NDArray[np.int32]  # (P,) index into the model's pairs, −1 where free

    @property
    def free(self) -> bool:
        return not bool(self.hit.any())


def check_path(path: Path, q: Array, model: CollisionModel, options: PlanOptions) -> PathCheck:
    """Check every stretch with a configuration, with a bounded joint step in between.

    Args:
        q: (P, 6) rad, NaN where there is none.
    """
    hit, pair = np.zeros(len(q), bool), np.full(len(q), -1, np.int32)
    known = np.asarray(np.isfinite(q).all(axis=1))
    touch = path.may_touch
    for first, last in path.runs:
        rows = np.arange(first, last + 1)[known[first : last + 1]]
        for stretch in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1):
            if len(stretch):
                contacts = model.check_motion(q[stretch], touch[stretch], options.collision_step)
                hit[stretch], pair[stretch] = contacts.hit, contacts.pair
    return PathCheck(hit, pair)


def forbid(path: Path, candidates: Candidates, choice: Choice, check: PathCheck, model: CollisionModel | None) -> int:
    """Mark colliding vertices at and around the stations that collide; changes ``candidates`` in place.

    Without a model the hits are points no configuration was found for; then only the chosen rotation goes.

    Returns:
        how many vertices were struck out (≥ 1 whenever something collides, so that choosing again ends).
    """
    st = path.stations
    stations = np.unique(np.clip(np.searchsorted(st, np.flatnonzero(check.hit)), 0, len(st) - 1))
    stations = stations[~choice.dropped[stations]]
    if len(stations) > STATIONS_PER_ROUND:
        stations = stations[np.unique(np.linspace(0, len(stations) - 1, STATIONS_PER_ROUND).round().astype(int))]
    before = int(candidates.feasible.sum())
    touch = path.may_touch
    for s in stations:
        b = choice.branch[s]
        struck = np.zeros(0, int)
        if model is not None:
            rotations = np.flatnonzero(candidates.feasible[s, :, b].any(axis=1))
            contacts = model.check(candidates.q[s, rotations, b], np.full(len(rotations), touch[st[s]]))
            struck = rotations[contacts.hit]
        if choice.rotation[s] not in struck:
            # free at the station but not on the way to it: this rotation and its neighbours are given up
            struck = np.union1d(struck, (choice.rotation[s] + np.arange(-1, 2)) % len(candidates.phi))
        candidates.feasible[s, struck, b] = False
        candidates.reason[s, struck, b] = Reason.COLLIDING if model is not None else Reason.NO_PATH
    return before - int(candidates.feasible.sum())
