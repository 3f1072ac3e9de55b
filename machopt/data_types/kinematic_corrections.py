"""Kinematic corrections between a joint's encoder angle and its true angle.

The true angle of joint j is q_j + Δ_j(q), with q the encoder angles and Δ_j the sum of the corrections of joint j.
Planner and verification each implement these entries on their own; here they are as kinematics.yaml and
diagnosis.json hold them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class KinematicCorrection:
    """One entry. ``parameters`` are the file's own keys, which carry their units:
    :mod:`machopt.effects.joint.joint_angle_errors`, and
    :mod:`machopt.effects.joint.joint_coupling` between two joints.
    """

    effect: str
    location: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    # of a user-defined effect: (S,) rad rotation of its joint at angles (S,) rad; it has no second implementation
    own: Callable[[Array], Array] | None = field(default=None, compare=False)


@dataclass(frozen=True)
class KinematicCorrections:
    """All corrections of an arm."""

    corrections: tuple[KinematicCorrection, ...] = ()
    file: Path | None = field(default=None, compare=False)  # it was read from, for messages

    def __bool__(self) -> bool:
        return bool(self.corrections)
