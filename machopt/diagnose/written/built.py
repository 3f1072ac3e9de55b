"""A diagnosis whose files hold together: what no file may hold bends none of the corrections that are written.

Corrections of measured poses are fitted together, and often lean on each other. Where one of them is withheld, since
nothing that is built can be so, the others were fitted beside it and mislead without it: so they are found again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from machopt.diagnose.nouns.result import Name
from machopt.diagnose.run import Examined
from machopt.diagnose.written.extended import Extended, stiffness_of
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection
from machopt.effects.words import spoken

AGAIN = 3  # searches at most


def built(cell: Cell, look: Callable[[frozenset[Name]], Examined]) -> tuple[Examined, Extended]:
    """A diagnosis, and the stiffness that it leaves.

    Args:
        cell: the robot cell.
        look: diagnoses without the explanations that are barred.
    """
    barred: frozenset[Name] = frozenset()
    for _ in range(AGAIN):
        found = look(barred)
        made = stiffness_of(cell, found.diagnosis, weight_alone=found.weight_alone)
        impossible = {(t.effect, t.location) for t in made.withheld} - barred
        beside = any(isinstance(f.correction, KinematicCorrection) for f in found.diagnosis.findings)
        if not impossible or not beside or found.recording.kind != "absolute":
            break
        barred |= impossible
    notes = tuple(
        f"{spoken(*name)} would fit, as nothing that is built can be; it was left out and all else found without it"
        for name in sorted(barred)
    )
    return replace(found, diagnosis=replace(found.diagnosis, notes=(*found.diagnosis.notes, *notes))), made
