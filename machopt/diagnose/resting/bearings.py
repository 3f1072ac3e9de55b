"""A bearing that tilts across its joint's axis: no word of the catalogue means it, so a load test never names it.

The catalogue's joints turn about their axes, and its bodies give way between bearings. A main bearing that gives way
across the axis looks like a base or a link a little way off, and one with play like backlash of a joint that is not
loose at all. It tilts by the moment that it bears across its axis, weight included: in proportion to it where it is
seated, or freely, up to where it seats.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.at_body import weight_wrench
from machopt.diagnose.nouns.problem import Hypothesis, Shape
from machopt.diagnose.nouns.readings import Readings
from machopt.diagnose.search.unnamed import law
from machopt.domain.location import joint_at

TILTS, ROCKS = "tilts across its axis", "tilts across its axis until it seats"
BORNE = 3  # joints whose bearings are looked at: those of the wrist are short
SEATS = (0.05, 0.1, 0.2, 0.4)  # of the largest moment of the load
WAYS: Shape = tuple(np.radians(np.arange(0.0, 180.0, 30.0)).tolist())  # rad, of the axis that it tilts about
ANY = -1.0  # it tilts wherever the moment points


@dataclass(frozen=True)
class _Bearing:
    """What one bearing bears, base_link axes, SI; two ways across it turn with the arm before or behind the joint."""

    lever: Array  # (N, 3) from the joint to the TCP
    load: Array  # (N, 3) N·m of the recorded load
    weight: Array  # (N, 3) N·m of all that it carries
    across: Array  # (N, 2, 3)

    def lifted(self, turn: Array) -> Array:
        """(N, 6) m, rad at the TCP of a turn (N, 3)."""
        return np.concatenate([np.cross(turn, self.lever), turn], axis=1)


def hypotheses(r: Readings) -> list[Hypothesis]:
    """Forms of the bearings of the first joints.

    Args:
        r: the readings of a load test.
    """
    out = []
    for j in range(BORNE):
        behind, before = _bearing(r, j, j + 1), _bearing(r, j, j)
        out += [_tilts(r, j, b) for b in (before, behind)]
        out += [_rocks(r, j, before, ways=(ANY, *WAYS)), _rocks(r, j, behind, ways=WAYS)]
    return out


def _bearing(r: Readings, j: int, body: int) -> _Bearing:
    """Of joint ``j``, from 0, its ways across fixed in a body."""
    state = r.state
    assert state.R_bodies is not None  # readings come with bodies
    assert state.p_bodies is not None
    at = state.R_bodies[:, j] @ r.robot.point[j] + state.p_bodies[:, j]
    z, lever = state.J[:, 3:, j], state.T_base_tool[:, :3, 3] - at

    def moment(wrench: Array) -> Array:
        return np.asarray(wrench[:, 3:] + np.cross(lever, wrench[:, :3]))

    carried = np.zeros((len(r), 6)) if r.masses is None else weight_wrench(r, r.masses.body >= j + 1)
    R = state.R_bodies[:, body]
    axis = R[0].T @ z[0]  # the same in every posture
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    across = np.stack([R @ u, R @ np.cross(axis, u)], axis=1)
    return _Bearing(lever, moment(r.wrench), moment(carried), across)


def _tilts(r: Readings, j: int, bearing: _Bearing) -> Hypothesis:
    """A seat that gives way in proportion, otherwise one way than another: three numbers of a symmetric matrix."""
    about = np.einsum("nwc,nc->nw", bearing.across, bearing.load)
    pairs = list(combinations_with_replacement(range(2), 2))
    turns = [
        (bearing.across[:, a] * about[:, b, None] + bearing.across[:, b] * about[:, a, None]) / (2.0 if a == b else 1.0)
        for a, b in pairs
    ]
    columns = r.seen(np.stack([bearing.lifted(t) for t in turns], axis=2), j + 1)
    return _form(j, TILTS, lambda shape: columns, ((),))


def _rocks(r: Readings, j: int, bearing: _Bearing, ways: Shape) -> Hypothesis:
    """Play, used up by a share of the largest moment: about one axis across the joint's, or about any."""
    moment = np.linalg.norm(_across(bearing, bearing.load), axis=1)
    largest = float(np.quantile(moment, 1.0 - calibrated.RESTING.rare))

    def columns(shape: Shape) -> Array:
        seat, way = shape
        keep = _any if way == ANY else _about(bearing, way)
        there, loaded = keep(_across(bearing, bearing.weight)), keep(_across(bearing, bearing.weight + bearing.load))
        turn = _seated(loaded, seat * largest) - _seated(there, seat * largest)
        return np.asarray(r.seen(bearing.lifted(turn), j + 1)[:, :, None])

    return _form(j, ROCKS, columns, tuple((s, w) for w in ways for s in SEATS) if largest > 0.0 else ())


def _across(bearing: _Bearing, moment: Array) -> Array:
    """(N, 3) the part of a moment across the axis."""
    return np.asarray(np.einsum("nwc,nwk,nk->nc", bearing.across, bearing.across, moment))


def _any(moment: Array) -> Array:
    return moment


def _about(bearing: _Bearing, way: float) -> Callable[[Array], Array]:
    """The part of moments about one axis, ``way`` rad from the first."""
    axis = np.cos(way) * bearing.across[:, 0] + np.sin(way) * bearing.across[:, 1]
    return lambda moment: axis * np.einsum("nc,nc->n", axis, moment)[:, None]


def _seated(moment: Array, seat: float) -> Array:
    """(N, 3) of the play: in proportion to the moment, all of it from ``seat`` N·m on."""
    return np.asarray(moment / np.maximum(np.linalg.norm(moment, axis=1), seat)[:, None])


def _form(j: int, name: str, columns: Callable[[Shape], Array], shapes: tuple[Shape, ...]) -> Hypothesis:
    note = f"tilts across the axis of joint {j + 1} by the moment there, as a main bearing that is loose or soft does"
    return replace(law(joint_at(j + 1), name, note, columns, shapes), rough=True)
