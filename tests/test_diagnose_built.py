"""What no file may hold bends no correction that is written: the rest is found again without it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from machopt.diagnose.nouns.result import Name
from machopt.diagnose.run import Examined
from machopt.diagnose.written import built
from machopt.diagnose.written.extended import Extended
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection
from machopt.domain.stiffness import Term

SOFT = Term("joint_pose_dependent_stiffness", "joint:4", {})


@pytest.mark.parametrize(
    ("kind", "beside", "times"), [("absolute", True, 2), ("absolute", False, 1), ("deflection", True, 1)]
)
def test_what_is_withheld_is_left_out_and_the_corrections_are_found_again(
    monkeypatch: pytest.MonkeyPatch, kind: str, beside: bool, times: int
) -> None:
    looked: list[frozenset[Name]] = []
    wave = KinematicCorrection("transmission_error", "joint:4", {})

    def look(barred: frozenset[Name]) -> Examined:
        looked.append(barred)
        corrections = [*([] if (SOFT.effect, SOFT.location) in barred else [SOFT]), *([wave] if beside else [])]
        return Examined(_diagnosis(corrections), cast("object", None), SimpleNamespace(kind=kind))  # type: ignore[arg-type]

    def stiffness_of(cell: Cell, d: object, **_: bool) -> Extended:
        held = tuple(f.correction for f in d.findings if isinstance(f.correction, Term))  # type: ignore[attr-defined]
        return Extended(None, None, held)

    monkeypatch.setattr(built, "stiffness_of", stiffness_of)
    monkeypatch.setattr(Examined, "weight_alone", False)
    found, made = built.built(cast("Cell", None), look)
    assert looked == [frozenset(), frozenset({(SOFT.effect, SOFT.location)})][:times]
    assert bool(made.withheld) == (times == 1)
    assert ("left out" in " ".join(found.diagnosis.notes)) == (times == 2)


def _diagnosis(corrections: list[object]) -> object:
    from dataclasses import make_dataclass

    made = make_dataclass("Diagnosis", ["findings", "notes"])
    return made(tuple(SimpleNamespace(correction=c) for c in corrections), ())
