"""Chords of arcs, helices and cubic B-splines within a tolerance. Any consistent length unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from machopt.numerics.array_types import Array

MAX_CHORDS = 200_000  # of one curve: beyond it the tolerance or the radius is a fault
RADIUS_WARN = 0.05  # mm between start and end radius: programs print three to six decimals
RADIUS_FAULT = 0.1  # share of the radius: above it, or above half a millimetre, the numbers are wrong
FULL_CIRCLE = 1e-6  # rad: a smaller sweep between equal start and end is a whole turn


class ArcError(ValueError):
    """The numbers of an arc do not describe one; the reader adds file and line."""


@dataclass(frozen=True)
class ArcChords:
    """Chord ends of an arc, start excluded, end exact."""

    points: Array  # (N, 3)
    sweep: float  # rad, always positive
    radius: float
    mismatch: float  # |start − centre| − |end − centre|


def compute_arc_chords(
    start: Array,
    end: Array,
    centre: Array,
    normal: Array,
    tolerance: float,
    *,
    turns: int = 1,
    closed_within: float = 1e-6,
    least: int = 1,
) -> ArcChords:
    """Chords from start to end, right-handed about ``normal``; rises linearly along it (helix).

    p(θ) = c + r(θ)·(cos θ·u + sin θ·v) + h(θ)·n, with u from the centre to the start and v = n × u. A radius
    that differs between start and end is spread linearly over the sweep.

    Args:
        start, end, centre: (3,) points; the centre's height along ``normal`` does not matter.
        normal: (3,) axis of right-handed travel, any length.
        tolerance: largest distance between chord and arc.
        turns: n adds n − 1 full turns.
        least: fewest chords.
        closed_within: start and end nearer than this (across the axis) are a full circle.
    Returns:
        The chord ends with sweep, radius and radius mismatch.
    Raises:
        ArcError: no radius, no axis, or more than MAX_CHORDS chords.
    """
    nx, ny, nz = (float(v) for v in normal)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 1e-9:
        raise ArcError("the arc's axis is zero")
    n = (nx / length, ny / length, nz / length)
    to_start, to_end = (start - centre).tolist(), (end - centre).tolist()
    low, high = _compute_dot(to_start, n), _compute_dot(to_end, n)
    u0 = [a - low * b for a, b in zip(to_start, n, strict=True)]
    u1 = [a - high * b for a, b in zip(to_end, n, strict=True)]
    r0, r1 = math.sqrt(_compute_dot(u0, u0)), math.sqrt(_compute_dot(u1, u1))
    if not (math.isfinite(r0) and math.isfinite(r1) and min(r0, r1) > 1e-9):
        raise ArcError(f"the arc's radius is {r0:g} at its start and {r1:g} at its end")
    u = [a / r0 for a in u0]
    v = [n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]]
    sweep = math.atan2(_compute_dot(u1, v), _compute_dot(u1, u)) % math.tau
    if (math.dist(u0, u1) <= closed_within and (sweep < 0.1 or sweep > math.tau - 0.1)) or sweep < FULL_CIRCLE:
        sweep = math.tau
    sweep += math.tau * (max(turns, 1) - 1)
    count = max(count_chords(max(r0, r1), sweep, tolerance), least)
    theta = np.arange(1, count + 1) * (sweep / count)
    share = theta / sweep
    radius = r0 + (r1 - r0) * share
    points = np.empty((count, 3))
    cosine, sine, height = radius * np.cos(theta), radius * np.sin(theta), low + (high - low) * share
    for k in range(3):
        points[:, k] = float(centre[k]) + cosine * u[k] + sine * v[k] + height * n[k]
    points[-1] = end
    return ArcChords(points, sweep, r0, r0 - r1)


def _compute_dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def count_chords(radius: float, sweep: float, tolerance: float) -> int:
    """Compute the smallest number of equal chords whose sagitta r(1 − cos(Δθ/2)) is below the tolerance.

    Args:
        radius: Radius of the arc.
        sweep: Angle of the arc, rad.
        tolerance: Largest sagitta, unit of the radius.

    Returns:
        Number of chords.

    Raises:
        ArcError: the arc needs more than MAX_CHORDS chords.
    """
    # arccos(1 − x) = 2 arcsin √(x/2), exact for small x too
    widest = 4.0 * math.asin(math.sqrt(min(tolerance / (2.0 * radius), 1.0)))
    widest = min(widest, math.pi / 4.0)  # a tiny circle still needs the shape of one
    count = math.ceil(sweep / widest - 1e-9)
    if count > MAX_CHORDS:
        raise ArcError(f"{count} chords for one arc of radius {radius:g}; the limit is {MAX_CHORDS}")
    return max(count, 1)


def compute_centre_from_radius(start: Array, end: Array, radius: float, normal: Array) -> Array:
    """Compute the centre of the arc from start to end, right-handed about the normal.

    Args:
        start: Start point (3,).
        end: End point (3,).
        radius: Radius; negative for the longer arc.
        normal: Normal of the plane (3,), unit vector.

    Returns:
        Centre (3,).

    Raises:
        ArcError: the end is farther away than the diameter, or start and end coincide.
    """
    n = normal / np.linalg.norm(normal)
    chord = end - start
    chord = chord - (chord @ n) * n
    d = float(np.linalg.norm(chord))
    if d < 1e-9:
        raise ArcError("start and end of an arc given by its radius coincide; give the centre instead")
    square = radius * radius - d * d / 4.0
    if square < 0.0:
        if d / 2.0 - abs(radius) > max(0.01 * abs(radius), 0.01):
            raise ArcError(f"radius {abs(radius):g} is too small for an end {d:g} away")
        square = 0.0
    side = math.copysign(1.0, radius)
    return np.asarray(start + chord / 2.0 + side * math.sqrt(square) * np.cross(n, chord / d))


def interpolate_axes(a: Array, b: Array, shares: Array) -> Array:
    """(N, 3) unit vectors that turn evenly from a to b, in the plane of both.

    slerp(s) = (sin((1 − s)θ) a + sin(sθ) b) / sin θ, θ the angle between them (Shoemake, SIGGRAPH 1985).

    Args:
        a, b: (3,) or (N, 3) unit vectors.
        shares: (N,) from 0 at a to 1 at b.
    Raises:
        ArcError: they are opposite, so that no plane holds both alone.
    """
    a, b = np.broadcast_to(a, (len(shares), 3)), np.broadcast_to(b, (len(shares), 3))
    theta = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
    if (theta > math.pi - 1e-6).any():
        raise ArcError("the tool axis turns by 180° in one block: the direction of the turn is not stated")
    sine = np.sin(theta)
    near = sine < 1e-9
    safe = np.where(near, 1.0, sine)
    first = np.where(near, 1.0 - shares, np.sin((1.0 - shares) * theta) / safe)
    second = np.where(near, shares, np.sin(shares * theta) / safe)
    return np.asarray(first[:, None] * a + second[:, None] * b)


def compute_spline_chords(control: Array, knots: Array, tolerance: float) -> Array:
    """Chord ends of a clamped cubic B-spline, first point excluded.

    In each knot span C″ is linear, so max|C″| is at its ends and a chord of parameter width h is off by at
    most h²·max|C″|/8.

    Args:
        control: (M, 3) control points, the first one being where the curve starts.
        knots: (M + 4,) full knot vector.
        tolerance: largest distance between chord and curve.
    Raises:
        ArcError: the knots do not fit the control points or fall.
    """
    from scipy.interpolate import BSpline

    if len(knots) != len(control) + 4:
        raise ArcError(f"{len(knots) - 8} inner knots for {len(control)} control points; expected {len(control) - 4}")
    if not np.isfinite(knots).all() or (np.diff(knots) < 0.0).any() or not knots[-1] > knots[0]:
        raise ArcError("the knots do not rise")
    curve = BSpline(knots, control, 3)
    with np.errstate(over="ignore", invalid="ignore"):  # knots that all but coincide
        bend = curve.derivative(2)
    parameters: list[Array] = []
    spans = np.unique(knots)
    for a, b in pairwise(spans):
        inside = a + (b - a) * np.array([1e-9, 1.0 - 1e-9])
        with np.errstate(over="ignore", invalid="ignore"):
            most = float(np.linalg.norm(bend(inside), axis=1).max())
        wanted = (b - a) * math.sqrt(most / (8.0 * tolerance))
        if not wanted <= MAX_CHORDS:
            raise ArcError(f"{wanted:.0f} chords in one span of a spline; the limit is {MAX_CHORDS}")
        parameters.append(np.linspace(a, b, max(math.ceil(wanted), 1) + 1)[1:])
    points = np.asarray(curve(np.concatenate(parameters)))
    points[-1] = control[-1]
    return points
