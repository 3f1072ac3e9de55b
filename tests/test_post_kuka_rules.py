"""KUKA rules: S and T, angles, names, program header, custom words at events."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from sample_robot_programs import ARM, PLAIN, Recipe, program

from machopt.data_types.robot_program import LIN, ExternalProgramAxis, RobotController, RobotProgram
from machopt.errors import InputError
from machopt.kinematics.controller_posture import compute_controller_posture, compute_posture_sides
from machopt.kinematics.robot import Robot
from machopt.programs.kuka.post_rules import compute_status_bits, compute_turn_bits
from machopt.programs.program_reader import read_program
from machopt.programs.program_writer import format_program_name, write_program
from machopt.programs.reading.rotation_conventions import (
    compute_fixed_xyz_rotation,
    compute_moving_xyz_rotation,
    convert_quaternion,
    convert_rotation_vector,
)
from machopt.programs.writing.orientation_angles import (
    convert_to_abc_deg,
    convert_to_positive_quaternion,
    convert_to_ur_rotation_vector,
    convert_to_xyz_deg,
)

X = np.array([1.0, 0.0, 0.0])
KR = replace(ARM, point=np.array([[0, 0, 0.675], [0.35, 0, 0.675], [1.6, 0, 0.675], *[[2.7, 0, 0.62]] * 3]))
"""The dimensions of KUKA's drawing: 0.35 m to axis 2, upper arm 1.25 m, forearm 1.1 m, axis 4 0.055 m below axis 3."""


def rz_ry_rx(a: float, b: float, c: float) -> np.ndarray:
    """Compute KUKA's angles by definition, from three elementary rotations."""
    a, b, c = np.radians([a, b, c])
    rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return rz @ ry @ rx


def status(robot: Robot, axes_deg: np.ndarray) -> int:
    standing = compute_posture_sides(robot, np.radians(axes_deg), X)
    assert standing is not None
    return int(compute_status_bits(axes_deg, *standing))


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ((0, -90, 90, 0, 30, 0), 0b010),  # the pose of the data sheet: wrist in front, elbow up
        ((0, -90, 90, 0, -30, 0), 0b110),
        ((0, -120, -60, 0, 30, 0), 0b001),  # folded back over the shoulder, elbow down: x = 0.35 − 0.63 − 1.1
        ((0, -20, -10, 0, 30, 0), 0b000),  # almost stretched, elbow below the line
        ((0, -170, 10, 0, 30, 0), 0b011),  # arm leaning backwards
        ((170, -90, 90, 0, 30, 0), 0b010),  # joint 1 rotated: the same configuration
    ],
)
def test_status_of_known_configurations(axes: tuple[float, ...], expected: int) -> None:
    assert status(KR, np.array(axes, float)) == expected


def test_elbow_bit_changes_where_the_arm_is_stretched() -> None:
    """The distance from axis 2 to the wrist centre is largest exactly where bit 1 changes."""
    a3 = np.linspace(-30, 30, 60_001)
    x = 1.25 + 1.1 * np.cos(np.radians(a3)) - 0.055 * np.sin(np.radians(a3))
    z = -1.1 * np.sin(np.radians(a3)) - 0.055 * np.cos(np.radians(a3))
    longest = a3[np.argmax(np.hypot(x, z))]
    axes = np.zeros((len(a3), 6))
    axes[:, 2], axes[:, 4] = a3, 10
    standing = compute_posture_sides(KR, np.radians(axes), X)
    assert standing is not None
    assert a3[np.argmax(standing[1])] == pytest.approx(longest, abs=0.0011)  # step of the grid


def test_base_orientation_at_zero_does_not_change_the_status() -> None:
    turned = np.array([0.0, 1.0, 0.0])
    q = np.radians([[-90, -90, 90, 0, 30, 0], [90, -90, 90, 0, 30, 0]])  # axis 1 points down: −90° rotates to +y
    standing = compute_posture_sides(KR, q, turned, q1_zero=np.radians(-90.0))
    assert standing is not None
    assert standing[0].tolist() == [False, False]
    assert standing[1].tolist() == [True, True]


def test_status_of_many_rows_equals_that_of_single_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    q = np.random.default_rng(5).uniform(-2.0, 2.0, (23, 6))
    whole = compute_posture_sides(KR, q, X)
    monkeypatch.setattr("machopt.kinematics.controller_posture.BLOCK_ROWS", 5)
    for rows in (q, q[:0]):
        by_parts = compute_controller_posture(KR, rows, RobotController())
        assert whole is not None
        assert by_parts is not None
        for one, other in zip(by_parts, whole, strict=True):
            assert 0 < other.sum() < len(q)
            assert (one == other[: len(rows)]).all()


def test_arm_without_wrist_centre_has_no_status() -> None:
    bent = replace(ARM, point=ARM.point + np.array([[0, 0, 0]] * 5 + [[0, 0.1, 0.05]]))
    assert compute_posture_sides(bent, np.zeros((1, 6)), X) is None


def test_turn_bits_agree_with_points_recorded_on_robots() -> None:
    assert compute_turn_bits(np.array([-5.0, -60, 90, 10, 40, -3])) == 35  # S 2,T 35
    assert compute_turn_bits(np.array([5.0, -60, 90, 10, -40, -3])) == 50  # S 6,T 50


def test_bits_agree_with_the_printed_number() -> None:
    assert compute_turn_bits(np.array([-4e-6, -6e-6, 0, 0, 0, 0])) == 0b10  # printed as −0.00000 and −0.00001


def test_unknown_status_is_left_out(tmp_path: Path) -> None:
    p = program(Recipe(2))
    write_program(tmp_path, "known", p, "krl", PLAIN)
    write_program(tmp_path, "unknown", replace(p, wrist_behind=None, elbow_up=None), "krl", PLAIN)
    lin = np.flatnonzero(p.kind == LIN)
    assert all(set(read_program(tmp_path / "known.src").configuration[k]) == {"S", "T"} for k in lin)
    assert all(set(read_program(tmp_path / "unknown.src").configuration[k]) == {"T"} for k in lin)
    assert "S is left out" in (tmp_path / "unknown.src").read_text()
    with pytest.raises(InputError, match="there is no S; the post krl works without"):
        write_program(tmp_path, "cartesian", replace(p, wrist_behind=None, elbow_up=None), "krl_pos", PLAIN)


@settings(max_examples=scale_example_count(100), deadline=None)
@given(*[st.floats(-180, 180)] * 3)
def test_every_angle_notation_converts_back_to_the_rotation(a: float, b: float, c: float) -> None:
    R = rz_ry_rx(a, b, c)
    A, B, C = convert_to_abc_deg(R)
    np.testing.assert_allclose(rz_ry_rx(A, B, C), R, atol=1e-9)
    np.testing.assert_allclose(np.reshape(compute_fixed_xyz_rotation(C, B, A), (3, 3)), R, atol=1e-9)
    np.testing.assert_allclose(np.reshape(compute_moving_xyz_rotation(*convert_to_xyz_deg(R)), (3, 3)), R, atol=1e-9)
    q = convert_to_positive_quaternion(R)
    assert q[0] >= 0
    np.testing.assert_allclose(np.reshape(convert_quaternion(*q) or (), (3, 3)), R, atol=1e-12)
    np.testing.assert_allclose(
        np.reshape(convert_rotation_vector(*convert_to_ur_rotation_vector(R)), (3, 3)), R, atol=1e-9
    )


@pytest.mark.parametrize("b", [90.0, -90.0, 89.9999999])
def test_angle_notations_at_their_singularities(b: float) -> None:
    """If the middle angle is 90°, a cosine below 1e-9 is treated as 0."""
    R = rz_ry_rx(20.0, b, -50.0)
    np.testing.assert_allclose(rz_ry_rx(*convert_to_abc_deg(R)), R, atol=5e-9)
    turned = np.reshape(compute_moving_xyz_rotation(20.0, b, -50.0), (3, 3))
    np.testing.assert_allclose(
        np.reshape(compute_moving_xyz_rotation(*convert_to_xyz_deg(turned)), (3, 3)), turned, atol=5e-9
    )


@pytest.mark.parametrize("axis", [X, np.array([0.0, -0.6, 0.8])])
def test_half_turns_are_converted(axis: np.ndarray) -> None:
    R = 2 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(
        np.reshape(convert_quaternion(*convert_to_positive_quaternion(R)) or (), (3, 3)), R, atol=1e-12
    )
    np.testing.assert_allclose(
        np.reshape(convert_rotation_vector(*convert_to_ur_rotation_vector(R)), (3, 3)), R, atol=1e-12
    )


@pytest.mark.parametrize(
    ("post", "text", "name"),
    [
        ("krl", "2nd op-A", "p2nd_op_A"),
        ("krl", "part", "part"),
        ("krl", "ü", "u_6074"),
        ("krl", "x" * 40, "x" * 19 + "_bd91"),
        ("fanuc", "2nd op-A", "P2ND_OP_A"),
        ("val3", "x" * 40, "x" * 10 + "_bd91"),
        ("rapid", "Main", "pMain"),
    ],
)
def test_names_are_valid(post: str, text: str, name: str) -> None:
    assert format_program_name(text, post) == name


def test_unrepresentable_program_is_refused(tmp_path: Path) -> None:
    p = program(Recipe(1, moves=3))
    with pytest.raises(InputError, match="no program name"):
        write_program(tmp_path, "1part", p, "krl")
    with pytest.raises(ValueError, match="begins with a PTP"):
        replace(p, kind=np.full(3, LIN, np.int8))
    with pytest.raises(ValueError, match="needs a feed"):
        replace(p, kind=np.array([0, 1, 1], np.int8), feed=np.array([np.nan, np.nan, 0.1]))
    with pytest.raises(ValueError, match="external_axes"):
        replace(p, external_axes=(ExternalProgramAxis("rail", True, False),))
    with pytest.raises(ValueError, match="must rise"):
        replace(p, time=np.zeros(3))
    slow = replace(p, kind=np.array([0, 1, 1], np.int8), feed=np.array([np.nan, 5e-5, 0.1]))
    with pytest.raises(InputError, match="steps of 6 mm/min"):
        write_program(tmp_path, "PART", slow, "fanuc_joint")


RAIL_AND_TABLE = (ExternalProgramAxis("rail", True, False), ExternalProgramAxis("turn", False, True))


def with_externals() -> RobotProgram:
    p = program(Recipe(4, moves=9))
    return replace(p, external=np.linspace(0, 1, 18).reshape(9, 2), external_axes=RAIL_AND_TABLE)


@pytest.mark.parametrize(
    ("post", "file"), [("krl", "part.src"), ("rapid", "part.mod"), ("fanuc_joint", "PART.ls"), ("csv", "part.csv")]
)
def test_external_axes_are_written(tmp_path: Path, post: str, file: str) -> None:
    p = with_externals()
    write_program(tmp_path, Path(file).stem, p, post, PLAIN)
    parsed = read_program(tmp_path / file)
    expected = p.external * np.array([1e3, 180 / np.pi])  # mm and degrees
    np.testing.assert_allclose(parsed.external, expected, atol=0.51e-4, rtol=0)


def test_custom_words_of_the_cell_follow_the_event(tmp_path: Path) -> None:
    p = program(Recipe(1))
    from machopt.data_types.toolpath import ToolpathEvent

    p = replace(
        p,
        events=(
            ToolpathEvent(1, "spindle", "SPINDL/9000,RPM", 9000.0),
            ToolpathEvent(3, "spindle", "SPINDL/OFF", 0.0),
            ToolpathEvent(4, "coolant", "M8"),
        ),
    )
    own = {"spindle_on": "SPINDLE_ON(@{value:.0f})", "spindle_off": "$OUT[7]=FALSE", "coolant_on": "$OUT[8]=TRUE"}
    write_program(tmp_path, "part", p, "krl", RobotController(lines=own))
    lines = (tmp_path / "part.src").read_text().splitlines()
    for comment, line in (
        ("; CAM: SPINDL/9000,RPM", "SPINDLE_ON(9000)"),
        ("; CAM: SPINDL/OFF", "$OUT[7]=FALSE"),
        ("; CAM: M8", "$OUT[8]=TRUE"),
    ):
        assert lines[lines.index(comment) + 1] == line
    parsed = read_program(tmp_path / "part.src")
    assert [(e.index, e.text) for e in parsed.events] == [(e.index, e.text) for e in p.events]
    with pytest.raises(InputError, match=r"needs @\{value\}, but 'M8' gives none"):
        write_program(tmp_path, "part", p, "krl", RobotController(lines={"coolant_on": "X(@{value})"}))
    with pytest.raises(InputError, match="no field is named 'rpm'"):
        write_program(tmp_path, "part", p, "krl", RobotController(lines={"spindle_on": "X(@{rpm})"}))


def test_header_states_missing_cell_settings(tmp_path: Path) -> None:
    p = program(Recipe(1))
    write_program(tmp_path, "bare", p, "krl", RobotController())
    head = (tmp_path / "bare.src").read_text()
    for word in ("controller.joint_map", "controller.root", "controller.flange", "$ROBROOT"):
        assert word in head
    assert "$BASE=MO_BASE" in head
    write_program(tmp_path, "numbered", p, "krl", RobotController(tool_number=4, base_number=7))
    assert "$TOOL=TOOL_DATA[4]" in (tmp_path / "numbered.src").read_text()
