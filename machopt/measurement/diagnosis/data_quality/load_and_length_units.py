"""Units of loads or displacements that make the whole arm as stiff as the cell states."""

from __future__ import annotations

import numpy as np

from machopt.effects.recording.record_faults import FORCES, LENGTHS
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault as Problem
from machopt.measurement.identification.data_quality.unit_checks import GENERIC_REACH, GENERIC_STIFFNESS
from machopt.numerics.array_types import Array

MOST_PAIRED = 400  # most readings of a pose that are compared in pairs
SIZES = (  # ratio of recorded to true displacement per load; factors of 1000 are checked earlier
    *((name, 1.0 / LENGTHS[name], "dx_mm", LENGTHS[name]) for name in ("inches", "centimetres")),
    *((name, FORCES[name], "fx_N", FORCES[name]) for name in ("kilograms", "pounds")),
)


def find_displacement_unit_fault(
    tests: LoadTestExperiment, prior: Array | None, reach: float, estimated: bool
) -> Problem | None:
    """Find another unit that makes the whole arm as stiff as the cell states, or closer to robots of its size.

    A common factor on all displacements or all loads leaves no other trace if only forces are recorded. Four
    conditions apply. Most joints must deviate by the factor. An estimated stiffness cannot separate pounds from a
    compliant arm. Displacements whose replicates scatter as stated are in the stated unit. Refitted springs must
    explain the displacement: a compliant link makes springs softer too, and leaves a mismatch that no unit makes.

    Args:
        tests: Load tests in base axes.
        prior: (6,) joint stiffness of the cell, N·m/rad; None if unknown.
        reach: Reach of the arm, m.
        estimated: Whether that stiffness is only estimated from the arm's size.

    Returns:
        The fault with column and factor; None if the stated units hold.
    """
    if prior is None:
        return None
    y, load = tests.measured[:, :3], np.linalg.norm(tests.wrench, axis=1)

    def ratio(stiffness: Array) -> tuple[float, Array]:
        predicted = tests.response()[:, :3] @ (1.0 / stiffness)
        return float(fit_least_absolute_deviations(predicted[:, :, None], y, load)[0]), predicted

    seen, predicted = ratio(prior)
    joints = _compute_softness_factors(tests, prior)
    alike = bool(len(joints) > 2 and joints.min() > 0 and joints.max() < thresholds.RATIOS.double * joints.min())
    far = thresholds.RATIOS.wrong_unit if alike and not estimated else thresholds.RATIOS.doubtful
    if (
        not seen > 0
        or 1 / far < seen < far
        or np.abs(y - seen * predicted).sum() > thresholds.SHARES.majority * np.abs(y).sum()
        or _compute_unexplained_share(tests) > thresholds.SHARES.relevant
    ):
        return None
    usual, _ = ratio(np.full(tests.joint_count, GENERIC_STIFFNESS * (reach / GENERIC_REACH) ** 3))
    scatter = _compute_replicate_scatter(tests)
    for name, value, head, factor in sorted(SIZES, key=lambda s: abs(np.log(seen / s[1]))):
        as_stated = np.inf if alike else abs(np.log(max(usual, 1e-300)))
        nearer = abs(np.log(max(usual, 1e-300) / value)) < min(as_stated, np.log(thresholds.RATIOS.implausible))
        likely = (alike or _are_most_joints_off(joints, value)) and not (
            head == "dx_mm" and _is_scatter_as_stated(scatter, factor, tests)
        )
        if abs(np.log(seen / value)) < np.log(thresholds.RATIOS.double) and nearer and likely:
            return Problem(
                code="units",
                severity="error",
                message=f"displacement per load is {seen:.3g} times what the cell's stiffness gives: the "
                f"columns {head} … seem to hold {name}",
                column=head,
                factor=factor,
            )
    return None


def _compute_unexplained_share(tests: LoadTestExperiment) -> float:
    """Return the share of the displacement that refitted joint springs leave."""
    y, A = tests.measured[:, :3], tests.response()[:, :3]
    left = y - A @ fit_least_absolute_deviations(A, y, np.linalg.norm(tests.wrench, axis=1))
    return float(np.abs(left).sum() / max(float(np.abs(y).sum()), np.finfo(float).tiny))


def _compute_softness_factors(tests: LoadTestExperiment, prior: Array) -> Array:
    """Return for each observable joint the ratio of its compliance to the cell's."""
    y, A = tests.measured[:, :3], tests.response()[:, :3]
    c = fit_least_absolute_deviations(A, y, np.linalg.norm(tests.wrench, axis=1))
    moved = np.abs(A * c).sum(axis=(0, 1))
    return np.asarray((c * prior)[moved > thresholds.SHARES.negligible * moved.sum()])


def _are_most_joints_off(joints: Array, value: float) -> bool:
    """Return whether most joints deviate by about this factor, as a wrong unit does."""
    if len(joints) < 3:
        return False
    middle = float(np.median(joints))
    return middle > 0 and abs(np.log(middle / value)) < abs(np.log(middle))


def _compute_replicate_scatter(tests: LoadTestExperiment) -> float:
    """Return the standard deviation (m) of a coordinate between cycles of equal pose and load; NaN without
    replicates.
    """
    y, A, w = tests.measured[:, :3], tests.response()[:, :3], tests.wrench[:, :3]
    e = y - A @ fit_least_absolute_deviations(A, y, np.linalg.norm(tests.wrench, axis=1))
    apart = []
    for pose in np.unique(tests.pose):
        rows = np.flatnonzero(tests.pose == pose)
        if len(rows) > MOST_PAIRED:  # the number of pairs grows with the square
            rows = np.sort(np.random.default_rng(0).choice(rows, MOST_PAIRED, replace=False))
        i, j = (rows[k] for k in np.triu_indices(len(rows), 1))
        near = (
            np.linalg.norm(w[i] - w[j], axis=1)
            <= thresholds.SHARES.load_tolerance * np.linalg.norm(w[rows], axis=1).max()
        )
        near &= tests.cycle[i] != tests.cycle[j]
        apart.append((e[i] - e[j])[near].ravel())
    every = np.concatenate(apart) if apart else np.zeros(0)
    return 1.4826 * float(np.median(np.abs(every))) / np.sqrt(2.0) if len(every) else float("nan")


def _is_scatter_as_stated(scatter: float, factor: float, tests: LoadTestExperiment) -> bool:
    """Return whether replicates scatter as the recording states rather than as another unit would imply."""
    stated = tests.uncertainty.displacement
    if not stated or not scatter > 0:
        return False
    return bool(abs(np.log(scatter / stated)) < abs(np.log(scatter * factor / stated)))
