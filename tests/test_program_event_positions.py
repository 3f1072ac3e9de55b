"""Positions of program events between moves, within samples or printed decimals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import LIN, PTP
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathEvent, ToolpathOperation
from machopt.numerics.array_types import Array
from machopt.programs.checking.printed_precision import compute_last_digit
from machopt.verification.folder.programs.frames_and_axes import compute_toolpath_index
from machopt.verification.programs.cam_comparison import LINE_TIE_M, _find_cut_moves, compare_with_cam
from machopt.verification.programs.controller_interpolation import _compute_line_deviation, _compute_line_deviations
from machopt.verification.programs.event_comparison import check_events
from machopt.verification.programs.expected_cuts import ExpectedCuts
from machopt.verification.programs.motion_comparison import _check_move_kinds
from machopt.verification.programs.target_matching import AXIS_LEVER_M, TargetTolerances, check_external_axes
from machopt.verification.tables.exported_tables import ExportedMotion


def path(position: list[list[float]], move: list[MoveKind], events: tuple[ToolpathEvent, ...]) -> Toolpath:
    n = len(position)
    feed = np.where(np.array(move) == MoveKind.RAPID, np.nan, 0.05)
    return Toolpath(
        position=1e-3 * np.array(position),
        axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        move=np.array(move, np.int8),
        feed=feed,
        operation=np.zeros(n, np.int32),
        operations=(ToolpathOperation("a", "trajectory"),),
        reference=np.full((n, 3), np.nan),
        tolerance=np.full(n, np.nan),
        line=np.arange(1, n + 1, dtype=np.int32),
        source="p.nc",
        format="gcode",
        sha256="",
        events=events,
    )


def program(place: Array, kind: list[int], events: tuple[ToolpathEvent, ...], place_step: float = 0.0) -> ProgramInCell:
    n = len(place)
    T = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (n, 1, 1))
    T[:, :3, 3] = 1e-3 * place
    return ProgramInCell(
        file="p",
        kind=np.array(kind, np.int8),
        q=np.zeros((n, 6)),
        external=np.zeros((n, 0)),
        T_workpiece_tcp=T,
        feed=np.full(n, 0.05),
        move=np.zeros(n, np.int8),
        operation=("a",) * n,
        events=events,
        line=np.arange(n, dtype=np.int32),
        time=np.full(n, np.nan),
        place_step=place_step,
    )


def build_motion(point: Array, move: Array) -> ExportedMotion:
    n = len(point)
    q = np.repeat(0.01 * np.arange(n)[:, None], 6, axis=1)
    return ExportedMotion(
        time=0.012 * np.arange(n),
        point=point,
        move=move,
        q=q,
        external=q[:, :0],
        operation=("a",) * n,
        gamma=np.zeros(n),
        feed=np.full(n, 0.05),
    )


def cuts(toolpath: Toolpath, axis_corner: float = 0.0) -> ExpectedCuts:
    n = len(toolpath)
    wanted = toolpath.cutting
    corners = (np.arange(float(n)), toolpath.position)
    none = np.zeros((n, 3))
    return ExpectedCuts(
        toolpath=toolpath,
        position=toolpath.position,
        corners=corners,
        wanted=wanted,
        corner=1.5e-5,
        axis_corner=axis_corner,
        approach_feed=0.05,
        offset=none,
        tilt=none,
    )


def test_event_index_follows_the_distance_between_long_and_short_moves() -> None:
    """A move of 340 mm, then 1 mm chords of an arc, 0.6 mm per sample.

    Point 1 is 0.2 mm after one sample and 0.4 mm before the next.
    """
    toolpath = path([[0, 0, 0], [340, 0, 0], [341, 0, 0]], [MoveKind.CUT] * 3, ())
    motion = build_motion(np.array([1 - 0.2 / 340, 1.4]), np.zeros(2, np.int64))
    (index,) = compute_toolpath_index(motion, np.array([0.2 / 0.6]), toolpath)
    assert abs(index - 1.0) < 1e-6  # 1 nm, the length that a step without motion counts


def test_event_between_two_moves_to_one_place_is_in_place() -> None:
    """A rapid move, a spindle start and a move to the current position: printed decimals leave 4 µm of travel."""
    spindle = ToolpathEvent(2, "spindle", "S6000", 6000.0)
    rapid, cut = MoveKind.RAPID, MoveKind.CUT
    toolpath = path([[0, 0, 50], [9, 0, 50], [9, 0, 50], [9, 0, 0]], [rapid, rapid, rapid, cut], (spindle,))
    place = np.array([[0, 0, 99], [0, 0, 50], [9, 0, 50], [9, 0, 50], [9, 0, 0.0]])
    reached = np.array([-1, -1, -1, 4])
    at = np.array([np.nan, 0.0, 0.9955, 0.9955, 3.0])
    for index, passed in ((3, True), (2, False), (1, False), (4, True)):
        event = ToolpathEvent(index, "spindle", "S6000", 6000.0)
        parsed_program = program(place, [PTP, PTP, PTP, PTP, LIN], (event,), place_step=5e-6)
        (check,) = check_events(parsed_program, cuts(toolpath), reached, at)
        assert check.passed is passed, (index, check.where)


def test_event_at_the_start_of_a_rapid_move_is_in_place() -> None:
    """The index on the way to point 2 increases with time: it is 1.0002 while the tool is still at point 1."""
    rapid = MoveKind.RAPID
    toolpath = path([[0, 0, 50], [9, 0, 50], [1400, 0, 50], [1400, 0, 60]], [rapid] * 4, ())
    reached = np.full(4, -1)
    for x, index, passed in ((9.0, 1.0002, True), (9.5, 1.0002, False), (9.0, 1.9, False)):
        place = np.array([[0, 0, 99], [0, 0, 50], [x, 0, 50], [1400, 0, 50], [1400, 0, 60.0]])
        event = ToolpathEvent(2, "comment", "SLOT B")
        toolpath = replace(toolpath, events=(event,))
        parsed_program = program(place, [PTP] * 5, (replace(event, index=3),), place_step=5e-6)
        (check,) = check_events(parsed_program, cuts(toolpath), reached, np.array([np.nan, 0.0, index, 2.0, 3.0]))
        assert check.passed is passed, (x, index, check.where)


def test_samples_within_printed_decimals_are_no_joint_move() -> None:
    """The last samples of a retract are 1 µm apart; the program's target is located two samples too early."""
    p = np.zeros((6, 3))
    p[:, 2] = 1e-3 * np.array([0, 9.998, 9.9995, 10.0, 15.0, 20.0])
    move = np.array(
        [MoveKind.CUT, MoveKind.RETRACT, MoveKind.RETRACT, MoveKind.RETRACT, MoveKind.RAPID, MoveKind.RAPID]
    )
    place = np.array([[0, 0, 0], [0, 0, 10], [0, 0, 20.0]])
    for step, passed in ((2e-6, True), (0.0, False)):
        parsed_program = program(place, [LIN, LIN, PTP], (), place_step=step)
        at, linear = np.array([0.0, 1.2, 5.0]), np.array([True, True, False])
        motion = build_motion(np.array([0, 1, 1, 1, 1.5, 2.0]), move.astype(np.int64))
        check = _check_move_kinds(parsed_program, motion, p, at, linear, ["1", "2", "3"], 2e-5)
        assert ("joint move" not in check.where) is passed, check.where


def test_joint_move_at_the_current_place_is_not_on_the_path() -> None:
    """One cut point; with its printed decimals the joint target is 2 µm from the tool, which rests for two samples."""
    p = 1e-3 * np.array([[0, 0, 90.0], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 90.0]])
    move = np.array([MoveKind.RAPID, MoveKind.RAPID, MoveKind.CUT, MoveKind.CUT, MoveKind.RAPID])
    place = np.array([[0, 0, 90], [0, 0, 2e-3], [0, 0, 2e-3], [0, 0, 90.0]])
    parsed_program = program(place, [PTP, PTP, LIN, PTP], ())
    at, linear = np.array([0.0, 1.0, 1.0, 4.0]), np.array([False, False, True, False])
    moving = build_motion(np.array([-1, 0, 0, 0, -1.0]), move.astype(np.int64))
    q = moving.q.copy()
    q[1:4] = q[1]
    for motion, passed in ((replace(moving, q=q), True), (moving, False)):
        check = _check_move_kinds(parsed_program, motion, p, at, linear, ["1", "2", "3", "4"], 2e-5)
        assert ("joint move" not in check.where) is passed, check.where


def test_rounding_of_joint_targets_is_allowed_like_pulses() -> None:
    """With a positioner, a target with five decimals was 1.2 µm from the tool position, and the exit code was 4."""
    assert compute_last_digit(np.array([[-74.22112, np.nan], [0.0, 90.0]])) == 1e-5
    assert compute_last_digit(np.array([-90.0, 45.0])) == 1e-4  # round values by chance
    assert compute_last_digit(np.array([np.pi, np.nan])) == compute_last_digit(np.array([np.nan])) == 0.0
    p = 1e-3 * np.array([[0, 0, 0], [0, 0, 9.9988], [0, 0, 10.0], [0, 0, 15.0], [0, 0, 20.0]])
    move = np.array([MoveKind.CUT, MoveKind.RETRACT, MoveKind.RETRACT, MoveKind.RAPID, MoveKind.RAPID]).astype(np.int64)
    parsed_program = program(np.array([[0, 0, 0], [0, 0, 10], [0, 0, 20.0]]), [LIN, LIN, PTP], ())
    at, linear = np.array([0.0, 0.4, 4.0]), np.array([True, True, False])
    motion = build_motion(np.array([0, 1, 1, 1.5, 2.0]), move)
    for step, passed in ((1e-6, True), (1e-7, False)):
        check = _check_move_kinds(
            replace(parsed_program, target_step=step), motion, p, at, linear, ["1", "2", "3"], 2e-5
        )
        assert ("joint move" not in check.where) is passed, check.where


def tilt_pose(T: Array, angle: float) -> Array:
    """Return the pose (4, 4) with its axis tilted about y."""
    out = T.copy()
    out[:3, :3] = Rotation.from_euler("y", angle).as_matrix() @ T[:3, :3]
    return out


def on_the_spot() -> tuple[Toolpath, ProgramInCell]:
    """Return a cut, a tilt of the axis by 0.5 rad at its end, and another cut."""
    toolpath = path([[0, 0, 0], [30, 0, 0], [30, 0, 0], [60, 0, 0]], [MoveKind.CUT] * 4, ())
    axis = toolpath.axis.copy()
    axis[2:] = [np.sin(0.5), 0.0, np.cos(0.5)]
    toolpath = replace(toolpath, axis=axis)
    output = program(np.array([[0, 0, 0], [30, 0, 0], [30, 0, 0], [60, 0, 0.0]]), [LIN] * 4, ())
    for n in (2, 3):
        output.T_workpiece_tcp[n] = tilt_pose(output.T_workpiece_tcp[n], 0.5)
    return toolpath, output


def test_axis_rotation_on_the_spot_is_located_at_its_end() -> None:
    toolpath, output = on_the_spot()
    T = output.T_workpiece_tcp
    reached, gap, tilt = _find_cut_moves(T[:, :3, 3], -T[:, :3, 2], cuts(toolpath), 2e-5)
    assert reached.tolist()[1:] == [1, 2, 3]
    assert np.nanmax(gap) < 1e-9
    assert np.nanmax(tilt[1:]) < 1e-6
    left_out = np.array([0, 1, 3])  # a program that rotates the axis during the next move instead
    _, _, tilt = _find_cut_moves(T[left_out, :3, 3], -T[left_out, :3, 2], cuts(toolpath), 2e-5)
    assert tilt[2] > 0.4


def test_streamed_motion_may_rotate_the_axis_within_the_tolerance() -> None:
    """The samples approach the point, rotate and leave;
    the first one within the tolerance is 15 µm before the point."""
    toolpath, _ = on_the_spot()
    x = np.array([0, 29.9, 29.985, 30, 30, 30, 30.01, 30.1, 60])
    parsed_program = program(np.column_stack([x, 0 * x, 0 * x]), [LIN] * len(x), ())
    T = parsed_program.T_workpiece_tcp
    for n, angle in ((4, 0.25), (5, 0.4999), (6, 0.5), (7, 0.5), (8, 0.5)):
        T[n] = tilt_pose(T[n], angle)
    reached, _, tilt = _find_cut_moves(T[:, :3, 3], -T[:, :3, 2], cuts(toolpath), 2e-5)
    assert reached.tolist()[1:] == [3, 5, 8]
    assert np.nanmax(tilt[1:]) < LINE_TIE_M / AXIS_LEVER_M + 1e-9
    T[6:8] = tilt_pose(T[6], -0.5)  # rotated back before it leaves: the tilt was not 0.5 rad at departure
    _, _, tilt = _find_cut_moves(T[[0, 1, 2, 3, 7, 8], :3, 3], -T[[0, 1, 2, 3, 7, 8], :3, 2], cuts(toolpath), 2e-5)
    assert tilt[2] > 0.4


def test_allowed_deviation_applies_to_streamed_motion_not_to_targets() -> None:
    toolpath = path([[0, 0, 0], [30, 0, 0], [60, 0, 0]], [MoveKind.CUT] * 3, ())
    output = program(1e3 * toolpath.position, [LIN] * 3, ())
    output.T_workpiece_tcp[1] = tilt_pose(output.T_workpiece_tcp[1], np.radians(0.5))
    for streamed, most, passed in ((True, 1.0, True), (True, 0.4, False), (True, 0.0, False), (False, 1.0, False)):
        wanted = cuts(toolpath, np.radians(most))
        checks = compare_with_cam(replace(output, is_streamed=streamed), wanted, np.arange(3.0))
        (check,) = (c for c in checks if c.what == "CAM tool axis")
        assert check.passed is passed, (streamed, most, check.value, check.limit)


def test_rail_rounding_its_corner_deviates_within_the_tolerance() -> None:
    """The tip moves straight at 0.05 mm per sample; the rail, which should start there,
    starts 0.5 mm of path earlier."""
    x = 0.05 * np.arange(-100, 101)
    tcp = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(x), 1, 1))
    tcp[:, 0, 3] = 1e-3 * x
    rail = np.where(np.abs(x) < 0.5, 0.5 * (x + 0.5) ** 2, np.clip(x, 0.0, None))
    moving = build_motion(x, np.zeros(len(x), np.int64))
    parsed_program = program(np.zeros((1, 3)), [LIN], ())
    for additional, corner, passed in ((0.0, 5e-4, True), (0.0, 0.0, False), (0.1, 5e-4, True), (0.3, 5e-4, False)):
        motion = replace(moving, external=1e-3 * rail[:, None], slides=(True,))
        parsed_program = replace(parsed_program, external=np.array([[1e-3 * -additional]]))
        check = check_external_axes(
            parsed_program,
            motion,
            tcp,
            np.array([100.0]),
            TargetTolerances(position=1e-3, axis=1e-3, turn=0.01, corner=corner, axis_corner=0.0),
            ["1"],
        )
        assert check.passed is passed, (additional, corner, check.value)
    even = replace(moving, external=1e-3 * x[:, None], slides=(True,))
    parsed_program = replace(parsed_program, external=np.array([[2e-4]]))
    check = check_external_axes(
        parsed_program,
        even,
        tcp,
        np.array([100.0]),
        TargetTolerances(position=1e-3, axis=1e-3, turn=0.01, corner=5e-4, axis_corner=0.0),
        ["1"],
    )
    assert not check.passed


def test_sample_of_a_started_rotation_belongs_to_that_move() -> None:
    """The preceding target is located by its position, so it may be found one sample late."""
    _, output = on_the_spot()
    T = output.T_workpiece_tcp
    tcp = np.stack([tilt_pose(T[1], 1e-3), T[1]])
    tcp[1, 0, 3] -= 1e-4  # a sample during the move, which is not reassigned
    tcp[1, :3, :3] = tcp[0, :3, :3]
    rows, move = np.arange(2), np.array([1, 1])
    off = _compute_line_deviation(tcp, T[move - 1], T[move])
    assert off[:, 1].min() > 9e-4
    off = _compute_line_deviations(output, tcp, rows, move)
    assert off[0, 1] < 1e-9
    assert off[1, 1] > 9e-4
