"""Cutting forces of end mills: mean over a revolution, and along the rotation."""

from machopt.process.milling.engagement_angles import ContactArc, compute_chip_thickness, compute_contact_arc
from machopt.process.milling.instantaneous_force import (
    CuttingWaveform,
    compute_surface_generation_load,
    compute_waveform,
    find_peak_force,
)
from machopt.process.milling.kienzle_conversion import LinearizedKienzle, linearize_kienzle
from machopt.process.milling.mean_force import MeanCuttingLoad, compute_mean_load, compute_mean_load_of_arc
from machopt.process.milling.milling_cut import (
    MillingCut,
    MillingCutter,
    check_milling_coefficients,
    compute_feed_per_tooth,
)
from machopt.process.milling.orthogonal_to_oblique import (
    TI6AL4V,
    OrthogonalCuttingData,
    compute_oblique_coefficients,
)

__all__ = [
    "TI6AL4V",
    "ContactArc",
    "CuttingWaveform",
    "LinearizedKienzle",
    "MeanCuttingLoad",
    "MillingCut",
    "MillingCutter",
    "OrthogonalCuttingData",
    "check_milling_coefficients",
    "compute_chip_thickness",
    "compute_contact_arc",
    "compute_feed_per_tooth",
    "compute_mean_load",
    "compute_mean_load_of_arc",
    "compute_oblique_coefficients",
    "compute_surface_generation_load",
    "compute_waveform",
    "find_peak_force",
    "linearize_kienzle",
]
