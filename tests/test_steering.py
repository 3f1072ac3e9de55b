"""Steering rules of individual points are respected exactly, and conflicts are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from pydantic import ValidationError
from small_cell import small_cell
from test_external_axes import long_slot
from test_planning_path import Rows, toolpath
from test_planning_pipeline import FREE, UP, K, pass_over_block

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import (
    ExternalJointOptions,
    ExternalMode,
    FixedRotation,
    PlanOptions,
    ProcessForce,
    SteeringRule,
)
from machopt.data_types.steering_rules import (
    format_steering_rule,
    is_inside_zone,
    list_constrained_points,
    refuse_narrow_zones,
    resolve_steering,
)
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.errors import InputError
from machopt.options.steering_schema import SteerKeys, format_steering, parse_steering
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.job.constraint_conflicts import (
    add_constraint_conflict,
    add_undrivable_conflict,
    find_minimal_conflict,
    is_complete,
    list_constraints,
)
from machopt.planning.motion.trajectory_builder import build_timeline
from machopt.planning.optimality_certificate import compute_certificate
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma
from machopt.planning.plan_output.plan_remarks import list_hints
from machopt.planning.stations.planning_path import build_planning_path
from machopt.verification.check_results import VerificationCheck
from machopt.verification.motion.checks.requested_choices import check_requested_choices
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

EXACT = 1e-5  # rad; tolerance of the solver
C, R, A = MoveKind.CUT, MoveKind.RAPID, MoveKind.APPROACH


def deg(value: float) -> float:
    return float(np.radians(value))


def job(folder: Path, before: Plan | None = None, **wishes: object) -> Plan:
    cell = small_cell(folder, stiffness=ArmStiffness(joints=K))
    return plan_path(cell, toolpath(pass_over_block()), replace(FREE, **wishes), before=before)


def at_points(p: Plan) -> np.ndarray:
    """Return γ in degrees at the points of the toolpath."""
    return np.degrees(compute_gamma(p)[p.path.is_point])


def two_operations() -> Toolpath:
    """Return an approach, three points of "a", then a rapid move and two points of "b"."""
    rows: Rows = [((0.0, 0.0, 0.1), UP, R), ((0.0, 0.0, 0.02), UP, A)]
    rows += [((0.01 * k, 0.0, 0.0), UP, C) for k in range(3)]
    rows += [((0.0, 0.05, 0.1), UP, R), ((0.0, 0.05, 0.0), UP, C), ((0.01, 0.05, 0.0), UP, C)]
    labelled = (ToolpathOperation("a", "trajectory"), ToolpathOperation("b", "trajectory"))
    return replace(toolpath(rows), operations=labelled, operation=np.array([0, 0, 0, 0, 0, 1, 1, 1], np.int32))


def test_steering_rules_are_assigned_to_points() -> None:
    wishes = (
        SteeringRule(operation="a", gamma=0.5),
        SteeringRule(operation="b", forbid=(0.0, 1.0)),
        SteeringRule(points=(6, 7), branch=2),
        SteeringRule(prefer=0.25),
    )
    laid = resolve_steering(PlanOptions(fixed=(FixedRotation(3, 0.7),), steer=wishes), two_operations())
    # a point's own rule has priority
    assert laid.fixed == (FixedRotation(3, 0.7), FixedRotation(2, 0.5), FixedRotation(4, 0.5))
    b = (6, 7)
    assert laid.steer == (
        SteeringRule(points=b, forbid=(0.0, 1.0)),
        SteeringRule(points=b, branch=2),
        SteeringRule(points=(0, 7), prefer=0.25),
    )
    assert resolve_steering(laid, two_operations()) == laid
    assert list_constrained_points(laid) == (3, 2, 4, 6, 7)
    assert resolve_steering(PlanOptions(), two_operations()) == PlanOptions()


@pytest.mark.parametrize(
    ("wish", "parts"),
    [
        ((SteeringRule(operation="aa", gamma=0.1),), ["'aa' is no operation", "valid: ", "steer[0].operation"]),
        ((SteeringRule(points=(2, 8), gamma=0.1),), ["points 2 to 8", "points 0 to 7", "steer[0].points"]),
        (
            (SteeringRule(operation="a", gamma=0.1), SteeringRule(points=(3, 3), gamma=deg(20))),
            ["point 3", "'a'", "20°", "fixed"],
        ),
    ],
)
def test_impossible_rules_are_refused(wish: tuple[SteeringRule, ...], parts: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        resolve_steering(PlanOptions(steer=wish), two_operations())
    assert all(part in str(caught.value) for part in parts)


def test_zone_between_two_grid_rotations_is_refused() -> None:
    refuse_narrow_zones(PlanOptions(steer=(SteeringRule(forbid=(deg(177), deg(-178))),)))  # 5° wide, across 180°
    with pytest.raises(InputError, match=r"narrower than rotation_step_deg \(5\)"):
        refuse_narrow_zones(PlanOptions(steer=(SteeringRule(forbid=(deg(1), deg(4))),)))


def test_pin_beyond_the_range_is_refused_and_half_turns_are_equal() -> None:
    options = PlanOptions(rotation_range=(deg(0), deg(180)), steer=(SteeringRule(points=(1, 2), gamma=deg(-180)),))
    refuse_narrow_zones(options)
    for beyond in ({"fixed": (FixedRotation(3, deg(-10)),)}, {"steer": (SteeringRule(operation="a", gamma=deg(-10)),)}):
        with pytest.raises(InputError, match=r"-10° .*is beyond rotation_range_deg \[0°, 180°\]"):
            refuse_narrow_zones(replace(options, **beyond))
    both = (SteeringRule(operation="a", gamma=deg(180)), SteeringRule(points=(0, 1), gamma=deg(-180)))
    assert len(resolve_steering(PlanOptions(steer=both), two_operations()).fixed) > 1


def test_zone_may_contain_the_half_turn_and_includes_its_ends() -> None:
    zone = (deg(170), deg(-170))
    assert (
        is_inside_zone(np.radians([180.0, -175.0, 170.0, -170.0, 0.0, 169.0]), zone).tolist()
        == [True, True] + [False] * 4
    )


def test_pins_are_met_exactly_and_the_rest_is_free(tmp_path: Path) -> None:
    free = job(tmp_path)
    pinned = job(tmp_path, before=free, steer=(SteeringRule(points=(4, 6), gamma=deg(71.3)),))
    assert is_complete(pinned)
    assert at_points(pinned)[4:7] == pytest.approx(71.3, abs=np.degrees(EXACT))
    assert abs(at_points(free)[5] - 71.3) > 5.0  # without the rule the value is different
    alone = job(tmp_path, steer=(SteeringRule(points=(4, 6), gamma=deg(71.3)),))
    # independent of the reused results
    np.testing.assert_array_equal(alone.chosen.assignment.q, pinned.chosen.assignment.q)
    certificate = compute_certificate(pinned)
    assert certificate is not None
    assert certificate.bound <= certificate.sequence
    assert certificate.bound > 0.0


def test_zone_holds_at_every_planning_point(tmp_path: Path) -> None:
    at = at_points(job(tmp_path))[5]
    zone = (deg(at - 32.0), deg(at + 18.0))
    p = job(tmp_path, steer=(SteeringRule(points=(3, 7), forbid=zone),))
    rows = (p.path.index >= 3) & (p.path.index <= 7)
    assert is_complete(p)
    assert not is_inside_zone(compute_gamma(p)[rows], (zone[0] + EXACT, zone[1] - EXACT)).any()


def test_preferred_rotation_of_some_points_attracts_the_curve(tmp_path: Path) -> None:
    p = job(tmp_path, steer=(SteeringRule(points=(0, 9), prefer=deg(100), weight=50.0),))
    assert at_points(p) == pytest.approx(100.0, abs=2.0)  # the performance index still has an influence
    everywhere = job(tmp_path, preferred_rotation=deg(100), preferred_weight=50.0)
    np.testing.assert_array_equal(p.chosen.assignment.phi, everywhere.chosen.assignment.phi)


def test_branch_rule_is_respected(tmp_path: Path) -> None:
    taken = int(job(tmp_path).chosen.assignment.branch[3])
    other = next(b for b in (5, 4) if b != taken)
    p = job(tmp_path, steer=(SteeringRule(branch=other),))
    assert is_complete(p)
    assert (p.chosen.assignment.branch == other).all()
    with pytest.raises(InputError, match=r"branch 77 at points 0 to 9: this arm has the branches 0 to 7"):
        job(tmp_path, steer=(SteeringRule(branch=77),))
    # the configuration with the shoulder turned back reaches none of the points
    never = job(tmp_path, steer=(SteeringRule(branch=1),))
    assert (never.chosen.assignment.reason != InfeasibilityReason.OK).all()


def test_branch_without_a_stable_number_is_refused(tmp_path: Path) -> None:
    """Axis 6 does not pass through the wrist centre:
    for a general arm the solutions are numbered anew at every pose."""
    cell = small_cell(tmp_path, stiffness=ArmStiffness(joints=K))
    additional = cell.urdf.read_text().replace('xyz="0.215 0.0 0.0"', 'xyz="0.215 0.0 0.02"')
    assert additional != cell.urdf.read_text()
    cell.urdf.write_text(additional)
    with pytest.raises(InputError, match=r"branch 2 at points 1 to 9: branches of this arm have no numbers that"):
        plan_path(cell, toolpath(pass_over_block()), replace(FREE, steer=(SteeringRule(operation="op", branch=2),)))


def test_conflicting_pins_are_named(tmp_path: Path) -> None:
    """This arm cannot rotate by 180° between two adjacent points; the third pin is not part of the conflict."""
    path = toolpath(pass_over_block())
    pins = (FixedRotation(1, deg(20)), FixedRotation(4, deg(10)), FixedRotation(5, deg(-170)))
    options = replace(FREE, fixed=pins)
    p = job(tmp_path, fixed=pins)
    assert not is_complete(p)
    constraint_conflict = add_constraint_conflict(p, p.setup.cell, path, options, StageTimings())
    assert "the rotation 10° at point 4, the rotation -170° at point 5" in constraint_conflict.conflict
    assert "point 1" not in constraint_conflict.conflict
    assert constraint_conflict.conflict in list_hints(constraint_conflict)
    fixed = replace(FREE, fixed=pins[:2])
    assert is_complete(job(tmp_path, fixed=pins[:2]))
    fine = job(tmp_path, fixed=pins[:2])
    assert add_constraint_conflict(fine, p.setup.cell, path, fixed, StageTimings()) is fine


def test_rules_beside_an_undrivable_place_are_reported(tmp_path: Path) -> None:
    """All points are feasible, so only the timed motion finds the conflict; the nearest three requests are named."""
    path = toolpath(pass_over_block())
    pins = (FixedRotation(0, deg(20)), FixedRotation(4, deg(20)), FixedRotation(5, deg(22)))
    zone = SteeringRule(points=(8, 9), forbid=(deg(100), deg(120)))
    p = job(tmp_path, fixed=pins[:1])
    stop = SequenceBreak(before=4.25, after=4.25, code="no_pose", text="the pose cannot be reached", help="")
    conflict = add_undrivable_conflict(p, (stop,), path, replace(FREE, fixed=pins, steer=(zone,))).conflict
    assert "cannot be driven at point 4.25: the pose cannot be reached." in conflict
    near = "Nearest requests: the rotation 20° at point 4, the rotation 22° at point 5, no rotation from 100°"
    assert near in conflict
    assert "point 0" not in conflict
    assert add_undrivable_conflict(p, (stop,), path, FREE) is p  # no rule is given
    assert add_undrivable_conflict(p, (), path, replace(FREE, fixed=pins)) is p


def test_two_rotations_along_one_plunge_are_a_conflict(tmp_path: Path) -> None:
    rows: Rows = [((0.0, 0.0, 0.08), UP, R), ((0.0, 0.0, 0.03), UP, A), ((0.0, 0.0, 0.01), UP, C)]
    path = toolpath(rows, kind="point")
    options = replace(FREE, fixed=(FixedRotation(1, deg(10.0)), FixedRotation(2, deg(12.0))))
    cell = small_cell(tmp_path, stiffness=ArmStiffness(joints=K))
    p = add_constraint_conflict(plan_path(cell, path, options), cell, path, options, StageTimings())
    assert "10° at point 1, the rotation 12° at point 2" in p.conflict


def test_smallest_conflict_is_found_among_many() -> None:
    wishes = tuple(FixedRotation(k, 0.1) for k in range(40))
    bad = {wishes[7], wishes[31]}
    requested: list[int] = []

    def possible(some: object) -> bool:
        requested.append(1)
        return not bad <= set(some)  # type: ignore[call-overload]

    assert find_minimal_conflict(wishes, possible) == [wishes[7], wishes[31]]
    assert len(requested) < 30


def test_preferences_are_never_in_a_conflict() -> None:
    wishes = (SteeringRule(prefer=0.1), SteeringRule(operation="a", gamma=0.2))
    assert list_constraints(PlanOptions(steer=wishes)) == wishes[1:]
    assert format_steering_rule(wishes[1]) == "the rotation 11.4592° for operation 'a'"


def build_resting_motion(external: np.ndarray) -> ExportedMotion:
    """Return a motion with one sample at each point of :func:`two_operations`."""
    path, n = two_operations(), len(external)
    labels = tuple(path.operations[k].label for k in path.operation)
    zero = np.zeros(n)
    return ExportedMotion(
        time=zero,
        point=np.arange(n, dtype=float),
        move=path.move,
        q=np.zeros((n, 6)),
        external=external,
        operation=labels,
        gamma=zero,
        feed=zero,
    )


def test_verifier_detects_a_wrong_external_joint(tmp_path: Path) -> None:
    cell, path = external_cell(tmp_path, rail=True), two_operations()
    n = len(path)
    numbers = {"gamma_deg": np.zeros(n), "branch": np.full(n, 4.0), "limit_margin_deg": np.full(n, 9.0)}
    at = np.full((n, 1), 0.3)
    points = ExportedPoints(
        point=np.arange(n), q=np.zeros((n, 6)), external=at.copy(), status=("ok",) * n, numbers=numbers, words={}
    )
    pin = SteeringRule(points=(2, 4), joint="e1", at=0.3, unit="mm")
    zone = SteeringRule(operation="b", joint="rail", away=(0.31, 0.5), unit="mm")
    for options in (
        PlanOptions(collision=False, steer=(pin, zone)),
        PlanOptions(
            collision=False, external=(ExternalJointOptions(joint="rail", at_operations=(("a", 0.3),), unit="mm"),)
        ),
        PlanOptions(collision=False, external=(ExternalJointOptions(joint="rail", mode="locked", at=0.3, unit="mm"),)),
    ):
        (message,) = (
            c
            for c in check_requested_choices(cell, path, points, np.arange(n), options, build_resting_motion(at))
            if "external" in c.name
        )
        assert message.passed
        between = at.copy()
        between[3] += 0.0002  # between two points with a fixed rotation
        (message,) = (
            c
            for c in check_requested_choices(cell, path, points, np.arange(n), options, build_resting_motion(between))
            if "external" in c.name
        )
        assert (message.passed, message.unit, message.value) == (False, "mm off", pytest.approx(0.2))
        assert "point 3" in message.where
    points.external[6] = 0.33
    options = PlanOptions(collision=False, steer=(pin, zone))
    (message,) = (
        c
        for c in check_requested_choices(cell, path, points, np.arange(n), options, build_resting_motion(at))
        if "external" in c.name
    )
    assert (message.passed, message.value, message.where) == (False, pytest.approx(20.0), "point 6")


def test_verifier_detects_a_violated_zone_and_branch(tmp_path: Path) -> None:
    path = two_operations()
    n = len(path)
    numbers = {"gamma_deg": np.zeros(n), "branch": np.full(n, 4.0), "limit_margin_deg": np.full(n, 9.0)}
    points = ExportedPoints(
        point=np.arange(n), q=np.zeros((n, 6)), external=np.zeros((n, 0)), status=("ok",) * n, numbers=numbers, words={}
    )
    wishes = (
        SteeringRule(operation="a", forbid=(deg(-3), deg(40))),
        SteeringRule(operation="b", branch=4),
        SteeringRule(operation="b", gamma=0.0),
    )
    cell, options = external_cell(tmp_path), PlanOptions(collision=False, steer=wishes)

    def checks() -> dict[str, VerificationCheck]:
        return {
            c.name: c
            for c in check_requested_choices(
                cell, path, points, np.arange(n), options, build_resting_motion(np.zeros((n, 0)))
            )
        }

    by_name = checks()
    assert not by_name["requested: forbidden rotations"].passed
    assert by_name["requested: forbidden rotations"].value == pytest.approx(3.0)
    assert by_name["requested: branch"].passed
    assert by_name["requested: fixed rotations"].passed
    numbers["branch"][7] = 5.0
    wrong = checks()
    assert not wrong["requested: branch"].passed
    assert wrong["requested: branch"].where == "point 7"


def test_external_joint_has_the_value_of_its_operation(tmp_path: Path) -> None:
    """The value applies to each group; an operation without a value is left to the planner."""
    cell, path = external_cell(tmp_path, rail=True), two_operations()

    def stands(at: tuple[tuple[str, float], ...]) -> list[OperationGroup]:
        axes = resolve_axis_options(
            cell, PlanOptions(external=(ExternalJointOptions(joint="e1", at_operations=at, unit="mm"),))
        )
        return build_operation_groups(cell, path, build_planning_path(path), axes)

    first, second = stands((("b", 0.3),))
    assert (first.low[0], first.high[0]) == (cell.limits.lower[6], cell.limits.upper[6])
    assert (second.low[0], second.high[0], second.moving[0]) == (0.3, 0.3, False)
    for at, where in (((("c", 0.3),), "'c' is no operation"), ((("b", 99.0),), "at_operations_mm")):
        with pytest.raises(InputError, match=where):
            stands(at)


def test_pinned_rotation_holds_between_its_points(tmp_path: Path) -> None:
    """Value not on the grid: planning points between two fixed points would take grid rotations."""
    p = job(tmp_path, rotation_step=deg(30), steer=(SteeringRule(points=(2, 8), gamma=deg(71.3)),))
    rows = (p.path.index >= 2) & (p.path.index <= 8)
    assert is_complete(p)
    assert (rows & ~p.path.is_point).any()
    assert np.degrees(compute_gamma(p)[rows]) == pytest.approx(71.3, abs=np.degrees(EXACT))


def test_separate_point_divides_a_pin() -> None:
    options = PlanOptions(fixed=(FixedRotation(5, 0.9),), steer=(SteeringRule(points=(2, 8), gamma=0.5),))
    laid = resolve_steering(options, toolpath(pass_over_block()))
    assert laid.steer == (SteeringRule(points=(2, 4), gamma=0.5), SteeringRule(points=(6, 8), gamma=0.5))
    assert resolve_steering(laid, toolpath(pass_over_block())) == laid


PIN = SteeringRule(points=(3, 3), joint="rail", at=0.4, unit="mm")


def on_rail(folder: Path, *wishes: SteeringRule, mode: ExternalMode | None = None, before: Plan | None = None) -> Plan:
    """A slot of 2 m along the rail, 24 points from −1 m to 1 m."""
    cell = replace(external_cell(folder, rail=True), stiffness=ArmStiffness(joints=K))
    force = ProcessForce(normal=200.0, axial=100.0)
    options = PlanOptions(collision=False, rotation_step=deg(30), force=force, sample=0.02, steer=wishes)
    options = replace(options, external=() if mode is None else (ExternalJointOptions(joint="rail", mode=mode),))
    return find_best_plan(cell, long_slot(1.0), options, before=before)


@pytest.mark.slow
def test_pinned_rail_is_reached_at_its_point_and_moves_elsewhere(tmp_path: Path) -> None:
    """Two rail positions and a zone in one run: no constant rail position satisfies them."""
    zone = SteeringRule(points=(18, 21), joint="rail", away=(0.2, 2.5), unit="mm")
    p = on_rail(tmp_path, PIN, SteeringRule(points=(12, 14), joint="e1", at=-0.2, unit="mm"), zone)
    assert is_complete(p)
    rail = p.path.external[:, 0]
    at = rail[p.path.is_point]
    assert at[3] == pytest.approx(0.4, abs=1e-12)
    between = (p.path.index >= 12) & (p.path.index <= 14)
    assert rail[between] == pytest.approx(-0.2, abs=1e-12)
    assert (rail[(p.path.index >= 18) & (p.path.index <= 21)] <= 0.2 + 1e-12).all()
    motion = build_timeline(p, long_slot(1.0)).trajectory
    assert motion is not None  # the motion is within the limits of every axis
    on = (motion.point >= 12) & (motion.point <= 14)
    assert np.abs(motion.external[on, 0] + 0.2).max() < 2e-5  # also between the points of one rule
    assert np.interp(3.0, motion.point, motion.external[:, 0]) == pytest.approx(0.4, abs=1e-4)


@pytest.mark.slow
def test_constant_rail_uses_the_pinned_place(tmp_path: Path) -> None:
    p = on_rail(tmp_path, PIN, mode="operation")
    assert (p.path.external == 0.4).all()
    locked = on_rail(tmp_path, PIN, mode="locked")
    assert (locked.path.external == 0.4).all()
    assert any("rail at 400 mm at point 3 (steer) goes before its lock at 0 mm" in h for h in list_hints(locked))
    assert not any("goes before" in h for h in list_hints(p))
    zoned = on_rail(tmp_path, SteeringRule(joint="rail", away=(-0.5, 0.6), unit="mm"), mode="operation")
    assert not ((zoned.path.external > -0.5) & (zoned.path.external < 0.6)).any()
    with pytest.raises(InputError, match=r"rail at 400 mm at point 3 and rail at -200 mm at point 12.* mode: moving"):
        on_rail(tmp_path, PIN, SteeringRule(points=(12, 12), joint="rail", at=-0.2, unit="mm"), mode="operation")


@pytest.mark.parametrize(
    ("wish", "told"),
    [
        ({"joint": "tabel", "at": 0.1, "unit": "mm"}, "'tabel' is no external joint"),
        ({"joint": "rail", "at": 0.1, "unit": "deg"}, "'rail' slides; a place in mm would work"),
        ({"joint": "rail", "at": 9.0, "unit": "mm"}, "rail at 9000 mm at point 3: the range of 'rail' is"),
        ({"joint": "rail", "away": (0.3, 0.5), "unit": "mm"}, "rail at 400 mm at point 3 and rail not between 300 mm"),
    ],
)
def test_impossible_joint_place_is_refused(tmp_path: Path, wish: dict[str, object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        on_rail(tmp_path, PIN, SteeringRule(points=(3, 3), **wish))  # type: ignore[arg-type]


@pytest.mark.slow
def test_pinned_rail_with_unreachable_points_is_named(tmp_path: Path) -> None:
    cell = replace(external_cell(tmp_path, rail=True), stiffness=ArmStiffness(joints=K))
    far = SteeringRule(points=(3, 3), joint="rail", at=2.4, unit="mm")
    near = SteeringRule(points=(20, 20), joint="rail", at=0.5, unit="mm")
    options = PlanOptions(collision=False, rotation_step=deg(30), sample=0.02, steer=(far, near))
    p = find_best_plan(cell, long_slot(1.0), options)
    assert not is_complete(p)
    conflict = add_constraint_conflict(p, cell, long_slot(1.0), options, StageTimings()).conflict
    assert "rail at 2400 mm at point 3" in conflict
    assert "500 mm" not in conflict


def test_place_is_read_back_as_written() -> None:
    given = [
        {"point": 7, "external": "rail", "at_mm": 400.0},
        {"operation": "a", "external": "e2", "forbid_deg": [-20.0, 30.0]},
    ]
    assert [format_steering(parse_steering(SteerKeys.model_validate(entry))) for entry in given] == given
    for bad, message in (
        ({"point": 7, "at_mm": 1.0}, "external: names"),
        ({"point": 7, "external": "rail"}, "no place"),
        ({"external": "rail", "at_mm": 1.0, "at_deg": 2.0}, "at_mm and at_deg"),
        ({"external": "rail", "at_mm": 1.0, "gamma_deg": 2.0}, "two entries"),
        ({"external": "rail", "forbid_mm": [3.0, 1.0]}, "from < to"),
    ):
        with pytest.raises(ValidationError, match=message):
            SteerKeys.model_validate(bad)
