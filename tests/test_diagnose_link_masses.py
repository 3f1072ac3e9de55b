"""Link masses within their uncertainty are neither a payload nor a zero offset."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
from test_diagnose_tcp_poses import NDArray, RobotMasses, arm, build, measure

from machopt.effects import prior_scales
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.model_selection import selection_pipeline

ROOT = Path(__file__).resolve().parents[1]
NOISE = 2e-5  # m
TOOL = 25.0  # kg of an unknown payload at the flange


def scale_link_masses(relative: NDArray[np.float64]) -> RobotMasses:
    """Return the masses with links 1 to 6 multiplied by 1 + ``relative`` (6,); the tool mass is unchanged."""
    own = arm()[2]
    factor = np.ones(len(own.mass))
    for link in range(1, 7):
        first = np.flatnonzero(own.body == link)[:1]
        factor[first] += relative[link - 1]
    return replace(own, mass=own.mass * factor)


def with_payload(masses: RobotMasses) -> RobotMasses:
    _, robot, _ = arm()
    return replace(
        masses,
        body=np.append(masses.body, 6),
        mass=np.append(masses.mass, TOOL),
        com=np.vstack([masses.com, robot.T_base_flange_zero[:3, 3]]),
    )


def diagnose_with_masses(masses: RobotMasses, *, inputs: bool = True) -> DiagnosisResult:
    problem, catalogue = build(measure(masses=masses, noise=NOISE, registration="fixed"))
    if not inputs:
        catalogue = replace(catalogue, uncertain_inputs=None)
    options = selection_pipeline.DiagnosisOptions(is_static=True)
    return selection_pipeline.diagnose_problem(problem, catalogue, options, np.random.default_rng(0))


def test_columns_equal_finite_differences_of_a_link_mass() -> None:
    """Finite differences of an independently computed equilibrium."""
    _, catalogue = build(measure(registration="fixed"))
    inputs = catalogue.uncertain_inputs
    assert inputs is not None
    for k, u in enumerate(inputs.unknowns):
        link = int(u.location[-1])
        assert link in range(1, 6)
        step = np.zeros(6)
        step[link - 1] = 0.02
        observed, plain = measure(masses=scale_link_masses(step)).position, measure().position
        assert observed is not None
        assert plain is not None
        moved = (observed - plain) / 0.02
        # columns use the fitted springs, and neglect that weight rotates the axes of the other joints
        np.testing.assert_allclose(inputs.columns[:, :3, k], moved, atol=0.05 * np.abs(moved).max())


def test_masses_within_their_uncertainty_are_not_named() -> None:
    off = np.random.default_rng(3).normal(0.0, prior_scales.LINK_MASS.scale, 6)
    off[1:3] = np.sign(off[1:3]) * 0.06  # deviations of the upper arm and forearm that are always detectable
    off[5] = 0.0
    assert diagnose_with_masses(scale_link_masses(off), inputs=False).findings
    found = diagnose_with_masses(scale_link_masses(off))
    assert not found.findings
    assert found.verdict == "consistent"


def test_payload_beside_mass_uncertainty_has_a_covering_interval() -> None:
    found = diagnose_with_masses(with_payload(scale_link_masses(np.array([0.0, 0.05, -0.05, 0.04, -0.04, 0.0]))))
    assert [f.effect for f in found.findings] == ["payload"]
    low, high = found.findings[0].parameters["mass"].ci95
    assert low <= TOOL <= high


def test_masses_far_outside_the_uncertainty_are_a_mismatch() -> None:
    found = diagnose_with_masses(scale_link_masses(np.array([0.0, 0.5, -0.5, 0.0, 0.0, 0.0])))
    assert found.verdict != "consistent"


def test_every_prior_is_a_row_of_the_table() -> None:
    """No literal number is passed as the prior of a base unknown or of a law."""
    for path in (*(ROOT / "machopt/effects").rglob("*.py"), *(ROOT / "machopt/measurement").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.keyword) and node.arg in ("prior", "prior_sigma"):
                assert not any(
                    isinstance(n, ast.Constant) and isinstance(n.value, float) for n in ast.walk(node.value)
                ), path
    for row in prior_scales.PRIOR_SCALES:
        assert row.scale > 0.0
        assert row.source
    assert len({row.quantity for row in prior_scales.PRIOR_SCALES}) == len(prior_scales.PRIOR_SCALES)
