"""Pipeline of an identification from frequency responses.

::

    equations ─► start ─► both damping laws ─► the likelier one ─► what is determined ─► bounds, modes, result
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.data_types.stiffness import ArmStiffness, format_joint_stiffness
from machopt.errors import RecordingError
from machopt.kinematics.robot import Robot
from machopt.measurement.identification.frequency_response.frequency_response_result import (
    FrequencyResponseResult,
    JointResponseResult,
)
from machopt.measurement.identification.frequency_response.joint_bounds import (
    DeterminedFit,
    find_lower_bound,
    fit_determined,
    list_identified_joints,
)
from machopt.measurement.identification.frequency_response.modal_damping import compute_modal_damping
from machopt.measurement.identification.frequency_response.response_equations import build_response_equations
from machopt.measurement.identification.frequency_response.response_fit import (
    ResponseFit,
    build_prior,
    find_start,
    fit_responses,
)
from machopt.measurement.identification.frequency_response.response_model import (
    JOINTS,
    DampingLaw,
    ResponseModel,
    build_response_model,
)
from machopt.numerics.array_types import Array

TYPICAL_STIFFNESS = 1e6  # N·m/rad, start of the search where the cell states none: middle of published arms
LAWS: tuple[DampingLaw, DampingLaw] = ("viscous", "structural")
EXPLAINS_LITTLE = 0.5  # of the mean square of a response: less than half explained is more unknown than known
COMPARED_PASSES = 2  # of the fits whose likelihoods are compared: the wrong law never settles
INDISTINGUISHABLE = 3.0  # of the logarithm of the likelihood: odds of 20 to 1


def identify_from_responses(
    recording: FrequencyResponseRecording,
    cell: Cell,
    robot: Robot,
    level: float,
    rng: np.random.Generator,
    progress: Callable[[str], None] = lambda _: None,
) -> FrequencyResponseResult:
    """Identify joint stiffness and damping.

    Args:
        recording: Measured responses.
        cell: Robot cell with masses, tool and the stiffness that serves as prior.
        robot: Kinematic model of the arm.
        level: Of the intervals, 0 … 1.
        rng: Random generator of the starts.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: No masses, responses in another unit, or responses that the model does not explain at all.
    """
    prior_k = None if cell.stiffness is None else np.array(cell.stiffness.joints)
    equations = build_response_equations(recording, cell, robot, prior_k)
    prior = build_prior(np.full(JOINTS, TYPICAL_STIFFNESS) if prior_k is None else prior_k, prior_k is not None)
    progress("fitting both damping laws")
    models = [build_response_model(equations, law) for law in LAWS]
    start = find_start(models[0], prior, rng)
    first = [fit_responses(model, start, prior, COMPARED_PASSES) for model in models]
    best = int(np.argmax([fit.log_likelihood for fit in first]))
    gain = first[best].log_likelihood - first[1 - best].log_likelihood
    model = models[best]
    found = fit_determined(model, first[best].x, prior)
    residual = np.abs(found.fit.predicted - equations.receptance) ** 2
    size = np.bincount(equations.group, np.abs(equations.receptance) ** 2)
    explained = 1.0 - np.bincount(equations.group, residual) / size
    if explained.max() < EXPLAINS_LITTLE:
        raise RecordingError(
            f"no response is explained by half (best {100 * explained.max():.0f} %): expected receptances of this arm "
            "in m/N; check q1_deg … q6_deg, directions, points and the sign of the imaginary part (negative at a "
            "peak of one point and direction)",
            file=recording.files[0],
        )
    progress("bounds of what is not determined")
    covariance = _compute_covariance(model, found.fit, recording.mass_sigma)
    joints = _list_joints(model, found, covariance, level, prior_k)
    stiffness = _build_stiffness(recording, cell, found, covariance)
    count = np.bincount(equations.group)
    return FrequencyResponseResult(
        stiffness=stiffness,
        law=model.law,
        log_likelihood_gain=float(gain / found.fit.inflation),
        joints=joints,
        modes=compute_modal_damping(model, found.fit, covariance),
        level=level,
        predicted=np.array(found.fit.predicted),
        noise=np.sqrt(np.bincount(equations.group, residual) / count),
        explained=explained,
        inflation=found.fit.inflation,
        warnings=_list_warnings(recording, cell, found.fit, explained, gain / found.fit.inflation),
    )


def _compute_covariance(model: ResponseModel, fit: ResponseFit, mass_sigma: float | None) -> Array:
    """Return the covariance of log k and log η, the scatter of the links' masses included, (12, 12)."""
    covariance = fit.compute_covariance()
    if not mass_sigma:
        return covariance
    e = model.equations
    weights = 1.0 / (fit.scale[e.group] * e.shape) ** 2 / fit.inflation
    J, by_mass = model.evaluate(fit.x)[1], model.evaluate_mass_derivatives(fit.x)
    moved = -covariance @ np.real(np.conj(J).T @ (weights[:, None] * by_mass))  # change of the minimum per link
    return np.asarray(covariance + mass_sigma**2 * moved @ moved.T)


def _list_joints(
    model: ResponseModel, determined_fit: DeterminedFit, covariance: Array, level: float, prior: Array | None
) -> tuple[JointResponseResult, ...]:
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * level))
    k, eta = np.exp(determined_fit.fit.x[:JOINTS]), np.exp(determined_fit.fit.x[JOINTS:])
    sigma = np.sqrt(np.diag(covariance))
    damping = eta * k / model.equations.reference if model.law == "viscous" else eta
    by_law = np.concatenate([np.eye(JOINTS) * (model.law == "viscous"), np.eye(JOINTS)], axis=1)
    damping_sigma = np.sqrt(np.diag(by_law @ covariance @ by_law.T))
    stiff, damped = list_identified_joints(determined_fit)
    out = []
    for j in range(JOINTS):
        interval, reason = (k[j] * math.exp(-z * sigma[j]), k[j] * math.exp(z * sigma[j])), ""
        if not stiff[j]:
            bound = find_lower_bound(model, determined_fit.fit, j, level)
            interval = (bound, math.inf)
            unchanged_text = "a typical value" if prior is None else "the cell's value"
            reason = (
                f"the responses do not determine it: stiffer than {format_joint_stiffness(bound)} is all that is "
                f"known; the written value is that of {unchanged_text} as prior"
                f"{', which lies below that bound' if k[j] < bound else ''}"
            )
        ends = (damping[j] * math.exp(-z * damping_sigma[j]), damping[j] * math.exp(z * damping_sigma[j]))
        out.append(
            JointResponseResult(
                joint=j + 1,
                k=float(k[j]),
                interval=interval,
                identified=bool(stiff[j]),
                reason=reason,
                damping=float(damping[j]),
                damping_interval=ends if damped[j] else None,
            )
        )
    return tuple(out)


def _build_stiffness(
    recording: FrequencyResponseRecording, cell: Cell, determined_fit: DeterminedFit, covariance: Array
) -> ArmStiffness:
    """Return the springs; without identification a compliance has 100 % uncertainty, as in a static fit."""
    c = np.exp(-determined_fit.fit.x[:JOINTS])
    known = np.flatnonzero(determined_fit.identified[:JOINTS])
    matrix = np.diag(c**2)
    matrix[np.ix_(known, known)] = (np.outer(c, c) * covariance[:JOINTS, :JOINTS])[np.ix_(known, known)]
    stiffness = cell.stiffness
    return ArmStiffness(
        joints=1.0 / c,
        covariance=matrix,
        external=() if stiffness is None else stiffness.external,
        position=None if stiffness is None else stiffness.position,
        source=f"frequency responses, recording {recording.source}",
    )


def _list_warnings(
    recording: FrequencyResponseRecording, cell: Cell, fit: ResponseFit, explained: Array, gain: float
) -> tuple[str, ...]:
    out = list(recording.warnings)
    if recording.mass_sigma is None:
        out.append(
            "masses and inertias of the URDF count as exact; standard_uncertainty: {mass_percent: …} would widen the "
            "intervals by theirs (stiffness is proportional to mass at the same frequencies)"
        )
    if cell.stiffness is not None and cell.stiffness.terms:
        names = ", ".join(f"{t.effect} at {t.location}" for t in cell.stiffness.terms)
        out.append(f"terms of the cell's stiffness are not counted and not written: {names}")
    if cell.stiffness is not None and cell.stiffness.grid is not None:
        out.append("the grid of the cell's stiffness is not counted and not written: one value a joint is fitted")
    if gain < INDISTINGUISHABLE:
        out.append("the responses do not tell viscous from structural damping")
    if fit.inflation > 2.0:
        out.append(
            "the residuals are correlated along the frequency: the arm has modes that joints alone do not make. The "
            f"intervals are widened by a factor {math.sqrt(fit.inflation):.2f}"
        )
    for n in np.flatnonzero(explained < EXPLAINS_LITTLE):
        row = int(np.argmax(recording.group == n))
        out.append(
            f"{100 * explained[n]:.0f} % of the response that starts at {recording.format_place(row)} is explained: "
            "check its pose and directions"
        )
    return tuple(out)
