"""What joint torques show beside friction: a payload, a compensator, a clock, ripple of a gear, a springy joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.motion_frame import Scene, curve, joint_law
from machopt.diagnose.problem import Correction, Curve, Hypothesis, Quantity, RecordCorrection, Shape
from machopt.effects import files
from machopt.effects.compensator import EFFECT, HARMONIC, LINKAGE
from machopt.effects.corrections import entry
from machopt.effects.kinematic import WAVES, Waves
from machopt.effects.protocol import Beside
from machopt.effects.waves import waves

ORDERS = 60  # highest gear order per turn of a joint that is looked for
TURNS = 1.5  # waves within the range of the joint, at least: fewer are no ripple
BANDS = (3.0, 4.5, 6.5, 9.5, 14.0, 20.0)  # Hz


def compensator(scene: Scene) -> list[Hypothesis]:
    """A spring between two pins that helps joint 2: harmonic, or with the length of the spring."""
    if scene.joints < 2 or not scene.moves(1) or scene.prismatic[1]:
        return []
    q = scene.motion.q[:, 1]

    def law(name: str, equation: str, own: Beside) -> Hypothesis:
        def signal(s: Shape) -> Array:
            return own.torque(np.array(s), q)

        def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
            pull = signal(s) @ x
            # the offset of joint 2 hides a constant part: what varies is what is seen
            return {
                "variation": Quantity(float(np.ptp(pull)), "N·m"),
                "peak_torque": Quantity(float(np.abs(pull).max()), "N·m"),
            }

        return joint_law(
            scene,
            1,
            EFFECT.name,
            name,
            equation,
            signal,
            sizes,
            own.grid(),
            family="compensator",
            curve=lambda x, s: curve(scene, np.degrees(q), signal(s) @ x, "joint 2 in degrees", "torque in N·m"),
            note="with the angle of joint 2",
            correction=lambda x, s: RecordCorrection(EFFECT.name, "joint:2", files.write(own, x, np.array(s))),
        )

    return [
        law("harmonic", "τ₂ += a cos q₂ + b sin q₂: a spring with no length of its own", HARMONIC),
        law("spring between two pins", "τ₂ += (F₀ + k s) ∂s/∂q₂, s² = a² + L² + 2 a L cos(α + q₂)", LINKAGE),
    ]


def orders(scene: Scene, joint: int) -> tuple[Shape, ...]:
    """Gear orders per turn that this range of a joint can show."""
    spread = float(np.ptp(scene.motion.q[:, joint]))
    least = max(2, int(np.ceil(TURNS * 2.0 * np.pi / max(spread, 1e-9))))
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
                    "transmission_error", where, {"order": s[0], "cos_Nm": float(x[0]), "sin_Nm": float(x[1])}
                )
            return entry(WAVES, where, x, np.array(multiples(s, harmonics)))

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
            "transmission_error",
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
    inertia = scene.dynamics.own_inertia(m.q)[:, joint]
    load = -scene.predicted[:, joint]

    def response(s: Shape) -> Array:
        from machopt.diagnose.motion_memory import mass_on_spring

        k = float(np.mean(inertia)) * (2.0 * np.pi * s[0]) ** 2
        x = mass_on_spring(load, inertia, scene.step, scene.first, k, 0.04)
        return inertia * m.differentiate(m.differentiate(x))

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        k = float(np.mean(inertia)) * (2.0 * np.pi * s[0]) ** 2
        return {"compliance": Quantity(float(x[0]) / k, "rad/(N·m)"), "frequency": Quantity(s[0], "Hz")}

    shapes = tuple((f,) for f in BANDS if f < 0.4 * m.rate)
    if not shapes:
        return []
    return [
        joint_law(
            scene,
            joint,
            "joint_elasticity",
            "mass on a spring",
            "τ += M ẍ, M ẍ + 2ζ√(kM) ẋ + k x = −τ",
            response,
            sizes,
            shapes,
            lower=(0.0,),
            family="vibration",
            note="after accelerations change",
        )
    ]
