"""What is written of a cell, and pieces of its YAML. Lengths as the names say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import trimesh

from making.arms import Arm


@dataclass(frozen=True)
class CellFiles:
    folder: str
    title: str
    arm: Arm
    base_mm: tuple[float, float, float]
    home_deg: tuple[float, ...]
    tool: str  # YAML of the tool block without geometry
    tool_mesh: trimesh.Trimesh  # in the flange frame
    workpiece_mm: tuple[float, float, float]
    workpiece_rpy: tuple[float, float, float]
    workpiece_mesh: trimesh.Trimesh  # in the CAM frame
    obstacles: tuple[str, ...]
    stiffness: tuple[str, ...]  # comment lines, then the six values as a YAML list
    controller: str  # YAML of the controller
    extra: dict[str, str] = field(default_factory=dict)
    accuracy: str = ""  # YAML of the arm's accuracy
    spread: str = ""  # YAML lines of stiffness.yaml: how uncertain its springs are
    force: str = ""  # YAML of the process force, in path axes


def block(name: str, size_mm: Sequence[float], centre_mm: Sequence[float]) -> str:
    """A box among the obstacles, in world."""
    return f"{{name: {name}, box_mm: {as_list(size_mm)}, xyz_mm: {as_list(centre_mm)}}}"


def four(name: str, size_mm: Sequence[float], centre_mm: Sequence[float], away_mm: tuple[float, float]) -> list[str]:
    """Four boxes about a centre, at ± ``away_mm`` along x and y."""
    signs = [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    cx, cy, cz = centre_mm
    return [
        block(f"{name}_{i}", size_mm, (cx + sx * away_mm[0], cy + sy * away_mm[1], cz))
        for i, (sx, sy) in enumerate(signs, 1)
    ]


def as_list(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"
