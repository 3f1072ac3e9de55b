"""Loads and displacements that are inconsistent for any arm: computed moments, or a load recorded with a wrong
direction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.sensor_errors import DISPLACEMENT, LOAD
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.identification.data_quality.alternative_conventions import fit_bounded_absolute_deviations
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import skew_matrix

STEPS = 40  # iterations of reweighted least squares


def correct_inconsistent_loads(
    recording: Recording, robot: Robot, T_flange_tcp: Array
) -> tuple[Recording, list[Finding]]:
    """Detect loads that were computed instead of measured, or that acted otherwise than recorded, and correct certain
    cases.

    Args:
        recording: Load tests with corrected units and frames.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    out: list[Finding] = []
    recording, lever = _correct_computed_moments(recording, robot, T_flange_tcp)
    out += lever
    stated = _compute_unexplained_share(recording, robot, T_flange_tcp)
    if stated < thresholds.SHARES.majority:
        return recording, out
    assert recording.wrench is not None  # kind deflection
    assert recording.displacement is not None
    w, d = recording.wrench, recording.displacement
    hung = np.zeros_like(w)
    hung[:, 2] = -np.linalg.norm(w[:, :3], axis=1)
    ways: dict[tuple[str, int], Recording] = {}
    for load, wrench, frame in (("recorded", w, recording.wrench_frame), ("hung", hung, "base")):
        for axis in (-1, 0, 1, 2):
            turned = d.copy()
            if axis >= 0:
                turned[:, axis] *= -1.0
            ways[load, axis] = replace(recording, wrench=wrench, wrench_frame=frame, displacement=turned)
    left = {k: _compute_unexplained_share(r, robot, T_flange_tcp) for k, r in ways.items()}
    load, axis = best = min(left, key=lambda k: left[k])
    if left[best] > thresholds.SHARES.majority * stated:
        return recording, out
    before, after = (1e3 * v * float(np.mean(np.abs(d[:, :3]))) for v in (stated, left[best]))
    against = float(np.mean(np.einsum("nc,nc->n", w[:, :3], d[:, :3]) < 0))
    chance = 0.5 ** len(np.unique(recording.pose))  # probability that every pose agrees by chance
    text = (
        f"{100 * against:.0f} % of the readings move against their load. "
        if against > thresholds.SHARES.agreement
        else ""
    )
    if load == "hung":
        out.append(
            build_record_finding(
                LOAD.name,
                "sensor:force",
                f"{text}Displacements fit a weight of the recorded size that hangs straight down, not the recorded "
                "directions",
                before,
                after,
                chance,
            )
        )
        text = ""
    if axis >= 0:
        name = "xyz"[axis]
        out.append(
            build_record_finding(
                DISPLACEMENT.name,
                "sensor:displacement",
                f"{text}d{name} counts against {name} of the stated axes",
                before,
                after,
                chance,
            )
        )
    return ways[best], out


def _correct_computed_moments(
    recording: Recording, robot: Robot, T_flange_tcp: Array
) -> tuple[Recording, list[Finding]]:
    """Correct moments that equal one lever arm in base axes times the force in every pose: computed, not measured at
    the TCP.
    """
    w = recording.wrench
    assert w is not None  # kind deflection
    tests = build_load_test_experiment(recording, robot, T_flange_tcp)
    f, m = tests.wrench[:, :3], w[:, 3:]
    if (
        recording.wrench_frame != "base"
        or not m.any()
        or len(np.unique(tests.pose)) < thresholds.COUNTS.min_comparisons
    ):
        return recording, []
    R = tests.T_base_tcp[:, :3, :3]
    spread = float(np.linalg.norm((R - R.mean(axis=0)).reshape(-1, 9), axis=1).mean() / np.sqrt(2.0))
    if spread < thresholds.LIMITS.attitude_spread:
        return recording, []
    A = np.concatenate([-skew_matrix(f), np.broadcast_to(np.eye(3), (len(f), 3, 3))], axis=2).reshape(-1, 6)
    y, weight = m.reshape(-1), np.ones(m.size)
    x: Array = np.zeros(6)
    for _ in range(STEPS):  # least absolute deviations: robust against single wrong rows
        x = np.asarray(np.linalg.lstsq(A * weight[:, None], y * weight, rcond=None)[0], float)
        weight = 1.0 / np.sqrt(np.maximum(np.abs(y - A @ x), 1e-3))
    share = 1.0 - float(np.median(np.abs(y - A @ x)) / max(np.median(np.abs(y)), 1e-9))
    if share < thresholds.SHARES.inseparable_correlation:
        return recording, []
    bare = w.copy()
    bare[:, 3:] = 0.0
    forces = replace(recording, wrench=bare, wrench_point=None)
    stated, without = (
        _compute_unexplained_share(recording, robot, T_flange_tcp),
        _compute_unexplained_share(forces, robot, T_flange_tcp),
    )
    r = 1e3 * x[:3]
    size = float(np.linalg.norm(r))
    typical = 1e3 * float(np.mean(np.abs(tests.measured[:, :3])))
    place = f"({r[0]:.0f}, {r[1]:.0f}, {r[2]:.0f} mm)".replace("-", "−")
    words = (
        f"the moments are, to {100 * (1 - share):.1g} % in the middle, one lever of base_link axes {place} times the "
        f"force plus a constant, in postures that turn the tool by {np.degrees(spread):.0f}°: no load at the tool "
        f"gives that; {'they were left out' if without < stated else 'they were kept'}"
    )
    found = build_record_finding(
        LOAD.name,
        "sensor:force",
        words,
        typical * stated,
        typical * min(stated, without),
        0.5 ** len(np.unique(tests.pose)),
        {"lever": build_exact_estimate(size, "mm")},
    )
    return (forces if without < stated else recording), [found]


def _compute_unexplained_share(recording: Recording, robot: Robot, T_flange_tcp: Array) -> float:
    """Return the share of the translations that six non-negative joint compliances leave (absolute deviations)."""
    tests = build_load_test_experiment(recording, robot, T_flange_tcp)
    A, y = tests.response()[:, :3], tests.measured[:, :3]
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    x = fit_bounded_absolute_deviations(A, y, load)
    return float(np.abs(y - A @ x).sum() / max(np.abs(y).sum(), 1e-300))
