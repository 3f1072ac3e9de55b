"""Effects outside the catalogue in load tests: reported with their location, never named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnose_load_test_drift import build_timed_readings
from test_effects import build_posed_problem

from machopt.effects.joint import angle_dependent_stiffness
from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue, Quantity
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import gravity_compensator, joint_torque, sensor_errors, thermal_drift
from machopt.measurement.diagnosis.model_selection import selection_pipeline, unmodelled_slip_and_external_forces
from machopt.measurement.diagnosis.model_selection.attribution import naming_stages, uncatalogued_form_guard
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search import law_error, search_iterations, selected_effect


def catalogue(r: StaticReadings) -> HypothesisCatalogue:
    return HypothesisCatalogue(
        (
            *sensor_errors.build_load_test_sensor_hypotheses(r),
            *unmodelled_slip_and_external_forces.build_interface_hypotheses(r),
        )
    )


@pytest.mark.parametrize(
    "law", [unmodelled_slip_and_external_forces.SLIP_LAW, unmodelled_slip_and_external_forces.JUMP_LAW]
)
def test_unnamed_effect_is_reported_with_its_place(law: str) -> None:
    r, _, _ = build_timed_readings()
    true = next(h for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r) if h.law == law)
    size = np.eye(9)[2] if law == unmodelled_slip_and_external_forces.JUMP_LAW else np.ones(1)
    moved = true.columns((0.6,)) @ (8e-5 * size)
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved), catalogue(r), selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if f"something at {true.location}" in n]
    assert next(s.axis for s in found.mismatch if s.kind == "machine") == true.location
    assert not {x.effect for x in found.limits} & {true.effect}


def test_catalogue_effect_is_named_beside_an_unnamed_one() -> None:
    r, _, _ = build_timed_readings()
    turned = next(h for h in sensor_errors.build_load_test_sensor_hypotheses(r) if h.effect == "force_sensor_offset")
    slips = next(
        h
        for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r)
        if h.law == unmodelled_slip_and_external_forces.SLIP_LAW
    )
    moved = turned.columns(turned.shapes[0]) @ np.full(3, 60.0) + slips.columns((0.6,)) @ np.full(1, 8e-5)
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved), catalogue(r), selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert [f.effect for f in found.findings] == ["force_sensor_offset"]
    assert found.verdict == "partly_explained"


def test_slip_begins_above_its_load_and_remains_in_the_cycle() -> None:
    along = np.array([[1.0, 0, 0]] * 4 + [[0, 1.0, 0]] * 3)
    share = np.array([0.3, 0.8, 1.0, 0.2, 0.3, 0.5, 0.2])
    slipped = unmodelled_slip_and_external_forces._compute_slip_direction(
        along, share, np.array([0, 0, 0, 0, 1, 1, 1]), 0.6
    )
    np.testing.assert_array_equal(slipped, [[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0], *np.zeros((3, 3))])


def test_friction_of_a_jack_delays_unloading() -> None:
    share, cycle = np.array([0.5, 1.0, 0.5, 1.0, 0.4]), np.array([0, 0, 0, 1, 1])
    np.testing.assert_array_equal(
        unmodelled_slip_and_external_forces._compute_load_direction(share, cycle), [-1, -1, 1, -1, 1]
    )


def compute_rest_position(
    r: StaticReadings, wrench: np.ndarray, pull: np.ndarray, spring: float, at: np.ndarray
) -> np.ndarray:
    """Return the TCP (N, 3) in m under a load and the pull f₀ − k (p − at) of a hose at the flange, with joint
    deflection."""
    theta = np.zeros_like(r.state.q)
    back = r.T_flange_tcp[:3, :3].T @ r.T_flange_tcp[:3, 3]
    for _ in range(12):
        state = r.robot.compute_state(r.state.q + theta, r.T_flange_tcp, bodies=True)
        lever = -state.T_base_tool[:, :3, :3] @ back
        end = state.J[:, :3] + np.cross(state.J[:, 3:], lever[:, :, None], axis=1)
        force = pull - spring * (state.T_base_tool[:, :3, 3] + lever - at)
        theta = r.compliance * (np.einsum("nci,nc->ni", state.J, wrench) + np.einsum("nci,nc->ni", end, force))
    return r.robot.compute_state(r.state.q + theta, r.T_flange_tcp).T_base_tool[:, :3, 3]


def test_external_pull_changes_displacements_as_in_equilibrium() -> None:
    r, _, _ = build_timed_readings()
    pulled = next(
        h
        for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r)
        if (h.law, h.location) == (unmodelled_slip_and_external_forces.PULL_LAW, "tool")
    )
    at, none = unmodelled_slip_and_external_forces._compute_flange_positions(r).mean(axis=0), np.zeros_like(r.wrench)
    pull, spring, small = np.array([30.0, -20.0, 50.0]), 25.0, 0.05 * r.wrench
    moved = compute_rest_position(r, small, pull, spring, at) - compute_rest_position(r, none, pull, spring, at)
    alone = compute_rest_position(r, small, np.zeros(3), 0.0, at) - compute_rest_position(r, none, np.zeros(3), 0.0, at)
    true = (moved - alone) / 0.05
    first = (pulled.columns(()) @ [*pull, spring])[:, :3]
    assert np.abs(first - true).max() < 0.03 * np.abs(true).max()


@pytest.mark.parametrize("where", ["link:4", "tool"])
def test_hose_is_located_and_is_no_gear_or_compensator(where: str) -> None:
    r, _, _ = build_timed_readings()
    pulled = next(
        h
        for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r)
        if (h.law, h.location) == (unmodelled_slip_and_external_forces.PULL_LAW, where)
    )
    moved = pulled.columns(()) @ [1.0, -0.5, 2.0, 1.5]
    moved *= 1e-4 / np.abs(moved[:, :3]).max()
    known = [
        *gravity_compensator.build_load_test_hypotheses(r),
        *sensor_errors.build_load_test_sensor_hypotheses(r),
        *unmodelled_slip_and_external_forces.build_interface_hypotheses(r),
    ]
    for j in range(6):
        known += joint_torque.build_joint_hypotheses(r, j, angle_dependent_stiffness.EFFECT)[0]
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved),
        HypothesisCatalogue(tuple(known)),
        selection_pipeline.DiagnosisOptions(),
        np.random.default_rng(0),
    )
    assert found.findings == ()
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if "hose or a cable" in n]


def test_sinking_floor_on_one_day_is_no_thermal_drift() -> None:
    r, _, _ = build_timed_readings()
    share = np.linalg.norm(r.wrench[:, :3], axis=1)
    moved = np.zeros((len(r), 6))
    moved[:, 2] = -5e-5 * (share / share.max()) ** 2 * (r.session == r.session.max())
    known = HypothesisCatalogue(
        (
            *thermal_drift.build_thermal_hypotheses(r),
            *sensor_errors.build_load_test_sensor_hypotheses(r),
            *unmodelled_slip_and_external_forces.build_interface_hypotheses(r),
        )
    )
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved), known, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert (found.findings, found.verdict) == ((), "unexplained")
    assert [n for n in found.notes if "in one session" in n]


def test_named_effect_beside_an_unnamed_form_must_be_large() -> None:
    """A hose is slack in some poses: the residual of the unnamed form there was named angle-dependent joint
    stiffness."""
    r, _, _ = build_timed_readings()
    forms = {
        h.law: h for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r) if h.location == "tool"
    }
    other = SimpleNamespace(
        whitened=SimpleNamespace(
            hypothesis=joint_torque.build_joint_hypotheses(r, 2, angle_dependent_stiffness.EFFECT)[0][0]
        )
    )
    least = []
    for form in (
        forms[unmodelled_slip_and_external_forces.PULL_LAW],
        forms[unmodelled_slip_and_external_forces.SLIP_LAW],
    ):
        scored = SimpleNamespace(whitened=SimpleNamespace(hypothesis=form), gain=600.0)
        chosen = selected_effect.SelectedEffect(scored, 0.0)  # type: ignore[arg-type]
        least.append(law_error.compute_law_error(other, [chosen]))
    assert least == pytest.approx([150.0, 36.0])


def test_hose_slack_in_some_poses_is_no_joint_effect() -> None:
    r, _, _ = build_timed_readings()
    pulled = next(
        h
        for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r)
        if (h.law, h.location) == (unmodelled_slip_and_external_forces.PULL_LAW, "tool")
    )
    taut = r.recording.pose % 4 > 0
    moved = pulled.columns(()) @ [1.0, -0.5, 2.0, 1.5] * taut[:, None]
    moved *= 1e-4 / np.abs(moved[:, :3]).max()
    known = [
        *gravity_compensator.build_load_test_hypotheses(r),
        *sensor_errors.build_load_test_sensor_hypotheses(r),
        *unmodelled_slip_and_external_forces.build_interface_hypotheses(r),
    ]
    for j in range(6):
        known += joint_torque.build_joint_hypotheses(r, j, angle_dependent_stiffness.EFFECT)[0]
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved),
        HypothesisCatalogue(tuple(known)),
        selection_pipeline.DiagnosisOptions(),
        np.random.default_rng(0),
    )
    assert (found.findings, found.verdict) == ((), "unexplained")


@pytest.mark.parametrize(("off", "kept"), [(0.0, True), (0.3, False)])
def test_law_with_a_better_unnamed_form_has_no_name(off: float, kept: bool) -> None:
    """A hose between column and forearm was named gravity compensator, because an external pull did not fit better."""
    r, _, _ = build_timed_readings()
    pulled = next(
        h
        for h in unmodelled_slip_and_external_forces.build_interface_hypotheses(r)
        if (h.law, h.location) == (unmodelled_slip_and_external_forces.PULL_LAW, "link:4")
    )
    moved = pulled.columns(()) @ [1.0, -0.5, 2.0, 1.5]
    moved *= 1e-4 / np.abs(moved[:, :3]).max()
    other = pulled.columns(()) @ [0.3, 2.0, -1.0, 0.5]
    nearly = moved + off * other * np.linalg.norm(moved) / np.linalg.norm(other)
    named = replace(
        gravity_compensator.build_load_test_hypotheses(r)[0], columns=lambda shape: nearly[:, :, None], shapes=((),)
    )
    named = replace(named, is_plausible=lambda x, shape: True, correction=lambda x, shape: None)
    named = replace(named, quantities=lambda x, shape: {"variation": Quantity(float(x[0]), "%")})
    problem = build_posed_problem(r, moved)
    state = search_iterations.search_iteratively(problem, HypothesisCatalogue((named, pulled)), 3, 0)
    law = next(t for t in state.whitened_hypotheses if t.hypothesis is named)
    state = replace(state, chosen=(selected_effect.SelectedEffect(score_hypotheses(state.base, [law])[0], 0.002),))
    (effect,) = naming_stages.apply_naming_stages(state, np.random.default_rng(0)).chosen
    assert effect.whitened.hypothesis.is_in_catalogue is kept
    assert (uncatalogued_form_guard.UNCATALOGUED_REASON in effect.whitened.hypothesis.note) is not kept
