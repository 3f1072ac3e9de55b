"""Joint torques that are no effect of the catalogue: tried if several orders or several effects were found at a
joint.

A hose, cable or bumper pulls at a joint beyond an angle, with increasing force. No gear does this, but two or three
low harmonics approximate it over part of a turn and would be reported as gear ripple.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel
from machopt.measurement.diagnosis.model_selection.unmodelled_slip_and_external_forces import (
    build_uncatalogued_hypothesis,
)
from machopt.numerics.array_types import Array

TIGHTENING_LAW = "tightens beyond an angle"
SHARES = (0.1, 0.25, 0.4, 0.55, 0.7, 0.9)  # share of the samples below the onset angle
# exponents of the torque over the angle beyond the onset
POWERS = {1.0: "as a spring", 1.5: "as a contact", 2.0: "ever stiffer", 3.0: "ever stiffer, and late"}


def build_unmodelled_torque_hypotheses(scene: MotionModel, joint: int) -> list[EffectHypothesis]:
    """Build torque shapes of one joint that no effect of the catalogue has.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.

    Returns:
        The hypotheses.
    """
    if not scene.is_joint_moving(joint) or scene.prismatic[joint]:
        return []
    at = tuple(float(a) for a in np.quantile(scene.motion.q[:, joint], SHARES))
    ways: tuple[tuple[str, tuple[int, ...], tuple[Shape, ...]], ...] = (
        ("above", (1,), tuple((a,) for a in at)),
        ("below", (-1,), tuple((a,) for a in at)),
        ("both ways", (-1, 1), tuple((low, high) for low in at for high in at if low <= high)),
    )
    note = f"pulls at joint {joint + 1} from an angle on, and more the further it turns: a hose or a cable, say"
    return [
        build_uncatalogued_hypothesis(
            format_joint_location(joint + 1),
            f"{TIGHTENING_LAW}, {how}, {side}",
            note,
            _build_pull_torque(scene, joint, way, power),
            shapes,
        )
        for power, how in POWERS.items()
        for side, way, shapes in ways
    ]


def _build_pull_torque(scene: MotionModel, joint: int, ways: tuple[int, ...], power: float) -> Callable[[Shape], Array]:
    """Return the motor torque against a pull: one column per direction (1 up, −1 down), from the onset angles of the
    shape.
    """
    q = scene.motion.q[:, joint]

    def columns(shape: Shape) -> Array:
        pulls = [w * np.maximum(w * (q - a), 0.0) ** power for w, a in zip(ways, shape, strict=True)]
        return scene.column(joint, np.stack(pulls, axis=1))

    return columns
