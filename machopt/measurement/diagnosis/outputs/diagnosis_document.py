"""The document diagnosis.json of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.documents.diagnosis_document import (
    BaselineErrorsSection,
    CoefficientEntry,
    CoefficientKeySection,
    CorrectionSection,
    DetectionLimitEntry,
    DiagnosisDocument,
    EstimateSection,
    FinalErrorsSection,
    FindingEntry,
    FittedLawSection,
    HoldoutValidationSection,
    JobEffectSection,
    MismatchShareEntry,
    NotTestableEntry,
    OutlierRowsEntry,
    RecordingSection,
    RivalEntry,
    ScatterSection,
)
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Correction, RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding, LawFit
from machopt.version import __version__

Ints = NDArray[np.int64]
ABSORBED_REASON = "what is refitted in any case takes it up on these readings"


def format_rows_location(rows: Sequence[int] | Ints) -> str:
    """Format data rows as a location: ``rows:3,7``.

    Args:
        rows: Data rows, 1-based.

    Returns:
        Location string.
    """
    return "rows:" + ",".join(str(int(r)) for r in sorted(rows))


def build_diagnosis_document(
    cell: Cell,
    recording: Recording | Sequence[Recording],
    diagnosis: DiagnosisResult,
    *,
    model: str | None = "stiffness.yaml",
    kinematics: str | None = None,
    effect_on_job: JobEffectSection | None = None,
    options: Mapping[str, Any] | None = None,
    inputs: Mapping[str, str] | None = None,
) -> DiagnosisDocument:
    """Build the document diagnosis.json; NaN and infinities become None.

    Args:
        cell: Robot cell.
        recording: Diagnosed recording; several if they were not merged.
        diagnosis: Result of the diagnosis.
        model: Name of the written stiffness file; None if none is written.
        kinematics: Name of the written file of kinematic corrections; None if none is written.
        effect_on_job: Comparison of plans for a toolpath; None if not requested.
        options: Options of this run.
        inputs: Hashes of the input files.

    Returns:
        The document.
    """
    d = diagnosis
    proof = d.proof
    absorbed = (x for x in d.limits if not np.isfinite(x.value))
    return DiagnosisDocument(
        machopt_diagnosis=1,
        version=__version__,
        cell=cell.name,
        recording=format_recording_source(recording),
        verdict=d.verdict,
        sentence=d.sentence,
        channel=d.channel,
        predicted=d.predicted,
        rmse_unit=d.unit,
        baseline=BaselineErrorsSection(
            heldout_rmse=d.heldout_before,
            noise_floor=d.noise_floor,
            measured_noise=d.measured_noise,
            repeatable_rmse=d.repeatable,
            p_value=d.mismatch_p,
        ),
        final=FinalErrorsSection(
            rmse=d.rmse, heldout_rmse=d.heldout_after, explained_share=d.explained, repeatable_rmse=d.repeatable_after
        ),
        mismatch=tuple(MismatchShareEntry(axis=s.axis, share=s.share, note=s.note, kind=s.kind) for s in d.mismatch),
        findings=tuple(_build_finding_entry(f) for f in d.findings),
        unnamed_corrections=tuple(c for f in d.unnamed if (c := _build_correction_entry(f.correction)) is not None),
        detection_limits=tuple(DetectionLimitEntry.from_fields(x) for x in d.limits if np.isfinite(x.value)),
        not_testable=(
            *(NotTestableEntry(effect=u.effect, location=u.location, reason=u.reason) for u in d.untestable),
            *(NotTestableEntry(effect=x.effect, location=x.location, reason=ABSORBED_REASON) for x in absorbed),
        ),
        next_experiment=d.next_experiment,
        model=model,
        kinematics=kinematics,
        readings=len(d.used),
        recorded=_build_recording_section(recording, d),
        outliers=OutlierRowsEntry(location=format_rows_location(d.outliers), rows=tuple(d.outliers.tolist()))
        if len(d.outliers)
        else None,
        proof=None
        if proof is None
        else HoldoutValidationSection(
            groups=tuple(proof.groups.tolist()),
            heldout_rmse_before=proof.before,
            heldout_rmse_after=proof.after,
            noise_floor=proof.noise_floor,
            wins=proof.wins,
            of=proof.of,
            p_value=proof.p_value,
        ),
        coefficients=tuple(
            CoefficientEntry(
                name=c.unknown.name,
                location=c.unknown.location,
                unit=c.unknown.unit,
                before=c.before,
                value=c.value,
                sigma=c.sigma,
                key=None if c.unknown.key is None else CoefficientKeySection.from_fields(c.unknown.key),
            )
            for c in d.coefficients
        ),
        tried=d.tried,
        notes=tuple(d.notes),
        warnings=tuple(d.warnings),
        effect_on_job=effect_on_job,
        options=dict(options or {}),
        inputs=dict(inputs or {}),
    )


def _build_finding_entry(f: Finding) -> FindingEntry:
    own = (f.effect, f.location)
    return FindingEntry(
        effect=f.effect,
        location=f.location,
        one_of=(own, *(name for name in f.one_of if name != own)),  # the reported one first
        parameters={name: EstimateSection.from_fields(e) for name, e in f.parameters.items()},
        heldout_rmse_before=f.before,
        heldout_rmse_after=f.after,
        p_value=f.p_value,
        law=f.law,
        equation=f.equation,
        note=f.note,
        of_the_record=f.record,
        rivals=tuple(
            RivalEntry(
                effect=r.effect,
                location=r.location,
                law=r.law,
                closed_share=r.closed,
                standing=r.standing,
                p_value=r.p_value,
                placebo=r.placebo,
                fit=_build_law_entry(r.fit),
            )
            for r in f.rivals
        ),
        correction=_build_correction_entry(f.correction),
        fit=_build_law_entry(f.rivals[0].named) if f.rivals else None,
    )


def _build_recording_section(recording: Recording | Sequence[Recording], d: DiagnosisResult) -> RecordingSection:
    """Return measurement set-up and scatter of the readings, used to plan the next measurement.

    The scatter of held-out residuals is divided into a part of the single reading and a part shared by a visit.
    """
    parts = list_source_recordings(recording)
    first, residual = parts[0], d.errors.final
    out = RecordingSection(
        kind=first.kind,
        coordinates=residual.shape[1],
        wrench_frame=first.wrench_frame,
        displacement_frame=first.displacement_frame,
        registration=first.registration,
    )
    if first.kind == "motion" or sum(len(r) for r in parts) != len(residual):
        return out
    labels = np.concatenate([np.stack([np.full(len(r), n), r.session, r.pose], axis=1) for n, r in enumerate(parts)])
    visit = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)[d.used]
    count = np.bincount(visit).astype(float)
    scatter: dict[str, ScatterSection] = {}
    for name, columns in (("scatter_m", slice(0, 3)), ("scatter_rad", slice(3, 6))):
        e = residual[d.used][:, columns]
        if e.shape[1] == 0:
            continue
        mean = np.stack([np.bincount(visit, x) for x in e.T], axis=1) / np.maximum(count, 1.0)[:, None]
        freedom = float(np.sum(np.maximum(count - 1.0, 0.0)))
        whole = float(np.mean(e**2))
        own = float(np.sum(np.mean((e - mean[visit]) ** 2, axis=1))) / freedom if freedom > 0 else whole
        scatter[name] = ScatterSection(own=own**0.5, visit=max(whole - own, 0.0) ** 0.5)
    return out.model_copy(update=scatter)


def _build_law_entry(fit: LawFit | None) -> FittedLawSection | None:
    """Return the fit that plan-poses needs to predict a law at other poses."""
    if fit is None:
        return None
    return FittedLawSection(
        coefficients=tuple(fit.coefficients), shape=tuple(fit.shape), correction=_build_correction_entry(fit.correction)
    )


def _build_correction_entry(c: Correction | None) -> CorrectionSection | None:
    if c is None:
        return None
    of: Literal["stiffness", "kinematics", "record"] = (
        "kinematics"
        if isinstance(c, KinematicCorrection)
        else "record"
        if isinstance(c, RecordCorrection)
        else "stiffness"
    )
    return CorrectionSection(of=of, effect=c.effect, location=c.location, parameters=dict(c.parameters))


def list_source_recordings(recording: Recording | Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the recordings as a tuple.

    Args:
        recording: One recording or several.

    Returns:
        The recordings.
    """
    return (recording,) if isinstance(recording, Recording) else tuple(recording)


def format_recording_source(recording: Recording | Sequence[Recording]) -> str:
    """Return the sources of the recordings, separated by commas.

    Args:
        recording: One recording or several.

    Returns:
        Text.
    """
    return ", ".join(r.source for r in list_source_recordings(recording))
