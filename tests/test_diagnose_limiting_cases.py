"""Limiting cases of laws: the simpler of two equivalent laws is named; implausible laws have no name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_model_selection import build_synthetic_problem, law
from test_diagnose_session_errors import CELL, CELLS, simulate_correct_sessions

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue, Quantity
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.attribution import limiting_case_laws
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search import search_iterations, selected_effect
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment

KNEE, STEP = "joint_nonlinear_stiffness", "joint_backlash"


def mix_columns(one: np.ndarray, two: np.ndarray, share: float) -> np.ndarray:
    return np.asarray(share * one + np.sqrt(1.0 - share**2) * two)


@pytest.mark.parametrize(
    ("true_knee", "softer", "alike", "named"),
    [
        (60.0, 1.0, 0.999, STEP),  # threshold below every load: a step fits as well
        (300.0, 1.0, 0.999, KNEE),  # threshold within the loads
        (60.0, -1.0, 0.999, KNEE),  # stiffer below the threshold, which backlash cannot cause
        (60.0, 1.0, 0.8, KNEE),  # these data exclude the step
    ],
)
def test_threshold_below_every_load_is_backlash_unless_excluded(
    true_knee: float, softer: float, alike: float, named: str
) -> None:
    problem, column = build_synthetic_problem(21, extra=40e-6 * softer)
    rng = np.random.default_rng(2)
    half = len(column) // 2
    other, noise = (np.tile(rng.standard_normal((half, *column.shape[1:])), (2, 1, 1)) for _ in range(2))
    at = {true_knee: column, 360.0 - true_knee: other}
    knees = replace(
        law(column, KNEE, "joint:2"),
        columns=lambda shape: at[shape[0]],
        shapes=((60.0,), (300.0,)),
        quantities=lambda x, shape: {"stiffness_change": Quantity(1e6 * float(x[0]), "µm")},
    )
    step = law(mix_columns(column, noise, alike), STEP, "joint:2")
    d = selection_pipeline.diagnose_problem(
        problem, HypothesisCatalogue((knees, step)), selection_pipeline.DiagnosisOptions(), rng
    )
    assert [f.effect for f in d.findings] == [named]
    assert ((KNEE, "joint:2") in d.findings[0].one_of and (STEP, "joint:2") in d.findings[0].one_of) is (alike > 0.9)


@pytest.mark.parametrize(("further", "named"), [(0.05, STEP), (1.0, KNEE)])
def test_slopes_much_better_than_a_step_keep_their_name(
    further: float, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pins that make contact one after the other were named backlash: the paired comparison did not exclude
    backlash, although its gain was only half."""
    problem, column = build_synthetic_problem(26)
    other = np.tile(np.random.default_rng(4).standard_normal((len(column) // 2, *column.shape[1:])), (2, 1, 1))
    both = np.concatenate([column, other], axis=2)
    problem = replace(problem, y=problem.y + both @ np.array([40e-6, 40e-6 * further]))
    knees = replace(
        law(column, KNEE, "joint:2"),
        columns=lambda shape: both if shape[0] < 100.0 else both[::-1],
        shapes=((60.0, 200.0), (300.0, 360.0)),
        quantities=lambda x, shape: {"stiffness_change": Quantity(1e6 * float(x[0]), "µm")},
    )
    state = search_iterations.search_iteratively(
        problem, HypothesisCatalogue((knees, law(column, STEP, "joint:2"))), 3, 0
    )
    chosen = (selected_effect.SelectedEffect(score_hypotheses(state.base, [state.whitened_hypotheses[0]])[0], 0.001),)
    monkeypatch.setattr(
        limiting_case_laws, "find_rival_explanations", lambda *_: ([], [(KNEE, "joint:2"), (STEP, "joint:2")])
    )
    assert [
        c.whitened.hypothesis.effect
        for c in limiting_case_laws.rename_limiting_cases(replace(state, chosen=chosen)).chosen
    ] == [named]


@pytest.mark.parametrize("longest", [True, False])
def test_creep_without_decay_is_hysteresis(longest: bool) -> None:
    problem, column = build_synthetic_problem(22, extra=40e-6)
    rng = np.random.default_rng(2)
    noise = np.tile(rng.standard_normal((len(column) // 2, *column.shape[1:])), (2, 1, 1))
    at = {300.0 if longest else 20.0: column, 20.0 if longest else 300.0: noise}
    creep = replace(
        law(column, "joint_creep", "joint:3"), columns=lambda shape: at[shape[0]], shapes=((20.0, 0.0), (300.0, 0.0))
    )
    loop = law(mix_columns(column, noise, 0.9999), "joint_hysteresis", "joint:3")
    d = selection_pipeline.diagnose_problem(
        problem, HypothesisCatalogue((creep, loop)), selection_pipeline.DiagnosisOptions(), rng
    )
    assert [f.effect for f in d.findings] == ["joint_hysteresis" if longest else "joint_creep"]


def test_implausible_law_keeps_its_place_without_a_name() -> None:
    problem, column = build_synthetic_problem(23, extra=40e-6)
    impossible = replace(law(column), is_plausible=lambda x, shape: float(x[0]) < 1e-6)
    d = selection_pipeline.diagnose_problem(
        problem, HypothesisCatalogue((impossible,)), selection_pipeline.DiagnosisOptions(), np.random.default_rng(2)
    )
    assert (d.findings, d.verdict) == ((), "unexplained")
    assert any("numbers that nothing built has" in n for n in d.notes)


def test_drift_is_unnamed_where_days_differ_by_a_larger_effect() -> None:
    problem, column = build_synthetic_problem(25)
    rng = np.random.default_rng(2)
    first = (problem.session == 0)[:, None, None]
    spoilt = replace(problem, y=problem.y + (60e-6 * column * first)[:, :, 0])
    drift = replace(
        law(mix_columns(column * first, rng.standard_normal(column.shape), 0.6), "thermal_drift"), family="environment"
    )
    d = selection_pipeline.diagnose_problem(
        spoilt, HypothesisCatalogue((drift, law(column))), selection_pipeline.DiagnosisOptions(), rng
    )
    assert (d.findings, d.verdict) == ((), "unexplained")
    sound = replace(problem, y=problem.y + 60e-6 * drift.columns(())[:, :, 0])
    d = selection_pipeline.diagnose_problem(
        sound, HypothesisCatalogue((drift, law(column))), selection_pipeline.DiagnosisOptions(), rng
    )
    assert [f.effect for f in d.findings] == ["thermal_drift"]


def test_compensator_torque_is_limited_by_the_weight() -> None:
    cell, r = load_cell(CELLS / CELL), simulate_correct_sessions()
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    masses = load_masses(cell)
    _, tried, _ = load_test_channel.build_load_test_problem(
        r, build_load_test_experiment(r, robot, T), robot, T, masses
    )
    balancer = next(h for h in tried.hypotheses if h.effect == "gravity_compensator")
    shape = balancer.shapes[5]
    assert balancer.is_plausible(np.array([0.0, 5e3]), shape)
    assert not balancer.is_plausible(np.array([0.0, 1e7]), shape)
    _, tried, _ = load_test_channel.build_load_test_problem(
        r, build_load_test_experiment(r, robot, T), robot, T, None
    )  # with unknown weight, the compensator cannot be separated from it
    assert "gravity_compensator" not in {h.effect for h in tried.hypotheses}
    assert "gravity_compensator" in {u.effect for u in tried.untestable}


def laws_of_two_forms(one: float, two: float) -> DiagnosisResult:
    """Diagnose a mismatch between two laws of one effect that give sizes differing by a factor of two."""
    problem, column = build_synthetic_problem(24, extra=60e-6)
    rng = np.random.default_rng(2)
    a, b = (np.tile(rng.standard_normal((len(column) // 2, *column.shape[1:])), (2, 1, 1)) for _ in range(2))
    near = replace(law(mix_columns(column, a, one)), law="near")
    far = replace(
        law(mix_columns(column, b, two)),
        law="far",
        quantities=lambda x, shape: {"size": Quantity(2e6 * float(x[0]), "µm")},
    )
    return selection_pipeline.diagnose_problem(
        problem, HypothesisCatalogue((near, far)), selection_pipeline.DiagnosisOptions(), rng
    )


@pytest.mark.parametrize(("one", "two", "both"), [(0.98, 0.977, True), (1.0, 0.97, False)])
def test_interval_covers_equally_good_forms(one: float, two: float, both: bool) -> None:
    """The interval covers both laws where neither is exact; an exact law has no model uncertainty."""
    d = laws_of_two_forms(one, two)
    low, high = d.findings[0].parameters["size"].ci95
    assert low < 60.0 < high
    assert (high > 110.0) is both
