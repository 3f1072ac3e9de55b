"""What a gear does under the torque of a moving arm, as a twist of its joint: loops, clearance, slopes, creep, swing.

``load`` is the torque that bends the joint forward: minus what the motor side must give to the link side.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.motion_frame import ARCMIN, PowerTaken, Scene, curve, joint_law, one_joint
from machopt.diagnose.moving.torque import gear_load
from machopt.diagnose.nouns.lowpass import zero_phase
from machopt.diagnose.nouns.problem import Curve, Hypothesis, Quantity, Shape
from machopt.domain.location import joint_at
from machopt.domain.stiffness import Term
from machopt.effects import files, registry
from machopt.effects.given import Parameters
from machopt.effects.protocol import MEMORIES, Drive, Effect, Law, Scale, Swinging, SwingLaw, timed


def gear_laws(scene: Scene, joint: int, load: Array, inertia: Array | None, fit: PowerTaken) -> list[Hypothesis]:
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
    if largest <= 0 or around < calibrated.MOTION.gear_swing * largest:
        return []
    m = scene.motion
    lasting = min(float(m.time[s.stop - 1] - m.time[s.start]) for s in m.segments())
    out = []
    # loops first and what takes time last: of laws as good as each other the first is named
    for effect in sorted(registry.of_joint_torque(), key=lambda e: (timed(e.laws[0]), not e.remembers)):
        for law in effect.laws:
            scale = Scale(reach=around if law.remembers else largest, lasting=lasting, sampled=True)
            if not law.silent(load, np.zeros(0), scale):
                grid = law.grid(scale)
                out += [_of_registry(scene, joint, effect, law, load, scale, grid)] if grid else []
    if inertia is not None and inertia.min() > 0.0:  # behind a last link without mass nothing swings
        for effect in registry.of_swings():
            for spring in effect.swings:
                out += _vibration(scene, joint, effect, spring, load, inertia, fit)
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
    return joint_law(
        scene, joint, effect, words, equation, signal, sizes, shapes, lower=lower, note=note, curve=line, **more
    )


def _of_registry(
    scene: Scene, joint: int, effect: Effect, law: Law, load: Array, scale: Scale, grid: tuple[Shape, ...]
) -> Hypothesis:
    """A law of the registry over the samples."""
    drive = _driven(scene, joint, load)
    memory = MEMORIES[-1] if law.remembers else ""

    def term(x: Array, s: Shape) -> Term:
        return Term(effect.name, joint_at(joint + 1), files.write(law, x, np.array(s), memory))

    lower = tuple(least for _, _, least in files.named(law, law.columns(np.array(grid[0]), drive).shape[-1]))
    return _law(
        scene,
        joint,
        effect.name,
        law.name,
        law.equation,
        lambda s: law.columns(np.array(s), drive),
        load,
        lambda x, s: law.sizes(x, np.array(s), scale),
        grid,
        lower if np.isfinite(lower).any() else (),
        effect.note,
        term,
    )


def known(scene: Scene, joint: int, load: Array) -> Array:
    """(M,) rad that the terms known of one joint make of its load, remembered from where a segment begins."""
    out = np.zeros(len(load))
    for term in scene.known:
        effect = registry.elastic(term.effect)
        if term.location != joint_at(joint + 1) or not effect.laws:
            continue
        given = Parameters(term.parameters, term.effect)
        law = files.law_of(effect, given)
        values, shape, _ = files.read(law, given)
        out += law.columns(shape, _driven(scene, joint, load)) @ values
    return out


def _driven(scene: Scene, joint: int, load: Array) -> Drive:
    """Where a segment begins, what the gear holds has settled."""
    gap = np.where(scene.first > 0, np.inf, scene.step)
    return Drive(load, scene.motion.q[:, joint], gap, scene.first)


def _vibration(
    scene: Scene, joint: int, effect: Effect, law: SwingLaw, load: Array, inertia: Array, fit: PowerTaken
) -> list[Hypothesis]:
    """What swings on the joint's spring, integrated in time; its static part is in the base."""
    seen = Swinging(load, inertia, scene.step, scene.first)

    def response(s: Shape) -> Array:
        at = np.array(s)
        return law.stiffness(at, seen) * law.deflection(at, seen)

    grid = law.grid(scene.motion.rate, lambda s: fit.gain(scene.column(joint, response(s))))
    if not grid:
        return []
    return [
        _law(
            scene,
            joint,
            effect.called,
            law.name,
            f"{law.equation}: beyond c τ it swings",
            response,
            load,
            lambda x, s: law.sizes(float(x[0]), np.array(s), seen),
            grid,
            (0.0,),
            effect.note,
        )
    ]


@dataclass(frozen=True)
class Driven:
    """What bends the joints of a motion."""

    load: Array  # (M, n) N·m forward
    by_bodies: bool  # by rigid bodies, so without friction; else as recorded

    @property
    def words(self) -> str:
        if self.by_bodies:
            return "torque by rigid-body dynamics from the URDF's inertias"
        return "recorded torque, smoothed"


def drive(scene: Scene) -> Driven | None:
    """The torque that bends the joints forward: by rigid bodies where they describe the recorded torque, which
    also holds friction and noise; else as recorded; None where neither is known.
    """
    # as many coordinates as joints, whatever the channel has
    load = gear_load(replace(scene, dimensions=scene.joints, lift=one_joint(scene.motion, scene.joints)))
    m = scene.motion
    if load is not None:
        return Driven(-load, True)
    if scene.recording.torque is None:
        return None
    tau = scene.recording.torque[m.index, : scene.joints]
    smooth = np.empty_like(tau)
    for s in m.segments():
        smooth[s] = zero_phase(tau[s], 2, min(2.0 * m.cutoff, 0.4 * m.rate), m.rate)
    return Driven(-smooth, False)
