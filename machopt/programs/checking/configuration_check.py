"""Status, turns and confdata recomputed from the joints, to check the values in a program.

machopt/programs/README.md gives the meanings; each maker's ``checks.py`` compares its words.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.programs.checking.program_checks import ArmPosture, ProgramChecks, Words

PostureWords = tuple[NDArray[np.bool_], NDArray[np.bool_]]


def find_first_difference(
    checks: ProgramChecks,
    configuration: Sequence[Words],
    axes_deg: Array,
    posture: PostureWords | None,
    nonflip_j5: Literal["negative", "positive"] | None = None,
) -> tuple[int, int | None]:
    """Count the moves with values that can be recomputed, and find the first wrong one.

    Args:
        checks: of the program's maker.
        configuration: words of the moves.
        axes_deg: (M, 6) as the controller counts them.
        posture: wrist root behind axis 1 (M,), elbow up (M,); None where the arm has no such.
        nonflip_j5: FANUC's N.
    """
    known, wrong = 0, None
    for k, stated in enumerate(configuration):
        behind, up = (None, None) if posture is None else (bool(posture[0][k]), bool(posture[1][k]))
        target = ArmPosture(axes_deg=axes_deg[k].tolist(), wrist_behind=behind, elbow_up=up, nonflip_j5=nonflip_j5)
        verdicts = checks.compare_words(stated, target)
        known += bool(verdicts)
        if wrong is None and not all(verdicts):
            wrong = k
    return known, wrong
