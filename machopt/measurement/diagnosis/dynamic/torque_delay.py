"""Delay of the recorded torques behind the recorded angles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.dynamic.friction import (
    compute_reversal_signal,
    fit_least_squares,
)
from machopt.measurement.diagnosis.dynamic.time_delays import LONGEST, find_best_delay
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel
from machopt.numerics.array_types import Array

SESSION_GAP = 1_000_000  # s between sessions, whose clocks may restart
DELAY_REVERSAL_SHAPES = ((0.0, 0.0), (5e-5, 0.0), (2e-4, 0.0), (0.0, 0.01), (0.0, 0.05))


def estimate_torque_delay(
    scene: MotionModel, measured: Array, load: Array
) -> tuple[float, bool, Callable[[float], Array]]:
    """Estimate the delay of the torques.

    Returns the delay in s, whether most joints clearly improve with it, and a function that returns the torque (M, n)
    delayed by d. Friction and motor inertia of each joint are refitted at every delay. Friction is delayed together
    with the rigid-body torque because it changes at reversals. ``load`` (N, n, p) holds the columns of an unmodelled
    payload or spring, whose torque is out of phase with the prediction as a delay is; they are refitted too. Readings
    around reversals are left out: encoder steps and dwells give wrong times there, and friction reverses by laws of
    its own.
    """
    m = scene.motion
    assert scene.predicted is not None
    predicted = scene.predicted
    moving = [j for j in range(scene.joints) if scene.is_joint_moving(j)]
    tau = m.subtract_period_mean(m.average_blocks(measured))
    at = m.average_blocks(m.time + SESSION_GAP * m.session)
    under_way = {j: _select_moving_readings(scene, j) for j in moving}

    def carried(d: float, j: int) -> Array:
        """(N, p) of the load, late; it is smooth, so that averages will do."""
        return m.subtract_period_mean(np.stack([np.interp(at - d, at, x) for x in load[:, j].T], axis=1))

    def smooth(d: float) -> tuple[Array, Array, Array]:
        return m.delay_cubic(predicted, d), m.delay_cubic(m.v, d), m.delay_cubic(m.a, d)

    def turning(v: Array, j: int, k: int, d: float) -> Array:
        # from the delayed speed: a delayed step between two samples would become a ramp
        if k < len(DELAY_REVERSAL_SHAPES):
            return compute_reversal_signal(scene, v[:, j], DELAY_REVERSAL_SHAPES[k])
        # as with a recorder that aligns two clocks by linear interpolation
        return m.delay_linear(
            compute_reversal_signal(scene, m.v[:, j], DELAY_REVERSAL_SHAPES[k - len(DELAY_REVERSAL_SHAPES)]), d
        )

    def parts(
        d: float, j: int, late: tuple[Array, Array, Array], turns: int = len(DELAY_REVERSAL_SHAPES)
    ) -> tuple[Array, Array, Array]:
        """(N,) torque of a joint less the rigid bodies', what is refitted beside (N, p), friction by path (N, k)."""
        body, v, a = late
        z = [turning(v, j, k, d) for k in range(turns)]
        signals = (body[:, j], np.ones(len(v)), v[:, j], a[:, j], *z)
        X = m.subtract_period_mean(np.stack([m.average_blocks(x) for x in signals], axis=1))
        return tau[:, j] - X[:, 0], np.concatenate([X[:, 1:4], carried(d, j)], axis=1), X[:, 4:]

    def left(d: float) -> list[float]:
        """Mean square that each moving joint leaves while under way, by the breakaway path that leaves least."""
        late, out = smooth(d), []
        for j in moving:
            y, other_columns, z = (x[under_way[j]] for x in parts(d, j, late))
            size = np.linalg.norm(other_columns, axis=0)
            Q, _ = np.linalg.qr(other_columns[:, size > 0] / size[size > 0])
            y, z = (x - Q @ (Q.T @ x) for x in (y, z))
            gains = (y @ z) ** 2 / np.maximum(np.sum(z**2, axis=0), 1e-300)
            out.append(float(y @ y - gains.max()) / len(y))
        return out

    power = np.array(left(0.0))

    def misfit(d: float) -> float:
        return float(np.sum(np.log(np.maximum(left(d), 0.0) + 1e-6 * power)))

    best = find_best_delay(misfit) if moving else 0.0
    # an insignificant delay would still smear each reversal over several samples
    worth = len(tau) * (misfit(0.0) - misfit(best)) >= thresholds.LEVELS.min_gain
    shared = worth and 2 * int(np.sum(np.array(left(best)) < power)) > len(moving)
    fitted, late = [], smooth(best)
    for j in moving:
        y, other_columns, z = parts(best, j, late, 2 * len(DELAY_REVERSAL_SHAPES))
        each = [
            (*fit_least_squares(y, np.concatenate([other_columns[:, :3], x[:, None], other_columns[:, 3:]], axis=1)), k)
            for k, x in enumerate(z.T)
        ]
        fitted.append(min(each, key=lambda f: float(f[0] @ f[0])))

    def rough(d: float) -> Array:
        body, v, a = smooth(d)
        out = body.copy()
        for j, (_, x, k) in zip(moving, fitted, strict=True):
            out[:, j] += x[0] + x[1] * v[:, j] + x[2] * a[:, j] + x[3] * turning(v, j, k, d)
        return out

    return best, shared, rough


def _select_moving_readings(scene: MotionModel, joint: int) -> NDArray[np.bool_]:
    """Return readings (N,) around which a joint does not reverse within the longest delay; all if these are few."""
    m = scene.motion
    v = m.average_blocks(m.v[:, joint])
    fast = float(np.quantile(np.abs(v), 0.9)) * thresholds.SHARES.relevant
    window = 2 * int(np.ceil(LONGEST / max(float(np.median(np.diff(m.average_blocks(m.time)))), 1e-6))) + 1
    near = np.lib.stride_tricks.sliding_window_view(np.pad(v, window // 2, mode="symmetric"), window)
    low, high = near.min(axis=1), near.max(axis=1)
    out = (low > fast) | (high < -fast)
    return out if out.mean() > thresholds.SHARES.minority else np.ones(len(v), bool)
