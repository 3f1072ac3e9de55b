"""What the second reader delivers: moves with sampled points, their lengths, feeds and source lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

TURN = 2.0 * math.pi
SAGITTA = 5e-4  # mm: how far the chords of a sampled arc leave it, a twentieth of what is compared


class NotReadError(Exception):
    """Why a file, or a construct in it, is not read here."""


@dataclass(frozen=True)
class Move:
    """One programmed move."""

    points: Vector  # (N, 3) mm, without the start; the last row is the programmed end
    length: float  # mm, along the exact curve; 0 where the start is not known
    rapid: bool
    feed: float  # mm/min; NaN for rapid moves and where the file gives none
    arc: bool
    line: int  # 1-based line of the source
    axis: tuple[float, float, float]  # unit, from tip to shank, at the end


@dataclass
class Path3:
    """All moves of one file, in order."""

    dialect: str
    unit: str = "mm"
    moves: list[Move] = field(default_factory=list)
    tools: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    pecks: bool = False  # holes are drilled in steps; here each is one stroke, so lengths are too short
    at: Vector | None = None  # where the path stands; None where the file does not say

    def line_to(self, end: Vector, *, rapid: bool, feed: float, line: int, axis: Sequence[float] = (0, 0, 1)) -> None:
        """A straight move."""
        end = np.asarray(end, dtype=float)
        length = 0.0 if self.at is None else float(np.linalg.norm(end - self.at))
        self._add(end[None], length, rapid, feed, False, line, axis)

    def arc_to(
        self,
        end: Vector,
        centre: Vector,
        normal: Sequence[float],
        turns: int = 0,
        *,
        feed: float,
        line: int,
        rapid: bool = False,
        axis: Sequence[float] = (0, 0, 1),
        full: bool = True,
    ) -> None:
        """A counter-clockwise arc or helix about ``normal``; start = end is a full circle where ``full``."""
        if self.at is None:
            raise NotReadError(f"line {line}: an arc without a known start")
        start, end = self.at, np.asarray(end, dtype=float)
        n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
        a, b = start - centre, end - centre
        rise = float((b - a) @ n)
        a, b = a - (a @ n) * n, b - (b @ n) * n
        ra, rb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
        if ra < 1e-9 or rb < 1e-9:
            raise NotReadError(f"line {line}: an arc of no radius")
        if abs(ra - rb) > max(0.05, 0.02 * ra):
            raise NotReadError(f"line {line}: the arc's radius is {ra:.4f} at its start and {rb:.4f} at its end")
        u, v = a / ra, np.cross(n, a / ra)
        sweep = math.atan2(float(b @ v), float(b @ u)) % TURN
        near = float(np.linalg.norm(b - a)) < 1e-6 * max(1.0, ra)
        if near:
            sweep = TURN if full else 0.0
        sweep += TURN * turns
        count = max(4, math.ceil(sweep * math.sqrt(max(ra, rb) / (8 * SAGITTA))))
        t = np.arange(1, count + 1) / count
        radius = ra + (rb - ra) * t
        foot = centre + ((start - centre) @ n) * n
        pts = (
            foot
            + radius[:, None] * (np.cos(sweep * t)[:, None] * u + np.sin(sweep * t)[:, None] * v)
            + (rise * t)[:, None] * n
        )
        pts[-1] = end
        self._add(pts, math.hypot(sweep * (ra + rb) / 2, rise), rapid, feed, True, line, axis)

    def _add(
        self, pts: Vector, length: float, rapid: bool, feed: float, arc: bool, line: int, axis: Sequence[float]
    ) -> None:
        a = np.asarray(axis, dtype=float)
        a = a / np.linalg.norm(a)
        feed = math.nan if rapid else feed
        self.moves.append(Move(pts, length, rapid, feed, arc, line, (float(a[0]), float(a[1]), float(a[2]))))
        self.at = pts[-1].copy()

    def note(self, text: str) -> None:
        """Remember something odd, once."""
        if text not in self.notes:
            self.notes.append(text)

    def tool(self, name: str) -> None:
        """A tool change to this tool."""
        if not self.tools or self.tools[-1] != name:
            self.tools.append(name)

    def extent(self, *, cutting: bool = False) -> tuple[Vector, Vector]:
        """Lowest and highest corner of all points, mm."""
        pts = [m.points for m in self.moves if not (cutting and m.rapid)]
        if not pts:
            return np.full(3, np.nan), np.full(3, np.nan)
        every = np.concatenate(pts)
        return every.min(axis=0), every.max(axis=0)

    def length(self, *, rapid: bool) -> float:
        """Sum of the lengths of feed or of rapid moves, mm."""
        return sum(m.length for m in self.moves if m.rapid == rapid)

    def feeds(self) -> list[float]:
        """The different feeds of the feed moves, mm/min, ascending."""
        return sorted({round(m.feed, 3) for m in self.moves if not m.rapid and not math.isnan(m.feed)})


def circle_through(a: Vector, b: Vector, c: Vector) -> tuple[Vector, Vector]:
    """Centre and normal of the arc from a over b to c, counter-clockwise about the normal."""
    ab, ac = b - a, c - a
    n = np.cross(ab, ac)
    nn = float(n @ n)
    if nn < 1e-18:
        raise NotReadError("three points of an arc lie on a line")
    centre = a + (np.cross(n, ab) * float(ac @ ac) + np.cross(ac, n) * float(ab @ ab)) / (2 * nn)
    return centre, n / math.sqrt(nn)


def rot(axis: str, degrees: float) -> Vector:
    """Rotation about X, Y or Z."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i = "XYZ".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    r = np.eye(3)
    r[j, j], r[j, k], r[k, j], r[k, k] = c, -s, s, c
    return r
