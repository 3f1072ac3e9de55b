"""Stiffness of an arm: joint springs, constant or per cell of a grid (jiao2022 section 2.2), and further terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array

SOFTEST, STIFFEST = 1e2, 1e10  # N·m/rad of a joint; beyond these it is another unit, not another robot
LEAST_STIFFNESS = 1e4  # N·m/rad, the bottom of the range of robot joints: fits look for none below it
WITHIN = np.radians(1.0)  # beyond the last measured angle that still counts as covered: poses are rounded, and sag


def format_joint_stiffness(stiffness: float) -> str:
    """Return a joint's stiffness as files and tables write it: 4.68e5 N·m/rad.

    Args:
        stiffness: Joint stiffness, N·m/rad.
    """
    return f"{stiffness:.3g} N·m/rad".replace("e+0", "e").replace("e+", "e")


@dataclass(frozen=True)
class StiffnessGrid:
    """Piecewise constant joint stiffness over boxes of TCP positions in base_link; x fastest."""

    origin: Array  # (3,) m, lowest corner, in base_link
    cell: float  # m, edge length
    shape: tuple[int, int, int]
    joints: Array  # (nx*ny*nz, 6) N·m/rad, x fastest
    std: Array | None = None  # (nx*ny*nz, 6) N·m/rad, 1 sigma of ``joints``


@dataclass(frozen=True)
class StiffnessTerm:
    """One piece of physics beside the joint springs, as stiffness.yaml and diagnosis.json name it.

    ``parameters`` are the file's own keys, which carry their units (EI_Nm2, length_mm …);
    :mod:`machopt.stiffness.terms` knows what each effect needs.
    """

    effect: str  # a word of the vocabulary, e.g. "link_compliance"
    location: str  # e.g. "link:4"
    parameters: Mapping[str, Any] = field(default_factory=dict)
    covariance: tuple[tuple[float, ...], ...] | None = None  # of its numbers, in the file's units; None: not stated


@dataclass(frozen=True, kw_only=True)
class ModelDiscrepancy:
    """How far a model may be from the arm, in coefficients that :mod:`machopt.stiffness.discrepancy_columns` names; SI
    units.

    They are ``shift`` off the file's numbers (zero for what is not in it) in the mean, and scatter about that with the
    covariance Σ mᵀ m over ``modes``. Joints are among them: where this is given, it includes all of ``covariance``.
    ``counted``: what is predicted counts ``shift`` in; otherwise it is the file's numbers alone, which are off by it.
    """

    parts: tuple[str, ...]  # K names
    torque: Array  # (6,) N·m, the joints' typical torque in the load tests: what ``play`` and ``knee`` are shares of
    shift: Array  # (K,)
    modes: Array  # (R, K)
    left: float  # m a coordinate, what the model left of the readings
    noise: float  # m a coordinate, what replicates and statements make of it
    misfit: bool = True  # readings show that something is missing
    local: float = 0.0  # m/N, 1 sigma of a coordinate's compliance of each pose on its own, in addition
    counted: bool = True

    def describe_misfit(self, what: str, sure: str = "") -> str:
        """Return a sentence on the model's misfit, and whether a quantity includes it; empty where there is neither.

        Args:
            what: Name of the quantity, a plural.
            sure: A sentence on its uncertainty.
        """
        counts = self.counted and bool(self.shift.any())
        mean = f"{what} count in, in the mean, what the readings show beyond the file's springs."
        if not self.misfit:
            return f"{mean} (discrepancy of the stiffness file)" if counts and not sure else ""
        times = self.left / self.noise if self.noise > 0 else np.inf
        if not self.counted:
            mean = f"{what} are of the springs alone (discrepancy.counted: false)."
        return (
            f"The stiffness leaves {1e3 * self.left:.3g} mm of the readings it comes from, {times:.1f} times their "
            f"noise of {1e3 * self.noise:.3g} mm: physics is missing in it. {mean} {sure}machopt diagnose looks for "
            "what is missing."
        )


@dataclass(frozen=True)
class PositionError:
    """How far the TCP is from where the model says, by measured poses that no fit saw: a scatter, never a mean.

    A coordinate, 1 sigma, the instrument's own noise in it; beside base_link and TCP as the poses' own fit set them.
    It holds at joint angles between those that were measured.
    """

    std: float  # m, with the corrections of kinematics.yaml
    plain: float  # m, without them: springs alone
    noise: float  # m, of it what repeats or statements make of the instrument and the arm's return
    poses: int
    joints: Array  # (6, 2) rad, lowest and highest encoder angle

    def is_in_covered_range(self, q: Array) -> Array:
        """Return (N, 6) whether each joint is within its measured range.

        Args:
            q: (N, 6) joint positions by encoder, rad.
        """
        return np.asarray((q >= self.joints[:, 0] - WITHIN) & (q <= self.joints[:, 1] + WITHIN))

    def beyond(self, q: Array) -> tuple[str, ...]:
        """Return a sentence on joints beyond the measured range; none if all are within.

        Args:
            q: (N, 6) joint positions by encoder, rad.
        """
        inside = self.is_in_covered_range(q)
        if inside.all():
            return ()
        which = ", ".join(str(j + 1) for j in np.flatnonzero(~inside.all(axis=0)))
        share = 100.0 * float(np.mean(~inside.all(axis=1)))
        return (
            f"{share:.0f} % of these poses lie outside the joint angles (joint {which}) that the cell's position_error "
            "covers: corrections found with it are not known to hold there",
        )


@dataclass(frozen=True, kw_only=True)
class ExternalJointSpring:
    """Compliant external joint and the body that it moves: a rail's carriage, a positioner's table.

    The body's frame is the URDF link that the joint moves.
    """

    joint: str
    stiffness: float  # N·m/rad where it turns, N/m where it slides; inf: rigid
    slides: bool | None  # what the unit of its stiffness says; None: none is stated
    compliance: Array  # (6, 6) SI, of the body at ``at``, in the body's axes
    at: Array  # (3,) m, in the body
    mass: float = 0.0  # kg of the body and what is bolted to it, the robot not among it
    com: Array | None = None  # (3,) m, in the body; None: its origin
    std: float = 0.0  # 1 σ of the stiffness, in its unit; 0: it counts as exact

    @property
    def compliance_sigma(self) -> float:
        """1 σ of the joint's compliance 1/k, to first order: rad/(N·m), m/N."""
        return self.std / self.stiffness**2 if self.std else 0.0

    @property
    def is_compliant(self) -> bool:
        """Whether the joint or its body deflects under a load."""
        return bool(np.isfinite(self.stiffness) or self.compliance.any())


@dataclass(frozen=True, kw_only=True)
class ArmStiffness:
    """Stiffness of the arm, and of what moves its base or the workpiece.

    Outside ``grid`` the constant values apply (marked in the results).
    """

    joints: Array  # (6,) N·m/rad
    covariance: Array | None = None  # (6, 6) of the joint compliances, (rad/(N·m))²
    grid: StiffnessGrid | None = None
    terms: tuple[StiffnessTerm, ...] = ()
    file: Path | None = field(default=None, compare=False)  # it was read from, for messages
    estimated: bool = False  # by a rule, from no measurement of this arm
    discrepancy: ModelDiscrepancy | None = None  # None: not compared with readings
    external: tuple[ExternalJointSpring, ...] = ()  # of the external joints that are not rigid or weigh something
    position: PositionError | None = None  # None: not compared with measured poses
    spread: float | None = None  # 1 sigma of the logarithm of every spring, where there is no covariance
    source: str = ""  # where the numbers come from


def describe_ignored_springs(external: tuple[ExternalJointSpring, ...]) -> tuple[str, ...]:
    """Return the warning that springs of external joints are ignored in measurements; none without springs.

    Args:
        external: Springs of the external joints.
    """
    names = ", ".join(s.joint for s in external if s.is_compliant)
    if not names:
        return ()
    return (
        f"external_joints of stiffness.yaml ({names}): not fitted, not counted in what is predicted here, and kept as "
        "they are in a file that is written. A tracker or gauge on the floor sees the carriage deflect "
        "too, which looks like base_compliance; such a finding and external_joints would count twice",
    )
