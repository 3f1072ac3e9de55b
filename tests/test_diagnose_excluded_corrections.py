"""Corrections that no file can contain are excluded, and the others are fitted again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.data_types.stiffness import StiffnessTerm
from machopt.measurement.diagnosis.data_types.diagnosis_result import EffectLocation
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording
from machopt.measurement.diagnosis.outputs import implausible_correction_removal
from machopt.measurement.diagnosis.outputs.extended_stiffness import ExtendedStiffness

SOFT = StiffnessTerm("joint_pose_dependent_stiffness", "joint:4", {})


@pytest.mark.parametrize(
    ("kind", "beside", "is_barred"), [("absolute", True, True), ("absolute", False, False), ("deflection", True, False)]
)
def test_excluded_corrections_are_left_out_and_the_others_refitted(
    monkeypatch: pytest.MonkeyPatch, kind: str, beside: bool, is_barred: bool
) -> None:
    looked: list[tuple[frozenset[EffectLocation], frozenset[EffectLocation]]] = []
    wave = KinematicCorrection("transmission_error", "joint:4", {})

    def look(barred: frozenset[EffectLocation], unstated: frozenset[EffectLocation]) -> DiagnosedRecording:
        looked.append((barred, unstated))
        out = barred | unstated
        corrections = [*([] if (SOFT.effect, SOFT.location) in out else [SOFT]), *([wave] if beside else [])]
        return DiagnosedRecording(_diagnosis(corrections), cast("object", None), SimpleNamespace(kind=kind))  # type: ignore[arg-type]

    def stiffness_of(cell: Cell, d: object, **_: bool) -> ExtendedStiffness:
        fixed = tuple(f.correction for f in d.findings if isinstance(f.correction, StiffnessTerm))  # type: ignore[attr-defined]
        return ExtendedStiffness(None, None, fixed)

    monkeypatch.setattr(implausible_correction_removal, "build_extended_stiffness", stiffness_of)
    monkeypatch.setattr(DiagnosedRecording, "weight_alone", False)
    found, made = implausible_correction_removal.diagnose_with_plausible_corrections(cast("Cell", None), look)
    none, soft = frozenset[EffectLocation](), frozenset({(SOFT.effect, SOFT.location)})
    assert looked == [(none, none), (soft, none) if is_barred else (none, soft)]
    assert not made.withheld
    assert ("left out" in " ".join(found.diagnosis.notes)) == is_barred


def _diagnosis(corrections: list[object]) -> object:
    from dataclasses import make_dataclass

    made = make_dataclass("Diagnosis", ["findings", "notes"])
    return made(tuple(SimpleNamespace(correction=c) for c in corrections), ())
