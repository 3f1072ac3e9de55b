"""Thrust and torque of drills, countersinks and reamers, and the part of them that the arm carries."""

from machopt.process.drilling.breakthrough_velocity import (
    compute_axial_compliance,
    compute_axial_mass,
    compute_breakthrough_velocity,
)
from machopt.process.drilling.drilling_tools import DrillingTool, MaterialLayer, build_countersink, build_reamer
from machopt.process.drilling.feed_inversion import find_largest_feed
from machopt.process.drilling.pressure_foot import FootLoad, compute_foot_load, compute_skid_margin
from machopt.process.drilling.stroke_phases import (
    DrillingStroke,
    build_drilling_stroke,
    compute_load_at_depth,
    compute_stroke_maximum,
    get_stroke_phase,
)
from machopt.process.drilling.thrust_and_torque import (
    DrillingLoad,
    compute_feed_per_revolution,
    compute_full_load,
    compute_vendor_load,
)

__all__ = [
    "DrillingLoad",
    "DrillingStroke",
    "DrillingTool",
    "FootLoad",
    "MaterialLayer",
    "build_countersink",
    "build_drilling_stroke",
    "build_reamer",
    "compute_axial_compliance",
    "compute_axial_mass",
    "compute_breakthrough_velocity",
    "compute_feed_per_revolution",
    "compute_foot_load",
    "compute_full_load",
    "compute_load_at_depth",
    "compute_skid_margin",
    "compute_stroke_maximum",
    "compute_vendor_load",
    "find_largest_feed",
    "get_stroke_phase",
]
