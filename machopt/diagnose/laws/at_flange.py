"""What the tool side carries beyond the cell's statement, in any channel: each law of the registry.

Resting readings see its weight through the joints' springs; joint torques of a motion its weight and inertia as they
are (:meth:`machopt.model.rigid.Dynamics.regressors`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.motion_frame import Scene
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.nouns.readings import Readings
from machopt.effects import registry
from machopt.effects.protocol import Carried, CarriedLaw, Effect

WHOLE = 4  # mass and its three moments


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
    if recorded:  # accelerations tell mass and moments apart: the whole load is what limits are stated of
        laws.sort(key=lambda each: len(each[1].coefficients) < WHOLE)
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
        effect=effect.called,
        location=where,
        law=law.name,
        equation=cause.format(law.equation),
        columns=lambda shape: columns,
        quantities=sizes,
        family=family,
        correction=correction,
        note=note,
        penalty=calibrated.MOTION.part_of_load if recorded and _part(effect, law) else 0.0,
        possible=partial(_weighs, carried=seen.mass) if recorded and columns.shape[2] == WHOLE else None,
        usual=_where_it_hangs(seen) if columns.shape[2] == WHOLE else None,
    )


def _where_it_hangs(seen: Carried) -> Array:
    """(1, 4) a load where the cell's own is; a moment beside it shows more, and a limit of any load would be its."""
    return np.asarray(np.r_[1.0, seen.centre - seen.about][None, :])


def _part(effect: Effect, law: CarriedLaw) -> bool:
    """Whether a law holds part of a load as stated where another one of the effect does not."""
    return len(law.coefficients) < max(len(one.coefficients) for one in effect.carries)


def _weighs(x: Array, normal: Array, *, carried: float) -> Array:
    """The nearest mass and moments (4,), by how the misfit grows, of a tool side that weighs no less than nothing."""
    if x[0] >= -carried:
        return x
    step = -carried - float(x[0])
    moments = -np.linalg.lstsq(normal[1:, 1:], normal[1:, 0] * step, rcond=None)[0]
    return np.asarray(x + np.concatenate([[step], moments]))


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
