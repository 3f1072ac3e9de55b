"""Payload errors relative to the cell in any channel: each registered payload law.

Static readings show the weight through the joint springs. Joint torques of a motion show weight and inertia
(:meth:`machopt.dynamics.rigid_body.RigidBodyDynamics.compute_regressors`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from machopt.effects import registry
from machopt.effects.protocol import Effect, PayloadLaw, ToolSideLoad
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    Quantity,
    RecordCorrection,
    Shape,
)
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel
from machopt.numerics.array_types import Array

PAYLOAD_COEFFICIENTS = 4  # mass and three first moments


def build_static_payload_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the payload laws for static readings, visible by the deflection of the joint springs under weight.

    Args:
        r: Static readings.

    Returns:
        The hypotheses; none if masses are unknown.
    """
    if r.masses is None:
        return []
    own = r.masses.body == r.joint_count
    flange = r.robot.T_base_flange_zero
    carried = float(r.masses.mass[own].sum())
    centre = r.masses.mass[own] @ r.masses.com[own] / carried if carried > 0.0 else flange[:3, 3]
    at = flange[:3, :3].T @ (centre - flange[:3, 3])  # (3,) m in flange
    return _build_payload_hypotheses(
        ToolSideLoad(carried, at, np.zeros(3), _compute_weight_columns(r)),
        "J c Jᵀ w of {}, c as the base has it",
        "environment",
        "with gravity: as the joints' compliance, but shaped by the flange's weight alone",
    )


def build_motion_payload_hypotheses(scene: MotionModel, columns: Array) -> list[EffectHypothesis]:
    """Build the payload laws for joint torques.

    Args:
        scene: Motion model of the torque channel.
        columns: (N, D, 4) torque per kg and kg·m, of
            :meth:`machopt.dynamics.rigid_body.RigidBodyDynamics.compute_regressors`.

    Returns:
        The hypotheses.
    """
    assert scene.dynamics is not None
    com = scene.dynamics.tool_com
    return _build_payload_hypotheses(
        ToolSideLoad(scene.dynamics.tool_mass, com, com, columns),
        "τ += Y(q, q̇, q̈) (Δm, Δm c), inertia and {}; Atkeson, An & Hollerbach, IJRR 5 (1986) 101",
        "body",
        "with gravity and acceleration of the tool",
        recorded=True,
    )


def _build_payload_hypotheses(
    tool_side_load: ToolSideLoad, cause: str, family: str, note: str, *, recorded: bool = False
) -> list[EffectHypothesis]:
    laws = [(e, law, law.grid(tool_side_load)) for e in registry.select_payload_effects() for law in e.payload_laws]
    if recorded:  # accelerations separate mass and moments: detection limits refer to the whole load
        laws.sort(key=lambda each: len(each[1].coefficients) < PAYLOAD_COEFFICIENTS)
    return [
        _build_payload_hypothesis(tool_side_load, e, law, cause, family, note, recorded)
        for e, law, grid in laws
        if grid
    ]


def _build_payload_hypothesis(
    tool_side_load: ToolSideLoad, effect: Effect, law: PayloadLaw, cause: str, family: str, note: str, recorded: bool
) -> EffectHypothesis:
    columns, where = law.columns(tool_side_load), effect.places[0]

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, tool_side_load)

    def correction(x: Array, shape: Shape) -> RecordCorrection | None:
        if not recorded:
            return None
        return RecordCorrection(effect.file_word, where, {k: q.value for k, q in law.sizes(x, tool_side_load).items()})

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=cause.format(law.equation),
        columns=lambda shape: columns,
        quantities=sizes,
        family=family,
        correction=correction,
        note=note,
        penalty=thresholds.LEVELS.gain_three_sigma if recorded and _is_part_of_load(effect, law) else 0.0,
        project_to_plausible=partial(_project_to_physical_load, carried=tool_side_load.mass)
        if recorded and columns.shape[2] == PAYLOAD_COEFFICIENTS
        else None,
        typical_coefficients=_locate_known_load(tool_side_load) if columns.shape[2] == PAYLOAD_COEFFICIENTS else None,
    )


def _locate_known_load(tool_side_load: ToolSideLoad) -> Array:
    """Return a load (1, 4) at the position of the cell's own load, which detection limits refer to."""
    return np.asarray(np.r_[1.0, tool_side_load.centre - tool_side_load.reference_point][None, :])


def _is_part_of_load(effect: Effect, law: PayloadLaw) -> bool:
    """Return whether a law keeps a part of the load as stated that another law of the effect changes."""
    return len(law.coefficients) < max(len(one.coefficients) for one in effect.payload_laws)


def _project_to_physical_load(x: Array, normal: Array, *, carried: float) -> Array:
    """Return the nearest mass and moments (4,), in the metric of the misfit, with non-negative total mass."""
    if x[0] >= -carried:
        return x
    step = -carried - float(x[0])
    moments = -np.linalg.lstsq(normal[1:, 1:], normal[1:, 0] * step, rcond=None)[0]
    return np.asarray(x + np.concatenate([[step], moments]))


def _compute_weight_columns(r: StaticReadings) -> Array:
    """Return columns (N, D, 4) m, rad per kg at the flange origin and per kg·m along its axes."""
    assert r.masses is not None  # checked by the caller
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    T = r.state.T_base_tool
    R = T[:, :3, :3] @ r.T_flange_tcp[:3, :3].T
    flange = r.state.R_bodies[:, -1] @ r.robot.T_base_flange_zero[:3, 3] + r.state.p_bodies[:, -1]
    arm = flange - T[:, :3, 3]  # relative to the measured point (TCP or reflector)
    g = np.broadcast_to(r.masses.gravity, arm.shape)
    zero = np.zeros_like(arm)
    parts = [np.concatenate([g, np.cross(arm, g)], axis=1)]
    parts += [np.concatenate([zero, np.cross(R[:, :, k], g)], axis=1) for k in range(3)]
    return np.stack([r.compute_displacement(w) for w in parts], axis=2)
