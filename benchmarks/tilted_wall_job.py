"""A conical wall whose finish cut turns the tool axis: cell, stock, finished part and toolpath.

The wall is a cone that gets narrower upwards. The stock has an even allowance on it. A flat end mill cuts with its
side, its axis parallel to the generator of the cone, along an arc. The finished wall is the exact cone, so that the
width of the cut, its angles and the removed volume are known.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

ROOT = Path(__file__).resolve().parents[1]
KR500 = ROOT / "cells" / "kr500_milling"
SECTIONS = 720  # of a solid of revolution
PROCESS = """machopt_process: 1
materials:
  al7075:
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, h_mm: [0.02, 0.12],
      source: "10.1186/s10033-021-00536-9 table 5, 7075-T6"}
operations:
  finish wall: {kind: milling, material: al7075, spindle_rpm: 12000, engagement: stock, cut: down, surface: side,
    tolerance: {surface_mm: 0.15, reference: relative}}
stock: {mesh: meshes/stock.stl, cell_mm: CELL}
modes: {damping_percent: 3, source: assumed}
"""


@dataclass(frozen=True, kw_only=True)
class TiltedWall:
    """Sizes of the job, m and rad."""

    foot: float = 0.060  # radius of the finished cone at z = 0
    height: float = 0.020
    lean: float = float(np.radians(15.0))  # of the wall and of the tool axis from the vertical
    allowance: float = 0.8e-3  # along the normal of the wall
    radius: float = 8.5e-3  # of the cutter
    corner: float = 0.0  # of the cutter
    below: float = 3e-3  # of the tip below the foot, along the axis
    sector: float = float(np.radians(60.0))
    points: int = 121

    def build_solid(self, allowance: float) -> trimesh.Trimesh:
        """Return the cone on its pedestal.

        Args:
            allowance: m, material on the wall.
        """
        more = allowance / np.cos(self.lean)
        top = self.foot - self.height * np.tan(self.lean)
        profile = [
            *((0, -0.02), (self.foot - 0.015, -0.02), (self.foot - 0.015, 0), (self.foot + more, 0)),
            *((top + more, self.height), (0, self.height)),
        ]
        return trimesh.creation.revolve(np.array(profile), sections=SECTIONS)

    def build_path(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (N, 3) m tips, (N, 3) axes and (N, 3) normals of the finish pass, clockwise seen from above."""
        angle = np.linspace(0.5, -0.5, self.points) * self.sector
        s, c = np.sin(self.lean), np.cos(self.lean)
        out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        up = np.array([0.0, 0.0, 1.0])
        axis, normal = c * up - s * out, c * out + s * up
        return self.foot * out + self.radius * normal - self.below * axis, axis, normal

    def find_removed_volume(self) -> float:
        """Return m³ that the steady part of the pass removes: the allowance over the sector, without entry and exit."""
        more = self.allowance / np.cos(self.lean)
        mean = self.foot - 0.5 * self.height * np.tan(self.lean) + 0.5 * more
        return float(self.sector * mean * more * self.height)

    def find_contact(self) -> dict[str, tuple[float, float]]:
        """Return the range of the exact width in mm and of both angles in degrees, over the height of the wall.

        Across its generator the cone has the radius of curvature r / cos(lean). The allowance is a larger circle about
        the same centre, and the cutter touches the smaller one.
        """
        out: dict[str, list[float]] = {"ae_mm": [], "phi_in_deg": [], "phi_out_deg": [180.0, 180.0]}
        for r in (self.foot, self.foot - self.height * np.tan(self.lean)):
            bend = r / np.cos(self.lean)
            d = bend + self.radius
            cosine = (d**2 + self.radius**2 - (bend + self.allowance) ** 2) / (2.0 * d * self.radius)
            out["ae_mm"].append(1e3 * self.radius * (1.0 - cosine))
            out["phi_in_deg"].append(180.0 - float(np.degrees(np.arccos(cosine))))
        return {name: (float(min(values)), float(max(values))) for name, values in out.items()}

    def write_toolpath(self, file: Path, feed: float = 1500.0) -> None:
        """Write the pass with a rapid move before and after it.

        Args:
            file: The table.
            feed: mm/min.
        """
        tips, axes, normals = self.build_path()
        lines = ["x_mm,y_mm,z_mm,i,j,k,nx,ny,nz,move,feed_mm_min,operation"]
        rows = [(tips[0] + 0.06 * axes[0] + 0.03 * normals[0], 0, "rapid"), (tips[0] + 0.005 * normals[0], 0, "rapid")]
        rows += [(tip, n, "cut") for n, tip in enumerate(tips)]
        last = len(tips) - 1
        rows += [(tips[last] + 0.005 * normals[last], last, "cut"), (tips[last] + 0.06 * axes[last], last, "rapid")]
        for tip, n, move in rows:
            numbers = [*(1e3 * tip).tolist(), *axes[n].tolist(), *normals[n].tolist()]
            lines.append(",".join(f"{v:.9f}" for v in numbers) + f",{move},{feed if move == 'cut' else ''},finish wall")
        file.write_text("\n".join(lines) + "\n")

    def write_cell(self, folder: Path, cell_mm: float = 0.25) -> None:
        """Write the shipped milling cell with the stock and the finished part.

        Args:
            folder: The new cell.
            cell_mm: Cell size of the stock.
        """
        shutil.copytree(KR500, folder)
        self.build_solid(self.allowance).export(folder / "meshes" / "stock.stl")
        self.build_solid(0.0).export(folder / "meshes" / "finished.stl")
        text = (folder / "cell.yaml").read_text(encoding="utf-8").replace("meshes/workpiece.stl", "meshes/finished.stl")
        text = text.replace(
            "diameter_mm: 17", f"diameter_mm: {2e3 * self.radius:g}, corner_radius_mm: {1e3 * self.corner:g}"
        )
        lines = [line for line in text.splitlines() if not line.startswith("process:")]
        (folder / "cell.yaml").write_text("\n".join([*lines, "process: process.yaml"]) + "\n", encoding="utf-8")
        (folder / "process.yaml").write_text(PROCESS.replace("CELL", f"{cell_mm:g}"))
