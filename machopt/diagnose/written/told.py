"""diagnosis.json from a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose.nouns.problem import Correction, RecordCorrection
from machopt.diagnose.nouns.result import Diagnosis, Finding, LawFit
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection
from machopt.domain.recording import Recording
from machopt.domain.results.diagnosis import (
    BaselineErrors,
    CoefficientTold,
    CorrectionTold,
    DetectionLimit,
    DiagnosisResult,
    EffectOnJob,
    Estimated,
    FinalErrors,
    FindingTold,
    FittedLaw,
    KeyTold,
    MismatchShare,
    NotTestable,
    OutlyingRows,
    ProofTold,
    Recorded,
    RivalTold,
    Scatter,
)
from machopt.version import __version__

Ints = NDArray[np.int64]
ABSORBED = "what is refitted in any case takes it up on these readings"


def rows_location(rows: Sequence[int] | Ints) -> str:
    """1-based data rows as a location: ``rows:3,7``."""
    return "rows:" + ",".join(str(int(r)) for r in sorted(rows))


def result_of(
    cell: Cell,
    recording: Recording | Sequence[Recording],
    diagnosis: Diagnosis,
    *,
    model: str | None = "stiffness.yaml",
    kinematics: str | None = None,
    effect_on_job: EffectOnJob | None = None,
    options: Mapping[str, Any] | None = None,
    inputs: Mapping[str, str] | None = None,
) -> DiagnosisResult:
    """``diagnosis.json``; NaN and infinities are None.

    Args:
        cell: the cell.
        recording: what was diagnosed; several where they were not joined.
        diagnosis: what was found.
        model: the stiffness file beside it; None where none is written.
        kinematics: the file of kinematic corrections, where one is written.
        effect_on_job: what ``--toolpath`` gave; see ``job_effect``.
        options: of this run.
        inputs: hashes of the files read.
    """
    d = diagnosis
    proof = d.proof
    absorbed = (x for x in d.limits if not np.isfinite(x.value))
    return DiagnosisResult(
        machopt_diagnosis=1,
        version=__version__,
        cell=cell.name,
        recording=source_of(recording),
        verdict=d.verdict,
        sentence=d.sentence,
        channel=d.channel,
        predicted=d.predicted,
        rmse_unit=d.unit,
        baseline=BaselineErrors(
            heldout_rmse=d.heldout_before,
            noise_floor=d.noise_floor,
            repeatable_rmse=d.repeatable,
            p_value=d.mismatch_p,
        ),
        final=FinalErrors(
            heldout_rmse=d.heldout_after, explained_share=d.explained, repeatable_rmse=d.repeatable_after
        ),
        mismatch=tuple(MismatchShare(axis=s.axis, share=s.share, note=s.note, kind=s.kind) for s in d.mismatch),
        findings=tuple(_finding(f) for f in d.findings),
        detection_limits=tuple(DetectionLimit.from_fields(x) for x in d.limits if np.isfinite(x.value)),
        not_testable=(
            *(NotTestable(effect=u.effect, location=u.location, reason=u.reason) for u in d.untestable),
            *(NotTestable(effect=x.effect, location=x.location, reason=ABSORBED) for x in absorbed),
        ),
        next_experiment=d.next_experiment,
        model=model,
        kinematics=kinematics,
        readings=len(d.used),
        recorded=_recorded(recording, d),
        outliers=OutlyingRows(location=rows_location(d.outliers), rows=tuple(d.outliers.tolist()))
        if len(d.outliers)
        else None,
        proof=None
        if proof is None
        else ProofTold(
            groups=tuple(proof.groups.tolist()),
            heldout_rmse_before=proof.before,
            heldout_rmse_after=proof.after,
            noise_floor=proof.noise_floor,
            wins=proof.wins,
            of=proof.of,
            p_value=proof.p_value,
        ),
        coefficients=tuple(
            CoefficientTold(
                name=c.unknown.name,
                location=c.unknown.location,
                unit=c.unknown.unit,
                before=c.before,
                value=c.value,
                sigma=c.sigma,
                key=None if c.unknown.key is None else KeyTold.from_fields(c.unknown.key),
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


def _finding(f: Finding) -> FindingTold:
    own = (f.effect, f.location)
    return FindingTold(
        effect=f.effect,
        location=f.location,
        one_of=(own, *(name for name in f.one_of if name != own)),  # the named one first, always there
        parameters={name: Estimated.from_fields(e) for name, e in f.parameters.items()},
        heldout_rmse_before=f.before,
        heldout_rmse_after=f.after,
        p_value=f.p_value,
        law=f.law,
        equation=f.equation,
        note=f.note,
        of_the_record=f.record,
        rivals=tuple(
            RivalTold(
                effect=r.effect,
                location=r.location,
                law=r.law,
                closed_share=r.closed,
                standing=r.standing,
                p_value=r.p_value,
                placebo=r.placebo,
                fit=_fit(r.fit),
            )
            for r in f.rivals
        ),
        correction=_correction(f.correction),
        fit=_fit(f.rivals[0].named) if f.rivals else None,
    )


def _recorded(recording: Recording | Sequence[Recording], d: Diagnosis) -> Recorded:
    """How it was measured and how far readings scattered, for whoever plans the next measurement.

    The scatter is what the findings leave on unseen readings, split into a reading's own and what a visit shares.
    """
    parts = parts_of(recording)
    first, residual = parts[0], d.errors.final
    out = Recorded(
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
    scatter: dict[str, Scatter] = {}
    for name, columns in (("scatter_m", slice(0, 3)), ("scatter_rad", slice(3, 6))):
        e = residual[d.used][:, columns]
        if e.shape[1] == 0:
            continue
        mean = np.stack([np.bincount(visit, x) for x in e.T], axis=1) / np.maximum(count, 1.0)[:, None]
        freedom = float(np.sum(np.maximum(count - 1.0, 0.0)))
        whole = float(np.mean(e**2))
        own = float(np.sum(np.mean((e - mean[visit]) ** 2, axis=1))) / freedom if freedom > 0 else whole
        scatter[name] = Scatter(own=own**0.5, visit=max(whole - own, 0.0) ** 0.5)
    return out.model_copy(update=scatter)


def _fit(fit: LawFit | None) -> FittedLaw | None:
    """What plan-poses needs to predict a law at poses not measured yet."""
    if fit is None:
        return None
    return FittedLaw(
        coefficients=tuple(fit.coefficients), shape=tuple(fit.shape), correction=_correction(fit.correction)
    )


def _correction(c: Correction | None) -> CorrectionTold | None:
    if c is None:
        return None
    of: Literal["stiffness", "kinematics", "record"] = (
        "kinematics"
        if isinstance(c, KinematicCorrection)
        else "record"
        if isinstance(c, RecordCorrection)
        else "stiffness"
    )
    return CorrectionTold(of=of, effect=c.effect, location=c.location, parameters=dict(c.parameters))


def parts_of(recording: Recording | Sequence[Recording]) -> tuple[Recording, ...]:
    return (recording,) if isinstance(recording, Recording) else tuple(recording)


def source_of(recording: Recording | Sequence[Recording]) -> str:
    return ", ".join(r.source for r in parts_of(recording))
