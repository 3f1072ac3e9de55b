"""Stability of milling: modes at the tip, largest stable depth of cut, stability lobes, resonance."""

from machopt.process.stability.depth_limit import (
    DelayLaw,
    DepthLimit,
    compute_depth_limit,
    compute_feedback_coefficients,
    compute_single_mode_limits,
    compute_tooth_period,
)
from machopt.process.stability.directional_matrix import compute_directional_matrix
from machopt.process.stability.resonance import ResonanceMeeting, find_resonances
from machopt.process.stability.stability_lobes import LobeMinimum, compute_stability_lobes, find_lobe_minimum
from machopt.process.stability.structural_modes import (
    StructuralModes,
    build_tool_modes,
    compute_arm_modes,
    merge_modes,
)

__all__ = [
    "DelayLaw",
    "DepthLimit",
    "LobeMinimum",
    "ResonanceMeeting",
    "StructuralModes",
    "build_tool_modes",
    "compute_arm_modes",
    "compute_depth_limit",
    "compute_directional_matrix",
    "compute_feedback_coefficients",
    "compute_single_mode_limits",
    "compute_stability_lobes",
    "compute_tooth_period",
    "find_lobe_minimum",
    "find_resonances",
    "merge_modes",
]
