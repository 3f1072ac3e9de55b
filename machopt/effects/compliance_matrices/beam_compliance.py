"""Compliance matrices of beams at their loaded end, clamped at the other; local axes, x along the beam.

Order of rows: translation x, y, z in m, rotation x, y, z in rad; of columns: force, moment. Euler–Bernoulli,
prismatic, isotropic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import skew_matrix


def compute_bending_compliance(length: float) -> Array:
    """(6, 6) compliance of bending per unit of 1/(E·I), both planes alike; L³/3, L²/2, L (zhang2025 eq. 19's inverse).

    Args:
        length: m.
    """
    x, y, z = np.eye(3)
    return compute_single_axis_bending_compliance(y, x, length) + compute_single_axis_bending_compliance(z, x, length)


def compute_single_axis_bending_compliance(axis: Array, along: Array, length: float) -> Array:
    """(6, 6) compliance of bending about one principal axis alone, per unit of its 1/(E·I).

    Args:
        axis: (3,) the principal axis.
        along: (3,) the beam's, clamped end to loaded end.
        length: m.
    """
    shift, L = np.cross(axis, along), length  # a moment about z lifts the end of a beam along x to +y
    C = np.zeros((6, 6))
    C[:3, :3] = L**3 / 3.0 * np.outer(shift, shift)
    C[:3, 3:] = L**2 / 2.0 * np.outer(shift, axis)
    C[3:, :3] = C[:3, 3:].T
    C[3:, 3:] = L * np.outer(axis, axis)
    return C


def compute_torsion_compliance(length: float) -> Array:
    """(6, 6) compliance of torsion per unit of 1/(G·J): L on the rotation about the beam."""
    C = np.zeros((6, 6))
    C[3, 3] = length
    return C


def compute_axial_compliance(length: float) -> Array:
    """(6, 6) compliance of stretching per unit of 1/(E·A): L on the translation along the beam."""
    C = np.zeros((6, 6))
    C[0, 0] = length
    return C


@dataclass(frozen=True)
class BeamCylinder:
    """One step of a tool: a solid round bar, or a tube."""

    diameter: float  # m
    length: float  # m
    youngs: float  # Pa
    poisson: float = 0.3
    bore: float = 0.0  # m

    @property
    def EI(self) -> float:
        """Bending stiffness E π (D⁴ − d⁴)/64 in N·m². tian2025 calls I "polar"; eq. 2 needs the area moment."""
        return self.youngs * np.pi * (self.diameter**4 - self.bore**4) / 64.0

    @property
    def GJ(self) -> float:
        """Torsional stiffness G π (D⁴ − d⁴)/32 in N·m²."""
        return self.youngs / (2.0 * (1.0 + self.poisson)) * np.pi * (self.diameter**4 - self.bore**4) / 32.0

    @property
    def EA(self) -> float:
        """Axial stiffness E π (D² − d²)/4 in N."""
        return self.youngs * np.pi * (self.diameter**2 - self.bore**2) / 4.0


def compute_cylinder_compliance(cylinder: BeamCylinder) -> Array:
    """(6, 6) compliance of one cylinder at its end: bending, torsion, stretching."""
    L = cylinder.length
    return np.asarray(
        compute_bending_compliance(L) / cylinder.EI
        + compute_torsion_compliance(L) / cylinder.GJ
        + compute_axial_compliance(L) / cylinder.EA
    )


def compute_stepped_beam_compliance(cylinders: Sequence[BeamCylinder]) -> Array:
    """(6, 6) compliance at the tip of cylinders in series, the clamped one first.

    Each cylinder also carries the moment of the force at the tip and tilts all that follows, which the sum of
    L³/3EI (tian2025 eq. 3) leaves out: :func:`compute_tian2025_tip_compliance`.
    """
    C = np.zeros((6, 6))
    for cylinder in cylinders:
        C = shift_compliance_along_beam(C, cylinder.length) + compute_cylinder_compliance(cylinder)
    return C


def shift_compliance_along_beam(C: Array, distance: float) -> Array:
    """(6, 6) compliance at a point rigidly ``distance`` m further along local x: G C Gᵀ."""
    G = np.eye(6)
    G[:3, 3:] = -skew_matrix(np.array([distance, 0.0, 0.0]))
    return np.asarray(G @ C @ G.T)


def compute_tian2025_tip_compliance(cylinders: Sequence[BeamCylinder]) -> float:
    """Lateral compliance at the tip in m/N as tian2025 eqs. 2–3 have it: Σ L³/(3 E I), lever arms left out.

    For comparison only: a long thin bur behind a stiff holder comes out right, a soft holder far from the tip far
    too stiff.
    """
    return float(sum(c.length**3 / (3.0 * c.EI) for c in cylinders))
