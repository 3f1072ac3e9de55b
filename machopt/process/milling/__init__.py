"""Cutting forces of end mills: mean over a revolution, and along the rotation."""

from machopt.process.milling.engagement_angles import ContactArc, compute_chip_thickness, compute_contact_arc
from machopt.process.milling.mean_force import MeanCuttingLoad, compute_mean_load, compute_mean_load_of_arc
from machopt.process.milling.milling_cut import (
    MillingCut,
    MillingCutter,
    check_milling_coefficients,
    compute_feed_per_tooth,
)

__all__ = [
    "ContactArc",
    "MeanCuttingLoad",
    "MillingCut",
    "MillingCutter",
    "check_milling_coefficients",
    "compute_chip_thickness",
    "compute_contact_arc",
    "compute_feed_per_tooth",
    "compute_mean_load",
    "compute_mean_load_of_arc",
]
