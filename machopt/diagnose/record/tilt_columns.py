"""Columns of an inclinometer written otherwise: exchanged, reversed, in another unit; put right.

Weight tilts what bears it towards itself: of a base, tilt = C m, C symmetric with nothing negative in it, m the moment
of all weights about the base; of a link behind joints, the sag of these beside it. Exchanged columns give a C with one
negative direction, reversed ones a negative C, so no poses are needed to see it. Of the unit they are: a base that
rocks moves the points by as much as it turns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.at_body import weight_wrench
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Finding, rms
from machopt.diagnose.record.sessions import chance
from machopt.diagnose.resting import inclinometer
from machopt.diagnose.resting.nominal_poses import Nominal
from machopt.domain.cell import Cell
from machopt.domain.location import column_at
from machopt.domain.recording import Recording
from machopt.effects.record import COLUMNS, UNITS
from machopt.model.robot import Masses, Robot

Flags = NDArray[np.bool_]
HEAD = "tilt_x_mrad"
DIRECTIONS = 12  # of what C is made of: c u uᵀ, c ≥ 0


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """What an inclinometer reads and what could make it read so; of n readings, each session about its own mean."""

    y: Array  # (n, 2) rad
    sag: Array  # (n, 2) rad, of joints up to the link
    moment: Array  # (n, 2) N·m about the base
    rocking: Array  # (n, 2) rad, what the poses say of the base
    shown: bool  # they say it
    pose: NDArray[np.int64]

    def columns(self) -> Array:
        """(2 n, P) per unit of coefficients that are not negative."""
        angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        u = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rays = np.einsum("ka,kb,nb->nak", u, u, self.moment)
        return np.concatenate([rays, self.sag[:, :, None]], axis=2).reshape(self.y.size, -1)

    def error(self, y: Array) -> tuple[Array, float]:
        """(n, 2) rad that no weight explains, and the share of the sag that there is."""
        A = self.columns()
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        x = nnls(A / size, y.reshape(-1))[0] / size
        return y - (A @ x).reshape(y.shape), float(x[-1])


def mended(
    recording: Recording, cell: Cell, robot: Robot, masses: Masses | None, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Read the tilts the way that weight can make them, where that is sure.

    Args:
        recording: kind absolute, its poses right.
        cell, robot, masses: the arm; without masses nothing is known.
        accept: effects that the user says are none.
    """
    if recording.kind != "absolute" or masses is None:
        return recording, []
    inclined = inclinometer.where(recording, cell)
    if inclined is None or recording.tilt is None:
        return recording, []
    rows = np.asarray(inclined.present.all(axis=1))
    if rows.sum() < calibrated.RECORD.tilt_readings:
        return recording, []
    model = Nominal(recording, cell, robot, masses, frozenset())
    seen = _seen(model, inclined.link, rows)
    out: list[Finding] = []
    if COLUMNS.name not in accept:
        way = _assigned(seen)
        if way is not None:
            words, read = way
            out.append(_said(seen, read(seen.y), f"{words}, so weight would tilt what bears it away from itself"))
            seen = replace(seen, y=read(seen.y))
            recording = _read(recording, rows, read)
    factor = 1.0 if UNITS.name in accept else _unit(seen)
    if factor != 1.0:
        name = next(n for n, f in inclinometer.UNITS.items() if f == factor)
        words = f"{HEAD}, tilt_y_mrad hold {name} by what weight does to joints and points"
        out.append(_said(seen, seen.y / factor, words, factor))
        recording = _read(recording, rows, lambda t: t / factor)
    return recording, out


def _seen(model: Nominal, link: int, rows: Flags) -> _Seen:
    recording = model.recording
    assert recording.tilt is not None  # mended looks for it
    first = model.first_fit()
    state, p, R = model.predict(first)
    assert model.masses is not None
    r = model.readings(state, first, first.compliance)
    w = weight_wrench(r, model.masses.body >= 1)
    moment = w[:, 3:] + np.cross(state.T_base_tool[:, :3, 3], w[:, :3])
    rocking, shown = _by_points(model, model.residual(first, p, R)[:, :3], model.columns(state, p)[0][:, :3], p, moment)
    session = np.unique(recording.session[rows], return_inverse=True)[1].reshape(-1)

    def apart(values: Array) -> Array:
        v = values[rows][:, :2]
        mean = np.stack([np.bincount(session, c) for c in v.T], axis=1) / np.bincount(session)[:, None]
        return np.asarray(v - mean[session])

    sag = inclinometer.sagged(model, state, link)
    return _Seen(
        y=apart(recording.tilt),
        sag=apart(sag),
        moment=apart(moment),
        rocking=apart(rocking),
        shown=shown,
        pose=recording.pose[rows].astype(np.int64),
    )


def _by_points(model: Nominal, e: Array, base: Array, p: Array, moment: Array) -> tuple[Array, bool]:
    """(N, 2) rad that the base turns by what the points (N, 3) m show, beside what is fitted in any case."""
    turns = np.zeros((len(p), 3, 3))  # by c_xx, c_xy, c_yy
    turns[:, 0, 0] = moment[:, 0]
    turns[:, 0, 1], turns[:, 1, 1] = moment[:, 1], moment[:, 0]
    turns[:, 1, 2] = moment[:, 1]
    moved = np.cross(turns, p[:, :, None], axisa=1, axisb=1, axisc=1)
    A = np.concatenate([base, moved], axis=2).reshape(e.size, -1)
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    x, *_ = np.linalg.lstsq(A / size, e.reshape(-1), rcond=1e-9)
    without, *_ = np.linalg.lstsq(A[:, :-3] / size[:-3], e.reshape(-1), rcond=1e-9)
    left = float(np.linalg.norm(e.reshape(-1) - A / size @ x))
    more = float(np.linalg.norm(e.reshape(-1) - A[:, :-3] / size[:-3] @ without))
    return np.einsum("nck,k->nc", turns, (x / size)[-3:]), left < calibrated.RECORD.tilt_shown * more


def _assigned(seen: _Seen) -> tuple[str, inclinometer.Way] | None:
    """The other way to read two columns that weight explains; None: as stated, or nothing is sure."""
    size = rms(seen.y)
    stated = rms(seen.error(seen.y)[0]) / max(size, 1e-300)
    if stated < calibrated.RECORD.tilt_doubted:
        return None
    found = []
    for words, read in _ways():
        found.append((rms(seen.error(read(seen.y))[0]) / max(size, 1e-300), words, read))
    found.sort(key=lambda f: f[0])
    (best, words, read), (second, *_) = found[:2]
    if best > calibrated.RECORD.moved_falls * stated or second < calibrated.RECORD.moved_as_good * best:
        return None
    return words, read


def _ways() -> Iterator[tuple[str, inclinometer.Way]]:
    for exchanged in (False, True):
        for x, y in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
            if not exchanged and x == y == 1:
                continue
            names = [n for n, s in ((HEAD, x), ("tilt_y_mrad", y)) if s < 0]
            signs = f"{' and '.join(names)} reversed" if names else ""
            words = " and ".join(w for w in (f"{HEAD} and tilt_y_mrad exchanged" if exchanged else "", signs) if w)
            sign = np.array([x, y], float)
            yield words, lambda t, e=exchanged, s=sign: (t * s)[:, ::-1] if e else t * s  # type: ignore[misc]


def _unit(seen: _Seen) -> float:
    """What numbers were divided by less than they should have been: 1 where mrad fit as well as anything."""
    whole = seen.sag + (seen.rocking if seen.shown else 0.0)
    if rms(whole) < calibrated.RECORD.tilt_least * (1.0 if seen.shown else 2.0):
        return 1.0
    slope = float(np.sum(whole * seen.y) / np.sum(whole**2))
    alike = float(np.sum(whole * seen.y)) / max(float(np.linalg.norm(whole) * np.linalg.norm(seen.y)), 1e-300)
    if slope <= 0.0 or alike < calibrated.RECORD.tilt_alike:
        return 1.0
    factors = (1.0, *inclinometer.UNITS.values())
    return min(factors, key=lambda f: abs(np.log(slope / f)))


def _read(recording: Recording, rows: Flags, read: inclinometer.Way) -> Recording:
    assert recording.tilt is not None  # mended looks for it
    tilt = recording.tilt.copy()
    tilt[rows] = read(tilt[rows])
    return replace(recording, tilt=tilt)


def _said(seen: _Seen, read: Array, words: str, factor: float = 1.0) -> Finding:
    before, after = (np.linalg.norm(seen.error(v)[0], axis=1) / max(rms(v), 1e-300) for v in (seen.y, read))
    words = f"{words}; they were read right"
    return repaired(
        COLUMNS.name if factor == 1.0 else UNITS.name,
        column_at(HEAD),
        words,
        np.nan,
        np.nan,
        chance(seen.pose, before, after) if factor == 1.0 else 0.0,
        {} if factor == 1.0 else {"factor": exact(factor)},
    )
