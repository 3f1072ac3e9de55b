"""What joint torques show beside friction and loads: ripple of a gear, a springy joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.laws.motion_frame import Scene, curve, joint_law
from machopt.diagnose.moving.angles import orders, swept
from machopt.diagnose.nouns.problem import Correction, Curve, Hypothesis, Quantity, RecordCorrection, Shape
from machopt.domain.location import joint_at
from machopt.effects import registry
from machopt.effects.kinematic import SUM, WAVES, wave_orders, wave_sizes
from machopt.effects.protocol import Effect, Swinging, SwingLaw
from machopt.effects.waves import Turning


def ripple(scene: Scene, joint: int) -> list[Hypothesis]:
    """A torque A sin(Nq + φ) of one joint (0-based), with and without its second harmonic: what uneven gears ask."""
    if not scene.moves(joint) or scene.prismatic[joint]:
        return []
    orders_shown = wave_orders(swept(scene, joint))
    shapes: dict[int, tuple[Shape, ...]] = {
        1: tuple((n,) for n in orders_shown),
        2: tuple((n, 2 * n) for n in orders_shown if 2 * n <= orders_shown[-1]),
    }
    turning = Turning(scene.motion.q[:, joint])
    return [_ripple(scene, joint, turning, shapes[k], k) for k in (1, 2) if shapes[k]]


def _ripple(scene: Scene, joint: int, turning: Turning, shapes: tuple[Shape, ...], harmonics: int) -> Hypothesis:
    q, over, where = turning.angle, turning.waves, joint_at(joint + 1)

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return wave_sizes(np.hypot(x[0::2], x[1::2]), s, "N·m", doubled=harmonics > 1)

    def fix(x: Array, s: Shape) -> Correction:
        stated = {"per_turn": list(s), "cos_Nm": x[0::2].tolist(), "sin_Nm": x[1::2].tolist()}
        return RecordCorrection(WAVES.called, where, stated)

    def line(x: Array, s: Shape) -> Curve:
        label = f"joint {joint + 1} within one of {s[0]:g} waves a turn in degrees"
        return curve(scene, np.degrees(np.mod(q, 2 * np.pi / s[0])), over(s) @ x, label, "in N·m")

    return joint_law(
        scene,
        joint,
        WAVES.called,
        "one wave" if harmonics == 1 else "wave and its second harmonic",
        "A sin(Nq + φ)" + (" + B sin(2Nq + ψ)" if harmonics > 1 else ""),
        over,
        sizes,
        shapes,
        family="kinematic",
        curve=line,
        correction=fix,
        note="periodic with the gear",
        finer=orders(scene, joint),
        summed=SUM if harmonics == 1 else "",
    )


def springy(scene: Scene, joint: int, inertia: Array) -> list[Hypothesis]:
    """Motor torque of an elastic joint: what is behind it moves by −τ/k more, M_j ẍ comes on top.

    Args:
        scene: channel torque.
        joint: 0-based.
        inertia: (M, n) kg·m² behind each joint.
    """
    if scene.predicted is None or scene.prismatic[joint] or not scene.moves(joint):
        return []
    if inertia[:, joint].min() <= 0.0:  # a last link without mass: nothing swings
        return []
    m = scene.motion
    seen = Swinging(-scene.predicted[:, joint], inertia[:, joint], scene.step, scene.first)
    laws = ((e, law, law.grid(m.rate)) for e in registry.of_swings() for law in e.swings)
    return [_springy(scene, joint, e, law, seen, grid) for e, law, grid in laws if grid]


def _springy(
    scene: Scene, joint: int, effect: Effect, law: SwingLaw, seen: Swinging, grid: tuple[Shape, ...]
) -> Hypothesis:
    """The coefficient is how much of the spring's own inertia force is there: compliance times stiffness."""
    m = scene.motion

    def response(s: Shape) -> Array:
        return seen.inertia * m.differentiate(m.differentiate(law.deflection(np.array(s), seen)))

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        at = np.array(s)
        return law.sizes(float(x[0]) / law.stiffness(at, seen), at, seen)

    return joint_law(
        scene,
        joint,
        effect.called,
        law.name,
        f"τ += M φ̈, {law.equation}",
        response,
        sizes,
        grid,
        lower=(0.0,),
        family="vibration",
        note=effect.note,
    )
