"""What the tool side carries beyond the cell's statement, in any channel: each law of the registry.

Resting readings see its weight through the joints' springs; joint torques of a motion its weight and inertia as they
are (:meth:`machopt.model.rigid.Dynamics.regressors`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.laws.motion_frame import Scene
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.nouns.readings import Readings
from machopt.effects import registry
from machopt.effects.protocol import Carried, CarriedLaw, Effect


def at_rest(r: Readings) -> list[Hypothesis]:
    """Seen by how far the joints' springs give under weight."""
    if r.masses is None:
        return []
    own = r.masses.body == 6
    flange = r.robot.T_base_flange_zero
    carried = float(r.masses.mass[own].sum())
    centre = r.masses.mass[own] @ r.masses.com[own] / carried if carried > 0.0 else flange[:3, 3]
    at = flange[:3, :3].T @ (centre - flange[:3, 3])  # (3,) m in flange
    return _offered(
        Carried(carried, at, np.zeros(3), _weight(r)),
        "J c Jᵀ w of {}, c as the base has it",
        "environment",
        "with gravity: as the joints' compliance, but shaped by the flange's weight alone",
    )


def in_motion(scene: Scene, columns: Array) -> list[Hypothesis]:
    """Seen in the joints' torques.

    Args:
        scene: channel torque.
        columns: (N, D, 4) N·m of :meth:`machopt.model.rigid.Dynamics.regressors`.
    """
    assert scene.dynamics is not None
    com = scene.dynamics.tool_com
    return _offered(
        Carried(scene.dynamics.tool_mass, com, com, columns),
        "τ += Y(q, q̇, q̈) (Δm, Δm c), inertia and {}; Atkeson, An & Hollerbach, IJRR 5 (1986) 101",
        "body",
        "with gravity and acceleration of the tool",
        recorded=True,
    )


def _offered(seen: Carried, cause: str, family: str, note: str, *, recorded: bool = False) -> list[Hypothesis]:
    laws = [(e, law, law.grid(seen)) for e in registry.of_flange() for law in e.carries]
    if recorded:  # masses of links are as unsure as the tool's: no law of a motion says that it is as stated
        laws = [each for each in laws if len(each[1].coefficients) == seen.columns.shape[2]] or laws
    return [_hypothesis(seen, e, law, cause, family, note, recorded) for e, law, grid in laws if grid]


def _hypothesis(
    seen: Carried, effect: Effect, law: CarriedLaw, cause: str, family: str, note: str, recorded: bool
) -> Hypothesis:
    columns, where = law.columns(seen), effect.places[0]

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, seen)

    def correction(x: Array, shape: Shape) -> RecordCorrection | None:
        if not recorded:
            return None
        return RecordCorrection(effect.called, where, {k: q.value for k, q in law.sizes(x, seen).items()})

    return Hypothesis(
        effect.called,
        where,
        law.name,
        cause.format(law.equation),
        lambda shape: columns,
        sizes,
        family=family,
        correction=correction,
        note=note,
    )


def _weight(r: Readings) -> Array:
    """(N, D, 4) m, rad per kg at the flange's origin and per kg·m along its axes."""
    assert r.masses is not None  # at_rest asks
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    T = r.state.T_base_tool
    R = T[:, :3, :3] @ r.T_flange_tcp[:3, :3].T
    flange = r.state.R_bodies[:, 6] @ r.robot.T_base_flange_zero[:3, 3] + r.state.p_bodies[:, 6]
    arm = flange - T[:, :3, 3]  # as seen from the TCP, or from the reflector that was measured
    g = np.broadcast_to(r.masses.gravity, arm.shape)
    zero = np.zeros_like(arm)
    parts = [np.concatenate([g, np.cross(arm, g)], axis=1)]
    parts += [np.concatenate([zero, np.cross(R[:, :, k], g)], axis=1) for k in range(3)]
    return np.stack([r.through(w) for w in parts], axis=2)
