"""Pipeline of an identification.

::

    experiment ─► check ─► fit ─► uncertainty ─► settle ─► cross-validation, influence, studies ─► IdentificationResult
                            ▲      (with K_C: about the loaded equilibrium, until convergence)
                            └─► grid, if requested or if it improves the cross-validated error
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.assessment.coefficient_uncertainty import (
    CoefficientUncertainty,
    compute_coefficient_uncertainty,
)
from machopt.measurement.identification.assessment.holdout_errors import compute_holdout_residuals
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients, settle_coefficients
from machopt.measurement.identification.assessment.subset_and_monte_carlo_studies import (
    MonteCarloResult,
    SubsetStudyResult,
    run_monte_carlo,
    run_subset_study,
)
from machopt.measurement.identification.data_quality.load_test_checks import check_experiment, refuse_record_faults
from machopt.measurement.identification.fitting.loaded_equilibrium import LoadedEquilibriumModel, refine_at_equilibrium
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit, fit_stiffness, list_fit_coefficients
from machopt.measurement.identification.grid_stiffness.grid_fit import GridFit, fit_grid
from machopt.measurement.identification.identification_result import IdentificationResult
from machopt.measurement.identification.options import IdentifyOptions
from machopt.measurement.identification.result_assembly import IdentificationStages, assemble_identification
from machopt.numerics.array_types import Array
from machopt.stiffness.terms import LinearTerm, compile_terms


def identify_stiffness(
    experiment: LoadTestExperiment,
    robot: Robot,
    T_flange_tcp: Array,
    prior: ArmStiffness | None,
    options: IdentifyOptions,
    rng: np.random.Generator,
    masses: RobotMasses | None = None,
) -> IdentificationResult:
    """Identify the stiffness of an arm from load tests.

    Args:
        experiment: Load tests in base axes.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        prior: Stiffness of the cell. It supplies the values of unidentified joints; its terms count as known
            unless they are refitted. None if the cell has none.
        options: Options of the identification.
        rng: Random generator of the studies and of the folds beyond 60 poses.
        masses: Masses for the weight at the loaded equilibrium; None: without weight.

    Returns:
        The result.

    Raises:
        InputError: An inconsistent recording, too few readings, or an unsuitable term.
    """
    model = _select_model_terms(robot, T_flange_tcp, prior, options)
    nominal = None if prior is None else prior.joints
    findings = check_experiment(
        experiment, robot, T_flange_tcp, nominal, len(list_fit_coefficients(experiment.joint_count, model.fitted_terms))
    )
    messages = refuse_record_faults(experiment, findings, options.accept)
    solved = _fit_constant_model(experiment, robot, T_flange_tcp, model, nominal, options, masses)
    left_out = compute_holdout_residuals(solved.fit, solved.settled, rng)
    subsets, errors_study = _run_studies(solved, robot, T_flange_tcp, options, rng)
    grid, why = _fit_grid_if_useful(solved, options)
    return assemble_identification(
        IdentificationStages(
            experiment=experiment,
            fit=solved.fit,
            uncertainty=solved.uncertainty,
            settled=solved.settled,
            known_terms=model.known_terms,
            geometric=model.geometric,
            heldout=left_out,
            grid=grid,
            why_model=why,
            findings=tuple(findings),
            messages=tuple(messages),
            subsets=subsets,
            monte_carlo=errors_study,
            equilibrium_influence=solved.equilibrium_influence,
            notes=solved.notes,
        )
    )


@dataclass(frozen=True)
class _ModelTerms:
    """Terms that are fitted and terms that are known."""

    fitted_terms: tuple[LinearTerm, ...]
    known_terms: tuple[LinearTerm, ...]
    geometric: bool


@dataclass(frozen=True)
class _ConstantSolution:
    """Constant model with its uncertainty."""

    fit: StiffnessFit
    uncertainty: CoefficientUncertainty
    settled: SettledCoefficients
    equilibrium_influence: Array | None
    notes: tuple[str, ...] = ()


def _select_model_terms(
    robot: Robot, T_flange_tcp: Array, prior: ArmStiffness | None, options: IdentifyOptions
) -> _ModelTerms:
    fitted, geometric = compile_terms(options.terms, robot, T_flange_tcp)
    again = {(t.effect, t.location) for t in fitted}
    known_terms = [] if prior is None else [t for t in prior.terms if (t.effect, t.location) not in again]
    known, geometric_before = compile_terms(known_terms, robot, T_flange_tcp)
    return _ModelTerms(fitted, known, options.geometric or geometric or geometric_before)


def _fit_constant_model(
    experiment: LoadTestExperiment,
    robot: Robot,
    T_flange_tcp: Array,
    model: _ModelTerms,
    nominal: Array | None,
    options: IdentifyOptions,
    masses: RobotMasses | None,
) -> _ConstantSolution:
    def fitted(e: LoadTestExperiment, before: StiffnessFit | None = None) -> _ConstantSolution:
        found = fit_stiffness(
            e,
            model.fitted_terms,
            model.known_terms,
            robust=options.robust,
            weighted=options.weighted,
            bounded=options.bounded,
            groups=None if before is None else before.clusters,
            weighting=None if before is None else before.weighting,
        )
        sure = compute_coefficient_uncertainty(found, options.level)
        return _ConstantSolution(found, sure, settle_coefficients(found, sure, nominal), None)

    plain = fitted(experiment)
    equilibrium = LoadedEquilibriumModel(experiment, robot, T_flange_tcp, masses)
    if not model.geometric:
        return _refine_with_load(plain, equilibrium, fitted) if options.load_effect else plain
    about = equilibrium.linearise(np.maximum(plain.settled.compliance, 0.0))
    weights = fitted(about).fit  # determined once; then only the equilibrium is updated
    settled = refine_at_equilibrium(
        equilibrium, plain.settled.compliance, lambda e: fitted(e, weights).settled.compliance
    )
    last = fitted(settled.linear, weights)
    return _ConstantSolution(last.fit, last.uncertainty, last.settled, settled.influence)


def _refine_with_load(
    plain: _ConstantSolution,
    equilibrium: LoadedEquilibriumModel,
    fitted: Callable[[LoadTestExperiment], _ConstantSolution],
) -> _ConstantSolution:
    """Return the fit about the loaded equilibrium if that changes a joint beyond the noise, else the linear fit.

    Loads that always hang down change the lever arms in the same direction. This is a bias that more readings do not
    remove and that the intervals of the linear law do not contain. One round suffices for a correction of a few
    percent.
    """
    c = np.maximum(plain.settled.compliance, 0.0)
    try:
        about = equilibrium.linearise(c)
    except InputError:  # unstable under this load: the recording has another fault, which other checks report
        return plain
    again = fitted(about)
    known = np.array(
        [
            a.identified and b.identified
            for a, b in zip(plain.settled.joint_status, again.settled.joint_status, strict=True)
        ]
    )
    sigma = np.where(known, again.uncertainty.sigma[: len(c)], np.inf)
    moved = np.abs(again.settled.compliance - plain.settled.compliance)
    if not (moved > thresholds.SHARES.minority * sigma).any():
        return plain
    worst = int(np.argmax(moved / sigma))
    exact = np.linalg.norm((equilibrium.experiment.measured - about.measured + about.sensitivity @ c)[:, :3], axis=1)
    linear = np.linalg.norm(equilibrium.experiment.response()[:, :3] @ c, axis=1)
    share = np.abs(exact - linear) / np.maximum(np.maximum(exact, linear), np.finfo(float).tiny)
    note = (
        f"what the load itself does to the lever arms (K_C) is counted; without it joint {worst + 1} would come out "
        f"{100 * moved[worst] / again.settled.x[worst]:.2g} % off. Weight is not counted (--geometric counts it)"
    )
    return replace(again, equilibrium_influence=share, notes=(note,))


def _run_studies(
    solved: _ConstantSolution, robot: Robot, T_flange_tcp: Array, options: IdentifyOptions, rng: np.random.Generator
) -> tuple[SubsetStudyResult | None, MonteCarloResult | None]:
    if not options.studies:
        return None, None
    of = "poses" if solved.fit.clusters.poses >= thresholds.COUNTS.min_comparisons else "readings"
    return (
        run_subset_study(solved.fit, solved.settled, rng, of=of),
        run_monte_carlo(solved.fit, solved.settled, robot, T_flange_tcp, rng),
    )


def _fit_grid_if_useful(solved: _ConstantSolution, options: IdentifyOptions) -> tuple[GridFit | None, str]:
    """Return the grid if it is requested or useful."""
    if options.model == "constant":
        return None, ""
    if options.model == "auto" and solved.fit.clusters.poses < thresholds.COUNTS.min_degrees_of_freedom:
        return (
            None,
            f"constant: fewer than {thresholds.COUNTS.min_degrees_of_freedom} poses say nothing of a change over space",
        )
    known = np.array([s.identified for s in solved.settled.joint_status])
    if not known.any():
        return None, "constant: no joint is identified"
    hold = np.where(known, np.nan, 1.0 / np.where(known, 1.0, solved.settled.compliance))
    origin = None if options.grid_origin is None else np.array(options.grid_origin)
    try:
        if options.model == "auto":
            draft = fit_grid(solved.fit, options.grid_cell, origin, options.grid_shape, hold=hold, draft=True)
            if draft.heldout.gain[0] <= 0:
                return None, "constant: a stiffness per grid cell predicts poses that it has not seen no better"
        found = fit_grid(solved.fit, options.grid_cell, origin, options.grid_shape, robust=options.robust, hold=hold)
    except InputError as problem:
        if options.model == "grid":
            raise
        return None, f"constant: no grid can be fitted ({problem.reason})"
    if options.model == "grid":
        return found, ""
    gain, error = found.heldout.gain
    grid, constant = (1e3 * r for r in found.heldout.rmse)
    compared = f"held-out error {grid:.4f} mm with the grid, {constant:.4f} mm without"
    errors, least = thresholds.LEVELS.two_sigma, thresholds.SHARES.negligible
    if gain > errors * error and grid < (1.0 - least) * constant:
        return found, f"grid: {compared}; the gain is {gain / error:.1f} standard errors"
    return None, (
        f"constant: {compared}; a grid is taken for a gain of {100 * least:g} % and {errors:g} standard errors"
    )
