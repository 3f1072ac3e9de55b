"""What a drive winds up by, beyond its linear spring, as a function of torque, angle and history.

Each law has ``compute_extra(drive) -> (N,) rad`` and ``advance(drive)`` at the end of a load step. ``Drive``
carries torque, angle
and time of the whole arm, so that laws may couple joints. Laws with contact or slip are torque functions of the
windup and
are inverted by bisection: torque(windup) increases strictly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Drive:
    """State of all six drives in one load step."""

    torque: np.ndarray  # (N, 6) N·m, that the bushing carries about the axis
    angle: np.ndarray  # (N, 6) rad, encoder angle
    duration: np.ndarray  # (N,) s since the previous step
    arrival: np.ndarray  # (N, 6) ±1, direction from which the joint came


def invert_torque(torque_of: Callable[[np.ndarray], np.ndarray], torque: np.ndarray, reach: float) -> np.ndarray:
    """Return the windup (N,) at which an increasing function takes the torque (N,); |windup| ≤ reach."""
    low, high = np.full(torque.shape, -reach), np.full(torque.shape, reach)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = torque_of(middle) > torque
        high, low = np.where(above, middle, high), np.where(above, low, middle)
    return 0.5 * (low + high)


class GearLaw:
    """Base: no memory."""

    joint: int

    def reset(self, count: int) -> None:
        """Forget the history of all postures of a batch."""

    def compute_extra(self, drive: Drive) -> np.ndarray:
        """Return the extra windup (N,) in rad."""
        raise NotImplementedError

    def advance(self, drive: Drive) -> None:
        """Keep the state at the end of a load step."""


@dataclass
class HertzWindup(GearLaw):
    """Roller contacts: windup a·sgn(τ)|τ/τ_r|^0.6, rounded near zero: softest at low torque."""

    joint: int
    amplitude: float  # rad at the reference torque
    reference: float  # N·m

    def compute_extra(self, drive: Drive) -> np.ndarray:
        t = drive.torque[:, self.joint] / self.reference
        return self.amplitude * t / (t**2 + 0.03**2) ** 0.2


@dataclass
class RoundedPlay(GearLaw):
    """Two flanks with a gap b and rounded entry; a seal keeps 2 % of the stiffness inside the gap."""

    joint: int
    width: float  # rad, whole gap
    stiffness: float  # N·m/rad of a flank in contact

    def _torque(self, windup: np.ndarray) -> np.ndarray:
        r = max(0.06 * self.width, 1e-9)
        push = r * (np.logaddexp(0, (windup - self.width / 2) / r) - np.logaddexp(0, (-windup - self.width / 2) / r))
        return self.stiffness * (0.02 * windup + push)

    def compute_extra(self, drive: Drive) -> np.ndarray:
        torque = drive.torque[:, self.joint]
        reach = self.width + 1.1 * float(np.max(np.abs(torque))) / self.stiffness + 1e-9
        return invert_torque(self._torque, torque, reach) - torque / self.stiffness


@dataclass
class SlipStack(GearLaw):
    """Iwan stack: a spring beside n Jenkins elements (spring and dry slider), whose slip torques spread over two
    decades.

    Share h of the stiffness is in the elements. At small torque nothing slips and the gear has its plain
    stiffness; a load cycle
    leaves a closed loop that does not depend on the rate.
    """

    joint: int
    share: float
    stiffness: float  # N·m/rad before any slip
    reference: float  # N·m, slip torque of the last element
    arrival_torque: float = 0.15  # of the reference: friction that the arrival leaves in the gear
    elements: int = 24
    slider: np.ndarray | None = field(default=None, repr=False)  # (N, n) rad
    arrived: bool = False

    def __post_init__(self) -> None:
        self.k = np.full(self.elements, self.share * self.stiffness / self.elements)
        windup = self.reference / self.stiffness
        self.limit = self.k * windup * np.geomspace(0.02, 2.0, self.elements)

    def reset(self, count: int) -> None:
        self.slider, self.arrived = np.zeros((count, self.elements)), False

    def _element_torques(self, windup: np.ndarray) -> np.ndarray:
        return np.clip(self.k * (windup[:, None] - self.slider), -self.limit, self.limit)

    def _torque(self, windup: np.ndarray) -> np.ndarray:
        return (1.0 - self.share) * self.stiffness * windup + self._element_torques(windup).sum(1)

    def _find_windup(self, torque: np.ndarray) -> np.ndarray:
        reach = 2.0 * (np.max(np.abs(torque)) / self.stiffness + self.reference / self.stiffness) / (1.0 - self.share)
        return invert_torque(self._torque, torque, float(reach))

    def compute_extra(self, drive: Drive) -> np.ndarray:
        torque = drive.torque[:, self.joint]
        return self._find_windup(torque) - torque / self.stiffness

    def _slide(self, torque: np.ndarray) -> None:
        windup = self._find_windup(torque)
        self.slider = windup[:, None] - self._element_torques(windup) / self.k

    def advance(self, drive: Drive) -> None:
        torque = drive.torque[:, self.joint]
        if not self.arrived:  # the arrival wound the gear up in its direction of motion, then the brake closed
            self._slide(torque + self.arrival_torque * self.reference * drive.arrival[:, self.joint])
            self.arrived = True
        self._slide(torque)


@dataclass
class CreepPair(GearLaw):
    """Two Kelvin–Voigt elements in series with the spring: τ_j ẋ_j + x_j = c_j τ."""

    joint: int
    fraction: float  # of the spring's compliance, both together
    stiffness: float  # N·m/rad
    times: tuple[float, float] = (11.0, 95.0)  # s
    state: np.ndarray | None = field(default=None, repr=False)  # (N, 2) rad
    arrived: bool = False

    def reset(self, count: int) -> None:
        self.state, self.arrived = np.zeros((count, 2)), False

    def _next(self, drive: Drive) -> np.ndarray:
        target = drive.torque[:, self.joint, None] / self.stiffness * self.fraction * np.array([0.6, 0.4])
        if not self.arrived:  # the weight has been there for long
            return target
        return target + (self.state - target) * np.exp(-drive.duration[:, None] / np.array(self.times))

    def compute_extra(self, drive: Drive) -> np.ndarray:
        return self._next(drive).sum(1)

    def advance(self, drive: Drive) -> None:
        self.state, self.arrived = self._next(drive), True


@dataclass
class SoftSector(GearLaw):
    """A worn sector of the ring gear: more compliance around one angle (von Mises shape)."""

    joint: int
    amplitude: float  # of the compliance at the centre
    stiffness: float
    center: float  # rad
    sharpness: float = 3.0

    def compute_extra(self, drive: Drive) -> np.ndarray:
        shape = np.exp(self.sharpness * (np.cos(drive.angle[:, self.joint] - self.center) - 1.0))
        return self.amplitude * shape * drive.torque[:, self.joint] / self.stiffness


@dataclass
class HollowShaft(GearLaw):
    """Shaft of joint j inside joint i: windup t = c_s (τ_j + ρ τ_i) adds t to joint j and ρ t to joint i."""

    joint: int  # i
    inner: int  # j
    ratio: float
    compliance: float  # rad/(N·m)
    own: bool = False  # False: this object is the part of joint i

    def compute_extra(self, drive: Drive) -> np.ndarray:
        i, j = (self.inner, self.joint) if self.own else (self.joint, self.inner)
        twist = self.compliance * (drive.torque[:, j] + self.ratio * drive.torque[:, i])
        return twist if self.own else self.ratio * twist


@dataclass
class GearWaves(GearLaw):
    """Transmission error: order N with amplitude modulation by the output turn, and its second order."""

    joint: int
    amplitude: float  # rad
    order: int
    phase: float

    def compute_extra(self, drive: Drive) -> np.ndarray:
        q = drive.angle[:, self.joint]
        wave = (1.0 + 0.25 * np.cos(q + 1.0)) * np.sin(self.order * q + self.phase)
        return self.amplitude * (wave + 0.3 * np.sin(2 * self.order * q + 2.1 * self.phase))


@dataclass
class AngleOffset(GearLaw):
    """A wrong encoder zero."""

    joint: int
    offset: float  # rad

    def compute_extra(self, drive: Drive) -> np.ndarray:
        return np.full(len(drive.angle), self.offset)


@dataclass
class AngleCoupling(GearLaw):
    """A kinematic coupling that the controller does not compensate: Δq_j = κ q_i."""

    joint: int
    source: int
    ratio: float

    def compute_extra(self, drive: Drive) -> np.ndarray:
        return self.ratio * drive.angle[:, self.source]
