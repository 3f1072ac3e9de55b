"""The diagnosis page's data from a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.nouns.problem import Problem
from machopt.diagnose.nouns.result import Diagnosis
from machopt.diagnose.written.told import parts_of, source_of
from machopt.domain.cell import Cell
from machopt.domain.recording import Recording
from machopt.domain.results.diagnosis import EffectOnJob
from machopt.report.diagnosis import Coordinate, DiagnosisPage, JobChange, JobEffect
from machopt.report.scene import Scene
from machopt.version import __version__

_AXES = ("x", "y", "z", "rx", "ry", "rz")


def page_of(
    cell: Cell,
    recording: Recording | Sequence[Recording],
    diagnosis: Diagnosis,
    facts: tuple[tuple[str, str], ...],
    effect_on_job: EffectOnJob | None = None,
    *,
    problem: Problem | None = None,
    scene: Scene | None = None,
) -> DiagnosisPage:
    """Collect everything the page shows.

    Args:
        cell: the cell.
        recording: what was diagnosed; several where they were not joined.
        diagnosis: what was found.
        facts: (name, value) of the run: options, hashes.
        effect_on_job: what ``--toolpath`` gave; see ``job_effect``.
        problem: what the engine was given; without it, readings are the recording's rows.
        scene: the cell, where residuals are displacements of its arm.
    """
    places = places_of(recording, diagnosis, problem)
    parts = parts_of(recording)
    q = np.zeros((0, 6)) if scene is None else np.concatenate([r.q for r in parts])
    whole = sum(len(r) for r in parts) == len(diagnosis.used)
    branch = None
    if whole and all(r.branch is not None for r in parts):
        branch = np.concatenate([r.branch for r in parts if r.branch is not None])
    return DiagnosisPage(
        title=f"Diagnosis of {cell.name}",
        cell=cell.name,
        recording=source_of(recording),
        version=__version__,
        diagnosis=diagnosis,
        branch=branch,
        facts=facts,
        job=None if effect_on_job is None else job_effect(effect_on_job),
        scene=scene,
        q=np.hstack([q, np.broadcast_to(cell.external_home, (len(q), len(cell.external_home)))]),
        **places,
    )


def job_effect(given: EffectOnJob) -> JobEffect:
    """The block a job gives: what a toolpath's result is under the model as it was, and as it is now."""
    changes = tuple(JobChange(c.what, _number(c.before), _number(c.after), c.unit) for c in given.changes)
    return JobEffect(
        toolpath=given.toolpath,
        sentence=given.sentence,
        changes=changes,
        point=_numbers(given.point),
        gamma_before=_numbers(given.gamma_before_deg),
        gamma_after=_numbers(given.gamma_after_deg),
        deflection_before=_numbers(given.deflection_before_mm),
        deflection_unchanged=_numbers(given.deflection_unchanged_mm),
        deflection_after=_numbers(given.deflection_after_mm),
    )


def places_of(
    recording: Recording | Sequence[Recording], d: Diagnosis, problem: Problem | None
) -> dict[str, Any]:  # of DiagnosisPage
    parts, n = parts_of(recording), len(d.used)
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
            elif family.beside:
                name = f"{family.name}_{_AXES[place]}"
            else:
                name = family.name if len(family.columns) == 1 else f"{family.name} {place + 1}"
            main = family.unit == problem.families[0].unit
            out[c] = Coordinate(name, family.unit, family.factor, main)
    return tuple(c if c is not None else Coordinate(f"coordinate {n + 1}", "", 1.0, False) for n, c in enumerate(out))


def _numbers(values: Any) -> Array:
    return np.zeros(0) if values is None else np.array([_number(v) for v in values], dtype=float)


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)
