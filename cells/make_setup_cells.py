"""Writes the example cell with three tools and two setups: a KR240 milling and drilling plates on two fixtures.

Run ``python cells/make_setup_cells.py``. Arm, spindle and stiffness are those of ``make_cells.py``; here are the tool
table, the work offsets and what stands there. Lengths in mm.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from making.cellfiles import block
from making.kr240 import kr240_drilling
from making.shapes import box
from making.written import write_cell

HERE = Path(__file__).resolve().parent

FOLDER = "kr240_setups"
NOSE = 360.0  # of the spindle, in the flange
BESIDE = 180.0  # the spindle's axis from that of axis 6
PLATE = (240.0, 160.0, 40.0)  # both parts; the top's middle is their zero
TABLE = 850.0  # height of the frame of the CAM coordinates


@dataclass(frozen=True)
class Cutter:
    """One tool of the table, all of it in front of the spindle's nose."""

    number: int
    what: str
    holder: tuple[float, float]  # radius, length
    diameter: float
    length: float  # free of the holder
    mass: float  # kg, of holder and cutter
    edges: str  # YAML keys of the cutter that forces need

    def lines(self) -> str:
        radius, long = self.holder
        tip = NOSE + long + self.length
        holder = f"cylinder_mm: [{radius:g}, {long:g}], xyz_mm: [{BESIDE:g}, 0, {NOSE + long / 2:g}]"
        return f"""\
  "{self.number}":   # {self.what}
    tcp: {{xyz_mm: [{BESIDE:g}, 0, {tip:g}], rpy_deg: [0, 0, 0]}}
    mass_kg: {47.0 + self.mass:g}
    com_mm: [110, 0, 165]
    geometry:
      - {{name: spindle, mesh: meshes/tool.stl}}
      - {{name: holder_{self.number}, {holder}}}
    cutter: {{diameter_mm: {self.diameter:g}, length_mm: {self.length:g}, {self.edges}}}
    tool_number: {self.number}
"""


TOOLS = (
    Cutter(1, "face mill, 50 mm", (31.5, 42.0), 50.0, 40.0, 1.9, "teeth: 5, helix_deg: 10"),
    Cutter(2, "end mill, 16 mm", (21.0, 80.0), 16.0, 44.0, 1.5, "teeth: 3, helix_deg: 30"),
    Cutter(3, "drill, 8.5 mm", (16.0, 75.0), 8.5, 75.0, 1.3, "teeth: 2, point_deg: 135, web_mm: 1.3"),
)
PROCESS = """\
machopt_process: 1
quantile: 0.95
materials:
  al7075:
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, h_mm: [0.02, 0.12],
      source: "Chin. J. Mech. Eng. 34 (2021), 10.1186/s10033-021-00536-9, table 5, 7075-T6"}
    drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300, thrust_spread_percent: 30, torque_spread_percent: 25,
      source: "VDI 3323 group 22; chisel edge and spread assumed"}
operations:   # by the labels that machopt inspect lists
  T1: {kind: milling, material: al7075, ae_mm: 40, ap_mm: 0.5, cut: up, alternate: true, surface: floor,
    tolerance: {surface_mm: 0.3, reference: relative}}
  T2: {kind: milling, material: al7075, ap_mm: 2, cut: slot, surface: side,
    tolerance: {surface_mm: 0.3, reference: relative}}
  T3: {kind: drilling, layers: [{material: al7075, thickness_mm: 40}], depth_mm: 20,
    tolerance: {position_mm: 0.3, axis_deg: 0.5, reference: relative}}
"""
OFFSETS = """\
offsets:
  G54:   # a plate lying in a vice
    pose: {xyz_mm: [0, -260, 0], rpy_deg: [0, 0, 0]}
    geometry: [{name: plate_lying, box_mm: [240, 160, 40], xyz_mm: [0, 0, -20]}]
    fixtures:
      - {name: jaw_fixed, box_mm: [180, 40, 60], xyz_mm: [0, 100.5, -40]}
      - {name: jaw_moved, box_mm: [180, 40, 60], xyz_mm: [0, -100.5, -40]}
      - {name: vice, box_mm: [200, 300, 70], xyz_mm: [0, 0, -105.5]}
  G55:   # the same plate upright on an angle plate, its face towards the robot
    pose: {xyz_mm: [-20, 260, 60], rpy_deg: [0, -90, 0]}
    geometry: [{name: plate_upright, box_mm: [240, 160, 40], xyz_mm: [0, 0, -20]}]
    fixtures:
      - {name: angle_plate, box_mm: [300, 200, 40], xyz_mm: [-50, 0, -60.5]}
      - {name: angle_foot, box_mm: [30, 200, 200], xyz_mm: [-185, 0, -181]}
"""

LINES = """\
  lines:   # an assumption: what the integrator of the cell calls them; README.md
    tool: "CHANGE_TOOL(@{value})"
    spindle_on: "SPINDLE_ON(@{value})"
    spindle_off: "SPINDLE_OFF()"
    coolant_on: "$OUT[1]=TRUE"
    coolant_off: "$OUT[1]=FALSE"
"""


def write(cells: Path) -> None:
    """The cell of ``make_cells.py``, then its tools and setups, into its folder among ``cells``."""
    x = 1700.0
    write_cell(
        replace(
            kr240_drilling(),
            folder=FOLDER,
            title="KR240 with three tools and two setups",
            workpiece_mm=(x, 0, TABLE),
            workpiece_mesh=box((-0.001, -0.001, -0.001), (0.001, 0.001, 0.001)),  # not used: parts lie in their offsets
            obstacles=(
                block("pedestal", (900, 900, 194), (0, 0, 97)),
                block("table", (800, 1200, 60), (x, 0, TABLE - 171)),
                block("stand", (600, 900, TABLE - 201), (x, 0, (TABLE - 201) / 2)),
            ),
            extra={},
        ),
        cells,
    )
    folder = cells / FOLDER
    (folder / "meshes" / "workpiece.stl").unlink()
    for name in ("robot.urdf", "cell.yaml"):
        text = (folder / name).read_text(encoding="utf-8")
        text = text.replace("made by cells/make_cells.py", "made by cells/make_setup_cells.py")
        (folder / name).write_text(text, encoding="utf-8")
    head, _, rest = text.partition("tool:\n")
    _, _, rest = rest.partition("workpiece:\n")
    rest = rest.replace("  geometry: [{name: workpiece, mesh: meshes/workpiece.stl}]\n", OFFSETS)
    rest = rest.replace("force_N: {axial: 250}", "force_N: {travel: 60, normal: 40, axial: 100}")
    rest = rest.replace("tool and base stand in the program itself: no numbers", "numbers of the tools: tools")
    rest = rest.replace("plan:\n", f"{LINES}plan:\n")
    head = head.replace("  limits:\n", "  tool_change_deg: [-60, -100, 110, 0, 80, 0]\n  limits:\n")
    text = f"{head}tools:\n{''.join(t.lines() for t in TOOLS)}workpiece:\n{rest}"
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    (folder / "process.yaml").write_text(PROCESS, encoding="utf-8")


if __name__ == "__main__":
    write(HERE)
    print(HERE / FOLDER)
