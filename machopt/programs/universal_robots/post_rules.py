"""Universal Robots: units m and rad, rotation vectors; blend radii never overlap (columns.rounding)."""

from __future__ import annotations

from collections.abc import Sequence

from machopt.errors import PostError
from machopt.programs.writing.external_axes import refuse_external_axes
from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.template_fields import PostJob


def _list_notes(job: PostJob, used: frozenset[str]) -> Sequence[str]:
    notes = ["lengths m, angles rad, speeds m/s and rad/s"]
    if job.controller.T_base_root is None:
        notes.append("ROS models turn base_link by 180 deg about z against the controller's base: see controller.root")
    return notes


def _check_job(job: PostJob, used: frozenset[str]) -> None:
    refuse_external_axes(
        job.program, "URScript has no external axes; another post would work, or none", unless_still=False
    )
    if "step" in used and job.program.time is None:
        raise PostError("servoj needs the time of every move; write it from the control samples", where="post")


DIALECT = MakerRules(notes=_list_notes, check=_check_job)
