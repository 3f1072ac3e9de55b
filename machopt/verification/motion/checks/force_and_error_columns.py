"""Process columns of points.csv recomputed: forces at the driven feed, nominal errors, and probabilities.

========================================  =========================================================================
column                                    recomputed as
========================================  =========================================================================
f_travel_N, f_normal_N, f_axial_N,        :mod:`machopt.verification.motion.process.point_loads` at the largest feed
m_axial_Nm                                of the samples on the way to the point
f_peak_N                                  :mod:`machopt.verification.motion.process.peak_load` at the same feed
ae_mm, ap_mm, phi_*                       :mod:`machopt.verification.motion.checks.contact_columns`
error_*                                   C w of :mod:`machopt.verification.motion.stiffness.arm_compliance` at the
                                          joints of the motion, part and compensation counted in
f1_Hz, a_lim_mm, chatter                  :mod:`machopt.verification.motion.checks.stability_columns`
feed_max_mm_min                           :mod:`machopt.verification.motion.checks.largest_feeds`
p_in, outcome                             20,000 draws (:mod:`machopt.verification.motion.process.random_draws`)
========================================  =========================================================================
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import (
    VerificationCheck,
    build_count_check,
    build_skipped_check,
    build_worst_value_check,
)
from machopt.verification.motion.checks.contact_columns import check_contact_columns, compare_column
from machopt.verification.motion.checks.largest_feeds import LargestFeeds
from machopt.verification.motion.checks.stability_columns import StabilityTables, check_stability
from machopt.verification.motion.kinematics.encoder_correction import compute_true_angles
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.process.peak_load import recompute_peaks
from machopt.verification.motion.process.point_loads import RecomputedLoads, recompute_loads
from machopt.verification.motion.process.predicted_errors import PredictedErrors, predict_errors
from machopt.verification.motion.process.random_draws import find_unsupported_draws
from machopt.verification.motion.stiffness import arm_compliance
from machopt.verification.motion.stiffness.spring_terms import UnknownTermError
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

LEAST_SAMPLES = 2  # between which joints are interpolated
FORCE_SHARE, FORCE_N = 2e-3, 0.05  # numerical integration, and feeds that are printed to 1e-3 mm/min
ERROR_SHARE, ERROR_MM, ERROR_DEG = 5e-3, 5e-4, 5e-4  # joints between planning points are interpolated
PROBABILITY = 0.02
FORCE_COLUMNS = ("f_travel_N", "f_normal_N", "f_axial_N", "m_axial_Nm")
PRINTED_PROBABILITY = 5e-6  # half of the last printed decimal: on it either outcome may follow


def check_process_columns(
    cell: Cell,
    toolpath: Toolpath,
    points: ExportedPoints,
    motion: ExportedMotion,
    arm: UrdfKinematics,
    options: PlanOptions,
) -> list[VerificationCheck]:
    """Return the checks of the process columns; none where the cell has no process.

    Args:
        cell: The cell with the tool of this part of the job.
        toolpath: Its toolpath, with the operation of process.yaml of each point.
        points: Rows of points.csv.
        motion: The exported motion.
        arm: Kinematics of the arm.
        options: The planning options.
    """
    if cell.process is None or toolpath.process_operation is None:
        extra = [name for name in FORCE_COLUMNS if name in points.numbers]
        return [build_count_check("points.csv process columns", extra, "columns")] if extra else []
    missing = [name for name in (*FORCE_COLUMNS, "p_in") if name not in points.numbers]
    if missing:
        return [build_count_check("points.csv process columns", missing, "columns")]
    if not points.is_complete(len(toolpath)):
        return [build_skipped_check("points.csv process columns", "points.csv has not one row a toolpath point")]
    driven = find_largest_feed(toolpath, motion)
    loads = recompute_loads(cell, toolpath, driven, toolpath.process_operation)
    checks = [*_check_forces(points, loads), *check_contact_columns(cell, toolpath, points, loads)]
    if "f_peak_N" in points.numbers:
        peaks = recompute_peaks(cell, toolpath, loads, points.numbers["f_peak_N"])
        checks.append(compare_column(points, "f_peak_N", *peaks))
    name = "points.csv predicted errors"
    if cell.stiffness is None:
        return [*checks, build_skipped_check(name, "the cell names no stiffness")]
    try:
        law = arm_compliance.ComplianceModel(cell, arm, cell.stiffness)
    except UnknownTermError as error:
        return [*checks, build_skipped_check(name, f"no second law is written for {error}")]
    true_motion = replace(motion, q=compute_true_angles(cell.kinematics, motion.q))
    true_points = _leave_out_unplaced_rows(replace(points, q=compute_true_angles(cell.kinematics, points.q)))
    if np.isfinite(motion.point).sum() < LEAST_SAMPLES:
        return [
            *checks,
            build_count_check(name, [f"trajectory.csv has no {LEAST_SAMPLES} samples at points"], "samples"),
        ]
    found = predict_errors(cell, toolpath, loads, true_motion, true_points, arm, law)
    tables = StabilityTables(cell=cell, toolpath=toolpath, loads=loads, points=true_points, arm=arm, law=law)
    checks += [*_check_errors(points, found), *check_stability(tables, options.min_stability_ratio)]
    checks.append(_check_tolerances(cell, toolpath, points))
    if not find_unsupported_draws(cell):

        def compute_probability(feed: Array, picked: Bools) -> Array:
            assert toolpath.process_operation is not None
            own = recompute_loads(cell, toolpath, feed, toolpath.process_operation)
            is_checked = true_points.ok & picked[np.clip(true_points.point, 0, len(picked) - 1)]
            some = replace(true_points, status=tuple("ok" if flag else "left out" for flag in is_checked))
            return predict_errors(cell, toolpath, own, true_motion, some, arm, law).p_in

        checks += LargestFeeds(
            cell=cell,
            toolpath=toolpath,
            points=points,
            loads=loads,
            driven=driven,
            compute_probability=compute_probability,
        ).check()
    return [*checks, *_check_probabilities(cell, points, found), _check_unknown(cell, toolpath, points, found)]


def _leave_out_unplaced_rows(points: ExportedPoints) -> ExportedPoints:
    """Return the points without a configuration where a joint is empty; nothing follows from one there."""
    placed: Bools = np.asarray(np.isfinite(np.hstack([points.q, points.external])).all(axis=1))
    words = zip(points.status, placed.tolist(), strict=True)
    return replace(points, status=tuple(word if known else "left out" for word, known in words))


def find_largest_feed(toolpath: Toolpath, motion: ExportedMotion) -> Array:
    """Return (N,) the largest feed of the cutting samples on the way to each point, m/s.

    Args:
        toolpath: The toolpath.
        motion: The exported motion.
    """
    out = toolpath.feed.copy()
    end = np.ceil(np.nan_to_num(motion.point, nan=-1.0) - 1e-9).astype(int)
    cuts = np.flatnonzero((motion.move == MoveKind.CUT) & (end >= 0) & (end < len(toolpath)))
    reached = np.zeros(len(toolpath))
    np.maximum.at(reached, end[cuts], motion.feed[cuts])
    slower = (reached > 0) & np.isfinite(toolpath.feed)
    out[slower] = np.minimum(reached, toolpath.feed)[slower]
    return out


def _check_forces(points: ExportedPoints, loads: RecomputedLoads) -> list[VerificationCheck]:
    wanted = np.column_stack([loads.force, loads.moment])
    wanted[loads.is_unknown] = np.nan
    size = np.nan_to_num(np.linalg.norm(loads.force, axis=1))
    size_of = (size, size, size, np.abs(np.nan_to_num(loads.moment)))
    limits = (FORCE_N, FORCE_N, FORCE_N, 1e-3)
    return [
        compare_column(points, name, wanted[:, n], limits[n] + FORCE_SHARE * size_of[n])
        for n, name in enumerate(FORCE_COLUMNS)
    ]


def _check_errors(points: ExportedPoints, predicted_errors: PredictedErrors) -> list[VerificationCheck]:
    checks = []
    for name, wanted in (
        ("along", predicted_errors.along),
        ("across", predicted_errors.across),
        ("normal", predicted_errors.normal),
    ):
        limit = ERROR_MM + ERROR_SHARE * 1e3 * np.nan_to_num(np.abs(predicted_errors.size))
        checks.append(compare_column(points, f"error_{name}_mm", 1e3 * wanted, limit))
    axis = np.degrees(predicted_errors.axis)
    return [*checks, compare_column(points, "error_axis_deg", axis, ERROR_DEG + ERROR_SHARE * np.nan_to_num(axis))]


def _check_probabilities(
    cell: Cell, points: ExportedPoints, predicted_errors: PredictedErrors
) -> list[VerificationCheck]:
    assert cell.process is not None
    why = find_unsupported_draws(cell)
    stated = points.numbers["p_in"]
    words = points.words.get("outcome", ())
    quantile = cell.process.quantile
    wrong = [f"point {p}: {word} with p_in {v:.3f}" for p, word, v in zip(points.point, words, stated, strict=False)
             if not _fits(word, v, quantile)]  # fmt: skip
    out = [build_count_check("points.csv outcome", wrong, "rows"), _check_bare_probabilities(points)]
    if why:
        return [*out, build_skipped_check("points.csv p_in", why)]
    known = np.isfinite(stated)
    off = np.where(known, np.abs(stated - predicted_errors.p_in), 0.0)
    return [
        *out,
        build_worst_value_check(
            "points.csv p_in",
            "1",
            np.where(known & np.isnan(predicted_errors.p_in), 1.0, off),
            PROBABILITY,
            "point {}".format,
        ),
    ]


def _check_bare_probabilities(points: ExportedPoints) -> VerificationCheck:
    """Find probabilities of the deflection alone that are none, or that stand where the outcome is known."""
    stated = points.numbers.get("p_in_deflection_only", np.full(len(points.point), np.nan))
    wrong = [
        f"point {p}: {value:g}"
        for p, word, value in zip(points.point, points.words.get("outcome", ()), stated, strict=False)
        if np.isfinite(value) and (word != "unknown" or not 0.0 <= value <= 1.0)
    ]
    return build_count_check("points.csv p_in_deflection_only", wrong, "rows")


def _check_tolerances(cell: Cell, toolpath: Toolpath, points: ExportedPoints) -> VerificationCheck:
    """Compare tolerance_mm of each point that has an outcome with the limit of its operation."""
    assert cell.process is not None
    assert toolpath.process_operation is not None
    wanted = np.full(len(toolpath), np.nan)
    for point, word in enumerate(points.words.get("outcome", ())):
        k = toolpath.process_operation[point]
        if word and k >= 0:
            limits = cell.process.operations[k].tolerance
            least = min(limits.position, limits.depth, limits.surface)
            wanted[point] = 1e3 * least if np.isfinite(least) else np.nan
    return compare_column(points, "tolerance_mm", wanted, np.full(len(toolpath), 1e-5))


def _check_unknown(
    cell: Cell, toolpath: Toolpath, points: ExportedPoints, predicted_errors: PredictedErrors
) -> VerificationCheck:
    """Find outcomes that are stated as unknown although every input is there."""
    assert cell.process is not None
    assert toolpath.process_operation is not None
    stiffness = cell.stiffness
    is_complete = stiffness is not None and not stiffness.estimated and stiffness.position is None
    has_spread = [_states_spread(cell.process, one) for one in cell.process.operations]
    wrong = [
        f"point {points.point[n]}: p_in {predicted_errors.p_in[n]:.3f} follows"
        for n, word in enumerate(points.words.get("outcome", ()))
        if is_complete
        and word == "unknown"
        and np.isfinite(predicted_errors.p_in[n])
        and has_spread[toolpath.process_operation[n]]
    ]
    return build_count_check("points.csv unknown outcomes", wrong, "points")


def _states_spread(process: CuttingProcess, one: ProcessOperation) -> bool:
    """Return whether the spread of an operation's force is stated."""
    if one.kind == "force":
        return one.spread is not None
    if one.kind == "milling":
        return process.materials[one.material].has_milling_spread
    return all(process.materials[layer.material].has_drilling_spread for layer in one.layers)


def _fits(word: str, probability: float, quantile: float) -> bool:
    if np.isnan(probability):
        return word in ("", "unknown")
    ends = (probability - PRINTED_PROBABILITY, probability + PRINTED_PROBABILITY)
    return word in {"pass" if p >= quantile else "fail" if p < 0.5 else "marginal" for p in ends}
