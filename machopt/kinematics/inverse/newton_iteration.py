"""Compiled Newton iteration and path tracking on the six lines of an arm; every result is checked against its pose.

Newton step: J(q) Δq = e, with e the twist from the present pose to the target (linear part first) and J the
geometric Jacobian at the flange. Kernels work on flat lists of (pose, start) pairs and never raise: a pair that
does not converge returns NaN.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from machopt.kinematics.inverse.compiled_vectors import add_vectors, rotate_vector, wrap_angle
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

CONVERGED = 1e-12  # m and rad: three digits below the accuracy of solve, three above rounding at an arm's length
ACCEPTED = 1e-10  # m and rad: near a singularity rounding prevents CONVERGED
MAX_NEWTON_STEP_RAD = 0.5  # rad, the longest Newton step from a rough start
MAX_TRACKING_STEP_RAD = 0.35  # rad a joint may turn in one tracking step; beyond it the step is halved
MAX_TRACKING_HALVINGS = 7  # the shortest tracking step is 2⁻⁷ of the way between two neighbours


@jit_compile
def _compute_pose_and_jacobian(axis: Array, point: Array, end: Array, q: Array, J: Array, T: Array) -> None:
    """Fill the pose T (4, 4) and the Jacobian J (6, 6) at q, in base_link axes at the flange's origin."""
    R = np.empty((3, 3))
    for k in range(3):
        for j in range(3):
            R[k, j] = 1.0 if k == j else 0.0
    p, d = np.zeros(3), np.empty(3)
    origin = np.empty((6, 3))
    for i in range(6):
        x, y, z = axis[i, 0], axis[i, 1], axis[i, 2]
        c, s = math.cos(q[i]), math.sin(q[i])
        v = 1.0 - c
        r00, r01, r02 = c + x * x * v, x * y * v - z * s, x * z * v + y * s
        r10, r11, r12 = x * y * v + z * s, c + y * y * v, y * z * v - x * s
        r20, r21, r22 = x * z * v - y * s, y * z * v + x * s, c + z * z * v
        a, b, e = point[i, 0], point[i, 1], point[i, 2]
        d[0] = a - (r00 * a + r01 * b + r02 * e)
        d[1] = b - (r10 * a + r11 * b + r12 * e)
        d[2] = e - (r20 * a + r21 * b + r22 * e)
        for k in range(3):
            m0, m1, m2 = R[k, 0], R[k, 1], R[k, 2]
            J[3 + k, i] = m0 * x + m1 * y + m2 * z
            origin[i, k] = p[k] + m0 * a + m1 * b + m2 * e
            p[k] += m0 * d[0] + m1 * d[1] + m2 * d[2]
            R[k, 0] = m0 * r00 + m1 * r10 + m2 * r20
            R[k, 1] = m0 * r01 + m1 * r11 + m2 * r21
            R[k, 2] = m0 * r02 + m1 * r12 + m2 * r22
    for k in range(3):
        T[k, 3] = p[k] + R[k, 0] * end[0, 3] + R[k, 1] * end[1, 3] + R[k, 2] * end[2, 3]
        for j in range(3):
            T[k, j] = R[k, 0] * end[0, j] + R[k, 1] * end[1, j] + R[k, 2] * end[2, j]
    for i in range(6):
        lx, ly, lz = T[0, 3] - origin[i, 0], T[1, 3] - origin[i, 1], T[2, 3] - origin[i, 2]
        wx, wy, wz = J[3, i], J[4, i], J[5, i]
        J[0, i] = wy * lz - wz * ly
        J[1, i] = wz * lx - wx * lz
        J[2, i] = wx * ly - wy * lx


@jit_compile
def _compute_pose_error(T: Array, goal: Array, e: Array) -> float:
    """Fill the twist e (6,) from T to goal and return max(|linear|, |angular|) in m, rad."""
    trace = 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        e[k] = goal[k, 3] - T[k, 3]
        v = 0.0
        for m in range(3):
            v += goal[j, m] * T[i, m] - goal[i, m] * T[j, m]
            trace += goal[k, m] * T[k, m]
        e[3 + k] = v
    s = 0.5 * math.sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])
    angle = math.atan2(s, 0.5 * (trace - 1.0))
    scale = 0.5 if s < 1e-8 else 0.5 * angle / s
    for k in range(3):
        e[3 + k] = scale * e[3 + k]
    return max(math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), angle)


@jit_compile
def _solve_linear_system(A: Array, b: Array) -> bool:
    """Solve A x = b in place of b by elimination with row pivoting; False where A is singular to rounding."""
    for c in range(6):
        best = c
        for r in range(c + 1, 6):
            if abs(A[r, c]) > abs(A[best, c]):
                best = r
        if abs(A[best, c]) < 1e-14:
            return False
        if best != c:
            for k in range(c, 6):
                A[c, k], A[best, k] = A[best, k], A[c, k]
            b[c], b[best] = b[best], b[c]
        for r in range(c + 1, 6):
            f = A[r, c] / A[c, c]
            if f != 0.0:
                for k in range(c + 1, 6):
                    A[r, k] -= f * A[c, k]
                b[r] -= f * b[c]
    for c in range(5, -1, -1):
        for k in range(c + 1, 6):
            b[c] -= A[c, k] * b[k]
        b[c] /= A[c, c]
    return True


@jit_compile
def _iterate_newton(
    axis: Array, point: Array, end: Array, goal: Array, q: Array, iterations: int, J: Array, T: Array, e: Array
) -> float:
    """Iterate from q (6,) in place to the pose ``goal`` (4, 4); return the remaining error. J, T and e are
    overwritten.
    """
    error = 0.0
    for i in range(iterations + 1):
        _compute_pose_and_jacobian(axis, point, end, q, J, T)
        error = _compute_pose_error(T, goal, e)
        # written so that NaN leaves the loop as well
        if not error > CONVERGED or i == iterations or not _solve_linear_system(J, e):
            break
        longest = 0.0
        for c in range(6):  # whole-array operations take three times as long to compile
            longest = max(longest, abs(e[c]))
        for c in range(6):
            q[c] += e[c] * min(1.0, MAX_NEWTON_STEP_RAD / longest) if longest > MAX_NEWTON_STEP_RAD else e[c]
    return error


@jit_compile
def solve_from_rough_starts(
    axis: Array, point: Array, end: Array, goal: Array, pose_of: NDArray[np.int64], q0: Array, iterations: int
) -> tuple[Array, Array]:
    """Run Newton's method from rough starts.

    Args:
        axis: (6, 3) unit, lines of the arm in base_link at q = 0.
        point: (6, 3) m, a point of each.
        end: (4, 4) flange pose at q = 0.
        goal: (M, 4, 4) target flange poses.
        pose_of: (K,) pose of each start.
        q0: (K, 6) rad.
        iterations: maximum number of steps.

    Returns:
        q (K, 6) rad, unwrapped, and the remaining error (K,) in m, rad (the larger).
    """
    q, error = q0.copy(), np.empty(len(q0))
    J, T, e = np.empty((6, 6)), np.zeros((4, 4)), np.empty(6)
    for k in range(len(q0)):
        error[k] = _iterate_newton(axis, point, end, goal[pose_of[k]], q[k], iterations, J, T, e)
    return q, error


@jit_compile
def compute_pose_deviation(axis: Array, point: Array, end: Array, q: Array, goal: Array) -> float:
    """Return an upper bound of the pose error to first order, m and rad, the larger.

    A rotation by an angle moves the axes x and y of the flange by at least that much, taken together.

    Args:
        axis: (6, 3) unit, lines of the arm in base_link at q = 0.
        point: (6, 3) m, a point of each.
        end: (4, 4) flange pose at q = 0.
        q: (6,) rad.
        goal: (4, 4) target flange pose.
    """
    x, y, t = (end[0, 0], end[1, 0], end[2, 0]), (end[0, 1], end[1, 1], end[2, 1]), (end[0, 3], end[1, 3], end[2, 3])
    for k in range(6):
        i = 5 - k
        h, c, s = (axis[i, 0], axis[i, 1], axis[i, 2]), math.cos(q[i]), math.sin(q[i])
        p = (point[i, 0], point[i, 1], point[i, 2])
        x, y = rotate_vector(h, c, s, x), rotate_vector(h, c, s, y)
        t = add_vectors(p, rotate_vector(h, c, s, (t[0] - p[0], t[1] - p[1], t[2] - p[2])))
    way, turn = 0.0, 0.0
    for r in range(3):
        way += (t[r] - goal[r, 3]) ** 2
        turn += (x[r] - goal[r, 0]) ** 2 + (y[r] - goal[r, 1]) ** 2
    return math.sqrt(max(way, turn))


@jit_compile
def polish_branches(
    axis: Array, point: Array, end: Array, goal: Array, q: Array, iterations: int, farthest: float
) -> None:
    """Refine branches that are nearly at their poses by Newton's method, in place.

    The results are in (−π, π]; NaN where the remaining error is above ACCEPTED, or a joint moved by more than
    ``farthest``, which indicates another branch.

    Args:
        axis: (6, 3) unit, lines of the arm in base_link at q = 0.
        point: (6, 3) m, a point of each.
        end: (4, 4) flange pose at q = 0.
        goal: (M, 4, 4) target flange poses.
        q: (M, B, 6) rad; changed.
        iterations: maximum number of steps.
        farthest: rad.
    """
    J, T, e, here = np.empty((6, 6)), np.zeros((4, 4)), np.empty(6), np.empty(6)
    for m in range(len(q)):
        for b in range(q.shape[1]):
            if not math.isfinite(q[m, b, 0]):
                continue
            for i in range(6):
                here[i] = q[m, b, i]
            if compute_pose_deviation(axis, point, end, q[m, b], goal[m]) <= CONVERGED:  # already converged
                met = True
            else:
                met = not _iterate_newton(axis, point, end, goal[m], here, iterations, J, T, e) > ACCEPTED
            for i in range(6):
                met = met and not abs(here[i] - q[m, b, i]) > farthest
            for i in range(6):
                q[m, b, i] = wrap_angle(here[i]) if met else math.nan


@jit_compile
def _interpolate_pose(A: Array, B: Array, t: float, out: Array) -> None:
    """Write the pose at share t from A to B: straight line of the origin, constant rotation about one axis."""
    D = np.ascontiguousarray(B[:3, :3]) @ np.ascontiguousarray(A[:3, :3].T)
    v = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    s = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    angle = t * np.arctan2(s, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    if s > 0.0:
        v = v / s
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    R = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    out[:3, :3] = R @ np.ascontiguousarray(A[:3, :3])
    out[:3, 3] = A[:3, 3] + t * (B[:3, 3] - A[:3, 3])


@jit_compile
def track_solutions(
    axis: Array, point: Array, end: Array, poses: Array, start: NDArray[np.int64], goal: NDArray[np.int64], q0: Array
) -> Array:
    """Track one solution from pose to neighbouring pose.

    The full step is taken when Newton contracts at once and no joint moves more than MAX_TRACKING_STEP_RAD; otherwise
    it is halved, so that the result is the continuation of the given solution and not another branch.

    Args:
        axis: (6, 3) unit, lines of the arm in base_link at q = 0.
        point: (6, 3) m, a point of each.
        end: (4, 4) flange pose at q = 0.
        poses: (M, 4, 4) flange poses.
        start: (K,) index into poses.
        goal: (K,) index into poses.
        q0: (K, 6) rad, solution at the start.

    Returns:
        (K, 6) rad, unwrapped; NaN where the solution ends on the way (a fold) or passes too near a singularity.
    """
    out = np.full(q0.shape, np.nan)
    J, T, e = np.empty((6, 6)), np.eye(4), np.empty(6)
    target = np.eye(4)
    for k in range(len(q0)):
        A, B = poses[start[k]], poses[goal[k]]
        q, t, h = q0[k].copy(), 0.0, 1.0
        shortest = 0.5**MAX_TRACKING_HALVINGS
        while t < 1.0 and h >= shortest:
            if t + h >= 1.0:
                target[:] = B
            else:
                _interpolate_pose(A, B, t + h, target)
            trial, last, good = q.copy(), np.inf, False
            for _ in range(8):
                _compute_pose_and_jacobian(axis, point, end, trial, J, T)
                error = _compute_pose_error(T, target, e)
                if error < CONVERGED:
                    good = True
                    break
                if not error < 0.5 * last:
                    good = error < ACCEPTED
                    break
                last = error
                if not _solve_linear_system(J, e):
                    break
                trial += e
                if np.max(np.abs(trial - q)) > MAX_TRACKING_STEP_RAD:
                    break
            if good:
                q, t, h = trial, t + h, 2.0 * h
            else:
                h *= 0.5
        if t >= 1.0:
            out[k] = q
    return out


@jit_compile
def remove_duplicate_solutions(
    q: Array, pose_of: NDArray[np.int64], error: Array, poses: int, width: int, same: float
) -> Array:
    """Return solutions sorted into rows (poses, width, 6), without duplicates, then NaN; errors above ACCEPTED are
    dropped.

    Two solutions are equal when every joint agrees to ``same`` modulo a full turn.

    Args:
        q: (K, 6) rad, solutions.
        pose_of: (K,) pose of each.
        error: (K,) remaining error in m or rad.
        poses: number of poses.
        width: maximum number of solutions per pose.
        same: rad.
    """
    out = np.full((poses, width, 6), np.nan)
    count = np.zeros(poses, np.int64)
    for k in range(len(q)):
        m = pose_of[k]
        if not error[k] <= ACCEPTED or count[m] == width:
            continue
        new = True
        for b in range(count[m]):
            worst = 0.0
            for i in range(6):
                d = (q[k, i] - out[m, b, i]) / (2.0 * np.pi)
                worst = max(worst, abs(d - np.round(d)) * 2.0 * np.pi)
            if worst < same:
                new = False
                break
        if new:
            for i in range(6):
                out[m, count[m], i] = np.pi - (np.pi - q[k, i]) % (2.0 * np.pi)
            count[m] += 1
    return out
