"""Tilted planes, shifted zeros and rotary axes without tool-centre-point control, compared with their geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.file_formats.source_file import parse_offsets
from machopt.path_building.coordinate_systems import SystemTransform, compute_axis_turn
from machopt.path_building.rotary_axes import RotaryMachine, parse_machine
from machopt.toolpath.readers.gcode.geometry.tilted_planes import (
    compute_cycle800_plane,
    compute_g68_2_plane,
    compute_spatial_plane,
)
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "G21 G90 G54\nT1 M6\nG0 X0 Y0 Z100\n"
C30, S30 = np.sqrt(3.0) / 2.0, 0.5


def read(tmp_path: Path, text: str, name: str = "part.nc", **options: object) -> Toolpath:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def mm(toolpath: Toolpath) -> np.ndarray:  # type: ignore[type-arg]
    return np.round(toolpath.position * 1e3, 9)


# ---- angle conventions of the controls


def test_euler_angles_of_g68_2_are_z_x_z() -> None:
    R = compute_g68_2_plane({"I": 90.0, "J": 30.0, "K": 0.0}, (1.0, 2.0, 3.0))
    # after 90° about z, x is along y; then 30° about it tilts z towards +x
    assert np.allclose(R.R[:, 0], [0.0, 1.0, 0.0])
    assert np.allclose(R.z, [S30, 0.0, C30])
    assert R.point((0.0, 0.0, 0.0)) == (1.0, 2.0, 3.0)


def test_roll_pitch_yaw_rotate_about_fixed_axes_in_the_named_order() -> None:
    words = {"P": 1.0, "I": 20.0, "J": 30.0, "K": 40.0}
    Rx, Ry, Rz = compute_axis_turn("X", 20.0), compute_axis_turn("Y", 30.0), compute_axis_turn("Z", 40.0)
    assert np.allclose(compute_g68_2_plane({**words, "Q": 123.0}, (0.0, 0.0, 0.0)).R, Rz @ Ry @ Rx)
    assert np.allclose(compute_g68_2_plane({**words, "Q": 321.0}, (0.0, 0.0, 0.0)).R, Rx @ Ry @ Rz)


def test_spatial_angles_rotate_about_machine_axes_a_b_c() -> None:
    assert np.allclose(
        compute_spatial_plane(20.0, 30.0, 40.0).R,
        compute_axis_turn("Z", 40.0) @ compute_axis_turn("Y", 30.0) @ compute_axis_turn("X", 20.0),
    )


def test_cycle800_reads_the_axes_from_its_mode() -> None:
    def plane(mode: float, *rest: float) -> SystemTransform:
        found = compute_cycle800_plane([1.0, None, 0.0, mode, 1.0, 2.0, 3.0, *rest], 1.0)
        assert found is not None
        return found

    xyz = plane(57.0, 20.0, 30.0, 40.0, 5.0, 0.0, 0.0)
    R = compute_axis_turn("X", 20.0) @ compute_axis_turn("Y", 30.0) @ compute_axis_turn("Z", 40.0)
    assert np.allclose(xyz.R, R)
    assert np.allclose(xyz.t, np.array([1.0, 2.0, 3.0]) + R @ [5.0, 0.0, 0.0])
    assert np.allclose(
        plane(27.0, 20.0, 30.0, 40.0).R,
        compute_axis_turn("Z", 20.0) @ compute_axis_turn("Y", 30.0) @ compute_axis_turn("X", 40.0),
    )
    assert compute_cycle800_plane([], 1.0) is None


# ---- programs


def test_tilted_plane_moves_points_and_tool_axis(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        HEAD + "G68.2 X10 Y0 Z0 I0 J30 K0\nG53.1\nG0 X0 Y0 Z20\nG1 Z-5 F200\nX4\nG2 X8 Y0 I2 J0\nG69\nG0 B0 C0\n"
        "G0 Z100\nG1 X50 Z50 F100\nM30\n",
    )
    tilt = t.axis[:, 1] < -0.1
    assert np.allclose(t.axis[tilt], [0.0, -S30, C30])
    p = mm(t)[tilt]
    assert np.allclose(p[0], [10.0, -20.0 * S30, 20.0 * C30])
    assert np.allclose(p[1], [10.0, 5.0 * S30, -5.0 * C30])
    depth = (p - [10.0, 0.0, 0.0]) @ [0.0, -S30, C30]
    assert np.allclose(depth[1:], -5.0)  # the arc is in the tilted plane
    assert np.allclose(p[-1], [18.0, 5.0 * S30, -5.0 * C30])
    assert mm(t)[-1].tolist() == [50.0, p[-1][1], 50.0]  # Y was not programmed after it
    assert np.allclose(t.axis[-1], [0.0, 0.0, 1.0])
    assert t.operations[0].kind == "trajectory"


def test_cutting_after_a_tilted_plane_requires_named_rotary_axes(tmp_path: Path) -> None:
    text = HEAD + "G68.2 X0 Y0 Z0 I0 J30 K0\nG53.1\nG0 X0 Y0 Z20\nG1 Z0 F200\nG69\nG1 X5\nM30\n"
    with pytest.raises(InputError, match=r"line 9: cuts after a tilted plane was left and before any rotary word"):
        read(tmp_path, text)


def test_drilling_cycle_in_a_tilted_plane_drills_along_the_tool(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        HEAD + "G68.2 X0 Y0 Z0 I0 J90 K0\nG53.1\nG0 X5 Y5 Z20\nG99 G81 X5 Y5 Z-8 R2 F100\nX15\nG80\nG69\nM30\n",
    )
    # Rx(90): the plane's y is z, its z is -y
    assert np.allclose(mm(t)[t.cutting], [[5.0, 8.0, 5.0], [15.0, 8.0, 5.0]])
    assert t.operations[0].kind == "point"


def test_g68_rotates_the_coordinates_and_not_the_tool(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "G68 X10 Y0 R90\nG0 X15 Y0 Z5\nG1 Z0 F100\nX20\nG69\nG1 X20 Y0\nM30\n")
    assert np.allclose(mm(t)[1:], [[10, 5, 5], [10, 5, 0], [10, 10, 0], [20, 0, 0]])
    assert np.allclose(t.axis, [0.0, 0.0, 1.0])


def test_siemens_frames_and_cycle800(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "G71 G90 G17\nT1 M6\nG0 X0 Y0 Z100\nTRANS X10\nAROT Z90\nG1 X5 Y0 F100\nTRANS\nG1 X0 Y0\n"
        'CYCLE800(1,"TC",0,57,0,0,0,0,30,0,0,0,0,1)\nG0 X0 Y0 Z10\nG1 Z0 F100\nMCALL CYCLE81(5,0,2,-6,)\nX5 Y0\nMCALL\n'
        "CYCLE800()\nM30\n",
        "part.mpf",
    )
    assert np.allclose(mm(t)[1], [10.0, 5.0, 100.0])
    assert np.allclose(t.axis[-1], [S30, 0.0, C30])
    hole = np.array([5.0 * C30, 0.0, -5.0 * S30])  # the x axis of the plane is (cos 30, 0, −sin 30)
    bottom = mm(t)[t.cutting][-1]
    assert np.allclose(bottom, hole - 6.0 * np.array([S30, 0.0, C30]))


def test_heidenhain_planes_with_an_inner_datum(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "BEGIN PGM A MM\nTOOL CALL 1 Z S1\nL X+0 Y+0 Z+50 FMAX\nCYCL DEF 7.0 DATUM\nCYCL DEF 7.1 X+100\n"
        "PLANE SPATIAL SPA+0 SPB+90 SPC+0 TURN FMAX\nL X+0 Y+0 Z+20 FMAX\nL Z+1 F100\nCYCL DEF 7.0\nCYCL DEF 7.1 X+3\n"
        "L X+0 Y+0 Z+1\nPLANE RESET STAY\nL B+0 C+0 FMAX\nEND PGM A MM\n",
        "a.h",
    )
    # Ry(90): the plane's x is -z, its z is x; the first datum, at x = 100, is the first system and thus the workpiece
    # frame
    assert np.allclose(mm(t)[1:], [[120, 0, 0], [101, 0, 0], [101, 0, -3]])
    assert np.allclose(t.axis[1:], [1.0, 0.0, 0.0])


def test_cycle_19_and_plane_vector_give_the_same_plane(tmp_path: Path) -> None:
    body = "L X+1 Y+2 Z+30 FMAX\nL Z+0 F100\nL X+7\nEND PGM A MM\n"
    head = "BEGIN PGM A MM\nTOOL CALL 1 Z S1\n"
    by_cycle = read(tmp_path, head + "CYCL DEF 19.0\nCYCL DEF 19.1 A-90\n" + body, "a.h")
    by_vector = read(tmp_path, head + "PLANE VECTOR BX1 BY0 BZ0 NX0 NY1 NZ0 TURN\n" + body, "a.h")
    by_euler = read(tmp_path, head + "PLANE EULER EULPR0 EULNU-90 EULROT0 TURN\n" + body, "a.h")
    assert np.allclose(by_cycle.axis, [0.0, 1.0, 0.0])
    assert np.allclose(by_cycle.position, by_vector.position, atol=1e-12)
    assert np.allclose(by_cycle.position, by_euler.position, atol=1e-12)
    with pytest.raises(InputError, match="PLANE AXIAL"):
        read(tmp_path, head + "PLANE AXIAL A-90 TURN\n" + body, "a.h")


# ---- rotary axes without tool-centre-point control


def test_rotated_table_moves_the_point_back(tmp_path: Path) -> None:
    """A and C bring a hole of the part under the spindle: the machine's X Y Z give the point of the part."""
    rotary = parse_machine("table-ac@0,0,-50")
    angles = {"A": 30.0, "C": 50.0}
    programmed = rotary.tip(angles).inverse().point((12.0, 7.0, 3.0))
    above = (
        rotary.tip(angles)
        .inverse()
        .point(tuple(np.array([12.0, 7.0, 3.0]) + 20.0 * np.array(rotary.tool_axis(angles))))
    )
    x, y, z = programmed
    assert above[2] - z == pytest.approx(20.0)  # along the machine's Z
    text = HEAD + f"G0 A30 C50\nG0 X{x:.9f} Y{y:.9f}\nG1 Z{z:.9f} F100\nG0 Z100\nA0 C0\nM30\n"
    t = read(tmp_path, text, machine="table-ac@0,0,-50")
    assert mm(t)[t.cutting] == pytest.approx(np.array([[12.0, 7.0, 3.0]]), abs=1e-8)
    assert t.axis[t.cutting][0] == pytest.approx(rotary.tool_axis(angles))
    assert t.operations[0].kind == "point"
    with pytest.raises(InputError, match=r"without tool-centre-point control.*table-ac@0,0,-50"):
        read(tmp_path, text, machine="table-ac")


def test_head_tilts_about_its_pivot(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "G0 B90 C0\nG1 X10 Y0 Z0 F100\nM30\n", machine="head-bc@250")
    # vertical tool: tip at (10, 0, 0), pivot 250 above; tool along x: the tip is 250 to the left of the pivot
    assert mm(t)[-1] == pytest.approx([10.0 - 250.0, 0.0, 250.0])
    assert t.axis[-1] == pytest.approx([1.0, 0.0, 0.0])


def test_table_axes_that_do_not_intersect() -> None:
    rotary = parse_machine("table-ac@5,0,0/0,0,-50")
    assert rotary.centres == ((5.0, 0.0, 0.0), (0.0, 0.0, -50.0))
    # C alone rotates about (5, 0), A alone about z = -50
    assert np.allclose(rotary.tip({"C": 90.0}).point((5.0, 3.0, 1.0)), [2.0, 0.0, 1.0])
    assert np.allclose(rotary.tip({"A": 90.0}).point((1.0, 0.0, -40.0)), [1.0, -10.0, -50.0])


def test_tip_path_is_followed_while_rotary_axes_move(tmp_path: Path) -> None:
    """A table that rotates by 90° under a fixed tool gives an arc; every chord end is on it."""
    text = HEAD + "G0 X40 Y0 Z0 C0\nG93 G1 C90 F2\nG94 G0 Z50\nC0\nM30\n"
    t = read(tmp_path, text, machine="table-c@0,0,0")
    arc = mm(t)[t.cutting]
    assert np.allclose(np.linalg.norm(arc[:, :2], axis=1), 40.0)
    assert np.allclose(arc[-1], [0.0, 40.0, 0.0], atol=1e-9)
    chord = np.linalg.norm(np.diff(np.vstack([[40.0, 0.0, 0.0], arc]), axis=0), axis=1).max()
    assert 40.0 - np.sqrt(1600.0 - chord**2 / 4.0) <= 0.005  # mm: the arc tolerance
    assert t.feed[t.cutting] == pytest.approx(2.0 * 40.0 * np.pi / 2.0 / 60e3, rel=1e-3)  # chords instead of the arc


@settings(max_examples=scale_example_count(60), deadline=None)
@given(
    a=st.floats(-120.0, 120.0),
    c=st.floats(-400.0, 400.0),
    p=st.tuples(*[st.floats(-300.0, 300.0)] * 3),
    name=st.sampled_from(["table-ac@3,4,-5", "mixed-ac@200/3,4,-5"]),
)
def test_tool_axis_and_tip_are_consistent(a: float, c: float, p: tuple[float, float, float], name: str) -> None:
    """Raising the machine's Z moves the tip along the tool axis of a table;
    heads and mixed machines preserve lengths."""
    rotary = parse_machine(name)
    angles = {"A": a, "C": c}
    tip = rotary.tip(angles)
    here, there = np.array(tip.point(p)), np.array(tip.point((p[0], p[1], p[2] + 10.0)))
    assert np.linalg.norm(there - here) == pytest.approx(10.0)
    if rotary.kind == "table":
        assert (there - here) / 10.0 == pytest.approx(rotary.tool_axis(angles))
    assert np.allclose(tip.inverse().point(tuple(here)), p, atol=1e-9)


def test_machines_by_explicit_axes() -> None:
    haas = parse_machine("table:B+Z,A-X@0,0,0")
    assert haas.letters == "BA"
    assert haas.tool_axis({"A": -37.576, "B": -45.0}) == pytest.approx(
        (-0.43122, -0.43122, 0.79254), abs=3e-5
    )  # printed with three decimals of a degree
    assert RotaryMachine("table:c+z,a+x").tool_axis({"A": 30.0, "C": 50.0}) == pytest.approx(
        RotaryMachine("table-ac").tool_axis({"A": 30.0, "C": 50.0})
    )
    for wrong in ("table:A+X,A-Z", "table:Q+X", "table-ac@1,2", "head-bc@1,2,3", "mixed-bc@250", "table-ac@1,2,nan"):
        with pytest.raises(InputError, match="machine"):
            parse_machine(wrong)


# ---- zeros


def test_second_work_offset_requires_its_place(tmp_path: Path) -> None:
    text = HEAD + "G1 Z0 F100\nG0 Z50\nG55\nG0 X1 Y1 Z50\nG1 Z0\nM30\n"
    with pytest.raises(InputError, match=r"line 8: the work offset changes from G54 to G55.*--offset G55=X,Y,Z"):
        read(tmp_path, text)
    t = read(tmp_path, text, offsets=("G55=100,20,-3",))
    assert mm(t)[-1].tolist() == [101.0, 21.0, -3.0]
    assert t.meta["work_offset"] == "G54"
    assert parse_offsets(["g54.1 p2 = 1,2,3"]) == (("G54.1P2", (1.0, 2.0, 3.0)),)
    with pytest.raises(InputError, match="--offset"):
        read(tmp_path, text, offsets=("G55",))


def test_unused_offset_word_at_the_end_has_no_effect(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "G1 Z0 F100\nG55\nG0 Z500\nM30\n")
    assert len(t) == 2  # the position of the rapid move in another system is unknown


def test_g52_and_g92_shift_later_points(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "G1 Z0 F100\nG52 X10 Y0 Z0\nG1 X0 Y5\nG52 X0 Y0 Z0\nG1 X0 Y0\nM30\n")
    assert mm(t)[1:].tolist() == [[0, 0, 0], [10, 5, 0], [0, 0, 0]]
    u = read(tmp_path, HEAD + "G1 Z0 F100\nX20\nG92 X0\nG1 X5\nM30\n")
    assert mm(u)[-1].tolist() == [25.0, 0.0, 0.0]
    assert any("G92" in w for w in u.warnings)
    first = read(tmp_path, "G21 G90\nG92 X100 Y100\nG0 X0 Y0 Z9\nG1 Z0 F100\nM30\n")
    assert mm(first)[0].tolist() == [0.0, 0.0, 9.0]  # the system at the start of the path is the workpiece frame


def test_fast_and_slow_line_readers_agree(tmp_path: Path) -> None:
    rows = [f"X{x * 0.5:.3f} Y{x * x * 0.01:.4f} Z-1.5 A{x % 7} C{x * 3}" for x in range(50)]
    head = "G21 G90\nG43.4 H1\nG0 X0 Y0 Z9 A0 C0\nG1 Z0 F500\n"
    plain = read(tmp_path, head + "\n".join(rows) + "\nM30\n", machine="table-ac")
    slow = read(tmp_path, head + "\n".join(f"{r} (c)" for r in rows) + "\nM30\n", machine="table-ac")
    assert np.array_equal(plain.position, slow.position)
    assert np.allclose(plain.axis, slow.axis, atol=1e-15)
    assert np.array_equal(plain.feed, slow.feed, equal_nan=True)
    assert np.array_equal(plain.line, slow.line)
    # lines with large rotations are divided into several points
    assert len(set(plain.line[plain.move == MoveKind.CUT].tolist())) == 51


def test_dynamic_work_offset_rotates_about_the_program_zero(tmp_path: Path) -> None:
    text = HEAD + "G0 A30 C0\nG254\nG0 X0 Y0 Z10\nG1 Z0 F100\nY8\nG255\nG0 Z100\nA0\nM30\n"
    t = read(tmp_path, text, machine="table-ac")  # the position of the rotary axes has no effect under G254
    cuts = mm(t)[t.cutting]
    assert np.allclose(cuts, [[0, 0, 0], [0, 8.0 * C30, 8.0 * S30]])
    assert np.allclose(t.axis[t.cutting], [0.0, -S30, C30])


@pytest.mark.parametrize(
    ("head", "row", "name"),
    [
        ("G21 G90\nG43.5 H1\nG0 X0 Y0 Z9\nG1 Z0 F500\n", "X{x} Y{y} I{i} J{j} K{k}", "a.nc"),
        ("G71 G90\nTRAORI\nG0 X0 Y0 Z9\nG1 Z0 F500\n", "X{x} Y{y} A3={i} B3={j} C3={k}", "a.mpf"),
        ("BEGIN PGM A MM\nM128\nL X0 Y0 Z9 FMAX\nL Z0 F500\n", "LN X{x} Y{y} NX0 NY0 NZ1 TX{i} TY{j} TZ{k}", "a.h"),
    ],
)
def test_tool_vectors_agree_in_fast_and_slow_readers(tmp_path: Path, head: str, row: str, name: str) -> None:
    angle = np.arange(40) * 0.1
    rows = [
        row.format(x=f"{10 * a:.3f}", y=f"{a * a:.3f}", i=f"{np.sin(a):.5f}", j="0.25", k=f"{np.cos(a):.5f}")
        for a in angle.tolist()
    ]
    tail = "\nEND PGM A MM\n" if name == "a.h" else "\nM30\n"
    plain = read(tmp_path, head + "\n".join(rows) + tail, name)
    slow = read(tmp_path, head + "\n".join(f"{r} ;c" for r in rows) + tail, name)
    assert len(plain) == 42
    assert np.array_equal(plain.position, slow.position)
    assert np.allclose(plain.axis, slow.axis, atol=1e-15)
    expected = np.column_stack([np.sin(angle), np.full(40, 0.25), np.cos(angle)]) / np.sqrt(1.0625)
    assert np.allclose(plain.axis[2:], expected, atol=1e-5)  # five printed decimals


def test_planes_left_with_the_axes_at_zero(tmp_path: Path) -> None:
    body = "L X+0 Y+0 Z+20 FMAX\nL Z+0 F100\n"
    head = "BEGIN PGM A MM\nTOOL CALL 1 Z S1\nPLANE SPATIAL SPA+30 SPB+0 SPC+0 TURN\n"
    t = read(tmp_path, head + body + "PLANE RESET TURN FMAX\nL X+1 Y+1 Z+5 F100\nEND PGM A MM\n", "a.h")
    assert mm(t)[-1].tolist() == [1.0, 1.0, 5.0]
    assert t.axis[-1].tolist() == [0.0, 0.0, 1.0]
    with pytest.raises(InputError, match="the positions of the rotary axes are not known"):
        read(tmp_path, head + body + "PLANE RESET STAY\nL X+1 Y+1 Z+5 F100\nEND PGM A MM\n", "a.h")
    siemens = (
        "G71 G90 G17\nT1 M6\nG0 X0 Y0 Z100\n"
        'CYCLE800(1,"TC",0,57,0,0,0,0,30,0,0,0,0,1)\nG0 X0 Y0 Z9\nG1 Z0 F9\n{}\nG1 X5 Y5 Z5\nM30\n'
    )
    u = read(tmp_path, siemens.format('CYCLE800(1,"TC",0,57,0,0,0,0,0,0,0,0,0,1)'), "a.mpf")
    assert mm(u)[-1].tolist() == [5.0, 5.0, 5.0]
    with pytest.raises(InputError, match="the positions of the rotary axes are not known"):
        read(tmp_path, siemens.format("CYCLE800()"), "a.mpf")


def test_offset_stated_by_g53(tmp_path: Path) -> None:
    text = "G21 G90\nG0 G53 X1 Y2 Z9\nG1 Z0 F100\nM30\n"
    with pytest.raises(InputError, match=r"line 3: cuts while X is not known.*--offset G53=0,0,0"):
        read(tmp_path, text)
    assert mm(read(tmp_path, text, offsets=("G53=0,0,0",))).tolist() == [[1, 2, 9], [1, 2, 0]]
