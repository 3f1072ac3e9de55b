"""Axes of the force sensor or of the displacement that are rotated by any angle, fitted to load tests.

The rotation is an unknown like the compliances: w = R_F Q w_recorded or δ = R_F Q δ_recorded, with F the base or the
tool. It is fitted by Gauss–Newton (displacements: Wahba 1965) from the 24 rotations of a cube. A soft base, link or
tool rotates displacements too. Therefore both readings, stated and rotated, have springs at every body beside the
joints, and a rotation is accepted only where its evidence, with three numbers counted, is very strong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Literal

import numpy as np
from scipy.optimize import nnls

from machopt.data_types.measurements.recording import FrameName, Recording
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.estimation.convention_score import compute_description_cost, compute_pose_errors
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector, convert_vector_to_rotation

Quantity = Literal["wrench", "displacement"]
CODE = "sensor_axes"
MOST_READINGS = 300  # sufficient to fit a rotation
STARTS = 4  # best of the 24 starts that are refined
STEPS = 20  # Gauss–Newton steps
SMALL_STEP = 1e-7  # rad, at which the fit has converged
ROBUST_STEPS = 4  # fits with robust weights
CAUCHY = 2.0  # robust standard deviations at which a reading counts half


@dataclass(frozen=True, kw_only=True)
class SensorRotation:
    """Fitted rotation of recorded axes."""

    quantity: Quantity
    frame: FrameName  # in which the rotation is constant
    rotation: Array  # (3, 3): true vector in ``frame`` = rotation · recorded vector
    by_pose: Array  # (G,) m, mean error of each pose
    cost: float  # −2 log evidence

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation, deg."""
        return float(np.degrees(np.linalg.norm(convert_to_rotation_vector(self.rotation))))

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with its axes turned back.

        Args:
            recording: Load tests as recorded.
        """
        if self.quantity == "wrench":
            assert recording.wrench is not None  # load tests have loads
            return replace(recording, wrench=_rotate(recording.wrench, self.rotation), wrench_frame=self.frame)
        assert recording.displacement is not None  # load tests have displacements
        turned = _rotate(recording.displacement, self.rotation)
        return replace(recording, displacement=turned, displacement_frame=self.frame)

    def describe(self) -> str:
        """Return what is wrong if this rotation is right."""
        about = convert_to_rotation_vector(self.rotation)
        axis = ", ".join(f"{v:.2f}" for v in about / max(float(np.linalg.norm(about)), 1e-12))
        columns = "fx_N …" if self.quantity == "wrench" else "dx_mm …"
        return (
            f"the columns {columns} fit in axes that are turned by {self.angle_deg:.1f}° about ({axis}) against "
            f"{'base_link' if self.frame == 'base' else 'the tool'}"
        )


def find_rotated_axes(e: LoadTestExperiment, robot: Robot) -> SensorRotation | None:
    """Find a rotation of the recorded axes that explains load tests decisively better.

    Args:
        e: Load tests as stated.
        robot: Kinematic model of the arm.

    Returns:
        The rotation; None if the stated axes are as good, or if two different rotations are.
    """
    e = e.select_readings(np.unique(np.linspace(0, len(e) - 1, min(len(e), MOST_READINGS)).astype(np.int64)))
    poses = len(np.unique(e.pose))
    if poses < thresholds.COUNTS.min_groups or not e.wrench.any() or not e.measured.any():
        return None
    parts = _list_body_springs(e, robot)
    stated = _fit_all(e, parts, e.wrench, e.measured)
    size = float(np.mean(compute_pose_errors(e.pose, np.linalg.norm(e.measured[:, :3], axis=1))))
    if float(np.mean(stated)) < thresholds.SHARES.small * size:
        return None
    cost = compute_description_cost(stated)
    found = sorted(_list_fits(e, parts), key=lambda r: r.cost)
    best = found[0]
    decisive = cost - best.cost > thresholds.LEVELS.min_evidence and float(
        np.mean(best.by_pose)
    ) < thresholds.SHARES.majority * float(np.mean(stated))
    if not decisive or np.radians(best.angle_deg) < thresholds.LIMITS.large_rotation:
        return None
    rivals = [r for r in found[1:] if r.cost - best.cost < thresholds.LEVELS.min_evidence]
    return None if any(r.quantity != best.quantity for r in rivals) else _prefer_stated_frame(e, best, rivals)


def check_sensor_axes(e: LoadTestExperiment, robot: Robot) -> list[RecordFault]:
    """Return the fault of recorded axes that are rotated by any angle.

    Args:
        e: Load tests as stated.
        robot: Kinematic model of the arm.
    """
    found = find_rotated_axes(e, robot)
    if found is None:
        return []
    message = f"{found.describe()}; values in {found.frame} axes would work, as machopt diagnose writes them"
    return [
        RecordFault(
            code=CODE,
            severity="error",
            message=message,
            column="fx_N" if found.quantity == "wrench" else "dx_mm",
        )
    ]


def _prefer_stated_frame(e: LoadTestExperiment, best: SensorRotation, rivals: list[SensorRotation]) -> SensorRotation:
    """Return the rotation in the stated frame where the data do not decide between base and tool."""
    stated = e.stated_frames[0 if best.quantity == "wrench" else 1]
    return next((r for r in rivals if r.frame == stated), best) if best.frame != stated else best


def _list_fits(e: LoadTestExperiment, parts: list[_BodySpring]) -> Iterator[SensorRotation]:
    quantities: tuple[Quantity, ...] = ("wrench", "displacement")
    frames: tuple[FrameName, ...] = ("base", "tool")
    for quantity in quantities:
        for frame in frames:
            turn = _fit_rotation(e, quantity, frame)
            w, y = _apply_rotation(e, quantity, frame, turn)
            by_pose = _fit_all(e, parts, w, y)
            yield SensorRotation(
                quantity=quantity,
                frame=frame,
                rotation=turn,
                by_pose=by_pose,
                cost=compute_description_cost(by_pose, parameters=3),
            )


def _fit_rotation(e: LoadTestExperiment, quantity: Quantity, frame: FrameName) -> Array:
    """Return the rotation (3, 3) of the recorded axes that fits best, with compliances ≥ 0."""
    starts: list[tuple[float, Array]] = []
    for turn in _list_cube_rotations():
        starts.append((_compute_misfit(e, *_apply_rotation(e, quantity, frame, turn)), turn))
    starts.sort(key=lambda s: s[0])
    refined = [_refine(e, quantity, frame, turn) for _, turn in starts[:STARTS]]
    return min(refined, key=lambda r: r[0])[1]


def _refine(e: LoadTestExperiment, quantity: Quantity, frame: FrameName, turn: Array) -> tuple[float, Array]:
    """Return the mean error and the rotation after Gauss–Newton steps over compliances and rotation together."""
    J, axes = e.state.J, _read_axes(e, frame)
    n = e.joint_count
    c = np.zeros(n)
    for _ in range(STEPS):
        w, y = _apply_rotation(e, quantity, frame, turn)
        A = (J * np.einsum("nci,nc->ni", J, w)[:, None, :])[:, :3]
        D = np.empty((len(y), 3, 3))
        for k in range(3):
            about = axes[:, :, k]
            if quantity == "wrench":
                change = np.concatenate([np.cross(about, w[:, :3]), np.cross(about, w[:, 3:])], axis=1)
                D[:, :, k] = (J * (np.einsum("nci,nc->ni", J, change) * c)[:, None, :]).sum(axis=2)[:, :3]
            else:
                D[:, :, k] = -np.cross(about, y[:, :3])
        r = y[:, :3] - A @ c
        size = np.linalg.norm(r, axis=1)
        weight = 1.0 / np.sqrt(1.0 + (size / max(CAUCHY * float(np.median(size)), 1e-12)) ** 2)
        X = np.concatenate([A, D], axis=2) if c.any() else A
        scale = np.maximum(np.sqrt(np.mean(X**2, axis=(0, 1))), 1e-300)
        rows = (X / scale * weight[:, None, None]).reshape(-1, X.shape[2])
        b = (y[:, :3] * weight[:, None]).reshape(-1)
        free = np.linalg.lstsq(rows, b, rcond=1e-10)[0] / scale
        if (free[:n] < 0).any():  # springs do not push: the bounded fit of the springs alone, then the rotation
            free[:n] = nnls(rows[:, :n], b)[0] / scale[:n]
        c, step = free[:n], free[n:]
        if len(step):
            length = float(np.linalg.norm(step))
            turn = convert_vector_to_rotation(step * min(1.0, 0.5 / max(length, 1e-12))) @ turn
            if length < SMALL_STEP:
                break
    return _compute_misfit(e, *_apply_rotation(e, quantity, frame, turn)), turn


def _read_axes(e: LoadTestExperiment, frame: FrameName) -> Array:
    """Return the axes (N, 3, 3) of a frame in base_link."""
    R = e.T_base_tcp[:, :3, :3]
    return R if frame == "tool" else np.broadcast_to(np.eye(3), R.shape)


def _apply_rotation(e: LoadTestExperiment, quantity: Quantity, frame: FrameName, turn: Array) -> tuple[Array, Array]:
    """Return loads (N, 6) and displacements (N, D) in base_link for a rotation of the recorded axes."""
    stated = e.stated_frames[0 if quantity == "wrench" else 1]
    M = _read_axes(e, frame) @ turn @ np.swapaxes(_read_axes(e, stated), 1, 2)
    if quantity == "displacement":
        return e.wrench, _rotate_each(e.measured, M)
    lever = e.lever_length
    own = e.wrench.copy()
    own[:, 3:] -= np.cross(lever, own[:, :3])  # moments about the point that the sensor refers to
    own = _rotate_each(own, M)
    own[:, 3:] += np.cross(lever, own[:, :3])
    return own, e.measured


def _compute_misfit(e: LoadTestExperiment, w: Array, y: Array) -> float:
    """Return the root sum of squares (m) that non-negative joint compliances leave of the translations."""
    J, row = e.state.J, _compute_row_weights(w)
    A = (J * np.einsum("nci,nc->ni", J, w)[:, None, :])[:, :3]
    A = A / np.maximum(np.sqrt(np.mean(A**2, axis=(0, 1))), 1e-300)
    return float(nnls((A * row[:, None, None]).reshape(-1, e.joint_count), (y[:, :3] * row[:, None]).reshape(-1))[1])


@dataclass(frozen=True)
class _BodySpring:
    """Point and axes where a body may yield, in base_link."""

    axes: Array  # (N, 3, 3)
    lever: Array  # (N, 3) m, from the point to the TCP

    def columns(self, w: Array) -> Array:
        """Return the translations (N, 3, 6) of the TCP by compliances along and about each axis.

        Args:
            w: (N, 6) N, N·m at the TCP.
        """
        moment = w[:, 3:] + np.cross(self.lever, w[:, :3])
        along = self.axes * np.einsum("nck,nc->nk", self.axes, w[:, :3])[:, None, :]
        about = np.stack([np.cross(self.axes[:, :, k], self.lever) for k in range(3)], axis=2)
        return np.concatenate([along, about * np.einsum("nck,nc->nk", self.axes, moment)[:, None, :]], axis=2)


def _list_body_springs(e: LoadTestExperiment, robot: Robot) -> list[_BodySpring]:
    """Return springs of the base, at the ends of the links 1 to 3, and of the tool."""
    s = e.state
    p, fixed = s.T_base_tool[:, :3, 3], np.broadcast_to(np.eye(3), (len(e), 3, 3))
    out = [_BodySpring(fixed, p), _BodySpring(s.T_base_tool[:, :3, :3], np.zeros_like(p))]
    if s.R_bodies is not None and s.p_bodies is not None:
        for body, joint in ((1, 1), (2, 2), (3, 4)):
            R = s.R_bodies[:, body]
            out.append(_BodySpring(R, p - R @ robot.point[joint] - s.p_bodies[:, body]))
    return out


def _fit_all(e: LoadTestExperiment, bodies: list[_BodySpring], w: Array, y: Array) -> Array:
    """Return the mean error (G,) m of each pose with springs at joints and bodies, compliances ≥ 0."""
    J = e.state.J
    joints = (J * np.einsum("nci,nc->ni", J, w)[:, None, :])[:, :3]
    A = np.concatenate([joints, *(b.columns(w) for b in bodies)], axis=2)
    A = A / np.maximum(np.sqrt(np.mean(A**2, axis=(0, 1))), 1e-300)
    row = _compute_row_weights(w)
    weight = row
    for _ in range(ROBUST_STEPS):
        X, b = (A * weight[:, None, None]).reshape(-1, A.shape[2]), (y[:, :3] * weight[:, None]).reshape(-1)
        r = np.linalg.norm(y[:, :3] - A @ nnls(X, b)[0], axis=1) * row
        weight = row / np.sqrt(1.0 + (r / max(CAUCHY * float(np.median(r)), 1e-12)) ** 2)
    return compute_pose_errors(e.pose, r)


def _compute_row_weights(w: Array) -> Array:
    """Return weights (N,) that limit the influence of large loads: 1 up to the median force."""
    size = np.linalg.norm(w[:, :3], axis=1)
    usual = max(float(np.median(size)), 1e-9)
    return np.asarray(usual / np.maximum(size, usual))


def _list_cube_rotations() -> Iterator[Array]:
    """Yield the 24 rotations that map a cube onto itself, the identity first."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), order] = sign
            if np.linalg.det(M) > 0:
                yield M


def _rotate(v: Array, M: Array) -> Array:
    return np.concatenate([v[:, a : a + 3] @ M.T for a in range(0, v.shape[1], 3)], axis=1)


def _rotate_each(v: Array, M: Array) -> Array:
    return np.concatenate([np.einsum("nij,nj->ni", M, v[:, a : a + 3]) for a in range(0, v.shape[1], 3)], axis=1)
