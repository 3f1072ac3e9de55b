"""ROS trajectory_msgs/JointTrajectory and its kin: radians of the URDF's joints, times strictly rising."""

from __future__ import annotations

import math

from machopt.errors import InputError
from machopt.formats.posts.columns import Job
from machopt.formats.posts.dialect import Dialect
from machopt.formats.posts.external import MOST
from machopt.formats.posts.template import Column

_TURNS, _SLIDES = "0", "2"  # joint types as COMPAS counts them


def _check(job: Job, used: frozenset[str]) -> None:
    if job.program.time is None:
        raise InputError(
            "a JointTrajectory needs the time of every point; write it from the control samples", where="post"
        )


def _seconds(job: Job, rest: bool) -> Column:
    time = job.program.time
    if time is None:
        return [""] * len(job.program)
    nano = [round(t * 1e9) for t in time.tolist()]
    return [n % 1_000_000_000 if rest else math.floor(n / 1_000_000_000) for n in nano]


def _kind(job: Job, k: int) -> Column:
    """What external joint ``k`` does; empty where there is none."""
    axes = job.program.external_axes
    word = "" if k >= len(axes) else _SLIDES if axes[k].slides else _TURNS
    return [word] * len(job.program)


DIALECT = Dialect(
    columns=lambda job: {
        "sec": lambda: _seconds(job, False),
        "nanosec": lambda: _seconds(job, True),
        **{f"e{k + 1}_type": (lambda k=k: _kind(job, k)) for k in range(MOST)},  # type: ignore[misc]
    },
    check=_check,
    maker=False,
)
