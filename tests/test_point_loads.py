"""Loads at toolpath points from process.yaml: holes, passes, directions; compared with the verifier's formulas."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.process_file import load_process
from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.process.binding.operation_matching import attach_process
from machopt.process.binding.point_loads import PointLoads, compute_point_loads
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.process.point_loads import find_operations, recompute_loads

MATERIALS = """machopt_process: 1
materials:
  al:
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, source: paper}
    drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 250, thrust_spread_percent: 60, torque_spread_percent: 25, source: t}
  ti: {drilling: {kc1: 2110, mc: 0.22, chisel_N_mm2: 0,
    thrust_spread_percent: 60, torque_spread_percent: 25, source: t}}
operations:
"""
DRILL = CutterGeometry(0.006, 0.07, teeth=2, point_angle=radians(135), web=0.001)
MILL = CutterGeometry(0.016, 0.03, teeth=3, helix=radians(30))
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"
PECKED = HEADER + "\n".join(
    f"{x},{y},{z},0,0,1,{move},{feed},holes"
    for x, y, z, move, feed in [
        (0, 0, 20, "rapid", ""),
        (0, 0, 5, "rapid", ""),
        (0, 0, -4, "cut", 300),
        (0, 0, 5, "cut", 3000),  # the retract, whatever kind the row states
        (0, 0, -3, "cut", 900),  # down to a depth that is already drilled
        (0, 0, -9, "cut", 300),
        (0, 0, 5, "retract", ""),
        (30, 0, 5, "rapid", ""),
        (30, 0, -9, "cut", 300),
        (30, 0, 5, "retract", ""),
    ]
)


def bind(
    folder: Path, rows: str, operations: str, cutter: CutterGeometry = DRILL
) -> tuple[CuttingProcess, Toolpath, PointLoads]:
    path, file = folder / "path.csv", folder / "process.yaml"
    path.write_text(rows)
    file.write_text(MATERIALS + operations)
    process = load_process(file)
    toolpath = attach_process(process, read_toolpath(path))
    return process, toolpath, compute_point_loads(process, toolpath, cutter, toolpath.feed)


HOLES = "  holes: {kind: drilling, spindle_rpm: 3000, layers: [{material: al, thickness_mm: 20}], depth_mm: 9}\n"


def test_only_moves_that_remove_material_have_a_thrust(tmp_path: Path) -> None:
    _, _, loads = bind(tmp_path, PECKED, HOLES)
    assert [h.deepest for h in loads.holes] == [5, 8]
    assert np.flatnonzero(loads.force[:, 2]).tolist() == [2, 5, 8]
    assert np.isfinite(loads.force).all()
    assert not loads.force[:, :2].any()
    assert loads.force[2, 2] == pytest.approx(loads.force[8, 2], rel=1e-3)  # full diameter in both holes
    assert loads.moment[8] > 0
    assert loads.bite[[2, 5, 8]] == pytest.approx(0.1e-3)


def test_arm_carries_the_clamp_force_while_the_foot_presses(tmp_path: Path) -> None:
    pressed = HOLES.replace("depth_mm: 9", "depth_mm: 9, clamp_N: 5000")
    _, _, loads = bind(tmp_path, PECKED, pressed)
    assert loads.arm_force[8, 2] == 5000.0
    assert loads.force[8, 2] < 1000.0
    weak = HOLES.replace("depth_mm: 9", "depth_mm: 9, clamp_N: 1")
    _, _, loads = bind(tmp_path, PECKED, weak)
    assert loads.arm_force[8, 2] == loads.force[8, 2]
    assert any("foot lifts" in note for note in loads.notes)


def test_peck_in_the_second_layer_has_its_material(tmp_path: Path) -> None:
    stack = HOLES.replace(
        "{material: al, thickness_mm: 20}", "{material: al, thickness_mm: 5}, {material: ti, thickness_mm: 9}"
    )
    _, _, loads = bind(tmp_path, PECKED, stack)
    assert loads.force[5, 2] > 1.5 * loads.force[2, 2]


def test_wear_counts_at_the_middle_of_its_range(tmp_path: Path) -> None:
    _, _, new = bind(tmp_path, PECKED, HOLES)
    _, _, worn = bind(tmp_path, PECKED, HOLES.replace("depth_mm: 9", "depth_mm: 9, wear: [1.0, 2.0]"))
    assert worn.force[8, 2] == pytest.approx(1.5 * new.force[8, 2])


def test_points_without_an_operation_use_the_planning_option(tmp_path: Path) -> None:
    rows = PECKED + "\n60,0,5,0,0,1,rapid,,other\n60,0,-2,0,0,1,cut,300,other\n"
    _, toolpath, loads = bind(tmp_path, rows, HOLES)
    assert toolpath.process_operation is not None
    assert toolpath.process_operation[-1] == -1
    assert np.isnan(loads.force[-1]).all()
    with_default = HOLES + "  default: {kind: force, force_N: {normal: 30}}\n"
    _, _, loads = bind(tmp_path, rows, with_default)
    assert loads.force[-1].tolist() == [0.0, 30.0, 0.0]


@pytest.mark.parametrize(
    ("operations", "words"),
    [
        ("  hole: {kind: force, force_N: {axial: 3}}\n", "did you mean 'holes'"),
        ("  holes: {kind: force, force_N: {axial: 3}, points: [50, 60]}\n", "points"),
        (HOLES.replace(", depth_mm: 9", ""), "depth_mm is missing"),
        (HOLES.replace("spindle_rpm: 3000, ", ""), "spindle_rpm is missing"),
    ],
)
def test_inconsistent_toolpath_is_refused(tmp_path: Path, operations: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        bind(tmp_path, PECKED, operations)
    assert str(caught.value.file).endswith("process.yaml")


def test_drill_requires_its_point_angle(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="point_deg"):
        bind(tmp_path, PECKED, HOLES, CutterGeometry(0.006, 0.07))


ZIGZAG = HEADER + "\n".join(
    f"{x},{y},0,0,0,1,{move},{feed},face"
    for x, y, move, feed in [
        (0, 0, "rapid", ""),
        (100, 0, "cut", 1800),
        (100, 4, "cut", 1800),
        (0, 4, "cut", 1800),
        (0, 8, "cut", 1800),
        (100, 8, "cut", 1800),
    ]
)
FACE = "  face: {kind: milling, material: al, spindle_rpm: 12000, ae_mm: 4, ap_mm: 2, cut: up, wear: [1, 1]}\n"


def test_reversing_passes_alternate_between_up_and_down_milling(tmp_path: Path) -> None:
    _, _, same = bind(tmp_path, ZIGZAG, FACE, MILL)
    assert same.side[1:].tolist() == [1, 1, 1, 1, 1]
    _, _, loads = bind(tmp_path, ZIGZAG, FACE.replace("cut: up", "cut: up, alternate: true"), MILL)
    assert loads.side[[1, 3, 5]].tolist() == [1, -1, 1]
    assert loads.force[1, 1] != pytest.approx(loads.force[3, 1])


def test_reversed_spindle_mirrors_the_cut(tmp_path: Path) -> None:
    flat = replace(MILL, helix=radians(30))
    _, _, cw = bind(tmp_path, ZIGZAG, FACE, flat)
    _, _, ccw = bind(
        tmp_path, ZIGZAG, FACE.replace("cut: up", "cut: up, spindle: ccw"), replace(flat, helix=-radians(30))
    )
    assert ccw.force[1] == pytest.approx(cw.force[1] * [1, -1, 1])
    assert ccw.moment[1] == pytest.approx(-cw.moment[1])


STACK = "{material: al, thickness_mm: 3}, {material: ti, thickness_mm: 4}"
CASES = [
    (PECKED, HOLES, DRILL),
    (PECKED, HOLES.replace("depth_mm: 9", "depth_mm: 6, pilot_mm: 2.5, rake_deg: 10, wear: [1, 1.4]"), DRILL),
    (PECKED, HOLES.replace("depth_mm: 9", "depth_mm: 9, spindle: ccw"), DRILL),
    (PECKED, HOLES.replace("{material: al, thickness_mm: 20}", STACK), DRILL),
    (PECKED, HOLES.replace("kind: drilling", "kind: countersinking, countersink_mm: 9, countersink_deg: 100"), DRILL),
    (PECKED, HOLES.replace("kind: drilling", "kind: reaming, reaming_stock_mm: 0.3"), DRILL),
    (ZIGZAG, FACE, MILL),
    (ZIGZAG, FACE.replace("cut: up", "cut: down, alternate: true, spindle: ccw"), MILL),
    (ZIGZAG, FACE.replace("ae_mm: 4, ap_mm: 2, cut: up", "ap_mm: 1, cut: slot"), MILL),
    (ZIGZAG, FACE, replace(MILL, corner=0.003)),
    (ZIGZAG, FACE.replace("ap_mm: 2", "ap_mm: 10"), replace(MILL, corner=0.008, helix=-radians(20))),
]


@pytest.mark.parametrize("case", range(len(CASES)))
def test_loads_agree_with_the_integration_of_the_verifier(tmp_path: Path, case: int) -> None:
    rows, operations, cutter = CASES[case]
    process, toolpath, loads = bind(tmp_path, rows, operations, cutter)
    cell = _CellWith(process, cutter)
    assert toolpath.process_operation is not None
    operation = find_operations(process, toolpath)
    assert operation.tolist() == toolpath.process_operation.tolist()
    other = recompute_loads(cell, toolpath, toolpath.feed, operation)  # type: ignore[arg-type]
    size = np.abs(loads.force).max()
    assert size > 5.0
    assert np.abs(other.force - loads.force).max() < 2e-3 * size
    assert np.abs(other.moment - loads.moment).max() < 2e-3 * np.abs(loads.moment).max()
    assert other.side.tolist() == loads.side.tolist()


class _CellWith:
    """The parts of a cell from which loads are computed."""

    def __init__(self, process: CuttingProcess, cutter: CutterGeometry) -> None:
        self.process = process
        self.tool = type("Tool", (), {"cutter": cutter})


CYCLES = {
    "h.csv": "x_mm,y_mm,z_mm,i,j,k,kind,depth_mm,approach_mm,feed_mm_min,operation\n"
    "10,0,-9,0,0,1,holes,9,2,300,holes\n",
    "h.mpf": "G17 G90 G71\nG0 X0 Y0 Z20\nF300 S3000 M3\nMCALL CYCLE81(10,1,2,-8)\nX10 Y0\nMCALL\nM30\n",
    "h.h": "0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S3000\n2 L X+0 Y+0 Z+20 R0 FMAX M3\n"
    "3 CYCL DEF 200 DRILLING Q200=2 Q201=-9 Q206=300 Q202=9 Q210=0 Q203=+1 Q204=20 Q211=0\n"
    "4 L X+10 Y+0 R0 FMAX M99\n5 END PGM A MM\n",
    "h.apt": "PARTNO A\nSPINDL/3000,RPM,CLW\nFEDRAT/300,MMPM\nRAPID\nGOTO/0,0,20,0,0,1\n"
    "CYCLE/DRILL,9,MMPM,300,2\nGOTO/10,0,0,0,0,1\nCYCLE/OFF\nEND\nFINI\n",
}


def test_restarted_spindle_has_its_speed(tmp_path: Path) -> None:
    text = CYCLES["h.apt"].replace("RAPID\n", "SPINDL/OFF\nSPINDL/ON\nRAPID\n", 1)
    (tmp_path / "again.apt").write_text(text)
    toolpath = read_toolpath(tmp_path / "again.apt", unit="mm")
    assert [e.value for e in toolpath.events if e.text == "SPINDL/ON"] == [3000.0]
    file = tmp_path / "process.yaml"
    file.write_text(MATERIALS + HOLES.replace("holes:", "default:").replace("spindle_rpm: 3000, ", ""))
    assert "spindle_rpm" not in file.read_text()
    process = load_process(file)
    loads = compute_point_loads(process, attach_process(process, toolpath), DRILL, toolpath.feed)
    assert loads.spindle_speed[loads.holes[0].rows[-1]] == pytest.approx(50.0)


@pytest.mark.parametrize("name", CYCLES)
def test_hole_depth_comes_from_the_cycle_that_states_it(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(CYCLES[name])
    toolpath = read_toolpath(tmp_path / name, unit="mm")
    assert toolpath.hole_depth is not None
    stated = np.flatnonzero(np.isfinite(toolpath.hole_depth))
    assert toolpath.hole_depth[stated] == pytest.approx([0.009])
    assert toolpath.position[stated[0], 2] == toolpath.position[:, 2].min()
    file = tmp_path / "process.yaml"
    file.write_text(MATERIALS + HOLES.replace(", depth_mm: 9", "").replace("holes:", "default:"))
    process = load_process(file)
    bound = attach_process(process, toolpath)
    assert compute_point_loads(process, bound, DRILL, bound.feed).holes[0].depth == pytest.approx(0.009)
