"""Stiffness of an arm: joint springs, constant or per cell of a grid (jiao2022 section 2.2), and further terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.arrays import Array

SOFTEST, STIFFEST = 1e2, 1e10  # N·m/rad of a joint; beyond these it is another unit, not another robot


@dataclass(frozen=True)
class StiffnessGrid:
    """Piecewise constant joint stiffness over boxes of TCP positions in base_link; x fastest."""

    origin: Array  # (3,) m, lowest corner, in base_link
    cell: float  # m, edge length
    shape: tuple[int, int, int]
    joints: Array  # (nx*ny*nz, 6) N·m/rad, x fastest
    std: Array | None = None  # (nx*ny*nz, 6) N·m/rad, 1 sigma of ``joints``


@dataclass(frozen=True)
class Term:
    """One piece of physics beside the joint springs, as stiffness.yaml and diagnosis.json name it.

    ``parameters`` are the file's own keys, which carry their units (EI_Nm2, length_mm …);
    :mod:`machopt.model.terms` knows what each effect needs.
    """

    effect: str  # a word of the vocabulary, e.g. "link_compliance"
    location: str  # e.g. "link:4"
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Discrepancy:
    """How far a model may be from the arm, in coefficients that :mod:`machopt.model.suspects` names; SI units.

    They are ``shift`` off the file's numbers (zero for what is not in it) in the mean, and scatter about that with the
    covariance Σ mᵀ m over ``modes``. Joints are among them: where this stands, it says all that ``covariance`` says.
    ``counted``: what is predicted counts ``shift`` in; otherwise it is the file's numbers alone, which are off by it.
    """

    parts: tuple[str, ...]  # K names
    torque: Array  # (6,) N·m, the joints' typical torque in the load tests: what ``play`` and ``knee`` are shares of
    shift: Array  # (K,)
    modes: Array  # (R, K)
    left: float  # m a coordinate, what the model left of the readings
    noise: float  # m a coordinate, what replicates and statements make of it
    misfit: bool = True  # readings show that something is missing
    local: float = 0.0  # m/N, 1 sigma of a coordinate's compliance that each pose has for itself beside all that
    counted: bool = True


@dataclass(frozen=True)
class Stiffness:
    """Stiffness of the arm.

    Outside ``grid`` the constant values hold (flagged in the results).
    """

    joints: Array  # (6,) N·m/rad
    covariance: Array | None = None  # (6, 6) of the joint compliances, (rad/(N·m))²
    grid: StiffnessGrid | None = None
    terms: tuple[Term, ...] = ()
    file: Path | None = field(default=None, compare=False)  # it was read from, for messages
    estimated: bool = False  # by a rule, from no measurement of this arm
    discrepancy: Discrepancy | None = None  # what it may lack; None: no reading was held against it
