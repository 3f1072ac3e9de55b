"""Explanations of a plan: each text is checked on one small plan with changed results."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from test_planning_path import Rows, toolpath
from test_planning_pipeline import UP, C, R, small_job

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stiffness import ModelDiscrepancy, PositionError
from machopt.planning.pipeline.plan_data_types import PathCompensation, Plan
from machopt.planning.plan_output.document_sections import build_worst_point_entry
from machopt.planning.plan_output.infeasibility_reasons import _describe_lost_by_shift, explain_points, list_breaks
from machopt.planning.plan_output.infeasibility_remedies import describe_remedy
from machopt.planning.plan_output.plan_remarks import describe_model_misfit, list_hints
from machopt.planning.plan_output.point_table import build_point_table, find_reason
from machopt.planning.uncertainty.measured_tcp_error import predict_position_error
from machopt.stiffness.arm_stiffness import ArmElasticity

ROWS: Rows = []
for y in (-0.1, 0.1):
    ROWS.append(((-0.1, y, 0.08), UP, R))
    ROWS += [((-0.1 + 0.05 * k, y, 0.01), UP, C) for k in range(4)]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Two passes over the block with a rapid move between them; reachable and free of collisions."""
    p = small_job(tmp_path_factory.mktemp("explained"), ROWS, PlanOptions(rotation_step=np.radians(30.0)))
    assert len(p.missing) == 0
    return p


def replace_answer(plan: Plan, **changes: np.ndarray) -> Plan:
    """Return the plan with another assignment."""
    assignment = replace(plan.chosen.assignment, **changes)
    return replace(plan, chosen=replace(plan.chosen, assignment=assignment))


def lose_row(plan: Plan, row: int, why: InfeasibilityReason) -> Plan:
    reason = plan.chosen.assignment.reason.copy()
    reason[row] = why
    return replace_answer(plan, reason=reason)


def test_change_of_configuration_between_runs_is_reported(made: Plan) -> None:
    assert not any("changes its configuration" in h for h in list_hints(made))
    first, last = made.path.runs[1]
    branch, q = made.chosen.assignment.branch.copy(), made.chosen.assignment.q.copy()
    was = int(branch[first])
    branch[first : last + 1] = was + 1
    at = f"before point {made.path.index[first]:g}"
    assert any(f"branch {was} → {was + 1} {at}" in h for h in list_hints(replace_answer(made, branch=branch)))
    q[first : last + 1, 5] += 2 * np.pi
    turned = 360.0 + np.degrees(made.chosen.assignment.q[first, 5] - made.chosen.assignment.q[made.path.runs[0][1], 5])
    assert any(f"joint 6 unwinds {turned:.0f}° {at}" in h for h in list_hints(replace_answer(made, q=q)))


def test_force_beyond_linear_elasticity_is_reported(made: Plan) -> None:
    bent = replace(made.chosen, cost=np.full(len(made.path.index), 0.05))
    other = replace(made, chosen=bent, scores=replace(made.scores, index="deflection"))
    (output,) = (h for h in list_hints(other) if "bends the arm" in h)
    assert "by up to 50 mm, beyond linear elasticity" in output
    assert "is force_N in N" in output
    small = replace(other, chosen=replace(bent, cost=bent.cost / 1e3))
    assert not any("bends the arm" in h for h in list_hints(small))


def test_advice_follows_the_reason(made: Plan) -> None:
    row = made.path.runs[0][1]
    assert "what helps at the gap" in describe_remedy(lose_row(made, row, InfeasibilityReason.GAP), row)
    assert "another path in the CAM file would help" in describe_remedy(
        lose_row(made, row, InfeasibilityReason.GOUGING), row
    )
    assert "compensation_max_mm" in describe_remedy(lose_row(made, row, InfeasibilityReason.SHIFT), row)


def test_near_point_is_not_advised_to_move_by_zero(made: Plan) -> None:
    """An arm without a wrist centre has no nearest configuration and no shortfall in length."""
    row = int(made.path.stations[0])
    c = made.candidates
    reason, shortfall = c.reason.copy(), c.shortfall.copy()
    reason[0] = InfeasibilityReason.UNREACHABLE
    out_of_reach = replace(made, candidates=replace(c, reason=reason, dropped=None))
    beyond = lose_row(out_of_reach, row, InfeasibilityReason.UNREACHABLE)
    message = [
        explain_points(p)[row]
        for p in (beyond, _set_shortfall(beyond, shortfall, 0.0), _set_shortfall(beyond, shortfall, 0.05))
    ]
    assert message[0] == message[1]
    assert "not too far away" in message[0]
    assert "(0, 0, 0)" not in describe_remedy(beyond, row)
    assert "machopt place" in describe_remedy(beyond, row)
    assert "50 mm outside the workspace" in message[2]
    assert "moving the part by about (" in describe_remedy(_set_shortfall(beyond, shortfall, 0.05), row)


def _set_shortfall(plan: Plan, shortfall: np.ndarray, by: float) -> Plan:
    """Return the plan with its first station out of reach by the given distance in m."""
    lacks = shortfall.copy()
    lacks[0] = by
    return replace(plan, candidates=replace(plan.candidates, shortfall=lacks))


def test_feasible_but_unconnected_rotations_are_counted(made: Plan) -> None:
    row = made.path.runs[0][1]
    s = min(int(np.searchsorted(made.path.stations, row)), len(made.path.stations) - 1)
    working = int((made.candidates.reason_of_rotation()[s] == InfeasibilityReason.OK).sum())
    assert working > 0
    output = explain_points(lose_row(made, row, InfeasibilityReason.NO_PATH))[row]
    assert output.startswith(f"{working} of {len(made.candidates.phi)} rotations work here, but none can be reached")


def test_bodies_in_contact_at_a_point_are_named(made: Plan) -> None:
    assert made.check is not None
    assert made.setup.collision is not None
    row, pair = made.path.runs[0][1], made.check.pair.copy()
    pair[row] = 0
    touching = lose_row(replace(made, check=replace(made.check, pair=pair)), row, InfeasibilityReason.COLLIDING)
    own = made.setup.collision.pairs[0]
    assert own.kinds == ("link", "link")
    output = explain_points(touching)[row]
    assert output.startswith(f"{own.name} touch or come nearer than the clearance")
    assert f"ignore_pairs: [[{own.a}, {own.b}]]" in output  # bodies of the robot itself may be adjacent


def test_place_between_two_points_is_a_separate_break(made: Plan) -> None:
    between = np.flatnonzero(~made.path.is_point)
    assert len(between)
    row = int(between[0])
    (one,) = list_breaks(lose_row(made, row, InfeasibilityReason.LIMIT))
    assert one.code == "no_pose"
    assert (one.before, one.after) == (np.floor(made.path.index[row]), np.ceil(made.path.index[row]))
    assert one.text.startswith(f"at {made.path.index[row]:.2f} between them: ")
    point = int(np.searchsorted(made.path.index, one.after))
    both = lose_row(lose_row(made, row, InfeasibilityReason.LIMIT), point, InfeasibilityReason.LIMIT)
    assert list_breaks(both) == ()  # the point itself has the explanation


def test_stiffness_misfit_is_reported_with_its_use(made: Plan) -> None:
    stiffness = made.setup.elasticity.stiffness
    none = np.zeros((1, 6))
    for counted, words in (
        (True, "count in, in the mean"),
        (False, "of the springs alone (discrepancy.counted: false)"),
    ):
        model_discrepancy = ModelDiscrepancy(
            parts=tuple(f"joint {j}" for j in range(1, 7)), torque=np.ones(6), shift=none[0], modes=none, local=0.0,
            left=6e-5, noise=2e-5, misfit=True, counted=counted,
        )  # fmt: skip
        other = ArmElasticity(
            made.setup.robot, made.setup.arm.T_flange_tcp, replace(stiffness, discrepancy=model_discrepancy), None, None
        )
        output = describe_model_misfit(replace(made, setup=replace(made.setup, elasticity=other)))
        assert "0.06 mm of the readings it comes from, 3.0 times their noise of 0.02 mm" in output
        assert words in output
    assert describe_model_misfit(made) == ""


def test_reach_lost_by_a_shift_is_reported_with_its_size(made: Plan) -> None:
    assert made.check is not None
    assert made.setup.collision is not None
    row, pair = made.path.runs[0][1], made.check.pair.copy()
    offset = np.zeros((len(made.path.index), 3))
    offset[row] = [0.0, 0.0, 3e-4]
    shifted = replace(made, compensation=cast(PathCompensation, SimpleNamespace(offset=offset)))
    for named, words in ((0, made.setup.collision.pairs[0].name), (-1, "0.300 mm")):
        pair[row] = named
        output = _describe_lost_by_shift(
            replace(shifted, check=replace(made.check, pair=pair)), InfeasibilityReason.COLLIDING, row
        )
        assert output.startswith("possible as programmed, but not with the compensation of 0.300 mm: ")
        assert words in output
    lacks = SimpleNamespace(offset=offset, lost=np.arange(len(offset)) == row)
    for reason, key in (
        (InfeasibilityReason.COLLIDING, "clearance_mm"),
        (InfeasibilityReason.LIMIT, "a larger limit_margin_deg"),
    ):
        help_there = describe_remedy(
            replace(lose_row(made, row, reason), compensation=cast(PathCompensation, lacks)), row
        )
        assert key in help_there
        assert "no compensation would help; --allow-gaps" in help_there


def test_single_rotation_method_reports_other_feasible_rotations(made: Plan) -> None:
    row = made.path.runs[0][1]
    stopped = lose_row(made, row, InfeasibilityReason.LIMIT)
    for method, words in (("default", "the CAM file's own rotation"), ("jiao2022", "the rotation that jiao2022 takes")):
        one = replace(stopped, options=replace(made.options, method=method))  # type: ignore[arg-type]
        output = explain_points(one)[row]
        assert output.startswith(f"{words} does not work here (a joint would leave its range); ")
        assert "--method global" in describe_remedy(one, row)


def test_finer_step_is_advised_only_where_it_could_help(made: Plan) -> None:
    """The advice is not given if the nearest configuration exceeds a joint limit
    by more than one rotation step can change."""
    row = made.path.runs[0][1]
    stopped = lose_row(made, row, InfeasibilityReason.LIMIT)
    s = int(np.searchsorted(made.path.stations, row))
    reason = made.candidates.reason.copy()
    reason[s] = np.where(
        np.isfinite(made.candidates.q[s]).all(axis=-1), InfeasibilityReason.LIMIT, InfeasibilityReason.UNREACHABLE
    )
    of_joint = np.abs(np.asarray(made.candidates.q[s])[reason[s] == InfeasibilityReason.LIMIT]).min()
    for missed, margin, finer in ((np.radians(3.0), np.radians(5.0), True), (np.radians(36.0), np.radians(5.0), False)):
        upper = np.full(6, of_joint)
        upper[0] = np.nanmin(made.candidates.q[s][..., 0]) - missed
        arm = replace(made.setup.arm, lower=np.full(6, -10.0), upper=np.r_[upper[0], np.full(5, 10.0)])
        setup = replace(made.setup, arm=replace(arm, turns=np.zeros((1, 6))))
        options = replace(made.options, limit_margin=margin)
        help_there = describe_remedy(
            replace(stopped, setup=setup, options=options, candidates=replace(made.candidates, reason=reason)), row
        )
        assert ("a finer rotation_step_deg" in help_there) is finer
        assert ("smaller limit_margin_deg" in help_there) is finer
        assert "a wider joint range" in help_there


def test_active_options_are_not_advised(made: Plan) -> None:
    row = made.path.runs[0][1]
    stopped = lose_row(made, row, InfeasibilityReason.LIMIT)
    assert "--allow-gaps" in describe_remedy(stopped, row)
    assert "--allow-gaps" not in describe_remedy(replace(stopped, options=replace(made.options, allow_gaps=True)), row)


def test_point_without_a_path_has_the_reason_of_the_furthest_attempt(made: Plan) -> None:
    row = made.path.runs[0][1]
    s = min(int(np.searchsorted(made.path.stations, row)), len(made.path.stations) - 1)
    no_path, reason = lose_row(made, row, InfeasibilityReason.NO_PATH), made.candidates.reason.copy()
    assert find_reason(no_path, row) is InfeasibilityReason.NO_PATH  # some rotation is feasible
    assert find_reason(lose_row(made, row, InfeasibilityReason.LIMIT), row) is InfeasibilityReason.LIMIT
    feasible = made.candidates.feasible.copy()
    feasible[s] = False
    for given, message in (
        ((InfeasibilityReason.BOUNDS, InfeasibilityReason.LIMIT), InfeasibilityReason.LIMIT),
        ((InfeasibilityReason.BOUNDS,), InfeasibilityReason.BOUNDS),
    ):
        reason[s] = InfeasibilityReason.BOUNDS
        reason[s, 0] = given[-1]
        stopped = replace(no_path, candidates=replace(made.candidates, reason=reason.copy(), feasible=feasible))
        assert find_reason(stopped, row) is message


def test_residual_pose_error_is_reported_and_moves_nothing(made: Plan) -> None:
    """The joint range of the plan is covered, with and without the corrections, or one joint is outside."""
    q = made.chosen.assignment.q[made.path.counted]
    whole = np.stack([q.min(axis=0), q.max(axis=0)], axis=1)
    elasticity = made.setup.elasticity

    def told(joints: np.ndarray, *, corrected: bool) -> Plan:
        error = PositionError(5e-5, 3e-4, 2e-5, 40, joints)
        stiffness = replace(elasticity.stiffness, position=error)
        known = KinematicCorrections((KinematicCorrection("joint_zero_offset", "joint:1", {"offset_deg": 0.01}),))
        cell = replace(made.setup.cell, kinematics=known if corrected else None)
        springs = ArmElasticity(elasticity.robot, elasticity.T_flange_tcp, stiffness)
        return replace(made, setup=replace(made.setup, cell=cell, elasticity=springs))

    assert predict_position_error(made) is None
    found = predict_position_error(told(whole, corrected=True))
    assert found is not None
    assert (found.std, found.uncovered, found.joints) == (5e-5, 0.0, ())
    assert "± 0.05 mm" in describe_model_misfit(told(whole, corrected=True))
    plain = predict_position_error(told(whole, corrected=False))
    assert plain is not None
    assert plain.std == 3e-4
    assert "kinematics.yaml that was found with it" in plain.words()
    narrow = whole.copy()
    narrow[3] = np.median(q[:, 3]) + np.radians([-0.5, 0.5])
    outside = predict_position_error(told(narrow, corrected=True))
    assert outside is not None
    beyond = np.abs(q[:, 3] - np.median(q[:, 3])) > np.radians(1.5)
    assert outside.joints == ((4,) if beyond.any() else ())
    assert outside.uncovered == pytest.approx(beyond.mean())
    assert beyond.any() == ("joint 4" in outside.words())


def test_worst_point_is_a_driven_point(made: Plan) -> None:
    """A point excluded by a contact also has an index;
    it was reported as the worst point without rotation, an internal error."""
    path = toolpath(ROWS)
    worst = build_worst_point_entry(made, build_point_table(made, path))
    assert worst is not None
    stopped = lose_row(made, int(np.flatnonzero(made.path.is_point)[worst.point]), InfeasibilityReason.COLLIDING)
    other = build_worst_point_entry(stopped, build_point_table(stopped, path))
    assert other is not None
    assert other.point != worst.point


def test_rotations_unchecked_for_contacts_are_not_promised(made: Plan) -> None:
    """jiao2022 reported that 72 of 72 rotations work at a point where ``global`` found that all of them collide."""
    assert made.setup.collision is not None
    row = made.path.runs[0][1]
    one = replace(lose_row(made, row, InfeasibilityReason.COLLIDING), options=replace(made.options, method="jiao2022"))
    assert explain_points(one)[row].startswith("the rotation that jiao2022 takes does not work here (it collides); ")
    assert explain_points(one)[row].endswith("rotations do, collisions not checked")
    assert "which chooses among them, may help" in describe_remedy(one, row)
