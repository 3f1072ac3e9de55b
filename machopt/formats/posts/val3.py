"""Stäubli VAL3: configuration words of a point. movel keeps the configuration, so they matter to movej only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.formats.posts.columns import Job
from machopt.formats.posts.dialect import Dialect
from machopt.formats.posts.external import driven, refuse

PRINTED = 5


def _side(job: Job, axis: int, words: tuple[str, str]) -> list[str]:
    below = np.round(job.axes_deg[:, axis], PRINTED) < 0.0
    return [words[1] if v else words[0] for v in below.tolist()]


def _shoulder(job: Job) -> list[str]:
    behind = job.program.behind
    if behind is None:
        return ["ssame"] * len(job.program)
    return ["righty" if v else "lefty" for v in behind.tolist()]


def _notes(job: Job, used: frozenset[str]) -> Sequence[str]:
    notes = ["lengths mm, angles deg, speeds mm/s"]
    if "shoulder" in used and job.program.behind is None:
        notes.append("the shoulder's side is not known: ssame")
    return [*notes, *_stands(job)]


def _check(job: Job, used: frozenset[str]) -> None:
    why = "VAL3 moves no rail or positioner; one that stands still all the way (plan: mode locked) would work"
    refuse(job.program, why, unless_still=True)


def _stands(job: Job) -> list[str]:
    axes = driven(job.program, job.controller)
    if not axes:
        return []
    places, units = " ".join(f"{d.values[0] + 0.0:.6f}" for d in axes), ", ".join(d.word for d in axes)
    return [f"external axes must stand where the next line says, in {units}", f"external: {places}"]


DIALECT = Dialect(
    columns=lambda job: {
        "shoulder": lambda: _shoulder(job),
        "elbow": lambda: _side(job, 2, ("epositive", "enegative")),
        "wrist": lambda: _side(job, 4, ("wpositive", "wnegative")),
    },
    notes=_notes,
    check=_check,
)
