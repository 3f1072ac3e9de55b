"""What drives tell beyond what each joint asks of its own motor: gains, shafts that run through another joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.laws.motion_frame import Scene
from machopt.diagnose.moving.friction import PATH, SMOOTH, Turn, direction, rest_of, turned
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.search.finer import between
from machopt.domain.location import joints_of
from machopt.effects import files, registry
from machopt.effects.protocol import Effect, Geared, MotorLaw


def hypotheses(scene: Scene, paths: Sequence[Turn], torque: Array, beside: Array) -> list[Hypothesis]:
    """Every law at every place of it whose joints turn.

    Args:
        scene: channel torque, with the predicted torque.
        paths: how friction turns over in the base, of each joint.
        torque: (N, n) N·m measured less predicted.
        beside: (N, n, p) what else of masses it may hold.
    """
    return [
        _hypothesis(scene, effect, where, law, joints, _way(scene, joints, paths[joints[-1]], torque, beside))
        for effect in registry.of_motors()
        for where in effect.tried
        if (joints := joints_of(where)) and _shown(scene, joints)
        for law in effect.motors
        if not (scene.free_gains and law.of_gain)
    ]


def _shown(scene: Scene, joints: tuple[int, ...]) -> bool:
    return all(
        j < scene.joints and scene.moves(j) and not scene.prismatic[j] and j not in scene.unsized for j in joints
    )


def _way(scene: Scene, joints: tuple[int, ...], turn: Turn, torque: Array, beside: Array) -> Callable[[Array], Array]:
    """Which way the friction of the last joint's motor points, by its speed; it turns over as its torque shows best.

    How the base has it was found by the speed of the joint, which is not the motor's.
    """
    m, j = scene.motion, joints[-1]
    own = np.stack([np.ones(len(m.q)), direction(scene, j, turn), m.a[:, j], *(m.v[:, k] for k in set(joints))], axis=1)
    rest = np.concatenate([m.within(m.mean(own)), beside[:, j]], axis=1)

    def left(z: Array) -> float:
        return float(
            np.sum(rest_of(torque[:, j], np.concatenate([rest, m.within(m.mean(z[:, None]))], axis=1))[0] ** 2)
        )

    return lambda v: min((turned(scene, v, t) for t in dict.fromkeys((turn, PATH, SMOOTH))), key=left)


def _hypothesis(
    scene: Scene,
    effect: Effect,
    where: str,
    law: MotorLaw,
    joints: tuple[int, ...],
    way: Callable[[Array], Array],
) -> Hypothesis:
    assert scene.predicted is not None  # the channel has it
    m, own = scene.motion, sorted(set(joints))
    seen = Geared(
        needed=scene.predicted[:, own],
        speed=m.v[:, own],
        acceleration=m.a[:, own],
        way=way,
    )

    def columns(shape: Shape) -> Array:
        parts = law.columns(np.array(shape), seen)
        return np.asarray(np.sum([scene.column(j, parts[:, k]) for k, j in enumerate(own)], axis=0))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape), seen)

    def fix(x: Array, shape: Shape) -> RecordCorrection:
        return RecordCorrection(effect.called, where, {k: q.value for k, q in sizes(x, shape).items()})

    lower = tuple(least for _, _, least in files.named(law, len(law.coefficients)))
    grid = law.grid()
    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=columns,
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        family="drive",
        correction=fix,
        note=law.note,
        penalty=law.penalty,
        finer=between(grid),
    )
