"""What the truth says about one effect, and the little all effects share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulator.laws import Law, Spring
from simulator.world import World

Array = NDArray[np.float64]
ARCMIN, ARCSEC = np.pi / 10800.0, np.pi / 648000.0


@dataclass
class Concealed:
    """The truth about one effect."""

    effect: str
    location: str
    law: str  # what the simulator does, in words
    parameters: dict[str, tuple[float, str]]  # name: value, unit
    size: tuple[float, str]  # the number a detection limit is compared with
    accepted: list[tuple[str, str]] = field(default_factory=list)
    catalogue: bool = True


Apply = Callable[[World, str, float, np.random.Generator], Concealed]


def joint_of(place: str) -> int:
    return int(place.split(":")[1]) - 1


def stiffness_of(law: Law) -> float:
    """N·m/rad of a gear that is still linear."""
    if isinstance(law, Spring):
        return law.k
    raise ValueError(f"two effects in one gear: {law}")


def gear_twist(world: World, i: int) -> float:
    """rad: twist of the gear under the largest load torques; at least what the smallest lever of the cell causes."""
    return float(world.load[i] / world.nominal.stiffness[i])
