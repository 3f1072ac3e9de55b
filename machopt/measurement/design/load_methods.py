"""Methods of load application: hanging weights, horizontal pulls, ropes or turnbuckles to anchors, on lever arms.

A load is a force f at a point of the tool. At the TCP it is the wrench (f, r × f), with r from the TCP to that point.
A bar bolted to the tool turns a plain weight into a moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors

Kind = Literal["weight", "pull", "rope"]

GRAVITY = 9.80665  # m/s², standard gravity
SHORTEST_ROPE = 0.2  # m, least distance of load point and anchor, for hook, sensor and turnbuckle
AXES = ("+x", "−x", "+y", "−y")  # directions of a lever arm, in TCP axes


@dataclass(frozen=True, kw_only=True)
class LoadMethod:
    """Method of load application without magnitude."""

    kind: Kind
    direction: Array | None  # (3,) unit, of the force on the robot in base_link; None for ropes
    anchor: Array | None  # (3,) m in base_link, for ropes
    arm: Array  # (3,) m, from the TCP to the load's point, in TCP axes
    magnitudes: tuple[float, ...]  # N, ascending
    words: str  # direction and load point in words

    def describe(self, magnitude: float) -> str:
        """Describe a load: ``50 kg hanging at the TCP``, ``500 N rope to anchor 1, arm +x 200 mm``, ``no load``.

        Args:
            magnitude: Force, N.

        Returns:
            Text.
        """
        if magnitude == 0.0:
            return "no load"
        size = f"{magnitude / GRAVITY:.4g} kg" if self.kind == "weight" else f"{magnitude:.4g} N"
        return f"{size} {self.words}"


def build_load_method_combinations(
    weights: Sequence[float],
    pulls: Sequence[float],
    azimuths: int,
    anchors: Array,
    arms: Sequence[float],
    R_base_world: Array,
) -> tuple[LoadMethod, ...]:
    """Build every combination of direction and lever arm.

    Args:
        weights: Masses of hanging weights, kg.
        pulls: Forces of ropes if there are ``anchors``, otherwise of horizontal pulls, N.
        azimuths: Number of horizontal directions, the first along world x; used without anchors.
        anchors: (A, 3) anchor positions in base_link, m.
        arms: Distances of the load point from the TCP across the tool, m; 0 is the TCP.
        R_base_world: (3, 3) world axes in base_link; weights pull along −z of world.

    Returns:
        The methods.
    """
    down = -R_base_world[:, 2]
    newtons = tuple(sorted({float(m) * GRAVITY for m in weights}))
    sizes = tuple(sorted({float(p) for p in pulls}))
    angles = [2.0 * np.pi * n / azimuths for n in range(0 if len(anchors) else azimuths)]
    out = []
    for at, place in _list_load_points(arms):
        if newtons:
            out.append(_build_method("weight", at, newtons, f"hanging {place}", direction=down))
        if not sizes:
            continue
        for n, anchor in enumerate(anchors, start=1):
            out.append(_build_method("rope", at, sizes, f"rope to anchor {n} {place}", anchor=anchor))
        for angle in angles:
            direction = R_base_world @ np.array([np.cos(angle), np.sin(angle), 0.0])
            words = f"horizontal pull at {np.degrees(angle):.4g} deg {place}"
            out.append(_build_method("pull", at, sizes, words, direction=direction))
    return tuple(out)


def _list_load_points(arms: Sequence[float]) -> list[tuple[Array, str]]:
    """Return the lever arms (3,) m across the tool, and their places in words."""
    points = [(np.zeros(3), "at the TCP")] if 0.0 in arms else []
    for arm in sorted({float(a) for a in arms if a > 0.0}):
        for word, axis in zip(AXES, ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)), strict=True):
            points.append((arm * np.array(axis, float), f"on an arm {word} {arm * 1e3:.4g} mm"))
    return points


def _build_method(
    kind: Kind,
    arm: Array,
    magnitudes: tuple[float, ...],
    words: str,
    *,
    direction: Array | None = None,
    anchor: Array | None = None,
) -> LoadMethod:
    return LoadMethod(kind=kind, direction=direction, anchor=anchor, arm=arm, magnitudes=magnitudes, words=words)


def compute_unit_wrench(way: LoadMethod, T_base_tcp: Array) -> tuple[Array, Array]:
    """Compute the wrench per newton of a load method, and the load point.

    Args:
        way: Load method.
        T_base_tcp: (..., 4, 4) TCP poses.

    Returns:
        (..., 6) N/N and m about the TCP in base_link axes, NaN for a rope shorter than 0.2 m; (..., 3) load
        point in base_link, m.
    """
    lever = np.einsum("...ij,j->...i", T_base_tcp[..., :3, :3], way.arm)
    point = T_base_tcp[..., :3, 3] + lever
    if way.anchor is not None:
        rope = way.anchor - point
        long_enough = np.linalg.norm(rope, axis=-1) >= SHORTEST_ROPE
        force = np.where(long_enough[..., None], normalise_vectors(np.where(long_enough[..., None], rope, 1.0)), np.nan)
    else:
        force = np.broadcast_to(np.asarray(way.direction), point.shape)
    return np.concatenate([force, np.cross(lever, force)], axis=-1), point
