"""Reflectors whose recorded position is wrong, or whose names are exchanged.

Reflector positions are always fitted, so neither fault distorts the physics. The recorded positions are wrong,
however, and this is reported.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording, TrackerTarget
from machopt.effects import prior_scales
from machopt.effects.recording.record_faults import COLUMNS
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.session_corrections import compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import fit_rigid_transform
from machopt.measurement.diagnosis.static.measured_pose_model import FirstPoseFit, NominalPoseModel
from machopt.measurement.estimation.convention_score import compute_description_cost, compute_pose_errors
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
LOOSE_UNCERTAINTY_FACTOR = 1e3  # factor on the stated uncertainty: removes the prior on positions that may be wrong


def correct_misplaced_reflectors(
    recording: Recording, cell: Cell, robot: Robot, masses: RobotMasses | None
) -> tuple[Recording, list[Finding]]:
    """Correct recorded positions (``targets_mm``) of reflectors that the poses contradict.

    A single reflector is compared with the others. Where most are far off, or all together, the places that the poses
    show replace the recorded ones if their evidence is very strong with three numbers a reflector counted. The fit of
    the base model could not reach them against its prior.

    Args:
        recording: Measured poses in base_link, except for the refitted frame.
        cell: Robot cell.
        robot: Kinematic model of the arm.
        masses: Link and tool masses; None if unknown.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    if not recording.targets:
        return recording, []
    model = NominalPoseModel(recording, cell, robot, masses, frozenset())
    first = model.fit_base(LOOSE_UNCERTAINTY_FACTOR)
    threshold = thresholds.LEVELS.three_sigma * (recording.uncertainty.target or prior_scales.TARGET_POSITION.scale)
    found = first.target + np.array([t.place for t in recording.targets])  # (T, 3)
    pair = _find_exchanged_reflectors(recording, first.target, found, threshold)
    if pair is not None:
        a, b = pair
        words = f"targets {recording.targets[a].name} and {recording.targets[b].name} are exchanged"
        targets = list(recording.targets)
        targets[a] = TrackerTarget(targets[a].name, recording.targets[b].place)
        targets[b] = TrackerTarget(targets[b].name, recording.targets[a].place)
        rows = np.isin(model.reflector_index, pair)
        return replace(recording, targets=tuple(targets)), [
            _build_reflector_finding(model, first, rows, words, {}, words)
        ]
    out, targets = [], list(recording.targets)
    for n in _find_misplaced_reflectors(first.target, threshold):
        deviation = 1e3 * first.target[n]
        name = recording.targets[n].name
        words = (
            f"target {name} sits ({', '.join(f'{v:.1f}' for v in deviation)}) mm from where targets_mm says, "
            "beyond the others; it was read at the place that the poses show"
        )
        sizes = {f"shift {a}": build_exact_estimate(float(v), "mm") for a, v in zip("xyz", deviation, strict=True)}
        targets[n] = TrackerTarget(name, _as_place(found[n]))
        out.append(_build_reflector_finding(model, first, model.reflector_index == n, words, sizes, name))
    if not out:
        return _move_all_reflectors(recording, model, first, found, threshold)
    return replace(recording, targets=tuple(targets)), out


def _move_all_reflectors(
    recording: Recording, model: NominalPoseModel, first: FirstPoseFit, found: Array, threshold: float
) -> tuple[Recording, list[Finding]]:
    """Take the places that the poses show for all reflectors, where several of them are far from the recorded ones.

    A plate that is moved as a whole is no fault of the record: its places are nominal. It is a warning only.
    """
    far = [n for n, off in enumerate(np.linalg.norm(first.target, axis=1)) if off > threshold]
    state, p, _ = model.predict(first)
    columns, unknowns = model.columns(state, p)
    if len(far) < min(2, len(recording.targets)) or model.count_undetermined_directions(columns, unknowns):
        return recording, []
    base_fit = model.fit_base()
    nominal, shown = (_compute_errors(model, fit) for fit in (base_fit, first))
    pose, sigma = model.recording.pose, recording.uncertainty.target or prior_scales.TARGET_POSITION.scale
    before = compute_description_cost(compute_pose_errors(pose, nominal)) + float(
        np.sum((base_fit.target / sigma) ** 2)
    )
    heavy = 2.0 * float(np.sum(np.log1p((first.target / sigma) ** 2)))  # heavy-tailed (Cauchy) prior
    after = compute_description_cost(compute_pose_errors(pose, shown), parameters=3 * len(first.target)) + heavy
    if before - after < thresholds.LEVELS.min_evidence:
        return recording, []
    targets = [TrackerTarget(t.name, _as_place(at)) for t, at in zip(recording.targets, found, strict=True)]
    names = ", ".join(recording.targets[n].name for n in far)
    most = 1e3 * float(np.linalg.norm(first.target, axis=1).max())
    words = (
        f"targets {names} sit up to {most:.1f} mm from where targets_mm says; all targets were read at the places that "
        "the poses show"
    )
    if _is_moved_as_a_whole(np.array([t.place for t in recording.targets]), found, threshold):
        warning = f"{words}; all moved together, as a plate does that is mounted otherwise"
        return replace(recording, targets=tuple(targets), warnings=(*recording.warnings, warning)), []
    finding = build_record_finding(
        COLUMNS.name,
        format_column_location("target"),
        words,
        1e3 * float(np.median(nominal)),
        1e3 * float(np.median(shown)),
        compute_sign_test(pose, nominal, shown),
        {"shift": build_exact_estimate(most, "mm")},
        stated={"message": words, "target": names},
    )
    return replace(recording, targets=tuple(targets)), [finding]


def _find_misplaced_reflectors(deviation: Array, threshold: float) -> list[int]:
    """Return reflectors whose offset (T, 3) m differs from that of the majority; none if most would differ."""
    if len(deviation) == 2:
        apart = float(np.linalg.norm(deviation[1] - deviation[0]))
        return [int(np.argmax(np.linalg.norm(deviation, axis=1)))] if apart > threshold else []
    beyond = np.flatnonzero(np.linalg.norm(deviation - np.median(deviation, axis=0), axis=1) > threshold)
    return beyond.tolist() if 2 * len(beyond) < len(deviation) else []


def _find_exchanged_reflectors(
    recording: Recording, deviation: Array, found: Array, threshold: float
) -> tuple[int, int] | None:
    """Return two reflectors each of which lies at the recorded position of the other."""
    size = np.linalg.norm(deviation, axis=1)
    for a, b in combinations(range(len(deviation)), 2):
        there = found[a] - recording.targets[b].place, found[b] - recording.targets[a].place
        if min(size[a], size[b]) > threshold and max(np.linalg.norm(e) for e in there) < threshold:
            return a, b
    return None


def _is_moved_as_a_whole(nominal: Array, found: Array, threshold: float) -> bool:
    """Return whether places (T, 3) m are a rigid motion of the nominal ones."""
    turn, shift = fit_rigid_transform(nominal, found)
    return bool(np.linalg.norm(nominal @ turn.T + shift - found, axis=1).max() < threshold)


def _as_place(at: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in at)
    return x, y, z


def _compute_errors(model: NominalPoseModel, fit: FirstPoseFit) -> Array:
    """Return the distance (N,) m of each reading from a fit."""
    _, p, R = model.predict(fit)
    return np.asarray(np.linalg.norm(model.residual(fit, p, R)[:, :3], axis=1))


def _build_reflector_finding(
    model: NominalPoseModel, first: FirstPoseFit, rows: Flags, words: str, sizes: dict[str, EstimatedValue], name: str
) -> Finding:
    nominal = replace(first, target=np.zeros_like(first.target))
    errors = [_compute_errors(model, each)[rows] for each in (nominal, first)]
    before, after = (float(np.median(e)) for e in errors)
    return build_record_finding(
        COLUMNS.name,
        format_column_location("target"),
        words,
        1e3 * before,
        1e3 * after,
        compute_sign_test(model.recording.pose[rows], *errors),
        sizes,
        stated={"message": words, "target": name},
    )
