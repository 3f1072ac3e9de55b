"""A laboratory with hidden physics, and one effect that changes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from bushing_simulator.robot_assembly import HiddenPhysics


@dataclass
class Laboratory:
    """Everything that differs from the cell: the robot's physics, sensor errors, errors of the pose measurement."""

    hidden: HiddenPhysics
    sensors: dict = field(default_factory=dict)
    errors: dict = field(default_factory=dict)


@dataclass(frozen=True)
class DrawnEffect:
    """One hidden effect; ``truth`` states its parameters at a scale as (value, unit)."""

    effect: str
    location: str
    law: str
    apply: Callable[[Laboratory, float], None]
    largest: float  # scale that is still physical
    truth: Callable[[float], dict[str, tuple[float, str]]]
    accepted: tuple[tuple[str, str], ...] = ()


def state_no_parameters(scale: float) -> dict[str, tuple[float, str]]:
    """Return no true parameter: the law has none that a catalogue states."""
    return {}
