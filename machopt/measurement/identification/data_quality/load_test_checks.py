"""Checks of a load-test recording before the fit: units, frames, signs, impossible rows, too few data.

Faulty recordings explain more published mismatches than rare physical effects. An *error* is refused unless the user
accepts its code, because the result would be wrong by a factor or in kind. A *warning* is reported with the result.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from machopt.errors import RecordingError
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.data_quality.alternative_conventions import (
    ConventionCandidate,
    build_convention_candidates,
)
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault, format_row_locations
from machopt.measurement.identification.data_quality.unit_checks import (
    check_displacement_units,
    check_moment_units,
    estimate_reach,
)
from machopt.numerics.array_types import Array

CODES = (  # codes of errors that the user may accept
    "displacement_frame",
    "wrench_frame",
    "frames",
    "load_sign",
    "moment_at_base",
    "moment_at_flange",
    "force_units",
    "joint_units",
    "units",
    "moment_units",
    "rotation_units",
    "sensor_axes",
    "joint_convention",
)


def check_experiment(
    experiment: LoadTestExperiment, robot: Robot, T_flange_tcp: Array, prior: Array | None = None, unknowns: int = 6
) -> list[RecordFault]:
    """Check load tests for faults that would invalidate an identification.

    Args:
        experiment: Load tests as stated.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown.
        unknowns: Number of coefficients to fit.

    Returns:
        The faults, errors first.

    Raises:
        InputError: There is no load or no displacement.
    """
    e = experiment
    for values, what in ((e.wrench, "load"), (e.measured, "displacement")):
        if not values.any():
            raise RecordingError(f"every {what} is zero; there is nothing to identify from", file=e.source)
    reach = estimate_reach(robot, T_flange_tcp)
    lever = check_moment_units(e, reach, prior)
    found = []
    if not any(f.severity == "error" for f in lever):  # frames cannot be judged with wrong units
        ways = build_convention_candidates(e, robot, T_flange_tcp)
        found = _check_conventions(ways)
        if not any(f.severity == "error" for f in found):  # magnitudes cannot be judged in a wrong frame
            found += check_displacement_units(e, ways[0], reach, prior)
    found += [
        *lever,
        *_check_data_amount(e, unknowns),
        *_check_moment_along_force(e),
        *_check_repeated_rows(e),
        *_check_impossible_displacement(e, reach),
        *_check_unloaded_displacement(e),
        *_check_joint_limits(e, robot),
    ]
    return sorted(found, key=lambda f: f.severity != "error")


def refuse_record_faults(
    experiment: LoadTestExperiment, findings: Sequence[RecordFault], accept: Collection[str] = ()
) -> list[str]:
    """Raise an error for faults that are not accepted; return the others as warnings.

    Args:
        experiment: Load tests in base axes.
        findings: Faults of the recording.
        accept: Codes of errors that become warnings.

    Returns:
        Warnings.

    Raises:
        InputError: Lists every error.
    """
    errors = [f for f in findings if f.severity == "error" and f.code not in accept]
    if errors:
        text = "; ".join(f"{f.message} [{f.code}]" for f in errors)
        raise RecordingError(
            f"{text}. If the record is right as it is, accept {errors[0].code}", file=experiment.source
        )
    return [f.message for f in findings]


def _check_conventions(ways: list[ConventionCandidate]) -> list[RecordFault]:
    """Report a frame, sign, unit or reference point that explains the recording clearly better than the stated one.

    Clearly means much better in most poses, slightly better in nearly all poses, or better by so many standard errors
    over poses that noise is excluded. Unmodelled physics does not cause this: the stated convention then still fits
    better.
    """
    stated, rivals = ways[0], ways[1:]
    best = min(rivals, key=lambda r: r.unexplained)
    ratio = best.unexplained / max(stated.unexplained, 1e-300)
    wins, poses = float(np.mean(best.by_pose < stated.by_pose)), len(best.by_pose)
    everywhere = (
        ratio * thresholds.RATIOS.equal_fit <= 1.0
        and wins >= thresholds.SHARES.inseparable_correlation
        and poses >= thresholds.COUNTS.min_groups
    )
    beyond_noise = (
        poses >= thresholds.COUNTS.min_groups
        and ratio <= thresholds.SHARES.inseparable_correlation
        and _compute_gain_per_standard_error(stated, best) >= thresholds.LEVELS.three_sigma
    )
    if not (everywhere or beyond_noise) and (ratio > thresholds.SHARES.majority or wins < thresholds.SHARES.agreement):
        return []
    share = (
        f"{_format_convention_message(best)} of the displacement is explained then, "
        f"{_format_convention_message(stated)} as stated"
    )
    much = ratio <= thresholds.SHARES.min_transfer and (
        stated.unexplained > thresholds.SHARES.min_transfer
        or _compute_largest_change(stated, best) > thresholds.RATIOS.larger
    )
    else_nothing = beyond_noise and thresholds.SHARES.majority * (1 - best.unexplained) > max(
        1 - stated.unexplained, 0.0
    )
    return [
        RecordFault(
            code=best.name, severity="error" if much or else_nothing else "warning", message=f"{best.message} ({share})"
        )
    ]


def _compute_gain_per_standard_error(stated: ConventionCandidate, best: ConventionCandidate) -> float:
    """Return the mean gain of a convention over poses, in standard errors."""
    gain = stated.by_pose - best.by_pose
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-12))


def _compute_largest_change(stated: ConventionCandidate, best: ConventionCandidate) -> float:
    """Return the factor by which the convention changes a relevant compliance."""
    matter = np.maximum(stated.effect, best.effect) > thresholds.SHARES.relevant
    c = np.stack([stated.compliance, best.compliance])[:, matter]
    low, high = c.min(axis=0, initial=np.inf), c.max(axis=0, initial=0.0)
    return float(np.max(high / np.maximum(low, 1e-300), initial=1.0))


def _format_convention_message(way: ConventionCandidate) -> str:
    return f"{100 * max(1 - way.unexplained, 0.0):.0f} %"


def _check_moment_along_force(e: LoadTestExperiment) -> list[RecordFault]:
    """Report moments along the force if all other readings are forces through a point (f · m = 0)."""
    force, moment = e.wrench[:, :3], e.wrench[:, 3:]
    size = np.linalg.norm(force, axis=1) * np.linalg.norm(moment, axis=1)
    there = (np.linalg.norm(moment, axis=1) > thresholds.LIMITS.moment) & (size > 0)
    if there.sum() < thresholds.COUNTS.min_groups:
        return []
    share = np.where(there, np.abs(np.einsum("nc,nc->n", force, moment)) / np.where(there, size, 1.0), 0.0)
    if np.quantile(share[there], 0.9) > thresholds.SHARES.negligible:
        return []  # couples were applied, or noise dominates
    rows = np.flatnonzero(share > thresholds.SHARES.minority)
    if not len(rows):
        return []
    return [
        RecordFault(
            code="moment_along_force",
            severity="warning",
            message=f"{format_row_locations(e, rows)}: the moment has a part along the force, which no single "
            f"force makes, unlike in "
            "all other readings; check sign and axes of the moments there",
            rows=tuple(rows.tolist()),
        )
    ]


def _check_repeated_rows(e: LoadTestExperiment) -> list[RecordFault]:
    """Report readings that are copies of others."""
    steps = e.measured[:, :3] / thresholds.LIMITS.reading_step
    fine = bool(np.abs(steps - np.round(steps)).max() > thresholds.SHARES.negligible)
    keys = (
        [e.wrench, e.measured]
        if fine
        else [e.wrench, e.measured, e.state.q, np.stack([e.pose, e.cycle, e.session], axis=1)]
    )
    table = np.concatenate([np.asarray(k, float) for k in keys], axis=1)
    moved = e.measured.any(axis=1)
    _, first, back = np.unique(table, axis=0, return_index=True, return_inverse=True)
    rows = np.flatnonzero((first[back.reshape(-1)] != np.arange(len(e))) & moved)
    if not len(rows):
        return []
    original = e.format_reading_location(int(first[back.reshape(-1)[rows[0]]]))
    return [
        RecordFault(
            code="repeated_rows",
            severity="warning",
            message=f"{format_row_locations(e, rows)}: the same loads and displacements to the last digit as "
            f"before ({original} at "
            "first); copies make the result look surer than it is, remove them",
            rows=tuple(rows.tolist()),
        )
    ]


def _check_impossible_displacement(e: LoadTestExperiment, reach: float) -> list[RecordFault]:
    most = thresholds.SHARES.negligible * reach
    rows = np.flatnonzero(np.linalg.norm(e.measured[:, :3], axis=1) > most)
    if not len(rows):
        return []
    return [
        RecordFault(
            code="impossible_displacement",
            severity="warning",
            message=f"{format_row_locations(e, rows)}: displaced by more than {1e3 * most:.0f} mm, more than an arm of "
            "this reach deflects; check these rows, or the unit of the displacement",
            rows=tuple(rows.tolist()),
        )
    ]


def _check_unloaded_displacement(e: LoadTestExperiment) -> list[RecordFault]:
    """Report a displacement without load."""
    loaded = e.wrench.any(axis=1)
    if loaded.all():
        return []
    size = np.linalg.norm(e.measured[:, :3], axis=1)
    rows = np.flatnonzero(~loaded & (size > thresholds.SHARES.minority * float(np.median(size[loaded]))))
    if not len(rows):
        return []
    return [
        RecordFault(
            code="moved_without_load",
            severity="warning",
            message=f"{format_row_locations(e, rows)}: displaced although no load is recorded; displacements "
            f"count from the unloaded "
            "state of the same cycle",
            rows=tuple(rows.tolist()),
        )
    ]


def _check_joint_limits(e: LoadTestExperiment, robot: Robot) -> list[RecordFault]:
    """Report joint angles outside of the limits."""
    q = e.state.q
    outside = (q < robot.lower - thresholds.LIMITS.small_rotation) | (
        q > robot.upper + thresholds.LIMITS.small_rotation
    )
    if not outside.any():
        return []
    rows = np.flatnonzero(outside.any(axis=1))
    joint = int(np.argmax(outside.sum(axis=0)))
    low, high = np.degrees(robot.lower[joint]), np.degrees(robot.upper[joint])
    worst = np.degrees(q[rows[np.argmax(outside[rows, joint])], joint])
    return [
        RecordFault(
            code="outside_limits",
            severity="warning",
            message=f"{format_row_locations(e, rows)}: joint {joint + 1} is outside its limits "
            f"({worst:.1f}° where the robot of "
            f"the cell goes from {low:.0f}° to {high:.0f}°); check zero, sign and order of the q columns, or the robot",
            rows=tuple(rows.tolist()),
        )
    ]


def _check_data_amount(e: LoadTestExperiment, unknowns: int) -> list[RecordFault]:
    poses, equations = len(np.unique(e.pose)), e.measured.size
    out = []
    if poses < thresholds.COUNTS.min_identification_poses:
        out.append(
            RecordFault(
                code="few_poses",
                severity="warning",
                message=f"only {poses} pose{'s' if poses > 1 else ''}: joints are separated by posture, and errors "
                "shared by a pose cannot be seen; ten poses or more would work (machopt plan-poses chooses them)",
            )
        )
    if equations < thresholds.COUNTS.min_equations_per_unknown * unknowns:
        out.append(
            RecordFault(
                code="few_readings",
                severity="warning",
                message=f"{len(e)} readings of {e.dimensions} coordinates are {equations} equations for {unknowns} "
                "unknowns; three times as many as unknowns, better more, would tell how sure the result is",
            )
        )
    return out
