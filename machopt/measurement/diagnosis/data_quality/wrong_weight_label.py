"""A calibration weight with a wrong label: loads of one size deviate from all others at the same poses.

Linear springs respond in proportion. Nonlinear gears respond to their torque, which differs at every pose. A load
size whose readings alone deviate by the same ratio at every pose, while smaller and larger loads agree, is none of
these. The same holds for a size that deviates in one session and after correction equals a size of another session.
Uncorrected, its rows would be rejected as outliers.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects import prior_scales
from machopt.effects.recording.record_faults import COLUMNS
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.force_gain_estimate import estimate_force_gain, predict_displacements
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.statistics.replicate_noise import compute_robust_sigma
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.numerics.array_types import Array, Ints

Flags = NDArray[np.bool_]
MOST = 4  # most corrected labels of one recording


@dataclass(frozen=True, kw_only=True)
class _LoadSize:
    """Loads of one size in one session."""

    session: int
    force: float  # N, as recorded
    rows: Flags
    ratio_by_pose: Array  # (K,) by pose: ratio of recorded to implied force, relative to the median of all sizes there

    @property
    def factor(self) -> float:
        return float(np.median(self.ratio_by_pose))

    @property
    def spread(self) -> float:
        return compute_robust_sigma(self.ratio_by_pose - self.factor)


def correct_wrong_weight_labels(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Correct load sizes whose label contradicts the other loads.

    Args:
        recording: Load tests with corrected units and axes.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each size.
    """
    out: list[Finding] = []
    if recording.kind != "deflection" or recording.wrench is None or COLUMNS.name in accept:
        return recording, out
    for _ in range(MOST):
        found = _find_wrong_size(build_load_test_experiment(recording, robot, T_flange_tcp))
        if found is None:
            break
        out.append(_build_label_finding(found, len(np.unique(recording.session)) > 1))
        wrench = recording.wrench.copy()
        wrench[found.rows] /= found.factor
        recording = replace(recording, wrench=wrench)
    return recording, out


def _find_wrong_size(tests: LoadTestExperiment) -> _LoadSize | None:
    """Return the load size with the largest deviation that no arm could cause; None if there is none."""
    every = _group_load_sizes(tests)
    odd = [
        s
        for s in every
        if _is_size_off(s)
        and _is_only_deviating_size(s, every)
        and (_has_smaller_and_larger_loads(s, every) or _is_contradicted_elsewhere(s, every))
    ]
    return max(odd, key=lambda s: abs(np.log(s.factor)), default=None)


def _is_size_off(s: _LoadSize) -> bool:
    least = thresholds.LEVELS.difference_sigma * max(
        prior_scales.FORCE_GAIN.scale, s.spread / np.sqrt(len(s.ratio_by_pose))
    )
    alike = np.mean(np.sign(np.log(s.ratio_by_pose)) == np.sign(np.log(s.factor))) >= thresholds.SHARES.agreement
    return abs(s.factor - 1.0) > least and bool(alike)


def _is_only_deviating_size(s: _LoadSize, every: list[_LoadSize]) -> bool:
    """Return whether the other sizes of its session agree with each other."""
    others = [o for o in every if o.session == s.session and o is not s]
    most = thresholds.SHARES.majority * abs(np.log(s.factor))
    return len(others) + 1 >= thresholds.COUNTS.min_repetitions and all(abs(np.log(o.factor)) < most for o in others)


def _has_smaller_and_larger_loads(s: _LoadSize, every: list[_LoadSize]) -> bool:
    """Return whether its session has smaller and larger loads: a nonlinearity would show in one of them too."""
    others = [o.force for o in every if o.session == s.session and o is not s]
    return min(others) < s.force < max(others)


def _is_contradicted_elsewhere(s: _LoadSize, every: list[_LoadSize]) -> bool:
    """Return whether another session has loads of the recorded size that agree with its other sizes."""
    return any(
        o.session != s.session
        and not _is_size_off(o)
        and abs(np.log(o.force * s.factor / s.force)) < thresholds.SHARES.load_tolerance
        for o in every
    )


def _group_load_sizes(tests: LoadTestExperiment) -> list[_LoadSize]:
    """Return the load sizes of all sessions whose loads come in a few sizes."""
    force = np.linalg.norm(tests.wrench[:, :3], axis=1)
    by_springs = predict_displacements(tests)
    read, moved = np.sum(by_springs**2, axis=1), np.sum(by_springs * tests.measured[:, :3], axis=1)
    out = []
    for session in np.unique(tests.session).tolist():
        own = tests.session == session
        label = _label_load_sizes(force[own])
        if label is None:
            continue
        size = np.full(len(force), -1)
        size[own] = label
        share = _compute_force_ratios(tests.pose[own], label, read[own], moved[own])
        for k in range(int(label.max()) + 1):
            each = share[k][np.isfinite(share[k])]
            if len(each) < thresholds.COUNTS.min_comparisons:
                continue
            rows = own.copy()
            rows[own] = label == k
            out.append(_LoadSize(session=session, force=float(np.median(force[rows])), rows=rows, ratio_by_pose=each))
    return out


def _label_load_sizes(force: Array) -> Ints | None:
    """Return the size index (N,) of each load; None if loads do not come in a few sizes."""
    order = np.argsort(force)
    if force[order[-1]] <= 0.0:
        return None
    step = np.diff(force[order]) > thresholds.SHARES.small * force[order[-1]]
    label = np.empty(len(force), np.int64)
    label[order] = np.concatenate([[0], np.cumsum(step)])
    wide = [np.ptp(force[label == k]) for k in range(int(label.max()) + 1)]
    return label if max(wide) < thresholds.SHARES.load_tolerance * force[order[-1]] else None


def _compute_force_ratios(pose: Ints, label: Ints, read: Array, moved: Array) -> Array:
    """Return ratios (sizes, poses) of recorded to implied force, relative to the median of the pose's sizes."""
    _, at = np.unique(pose, return_inverse=True)
    poses, sizes = int(at.max()) + 1, int(label.max()) + 1
    cell = label * poses + at.reshape(-1)
    above, below = (np.bincount(cell, v, sizes * poses).reshape(sizes, poses) for v in (read, moved))
    out = np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.nan)
    out[:, np.isfinite(out).sum(axis=0) < thresholds.COUNTS.min_repetitions] = np.nan
    some = np.isfinite(out).any(axis=0)
    out[:, some] /= np.nanmedian(out[:, some], axis=0)
    return np.asarray(out)


def _build_label_finding(s: _LoadSize, several: bool) -> Finding:
    found, p_value = estimate_force_gain(s.ratio_by_pose, s.factor, s.spread)
    over = found.value
    words = (
        (f"session {s.session}: " if several else "")
        + f"loads recorded as about {s.force:.4g} N read {abs(over):.3g} % too {'much' if over > 0 else 'little'} for "
        f"what the arm does under them, at every pose alike, and larger and smaller ones do not: a weight with a wrong "
        f"label; they were read as {s.force / s.factor:.4g} N"
    )
    session = {"session": build_exact_estimate(float(s.session))} if several else {}
    return build_record_finding(
        COLUMNS.name,
        format_column_location("fx_N"),
        words,
        float("nan"),
        float("nan"),
        p_value,
        {
            "gain": found,
            "force": build_exact_estimate(s.force, "N"),
            **session,
        },
        further_places=(format_column_location("fy_N"), format_column_location("fz_N")),
        stated={"message": words, "force_N": s.force} | ({"session": s.session} if several else {}),
    )
