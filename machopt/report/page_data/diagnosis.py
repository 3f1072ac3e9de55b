"""Data of the diagnosis page from a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.documents.diagnosis_document import JobEffectSection
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.outputs.diagnosis_document import format_recording_source, list_source_recordings
from machopt.numerics.array_types import Array
from machopt.report.page_types.diagnosis_page_data import (
    DiagnosisPageData,
    JobEffect,
    JobQuantityChange,
    ReadingCoordinate,
)
from machopt.report.scene.scene_types import CellScene
from machopt.version import __version__

_AXIS_NAMES = ("x", "y", "z", "rx", "ry", "rz")


def build_diagnosis_page_data(
    cell: Cell,
    recording: Recording | Sequence[Recording],
    diagnosis: DiagnosisResult,
    facts: tuple[tuple[str, str], ...],
    effect_on_job: JobEffectSection | None = None,
    *,
    problem: DiagnosisProblem | None = None,
    scene: CellScene | None = None,
) -> DiagnosisPageData:
    """Collect everything the page shows.

    Args:
        cell: the cell.
        recording: what was diagnosed; several where they were not joined.
        diagnosis: what was found.
        facts: (name, value) of the run: options, hashes.
        effect_on_job: what ``--toolpath`` gave; see ``build_job_effect``.
        problem: what the engine was given; without it, readings are the recording's rows.
        scene: the cell, where residuals are displacements of its arm.
    """
    places = locate_readings(recording, diagnosis, problem)
    parts = list_source_recordings(recording)
    q = np.zeros((0, 6)) if scene is None else np.concatenate([r.q for r in parts])
    whole = sum(len(r) for r in parts) == len(diagnosis.used)
    branch = None
    if whole and all(r.branch is not None for r in parts):
        branch = np.concatenate([r.branch for r in parts if r.branch is not None])
    return DiagnosisPageData(
        title=f"Diagnosis of {cell.name}",
        cell=cell.name,
        recording=format_recording_source(recording),
        version=__version__,
        diagnosis=diagnosis,
        branch=branch,
        facts=facts,
        job=None if effect_on_job is None else build_job_effect(effect_on_job),
        scene=scene,
        q=np.hstack([q, np.broadcast_to(cell.external_home, (len(q), len(cell.external_home)))]),
        **places,
    )


def build_job_effect(section: JobEffectSection) -> JobEffect:
    """Return what a toolpath's result is under the model before and after the diagnosis.

    Args:
        section: Section of diagnosis.json about the toolpath.
    """
    changes = tuple(
        JobQuantityChange(c.what, _convert_number(c.before), _convert_number(c.after), c.unit) for c in section.changes
    )
    return JobEffect(
        toolpath=section.toolpath,
        sentence=section.sentence,
        changes=changes,
        point=_convert_numbers(section.point),
        gamma_before=_convert_numbers(section.gamma_before_deg),
        gamma_after=_convert_numbers(section.gamma_after_deg),
        deflection_before=_convert_numbers(section.deflection_before_mm),
        deflection_unchanged=_convert_numbers(section.deflection_unchanged_mm),
        deflection_after=_convert_numbers(section.deflection_after_mm),
    )


def locate_readings(
    recording: Recording | Sequence[Recording], d: DiagnosisResult, problem: DiagnosisProblem | None
) -> dict[str, Any]:  # of DiagnosisPage
    """Return place and pose of each reading, by field of the page data.

    Args:
        recording: The recording, or the recordings that were joined.
        d: The diagnosis.
        problem: The equations of the diagnosis; None where they were not built.
    """
    parts, n = list_source_recordings(recording), len(d.used)
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
        "coordinates": _list_coordinates(d, problem),
        "pose": pose,
        "session": joined["session"],
        "line": joined["line"],
        "row": row,
        "file": file,
        "group_word": word,
        "group_names": named,
    }


def _list_coordinates(d: DiagnosisResult, problem: DiagnosisProblem | None) -> tuple[ReadingCoordinate, ...]:
    count = d.errors.residual.shape[1]
    out: list[ReadingCoordinate | None] = [None] * count
    if problem is None:
        if d.channel == "torque":
            return tuple(ReadingCoordinate(f"joint {j + 1}", d.unit, 1.0, True) for j in range(count))
        return tuple(ReadingCoordinate(_AXIS_NAMES[c], ("mm", "mrad")[c // 3], 1e3, c < 3) for c in range(count))
    for family in problem.families:
        for place, c in enumerate(family.columns):
            if family.name in ("translation", "rotation"):
                name = ("" if family.name == "translation" else "r") + _AXIS_NAMES[place]
            elif family.is_separate_instrument:
                name = f"{family.name}_{_AXIS_NAMES[place]}"
            else:
                name = family.name if len(family.columns) == 1 else f"{family.name} {place + 1}"
            main = family.unit == problem.families[0].unit
            out[c] = ReadingCoordinate(name, family.unit, family.factor, main)
    return tuple(
        c if c is not None else ReadingCoordinate(f"coordinate {n + 1}", "", 1.0, False) for n, c in enumerate(out)
    )


def _convert_numbers(values: Any) -> Array:
    return np.zeros(0) if values is None else np.array([_convert_number(v) for v in values], dtype=float)


def _convert_number(value: Any) -> float:
    return float("nan") if value is None else float(value)
