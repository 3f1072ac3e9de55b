"""Hypotheses that measured TCP poses can show in addition to the base, and those that they cannot.

A zero offset of joint 1 equals a rotation of the tracker frame. One of the last joint equals a shift of the target if
no orientation is measured. Effects that the base absorbs completely are listed as untestable. A step with the sign of a
torque that gravity keeps on one side equals a zero offset and is offered as such only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import format_joint_location, parse_joint_location, parse_location
from machopt.effects import registry
from machopt.effects.joint import angle_dependent_stiffness
from machopt.effects.joint import joint_angle_errors as joint_joint_angle_errors
from machopt.effects.protocol import is_time_dependent
from machopt.effects.structure import as_built_joint_frames as structure_link_geometry
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
    UntestableEffect,
)
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import (
    as_built_joint_frames,
    gravity_compensator,
    joint_angle_errors,
    joint_torque,
    payload,
    sensor_errors,
    structural_compliance,
    thermal_drift,
)
from machopt.measurement.diagnosis.static import unknown_link_masses, unmodelled_pose_errors
from machopt.numerics.array_types import Array

BODY = "body"  # family of compliant bodies
SLIDING_JOINT_REASON = "it slides: it is looked for by its geometry alone, and what gives along it is the base's"
ROUNDING = 1e-8  # relative remainder of a column that lies in the span of the base


def build_measured_pose_catalogue(r: StaticReadings, problem: DiagnosisProblem) -> HypothesisCatalogue:
    """Build every hypothesis that measured poses can show, without those that the base absorbs.

    Args:
        r: Prepared readings.
        problem: Problem with the base columns.

    Returns:
        The catalogue with untestable effects.
    """
    candidates: list[EffectHypothesis] = [
        *joint_angle_errors.build_joint_angle_hypotheses(r),
        *joint_torque.build_pose_couplings(r),
        *as_built_joint_frames.build_geometry_hypotheses(r, problem.base),
        *(
            [*payload.build_static_payload_hypotheses(r), *gravity_compensator.build_pose_hypotheses(r)]
            if unknown_link_masses.has_link_mass(r.masses)
            else []
        ),
        *thermal_drift.build_thermal_hypotheses(r),
        *(
            h
            for h in structural_compliance.build_structure_hypotheses(r)
            if not (r.recording.targets and h.location == "tool")
        ),
    ]
    slides = (
        [] if r.robot.slides is None else [format_joint_location(int(j) + 1) for j in np.flatnonzero(r.robot.slides)]
    )
    candidates = [
        h
        for h in candidates
        if h.effect == structure_link_geometry.EFFECT.name or not _is_at_sliding_joint(h.location, slides)
    ]
    missing = [
        *(UntestableEffect(joint_joint_angle_errors.ZERO.name, where, SLIDING_JOINT_REASON) for where in slides),
        *_list_untestable_effects(r),
    ]
    Q = compute_column_span(problem.base)
    turning = np.array([format_joint_location(j + 1) not in slides for j in range(r.joint_count)])
    drives = np.quantile(np.abs(r.torque), 0.9, axis=0) * turning
    kinds = [e for e in registry.select_joint_torque_effects() if not e.has_memory]
    for j in map(int, np.flatnonzero(turning)):
        where = format_joint_location(j + 1)
        if drives[j] <= thresholds.SHARES.rank * max(drives.max(), 1e-12):
            missing.append(
                UntestableEffect(angle_dependent_stiffness.EFFECT.name, where, "neither weight nor load turns it")
            )
            continue
        span_with_offset = _add_zero_offset(Q, r, j)
        for effect in sorted(kinds, key=lambda e: e.joint_laws[0].includes_weight):
            laws, _ = joint_torque.build_joint_hypotheses(r, j, effect)
            for law, h in ((law, h) for h in laws for law in effect.joint_laws if law.name == h.law):
                shapes = h.shapes
                if law.includes_weight:
                    shapes = tuple(s for s in shapes if _is_distinct_from_offset(h.columns(s), Q, span_with_offset))
                if shapes:
                    candidates.append(replace(h, shapes=shapes))
                else:
                    why = "weight keeps its torque on one side: it is a zero offset"
                    missing.append(
                        UntestableEffect(effect.name, where, why, (joint_joint_angle_errors.ZERO.name, where))
                    )
    if r.recording.registration == "fixed":
        candidates += sensor_errors.build_pose_sensor_hypotheses(r)
    testable = []
    for h in candidates:
        columns = h.columns(h.shapes[len(h.shapes) // 2])
        if h.family == BODY and _has_redundant_coefficients(columns, Q):
            continue
        if compute_remaining_share(columns, Q) > thresholds.SHARES.rank:
            testable.append(h)
        elif (h.effect, h.location) not in {(m.effect, m.location) for m in missing}:
            missing.append(UntestableEffect(h.effect, h.location, _explain_absorbed_effect(h, r)))
    axes = {"session": r.session.astype(float)}
    if np.abs(r.wrench).max() > 0.0:
        axes["load"] = np.linalg.norm(r.wrench[:, :3], axis=1)
    for name, values in (("time", r.recording.time), ("temperature", r.recording.temperature)):
        if values is not None:
            axes[name] = values
    p = r.state.T_base_tool[:, :3, 3]
    axes |= {name: p[:, k] for k, name in enumerate("xyz")} | {
        f"q{j + 1}": r.state.q[:, j] for j in range(r.joint_count)
    }
    testable_names = {(h.effect, h.location) for h in testable}
    untestable = tuple(m for m in missing if (m.effect, m.location) not in testable_names)
    finer = tuple(h for h in joint_angle_errors.build_refined_harmonics(r) if h.name in testable_names)
    return HypothesisCatalogue(
        tuple(testable), untestable, axes, finer, tuple(unmodelled_pose_errors.build_unmodelled_pose_hypotheses(r))
    )


def _is_at_sliding_joint(place: str, slides: list[str]) -> bool:
    """Return whether a law acts at a prismatic joint, where laws of angles and torques do not apply."""
    return parse_location(place).is_joint_location and any(
        format_joint_location(j + 1) in slides for j in parse_joint_location(place)
    )


def compute_column_span(columns: Array) -> Array:
    """Compute an orthonormal basis of the column span; rotations are scaled by ``thresholds.LIMITS.lever``.

    Args:
        columns: (N, D, P) columns.

    Returns:
        (N D, K) orthonormal columns.
    """
    B = _flatten_columns(columns)
    sizes = np.linalg.norm(B, axis=0)
    U, s, _ = np.linalg.svd(B[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s[0]] if len(s) else U)


def compute_remaining_share(columns: Array, Q: Array) -> float:
    """Compute the share of a hypothesis' columns, by norm, outside of a span.

    Args:
        columns: (N, D, p) columns.
        Q: Orthonormal basis, see :func:`compute_column_span`.

    Returns:
        0 to 1.
    """
    A = _flatten_columns(columns)
    size = float(np.linalg.norm(A))
    return float(np.linalg.norm(A - Q @ (Q.T @ A))) / size if size > 0 else 0.0


def _has_redundant_coefficients(columns: Array, Q: Array) -> bool:
    """Return whether the base absorbs some but not all coefficients; then a law with fewer coefficients is used.

    A base that settles under a constant weight shifts all points like a fitted tracker frame.
    """
    each = [compute_remaining_share(columns[:, :, [k]], Q) > thresholds.SHARES.rank for k in range(columns.shape[2])]
    return any(each) and not all(each)


def _flatten_columns(columns: Array) -> Array:
    weight = np.r_[np.ones(3), np.full(columns.shape[1] - 3, thresholds.LIMITS.lever)][:, None]
    return np.asarray((columns * weight).reshape(columns.shape[0] * columns.shape[1], columns.shape[2]))


def _add_zero_offset(Q: Array, r: StaticReadings, j: int) -> Array:
    """Return the span including a zero offset of joint j; unchanged if it already contains one."""
    column = _flatten_columns(r.lift_joint_twist(j, np.ones(len(r))))[:, 0]
    rest = column - Q @ (Q.T @ column)
    rest = rest - Q @ (Q.T @ rest)
    size = float(np.linalg.norm(rest))
    return np.column_stack([Q, rest / size]) if size > ROUNDING * float(np.linalg.norm(column)) else Q


def _is_distinct_from_offset(columns: Array, Q: Array, beside: Array) -> bool:
    """Return whether a law of a joint's torque differs from a zero offset of the joint in these poses."""
    alone = compute_remaining_share(columns, Q)
    return (
        alone > thresholds.SHARES.rank and compute_remaining_share(columns, beside) > thresholds.SHARES.minority * alone
    )


def _list_untestable_effects(r: StaticReadings) -> list[UntestableEffect]:
    out = [
        UntestableEffect("geometric_stiffness", "arm", "counted exactly: the arm is in equilibrium at its true pose")
    ]
    for effect in registry.select_joint_torque_effects():
        if effect.has_memory:
            how = (
                "since when the torque has been there"
                if is_time_dependent(effect.joint_laws[0])
                else ("how the torque came there; load cycles do")
            )
            out.append(UntestableEffect(effect.name, effect.places[0], f"measured poses do not say {how}"))
    if not unknown_link_masses.has_link_mass(r.masses):
        lacks = unknown_link_masses.describe_missing_masses(r.masses)
        out += [
            UntestableEffect("payload", "tool", f"{lacks}; with them weight would show it"),
            UntestableEffect("gravity_compensator", "joint:2", f"{lacks} to tell its torque from weight"),
        ]
    if r.recording.targets:
        out.append(
            UntestableEffect(
                "tool_compliance",
                "tool",
                "the reflectors sit on the flange, so the tool's deflection does not move them",
            )
        )
    if r.recording.time is None and r.recording.temperature is None:
        out.append(
            UntestableEffect("thermal_drift", "environment", "the recording has neither time_s nor temperature_C")
        )
    return out


def _explain_absorbed_effect(h: EffectHypothesis, r: StaticReadings) -> str:
    last = format_joint_location(r.joint_count)
    if h.effect in ("joint_zero_offset", "joint_coupling") and h.location == "joint:1":
        return "it turns everything about a fixed axis: the fitted tracker frame absorbs it"
    if h.effect == "joint_zero_offset" and h.location == last and r.dimensions == 3 and not r.recording.targets:
        return "it shifts the target in the flange, which is fitted; measured orientations would show it"
    if h.effect == "joint_zero_offset" and h.location == last:
        return "it turns all reflectors about one axis, and their places in the flange are fitted"
    return "what is refitted in any case takes it up altogether in these poses"
