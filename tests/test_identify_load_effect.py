"""Load effect of hanging loads on the lever arms; fitted matrices are positive semidefinite."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_arm import TrueArm
from simulated_load_tests import TRUE_K, add_measurement_errors, cell, draw_load_tests, plan_load_tests

from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.errors import InputError
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.identification.fitting.positive_semidefinite_fit import (
    fit_semidefinite_matrix,
    has_negative_compliance,
    list_fitted_matrices,
)
from machopt.measurement.identification.fitting.weighted_fit import fit_stiffness
from machopt.measurement.identification.identification_pipeline import identify_stiffness
from machopt.measurement.identification.identification_result import IdentificationResult
from machopt.measurement.identification.options import IdentifyOptions
from machopt.stiffness.terms import build_fitted_term, compile_terms

SOFT = TRUE_K / 3.0


def hanging(seed: int, noise: float = 1.0) -> LoadTestExperiment:
    """Weights of up to 150 kg on lever arms of up to 0.3 m, at the exact equilibrium."""
    rng = np.random.default_rng(seed)
    _, robot, T = cell()
    force = np.zeros((20, 4, 3))
    force[..., 2] = -rng.uniform(500.0, 1500.0, (20, 4))
    arm = 0.3 * rng.uniform(-1, 1, (20, 4, 3))
    made = plan_load_tests(rng, k=SOFT, wrench=np.concatenate([force, np.cross(arm, force)], axis=-1))
    exact = TrueArm(robot, T, 1.0 / SOFT).displacement(made.q, made.wrench)
    return build_load_test_experiment(
        add_measurement_errors(replace(made, exact=exact), rng, noise=noise, outliers=0.0), robot, T
    )


def identify_joints(e: LoadTestExperiment, **options: object) -> IdentificationResult:
    _, robot, T = cell()
    return identify_stiffness(
        e, robot, T, ArmStiffness(joints=SOFT), IdentifyOptions(studies=False, **options), np.random.default_rng(0)
    )  # type: ignore[arg-type]


def test_hanging_loads_bias_the_linear_law_and_the_load_effect_corrects_it() -> None:
    e = hanging(1, noise=0.0)
    error = {}
    for on in (False, True):
        result = identify_joints(e, load_effect=on)
        observed = np.array([j.identified for j in result.joints])
        error[on] = np.abs(result.stiffness.joints / SOFT - 1)[observed].max()
        # the effect corrects the readings; it is not a term of the written stiffness
        assert result.stiffness.terms == ()
        assert any("K_C" in note for note in result.notes) == on
    assert error[False] > 2e-3
    assert error[True] < 0.05 * error[False]  # one correction round: the second-order effect remains


@pytest.mark.proof
def test_intervals_of_hanging_loads_cover_with_the_load_effect() -> None:
    inside, outside = {False: 0, True: 0}, {False: 0, True: 0}
    for seed in range(12):
        e = hanging(100 + seed, noise=0.3)
        for on in (False, True):
            for j, k in zip(identify_joints(e, load_effect=on).joints, SOFT, strict=True):
                if j.identified:
                    hit = j.interval[0] <= k <= j.interval[1]
                    inside[on] += hit
                    outside[on] += not hit
    share = {on: inside[on] / (inside[on] + outside[on]) for on in inside}
    assert share[True] > 0.78  # 60 intervals of 90 %: fewer occurs once in 200
    assert share[False] < share[True] - 0.1


def test_load_effect_inside_the_noise_is_ignored() -> None:
    e = draw_load_tests(np.random.default_rng(5))
    stiff, plain = (identify_joints(e, load_effect=on) for on in (True, False))
    if not any("K_C" in n for n in stiff.notes):
        np.testing.assert_array_equal(stiff.stiffness.joints, plain.stiffness.joints)
    np.testing.assert_allclose(stiff.stiffness.joints, plain.stiffness.joints, rtol=0.01)


def test_recording_without_an_equilibrium_falls_back_to_the_linear_law() -> None:
    e = draw_load_tests(np.random.default_rng(6))
    huge = replace(e, wrench=1e3 * e.wrench, measured=1e3 * e.measured)  # displacements of metres
    assert not any("K_C" in n for n in identify_joints(huge, load_effect=True, accept=frozenset({"units"})).notes)


@pytest.fixture(scope="module")
def full() -> tuple[LoadTestExperiment, StiffnessTerm]:
    """Return a fit with a base of three angular compliances and all 21 coefficients."""
    _, robot, T = cell()
    e = draw_load_tests(np.random.default_rng(7), poses=20)
    law = build_fitted_term("base_compliance", "base", robot, T, compliance_diagonal=[0, 0, 0, 3e-7, 2.5e-7, 0])
    return replace(
        e, measured=e.measured + (law.compute_response(e.state, e.wrench) @ law.values)[:, :3]
    ), StiffnessTerm("base_compliance", "base", {"form": "full"})


def test_fitted_matrix_is_positive_semidefinite_and_accepted_by_the_planner(
    full: tuple[LoadTestExperiment, StiffnessTerm], tmp_path: Path
) -> None:
    _, robot, T = cell()
    e, term = full
    free = fit_stiffness(e, compile_terms((term,), robot, T)[0])
    assert has_negative_compliance(list_fitted_matrices(free)[0].matrix(free.x))  # caused by noise
    result = identify_stiffness(
        e,
        robot,
        T,
        ArmStiffness(joints=TRUE_K),
        IdentifyOptions(terms=(term,), studies=False),
        np.random.default_rng(0),
    )
    assert any("would move against a load" in w for w in result.warnings)
    write_stiffness(tmp_path / "stiffness.yaml", result.stiffness)
    read = load_stiffness(tmp_path / "stiffness.yaml")
    compile_terms(read.terms, robot, T)  # this function refuses a negative compliance
    C = np.array(read.terms[0].parameters["compliance"])
    assert np.diag(C)[3] == pytest.approx(3e-7, rel=0.1)  # the readings determine the tilt compliance to some percent
    assert result.heldout is not None
    assert result.heldout.rmse < 1.3 * result.errors.rmse


def test_projected_matrix_is_the_minimum(full: tuple[LoadTestExperiment, StiffnessTerm]) -> None:
    """No other admissible matrix nearby has a smaller sum of squares (the problem is convex)."""
    _, robot, T = cell()
    e, term = full
    free = fit_stiffness(e, compile_terms((term,), robot, T)[0])
    part = list_fitted_matrices(free)[0]
    H, h = free.normal.total()
    H = H + 1e-9 * np.trace(H) / len(H) * np.eye(len(H))  # makes the minimum unique, also in directions without data
    x = fit_semidefinite_matrix(free, part, H, h, free.x, np.zeros(len(free.x), bool))
    assert not has_negative_compliance(part.matrix(x))

    def value(x: np.ndarray) -> float:
        u = x / free.column
        return float(0.5 * u @ H @ u - h @ u)

    rng = np.random.default_rng(0)
    for size in (1e-1, 1e-3):
        for _ in range(30):
            other = x.copy()
            root = np.linalg.cholesky(part.matrix(x) + 1e-12 * np.eye(6) * np.trace(part.matrix(x)))
            turned = root @ (np.eye(6) + size * rng.standard_normal((6, 6)))
            other[part.first_coefficient] = (turned @ turned.T)[part.row, part.column]
            other[:6] *= 1 + size * rng.standard_normal(6)
            assert value(other) > value(x) - 1e-3  # tolerance in squared standard errors


@pytest.mark.proof
def test_matrix_from_noise_alone_is_not_found() -> None:
    _, robot, T = cell()
    retained = 0
    for seed in range(8):
        e = draw_load_tests(np.random.default_rng(60 + seed), poses=15)
        term = StiffnessTerm("tool_compliance", "tool", {"form": "full"})
        options = IdentifyOptions(terms=(term,), studies=False)
        result = identify_stiffness(e, robot, T, ArmStiffness(joints=TRUE_K), options, np.random.default_rng(0))
        retained += bool(result.stiffness.terms)
    assert retained <= 3  # false positive rate of 10 % each: more occurs once in 200


def test_zero_redundancy_is_refused_and_few_equations_keep_every_reading() -> None:
    with pytest.raises(InputError, match="6 equations for 6 unknowns; at least 3 readings"):
        identify_joints(draw_load_tests(np.random.default_rng(8), poses=1, loads=2, repeats=1))
    few = identify_joints(draw_load_tests(np.random.default_rng(8), poses=3, loads=1, repeats=1))
    assert not few.outliers
    assert np.isfinite(few.errors.rmse)


def test_grid_of_millions_of_cells_is_refused_and_auto_stays_constant() -> None:
    e = draw_load_tests(np.random.default_rng(9), poses=14)
    with pytest.raises(InputError, match="more than the 8000 that a grid may have"):
        identify_joints(e, model="grid", grid_cell=0.005)
    result = identify_joints(e, model="auto", grid_cell=0.005)
    assert result.model == "constant"
    assert "no grid can be fitted" in result.why_model
