"""Steps of a waveform fit: checks, start values, fit, and its result beside the coefficients.

The coefficients take the form of the mean-force regression, with the mean forces of the cuts.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.measurement.cutting.coefficient_fit import NAMES, CoefficientFit, build_milling_coefficients
from machopt.measurement.cutting.waveform.residual_noise import PHASE_BINS
from machopt.measurement.cutting.waveform.signal_checks import check_waveforms, limit_samples
from machopt.measurement.cutting.waveform.start_values import find_spindle_speeds, find_start_values
from machopt.measurement.cutting.waveform.waveform_fit import WaveformFit, compute_normal_quantile, fit_waveform
from machopt.measurement.cutting.waveform.waveform_model import (
    COEFFICIENTS,
    RUNOUT,
    WaveformModel,
    build_waveform_model,
)
from machopt.measurement.cutting.waveform.waveform_result import FoldedWaveform, RunoutEstimate, WaveformResult
from machopt.numerics.array_types import Array
from machopt.process.milling.milling_cut import MillingCutter, check_cutter

EXPLAINS_LITTLE = 0.5  # of the variance: less than half explained is more unknown than known


def fit_waveform_recording(
    recording: WaveformRecording, cutter: MillingCutter, force: Array, level: float = 0.9
) -> tuple[CoefficientFit, WaveformResult]:
    """Return coefficients, run-out and offsets of force waveforms.

    Args:
        recording: Samples of all cuts.
        cutter: Flat end mill with helix.
        force: (S, 3) N, travel, normal, axial, on the tool.
        level: of the intervals, 0 … 1.

    Raises:
        RecordingError: cuts that are too short or sampled too slowly, or do not determine the unknowns.
        CuttingInputError: an impossible cutter or cut.
    """
    check_cutter(cutter, build_milling_coefficients(np.ones(COEFFICIENTS), (0.0, 1.0), 0.0, ""))
    check_waveforms(recording, cutter)
    recording, force = limit_samples(recording, force, cutter.teeth)
    speeds = find_spindle_speeds(recording, cutter.teeth, force)
    model = build_waveform_model(recording, cutter, force, speeds)
    z = compute_normal_quantile(level)
    found = fit_waveform(model, find_start_values(model), z)
    runout, turned = (None, 0) if cutter.teeth == 1 else _estimate_runout(found, cutter.teeth, level)
    result = _build_result(recording, model, found, speeds, runout, turned)
    return _build_coefficient_fit(recording, model, found, result, level), result


def _estimate_runout(waveform_fit: WaveformFit, teeth: int, level: float) -> tuple[RunoutEstimate, int]:
    """Return the run-out, and by how many teeth the numbers change so that tooth 0 is the nearest to the offset."""
    vector, covariance = 1e-6 * waveform_fit.x[RUNOUT], 1e-12 * waveform_fit.covariance[RUNOUT, RUNOUT]
    amplitude, z = float(np.hypot(*vector)), compute_normal_quantile(level)
    pitch = 2.0 * math.pi / teeth
    along = vector / max(amplitude, 1e-15)
    across = np.array([-along[1], along[0]])
    sigma = math.sqrt(along @ covariance @ along)
    turned = math.sqrt(across @ covariance @ across) / max(amplitude, 1e-15)
    significant = float(vector @ np.linalg.solve(covariance, vector)) > -2.0 * math.log(1.0 - level)  # χ² of two
    angle = math.atan2(vector[1], vector[0])
    shift = round(angle / pitch)
    angle -= shift * pitch
    if not significant or turned > 0.5 * pitch:
        wide = math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
        low = max(0.0, amplitude - z * sigma) if significant else 0.0
        return RunoutEstimate(
            amplitude=amplitude, interval=(low, amplitude + z * wide), angle=None, angle_interval=None
        ), shift
    return RunoutEstimate(
        amplitude=amplitude,
        interval=(max(0.0, amplitude - z * sigma), amplitude + z * sigma),
        angle=angle,
        angle_interval=(angle - z * turned, angle + z * turned),
    ), shift


def _build_result(
    recording: WaveformRecording,
    model: WaveformModel,
    waveform_fit: WaveformFit,
    speeds: Array,
    runout: RunoutEstimate | None,
    turned: int,
) -> WaveformResult:
    pitch = 2.0 * math.pi / model.teeth
    offset, sigma, folded = [], [], []
    for n, cut in enumerate(model.cuts):
        phase = model.compute_phase(waveform_fit.x, n) + turned * pitch
        index = model.get_offset_index(n)
        gain = np.zeros(model.size)
        gain[index] = 1.0
        if model.has_own_offset:
            gain[8 + len(model.cuts) + n] = cut.rotation[0]  # at the first sample, with the error of the speed
        at = phase[0] if model.has_own_offset else waveform_fit.x[index] + turned * pitch
        offset.append((float(at) + math.pi) % (2.0 * math.pi) - math.pi)
        sigma.append(math.sqrt(gain @ waveform_fit.covariance @ gain))
        folded.append(_fold(phase, cut.force, waveform_fit.predicted[n]))
    speed = np.array(speeds)
    if model.has_own_offset:
        speed = speed * (1.0 + waveform_fit.x[8 + len(model.cuts) :])
    return WaveformResult(
        runout=runout,
        offset=np.array(offset),
        offset_sigma=np.array(sigma),
        spindle_speed=speed,
        samples=int(recording.first[-1]),
        noise_order=waveform_fit.noise.order,
        misfit_ratio=waveform_fit.misfit_ratio,
        has_misfit=waveform_fit.has_misfit,
        folded=tuple(folded),
    )


def _fold(phase: Array, measured: Array, predicted: Array) -> FoldedWaveform:
    bins = 3 * PHASE_BINS
    number = np.floor(phase / (2.0 * math.pi) * bins).astype(np.intp) % bins
    count = np.bincount(number, minlength=bins)
    some = count > 0
    means = [
        np.stack([np.bincount(number, force[:, f], bins)[some] / count[some] for f in range(3)], axis=1)
        for force in (measured, predicted)
    ]
    angle = (np.arange(bins) + 0.5) * (2.0 * math.pi / bins)
    return FoldedWaveform(angle=np.asarray(angle[some], float), measured=means[0], predicted=means[1])


def _build_coefficient_fit(
    recording: WaveformRecording, model: WaveformModel, waveform_fit: WaveformFit, result: WaveformResult, level: float
) -> CoefficientFit:
    """Return the coefficients with the mean forces of the cuts, as the regression of mean forces does."""
    z, values = compute_normal_quantile(level), waveform_fit.x[:COEFFICIENTS]
    covariance = waveform_fit.covariance[:COEFFICIENTS, :COEFFICIENTS]
    half = z * np.sqrt(np.diag(covariance))
    measured = np.array([cut.force.mean(axis=0) for cut in model.cuts])
    predicted = np.array([force.mean(axis=0) for force in waveform_fit.predicted])
    design = [model.evaluate(waveform_fit.x, n)[1][..., :COEFFICIENTS].mean(axis=0) for n in range(len(model.cuts))]
    doubt = np.array([np.trace(d @ covariance @ d.T) for d in design])
    square = np.sum((measured - predicted) ** 2, axis=1)
    relative = math.sqrt(float(np.mean((doubt + square) / np.sum(predicted**2, axis=1))))
    warnings = []
    if result.has_misfit:
        warnings.append(
            "the residuals repeat with the rotation: the waveform holds what the model lacks (dynamics of tool or "
            f"force sensor). The intervals are widened by a factor {math.sqrt(waveform_fit.misfit_ratio):.2f}"
        )
    if waveform_fit.explained[:2].max() < EXPLAINS_LITTLE:
        warnings.append(
            f"the model explains {100 * waveform_fit.explained[0]:.0f} and {100 * waveform_fit.explained[1]:.0f} % of "
            "travel and normal force: check teeth, side of the cut, frame and sign of the forces"
        )
    for n, name in enumerate(NAMES):
        if not waveform_fit.free[n]:
            warnings.append(f"{name} came out negative within its interval and is set to 0")
        elif values[n] < half[n]:
            warnings.append(
                f"{name} is not determined: its {100 * level:g} % interval is {values[n] - half[n]:.3g} … "
                f"{values[n] + half[n]:.3g}"
            )
    return CoefficientFit(
        values=np.array(values),
        covariance=np.array(covariance),
        low=values - half,
        high=values + half,
        level=level,
        fixed=tuple(name for n, name in enumerate(NAMES) if not waveform_fit.free[n]),
        measured=measured,
        predicted=predicted,
        feed_per_tooth=np.array([cut.feed_per_tooth for cut in model.cuts]),
        used=np.ones(len(model.cuts), bool),
        reasons=("",) * len(model.cuts),
        residual=np.array(waveform_fit.residual),
        explained=np.array(waveform_fit.explained),
        sigma_log=math.log1p(relative),
        warnings=(*recording.samples.warnings, *warnings),
    )
