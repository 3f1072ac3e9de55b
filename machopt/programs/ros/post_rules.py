"""ROS trajectory_msgs/JointTrajectory and related formats: URDF joints in rad, strictly increasing times."""

from __future__ import annotations

import math

from machopt.errors import PostError
from machopt.programs.writing.external_axes import MOST
from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.template_fields import PostJob
from machopt.programs.writing.template_language import TemplateColumn

_TURNS, _SLIDES = "0", "2"  # joint types as COMPAS counts them


def _check_job(job: PostJob, used: frozenset[str]) -> None:
    if job.program.time is None:
        raise PostError(
            "a JointTrajectory needs the time of every point; write it from the control samples", where="post"
        )


def _format_seconds(job: PostJob, rest: bool) -> TemplateColumn:
    time = job.program.time
    if time is None:
        return [""] * len(job.program)
    nano = [round(t * 1e9) for t in time.tolist()]
    return [n % 1_000_000_000 if rest else math.floor(n / 1_000_000_000) for n in nano]


def _list_joint_kind(job: PostJob, k: int) -> TemplateColumn:
    """What external joint ``k`` does; empty where there is none."""
    axes = job.program.external_axes
    word = "" if k >= len(axes) else _SLIDES if axes[k].slides else _TURNS
    return [word] * len(job.program)


DIALECT = MakerRules(
    columns=lambda job: {
        "sec": lambda: _format_seconds(job, False),
        "nanosec": lambda: _format_seconds(job, True),
        **{f"e{k + 1}_type": (lambda k=k: _list_joint_kind(job, k)) for k in range(MOST)},  # type: ignore[misc]
    },
    check=_check_job,
    maker=False,
)
