"""Consistent output files: a correction that cannot be written must not affect the others.

Corrections of measured poses are fitted together and are correlated. If one is withheld as implausible, the others
are biased without it. The search is therefore repeated without it.
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

MAX_SEARCHES = 3  # most searches


def diagnose_with_plausible_corrections(
    cell: Cell, look: Callable[[frozenset[EffectLocation]], DiagnosedRecording]
) -> tuple[DiagnosedRecording, ExtendedStiffness]:
    """Diagnose repeatedly until no correction is withheld.

    Args:
        cell: Robot cell.
        look: Function that diagnoses without the given effects and places.

    Returns:
        The diagnosis and its extended stiffness.
    """
    barred: frozenset[EffectLocation] = frozenset()
    for _ in range(MAX_SEARCHES):
        found = look(barred)
        extended_stiffness = build_extended_stiffness(cell, found.diagnosis, weight_alone=found.weight_alone)
        impossible = {(t.effect, t.location) for t in extended_stiffness.withheld} - barred
        beside = any(isinstance(f.correction, KinematicCorrection) for f in found.diagnosis.findings)
        if not impossible or not beside or found.recording.kind != "absolute":
            break
        barred |= impossible
    notes = tuple(
        f"{format_effect_in_sentence(*name)} would fit, as nothing that is built can be; it was left out and "
        f"all else found without it"
        for name in sorted(barred)
    )
    return replace(
        found, diagnosis=replace(found.diagnosis, notes=(*found.diagnosis.notes, *notes))
    ), extended_stiffness
