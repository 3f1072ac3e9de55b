"""Consistent output files: a correction that cannot be written must not affect the others.

Corrections of measured poses are fitted together and are correlated. If one is withheld as implausible, the others
are biased without it. The search is therefore repeated without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.measurement.diagnosis.data_types.diagnosis_result import EffectLocation
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording
from machopt.measurement.diagnosis.outputs.extended_stiffness import ExtendedStiffness, build_extended_stiffness
from machopt.measurement.diagnosis.outputs.model_assessment import ModelAssessment, assess_written_model

MAX_SEARCHES = 3  # most searches


Look = Callable[[frozenset[EffectLocation], frozenset[EffectLocation]], DiagnosedRecording]


@dataclass(frozen=True)
class AssessedDiagnosis:
    """Diagnosis with the stiffness that is written, and the errors of the written files."""

    found: DiagnosedRecording
    made: ExtendedStiffness
    assessed: ModelAssessment


def diagnose_with_useful_files(cell: Cell, look: Look) -> AssessedDiagnosis:
    """Diagnose so that the written files predict unseen readings no worse than the refitted nominal model.

    A plan evaluates a few laws more simply than the fit does. If the files are therefore worse than without findings,
    the terms are left out one at a time, then together. The findings keep their names.

    Args:
        cell: Robot cell.
        look: Function that diagnoses without the given effects and places, and with others that are named but not
            written.

    Returns:
        The diagnosis, its stiffness and the errors of the files.
    """
    best = _diagnose_and_assess(cell, look, frozenset())
    d = best.found.diagnosis
    terms = [(f.effect, f.location) for f in d.findings if isinstance(f.correction, StiffnessTerm)]
    if not terms or not best.assessed.errors_mm[1] > d.heldout_before:
        return best
    for left_out in ([t] for t in terms) if len(terms) > 1 else ():
        other = _diagnose_and_assess(cell, look, frozenset(left_out))
        best = min(best, other, key=lambda a: a.assessed.errors_mm[1])
    if best.assessed.errors_mm[1] > d.heldout_before:
        best = min(best, _diagnose_and_assess(cell, look, frozenset(terms)), key=lambda a: a.assessed.errors_mm[1])
    return best


def _diagnose_and_assess(cell: Cell, look: Look, unstated: frozenset[EffectLocation]) -> AssessedDiagnosis:
    found, made = diagnose_with_plausible_corrections(cell, look, unstated)
    return AssessedDiagnosis(found, made, assess_written_model(cell, found, made))


def diagnose_with_plausible_corrections(
    cell: Cell, look: Look, unstated: frozenset[EffectLocation] = frozenset()
) -> tuple[DiagnosedRecording, ExtendedStiffness]:
    """Diagnose repeatedly until no correction is withheld.

    Args:
        cell: Robot cell.
        look: Function that diagnoses without the given effects and places, and with others that are named but not
            written.
        unstated: Effects and places that are not to be written.

    Returns:
        The diagnosis and its extended stiffness.
    """
    barred: frozenset[EffectLocation] = frozenset()
    reasons: tuple[str, ...] = ()
    for _ in range(MAX_SEARCHES):
        found = look(barred, unstated)
        extended_stiffness = build_extended_stiffness(cell, found.diagnosis, weight_alone=found.weight_alone)
        impossible = {(t.effect, t.location) for t in extended_stiffness.withheld} - barred - unstated
        if not impossible:
            break
        beside = any(isinstance(f.correction, KinematicCorrection) for f in found.diagnosis.findings)
        if beside and found.recording.kind == "absolute":
            barred |= impossible
        else:
            unstated |= impossible
            reasons = (*reasons, *extended_stiffness.notes)
    notes = tuple(
        f"{format_effect_in_sentence(*name)} would fit, as nothing that is built can be; it was left out and "
        f"all else found without it"
        for name in sorted(barred)
    )
    return replace(found, diagnosis=replace(found.diagnosis, notes=(*found.diagnosis.notes, *notes))), replace(
        extended_stiffness, notes=tuple(dict.fromkeys((*reasons, *extended_stiffness.notes)))
    )
