"""Validated options of ``machopt init``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

UNITS = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}
"""m per unit of a mesh file."""


@dataclass(frozen=True, kw_only=True)
class InitRequest:
    """The options of ``machopt init``; mm, degrees, kg, N·m/rad."""

    robot: Path
    out: Path
    name: str | None = None  # of the cell; the robot's file name
    packages: Mapping[str, Path] = field(default_factory=dict)  # folders of ROS packages, by name
    xacro_args: Mapping[str, str] = field(default_factory=dict)  # values of a xacro file's arguments, by name
    allow_external: bool = False  # a xacro file may read files outside of its package and those it names
    base_link: str | None = None
    flange_link: str | None = None
    tool_length_mm: float | None = None  # from the flange to the TCP, out of the flange; a tenth of the arm's length
    tcp_mm: tuple[float, ...] | None = None  # in flange_link; out of the flange by tool_length_mm
    tcp_rpy_deg: tuple[float, ...] | None = None  # z out of the flange
    tool_mass_kg: float = 0.0
    tool_angle_deg: float | None = None  # between spindle and flange axis: 0, 45 or 90; 45 without any tool option
    tool_mesh: Path | None = None
    mesh_unit: str | None = None  # of tool and workpiece meshes: m, mm, inch; by their size
    cutter_diameter_mm: float = 10.0
    cutter_length_mm: float = 40.0
    workpiece_mm: tuple[float, ...] | None = None  # CAM frame in world; where the arm reaches well
    workpiece_rpy_deg: tuple[float, ...] | None = None  # turned about the vertical where only that brings it in reach
    workpiece_mesh: Path | None = None
    toolpath: Path | None = None  # that must be reached
    reading: Mapping[str, Any] = field(default_factory=dict)  # keywords of toolpath.toolpath_reader.read_toolpath
    stiffness: Path | None = None  # a stiffness.yaml; an estimate
    velocity_deg_s: tuple[float, ...] | None = None  # the URDF's
    post: str = ""
    for_diagnosis: bool = False  # more than six joints are accepted; the cell can be measured, not planned for
