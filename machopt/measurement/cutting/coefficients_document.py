"""The document coefficients.json of measured cuts: mean-force regression or waveform fit."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.documents.coefficients_document import (
    CoefficientsDocument,
    CuttingCoefficientEntry,
    ExcludedCutEntry,
    ForceComponentEntry,
    ProcessOptionsSection,
    RunoutSection,
    WaveformCutEntry,
    WaveformSection,
)
from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.measurement.cutting.coefficient_fit import COMPONENTS, NAMES, CoefficientFit
from machopt.measurement.cutting.request import ProcessRequest
from machopt.measurement.cutting.waveform.waveform_result import WaveformResult
from machopt.version import __version__


def build_coefficients_document(
    request: ProcessRequest, cell: Cell, recording: CuttingRecording, fit: CoefficientFit, inputs: dict[str, str]
) -> CoefficientsDocument:
    """Build the document coefficients.json.

    Args:
        request: Validated user request.
        cell: Robot cell.
        recording: Measured cuts.
        fit: Result of the regression.
        inputs: SHA-256 of the input files, by name.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    feeds = fit.feed_per_tooth[fit.used] * 1e3
    return CoefficientsDocument(
        machopt_coefficients=1,
        version=__version__,
        cell=cell.name,
        recording=recording.source,
        material=get_material_name(request, recording),
        cuts=len(recording),
        used=int(fit.used.sum()),
        interval_level=fit.level,
        coefficients=tuple(
            CuttingCoefficientEntry(
                name=name,  # type: ignore[arg-type]
                unit="N/mm²" if n < 3 else "N/mm",
                value=float(fit.values[n]),
                sigma=None if name in fit.fixed else float(sigma[n]),
                interval=(None, None) if name in fit.fixed else (float(fit.low[n]), float(fit.high[n])),
                fixed=name in fit.fixed,
            )
            for n, name in enumerate(NAMES)
        ),
        covariance=tuple(tuple(float(v) for v in row) for row in fit.covariance),
        components=tuple(
            ForceComponentEntry(
                component=name,  # type: ignore[arg-type]
                residual_N=float(fit.residual[n]),
                explained_share=float(fit.explained[n]),
            )
            for n, name in enumerate(COMPONENTS)
        ),
        spread_percent=100.0 * float(np.expm1(fit.sigma_log)),
        feed_per_tooth_mm=(float(feeds.min()), float(feeds.max())),
        excluded=tuple(
            ExcludedCutEntry(place=recording.format_place(row), reason=reason)
            for row, reason in enumerate(fit.reasons)
            if reason
        ),
        warnings=(*cell.warnings, *fit.warnings),
        options=ProcessOptionsSection(
            material=request.material, level_percent=request.level_percent, keep_outliers=request.keep_outliers
        ),
        inputs=inputs,
    )


def build_waveform_section(recording: CuttingRecording, waveform_result: WaveformResult) -> WaveformSection:
    """Build the section ``waveform`` of coefficients.json.

    Args:
        recording: One row a cut.
        waveform_result: Run-out, offsets and residuals.
    """
    runout = None
    if waveform_result.runout is not None:
        one = waveform_result.runout
        low, high = (None, None) if one.angle_interval is None else map(math.degrees, one.angle_interval)
        runout = RunoutSection(
            amplitude_mm=1e3 * one.amplitude,
            interval_mm=(1e3 * one.interval[0], 1e3 * one.interval[1]),
            angle_deg=None if one.angle is None else math.degrees(one.angle),
            angle_interval_deg=(low, high),
        )
    return WaveformSection(
        samples=waveform_result.samples,
        runout=runout,
        noise_order=waveform_result.noise_order,
        misfit_ratio=waveform_result.misfit_ratio,
        misfit_significant=waveform_result.has_misfit,
        cuts=tuple(
            WaveformCutEntry(
                place=recording.format_place(n),
                spindle_rpm=60.0 * float(waveform_result.spindle_speed[n]),
                offset_deg=math.degrees(waveform_result.offset[n]),
                offset_sigma_deg=math.degrees(waveform_result.offset_sigma[n]),
            )
            for n in range(len(recording))
        ),
    )


def get_material_name(request: ProcessRequest, recording: CuttingRecording) -> str:
    """Return the name of the material in process.yaml.

    Args:
        request: Validated user request.
        recording: Measured cuts.
    """
    return request.material or recording.source
