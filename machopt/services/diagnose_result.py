"""A diagnosis as diagnosis.json, residuals.csv and the data of its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import machopt
from machopt.diagnose.problem import Correction, Problem, RecordCorrection
from machopt.diagnose.result import Diagnosis, Estimate, Finding, Fit
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection
from machopt.domain.recording import Recording
from machopt.domain.results.diagnosis import DiagnosisResult, EffectOnJob
from machopt.formats.residuals import write_residuals_csv
from machopt.report.diagnosis import Coordinate, DiagnosisPage, JobChange, JobEffect

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ABSORBED = "what is refitted in any case takes it up on these readings"
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UNITS = {"N·m": "Nm", "µm": "um"}  # in column names
_CURVES = (
    "point",
    "gamma_before_deg",
    "gamma_after_deg",
    "deflection_before_mm",
    "deflection_unchanged_mm",
    "deflection_after_mm",
)


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
    out: dict[str, Any] = {
        "machopt_diagnosis": 1,
        "version": machopt.__version__,
        "cell": cell.name,
        "recording": _source(recording),
        "verdict": d.verdict,
        "sentence": d.sentence,
        "channel": d.channel,
        "predicted": d.predicted,
        "rmse_unit": d.unit,
        "baseline": {
            "heldout_rmse": d.heldout_before,
            "noise_floor": d.noise_floor,
            "repeatable_rmse": d.repeatable,
            "p_value": d.mismatch_p,
        },
        "final": {
            "heldout_rmse": d.heldout_after,
            "explained_share": d.explained,
            "repeatable_rmse": d.repeatable_after,
        },
        "mismatch": [{"axis": s.axis, "share": s.share, "note": s.note, "kind": s.kind} for s in d.mismatch],
        "findings": [_finding(f, d) for f in d.findings],
        "detection_limits": [
            {
                "effect": x.effect,
                "location": x.location,
                "value": x.value,
                "unit": x.unit,
                "standing": x.standing,
                "one_of": [list(name) for name in x.one_of],
            }
            for x in d.limits
            if np.isfinite(x.value)
        ],
        "not_testable": [
            *({"effect": u.effect, "location": u.location, "reason": u.reason} for u in d.untestable),
            *(
                {"effect": x.effect, "location": x.location, "reason": ABSORBED}
                for x in d.limits
                if not np.isfinite(x.value)
            ),
        ],
        "next_experiment": d.next_experiment,
        "model": model,
        "kinematics": kinematics,
        "readings": len(d.used),
        "recorded": _recorded(recording, d),
        "outliers": {"location": rows_location(d.outliers), "rows": d.outliers.tolist()} if len(d.outliers) else None,
        "proof": None
        if d.proof is None
        else {
            "groups": d.proof.groups.tolist(),
            "heldout_rmse_before": d.proof.before,
            "heldout_rmse_after": d.proof.after,
            "noise_floor": d.proof.noise_floor,
            "wins": d.proof.wins,
            "of": d.proof.of,
            "p_value": d.proof.p_value,
        },
        "coefficients": [
            {
                "name": c.unknown.name,
                "location": c.unknown.location,
                "unit": c.unknown.unit,
                "before": c.before,
                "value": c.value,
                "sigma": c.sigma,
                "key": None if c.unknown.key is None else asdict(c.unknown.key),
            }
            for c in d.coefficients
        ],
        "tried": d.tried,
        "notes": list(d.notes),
        "warnings": list(d.warnings),
        "effect_on_job": None if effect_on_job is None else effect_on_job.plain(),
        "options": dict(options or {}),
        "inputs": dict(inputs or {}),
    }
    return DiagnosisResult.model_validate(_plain(out))


def _finding(f: Finding, d: Diagnosis) -> dict[str, Any]:
    own = (f.effect, f.location)
    one_of = [list(own), *(list(name) for name in f.one_of if name != own)]  # the named one first, always there
    return {
        "effect": f.effect,
        "location": f.location,
        "one_of": one_of,
        "parameters": {name: _estimate(e) for name, e in f.parameters.items()},
        "heldout_rmse_before": f.before,
        "heldout_rmse_after": f.after,
        "p_value": f.p_value,
        "law": f.law,
        "equation": f.equation,
        "note": f.note,
        "of_the_record": f.record,
        "rivals": [
            {
                "effect": r.effect,
                "location": r.location,
                "law": r.law,
                "closed_share": r.closed,
                "standing": r.standing,
                "p_value": r.p_value,
                "placebo": r.placebo,
                "fit": _fit(r.fit),
            }
            for r in f.rivals
        ],
        "correction": _correction(f.correction),
        "fit": _fit(f.rivals[0].named) if f.rivals else None,
    }


def _recorded(recording: Recording | Sequence[Recording], d: Diagnosis) -> dict[str, Any]:
    """How it was measured and how far readings scattered, for whoever plans the next measurement.

    The scatter is what the findings leave on unseen readings, split into a reading's own and what a visit shares.
    """
    parts = _parts(recording)
    first, residual = parts[0], d.errors.final
    out: dict[str, Any] = {
        "kind": first.kind,
        "coordinates": residual.shape[1],
        "wrench_frame": first.wrench_frame,
        "displacement_frame": first.displacement_frame,
        "registration": first.registration,
    }
    if first.kind == "motion" or sum(len(r) for r in parts) != len(residual):
        return out
    labels = np.concatenate([np.stack([np.full(len(r), n), r.session, r.pose], axis=1) for n, r in enumerate(parts)])
    visit = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)[d.used]
    count = np.bincount(visit).astype(float)
    for name, columns in (("m", slice(0, 3)), ("rad", slice(3, 6))):
        e = residual[d.used][:, columns]
        if e.shape[1] == 0:
            continue
        mean = np.stack([np.bincount(visit, x) for x in e.T], axis=1) / np.maximum(count, 1.0)[:, None]
        freedom = float(np.sum(np.maximum(count - 1.0, 0.0)))
        whole = float(np.mean(e**2))
        own = float(np.sum(np.mean((e - mean[visit]) ** 2, axis=1))) / freedom if freedom > 0 else whole
        out[f"scatter_{name}"] = {"own": own**0.5, "visit": max(whole - own, 0.0) ** 0.5}
    return out


def _fit(fit: Fit | None) -> dict[str, Any] | None:
    """What plan-poses needs to predict a law at poses not measured yet."""
    if fit is None:
        return None
    return {"coefficients": list(fit.coefficients), "shape": list(fit.shape), "correction": _correction(fit.correction)}


def _estimate(e: Estimate) -> dict[str, Any]:
    return {"value": e.value, "unit": e.unit, "ci95": list(e.ci95), "ci90": list(e.ci90)}


def _correction(c: Correction | None) -> dict[str, Any] | None:
    if c is None:
        return None
    kinds = {KinematicCorrection: "kinematics", RecordCorrection: "record"}
    return {
        "of": kinds.get(type(c), "stiffness"),
        "effect": c.effect,
        "location": c.location,
        "parameters": dict(c.parameters),
    }


def write_residuals(
    path: Path, recording: Recording | Sequence[Recording], diagnosis: Diagnosis, problem: Problem | None = None
) -> None:
    """``residuals.csv``: line, pose, session, used, and the residual before and after in each coordinate."""
    page = _places(recording, diagnosis, problem)
    prefix = "d" if diagnosis.channel == "deflection" else ""
    names = [
        f"{prefix if c.name in 'xyz' else ''}{c.name.replace(' ', '')}_{_UNITS.get(c.unit, c.unit)}"
        for c in page["coordinates"]
    ]
    write_residuals_csv(
        path,
        row=page["row"],
        line=page["line"],
        file=page["file"],
        pose=page["pose"],
        session=page["session"],
        used=diagnosis.used,
        names=names,
        factors=[c.factor for c in page["coordinates"]],
        before=diagnosis.errors.residual,
        after=diagnosis.errors.final,
    )


def page_of(
    cell: Cell,
    recording: Recording | Sequence[Recording],
    diagnosis: Diagnosis,
    facts: tuple[tuple[str, str], ...],
    effect_on_job: EffectOnJob | None = None,
    *,
    problem: Problem | None = None,
) -> DiagnosisPage:
    """Collect everything the page shows.

    Args:
        cell: the cell.
        recording: what was diagnosed; several where they were not joined.
        diagnosis: what was found.
        facts: (name, value) of the run: options, hashes.
        effect_on_job: what ``--toolpath`` gave; see ``job_effect``.
        problem: what the engine was given; without it, readings are the recording's rows.
    """
    places = _places(recording, diagnosis, problem)
    parts = _parts(recording)
    whole = sum(len(r) for r in parts) == len(diagnosis.used)
    branch = None
    if whole and all(r.branch is not None for r in parts):
        branch = np.concatenate([r.branch for r in parts if r.branch is not None])
    return DiagnosisPage(
        title=f"Diagnosis of {cell.name}",
        cell=cell.name,
        recording=_source(recording),
        version=machopt.__version__,
        diagnosis=diagnosis,
        branch=branch,
        facts=facts,
        job=None if effect_on_job is None else job_effect(effect_on_job),
        **places,
    )


def job_effect(given: EffectOnJob) -> JobEffect:
    """The block a job gives: what a toolpath's result is under the model as it was, and as it is now."""
    curves = [_numbers(getattr(given, name)) for name in _CURVES]
    changes = tuple(JobChange(c.what, _number(c.before), _number(c.after), c.unit) for c in given.changes)
    return JobEffect(given.toolpath, given.sentence, changes, *curves)


def _places(
    recording: Recording | Sequence[Recording], d: Diagnosis, problem: Problem | None
) -> dict[str, Any]:  # of DiagnosisPage
    parts, n = _parts(recording), len(d.used)
    whole = sum(len(r) for r in parts) == n
    motion = parts[0].kind == "motion"
    joined = {
        name: np.concatenate([getattr(r, name) for r in parts]) if whole else np.zeros(n, np.int64)
        for name in ("pose", "session", "line")
    }
    file: tuple[str, ...] = ()
    names = list(dict.fromkeys(name for r in parts for name in (r.files or (r.source,))))
    if whole and len(names) > 1:
        file = tuple(
            r.files[0 if r.file is None else int(r.file[k])] if r.files else r.source
            for r in parts
            for k in range(len(r))
        )
    row = np.arange(1, n + 1)
    group = joined["pose"]
    if problem is not None:
        row, joined["line"], joined["session"] = problem.row, problem.line, problem.session
        group = problem.group
    pose = joined["pose"] if whole and not motion else group
    word = "stretch" if motion else "pose"
    first = dict(zip(*(v.tolist() for v in np.unique(group, return_index=True)), strict=True))
    named = tuple(str(pose[first[g]]) if g in first else str(g) for g in d.errors.groups.tolist())
    return {
        "coordinates": _coordinates(d, problem),
        "pose": pose,
        "session": joined["session"],
        "line": joined["line"],
        "row": row,
        "file": file,
        "group_word": word,
        "group_names": named,
    }


def _coordinates(d: Diagnosis, problem: Problem | None) -> tuple[Coordinate, ...]:
    count = d.errors.residual.shape[1]
    out: list[Coordinate | None] = [None] * count
    if problem is None:
        if d.channel == "torque":
            return tuple(Coordinate(f"joint {j + 1}", d.unit, 1.0, True) for j in range(count))
        return tuple(Coordinate(_AXES[c], ("mm", "mrad")[c // 3], 1e3, c < 3) for c in range(count))
    for family in problem.families:
        for place, c in enumerate(family.columns):
            if family.name in ("translation", "rotation"):
                name = ("" if family.name == "translation" else "r") + _AXES[place]
            else:
                name = family.name if len(family.columns) == 1 else f"{family.name} {place + 1}"
            main = family.unit == problem.families[0].unit
            out[c] = Coordinate(name, family.unit, family.factor, main)
    return tuple(c if c is not None else Coordinate(f"coordinate {n + 1}", "", 1.0, False) for n, c in enumerate(out))


def _parts(recording: Recording | Sequence[Recording]) -> tuple[Recording, ...]:
    return (recording,) if isinstance(recording, Recording) else tuple(recording)


def _source(recording: Recording | Sequence[Recording]) -> str:
    return ", ".join(r.source for r in _parts(recording))


def _numbers(values: Any) -> Array:
    return np.zeros(0) if values is None else np.array([_number(v) for v in values], dtype=float)


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _plain(value: Any) -> Any:
    """As JSON holds it: numpy's numbers as Python's, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
