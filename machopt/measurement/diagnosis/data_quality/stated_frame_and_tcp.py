"""Poses stated in base_link (``registration: fixed``) that are in a frame of the tracker, or of another point.

Four readings are compared: as stated, with a free tracker frame (six numbers), with another point of the flange
(three), and both. Small deviations are physics or effects of the catalogue. A frame counts from 0.1 rad or 0.3 m on, a
point from three standard deviations of a nominal place on.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording, TrackerTarget
from machopt.effects import prior_scales
from machopt.effects.recording.record_faults import COLUMNS
from machopt.effects.recording.sensor_errors import DISPLACEMENT
from machopt.effects.structure.as_built_joint_frames import EFFECT as GEOMETRY
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.convention_fits import RigidFit, fit_frames_and_points
from machopt.measurement.diagnosis.data_quality.session_corrections import compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import compute_nominal_points
from machopt.measurement.estimation.convention_score import compute_description_cost, compute_pose_errors
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector

POINT = "measured point"
ZERO_PRIOR = prior_scales.JOINT_ZERO.scale
ROBUST_STEPS = 6


@dataclass(frozen=True, kw_only=True)
class _FrameReading:
    """One way to understand the measured positions."""

    frame: bool  # the tracker frame is free
    point: bool  # the measured point is not the TCP
    fit: RigidFit
    cost: float  # −2 log evidence

    @property
    def error(self) -> Array:
        """Remaining distance (N,) of each reading, m."""
        return np.asarray(np.linalg.norm(self.fit.residual, axis=1))

    @property
    def is_frame_far(self) -> bool:
        """Whether the frame is so far from base_link that no catalogue effect describes it."""
        turn = float(np.linalg.norm(convert_to_rotation_vector(self.fit.turn[0])))
        shift = float(np.linalg.norm(self.fit.shift[0]))
        return turn > thresholds.LIMITS.large_rotation or shift > thresholds.LIMITS.lever


def correct_stated_frame(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Free the tracker frame, or the measured point, of poses that are stated in base_link and are not.

    Args:
        recording: Recording of any kind with corrected joint angles; measured poses in a known frame are checked.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording with ``registration: fit`` or with a target, and a finding for each correction.
    """
    if recording.kind != "absolute" or recording.position is None or recording.registration != "fixed":
        return recording, []
    if len(np.unique(recording.pose)) < thresholds.COUNTS.min_comparisons:
        return recording, []
    p, R = compute_nominal_points(recording, robot, T_flange_tcp)
    sigma = recording.uncertainty.target or prior_scales.TARGET_POSITION.scale
    stated = _read(p, R, recording, sigma, frame=False, point=False)
    ways = [stated, _read(p, R, recording, sigma, frame=False, point=True)]
    if DISPLACEMENT.name not in accept and recording.frame is None:
        ways += [_read(p, R, recording, sigma, frame=True, point=point) for point in (False, True)]
    best = min(ways, key=lambda w: w.cost)
    if best.frame and not best.is_frame_far:  # an effect of the catalogue
        best = min(ways[:2], key=lambda w: w.cost)
    better = float(np.mean(best.error)) < thresholds.SHARES.majority * float(np.mean(stated.error))
    if stated.cost - best.cost < thresholds.LEVELS.min_evidence or not better:
        return recording, []
    out: list[Finding] = []
    if best.frame:
        out.append(_build_frame_finding(recording, stated, best))
        recording = replace(recording, registration="fit")
    off = float(np.abs(best.fit.offset).max())
    if best.point and not recording.targets and off > thresholds.LEVELS.three_sigma * sigma:
        if GEOMETRY.name in accept or COLUMNS.name in accept:
            return recording, out
        offset, covariance = _estimate_point(recording, robot, T_flange_tcp, best)
        out.append(_build_point_finding(recording, stated, best, offset, covariance))
        x, y, z = (float(v) for v in T_flange_tcp[:3, 3] + offset)
        recording = replace(recording, targets=(TrackerTarget(POINT, (x, y, z)),))
    return recording, out


def _read(p: Array, R: Array, recording: Recording, sigma: float, *, frame: bool, point: bool) -> _FrameReading:
    fit = fit_frames_and_points(p, R, recording, frames=frame, points=point)
    by_pose = compute_pose_errors(recording.pose, np.linalg.norm(fit.residual, axis=1))
    parameters = 6 * frame + 3 * point * max(len(recording.targets), 1)
    far = 2.0 * float(np.sum(np.log1p((fit.offset / sigma) ** 2)))  # heavy-tailed (Cauchy) prior
    return _FrameReading(
        frame=frame, point=point, fit=fit, cost=compute_description_cost(by_pose, parameters=parameters) + far
    )


def _build_frame_finding(recording: Recording, stated: _FrameReading, best: _FrameReading) -> Finding:
    turn = np.degrees(convert_to_rotation_vector(best.fit.turn[0]))
    shift = 1e3 * best.fit.shift[0]
    at = ", ".join(f"{v:.1f}" for v in shift)
    words = (
        "registration is stated (or taken) as fixed, but the positions fit in a tracker frame that lies at "
        f"({at}) mm in base_link, turned by {float(np.linalg.norm(turn)):.1f}°; they were read with registration: fit"
    )
    parameters = {
        "angle": build_exact_estimate(float(np.linalg.norm(turn)), "deg"),
        **{f"shift {a}": build_exact_estimate(float(v), "mm") for a, v in zip("xyz", shift, strict=True)},
    }
    return build_record_finding(
        DISPLACEMENT.name,
        DISPLACEMENT.places[0],
        words,
        1e3 * float(np.mean(stated.error)),
        1e3 * float(np.mean(best.error)),
        compute_sign_test(recording.pose, stated.error, best.error),
        parameters,
    )


def _estimate_point(recording: Recording, robot: Robot, T: Array, best: _FrameReading) -> tuple[Array, Array]:
    """Return the offset (3,) m of the measured point in the flange, and its covariance, with free joint zeros.

    Zeros have a prior of :data:`ZERO_PRIOR`; without them errors of the joints would count as an offset of the point.
    """
    state = robot.compute_state(recording.q, T)
    R = state.T_base_tool[:, :3, :3] @ T[:3, :3].T
    beside = R @ best.fit.offset[0]
    J = state.J[:, :3] + np.swapaxes(np.cross(np.swapaxes(state.J[:, 3:], 1, 2), beside[:, None]), 1, 2)
    A = np.concatenate([R, J], axis=2).reshape(3 * len(R), -1)
    y, size = best.fit.residual, np.linalg.norm(best.fit.residual, axis=1)
    weight = np.ones(len(y))
    for _ in range(ROBUST_STEPS):
        rows = np.repeat(weight, 3)
        spread = float(np.sqrt(np.average(size**2, weights=weight) / 3.0))
        prior = np.diag([0.0] * 3 + [(spread / ZERO_PRIOR) ** 2] * (A.shape[1] - 3))
        inverse = np.linalg.pinv((A * rows[:, None]).T @ A + prior)
        x = inverse @ (A * rows[:, None]).T @ y.reshape(-1)
        size = np.linalg.norm(y - (A @ x).reshape(-1, 3), axis=1)
        weight = 1.0 / np.maximum(size / max(float(np.median(size)), 1e-12), 1.0)
    each = float(np.mean(size**2)) / 3.0  # readings of one pose share errors, and a pose has few readings
    return best.fit.offset[0] + x[:3], each * inverse[:3, :3]


def _build_point_finding(
    recording: Recording, stated: _FrameReading, best: _FrameReading, offset: Array, covariance: Array
) -> Finding:
    off = 1e3 * offset
    sigma = 1e3 * np.sqrt(np.diag(covariance))
    along = offset / np.linalg.norm(offset)
    total = 1e3 * float(np.sqrt(along @ covariance @ along))
    words = (
        f"the measured point lies ({', '.join(f'{v:.1f}' for v in off)}) mm in the flange from the cell's TCP; it is "
        "refitted there. Put the TCP into tool.tcp.xyz_mm, or the reflector into targets_mm"
    )
    finding = build_record_finding(
        GEOMETRY.name,
        "tool",
        words,
        1e3 * float(np.mean(stated.error)),
        1e3 * float(np.mean(best.error)),
        compute_sign_test(recording.pose, stated.error, best.error),
        {
            "offset": _build_estimate(float(np.linalg.norm(off)), total),
            **{f"offset_{a}": _build_estimate(float(v), float(e)) for a, v, e in zip("xyz", off, sigma, strict=True)},
        },
    )
    other = (COLUMNS.name, format_column_location("target"))
    return replace(finding, one_of=(*finding.one_of, other))


def _build_estimate(value: float, sigma: float) -> EstimatedValue:
    """Return a normal estimate in mm with its intervals."""
    half90, half95 = (float(ndtri(0.5 + level / 2.0)) * sigma for level in (0.90, 0.95))
    return EstimatedValue(value, "mm", (value - half90, value + half90), (value - half95, value + half95))
