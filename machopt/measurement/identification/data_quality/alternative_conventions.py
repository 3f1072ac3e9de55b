"""Alternative conventions of a recording: which frame, sign or reference point makes the load explain the
displacement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.effects.recording.record_faults import FORCES
from machopt.kinematics.robot import Robot
from machopt.measurement.estimation.bounded_least_squares import RANK, minimise_bounded_quadratic
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import (
    estimate_robust_scale,
    fit_least_absolute_deviations,
    sum_absolute_deviations,
)
from machopt.numerics.array_types import Array

STEPS = 12
ZERO_GRADIENT = 1e-12  # relative
MOST_RADIANS = 6.3  # one turn; angles in degrees below it would mean an arm that hardly moved
MOST_READINGS = 600  # sufficient to distinguish frames


@dataclass(frozen=True, kw_only=True)
class ConventionCandidate:
    """How well one convention explains the recording."""

    name: str
    message: str  # what is wrong if this convention is right, and how to correct it
    unexplained: float  # Σ|y − A x| / Σ|y| with compliances ≥ 0: 0 perfect, 1 nothing explained
    by_pose: Array  # (G,) the same by pose
    compliance: Array  # (6,) rad/(N·m)
    effect: Array  # (6,) mean displacement by each joint relative to the measured one


def build_convention_candidates(
    experiment: LoadTestExperiment, robot: Robot, T_flange_tcp: Array
) -> list[ConventionCandidate]:
    """Evaluate the stated convention and its alternatives.

    Args:
        experiment: Load tests as stated.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        The candidates, the stated one first.
    """
    e = experiment.select_readings(_select_spread_readings(len(experiment)))
    cases = _list_frame_cases(e)
    if e.wrench[:, 3:].any():
        cases += _list_moment_cases(e, robot.compute_fk(e.state.q)[:, :3, 3])
    out = [_evaluate_convention(e, *case) for case in cases]
    turns = _interpret_joints_as_radians(e, robot, T_flange_tcp)
    return out if turns is None else [*out, turns]


ConventionCase = tuple[str, str, Array, Array]  # code, message, wrenches (N, 6), displacements (N, D)


def _list_frame_cases(e: LoadTestExperiment) -> list[ConventionCase]:
    """Return the stated convention, and those with other frames or the opposite sign of the load."""
    R = e.T_base_tcp[:, :3, :3]
    stated_wrench, stated_displacement = e.stated_frames

    def other(frame: str) -> tuple[str, Callable[[Array], Array]]:
        """The frame that is not stated, and columns read in it."""
        if frame == "base":
            return "tool", lambda v: np.einsum("nij,nbj->nbi", R, v.reshape(len(v), -1, 3)).reshape(v.shape)
        return "base", lambda v: np.einsum("nji,nbj->nbi", R, v.reshape(len(v), -1, 3)).reshape(v.shape)

    frame_w, turn_w = other(stated_wrench)
    frame_d, turn_d = other(stated_displacement)
    turned_w, turned_d = turn_w(e.wrench), turn_d(e.measured)
    said_w = f"wrench_frame is stated (or taken) as {stated_wrench}, but the loads fit in {frame_w} axes"
    said_d = f"displacement_frame is stated (or taken) as {stated_displacement}, but the displacements fit in {frame_d}"
    return [
        ("stated", "", e.wrench, e.measured),
        ("displacement_frame", f"{said_d} axes; displacement_frame: {frame_d} would work", e.wrench, turned_d),
        ("wrench_frame", f"{said_w}; wrench_frame: {frame_w} would work", turned_w, e.measured),
        (
            "frames",
            f"wrench and displacement are stated (or taken) in {stated_wrench} and {stated_displacement} "
            f"axes, but fit in {frame_w} and {frame_d} axes; other frames in recording.yaml would work",
            turned_w,
            turned_d,
        ),
        (
            "load_sign",
            "the arm moves against its load: the columns hold the load on the tool or the sensor, not the "
            "one on the robot; all forces and moments with the opposite sign would work",
            -e.wrench,
            e.measured,
        ),
    ]


def _list_moment_cases(e: LoadTestExperiment, flange: Array) -> list[ConventionCase]:
    """Return the conventions with other points of the moments, and other units; ``flange`` (N, 3) m."""
    p, force, moment = e.T_base_tcp[:, :3, 3], e.wrench[:, :3], e.wrench[:, 3:]
    about_base = np.concatenate([force, moment - np.cross(p, force)], axis=1)
    about_flange = np.concatenate([force, moment + np.cross(flange - p, force)], axis=1)
    cases = [
        (
            "moment_at_base",
            "the moments are about the origin of base_link, not about the TCP; moments about the "
            "TCP, m − p × f, would work",
            about_base,
            e.measured,
        ),
        (
            "moment_at_flange",
            "the moments are about the flange, not about the TCP; wrench_point_mm: [0, 0, 0] would work",
            about_flange,
            e.measured,
        ),
    ]
    for unit, newtons in FORCES.items():  # forces and moments in inconsistent units
        as_newtons = np.concatenate(
            [force * newtons, moment + (newtons - 1.0) * np.cross(e.lever_length, force)], axis=1
        )
        what = f"the columns fx_N … seem to hold {unit}" + (" (or mx_Nm … N·mm)" if newtons == 1e3 else "")
        cases.append(
            (
                "force_units",
                f"forces and moments fit each other only where {what}; newtons and N·m would work",
                as_newtons,
                e.measured,
            )
        )
    return cases


def _interpret_joints_as_radians(
    e: LoadTestExperiment, robot: Robot, T_flange_tcp: Array
) -> ConventionCandidate | None:
    """Return the candidate with the columns q1_deg … in radians; None if the values are too large."""
    q = np.degrees(e.state.q)
    if np.abs(q).max() > MOST_RADIANS or not q.any():
        return None
    state = robot.compute_state(q, T_flange_tcp, bodies=True)
    there, R = state.T_base_tool, np.swapaxes(e.T_base_tcp[:, :3, :3], 1, 2)
    turn = there[:, :3, :3] @ R
    parts = []
    for v, frame in zip((e.wrench, e.measured), e.stated_frames, strict=True):
        turned = np.einsum("nij,nbj->nbi", turn, v.reshape(len(v), -1, 3)).reshape(v.shape)
        parts.append(turned if frame == "tool" else v)
    return _evaluate_convention(
        replace(e, state=state, T_base_tcp=there),
        "joint_units",
        "the columns q1_deg … q6_deg seem to hold radians; degrees would work",
        *parts,
    )


def _evaluate_convention(
    e: LoadTestExperiment, name: str, message: str, wrench: Array, measured: Array
) -> ConventionCandidate:
    other = replace(e, wrench=wrench, measured=measured)
    A, y = other.response()[..., : other.joint_count], measured
    size = np.repeat([max(estimate_robust_scale(y[:, c : c + 3]), 1e-15) for c in range(0, y.shape[1], 3)], 3)
    A, y = A / size[:, None], y / size
    x = fit_bounded_absolute_deviations(
        A, y, np.linalg.norm(wrench[:, :3], axis=1) + np.linalg.norm(wrench[:, 3:], axis=1)
    )
    wrong, whole = np.abs(y - A @ x).sum(axis=1), np.abs(y).sum(axis=1)
    _, pose = np.unique(e.pose, return_inverse=True)
    by_pose = np.bincount(pose.reshape(-1), wrong) / np.maximum(np.bincount(pose.reshape(-1), whole), 1e-300)
    total = max(float(whole.sum()), 1e-300)
    effect = np.abs(A).sum(axis=(0, 1)) * x / total
    return ConventionCandidate(
        name=name, message=message, unexplained=float(wrong.sum() / total), by_pose=by_pose, compliance=x, effect=effect
    )


def fit_bounded_absolute_deviations(A: Array, y: Array, load: Array) -> Array:
    """Fit non-negative coefficients by least absolute deviations of readings divided by their load.

    Args:
        A: (N, D, P) columns.
        y: (N, D) displacements.
        load: (N,) magnitude of each load.

    Returns:
        (P,) coefficients.
    """
    free = fit_least_absolute_deviations(A, y, load)
    if (free >= 0).all():
        return free
    typical = np.median(load[load > 0]) if (load > 0).any() else 1.0
    row = typical / np.maximum(load, typical)
    X, z = (A * row[:, None, None]).reshape(-1, A.shape[2]), (y * row[:, None]).reshape(-1)
    column = np.sqrt(np.mean(X**2, axis=0))
    column = np.where(column > 0, column, 1.0)
    X, z = np.ascontiguousarray(X / column), np.ascontiguousarray(z)
    H, h = X.T @ X, X.T @ z
    x = minimise_bounded_quadratic(H, h, np.zeros(len(h)))
    for _ in range(1, STEPS):
        H, h = sum_absolute_deviations(X, z, x, 1e-12)
        x = _minimise_from(H, h, x > 0)
    return np.asarray(x / column)


def _minimise_from(H: Array, h: Array, positive: NDArray[np.bool_]) -> Array:
    """Minimise ½ xᵀ H x − hᵀ x, x ≥ 0, with the positive coefficients of a similar problem where these are the right
    ones (Karush–Kuhn–Tucker conditions).
    """
    x, diagonal = np.zeros(len(h)), np.diag(H)[positive]
    if positive.any() and diagonal.min() > 0.0:
        unit = 1.0 / np.sqrt(diagonal)
        own = H[positive][:, positive] * np.outer(unit, unit)
        if np.linalg.eigvalsh(own)[0] > RANK:  # not two parallel columns
            x[positive] = unit * np.linalg.solve(own, unit * h[positive])
            if (x >= 0).all() and (h <= H @ x + ZERO_GRADIENT * np.abs(h).max()).all():
                return x
    return minimise_bounded_quadratic(H, h, np.zeros(len(h)))


def _select_spread_readings(count: int) -> NDArray[np.int64]:
    """Return evenly spaced reading indices."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_READINGS)).astype(np.int64))
