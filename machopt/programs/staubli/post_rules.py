"""Stäubli VAL3: configuration words of a point. movel keeps the configuration, so they affect movej only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.programs.writing.external_axes import list_driven_axes, refuse_external_axes
from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.template_fields import PostJob

PRINTED = 5


def _list_side_words(job: PostJob, axis: int, words: tuple[str, str]) -> list[str]:
    below = np.round(job.axes_deg[:, axis], PRINTED) < 0.0
    return [words[1] if v else words[0] for v in below.tolist()]


def _list_shoulder_words(job: PostJob) -> list[str]:
    behind = job.program.wrist_behind
    if behind is None:
        return ["ssame"] * len(job.program)
    return ["righty" if v else "lefty" for v in behind.tolist()]


def _list_notes(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    notes = ["lengths mm, angles deg, speeds mm/s"]
    if "shoulder" in used and job.program.wrist_behind is None:
        notes.append("the shoulder's side is not known: ssame")
    return [*notes, *_list_configuration_words(job)]


def _check_job(job: PostJob, used: frozenset[str]) -> None:
    why = "VAL3 moves no rail or positioner; one at rest all the way (plan: mode locked) would work"
    refuse_external_axes(job.program, why, unless_still=True)


def _list_configuration_words(job: PostJob) -> list[str]:
    axes = list_driven_axes(job.program, job.controller)
    if not axes:
        return []
    places, units = " ".join(f"{d.values[0] + 0.0:.6f}" for d in axes), ", ".join(d.word for d in axes)
    return [f"external axes must stand where the next line says, in {units}", f"external: {places}"]


DIALECT = MakerRules(
    columns=lambda job: {
        "shoulder": lambda: _list_shoulder_words(job),
        "elbow": lambda: _list_side_words(job, 2, ("epositive", "enegative")),
        "wrist": lambda: _list_side_words(job, 4, ("wpositive", "wnegative")),
    },
    notes=_list_notes,
    check=_check_job,
)
