"""Fits that assess a convention of joint angles: measured poses by rigid frames, load tests by joint springs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.effects import prior_scales
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.session_corrections import build_record_equations
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import (
    compute_nominal_points,
    fit_rigid_transform,
    index_reflectors,
    index_tracker_frames,
)
from machopt.measurement.estimation.convention_score import compute_description_cost, compute_pose_errors
from machopt.numerics.array_types import Array

ALTERNATIONS = 4  # of frames and reflectors


@dataclass(frozen=True, kw_only=True)
class ConventionFit:
    """How well a convention explains a recording."""

    error: Array  # (n,) m, remaining distance of each reading
    cost: float  # −2 log evidence, with the prior of the reflectors
    misplaced: float  # largest offset of a reflector from its nominal place, in standard deviations; 0 if none is free
    is_doubtful: bool  # the error or a reflector's place asks for another convention
    falls: float  # share of the stated convention's error that another one may leave

    @property
    def mean_error(self) -> float:
        """Mean distance, m. Series that move one joint at a time show a convention in few poses."""
        return float(np.mean(self.error))

    @property
    def is_point_misplaced(self) -> bool:
        """Whether a reflector would be far from its nominal place."""
        return self.misplaced > thresholds.RATIOS.implausible


@dataclass(frozen=True, kw_only=True)
class RigidFit:
    """Tracker frames and reflectors fitted to measured points."""

    registered: Array  # (N, 3) m, measured points in base_link
    residual: Array  # (N, 3) m, registered minus predicted
    turn: Array  # (F, 3, 3) tracker to base_link
    shift: Array  # (F, 3) m
    offset: Array  # (T, 3) m, reflectors against their nominal places, in flange


def fit_frames_and_points(p: Array, R: Array, recording: Recording, *, frames: bool, points: bool) -> RigidFit:
    """Fit rigid tracker frames and places of reflectors in turn, by least absolute deviations.

    Args:
        p: (N, 3) nominal points, m, base_link.
        R: (N, 3, 3) flange orientations in base_link.
        recording: N measured poses.
        frames: Whether each tracker frame is free.
        points: Whether the places of reflectors (or of the TCP) in the flange are free.

    Returns:
        The fit; identity frames or zero offsets for what is not free.
    """
    assert recording.position is not None  # checked by the caller
    stand, target = index_tracker_frames(recording), index_reflectors(recording)
    count, reflectors = int(stand.max()) + 1, max(len(recording.targets), 1)
    turn, shift = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    offset, x = np.zeros((reflectors, 3)), recording.position
    for _ in range(ALTERNATIONS if points else 1):
        at = p + np.einsum("nij,nj->ni", R, offset[target])
        if frames:
            for n in range(count):
                rows = stand == n
                turn[n], shift[n] = fit_rigid_transform(recording.position[rows], at[rows])
            x = np.einsum("nij,nj->ni", turn[stand], recording.position) + shift[stand]
        if points:
            there = np.einsum("nji,nj->ni", R, x - p)
            offset = np.array(
                [
                    np.median(there[target == n], axis=0) if (target == n).any() else np.zeros(3)
                    for n in range(reflectors)
                ]
            )
    residual = x - p - np.einsum("nij,nj->ni", R, offset[target])
    return RigidFit(registered=x, residual=residual, turn=turn, shift=shift, offset=offset)


def build_pose_fit(part: Recording, robot: Robot, T_flange_tcp: Array) -> Callable[[Array], ConventionFit]:
    """Return the fit of measured poses as a function of the joint angles (N, n) rad.

    Args:
        part: Measured poses.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
    """
    assert part.position is not None  # checked by the caller
    spread = float(np.median(np.linalg.norm(part.position - np.median(part.position, axis=0), axis=1)))
    sigma = part.uncertainty.target or prior_scales.TARGET_POSITION.scale
    frames = part.registration == "fit"
    points = frames or bool(part.targets)

    def fit(q: Array) -> ConventionFit:
        p, R = compute_nominal_points(replace(part, q=q), robot, T_flange_tcp)
        rigid = fit_frames_and_points(p, R, part, frames=frames, points=points)
        error = np.linalg.norm(rigid.residual, axis=1)
        off = np.abs(rigid.offset) / sigma
        doubtful = float(np.mean(error)) > thresholds.SHARES.pose_misfit * spread
        by_place = compute_description_cost(compute_pose_errors(part.pose, error))
        return ConventionFit(
            error=error,
            cost=by_place + 2.0 * float(np.sum(np.log1p(off**2))),  # heavy-tailed (Cauchy) prior of each coordinate
            misplaced=float(off.max()),
            is_doubtful=doubtful or float(off.max()) > thresholds.RATIOS.implausible,
            falls=thresholds.SHARES.relevant,
        )

    return fit


def build_load_test_fit(part: Recording, robot: Robot, T_flange_tcp: Array) -> Callable[[Array], ConventionFit]:
    """Return the fit of load tests as a function of the joint angles (N, 6) rad.

    Args:
        part: Load tests.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
    """

    def fit(q: Array) -> ConventionFit:
        e = build_record_equations(replace(part, q=q), robot, T_flange_tcp)
        error = np.linalg.norm(e.error(e.fit()), axis=1)
        size = float(np.mean(np.linalg.norm(e.y, axis=1)))
        return ConventionFit(
            error=error,
            cost=compute_description_cost(compute_pose_errors(part.pose, error)),
            misplaced=0.0,
            is_doubtful=float(np.mean(error)) > thresholds.SHARES.relevant * size,
            falls=thresholds.SHARES.corrected_misfit,
        )

    return fit
