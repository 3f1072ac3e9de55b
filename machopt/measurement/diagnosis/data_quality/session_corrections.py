"""A fault of one session, or of one pose, is not physics: each is held against the others, and mended where sure.

What the others say of a part of the record: springs ≥ 0 (load tests) or forward kinematics with a tracker frame
(poses), by least absolute deviations, plus what the very same pose and load left there (replicates), so that physics
the model lacks does not count. The ways a part may have been written otherwise: :mod:`.rewritten`.
One is taken only where the misfit falls by a wide margin, down to the level of the others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from machopt.data_types.locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot
from machopt.measurement.diagnosis import thresholds
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
MOST_REPAIRS = 4  # parts of one record


@dataclass(frozen=True, kw_only=True)
class RecordEquations:
    """What a model that is linear in few unknowns says of N translations; base_link axes, SI."""

    y: Array  # (N, 3) m
    A: Array  # (N, 3, P)
    load: Array  # (N,) size of what drives each reading
    wrench: Array  # (N, 6) N, N·m; zeros where none is recorded
    size: Array  # (N,) m, what a misfit of the whole is counted per
    pose: Ints  # (N,)
    springs: bool  # the unknowns are compliances, ≥ 0

    def fit(self) -> Array:
        """(P,) by least absolute deviations."""
        if self.springs:
            return fit_bounded_absolute_deviations(self.A, self.y, self.load)
        out, seen = np.zeros(self.A.shape[2]), self.A.any(axis=(0, 1))  # not a frame that no reading is in
        if seen.any():
            out[seen] = fit_least_absolute_deviations(self.A[:, :, seen], self.y, self.load)
        return out

    def error(self, x: Array) -> Array:
        """(N, 3) m."""
        return np.asarray(self.y - self.A @ x)


@dataclass(frozen=True, kw_only=True)
class _SessionCorrection:
    part: int  # label
    candidate: CorrectionCandidate
    recording: Recording  # the whole one, mended
    misfit_before: float  # m, median misfit of the part
    misfit_after: float
    unexplained_share: float  # unexplained share of the whole record
    replicate_share: float  # share of the part's readings that have a replicate elsewhere, mended
    distance_from_prior: float  # |log| of the arm's compliance per the cell's
    p_value: float


def correct_sessions_and_poses(
    recording: Recording, robot: Robot, T_flange_tcp: Array, prior: Array | None, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Mend sessions, then poses (of load tests), that were written otherwise than the rest.

    Args:
        recording: kind deflection or absolute, as read.
        robot, T_flange_tcp: the arm.
        prior: (6,) N·m/rad of the cell; None where it has none. It decides only which of two sessions is the odd one.
        accept: effects ("units", "columns") that the user says are none.

    Returns:
        the recording as it should have been (itself where nothing is wrong), a finding per repair.
    """
    out: list[Finding] = []
    if recording.kind == "absolute" and recording.position is None:
        return recording, out
    if recording.kind == "deflection" and (recording.wrench is None or recording.displacement is None):
        return recording, out
    if recording.kind == "deflection" and not (np.any(recording.wrench) and np.any(recording.displacement)):
        return recording, out  # says nothing, which is refused where it is looked at
    _, session = np.unique(recording.session, return_inverse=True)
    levels: list[tuple[str, Ints, Ints]] = [("session", session.reshape(-1).astype(np.int64), recording.session)]
    if recording.kind == "deflection":
        _, pose = np.unique(recording.pose, return_inverse=True)
        levels.append(("pose", pose.reshape(-1).astype(np.int64), recording.pose))
    for level, label, name in levels:
        if level == "pose" and label.max() + 1 < thresholds.RECORD.poses_to_compare:
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
    """Of a recording or a part of it."""
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
    assert recording.position is not None  # mended checks it
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
    """Every way that puts one part right, part by part."""
    limits = thresholds.RECORD
    whole = build_record_equations(recording, robot, T)
    parts = int(label.max()) + 1
    sigma = recording.uncertainty.displacement or 0.0
    for k in range(parts):
        rows = label == k
        if parts < 2 or rows.sum() < limits.part_readings:
            continue
        others = _select_equations(whole, ~rows)
        x = others.fit()
        rest = others.error(x)
        level_of_others = max(compute_typical_error(rest), sigma)
        known = others, rest, level == "session"
        seen, _ = _compute_part_misfit(_select_equations(whole, rows), x, *known)
        before = compute_typical_error(seen)
        if before < limits.part_stands_out * level_of_others:
            continue
        part = select_rows(recording, rows)
        falls = limits.session_falls if level == "session" else limits.pose_falls
        for way in generate_correction_candidates(part):
            changed = way.apply(part)
            whole_again = replace_rows(recording, changed, rows)
            now = (
                build_record_equations(changed, robot, T)
                if recording.kind == "deflection"
                else _select_equations(
                    build_record_equations(whole_again, robot, T), rows
                )  # with the frames and reflectors of the others too
            )
            e, twins = _compute_part_misfit(now, x, *known)
            after = compute_typical_error(e) * way.scale
            if after > falls * before or compute_typical_error(e) > limits.part_level * level_of_others:
                continue
            every = build_record_equations(whole_again, robot, T)
            left = _compute_unexplained_share(every, label)
            if left > limits.session_falls**0.5 * _compute_unexplained_share(whole, label):
                continue
            by_chance = compute_sign_test(now.pose, np.linalg.norm(seen, axis=1), np.linalg.norm(e, axis=1) * way.scale)
            yield _SessionCorrection(
                part=k,
                candidate=way,
                recording=whole_again,
                misfit_before=before,
                misfit_after=after,
                unexplained_share=left,
                replicate_share=twins,
                distance_from_prior=_compute_prior_distance(every, prior),
                p_value=by_chance,
            )


def _select_best_correction(found: list[_SessionCorrection]) -> _SessionCorrection | None:
    """The least misfit of the whole; among equals the one whose loads repeat others, then the one nearest the cell."""
    if not found:
        return None
    least = min(r.unexplained_share for r in found)
    near = [r for r in found if r.unexplained_share <= thresholds.RECORD.part_as_good * least]
    return min(near, key=lambda r: (-round(r.replicate_share, 1), round(r.distance_from_prior, 1), r.unexplained_share))


def _compute_part_misfit(
    part: RecordEquations, x: Array, others: RecordEquations, rest: Array, replicates: bool
) -> tuple[Array, float]:
    """(n, 3) m, how far a part is from what the others say, and the share of its readings that repeat one of them."""
    e, twins = part.error(x), 0
    if not replicates:
        return e, 0.0
    for pose in np.unique(part.pose):
        here, there = np.flatnonzero(part.pose == pose), np.flatnonzero(others.pose == pose)
        if not len(there):
            continue
        a, b = part.wrench[here, :3], others.wrench[there, :3]
        apart = np.linalg.norm(a[:, None] - b[None], axis=2)
        near = apart <= thresholds.RECORD.same_force * np.linalg.norm(b, axis=1).max()
        count = near.sum(axis=1)
        has = count > 0
        mean = (near[has].astype(float) @ rest[there]) / count[has, None]
        e[here[has]] -= mean
        twins += int(has.sum())
    return e, twins / max(len(e), 1)


def _compute_unexplained_share(whole: RecordEquations, label: Ints) -> float:
    """Unexplained share of the whole record, every part counting the same."""
    e = np.abs(whole.error(whole.fit())).sum(axis=1)
    n = int(label.max()) + 1
    return float(np.mean(np.bincount(label, e, n) / np.maximum(np.bincount(label, whole.size, n), 1e-300)))


def _compute_prior_distance(whole: RecordEquations, prior: Array | None) -> float:
    if prior is None or not whole.springs:
        return 0.0
    predicted = whole.A @ (1.0 / prior)
    ratio = float(fit_least_absolute_deviations(predicted[:, :, None], whole.y, whole.load)[0])
    return abs(float(np.log(max(ratio, 1e-12))))


def _select_equations(e: RecordEquations, rows: Flags) -> RecordEquations:
    return replace(
        e, y=e.y[rows], A=e.A[rows], load=e.load[rows], wrench=e.wrench[rows], size=e.size[rows], pose=e.pose[rows]
    )


def compute_typical_error(e: Array) -> float:
    """Median size of (N, 3) errors."""
    return float(np.median(np.linalg.norm(e, axis=1)))


def compute_sign_test(pose: Ints, before: Array, after: Array) -> float:
    """That so many poses come nearer by accident: a sign test."""
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
