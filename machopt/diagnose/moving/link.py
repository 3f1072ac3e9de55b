"""Link-side encoders against motor-side ones: y = q_secondary − q − Δ(q), the twist of the gear itself.

Δ is what the cell's kinematics.yaml holds: a gear's wave that is known is not found again.

Refitted in any case, for each joint that has a second encoder: an offset (mounting and zero) and the compliance under
the torque that the gear carries.
"""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.laws.motion_frame import PowerTaken, Scene
from machopt.diagnose.moving import angles
from machopt.diagnose.moving.clock import clocks, valley
from machopt.diagnose.moving.gears import drive, gear_laws, known
from machopt.diagnose.moving.torque import motion_axes
from machopt.diagnose.nouns.motion_signals import Motion
from machopt.diagnose.nouns.problem import Catalogue, Family, Hypothesis, Problem, Unknown, Untestable
from machopt.domain.location import joint_at
from machopt.domain.parameters import joint_spring
from machopt.effects import registry
from machopt.effects.protocol import Scale
from machopt.errors import InputError

MOVING = Scale(reach=1.0, sampled=True)  # what asks which laws a motion is searched for


def seen(scene: Scene) -> list[int]:
    """Joints with a second encoder that moves."""
    other = scene.recording.q_secondary
    if other is None:
        return []
    part = other[scene.motion.index, : scene.joints]
    finite = np.isfinite(part).all(axis=0)
    return [j for j in np.flatnonzero(finite).tolist() if np.ptp(part[:, j]) > 1e-6 and scene.moves(j)]


def build(scene: Scene, joints: list[int]) -> tuple[Problem, Catalogue]:
    """Equations and catalogue of the channel link.

    Args:
        scene: with D = len(joints), ``lift`` mapping joints to coordinates.
        joints: 0-based, that have a second encoder.

    Raises:
        InputError: no second encoder moves.
    """
    m, rec = scene.motion, scene.recording
    if not joints or rec.q_secondary is None:
        raise InputError(f"{rec.source}: no link-side encoder moves; qse1_deg … are needed for the channel link")
    y = m.within(m.mean((rec.q_secondary[m.index][:, : scene.joints] - scene.true_angles(m.q))[:, joints]))
    offset = np.concatenate([scene.column(j, np.ones(len(m.q))) for j in joints], axis=2)
    found = drive(scene)
    base, unknowns = offset, [Unknown(name=f"offset {j + 1}", unit="rad", location=joint_at(j + 1)) for j in joints]
    out: list[Hypothesis] = []
    untestable: list[Untestable] = []
    inertia = None if scene.dynamics is None else scene.dynamics.own_inertia(m.q)
    if found is None:
        reason = "neither torques are recorded nor does the URDF have inertias"
        untestable += [
            Untestable(effect, joint_at(j + 1), reason)
            for j in joints
            for effect in (e.name for e in registry.of_joint_torque() if any(law.grid(MOVING) for law in e.laws))
        ]
    else:
        load = found.load
        scene.notes.append(f"gears are loaded by the {found.words}")
        base = np.concatenate([offset, *(scene.column(j, load[:, j]) for j in joints)], axis=2)
        unknowns += [
            Unknown(
                name=f"compliance {j + 1}",
                unit="rad/(N·m)",
                lower=0.0,
                location=joint_at(j + 1),
                key=joint_spring(j + 1),
            )
            for j in joints
        ]
        if not found.by_bodies:
            for j in joints:  # the motor's torque holds friction that never reaches the gear
                way = np.stack([np.sign(m.v[:, j]), m.v[:, j]], axis=1)
                base = np.concatenate([base, scene.column(j, way)], axis=2)
                unknowns += [
                    Unknown(name=f"friction in the torque {j + 1}, {k}", unit=u, location=joint_at(j + 1))
                    for k, u in (("Coulomb", "rad"), ("viscous", "s"))
                ]
    if found is not None:
        for j in joints if scene.known else ():
            y = y - scene.column(j, known(scene, j, found.load[:, j]))[:, :, 0]
    # encoders of one kind have one noise, whatever the joints leave
    fit = PowerTaken(y, base, np.ones(len(joints)))
    for j in joints:
        if found is not None:
            out += gear_laws(scene, j, found.load[:, j], None if inertia is None else inertia[:, j], fit)
        laws, taken_up = angles.hypotheses(scene, j, fit)
        out += laws
        untestable += taken_up
    problem = scene.problem(
        "position",
        y,
        base,
        unknowns,
        Family(name="link-side angle", columns=tuple(range(len(joints))), unit="mrad", factor=1e3),
    )
    near = m.q[:, joints]
    far = near
    if found is not None:  # what the far side shows is late with it: the gear's own twist
        far = near + found.load[:, joints] * _compliance(m, fit, y, base, near, len(joints))
    # where the load is computed from the near side it is late with that, and the two are one and the same
    alone = far if found is not None and found.by_bodies else near

    def late(q: Array, d: float) -> Array:
        return m.within(m.mean(m.late(q, d) - q))

    def far_late(d: float) -> Array:
        return late(far, d)

    def near_late(d: float) -> Array:  # the difference shows as if it were early
        return -late(alone, -d)

    best = valley(lambda d: fit.misfit(far_late(d)))
    out += clocks(scene, "qse", far_late, best)
    early = -best if alone is far else valley(lambda d: fit.misfit(near_late(d)))
    out += clocks(scene, "q", near_late, early, penalty=2.0)
    return problem, Catalogue(tuple(out), tuple(untestable), motion_axes(scene))


def _compliance(m: Motion, fit: PowerTaken, y: Array, base: Array, q: Array, joints: int) -> Array:
    """(joints,) rad/(N·m) of the base beside the delay of the bare angles that suits best."""

    def late(d: float) -> Array:
        return m.within(m.mean(m.late(q, d) - q))

    X = base.reshape(-1, base.shape[2])
    size = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)
    shown = (y - late(valley(lambda d: fit.misfit(late(d))))).reshape(-1)
    x = np.linalg.lstsq(X / size, shown, rcond=1e-10)[0] / size
    return np.asarray(np.clip(x[joints : 2 * joints], 0.0, None))
