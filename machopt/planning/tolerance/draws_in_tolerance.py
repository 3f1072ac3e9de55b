"""Compiled count of the draws in which the tolerances of a hole hold."""

from __future__ import annotations

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile


@jit_compile
def count_good_draws(
    thrust: Array, torque: Array, parts: Array, tilt: Array, clamp: float, limits: tuple[float, float, float]
) -> int:
    """Return in how many of D draws a hole is in tolerance.

    Args:
        thrust: (D,) N, without the clamp.
        torque: (D,) N·m.
        parts: (D, 21) components by a unit thrust, by a unit torque, and others: displacement across the axis (2) and
            turns (2) at entry, displacement along the axis (1) and turns (2) at exit.
        tilt: (D, 2) rad, turns that no load causes.
        clamp: N, least load along the axis; −inf without a pressure foot.
        limits: Distance across the axis in m, angle of the axis in rad, depth in m; inf where none is stated.
    """
    position, angle, depth = limits[0] * limits[0], limits[1] * limits[1], limits[2]
    count = 0
    for d in range(len(thrust)):
        T, M, p = max(thrust[d], clamp), torque[d], parts[d]
        x, y = T * p[0] + M * p[7] + p[14], T * p[1] + M * p[8] + p[15]
        if not x * x + y * y <= position:
            continue
        if not abs(T * p[4] + M * p[11] + p[18]) <= depth:
            continue
        x, y = T * p[2] + M * p[9] + p[16] + tilt[d, 0], T * p[3] + M * p[10] + p[17] + tilt[d, 1]
        if not x * x + y * y <= angle:
            continue
        x, y = T * p[5] + M * p[12] + p[19] + tilt[d, 0], T * p[6] + M * p[13] + p[20] + tilt[d, 1]
        if x * x + y * y <= angle:
            count += 1
    return count
