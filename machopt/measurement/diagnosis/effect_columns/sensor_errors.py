"""Errors of a static recording: each registered law, through the compliance identified so far.

Load errors act through the arm: recorded w = acting w + error, hence δ = C (w_recorded − error).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.effects import registry
from machopt.effects.protocol import Effect, RecordedLoad, RecordLaw
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    EffectHypothesis,
    Quantity,
    RecordCorrection,
    Shape,
)
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.numerics.array_types import Array

NOTE = "in the record, not in the robot"


def build_load_test_sensor_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the sensor errors of load tests: forces and displacements.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    tool = r.state.T_base_tool[:, :3, :3]
    base = np.broadcast_to(np.eye(3), tool.shape)
    frames = {"wrench": r.recording.wrench_frame, "displacement": r.recording.displacement_frame}
    seen = {
        moves: RecordedLoad(r.wrench, r.compute_displacement(r.wrench), tool if frame == "tool" else base, tool)
        for moves, frame in frames.items()
    }
    seen["point"] = seen["wrench"]
    return [
        _build_sensor_hypothesis(r, e, law, seen[law.affected_quantity])
        for e, law in _list_sensor_laws()
        if law.affected_quantity in seen
    ]


def build_pose_sensor_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the sensor errors of measured positions, if the recording states their frame.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    axes = np.broadcast_to(np.eye(3), (len(r), 3, 3))
    seen = RecordedLoad(
        r.wrench,
        np.zeros((len(r), 6)),
        axes,
        r.state.T_base_tool[:, :3, :3],
        r.state.T_base_tool[:, :3, 3],
    )
    return [
        _build_sensor_hypothesis(r, e, law, seen)
        for e, law in _list_sensor_laws()
        if law.affected_quantity == "position"
    ]


def _compute_point_displacement(r: StaticReadings, way: Array) -> Array:
    """Return the displacement (N, D, P) m, rad for load and target at points (N, 3+, P) m from the TCP, to first
    order.
    """
    tau = r.load_torque * r.compliance
    turned = np.einsum("nci,ni->nc", r.state.J[:, 3:], tau)
    if r.bodies is not None:
        turned += np.einsum("ncd,nd->nc", r.bodies[:, 3:], r.wrench)
    out = []
    for off in np.moveaxis(way[:, :3], 2, 0):
        lever = np.concatenate([np.zeros_like(off), np.cross(off, r.wrench[:, :3])], axis=1)
        own = r.compute_displacement(lever)
        own[:, :3] += np.cross(turned, off)
        out.append(own)
    return np.stack(out, axis=2)


def _list_sensor_laws() -> list[tuple[Effect, RecordLaw]]:
    return [(e, law) for e in registry.select_record_effects() for law in e.record_laws]


def _build_sensor_hypothesis(
    r: StaticReadings, effect: Effect, law: RecordLaw, recorded_load: RecordedLoad
) -> EffectHypothesis:
    (where,) = effect.places

    def columns(shape: Shape) -> Array:
        more = law.columns(np.array(shape), recorded_load)
        if law.affected_quantity == "position":
            return r.project_to_measured(
                more, BODY_BEHIND_FLANGE
            )  # an inclinometer does not depend on the tracker frame
        if law.affected_quantity == "point":
            return _compute_point_displacement(r, more)
        if law.affected_quantity != "wrench":
            return more
        return np.stack([r.compute_displacement(w) for w in np.moveaxis(more, 2, 0)], axis=2)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape))

    def correction(x: Array, shape: Shape) -> RecordCorrection:
        return RecordCorrection(effect.file_word, where, {k: q.value for k, q in sizes(x, shape).items()})

    return EffectHypothesis(
        effect=effect.file_word,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=columns,
        quantities=sizes,
        shapes=law.grid(),
        correction=correction,
        wrench_change=(lambda shape: law.columns(np.array(shape), recorded_load))
        if law.affected_quantity == "wrench"
        else None,
        family="sensor",
        note=NOTE,
    )
