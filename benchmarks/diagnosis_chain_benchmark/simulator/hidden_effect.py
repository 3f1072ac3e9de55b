"""What the truth says about one effect, and the little all effects share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulator.gear_torque_laws import Law, Spring
from simulator.measurement_setup import MeasurementSetup

Array = NDArray[np.float64]
ARCMIN, ARCSEC = np.pi / 10800.0, np.pi / 648000.0


@dataclass
class HiddenEffect:
    """The truth about one effect."""

    effect: str
    location: str
    law: str  # what the simulator does, in words
    parameters: dict[str, tuple[float, str]]  # name: value, unit
    size: tuple[float, str]  # the number a detection limit is compared with
    accepted: list[tuple[str, str]] = field(default_factory=list)
    catalogue: bool = True


Apply = Callable[[MeasurementSetup, str, float, np.random.Generator], HiddenEffect]


def joint_of(place: str) -> int:
    return int(place.split(":")[1]) - 1


def stiffness_of(law: Law) -> float:
    """N·m/rad of a gear that is still linear."""
    if isinstance(law, Spring):
        return law.k
    raise ValueError(f"two effects in one gear: {law}")


def gear_twist(world: MeasurementSetup, i: int) -> float:
    """rad: twist of the gear under the largest load torques; at least what the smallest lever of the cell causes."""
    return float(world.load[i] / world.nominal.stiffness[i])
