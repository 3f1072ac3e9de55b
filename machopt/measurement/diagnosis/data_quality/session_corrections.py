"""Faults of one session or of one pose, found by comparison with the rest of the recording.

The rest predicts a part by non-negative springs (load tests) or forward kinematics with a tracker frame (poses),
fitted by least absolute deviations. The residuals of replicates are added, so that unmodelled physics does not count.
Candidates are listed in :mod:`machopt.measurement.diagnosis.data_quality.correction_candidates`. A candidate is
accepted only if the misfit falls by a wide margin to the level of the other parts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.correction_candidates import (
    CorrectionCandidate,
    generate_correction_candidates,
    replace_rows,
    select_rows,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import (
    build_frame_and_reflector_columns,
    compute_nominal_points,
)
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.measurement.identification.data_quality.alternative_conventions import fit_bounded_absolute_deviations
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]
MOST_REPAIRS = 4  # most corrected parts of one recording


@dataclass(frozen=True, kw_only=True)
class RecordEquations:
    """Linear equations of a simple model for N translations; base_link axes, SI."""

    y: Array  # (N, 3) m
    A: Array  # (N, 3, P)
    load: Array  # (N,) magnitude of the load of each reading
    wrench: Array  # (N, 6) N, N·m; zeros where none is recorded
    size: Array  # (N,) m, reference for relative misfits
    pose: Ints  # (N,)
    springs: bool  # the unknowns are non-negative compliances

    def fit(self) -> Array:
        """Fit the unknowns by least absolute deviations."""
        if self.springs:
            return fit_bounded_absolute_deviations(self.A, self.y, self.load)
        out, seen = np.zeros(self.A.shape[2]), self.A.any(axis=(0, 1))  # without frames that no reading uses
        if seen.any():
            out[seen] = fit_least_absolute_deviations(self.A[:, :, seen], self.y, self.load)
        return out

    def error(self, x: Array) -> Array:
        """Return the residuals.

        Args:
            x: (P,) unknowns, SI.

        Returns:
            (N, 3) m.
        """
        return np.asarray(self.y - self.A @ x)


@dataclass(frozen=True, kw_only=True)
class _SessionCorrection:
    part: int  # label
    candidate: CorrectionCandidate
    recording: Recording  # complete recording after correction
    misfit_before: float  # m, median misfit of the part as recorded
    misfit_after: float
    unexplained_share: float  # unexplained share of the whole record
    replicate_share: float  # share of the part's readings with a replicate in other parts, after correction
    distance_from_prior: float  # |log| of the ratio of the arm's compliance to the cell's
    p_value: float


def correct_sessions_and_poses(
    recording: Recording, robot: Robot, T_flange_tcp: Array, prior: Array | None, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Correct sessions, then single poses (of load tests), that differ from the rest by a recording fault.

    Args:
        recording: Load tests or measured poses.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown. It only decides which of two sessions
            is wrong.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    out: list[Finding] = []
    if recording.kind == "absolute" and recording.position is None:
        return recording, out
    if recording.kind == "deflection" and (recording.wrench is None or recording.displacement is None):
        return recording, out
    if recording.kind == "deflection" and not (np.any(recording.wrench) and np.any(recording.displacement)):
        return recording, out  # no load or no measurement; reported by a later check
    _, session = np.unique(recording.session, return_inverse=True)
    levels: list[tuple[str, Ints, Ints]] = [("session", session.reshape(-1).astype(np.int64), recording.session)]
    if recording.kind == "deflection":
        _, pose = np.unique(recording.pose, return_inverse=True)
        levels.append(("pose", pose.reshape(-1).astype(np.int64), recording.pose))
    for level, label, name in levels:
        if level == "pose" and label.max() + 1 < thresholds.COUNTS.min_comparisons:
            continue
        for _ in range(MOST_REPAIRS):
            best = _select_best_correction(
                [
                    r
                    for r in _generate_session_corrections(recording, robot, T_flange_tcp, prior, label, level)
                    if r.candidate.effect not in accept
                ]
            )
            if best is None:
                break
            recording = best.recording
            out += [
                _build_session_finding(best, way, level, int(name[label == best.part][0]))
                for way in (best.candidate, *best.candidate.alternative)
            ]
    return recording, out


def build_record_equations(recording: Recording, robot: Robot, T_flange_tcp: Array) -> RecordEquations:
    """Build the linear equations of a recording or of a part of it.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        Equations with springs (load tests), or with frame and reflectors (measured poses).
    """
    if recording.kind == "deflection":
        tests = build_load_test_experiment(recording, robot, T_flange_tcp)
        w, y = tests.wrench, tests.measured[:, :3]
        load = np.linalg.norm(w[:, :3], axis=1) + np.linalg.norm(w[:, 3:], axis=1)
        return RecordEquations(
            y=y,
            A=tests.response()[:, :3],
            load=load,
            wrench=w,
            size=np.abs(y).sum(axis=1),
            pose=recording.pose,
            springs=True,
        )
    assert recording.position is not None  # checked by the caller
    p, R = compute_nominal_points(recording, robot, T_flange_tcp)
    A = build_frame_and_reflector_columns(recording, p, R)
    w = np.zeros((len(p), 6)) if recording.wrench is None else recording.wrench
    return RecordEquations(
        y=recording.position - p,
        A=A,
        load=np.ones(len(p)),
        wrench=w,
        size=np.abs(p).sum(axis=1),
        pose=recording.pose,
        springs=False,
    )


def _generate_session_corrections(
    recording: Recording, robot: Robot, T: Array, prior: Array | None, label: Ints, level: str
) -> Iterable[_SessionCorrection]:
    """Yield every candidate correction of every part."""
    whole = build_record_equations(recording, robot, T)
    parts = int(label.max()) + 1
    sigma = recording.uncertainty.displacement or 0.0
    for k in range(parts):
        rows = label == k
        if parts < 2 or rows.sum() < thresholds.COUNTS.min_comparisons:
            continue
        others = _select_equations(whole, ~rows)
        x = others.fit()
        rest = others.error(x)
        level_of_others = max(compute_typical_error(rest), sigma)
        known = others, rest, level == "session"
        seen, _ = _compute_part_misfit(_select_equations(whole, rows), x, *known)
        before = compute_typical_error(seen)
        if before < thresholds.RATIOS.double * level_of_others:
            continue
        part = select_rows(recording, rows)
        falls = thresholds.SHARES.minority if level == "session" else thresholds.SHARES.corrected_misfit
        for way in generate_correction_candidates(part):
            changed = way.apply(part)
            whole_again = replace_rows(recording, changed, rows)
            now = (
                build_record_equations(changed, robot, T)
                if recording.kind == "deflection"
                else _select_equations(
                    build_record_equations(whole_again, robot, T), rows
                )  # including frames and reflectors of the other parts
            )
            e, replicates = _compute_part_misfit(now, x, *known)
            after = compute_typical_error(e) * way.scale
            if after > falls * before or compute_typical_error(e) > thresholds.RATIOS.double * level_of_others:
                continue
            every = build_record_equations(whole_again, robot, T)
            left = _compute_unexplained_share(every, label)
            if left > thresholds.SHARES.minority**0.5 * _compute_unexplained_share(whole, label):
                continue
            by_chance = compute_sign_test(now.pose, np.linalg.norm(seen, axis=1), np.linalg.norm(e, axis=1) * way.scale)
            yield _SessionCorrection(
                part=k,
                candidate=way,
                recording=whole_again,
                misfit_before=before,
                misfit_after=after,
                unexplained_share=left,
                replicate_share=replicates,
                distance_from_prior=_compute_prior_distance(every, prior),
                p_value=by_chance,
            )


def _select_best_correction(found: list[_SessionCorrection]) -> _SessionCorrection | None:
    """Return the correction with the smallest misfit; ties are decided by replicated loads, then by the cell's
    stiffness.
    """
    if not found:
        return None
    least = min(r.unexplained_share for r in found)
    near = [r for r in found if r.unexplained_share <= thresholds.RATIOS.equal_fit * least]
    return min(near, key=lambda r: (-round(r.replicate_share, 1), round(r.distance_from_prior, 1), r.unexplained_share))


def _compute_part_misfit(
    part: RecordEquations, x: Array, others: RecordEquations, rest: Array, replicates: bool
) -> tuple[Array, float]:
    """Return the deviation (n, 3) m of a part from the prediction by the others, and the share of its replicated
    readings.
    """
    e, replicated = part.error(x), 0
    if not replicates:
        return e, 0.0
    for pose in np.unique(part.pose):
        here, there = np.flatnonzero(part.pose == pose), np.flatnonzero(others.pose == pose)
        if not len(there):
            continue
        a, b = part.wrench[here, :3], others.wrench[there, :3]
        apart = np.linalg.norm(a[:, None] - b[None], axis=2)
        near = apart <= thresholds.SHARES.load_tolerance * np.linalg.norm(b, axis=1).max()
        count = near.sum(axis=1)
        has = count > 0
        mean = (near[has].astype(float) @ rest[there]) / count[has, None]
        e[here[has]] -= mean
        replicated += int(has.sum())
    return e, replicated / max(len(e), 1)


def _compute_unexplained_share(equations: RecordEquations, label: Ints) -> float:
    """Return the unexplained share of the whole recording; every part has equal weight."""
    e = np.abs(equations.error(equations.fit())).sum(axis=1)
    n = int(label.max()) + 1
    return float(np.mean(np.bincount(label, e, n) / np.maximum(np.bincount(label, equations.size, n), 1e-300)))


def _compute_prior_distance(equations: RecordEquations, prior: Array | None) -> float:
    if prior is None or not equations.springs:
        return 0.0
    predicted = equations.A @ (1.0 / prior)
    ratio = float(fit_least_absolute_deviations(predicted[:, :, None], equations.y, equations.load)[0])
    return abs(float(np.log(max(ratio, 1e-12))))


def _select_equations(e: RecordEquations, rows: Flags) -> RecordEquations:
    return replace(
        e, y=e.y[rows], A=e.A[rows], load=e.load[rows], wrench=e.wrench[rows], size=e.size[rows], pose=e.pose[rows]
    )


def compute_typical_error(e: Array) -> float:
    """Return the median norm of errors.

    Args:
        e: (N, 3) errors, m.

    Returns:
        Median in m.
    """
    return float(np.median(np.linalg.norm(e, axis=1)))


def compute_sign_test(pose: Ints, before: Array, after: Array) -> float:
    """Compute the p-value of a sign test over poses: the chance that as many poses improve.

    Args:
        pose: (N,) pose label.
        before: (N,) errors before the correction.
        after: (N,) errors after the correction.

    Returns:
        One-sided p-value.
    """
    each = [np.median(after[pose == g]) < np.median(before[pose == g]) for g in np.unique(pose)]
    better = int(np.sum(each))
    return float(bdtrc(better - 1, len(each), 0.5)) if better > 0 else 1.0


def _build_session_finding(r: _SessionCorrection, way: CorrectionCandidate, level: str, name: int) -> Finding:
    words = f"{level} {name}: {way.words}; the other {level}s say so, and it was read that way"
    factor = {"factor": build_exact_estimate(1.0 / way.factor)} if way.factor != 1.0 else {}
    return build_record_finding(
        way.effect,
        format_column_location(way.column),
        words,
        1e3 * r.misfit_before,
        1e3 * r.misfit_after,
        r.p_value,
        {**factor, level: build_exact_estimate(float(name))},
        stated={"message": words, level: name},
    )
