"""Effects on the record of a load test: each law of the registry, through the compliance found so far.

Errors of the load act on the displacement through the arm: recorded w = acting w + error, hence
δ = C (w_recorded − error).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.readings import Readings
from machopt.effects import registry
from machopt.effects.protocol import Effect, Recorded, RecordLaw

NOTE = "in the record, not in the robot"


def hypotheses(r: Readings) -> list[Hypothesis]:
    """The laws of every effect on forces and displacements."""
    tool = r.state.T_base_tool[:, :3, :3]
    base = np.broadcast_to(np.eye(3), tool.shape)
    frames = {"wrench": r.recording.wrench_frame, "displacement": r.recording.displacement_frame}
    seen = {
        moves: Recorded(r.wrench, r.through(r.wrench), tool if frame == "tool" else base, tool)
        for moves, frame in frames.items()
    }
    return [_hypothesis(r, e, law, seen[law.moves]) for e in registry.of_records() for law in e.recorded]


def _hypothesis(r: Readings, effect: Effect, law: RecordLaw, seen: Recorded) -> Hypothesis:
    (where,) = effect.places

    def columns(shape: Shape) -> Array:
        more = law.columns(np.array(shape), seen)
        if law.moves == "displacement":
            return more
        return np.stack([r.through(w) for w in np.moveaxis(more, 2, 0)], axis=2)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape))

    def correction(x: Array, shape: Shape) -> RecordCorrection:
        return RecordCorrection(effect.called, where, {k: q.value for k, q in sizes(x, shape).items()})

    return Hypothesis(
        effect.called,
        where,
        law.name,
        law.equation,
        columns,
        sizes,
        law.grid(),
        correction=correction,
        family="sensor",
        note=NOTE,
    )
