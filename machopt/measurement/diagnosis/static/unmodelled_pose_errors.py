"""Forms in measured poses that are no effect of the catalogue, tried if a mismatch remains or one form replaces
several effects.

A vertical temperature gradient bends the tracker's beam: points shift depending on their position, unlike a rigid
frame. The axis of a joint with an out-of-round bearing or bent seat wobbles: its frame moves by harmonics of the
joint's own angle, unlike another joint's constant frame error. A hose or cable with a spring pulls at a link
depending on its position, through the preceding joints, unlike a weight. A taut one is stiff along its direction and
soft across, so that its stiffness is a symmetric matrix. Source: Estler, Edmundson, Peggs & Parker 2002 (refraction
of a laser tracker's beam); ISO 230-7 (tilt and radial error motions of an axis of rotation, by harmonic orders).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np

from machopt.data_types.effect_locations import format_joint_location, format_link_location
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.measurement.diagnosis.effect_columns import as_built_joint_frames
from machopt.measurement.diagnosis.model_selection.unmodelled_slip_and_external_forces import (
    build_uncatalogued_hypothesis,
)
from machopt.numerics.array_types import Array

REFRACTION_LAW, AXIS_WOBBLE_LAW, NEIGHBOUR_JOINT_LAW = (
    "bends the line of sight",
    "error motion of an axis",
    "nods into the next axes",
)
POINT_PULL_LAW, LINE_PULL_LAW = "pulls towards a place", "pulls along a line to a place"
ORDERS: tuple[Shape, ...] = ((1.0,), (2.0,), (3.0,))  # harmonic orders per joint turn
MAX_READINGS = 3000  # most readings for forms with more than ten coefficients, because of time and memory
NEIGHBOUR_JOINTS = 2  # adjacent joints on either side whose rotations a wobble imitates


def build_unmodelled_pose_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the uncatalogued forms of measured poses.

    Args:
        r: Measured poses.

    Returns:
        The hypotheses.
    """
    up, every = np.eye(3)[:, 2:], np.eye(3)
    large = len(r) > MAX_READINGS
    axis = (
        ((NEIGHBOUR_JOINT_LAW, _build_neighbour_joint_waves),)
        if large
        else ((NEIGHBOUR_JOINT_LAW, _build_neighbour_joint_waves), (AXIS_WOBBLE_LAW, _build_axis_wobble))
    )
    out = [
        build_uncatalogued_hypothesis(
            "sensor:displacement",
            REFRACTION_LAW,
            f"moves points {how} by where they are, not as a rigid frame does: a line of sight that is bent, say",
            _build_beam_refraction(r, axes),
            ((),),
        )
        for axes, how in ((up, "up and down"), (every, "any way"))[: 1 if large else 2]
    ]
    for j in range(r.joint_count):
        if np.ptp(r.state.q[:, j]) < thresholds.LIMITS.joint_range:
            continue
        note = f"moves the arm behind joint {j + 1} by waves of its angle, beside the axis: one that nods, say"
        out += [
            build_uncatalogued_hypothesis(format_joint_location(j + 1), name, note, made(r, j), ORDERS)
            for name, made in axis
        ]
    note = "is pulled by a force that follows its place, as a hose on a spring pulls"
    return out + [
        build_uncatalogued_hypothesis(format_link_location(k), name, note, _build_pull_force(r, k, name), ((),))
        for k in range(2, r.joint_count)  # links at whose ends a hose may be attached
        for name in (POINT_PULL_LAW, LINE_PULL_LAW)
    ]


def _build_beam_refraction(r: StaticReadings, axes: Array) -> Callable[[Shape], Array]:
    """Build shifts along axes (3, A) of base_link as polynomials of the position up to second order, ten per axis."""
    p = r.state.T_base_tool[:, :3, 3]
    p = (p - p.mean(axis=0)) / max(float(p.std(axis=0).max()), 1e-9)
    x, y, z = p.T
    one = np.ones(len(p))
    products = np.stack([one, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=1)
    moved = np.zeros((len(p), 6, axes.shape[1] * products.shape[1]))
    moved[:, :3] = np.einsum("ca,nk->ncak", axes, products).reshape(len(p), 3, -1)
    columns = r.project_to_measured(moved, BODY_BEHIND_FLANGE)  # an inclinometer does not depend on the tracker beam
    return lambda shape: columns


def _compute_joint_waves(r: StaticReadings, j: int, shape: Shape) -> Array:
    """Return cosine and sine (N, 2) of the angle of joint ``j`` (0-based)."""
    angle = shape[0] * r.state.q[:, j]
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _build_neighbour_joint_waves(r: StaticReadings, j: int) -> Callable[[Shape], Array]:
    near = [k for k in range(r.joint_count) if 0 < abs(k - j) <= NEIGHBOUR_JOINTS]
    return lambda shape: np.concatenate(
        [r.lift_joint_twist(k, _compute_joint_waves(r, j, shape)) for k in near], axis=2
    )


def _build_axis_wobble(r: StaticReadings, j: int) -> Callable[[Shape], Array]:
    twists = (
        as_built_joint_frames.compute_frame_columns(r, format_joint_location(j + 1))
        * as_built_joint_frames.list_manufacturing_tolerances()
    )

    def columns(shape: Shape) -> Array:
        return np.concatenate([twists * w[:, None, None] for w in _compute_joint_waves(r, j, shape).T], axis=2)

    return columns


def _build_pull_force(r: StaticReadings, link: int, name: str) -> Callable[[Shape], Array]:
    """Build a force at the end of a link (1-based): f = f₀ + K (p − p̄) with K = k·1 or symmetric."""
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    at = r.state.R_bodies[:, link] @ r.robot.point[link] + r.state.p_bodies[:, link]
    lever = r.state.T_base_tool[:, :3, 3] - at
    away, every = at - at.mean(axis=0), np.eye(3)
    ways = (
        [every]
        if name == POINT_PULL_LAW
        else [np.outer(a, b) + np.outer(b, a) for a, b in combinations_with_replacement(every, 2)]
    )
    forces = [*np.broadcast_to(every[:, None], (3, *at.shape)), *(away @ K for K in ways)]
    moved = r.state.J[:, :, :link]
    # Jacobian of the link end: TCP motion minus rotation about the end
    J = moved[:, :3] - np.cross(moved[:, 3:], lever[:, :, None], axis=1)
    twists = [np.einsum("nci,nc,i->ni", J, f, r.compliance[:link]) for f in forces]
    columns = np.concatenate([sum(r.lift_joint_twist(i, t[:, i]) for i in range(link)) for t in twists], axis=2)
    return lambda shape: columns
