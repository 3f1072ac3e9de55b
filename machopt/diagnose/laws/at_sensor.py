"""Effects on the record of an arm at rest: each law of the registry, through the compliance found so far.

Errors of the load act on the displacement through the arm: recorded w = acting w + error, hence
δ = C (w_recorded − error).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.nouns.readings import BEHIND, Readings
from machopt.effects import registry
from machopt.effects.protocol import Effect, Recorded, RecordLaw

NOTE = "in the record, not in the robot"


def hypotheses(r: Readings) -> list[Hypothesis]:
    """Those of a load test, on forces and displacements."""
    tool = r.state.T_base_tool[:, :3, :3]
    base = np.broadcast_to(np.eye(3), tool.shape)
    frames = {"wrench": r.recording.wrench_frame, "displacement": r.recording.displacement_frame}
    seen = {
        moves: Recorded(r.wrench, r.through(r.wrench), tool if frame == "tool" else base, tool)
        for moves, frame in frames.items()
    }
    seen["point"] = seen["wrench"]
    return [_hypothesis(r, e, law, seen[law.moves]) for e, law in _laws() if law.moves in seen]


def in_poses(r: Readings) -> list[Hypothesis]:
    """Those on the position of the TCP, where the record says in which frame it is."""
    axes = np.broadcast_to(np.eye(3), (len(r), 3, 3))
    seen = Recorded(
        r.wrench,
        np.zeros((len(r), 6)),
        axes,
        r.state.T_base_tool[:, :3, :3],
        r.state.T_base_tool[:, :3, 3],
    )
    return [_hypothesis(r, e, law, seen) for e, law in _laws() if law.moves == "position"]


def _at_point(r: Readings, way: Array) -> Array:
    """(N, D, P) m, rad, of load and displacement at points that lie (N, 3+, P) m from the TCP, to first order."""
    tau = r.load_torque * r.compliance
    turned = np.einsum("nci,ni->nc", r.state.J[:, 3:], tau)
    if r.bodies is not None:
        turned += np.einsum("ncd,nd->nc", r.bodies[:, 3:], r.wrench)
    out = []
    for off in np.moveaxis(way[:, :3], 2, 0):
        lever = np.concatenate([np.zeros_like(off), np.cross(off, r.wrench[:, :3])], axis=1)
        own = r.through(lever)
        own[:, :3] += np.cross(turned, off)
        out.append(own)
    return np.stack(out, axis=2)


def _laws() -> list[tuple[Effect, RecordLaw]]:
    return [(e, law) for e in registry.of_records() for law in e.recorded]


def _hypothesis(r: Readings, effect: Effect, law: RecordLaw, seen: Recorded) -> Hypothesis:
    (where,) = effect.places

    def columns(shape: Shape) -> Array:
        more = law.columns(np.array(shape), seen)
        if law.moves == "position":
            return r.seen(more, BEHIND)  # no inclinometer tells where the tracker stands
        if law.moves == "point":
            return _at_point(r, more)
        if law.moves != "wrench":
            return more
        return np.stack([r.through(w) for w in np.moveaxis(more, 2, 0)], axis=2)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape))

    def correction(x: Array, shape: Shape) -> RecordCorrection:
        return RecordCorrection(effect.called, where, {k: q.value for k, q in sizes(x, shape).items()})

    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=columns,
        quantities=sizes,
        shapes=law.grid(),
        correction=correction,
        family="sensor",
        note=NOTE,
    )
