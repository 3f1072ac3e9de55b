"""Joint angle errors without load in measured poses: the angle laws of the registry.

Each law is an additional angle Δ_j of one joint as a function of the encoder angles q, transformed by the Jacobian
column J_j. The exported joint values compensate it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import format_joint_location, parse_joint_location
from machopt.effects import measured_angle_range, registry
from machopt.effects.joint.harmonic_functions import ARCSEC
from machopt.effects.joint.joint_angle_errors import LOW_ORDERS, MOST_HIGH
from machopt.effects.kinematic_corrections import build_kinematic_correction
from machopt.effects.protocol import DEGREE, Effect, JointAngleLaw, JointAngleRange
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, LawCurve, Shape
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.numerics.array_types import Array

FINE = 400  # points of a law's curve over the range


def build_joint_angle_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build every angle law at every likely place, if the measured angles can show it.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    out = []
    for effect in registry.select_angle_effects():
        for where in r.list_places(effect.search_places):
            by, _ = parse_joint_location(where)
            for law in effect.angle_laws:
                grid = law.grid(compute_joint_angle_range(r, by))
                if grid:
                    out.append(_build_pose_hypothesis(r, effect, where, law, grid))
    return out


def build_refined_harmonics(r: StaticReadings) -> list[EffectHypothesis]:
    """Build angle laws with finer order grids, which are not tried first because many shapes fit noise.

    A gear's tooth order or its overtone may exceed one order per few angles. A large grid raises the gain reachable
    by chance. If a mismatch remains that no other law explains, these orders are tried.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    out = []
    for effect in registry.select_angle_effects():
        for where in r.list_places(effect.search_places):
            by, _ = parse_joint_location(where)
            own = compute_joint_angle_range(r, by)
            if own.max_shapes < LOW_ORDERS:
                continue  # not even the low orders have their angles
            for law in effect.angle_laws:
                grid = _build_refined_grid(own, law)
                if grid:
                    out.append(_build_pose_hypothesis(r, effect, where, law, grid))
    return out


def _build_refined_grid(joint_angle_range: JointAngleRange, law: JointAngleLaw) -> tuple[Shape, ...]:
    """Return shapes beyond the normal grid: as many as for abundant angles, including the integer orders."""
    known, many = law.grid(joint_angle_range), law.grid(replace(joint_angle_range, max_shapes=LOW_ORDERS + MOST_HIGH))
    highest = max((s[-1] for s in many if s), default=0.0)
    whole = tuple(s for s in law.grid(replace(joint_angle_range, is_motion=True)) if s and s[-1] <= highest)
    return tuple(sorted({*many, *whole} - set(known)))


def compute_joint_angle_range(r: StaticReadings, j: int) -> JointAngleRange:
    """Compute the angle range of a joint and the number of shapes that it can show.

    Each order requires several distinct angles (``COUNTS.min_equations_per_unknown``). A gravity compensator causes the
    first two orders of its joint, so these are not offered as a transmission error there.

    Args:
        r: Static readings.
        j: Joint index, 0-based.

    Returns:
        The range.
    """
    q = r.state.q[:, j]
    low, high = float(q.min()), float(q.max())
    distinct = len(np.unique(np.round(q / thresholds.LIMITS.joint_motion)))
    is_observable = high - low >= thresholds.LIMITS.joint_range and distinct >= thresholds.COUNTS.min_groups
    balanced = any(format_joint_location(j + 1) in e.places for e in registry.select_parallel_torque_effects())
    most = int(distinct / thresholds.COUNTS.min_equations_per_unknown) if is_observable else 0
    return JointAngleRange(low, high, most, thresholds.LIMITS.gear_order if balanced else 1.0)


def _build_pose_hypothesis(
    r: StaticReadings, effect: Effect, where: str, law: JointAngleLaw, grid: tuple[Shape, ...]
) -> EffectHypothesis:
    by, moved = parse_joint_location(where)
    q = r.state.q[:, by]
    bare = build_joint_angle_hypothesis(
        effect, where, law, grid, q, lambda columns: r.lift_joint_twist(moved, columns), q
    )
    # a constant angle is exact: iterations are linearised about the current estimate
    return replace(
        bare, penalty=law.penalty, prior_sigma=law.prior, sum_name=law.sum_name, is_exact=effect.form_uncertainty == 0.0
    )


def build_joint_angle_hypothesis(
    effect: Effect,
    where: str,
    law: JointAngleLaw,
    grid: tuple[Shape, ...],
    q: Array,
    lift: Callable[[Array], Array],
    read: Array,
) -> EffectHypothesis:
    """Build the hypothesis of an angle law at a place.

    Args:
        effect: Effect of the law.
        where: Location.
        law: The angle law.
        grid: Shapes to try.
        q: (M,) encoder angles of the driving joint, rad.
        lift: Function from (M, p) rad of the moved joint to (N, D, p) of the readings.
        read: (N,) the driving angles by reading, rad, for the figure.

    Returns:
        The hypothesis.
    """
    by, _ = parse_joint_location(where)
    over = (
        {measured_angle_range.RANGE_KEY: measured_angle_range.compute_measured_range(q)} if law.has_angle_range else {}
    )

    def curve(x: Array, shape: Shape) -> LawCurve:
        at = np.linspace(q.min(), q.max(), FINE)
        line, each = (law.columns(np.array(shape), a) @ x / ARCSEC for a in (at, read))
        return LawCurve(
            x=at / DEGREE,
            law=line,
            x_label=f"joint {by + 1} in deg",
            y_label="angle in arcsec",
            data_x=read / DEGREE,
            per_reading=each,
        )

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=lambda s: lift(law.columns(np.array(s), q)),
        quantities=lambda x, s: law.sizes(x, np.array(s)),
        shapes=grid,
        correction=lambda x, s: build_kinematic_correction(effect, where, x, np.array(s), over),
        family="kinematic",
        note=law.note,
        curve=curve if law.shape else None,
    )
