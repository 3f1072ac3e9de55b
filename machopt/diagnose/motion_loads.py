"""What joint torques show beside friction and loads: ripple of a gear, a springy joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.motion_frame import Scene, curve, joint_law
from machopt.diagnose.problem import Correction, Curve, Hypothesis, Quantity, RecordCorrection, Shape
from machopt.effects import registry, within
from machopt.effects.corrections import entry
from machopt.effects.kinematic import WAVES, Waves
from machopt.effects.protocol import Effect, Swinging, SwingLaw
from machopt.effects.waves import waves

ORDERS = 60  # highest gear order per turn of a joint that is looked for


def orders(scene: Scene, joint: int) -> tuple[Shape, ...]:
    """Gear orders per turn that this range of a joint can show."""
    spread = float(np.ptp(scene.motion.q[:, joint]))
    least = max(2, int(np.ceil(calibrated.MOTION.turns * 2.0 * np.pi / max(spread, 1e-9))))
    return tuple((float(n),) for n in range(least, ORDERS + 1))


def ripple(scene: Scene, joint: int, unit: str, factor: float, *, torque: bool) -> list[Hypothesis]:
    """A sin(Nq + φ) of one joint, with and without its second harmonic.

    Args:
        scene: any channel.
        joint: 0-based.
        unit, factor: of the amplitude, report unit per SI unit.
        torque: of torques; else of angles, which the controller can compensate.
    """
    if not scene.moves(joint) or scene.prismatic[joint]:
        return []
    q, where = scene.motion.q[:, joint], f"joint:{joint + 1}"
    shapes = orders(scene, joint)
    if not shapes:
        return []

    def over(s: Shape, harmonics: int) -> Array:
        return waves(q, multiples(s, harmonics))

    def multiples(s: Shape, harmonics: int) -> list[float]:
        return [s[0] * k for k in range(1, harmonics + 1)]

    def law(harmonics: int) -> Hypothesis:
        def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
            if not torque:
                return Waves().sizes(x, np.array(multiples(s, harmonics)))
            out = {"amplitude": Quantity(float(np.hypot(x[0], x[1])) * factor, unit), "order": Quantity(s[0], "1/rev")}
            if harmonics > 1:
                out["second"] = Quantity(float(np.hypot(x[2], x[3])) * factor, unit)
            return out

        def fix(x: Array, s: Shape) -> Correction:
            if torque:
                return RecordCorrection(
                    WAVES.called, where, {"order": s[0], "cos_Nm": float(x[0]), "sin_Nm": float(x[1])}
                )
            over = {within.KEY: within.measured(q)}
            return entry(WAVES, where, x, np.array(multiples(s, harmonics)), over)

        def line(x: Array, s: Shape) -> Curve:
            return curve(
                scene,
                np.degrees(np.mod(q, 2 * np.pi / s[0])),
                over(s, harmonics) @ x * factor,
                f"joint {joint + 1} within one of {s[0]:g} waves a turn in degrees",
                f"in {unit}",
            )

        words = "one wave" if harmonics == 1 else "wave and its second harmonic"
        return joint_law(
            scene,
            joint,
            WAVES.called,
            words,
            "A sin(Nq + φ)" + (" + B sin(2Nq + ψ)" if harmonics > 1 else ""),
            lambda s: over(s, harmonics),
            sizes,
            shapes,
            family="kinematic",
            curve=line,
            correction=fix,
            note="periodic with the gear",
        )

    return [law(1), law(2)]


def springy(scene: Scene, joint: int) -> list[Hypothesis]:
    """Motor torque of an elastic joint: what is behind it moves by −τ/k more, M_j ẍ comes on top."""
    if scene.dynamics is None or scene.predicted is None or scene.prismatic[joint] or not scene.moves(joint):
        return []
    m = scene.motion
    seen = Swinging(-scene.predicted[:, joint], scene.dynamics.own_inertia(m.q)[:, joint], scene.step, scene.first)
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
