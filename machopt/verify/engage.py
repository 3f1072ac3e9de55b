"""The process force a shifted path is held against, computed again: by walking along the toolpath, piece by piece.

The law is the one that machopt states for its compensation. A mean over 2ℓ of the force along the run (outside the cuts
that of the nearest one), times a share that fades over ℓ away from the cuts and at ends of a run that is only come from
or gone to. The sideways direction of the force is that of the travel across the tool axis, and within 10° of the axis
it is blended into that of the next place that travels across (else the last; else the workpiece x axis).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.options import ProcessForce
from machopt.domain.toolpath import Move, Toolpath

Array = NDArray[np.float64]
ACROSS = 0.17364817766693033  # sin 10°
PIECES = 200  # of a window
PARALLEL = 0.9998476951563913  # cos 1°


@dataclass(frozen=True)
class Piece:
    """A straight move of a run that has a length."""

    start: float  # m along the run
    end: float
    direction: Array  # (3,)
    axis_start: Array
    axis_end: Array
    cut: bool


def demanded_force(toolpath: Toolpath, index: Array, force: ProcessForce, length: float) -> Array:
    """(P, 3) N in workpiece at fractional points (P,), fading and turning over ``length`` (m)."""
    out = np.zeros((len(index), 3))
    for first, last in runs(toolpath):
        rows = np.flatnonzero((index >= first - 1e-9) & (index <= last + 1e-9))
        pieces, at = walk(toolpath, first, last)
        if not any(p.cut for p in pieces):
            continue
        table = _Force(pieces, force)
        for row in rows:
            s = float(np.interp(index[row], np.arange(first, last + 1), at))
            share = _share(pieces, s, length)
            if share > 0:
                window = s + length * ((np.arange(PIECES) + 0.5) / PIECES * 2 - 1)
                out[row] = share * table.at(window).mean(axis=0)
    return out


def sideways(toolpath: Toolpath) -> Array:
    """(N, 3) direction of the sideways force of the move that leaves each point, at a run's end of the one to it.

    Of unit length across the axis and along it; in between the blend of the two may be shorter.
    """
    out = np.zeros((len(toolpath), 3))
    for first, last in runs(toolpath):
        pieces, at = walk(toolpath, first, last)
        leads = _leads(pieces)
        for k in range(first, last + 1):
            a = max(min(k, last - 1), first)
            axis = toolpath.axis[[k]]
            step = toolpath.position[min(a + 1, last)] - toolpath.position[a]
            size = float(np.linalg.norm(step))
            n = min(int(np.searchsorted([p.end for p in pieces], at[a - first], side="right")), len(pieces) - 1)
            lead = leads[n] if pieces else None
            side = _lead(np.zeros((1, 3)) if lead is None else lead[None], axis)
            out[k] = (_blend(step[None] / size, axis, side) if size > 0 else side)[0]
    return out


def runs(toolpath: Toolpath) -> list[tuple[int, int]]:
    """First and last point of each stretch that begins where a rapid move ends."""
    begins = [0, *(k for k in range(1, len(toolpath)) if toolpath.move[k] == Move.RAPID)]
    return [(a, b - 1) for a, b in zip(begins, [*begins[1:], len(toolpath)], strict=True)]


def walk(toolpath: Toolpath, first: int, last: int) -> tuple[list[Piece], Array]:
    """The run's moves, and the length along it at each of its points."""
    pieces, at = [], [0.0]
    for k in range(first + 1, last + 1):
        step = toolpath.position[k] - toolpath.position[k - 1]
        size = float(np.linalg.norm(step))
        if size > 0:
            pieces.append(Piece(at[-1], at[-1] + size, step / size, toolpath.axis[k - 1], toolpath.axis[k],
                                bool(toolpath.move[k] == Move.CUT)))  # fmt: skip
        at.append(at[-1] + size)
    return pieces, np.array(at)


def _share(pieces: list[Piece], s: float, length: float) -> float:
    away = min(max(p.start - s, s - p.end, 0.0) for p in pieces if p.cut)
    share = 1.0 - away / length
    if not pieces[0].cut:
        share = min(share, s / length)
    if not pieces[-1].cut:
        share = min(share, (pieces[-1].end - s) / length)
    return min(max(share, 0.0), 1.0)


class _Force:
    """The force at places along a run."""

    def __init__(self, pieces: list[Piece], force: ProcessForce) -> None:
        cuts = [k for k, p in enumerate(pieces) if p.cut]
        mine = [pieces[k] for k in cuts]
        leads = _leads(pieces)
        self.force = force
        self.starts, self.ends = np.array([p.start for p in mine]), np.array([p.end for p in mine])
        self.direction = np.array([p.direction for p in mine])
        self.axes = np.array([p.axis_start for p in mine]), np.array([p.axis_end for p in mine])
        none = np.zeros(3)
        self.lead = np.array([none if leads[k] is None else leads[k] for k in cuts])

    def at(self, s: Array) -> Array:
        """(n, 3) N at places (n,), outside the cuts that of the nearest."""
        away = np.maximum(np.maximum(self.starts - s[:, None], s[:, None] - self.ends), 0.0)
        n = away.argmin(axis=1)
        f = ((np.clip(s, self.starts[n], self.ends[n]) - self.starts[n]) / (self.ends[n] - self.starts[n]))[:, None]
        axis = (1 - f) * self.axes[0][n] + f * self.axes[1][n]
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        side = _blend(self.direction[n], axis, _lead(self.lead[n], axis))
        o = self.force
        return np.asarray(o.travel * side + o.normal * np.cross(axis, side) + o.axial * axis)


def _blend(direction: Array, axis: Array, lead: Array) -> Array:
    """(n, 3) the travel across the axis where there is enough of it, the lead where there is none."""
    flat = _across(direction, axis)
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    x = np.minimum(size / ACROSS, 1.0)
    w = x**2 * (3 - 2 * x)
    return np.asarray(w * flat / np.where(size > 0, size, 1.0) + (1 - w) * lead)


def _leads(pieces: list[Piece]) -> list[Array | None]:
    """Of each piece the sideways direction that a plunge there takes: of the next one across, else of the last."""
    own: list[Array | None] = []
    for p in pieces:
        middle = (p.axis_start + p.axis_end) / np.linalg.norm(p.axis_start + p.axis_end)
        flat = p.direction - (p.direction @ middle) * middle
        size = float(np.linalg.norm(flat))
        own.append(flat / size if size >= ACROSS else None)
    out = list(own)
    for k in range(len(out) - 2, -1, -1):
        out[k] = out[k] if out[k] is not None else out[k + 1]
    for k in range(1, len(out)):
        out[k] = out[k] if out[k] is not None else out[k - 1]
    return out


def _lead(lead: Array, axis: Array) -> Array:
    """(n, 3) unit vectors across the axes: the leads, or the workpiece x axis (y where x is parallel to the axis)."""
    x = np.where(np.abs(axis[:, :1]) <= PARALLEL, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    flat, bare = _across(lead, axis), _across(x, axis)
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    bare /= np.linalg.norm(bare, axis=1, keepdims=True)
    return np.where(size > 1e-9, flat / np.where(size > 1e-9, size, 1.0), bare)


def _across(v: Array, axis: Array) -> Array:
    return np.asarray(v - np.sum(v * axis, axis=1, keepdims=True) * axis)
