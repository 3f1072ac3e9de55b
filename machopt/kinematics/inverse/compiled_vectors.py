"""Operations on vectors of three numbers for compiled kernels, which keep tuples in registers."""

from __future__ import annotations

import math

from machopt.numerics.compiled_functions import jit_compile

Vector = tuple[float, float, float]


@jit_compile
def compute_angle_about_axis(h: Vector, source: Vector, target: Vector) -> float:
    """Return the angle in rad about h that rotates ``source`` onto ``target`` (components normal to h).

    Args:
        h: unit axis.
        source: first direction.
        target: second direction.
    """
    return math.atan2(
        dot_product(cross_product(source, target), h),
        dot_product(source, target) - dot_product(source, h) * dot_product(target, h),
    )


@jit_compile
def rotate_vector(h: Vector, c: float, s: float, v: Vector) -> Vector:
    """Return v rotated about a unit axis (Rodrigues).

    Args:
        h: unit axis.
        c: cosine of the angle.
        s: sine of the angle.
        v: vector.
    """
    x, rest = cross_product(h, v), (1.0 - c) * dot_product(h, v)
    return (c * v[0] + s * x[0] + rest * h[0], c * v[1] + s * x[1] + rest * h[1], c * v[2] + s * x[2] + rest * h[2])


@jit_compile
def cross_product(a: Vector, b: Vector) -> Vector:
    """Return a × b.

    Args:
        a: first vector.
        b: second vector.
    """
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@jit_compile
def dot_product(a: Vector, b: Vector) -> float:
    """Return a · b.

    Args:
        a: first vector.
        b: second vector.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit_compile
def add_vectors(a: Vector, b: Vector) -> Vector:
    """Return a + b.

    Args:
        a: first vector.
        b: second vector.
    """
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@jit_compile
def wrap_angle(angle: float) -> float:
    """Return the same angle in (−π, π]: π − (π − angle) mod 2π, without the division where it changes nothing.

    Args:
        angle: rad.
    """
    rest = math.pi - angle
    if not 0.0 <= rest < 2.0 * math.pi:
        rest = rest % (2.0 * math.pi)
    return math.pi - rest
