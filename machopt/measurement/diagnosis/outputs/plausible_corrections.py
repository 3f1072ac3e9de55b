"""A diagnosis whose files hold together: what no file may hold bends none of the corrections that are written.

Corrections of measured poses are fitted together, and often lean on each other. Where one of them is withheld, since
nothing that is built can be so, the others were fitted beside it and mislead without it: so they are found again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.measurement.diagnosis.data_types.diagnosis_result import EffectLocation
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording
from machopt.measurement.diagnosis.outputs.extended_stiffness import ExtendedStiffness, build_extended_stiffness

MAX_SEARCHES = 3  # searches at most


def diagnose_with_plausible_corrections(
    cell: Cell, look: Callable[[frozenset[EffectLocation]], DiagnosedRecording]
) -> tuple[DiagnosedRecording, ExtendedStiffness]:
    """A diagnosis, and the stiffness that it leaves.

    Args:
        cell: the robot cell.
        look: diagnoses without the explanations that are barred.
    """
    barred: frozenset[EffectLocation] = frozenset()
    for _ in range(MAX_SEARCHES):
        found = look(barred)
        made = build_extended_stiffness(cell, found.diagnosis, weight_alone=found.weight_alone)
        impossible = {(t.effect, t.location) for t in made.withheld} - barred
        beside = any(isinstance(f.correction, KinematicCorrection) for f in found.diagnosis.findings)
        if not impossible or not beside or found.recording.kind != "absolute":
            break
        barred |= impossible
    notes = tuple(
        f"{format_effect_in_sentence(*name)} would fit, as nothing that is built can be; it was left out and "
        f"all else found without it"
        for name in sorted(barred)
    )
    return replace(found, diagnosis=replace(found.diagnosis, notes=(*found.diagnosis.notes, *notes))), made
