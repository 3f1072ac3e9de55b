"""Fields of the toy post: the side of the wrist."""

from __future__ import annotations

import numpy as np

from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.template_fields import PostJob


def _list_wrist_words(job: PostJob) -> list[str]:
    return ["down" if below else "up" for below in (np.round(job.axes_deg[:, 4], 6) < 0.0).tolist()]


DIALECT = MakerRules(columns=lambda job: {"wrist": lambda: _list_wrist_words(job)})
