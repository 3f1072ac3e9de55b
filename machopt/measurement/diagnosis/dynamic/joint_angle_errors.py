"""Where the arm stands without any load, as a motion sees it: the laws of port angle of the registry.

As in settled poses (``measurement/diagnosis/effect_columns/joint_angle_errors.py``), lifted by what the channel sees of
a joint: its link-side encoder,
or J_j at the tip. A law's penalty and prior are of few readings, and a motion has thousands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from machopt.data_types.locations import parse_joint_location
from machopt.effects import registry
from machopt.effects.protocol import Effect, JointAngleLaw, JointAngleRange
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    Shape,
    ShapeRefinement,
    UntestableEffect,
)
from machopt.measurement.diagnosis.effect_columns.joint_angle_errors import build_joint_angle_hypothesis
from machopt.measurement.diagnosis.effect_columns.motion_columns import ExplainedPower, MotionModel

FINE = 31  # orders about one that are profiled


def compute_lowest_order(scene: MotionModel, joint: int, turns: float) -> float:
    """The slowest gear order per turn of which this range of a joint (0-based) shows so many waves."""
    return max(thresholds.MOTION.slowest_order, float(np.ceil(turns * _compute_order_resolution(scene, joint))))


def _compute_order_resolution(scene: MotionModel, joint: int) -> float:
    """Orders per turn by which two waves differ by one over the range of a joint."""
    return 2.0 * np.pi / max(float(np.ptp(scene.motion.q[:, joint])), 1e-9)


def build_order_refinement(scene: MotionModel, joint: int) -> ShapeRefinement:
    """An order is as sure as the range of its joint lets it be: whole where the data agree, else an interval."""
    apart = _compute_order_resolution(scene, joint)

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        n = shape[0]
        fine = np.linspace(max(n - share * apart, 0.5), n + share * apart, FINE)
        whole = np.arange(np.ceil(fine[0]), np.floor(fine[-1]) + 1.0)
        return tuple(tuple(float(v * k / n) for k in shape) for v in sorted({n, *fine, *whole}))

    def said(shapes: Sequence[Shape]) -> str:
        low, high = min(s[0] for s in shapes), max(s[0] for s in shapes)
        if high - low < 1.0:
            return ""
        return f"order not resolved (between {low:.1f} and {high:.1f} a turn): the joint turns by {360.0 / apart:.0f}°"

    return ShapeRefinement(
        shapes_around=about,
        is_preferred=lambda s: float(s[0]).is_integer(),
        describe_ambiguity=said,
        minimum_separation=thresholds.MOTION.beats * apart,
    )


def build_motion_angle_hypotheses(
    scene: MotionModel, joint: int, fit: ExplainedPower
) -> tuple[list[EffectHypothesis], list[UntestableEffect]]:
    """Every law at every place that moves this joint (0-based), where the motion can show one.

    Also those that the channel's base takes up: an angle that grows with the joint's own torque, say.
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
    kept: list[EffectHypothesis] = []
    untestable: list[UntestableEffect] = []
    for (effect_name, where), laws in out.items():
        shown = [
            h
            for h in laws
            if fit.compute_remaining_share(h.columns(h.shapes[len(h.shapes) // 2])) > thresholds.RESTING.taken_up
        ]
        kept += shown
        if not shown:
            untestable.append(UntestableEffect(effect_name, where, "what is refitted in any case takes it up"))
    return kept, untestable


def _list_slow_orders(scene: MotionModel, by: int, law: JointAngleLaw, grid: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """Orders of which the range shows part of a wave or little more, without which a faster one would be named."""
    if not law.has_angle_range or not scene.is_joint_moving(by) or any(len(s) != 1 for s in grid):
        return ()
    q = scene.motion.q[:, by]
    most = compute_lowest_order(scene, by, thresholds.MOTION.turns)
    few = JointAngleRange(
        float(q.min()),
        float(q.max()),
        len(q),
        compute_lowest_order(scene, by, thresholds.MOTION.few_turns),
        is_motion=True,
    )
    slow = tuple(s for s in law.grid(few) if len(s) == 1 and s[0] < 2.0 * most)
    return slow if any(s[0] < most for s in slow) else ()


def _penalise_partial_waves(h: EffectHypothesis) -> EffectHypothesis:
    """Anything smooth looks like part of a wave: it has to say more than a law of few numbers."""
    return replace(h, law=f"{h.law}, slow", penalty=h.penalty + thresholds.MOTION.of_few_turns)


def compute_motion_angle_range(scene: MotionModel, joint: int) -> JointAngleRange:
    """What the angles of a joint (0-based) in a motion can show."""
    q = scene.motion.q[:, joint]
    return JointAngleRange(
        float(q.min()),
        float(q.max()),
        len(q),
        compute_lowest_order(scene, joint, thresholds.MOTION.turns),
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
