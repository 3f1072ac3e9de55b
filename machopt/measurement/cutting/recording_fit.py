"""Fit of a recording of measured cuts: by regression of mean forces, or of waveforms."""

from __future__ import annotations

from dataclasses import dataclass, replace

from machopt.data_types.cell import Cell
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.errors import CuttingInputError, OptionError, RecordingError
from machopt.measurement.cutting.coefficient_fit import CoefficientFit, build_milling_coefficients, fit_coefficients
from machopt.measurement.cutting.force_axes import compute_cut_forces, note_cutter_of_cell
from machopt.measurement.cutting.waveform.waveform_result import WaveformResult, compute_chip_range
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.milling.milling_cut import MillingCutter, check_milling_coefficients


@dataclass(frozen=True, kw_only=True)
class CuttingFit:
    """Coefficients of a recording with all that they follow from."""

    recording: CuttingRecording  # one row a cut
    cutter: MillingCutter
    fit: CoefficientFit
    waveform: WaveformResult | None  # of a recording over time or angle
    coefficients: MillingCoefficients


def fit_recording(
    given: CuttingRecording | WaveformRecording, cell: Cell, *, level: float, keep_outliers: bool
) -> CuttingFit:
    """Return the coefficients of a recording.

    Args:
        given: mean forces, or waveforms.
        cell: for the cutter where the recording states none, and the tool's axis where forces are in base axes.
        level: of the intervals, 0 … 1.
        keep_outliers: no cut is left out because of its residual; mean forces only.

    Raises:
        InputError: cuts that do not determine the coefficients, an impossible cutter or cut, or an option without
            effect.
    """
    samples = given.samples if isinstance(given, WaveformRecording) else given
    try:
        cutter = build_milling_cutter(samples.cutter or cell.tool.cutter)
        samples = note_cutter_of_cell(samples, cutter)
        force = compute_cut_forces(samples, cell)
        if isinstance(given, WaveformRecording):
            # CasADi is imported for waveforms only
            from machopt.measurement.cutting.waveform.waveform_fit_pipeline import fit_waveform_recording

            if keep_outliers:
                raise OptionError("has no effect on waveforms: no sample is left out", where="--keep-outliers")
            recording = given.list_cuts()
            fit, waveform = fit_waveform_recording(replace(given, samples=samples), cutter, force, level)
        else:
            recording, waveform = samples, None
            fit = fit_coefficients(recording, cutter, force, level=level, keep_outliers=keep_outliers)
        found = _build_coefficients(recording, fit, cutter, waveform)
    except CuttingInputError as problem:
        raise RecordingError(problem.reason, file=samples.files[0]) from None
    return CuttingFit(recording=recording, cutter=cutter, fit=fit, waveform=waveform, coefficients=found)


def _build_coefficients(
    recording: CuttingRecording, fit: CoefficientFit, cutter: MillingCutter, waveform: WaveformResult | None
) -> MillingCoefficients:
    feeds = fit.feed_per_tooth[fit.used]
    low, high, what = float(feeds.min()), float(feeds.max()), "mean forces"
    if waveform is not None:
        low, high, what = *compute_chip_range(recording, cutter, fit.feed_per_tooth), "force waveforms"
    source = f"{what} of {int(fit.used.sum())} measured cuts, recording {recording.source}"
    found = build_milling_coefficients(fit.values, (low, high), fit.sigma_log, source)
    check_milling_coefficients(found)
    return found
