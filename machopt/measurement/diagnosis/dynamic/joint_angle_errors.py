"""Joint angle errors without load in a motion: the angle laws of the registry.

As in static poses (:mod:`machopt.measurement.diagnosis.effect_columns.joint_angle_errors`), but transformed to the
channel's coordinates: the secondary encoder, or J_j at the tracked TCP. Penalties and priors of a law are for few
static readings; a motion has thousands of samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location
from machopt.effects import registry
from machopt.effects.protocol import Effect, JointAngleLaw, JointAngleRange
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    Shape,
    ShapeRefinement,
    UntestableEffect,
)
from machopt.measurement.diagnosis.effect_columns.joint_angle_errors import build_joint_angle_hypothesis
from machopt.measurement.diagnosis.effect_columns.motion_columns import ExplainedPower, MotionModel

FINE = 31  # orders evaluated around the best one


def compute_lowest_order(scene: MotionModel, joint: int, turns: float) -> float:
    """Compute the lowest gear order per turn of which the joint's range covers a number of periods.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        turns: Number of periods.

    Returns:
        Order per turn.
    """
    return max(thresholds.LIMITS.weight_order, float(np.ceil(turns * _compute_order_resolution(scene, joint))))


def _compute_order_resolution(scene: MotionModel, joint: int) -> float:
    """Return the difference of orders that amounts to one period over the range of a joint."""
    return 2.0 * np.pi / max(float(np.ptp(scene.motion.q[:, joint])), 1e-9)


def build_order_refinement(scene: MotionModel, joint: int) -> ShapeRefinement:
    """Build the refinement of a gear order; its resolution follows from the range of the joint.

    The order is rounded to an integer if the data agree; otherwise it is an interval.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.

    Returns:
        The refinement.
    """
    resolution = _compute_order_resolution(scene, joint)

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        n = shape[0]
        fine = np.linspace(max(n - share * resolution, 0.5), n + share * resolution, FINE)
        whole = np.arange(np.ceil(fine[0]), np.floor(fine[-1]) + 1.0)
        return tuple(tuple(float(v * k / n) for k in shape) for v in sorted({n, *fine, *whole}))

    def describe_shapes(shapes: Sequence[Shape]) -> str:
        low, high = min(s[0] for s in shapes), max(s[0] for s in shapes)
        if high - low < 1.0:
            return ""
        return (
            f"order not resolved (between {low:.1f} and {high:.1f} a turn): the joint "
            f"turns by {360.0 / resolution:.0f}°"
        )

    return ShapeRefinement(
        shapes_around=about,
        is_preferred=lambda s: float(s[0]).is_integer(),
        describe_ambiguity=describe_shapes,
        minimum_separation=thresholds.LIMITS.partial_periods * resolution,
    )


def build_motion_angle_hypotheses(
    scene: MotionModel, joint: int, fit: ExplainedPower
) -> tuple[list[EffectHypothesis], list[UntestableEffect]]:
    """Build every angle law at every place that moves this joint, if the motion can show it.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        fit: Explained power of the channel's problem.

    Returns:
        The hypotheses, and the effects that the base of the channel absorbs.
    """
    out: dict[tuple[str, str], list[EffectHypothesis]] = {}
    for effect in registry.select_angle_effects():
        for where in effect.search_places:
            by, moved = parse_joint_location(where)
            if moved != joint or by >= scene.joints or scene.prismatic[by] or scene.prismatic[moved]:
                continue
            for law in effect.angle_laws:
                grid = law.grid(compute_motion_angle_range(scene, by)) if scene.is_joint_moving(by) else ()
                found = out.setdefault((effect.file_word, where), [])
                if grid:
                    found.append(_build_angle_hypothesis(scene, effect, where, law, grid))
                slow = _list_slow_orders(scene, by, law, grid)
                if slow:
                    found.append(_penalise_partial_waves(_build_angle_hypothesis(scene, effect, where, law, slow)))
    out = {name: laws for name, laws in out.items() if laws}
    visible_hypotheses: list[EffectHypothesis] = []
    untestable: list[UntestableEffect] = []
    for (effect_name, where), laws in out.items():
        visible = [
            h
            for h in laws
            if fit.compute_remaining_share(h.columns(h.shapes[len(h.shapes) // 2])) > thresholds.SHARES.rank
        ]
        visible_hypotheses += visible
        if not visible:
            untestable.append(UntestableEffect(effect_name, where, "what is refitted in any case takes it up"))
    return visible_hypotheses, untestable


def _list_slow_orders(scene: MotionModel, by: int, law: JointAngleLaw, grid: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """Return orders of which the range covers a period or less; without them a higher order would be reported
    instead.
    """
    if not law.has_angle_range or not scene.is_joint_moving(by) or any(len(s) != 1 for s in grid):
        return ()
    q = scene.motion.q[:, by]
    most = compute_lowest_order(scene, by, thresholds.LIMITS.ripple_periods)
    few = JointAngleRange(
        float(q.min()),
        float(q.max()),
        len(q),
        compute_lowest_order(scene, by, thresholds.LIMITS.partial_periods),
        is_motion=True,
    )
    slow = tuple(s for s in law.grid(few) if len(s) == 1 and s[0] < 2.0 * most)
    return slow if any(s[0] < most for s in slow) else ()


def _penalise_partial_waves(h: EffectHypothesis) -> EffectHypothesis:
    """Return a hypothesis with a penalty: any smooth curve resembles part of a wave."""
    return replace(h, law=f"{h.law}, slow", penalty=h.penalty + thresholds.LEVELS.gain_two_sigma)


def compute_motion_angle_range(scene: MotionModel, joint: int) -> JointAngleRange:
    """Compute the angle range of a joint in a motion.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.

    Returns:
        The range.
    """
    q = scene.motion.q[:, joint]
    return JointAngleRange(
        float(q.min()),
        float(q.max()),
        len(q),
        compute_lowest_order(scene, joint, thresholds.LIMITS.ripple_periods),
        is_motion=True,
    )


def _build_angle_hypothesis(
    scene: MotionModel, effect: Effect, where: str, law: JointAngleLaw, grid: tuple[Shape, ...]
) -> EffectHypothesis:
    by, moved = parse_joint_location(where)
    q = scene.motion.q[:, by]
    bare = build_joint_angle_hypothesis(
        effect, where, law, grid, q, partial(scene.column, moved), scene.motion.average_blocks(q)
    )
    return (
        replace(bare, refinement=build_order_refinement(scene, by), sum_name=law.sum_name)
        if law.has_angle_range
        else bare
    )
