"""Plans with rails and positioners: equal to fixed cells, chosen values, refused options."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from external_axis_cells import external_cell
from small_cell import small_cell
from test_planning_path import Rows, toolpath

from machopt.data_types.cell import Cell, Workpiece
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions, ProcessForce
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.errors import InputError
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_robot
from machopt.options.plan_option_reader import format_user_options, load_options
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.motion.rapid_moves import FreeSpace, RapidMove, RapidTiming, plan_rapid
from machopt.planning.motion.trajectory_builder import build_timeline
from machopt.planning.optimality_certificate import compute_certificate
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import prepare_planning
from machopt.planning.plan_output.infeasibility_reasons import explain_points
from machopt.planning.plan_output.infeasibility_remedies import describe_remedy

K = ArmStiffness(joints=np.array([1.4e6, 1.2e6, 9.4e5, 3.6e5, 3.7e5, 3.8e5]))
OPTIONS = PlanOptions(
    collision=False, rotation_step=np.radians(30.0), force=ProcessForce(normal=200.0, axial=100.0), sample=0.02
)
VALUES = replace(OPTIONS, external=(ExternalJointOptions(joint="e1", mode="operation"),))
UP = (0.0, 0.0, 1.0)
_ON_TOP = '<parent link="s2"/><child link="base_link"/>'


def slots(*starts: float, x: float = 0.0) -> Rows:
    """Return a short slot along y from each position, after a rapid move."""
    rows: Rows = []
    for y in starts:
        rows += [((x, y, 0.05), UP, MoveKind.RAPID)]
        rows += [((x, y + d, 0.0), UP, MoveKind.CUT) for d in (0.0, 0.04, 0.08)]
        rows += [((x, y + 0.08, 0.05), UP, MoveKind.RETRACT)]
    return rows


def separate_operations(path: Toolpath) -> Toolpath:
    """Return the path with each run as a separate operation."""
    operation = (np.cumsum(path.move == MoveKind.RAPID) - 1).astype(np.int32)
    labels = tuple(ToolpathOperation(f"op{k}", "trajectory") for k in range(int(operation[-1]) + 1))
    return replace(path, operation=operation, operations=labels)


def compute_driven_joints(p: Plan, path: Toolpath) -> np.ndarray:
    """Return the exported motion (S, 6 + E)."""
    motion = build_timeline(p, path).trajectory
    assert motion is not None
    return np.hstack([motion.q, motion.external])


@pytest.mark.parametrize(("kind", "e"), [({"rail": True}, 0.3), ({"table": True, "tilt": True}, 0.2)])
def test_external_axis_value_equals_a_cell_built_there(tmp_path: FilePath, kind: dict[str, bool], e: float) -> None:
    cell = replace(external_cell(tmp_path, **kind), stiffness=K)
    cell = replace(cell, external_home=np.full(len(cell.external_joints), e))
    machine = load_machine(cell, load_robot(cell))
    T = cell.T_world_base @ machine.compute_T_base_workpiece(cell.external_home[None])[0]
    still = small_cell(tmp_path / "..", stiffness=K, workpiece=Workpiece("world", T), obstacles=())
    path = toolpath(slots(0.1, -0.1))
    ours, theirs = (
        compute_driven_joints(plan_path(cell, path, OPTIONS), path),
        compute_driven_joints(plan_path(still, path, OPTIONS), path),
    )
    np.testing.assert_allclose(ours[:, :6], theirs, atol=1e-9)  # rounding of T, amplified by Newton steps
    np.testing.assert_array_equal(ours[:, 6:], np.full((len(ours), len(cell.external_joints)), e))


@pytest.mark.slow
def test_each_operation_has_one_value(tmp_path: FilePath) -> None:
    """Slots at both ends of a long part: not reachable from one rail position, and never worse than home."""
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    path = separate_operations(toolpath(slots(-2.4, 2.3)))
    p = find_best_plan(cell, path, VALUES)
    assert not len(p.missing)
    first, second = (p.path.external[a : b + 1, 0] for a, b in p.path.runs)
    assert np.ptp(first) == np.ptp(second) == 0
    assert first[0] < -0.5
    assert second[0] > 0.5
    x = compute_driven_joints(p, path)
    assert np.abs(np.diff(x[:, 6])).max() <= 0.02 * cell.limits.velocity[6]
    locked = find_best_plan(cell, path, replace(OPTIONS, external=(ExternalJointOptions(joint="e1", mode="locked"),)))
    assert len(locked.missing)


def test_chosen_value_is_no_worse_than_home(tmp_path: FilePath) -> None:
    cell = replace(external_cell(tmp_path, table=True), stiffness=K)
    path = toolpath(slots(0.15))
    p = find_best_plan(cell, path, replace(OPTIONS, external=(ExternalJointOptions(joint="turn", mode="operation"),)))
    home = plan_path(cell, path, OPTIONS, scale=p.scores.scale)
    assert p.chosen.objective.total <= home.chosen.objective.total
    # the rotation of the file, with the table at home
    assert p.cam_default.objective.total == home.cam_default.objective.total
    inside = replace(OPTIONS, external=(ExternalJointOptions(joint="turn", mode="operation", range=(0.5, 0.6)),))
    assert 0.5 <= find_best_plan(cell, path, inside).path.external[0, 0] <= 0.6


def long_slot(length: float, points: int = 24) -> Toolpath:
    """Return one slot along the rail, from −length to length."""
    ys = np.linspace(-length, length, points)
    rows: Rows = [((0.0, ys[0], 0.05), UP, MoveKind.RAPID)]
    rows += [((0.0, y, 0.0), UP, MoveKind.CUT) for y in ys]
    return toolpath([*rows, ((0.0, ys[-1], 0.05), UP, MoveKind.RETRACT)], feed=0.05)


@pytest.mark.slow
def test_part_longer_than_the_reach_is_cut_in_one_run(tmp_path: FilePath) -> None:
    cell, path = replace(external_cell(tmp_path, rail=True), stiffness=K), long_slot(2.2)
    assert len(find_best_plan(cell, path, VALUES).missing)
    p = find_best_plan(cell, path, OPTIONS)
    assert not len(p.missing)
    x = compute_driven_joints(p, path)
    for order, limit in enumerate((cell.limits.velocity, cell.limits.acceleration, cell.limits.jerk), 1):
        used = np.abs(np.diff(x, order, axis=0)).max(axis=0) / OPTIONS.sample**order / limit
        assert used.max() <= 1.0, order
    assert np.ptp(x[:, 6]) > 2.0
    assert (x[:, 6] >= cell.limits.lower[6]).all()
    assert (x[:, 6] <= cell.limits.upper[6]).all()
    motion = build_timeline(p, path).trajectory
    assert motion is not None
    tip = p.setup.arm.machine.compute_fk(x, cell.tool.T_flange_tcp)[motion.move == MoveKind.CUT][:, :3, 3]
    assert np.abs(tip[:, 0]).max() < 2e-5  # the slot is straight for any rail motion
    speed = np.linalg.norm(np.diff(tip, axis=0), axis=1) / OPTIONS.sample
    assert speed.max() <= 0.05 * 1.001  # the feed is that of the tool relative to the part
    certificate = compute_certificate(p)
    assert certificate is not None
    # the same unit; both include the travel of the rail
    assert certificate.sequence == pytest.approx(certificate.grid, rel=0.05)
    assert certificate.sequence > p.choice.total


@pytest.mark.slow
@pytest.mark.parametrize("kind", [{"rail": True}, {"table": True}])
def test_moving_is_never_worse_than_the_best_value(tmp_path: FilePath, kind: dict[str, bool]) -> None:
    cell, path = replace(external_cell(tmp_path, **kind), stiffness=K), long_slot(0.2, 8)
    moving, fixed = find_best_plan(cell, path, OPTIONS), find_best_plan(cell, path, VALUES)
    assert moving.scores.scale == fixed.scores.scale
    assert moving.chosen.objective.total <= fixed.chosen.objective.total


def ring(radius: float = 0.12, holes: int = 4) -> Toolpath:
    """Return holes on a circle with axes inclined outwards."""
    rows: Rows = []
    for a in np.linspace(0.0, 2.0 * np.pi, holes, endpoint=False):
        axis = (0.6 * np.cos(a), 0.6 * np.sin(a), 0.8)
        at = np.array([radius * np.cos(a), radius * np.sin(a), 0.0])
        for d, move in (
            (0.05, MoveKind.RAPID),
            (0.002, MoveKind.APPROACH),
            (-0.003, MoveKind.CUT),
            (0.05, MoveKind.RETRACT),
        ):
            rows.append((tuple(at + d * np.array(axis)), axis, move))
    return toolpath(rows)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["moving", "operation"])
def test_additional_joint_makes_no_plan_worse(tmp_path: FilePath, mode: str) -> None:
    cell, path = replace(external_cell(tmp_path, rail=True, table=True), stiffness=K), ring()
    free = tuple(ExternalJointOptions(joint=name, mode=mode) for name in ("rail", "turn"))
    both = find_best_plan(cell, path, replace(OPTIONS, external=free))
    for k, name in enumerate(("rail", "turn")):
        one = find_best_plan(
            cell, path, replace(OPTIONS, external=(free[1 - k], ExternalJointOptions(joint=name, mode="locked")))
        )
        own, w = one.chosen.objective, OPTIONS.weights
        index = w.mean * own.mean + w.worst * own.worst
        in_the_unit_of_both = own.total + index * (one.scores.scale / both.scores.scale - 1.0)
        assert both.chosen.objective.total <= 1.005 * in_the_unit_of_both, name


@pytest.mark.parametrize(
    ("axis", "told"),
    [
        (ExternalJointOptions(joint="slide"), "'slide' is no external joint of the cell"),
        (ExternalJointOptions(joint="rail", at=1.0, unit="deg"), "'rail' slides: values in mm would work"),
        (
            ExternalJointOptions(joint="rail", mode="locked", at=9.0, unit="mm"),
            r"found 9000 mm; the range of 'rail' is \[-2500, 2500\]",
        ),
        (ExternalJointOptions(joint="rail", range=(3.0, 4.0), unit="mm"), r"outside the range \[-2500, 2500\]"),
        (
            ExternalJointOptions(joint="e1", preferred=9.0, unit="mm"),
            r"found 9000 mm; the range of 'rail' is \[-2500, 2500\]",
        ),
        (
            ExternalJointOptions(joint="rail", at=1.0, unit="mm"),
            "at_mm is the position of a locked joint, and 'rail' may move",
        ),
        (ExternalJointOptions(joint="e1", operations=(("face", "locked"),)), "'face' is no operation of the toolpath"),
    ],
)
def test_unsupported_planning_is_refused_by_name(tmp_path: FilePath, axis: ExternalJointOptions, told: str) -> None:
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    with pytest.raises(InputError, match=told):
        find_best_plan(cell, toolpath(slots(0.0)), replace(OPTIONS, external=(axis,)))


@pytest.mark.parametrize(
    ("y", "axis", "told", "would"),
    [
        (
            2.4,
            ExternalJointOptions(joint="rail", mode="locked"),
            "with rail locked at 0 mm",
            "mode other than locked would help",
        ),
        (
            2.4,
            ExternalJointOptions(joint="rail", mode="locked"),
            "mm it would be in reach",
            "mode other than locked would help",
        ),
        (
            2.4,
            ExternalJointOptions(joint="rail", mode="operation", range=(0.0, 0.1), unit="mm"),
            "an end of its range 0 mm to 100 mm",
            "a wider external.rail.range_mm would help",
        ),
        (
            9.0,
            ExternalJointOptions(joint="rail", mode="locked"),
            "every value tried of rail (-2,500 mm to 2,500 mm)",
            "moving the part",
        ),
    ],
)
def test_unreachable_point_names_the_rail(
    tmp_path: FilePath, y: float, axis: ExternalJointOptions, told: str, would: str
) -> None:
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    p = find_best_plan(cell, toolpath(slots(y)), replace(OPTIONS, external=(axis,)))
    row = int(p.missing[0])
    assert told in explain_points(p)[row]
    assert would in describe_remedy(p, row)


def test_too_many_joints_are_refused_and_planned_where_one_is_locked(tmp_path: FilePath) -> None:
    """Four stacked slides caused an internal error."""
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    more = "".join(
        f'<link name="s{n}"/><joint name="x{n}" type="prismatic"><parent link="{on}"/><child link="s{n}"/>'
        '<axis xyz="1 0 0"/><limit lower="-0.1" upper="0.1" velocity="3" effort="1"/></joint>'
        for n, on in enumerate(("carriage", "s0", "s1"))
    )
    text = cell.urdf.read_text().replace('<parent link="carriage"/><child link="base_link"/>', _ON_TOP)
    cell.urdf.write_text(text.replace("</robot>", more + "</robot>"))
    own, far = cell.limits, np.full(3, 0.1)
    limits = replace(
        own,
        lower=np.r_[own.lower, -far],
        upper=np.r_[own.upper, far],
        velocity=np.r_[own.velocity, 10 * far],
        acceleration=np.r_[own.acceleration, 20 * far],
        jerk=np.r_[own.jerk, 150 * far],
    )
    names = (*cell.external_joints, "x0", "x1", "x2")
    cell = replace(
        cell, external_joints=names, external_prismatic=(True,) * 4, external_home=np.zeros(4), limits=limits
    )
    with pytest.raises(InputError, match=r"for 4 external joints \(rail, x0, x1, x2\), and 3 are the most"):
        find_best_plan(cell, toolpath(slots(0.0)), OPTIONS)
    fixed = tuple(ExternalJointOptions(joint=name, mode="locked") for name in names[1:])
    found = find_best_plan(cell, toolpath(slots(0.0)), replace(OPTIONS, external=fixed))
    assert not found.breaks
    assert not len(found.missing)


def test_joint_under_two_names_merges_its_settings(tmp_path: FilePath) -> None:
    named, short = (
        ExternalJointOptions(joint="rail", mode="moving", range=(0.2, 0.3), unit="mm"),
        ExternalJointOptions(joint="e1", mode="operation"),
    )
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    p = find_best_plan(cell, toolpath(slots(0.15)), replace(OPTIONS, external=(named, short)))
    assert ((p.path.external >= 0.2) & (p.path.external <= 0.3)).all()
    assert len(np.unique(p.path.external[p.path.run == 0])) == 1
    locked = (ExternalJointOptions(joint="rail", mode="locked"), ExternalJointOptions(joint="e1", at=0.25, unit="mm"))
    assert (find_best_plan(cell, toolpath(slots(0.15)), replace(OPTIONS, external=locked)).path.external == 0.25).all()


def test_tilting_gantry_is_refused(tmp_path: FilePath) -> None:
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    text = cell.urdf.read_text().replace('name="rail" type="prismatic"', 'name="rail" type="revolute"')
    cell.urdf.write_text(text)
    with pytest.raises(InputError, match="'rail' tilts the robot's base"):
        prepare_planning(replace(cell, external_prismatic=(False,)), OPTIONS)


def test_options_are_written_as_given() -> None:
    words = ["external.e1.mode=operation", "external.e1.range_mm=[0, 6000]", "external.turn.preferred_deg=30"]
    options = load_options(None, None, words)
    assert options.external[0].range == (0.0, 6.0)
    message = format_user_options(options)
    assert load_options(message) == options  # type: ignore[arg-type]
    with pytest.raises(InputError, match="slides \\(mm\\) or turns"):
        load_options(None, None, ["external.e1={at_mm: 1, preferred_deg: 2}"])
    with pytest.raises(InputError, match="slides \\(mm\\) or turns"):  # one in mm, the other in degrees
        load_options({"external": {"e1": {"range_mm": [0, 1]}}}, None, ["external.e1.range_deg=[0, 1]"])


def test_rapid_move_moves_the_rail(tmp_path: FilePath) -> None:
    cell: Cell = external_cell(tmp_path, rail=True)
    ends = np.zeros(7), np.array([0.1, -1.0, 0.5, 0.2, 0.1, 0.0, 2.0])
    move = plan_rapid(
        *ends,
        timing=RapidTiming(cell.limits, scale=0.8, sample=0.012),
        space=FreeSpace(collision=None, step=0.02),
        detours=lambda: (),
        rng=np.random.default_rng(0),
    )
    assert isinstance(move, RapidMove)
    v = np.diff(move.q, axis=0) / 0.012
    assert (np.abs(v).max(axis=0) <= 0.8 * cell.limits.velocity * 1.001).all()
    # the rail has the longest travel and limits the duration
    assert np.abs(v[:, 6]).max() > 0.75 * cell.limits.velocity[6]
    np.testing.assert_allclose(move.q[-1], ends[1], atol=1e-12)


def test_shaft_of_several_turns_is_followed(tmp_path: FilePath) -> None:
    """Three turns of a helix: grid values of a shaft with a range of four turns were too far apart for a path."""
    cell = replace(external_cell(tmp_path, table=True), stiffness=K)
    k = cell.external_joints.index("turn")
    low, high = cell.limits.lower.copy(), cell.limits.upper.copy()
    low[6 + k], high[6 + k] = -4 * np.pi, 4 * np.pi
    cell = replace(cell, limits=replace(cell.limits, lower=low, upper=high))
    at = np.linspace(0.0, 6.0 * np.pi, 120)
    away = np.column_stack([np.cos(at), np.sin(at), np.ones(120)]) / np.sqrt(2.0)
    rows: Rows = [(tuple(0.1 * away[0] * (1, 1, 0) + 0.1 * away[0]), tuple(away[0]), MoveKind.RAPID)]
    rows += [((0.1 * a[0], 0.1 * a[1], 0.05 + 0.01 * t), tuple(a), MoveKind.CUT) for a, t in zip(away, at, strict=True)]
    found = find_best_plan(cell, toolpath(rows), OPTIONS)
    assert not len(found.missing)
    assert not found.breaks
    assert np.ptp(found.path.external[:, k]) > 4.0 * np.pi
