"""What a gear does under the torque of a moving arm, as a twist of its joint: loops, clearance, slopes, creep, swing.

``load`` is the torque that bends the joint forward: minus what the motor side must give to the link side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfiltfilt

from machopt.diagnose.motion_frame import ARCMIN, Fit, Scene, curve, joint_law, one_joint
from machopt.diagnose.motion_memory import bouc_wen, lag, mass_on_spring, play
from machopt.diagnose.motion_torque import gear_load
from machopt.diagnose.problem import Array, Curve, Hypothesis, Quantity, Shape
from machopt.domain.stiffness import Term

CLICK = (0.004, 0.01, 0.025, 0.06)  # threshold per largest torque: a step, softened
KNEE = (0.1, 0.2, 0.3, 0.45, 0.6, 0.75)
PLAY = (0.02, 0.05, 0.1, 0.18, 0.3, 0.45)
PAIRS = ((0.02, 0.1), (0.02, 0.3), (0.05, 0.18), (0.05, 0.3), (0.1, 0.3), (0.1, 0.45), (0.18, 0.45))
DRAGS = tuple((r, b) for r in (0.1, 0.2, 0.4, 0.8, 1.6) for b in (0.5, 0.65, 0.8))
CREEP = (0.5, 1.5, 4.0, 12.0, 40.0)  # s
BANDS = tuple(float(f) for f in np.geomspace(0.8, 20.0, 17).round(2))  # Hz
DAMPING = (0.01, 0.02, 0.03, 0.045, 0.07, 0.1)
NARROW = (0.035, 0.012, 0.004)  # relative steps of the search for a frequency


def gear_laws(scene: Scene, joint: int, load: Array, inertia: Array | None, fit: Fit) -> list[Hypothesis]:
    """All laws of one joint.

    Args:
        scene: link or tip channel.
        joint: 0-based.
        load: (M,) N·m that twists the joint forward.
        inertia: (M,) kg·m² behind the joint; None: unknown.
        fit: of the channel's problem, to find the frequency of a vibration.
    """
    swing = load - np.median(load)
    largest = float(np.quantile(np.abs(load), 0.99))
    around = float(np.quantile(np.abs(swing), 0.99))
    if largest <= 0 or around < 0.02 * largest:
        return []
    out = [*_memory(scene, joint, load, around), *_instant(scene, joint, load, largest)]
    m, first, step = scene.motion, scene.first, scene.step
    lasting = min(float(m.time[s.stop - 1] - m.time[s.start]) for s in m.segments())
    slow = tuple((t,) for t in CREEP if t < lasting)
    if slow:
        out.append(
            _law(scene, joint, "joint_creep", "one time constant", "T φ̇ + φ = κ c τ",
                 lambda s: lag(load, step, first, s[0]), load,
                 lambda x, s: {"size": Quantity(float(x[0]) * around / ARCMIN, "arcmin"),
                               "slowest": Quantity(s[0], "s")},
                 slow, (0.0,), "late after the load",
                 lambda x, s: Term("joint_creep", f"joint:{joint + 1}", {
                     "extra_rad_per_Nm": float(x[0]), "time_constant_s": s[0]}))
        )  # fmt: skip
    if inertia is not None:
        out.append(_vibration(scene, joint, load, inertia, fit))
    return out


def _law(
    scene: Scene,
    joint: int,
    effect: str,
    words: str,
    equation: str,
    signal: Callable[[Shape], Array],
    driver: Array,
    sizes: Callable[[Array, Shape], Mapping[str, Quantity]],
    shapes: tuple[Shape, ...],
    lower: tuple[float, ...],
    note: str,
    term: Callable[[Array, Shape], Term] | None = None,
) -> Hypothesis:
    def line(x: Array, s: Shape) -> Curve:
        part = signal(s)
        twist = part * x[0] if part.ndim == 1 else part @ x
        return curve(scene, driver, twist / ARCMIN, f"load torque at joint {joint + 1} in N·m", "twist in arcmin")

    more = {} if term is None else {"correction": term}
    return joint_law(scene, joint, effect, words, equation, signal, sizes, shapes, lower=lower, note=note, curve=line,
                     **more)  # fmt: skip


def _memory(scene: Scene, joint: int, load: Array, around: float) -> list[Hypothesis]:
    """Loops: one play operator, or two (Prandtl–Ishlinskii)."""
    first, where = scene.first, f"joint:{joint + 1}"

    def plays(s: Shape) -> Array:
        return np.stack([play(load, first, r * around) for r in s], axis=1)

    def width(x: Array, s: Shape) -> Mapping[str, Quantity]:
        opened = sum(2.0 * float(a) * min(r, 0.5) * around for a, r in zip(x, s, strict=True))
        return {"width": Quantity(opened / ARCMIN, "arcmin"), "threshold": Quantity(s[0] * around, "N·m")}

    def term(x: Array, s: Shape) -> Term:
        return Term("joint_hysteresis", where, {
            "law": "play", "weights_rad_per_Nm": [float(v) for v in x],
            "thresholds_Nm": [float(r * around) for r in s]})  # fmt: skip

    def drag(s: Shape) -> Array:
        return -bouc_wen(load, first, s[0] * around, s[1])

    def drag_width(x: Array, s: Shape) -> Mapping[str, Quantity]:
        # twist between the branches where a full cycle crosses zero torque
        up = np.concatenate([np.linspace(0, 1, 40), np.linspace(1, -1, 80), np.linspace(-1, 1, 80)]) * around
        z = bouc_wen(up, np.zeros(len(up), np.int64), s[0] * around, s[1])
        return {"width": Quantity(float(x[0]) * abs(float(z[160] - z[80])) / ARCMIN, "arcmin"),
                "reach": Quantity(s[0] * around, "N·m")}  # fmt: skip

    equation = "φ = c τ + Σ a P_r[τ], P_r the play operator of half-width r (Prandtl–Ishlinskii)"
    return [
        _law(scene, joint, "joint_hysteresis", "play", equation, plays, load, width, tuple((r,) for r in PLAY), (0.0,),
             "on load reversal", term),
        _law(scene, joint, "joint_hysteresis", "two plays", equation, plays, load, width, PAIRS, (0.0, 0.0),
             "on load reversal", term),
        _law(scene, joint, "joint_hysteresis", "Bouc–Wen",
             "φ = c τ − a z, dz = [1 − |z| (β sgn(z dτ) + 1 − β)] dτ/r", drag, load, drag_width, DRAGS, (0.0,),
             "on load reversal"),
    ]  # fmt: skip


def _instant(scene: Scene, joint: int, load: Array, largest: float) -> list[Hypothesis]:
    """Laws without memory: clearance, and a slope that changes with the load."""
    out: list[Hypothesis] = []
    where = f"joint:{joint + 1}"
    if min(np.mean(load > CLICK[0] * largest), np.mean(load < -CLICK[0] * largest)) > 0.01:
        out.append(
            _law(scene, joint, "joint_backlash", "step with the sign of the torque",
                 "φ = c τ + ½ w sgn(τ), weight included",
                 lambda s: 0.5 * np.clip(load / (s[0] * largest), -1.0, 1.0), load,
                 lambda x, s: {"width": Quantity(float(x[0]) / ARCMIN, "arcmin")},
                 tuple((s,) for s in CLICK), (0.0,), "where the torque changes its sign",
                 lambda x, s: Term("joint_backlash", where, {
                     "width_arcmin": float(x[0] / ARCMIN), "transition_Nm": float(s[0] * largest)}))
        )  # fmt: skip
    out.append(
        _law(scene, joint, "joint_nonlinear_stiffness", "two slopes", "φ = c τ + a clip(τ, ±τ₀)",
             lambda s: np.clip(load, -s[0] * largest, s[0] * largest), load,
             lambda x, s: {"twist": Quantity(abs(float(x[0])) * s[0] * largest / ARCMIN, "arcmin"),
                           "knee_torque": Quantity(s[0] * largest, "N·m")},
             tuple((s,) for s in KNEE), (), "the slope changes with the load",
             lambda x, s: Term("joint_nonlinear_stiffness", where, {
                 "law": "knee", "extra_rad_per_Nm": float(x[0]), "knee_Nm": float(s[0] * largest)}))
    )  # fmt: skip
    out.append(
        _law(scene, joint, "joint_nonlinear_stiffness", "cubic", "φ = c τ + b τ³", lambda s: load**3 / largest**2, load,
             lambda x, s: {"twist": Quantity(abs(float(x[0])) * largest / ARCMIN, "arcmin")}, ((),), (),
             "the slope changes with the load",
             lambda x, s: Term("joint_nonlinear_stiffness", where, {
                 "law": "cubic", "cubic_rad_per_Nm3": float(x[0] / largest**2)}))
    )  # fmt: skip
    return out


def _vibration(scene: Scene, joint: int, load: Array, inertia: Array, fit: Fit) -> Hypothesis:
    """The link as a mass on the joint's spring, integrated in time; its static part is in the base."""
    mean = float(np.mean(inertia))
    limit = 0.3 * scene.motion.rate

    def stiffness(s: Shape) -> float:
        return mean * (2.0 * np.pi * s[0]) ** 2

    def response(s: Shape) -> Array:
        k = stiffness(s)
        return k * mass_on_spring(load, inertia, scene.step, scene.first, k, s[1])

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return {
            "compliance": Quantity(float(x[0]), "rad/(N·m)"),
            "frequency": Quantity(s[0], "Hz"),
            "damping": Quantity(100.0 * s[1], "%"),
        }

    def gain(f: float, z: float) -> float:
        return fit.gain(scene.column(joint, response((f, z))))

    shapes = tuple((f, z) for f in BANDS if f < limit for z in (DAMPING[1],))
    # weakly damped, a resonance is narrower than any grid that many joints can afford
    best, z = max(shapes, key=lambda s: gain(*s))
    for width in NARROW:
        near = [min(best * (1.0 + width * k), limit) for k in (-3, -2, -1, 0, 1, 2, 3)]
        best = max(near, key=lambda f: gain(f, z))
        z = max(DAMPING, key=lambda d: gain(best, d))
    shapes = (*shapes, (float(best), float(z)))
    return _law(
        scene, joint, "joint_elasticity", "mass on a spring", "M(q) φ̈ + 2ζ√(kM) φ̇ + k φ = τ: beyond c τ it swings",
        response, load, sizes, shapes, (0.0,), "after the load changes",
    )  # fmt: skip


def drive(scene: Scene) -> tuple[Array, str] | None:
    """The torque (M, n) that bends the joints forward: by rigid bodies where they describe the recorded torque, which
    also holds friction and noise; else as recorded; None where neither is known.
    """
    # as many coordinates as joints, whatever the channel has
    load = gear_load(replace(scene, dimensions=scene.joints, lift=one_joint(scene.motion, scene.joints)))
    m = scene.motion
    if load is not None:
        return -load, "torque by rigid-body dynamics from the URDF's inertias"
    if scene.recording.torque is None:
        return None
    tau = scene.recording.torque[m.index, : scene.joints]
    smooth = np.empty_like(tau)
    sos = butter(2, min(2.0 * m.cutoff, 0.4 * m.rate), fs=m.rate, output="sos")
    for s in m.segments():
        smooth[s] = sosfiltfilt(sos, tau[s], axis=0)
    return -smooth, "recorded torque, smoothed"
