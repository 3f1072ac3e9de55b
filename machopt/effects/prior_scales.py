"""Prior scales of everything uncertain that a diagnosis fits, each with its source.

This is the only place with numbers of priors. A fit uses a normal prior about the stated value, or about zero where
nothing is stated, with the scale as standard deviation. What a recording or a cell states of its own, such as
``target`` in ``uncertainty``, takes precedence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PriorScale:
    """Standard deviation of an uncertain quantity."""

    quantity: str
    scale: float
    unit: str  # SI; "1": relative
    source: str


LINK_MASS = PriorScale(
    "mass of a link, relative to the URDF",
    0.05,
    "1",
    "judgement: CAD masses lack cables, grease and paint",
)
WRONG_LINK_MASS = PriorScale(
    "mass of a link where a motion shows that several differ from the URDF",
    0.15,
    "1",
    "judgement: variants of one arm",
)
LINK_FIRST_MOMENT = PriorScale(
    "first moment of upper arm or forearm without a stated mass, per m⁴ of reach",
    10.0,
    "kg·m/m⁴",
    "judgement: volumes times lengths grow with the fourth power of size",
)
FORCE_GAIN = PriorScale(
    "gain of the force between sessions",
    0.02,
    "1",
    "judgement: load cells hold 0.5 to 2 % of a reading",
)
GEOMETRIC_STIFFNESS = PriorScale(
    "K_C relative to its computed value", 0.2, "1", "judgement: K_C depends on the compliances that are still open"
)
COMPLIANCE = PriorScale(
    "compliance of a joint in poses, relative to the cell",
    5.0,
    "1",
    "judgement: too wide to act where a load shows the spring",
)
FIRST_FIT_COMPLIANCE = PriorScale(
    "the same in the first fit of poses", 1.0, "1", "judgement: holds springs near the cell that weight does not show"
)
FRAME_SHIFT = PriorScale(
    "shift of a joint axis against its drawing",
    0.0005,
    "m",
    "judgement: manufacturing tolerance of a link",
)
FRAME_ROTATION = PriorScale(
    "direction of a joint axis against its drawing",
    float(np.radians(0.05)),
    "rad",
    "judgement: manufacturing tolerance of a link",
)
FRAME_DOUBT = PriorScale(
    "coefficients of a frame in units of FRAME_SHIFT and FRAME_ROTATION", 1.0, "1", "follows from their definition"
)
JOINT_ZERO = PriorScale(
    "zero of a joint against its mark, where another quantity is estimated beside it",
    float(np.radians(0.1)),
    "rad",
    "judgement: marks and cartridges hold 0.1°",
)
TARGET_POSITION = PriorScale(
    "place of a reflector on the flange without a stated uncertainty",
    0.002,
    "m",
    "judgement: a nest placed by hand",
)
WAVE_AMPLITUDE = PriorScale(
    "amplitude of a transmission error",
    3e-4,
    "rad",
    "judgement: about one arcmin for robot gears, more for strain wave gears",
)
COUPLING_RATIO = PriorScale(
    "kinematic coupling of wrist joints",
    3e-4,
    "1",
    "judgement: uncompensated wrists have 1e-4 to 1e-3; larger values indicate a tilted axis",
)

PRIOR_SCALES = (
    LINK_MASS,
    WRONG_LINK_MASS,
    LINK_FIRST_MOMENT,
    FORCE_GAIN,
    GEOMETRIC_STIFFNESS,
    COMPLIANCE,
    FIRST_FIT_COMPLIANCE,
    FRAME_SHIFT,
    FRAME_ROTATION,
    FRAME_DOUBT,
    JOINT_ZERO,
    TARGET_POSITION,
    WAVE_AMPLITUDE,
    COUPLING_RATIO,
)
