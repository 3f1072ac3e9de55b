"""Time, joint limits by differences of the samples, and where the motion begins and ends."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.verify.check import Check, Promise, worst
from machopt.verify.table import Motion

VELOCITY, ACCELERATION, JERK = 1.01, 1.03, 1.10  # differences over the limits: rounding grows with the order
JITTER_S = 5e-6  # of the control cycle: the time column is rounded
ARM = 6  # axes of the arm, before the external ones
HOME_DEG = 1e-6  # joints are printed with nine decimals


def check_limits(motion: Motion, cell: Cell, options: PlanOptions, ends: tuple[Array, Array]) -> list[Check]:
    """At rest before the first and after the last sample; joint columns are encoder angles, and so are the limits.

    Args:
        ends: (6 + E,) rad or m each, where the motion has to begin and to end.
    """
    return [*_time(motion, options), _home(motion, ends), *_limits(motion, cell)]


def _time(motion: Motion, options: PlanOptions) -> list[Check]:
    step = np.diff(motion.time)
    off = np.abs(step - motion.cycle) if motion.cycle > 0 else np.full(len(step), np.inf)
    n = int(np.argmax(off))
    even = Check(
        name="uniform time",
        passed=bool(off[n] <= JITTER_S and (step > 0).all()),
        value=float(off[n]),
        limit=JITTER_S,
        unit="s",
        where=motion.at(n + 1),
    )
    wrong = np.array([abs(motion.cycle - options.sample), abs(motion.time[0])])
    told = (f"{1e3 * motion.cycle:g} ms from row to row, {1e3 * options.sample:g} asked for", "the first row")
    return [even, worst("control cycle and start", "s", wrong, JITTER_S, told)]


def _home(motion: Motion, wanted: tuple[Array, Array]) -> Check:
    ends = np.hstack([motion.q, motion.external])[[0, -1]]
    off = np.degrees(np.abs(ends - np.array(wanted)).max(axis=1))  # a metre of a slide counts as a radian
    return worst("from home to home", "deg", off, HOME_DEG, ("the first row", "the last row"))


def _limits(motion: Motion, cell: Cell) -> list[Check]:
    q = np.hstack([motion.q, motion.external])
    limits = cell.limits
    beyond = np.maximum(limits.lower - q, q - limits.upper)
    n, j = np.unravel_index(np.argmax(beyond), beyond.shape)
    slides = j >= len(cell.home) and cell.external_prismatic[j - len(cell.home)]
    far = float(1e3 * beyond[n, j] if slides else np.degrees(beyond[n, j]))
    unit = "mm" if slides else "deg"
    out = [
        Check(
            name="joint positions",
            passed=bool(beyond[n, j] <= 1e-8),
            value=far,
            limit=0.0,
            unit=f"{unit} beyond the limit",
            where=f"{axis_name(int(j))}, {motion.at(int(n))}",
            beyond=unit,
        )
    ]
    x = np.vstack([np.repeat(q[:1], 3, axis=0), q, np.repeat(q[-1:], 3, axis=0)])
    orders = (
        (Promise.VELOCITY, limits.velocity, VELOCITY),
        (Promise.ACCELERATION, limits.acceleration, ACCELERATION),
        (Promise.JERK, limits.jerk, JERK),
    )
    for name, limit, most in orders:
        x = np.diff(x, axis=0) / motion.cycle
        ratio = np.abs(x) / limit
        n, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        where = f"{axis_name(int(j))}, {motion.at(int(np.clip(n - 2, 0, len(q) - 1)))}"
        out.append(
            Check(
                name=name,
                passed=bool(ratio[n, j] <= most),
                value=float(ratio[n, j]),
                limit=most,
                unit="of the limit",
                where=where,
            )
        )
    return out


def axis_name(j: int) -> str:
    """An axis as reports call it, counted from 0: those of the arm, then the external ones."""
    return f"axis {j + 1}" if j < ARM else f"external axis e{j + 1 - ARM}"
