"""Yaskawa: joint positions in pulses where the cell gives pulses_per_deg, else in degrees; RCONF of Cartesian ones.

RCONF, as the NX100's job format lists it: flip 0 or no-flip 1 (here by the sign of the B axis), upper arm 0 or lower
arm 1, front 0 or rear 1, then for R, T and S: 0 below 180°, 1 from 180°.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.errors import InputError
from machopt.formats.posts.columns import Job
from machopt.formats.posts.dialect import Dialect
from machopt.formats.posts.fanuc import check_slowest

PRINTED = 4


def _rconf(job: Job) -> list[str]:
    a = np.round(job.axes_deg, PRINTED)
    p = job.program
    bits = [a[:, 4] < 0.0, ~np.asarray(p.elbow_up), np.asarray(p.behind)]
    bits += [np.abs(a[:, k]) >= 180.0 for k in (3, 5, 0)]
    return [",".join(map(str, row)) for row in np.column_stack(bits).astype(int).tolist()]


def _notes(job: Job, used: frozenset[str]) -> Sequence[str]:
    c = job.controller
    notes = []
    if c.tool_number is None:
        notes.append("no controller.tool_number in the cell: 0 is taken")
    notes.append("feeds are rounded to 0.1 mm/s")
    if "x" in used and c.base_number is None:
        notes.append("no controller.base_number in the cell: user frame 1 is taken")
    return notes


def _check(job: Job, used: frozenset[str]) -> None:
    check_slowest(job)
    if "rconf" in used and job.program.behind is None:
        raise InputError("the posture of this arm is not known, so there is no RCONF; use the post jbi",
                         where="controller.post")  # fmt: skip


DIALECT = Dialect(
    columns=lambda job: {"rconf": lambda: _rconf(job)},
    values=lambda job: {
        "tool": job.controller.tool_number or 0,
        "user": job.controller.base_number or 1,
        "in_pulses": job.controller.pulses_per_deg is not None,
    },
    notes=_notes,
    check=_check,
)
