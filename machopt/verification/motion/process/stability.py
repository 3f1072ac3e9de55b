"""Modes and stability of milling at some points, recomputed one by one.

Modes: (K − ω² M) φ = 0 with M of the whole URDF by pinocchio, the tool added at the flange, rotors locked. Limit: the
least depth a at which the modes with a delay to second order lose their damping,

    (I + a T²/2 G) q̈ + (2 ζ ω − a T G) q̇ + ω² q = 0,    G = Uᵀ H U

found by doubling and bisection of a, with the eigenvalues of the companion matrix. H is averaged by the midpoint rule.
Where chatter begins below ωT = 1 a stated limit must not be above it; above ωT = 1 the expansion of the delay does not
hold, and the limit is not compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.process import CutSide, ProcessOperation
from machopt.data_types.stock import StockEngagement
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

HALVINGS, DEPTHS = 14, 12  # 14: a limit is found to 6e-6 of itself
SMALLEST_M, LARGEST_M, LADDER_STEP, LADDER_PART = 1e-5, 1.0, 1.1, 32
_RUNGS = math.ceil(math.log(LARGEST_M / SMALLEST_M) / math.log(LADDER_STEP))
_LADDER: Array = SMALLEST_M * np.power(LADDER_STEP, np.arange(_RUNGS, dtype=np.float64))


@dataclass(frozen=True)
class PointModes:
    """Modes at one point."""

    omega: Array  # (6,) rad/s, ascending
    shape: Array  # (6, 3) 1/√kg: travel, normal, axial

    @property
    def lowest_hz(self) -> float:
        """Lowest frequency, Hz."""
        return float(self.omega[0] / (2.0 * math.pi))


class ModeModel:
    """Mass matrix of the arm with its tool."""

    def __init__(self, cell: Cell, arm: UrdfKinematics) -> None:
        import pinocchio as pin

        self.arm, self.model = arm, arm.model.copy()
        frame = self.model.frames[self.model.getFrameId(cell.flange_link)]
        inertia = np.zeros((3, 3)) if cell.tool.inertia is None else np.array(cell.tool.inertia, float)
        if cell.tool.mass > 0:
            tool = pin.Inertia(cell.tool.mass, np.array(cell.tool.com, float), inertia)
            joint = frame.parentJoint
            self.model.inertias[joint] = self.model.inertias[joint] + frame.placement.act(tool)
        self.data = self.model.createData()
        self.columns = [self.model.joints[j].idx_v for j in arm.joints]

    @property
    def has_inertia(self) -> bool:
        """Whether any moving link has mass in the URDF."""
        return any(self.arm.model.inertias[j].mass > 0 for j in self.arm.joints)

    def compute_modes(self, q: Array, external: Array, springs: Array, J: Array, axes: Array) -> PointModes:
        """Return the modes at one point.

        Args:
            q: (6,) rad, true angles.
            external: (E,) external joints.
            springs: (6,) N·m/rad.
            J: (6, 6) Jacobian at the TCP in base_link.
            axes: (3, 3) travel, normal and axis as rows, in base_link.
        """
        import pinocchio as pin

        full = self.arm.build_full_configuration(q, external)
        upper = np.triu(pin.crba(self.model, self.data, full))
        M = (upper + np.triu(upper, 1).T)[np.ix_(self.columns, self.columns)]
        values, vectors = scipy.linalg.eigh(np.diag(springs), M)
        return PointModes(np.sqrt(values), (axes @ J[:3] @ vectors).T)


@dataclass(frozen=True)
class DelayLaw:
    """Modes at one point with the delay to second order; NaN where the damping of a mode is unknown."""

    zeta: Array  # (6,)
    omega: Array  # (6,) rad/s
    G: Array  # (6, 6) 1/(kg·m·s²): modal gain per depth
    T: float  # s, time between two teeth

    @classmethod
    def build(
        cls,
        cell: Cell,
        one: ProcessOperation,
        arcs: Sequence[tuple[float, float, float]],
        modes: PointModes,
        speed: float,
    ) -> DelayLaw:
        """Return the law of a point.

        Args:
            cell: The cell with tool and process.
            one: The operation.
            arcs: Share of the height, start and end rad of each arc of contact.
            modes: Modes at the point.
            speed: rev/s.
        """
        cutter, process = cell.tool.cutter, cell.process
        assert cutter is not None
        assert cutter.teeth is not None
        assert process is not None
        assert process.damping is not None
        zeta = np.array([process.damping.get_ratio(n) for n in range(6)], float)
        k = modes.shape.shape[1]
        H = np.zeros((k, k))  # without contact: no force that a chip of the tooth before could change
        for share, start, end in arcs:
            H += share * _average_directional_matrix(cell, one, start, end)
        return cls(zeta, modes.omega, modes.shape @ H @ modes.shape.T, 1.0 / (speed * cutter.teeth))

    def find_eigenvalues(self, depths: Array) -> NDArray[np.complex128]:
        """Return (n,) of the eigenvalues below 1/T, where the law holds, that with the largest real part, 1/s.

        Larger ones are poles of the expansion of the delay, at depths where 1 + a T² G / 2 is singular; −inf if there
        are no others.

        Args:
            depths: (n,) m, depths of cut.
        """
        a, n = depths[:, None, None], len(self.omega)
        inverse = np.linalg.inv(np.eye(n) + 0.5 * a * self.T**2 * self.G)
        A = np.zeros((len(depths), 2 * n, 2 * n))
        A[:, :n, n:] = np.eye(n)
        A[:, n:, :n] = -inverse * self.omega**2
        A[:, n:, n:] = -inverse @ (np.diag(2.0 * self.zeta * self.omega) - a * self.T * self.G)
        values = np.linalg.eigvals(A)
        real = np.where(np.abs(values) * self.T < 1.0, values.real, -np.inf)
        worst = np.argmax(real, axis=1)
        rows = np.arange(len(depths))
        return np.asarray(np.where(np.isfinite(real[rows, worst]), values[rows, worst], -np.inf), np.complex128)

    def find_limit(self) -> float:
        """Return the largest stable depth, m; inf where the law does not hold there or has none."""
        if np.isnan(self.zeta).any():
            return math.nan
        for first in range(0, len(_LADDER), LADDER_PART):
            depths = _LADDER[first : first + LADDER_PART]
            grows = np.flatnonzero(self.find_eigenvalues(depths).real >= 0.0)
            if len(grows):
                high = float(depths[grows[0]])
                break
        else:
            return math.inf
        low = high / LADDER_STEP
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._find_worst(middle).real < 0.0 else (low, middle)
        return low

    def _find_worst(self, depth: float) -> complex:
        return complex(self.find_eigenvalues(np.array([depth]))[0])

    def is_stable_to(self, depth: float) -> bool:
        """Return whether no eigenvalue grows at any of DEPTHS depths up to one, below ωT = 1 where the law holds.

        Args:
            depth: m, depth of cut.
        """
        if np.isnan(self.zeta).any():
            return False
        found = self.find_eigenvalues(depth * np.arange(1, DEPTHS + 1) / DEPTHS)
        return not (found.real >= 0.0).any()


def find_given_arc(cell: Cell, side: CutSide, ae: float) -> tuple[float, float, float]:
    """Return the arc of a given radial depth of cut over the whole height: 1, start and end rad.

    Args:
        cell: The cell with the tool.
        side: Side of the cut.
        ae: m, radial depth of cut.
    """
    assert cell.tool.cutter is not None
    theta = math.pi if side == "slot" else math.acos(min(max(1.0 - 2.0 * ae / cell.tool.cutter.diameter, -1.0), 1.0))
    return (1.0, math.pi - theta, math.pi) if side == "down" else (1.0, 0.0, theta)


def find_contact_arcs(arcs: StockEngagement, ap: float) -> list[tuple[float, float, float]]:
    """Return share of the height, start and end rad of each arc of a point.

    Args:
        arcs: Contact of that point alone.
        ap: m, height of the contact.
    """
    share = (arcs.high - arcs.low) / ap
    return list(zip(share.tolist(), arcs.start.tolist(), arcs.end.tolist(), strict=True))


def _average_directional_matrix(cell: Cell, one: ProcessOperation, start: float, end: float) -> Array:
    """Return (3, 3) Pa: mean force per depth and displacement of the cutter, travel, normal, axial."""
    cutter, process = cell.tool.cutter, cell.process
    assert cutter is not None
    assert cutter.teeth is not None
    assert process is not None
    c = process.materials[one.material].milling
    assert c is not None
    nodes, weights = np.polynomial.legendre.leggauss(16)  # sines of twice the angle over half a turn to 1e-15
    phi = start + 0.5 * (nodes + 1.0) * (end - start)
    mirror = 1.0 if one.spindle == "cw" else -1.0
    hand = math.copysign(1.0, cutter.helix) * mirror if cutter.helix else 0.0
    s, k = np.sin(phi), np.cos(phi)
    force = np.stack(
        [-c.Ktc_Pa * k - c.Krc_Pa * s, mirror * (c.Ktc_Pa * s - c.Krc_Pa * k), np.full_like(phi, -hand * c.Kac_Pa)]
    )  # per chip thickness and depth
    chip = np.stack([s, mirror * k, np.zeros_like(phi)])
    weight = 0.5 * (end - start) * cutter.teeth / (2.0 * math.pi)
    return np.asarray(weight * (force * weights) @ chip.T)
