"""Moves on which the end of a milling cutter removes material, by exact shapes: points.csv states no force there.

The material beneath the end at the start of a move is sampled on lines along the axis: the stock mesh without all
earlier poses. The same is done with the outline moved in and out. Only what both say is required.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools

LEAST_DESCENT, LEAST_VOLUME, LEAST_SHARE = 5e-6, 1e-12, 0.01  # m, m³, of what end and side remove
DOUBT = 2.0  # factor of the share within which either statement may follow
NO_TRAVEL, ROUNDING = 1e-9, 1e-9  # m
RADII, DIRECTIONS = 9, 40
SHARES = (1.0, 0.75, 0.5, 0.25)  # of a plunge, where the cutter is compared: an axis that turns may touch on the way


@dataclass(frozen=True)
class Descents:
    """Moves of one tool that may remove material with the end."""

    may: Bools  # (N,) a cut that descends, or does not travel across its axis
    is_steep: Bools  # (N,) it descends at least as far as it travels across, or does not travel
    across: Array  # (N,) m


@dataclass(frozen=True)
class EndDisc:
    """Disc beneath the end at the start of a move, or the whole cutter at its end."""

    radius: float  # m
    is_whole: bool  # the cutter along the move
    share: float = 1.0  # of the move, where the whole cutter is

    @property
    def areas(self) -> Array:
        """Return (P,) m² of the places."""
        edges = _list_ring_edges()
        return np.repeat(np.diff(edges), DIRECTIONS) * math.pi * self.radius**2 / DIRECTIONS

    def locate(self, path: Toolpath, k: int) -> tuple[Array, Array, Array]:
        """Return tip (3,), axis (3,) and the places on the disc (P, 3), m in the CAM frame.

        Args:
            path: The toolpath.
            k: Point at which the move ends.
        """
        last = max(k - 1, 0)
        _, travel = _split_move(path, k)
        tip, axis = path.position[last], path.axis[k]
        if self.is_whole:
            tip = tip + self.share * (path.position[k] - tip)
            axis = (1.0 - self.share) * path.axis[last] + self.share * axis
            axis = axis / np.linalg.norm(axis)
            travel = travel - (travel @ axis) * axis
            travel = travel / np.linalg.norm(travel)
        x, y = self._list_places()
        return tip, axis, tip + x[:, None] * travel + y[:, None] * np.cross(axis, travel)

    def list_ranges(self, path: Toolpath, k: int, cutter: CutterGeometry) -> Array:
        """Return (2, P) m, from where to where above the tip the move removes what is there.

        Args:
            path: The toolpath.
            k: Point at which the move ends.
            cutter: The cutter.
        """
        x, y = self._list_places()
        if self.is_whole:
            rc = cutter.corner
            beyond = np.clip(np.hypot(x, y) - 0.5 * cutter.diameter + rc, 0.0, rc)
            return np.stack([rc - np.sqrt(rc * rc - beyond**2), np.full(len(x), cutter.length)])
        (down, across), _ = _split_move(path, k)
        leaves = x + np.sqrt(np.maximum(self.radius**2 - y**2, 0.0))
        share = np.minimum(leaves / across, 1.0) if across > NO_TRAVEL else np.ones(len(x))
        return np.stack([-down * share, np.zeros(len(x))])

    def _list_places(self) -> tuple[Array, Array]:
        """Return places along travel and across it, (P,) m each, in rings that are narrow near the outline."""
        edges = _list_ring_edges()
        r = self.radius * np.sqrt(0.5 * (edges[:-1] + edges[1:]))
        turn = (np.arange(DIRECTIONS) + 0.5) * 2.0 * math.pi / DIRECTIONS
        return np.outer(r, np.sin(turn)).ravel(), np.outer(r, np.cos(turn)).ravel()


def _list_ring_edges() -> Array:
    """Return (RADII + 1,) shares of the area of a disc within the edges of its rings."""
    return np.asarray(1.0 - (1.0 - np.arange(RADII + 1) / RADII) ** 2)


Measure = Callable[[int, EndDisc], Array]


def _split_move(path: Toolpath, k: int) -> tuple[tuple[float, float], Array]:
    """Return how far a move descends along its axis and travels across it, m, and the unit direction across."""
    step = path.position[k] - path.position[max(k - 1, 0)]
    axis = path.axis[k]
    down = -float(step @ axis)
    flat = step + down * axis
    across = float(np.linalg.norm(flat))
    if across <= NO_TRAVEL:
        flat = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    return (down, across), flat / np.linalg.norm(flat)


def find_descents(path: Toolpath) -> Descents:
    """Return the moves on which the end may remove material.

    Args:
        path: Toolpath of one tool, with its contact.
    """
    found = path.engagement
    assert found is not None
    across, may, steep = np.zeros(len(path)), np.zeros(len(path), bool), np.zeros(len(path), bool)
    total = 0.0
    for k in np.flatnonzero(path.move == MoveKind.CUT).tolist():
        (down, across[k]), _ = _split_move(path, k)
        follows = k > 0 and path.move[k - 1] == MoveKind.CUT
        total = (total if follows else 0.0) + down if down > ROUNDING else 0.0
        still = across[k] <= NO_TRAVEL
        may[k] = found.is_computed[k] and (still or total > LEAST_DESCENT + ROUNDING)
        steep[k] = may[k] and (still or down >= across[k] - ROUNDING)
    return Descents(may, steep, across)


def list_wrong_forces(
    path: Toolpath, first: int, cutter: CutterGeometry, measure: Measure, sizes: tuple[float, int]
) -> list[str]:
    """Return the points whose force is stated or left out against the exact shapes.

    Args:
        path: Toolpath of one tool, with its contact; ``is_end_cut`` where no force is stated.
        first: Point of the job at which it starts.
        cutter: The cutter.
        measure: Returns (P,) m of material that the move to a point removes at the places of a disc.
        sizes: m, how far the outline is moved, and the largest number of points of each kind.
    """
    found = path.engagement
    if found is None:
        return []
    some = find_descents(path)
    strange = np.flatnonzero(found.is_end_cut & ~some.may)
    wrong = [f"point {first + k}: no force, and the move does not descend" for k in strange.tolist()]
    for stated in (True, False):
        rows = np.flatnonzero(some.may & (found.is_end_cut == stated))
        picked = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), sizes[1])).round().astype(int))
        for k in rows[picked].tolist():
            shares = [_measure_share(path, k, cutter, some, measure, moved) for moved in (-sizes[0], sizes[0])]
            if stated and max(shares) < 1.0 / DOUBT:
                wrong.append(f"point {first + k}: no force, and the end of the cutter removes nothing")
            elif not stated and min(shares) > DOUBT:
                wrong.append(f"point {first + k}: a force, and the end of the cutter removes material")
    return wrong


def _measure_share(
    path: Toolpath, k: int, cutter: CutterGeometry, some: Descents, measure: Measure, moved: float
) -> float:
    """Return what the end removes over the least that makes the force unknown."""
    found, R = path.engagement, 0.5 * cutter.diameter
    assert found is not None
    if some.is_steep[k]:
        most = 0.0
        for share in SHARES:
            disc = EndDisc(R + moved, is_whole=True, share=share)
            most = max(most, float(measure(k, disc) @ disc.areas) / LEAST_VOLUME)
            if most > DOUBT:
                break
        return most
    disc = EndDisc(R - cutter.corner + moved, is_whole=False)
    end = float(measure(k, disc) @ disc.areas) if disc.radius > 0.0 else 0.0
    mine = found.take_range(k, k + 1)
    arcs = float(np.sum((mine.high - mine.low) * R * (np.cos(mine.start) - np.cos(mine.end))))
    return end / max(LEAST_VOLUME, LEAST_SHARE * (end + arcs * float(some.across[k])))
