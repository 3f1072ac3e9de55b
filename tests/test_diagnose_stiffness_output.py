"""Diagnosis results in stiffness.yaml: observed joints and terms only."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.parameter_keys import ParameterKey, build_joint_spring_key
from machopt.data_types.stiffness import ArmStiffness, ExternalJointSpring, StiffnessTerm
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown, RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import BaseCoefficient, DiagnosisResult, Finding
from machopt.measurement.diagnosis.outputs.extended_stiffness import (
    ExtendedStiffness,
    add_withheld_notes,
    build_extended_stiffness,
)
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import build_fitted_term, compile_terms

ROOT = Path(__file__).resolve().parent.parent
CELL = load_cell(ROOT / "cells" / "kr240_drilling")
LINK = StiffnessTerm("link_compliance", "link:3", {"EI_Nm2": 1e7})


def build_diagnosis(joints: dict[int, float], terms: tuple[StiffnessTerm, ...], sigma: float = 0.1) -> DiagnosisResult:
    """Build a diagnosis with the fields that are read: compliances with the names of a motion channel, and findings."""
    other = BaseCoefficient(BaseUnknown(name="offset 1", unit="rad", location="joint:1"), 0.0, 1e-3, 1e-5)
    springs = [
        BaseCoefficient(
            BaseUnknown(
                name=f"compliance {j}",
                unit="rad/(N·m)",
                lower=0.0,
                location=f"joint:{j}",
                key=build_joint_spring_key(j),
            ),
            2 * c,
            c,
            sigma * c,
        )
        for j, c in joints.items()
    ]
    found = [SimpleNamespace(effect=t.effect, location=t.location, correction=t) for t in terms]
    return cast("DiagnosisResult", SimpleNamespace(coefficients=(other, *springs), findings=tuple(found), unwritten=()))


def test_observed_joints_are_written_and_the_others_come_from_the_cell() -> None:
    assert CELL.stiffness is not None
    made = build_extended_stiffness(CELL, build_diagnosis({2: 1e-6, 3: 2e-6}, (LINK,)))
    before, after = made.before, made.after
    assert before is not None
    assert after is not None
    expected = CELL.stiffness.joints.copy()
    expected[1:3] = 1e6, 5e5
    np.testing.assert_allclose(after.joints, expected, rtol=1e-12)
    expected[1:3] = 5e5, 2.5e5
    np.testing.assert_allclose(before.joints, expected, rtol=1e-12)
    assert after.terms == (LINK,)
    assert before.terms == ()
    unsure = build_extended_stiffness(CELL, build_diagnosis({2: 1e-6}, (), sigma=0.9)).after
    assert unsure is not None
    np.testing.assert_array_equal(unsure.joints, CELL.stiffness.joints)


@pytest.mark.parametrize("joints", [{2: 1e-6}, {}])
def test_stiffness_of_external_joints_is_preserved(joints: dict[int, float]) -> None:
    assert CELL.stiffness is not None
    rail = ExternalJointSpring(
        joint="rail", stiffness=4e7, slides=True, compliance=np.zeros((6, 6)), at=np.zeros(3), mass=900.0
    )
    cell = replace(CELL, stiffness=replace(CELL.stiffness, external=(rail,)))
    made = build_extended_stiffness(cell, build_diagnosis(joints, (LINK,)))
    assert made.after is not None
    assert made.after.external == (rail,)
    assert made.before is None or made.before.external == (rail,)


def test_term_is_written_without_an_observed_joint_and_replaces_the_old_one() -> None:
    assert CELL.stiffness is not None
    old = StiffnessTerm("link_compliance", "link:3", {"EI_Nm2": 5e7})
    cell = replace(CELL, stiffness=replace(CELL.stiffness, terms=(old,)))
    made = build_extended_stiffness(cell, build_diagnosis({}, (LINK,)))
    before, after = made.before, made.after
    assert before is cell.stiffness
    assert after is not None
    assert after.terms == (LINK,)
    assert build_extended_stiffness(
        replace(CELL, stiffness=None), build_diagnosis({2: 1e-6}, (LINK,))
    ) == ExtendedStiffness(None, None)


def test_keys_name_single_joints() -> None:
    assert build_joint_spring_key(3).joint == 3
    with pytest.raises(ValueError, match="no single joint"):
        _ = ParameterKey("joint_coupling", "joint:4-5", "ratio").joint


def test_rigid_beam_remains_rigid(tmp_path: Path) -> None:
    """A compliance of zero is a result; it must not be read back as a term that is still to be fitted."""
    robot, tool = load_robot(CELL), CELL.tool.T_flange_tcp
    beam = build_fitted_term("link_compliance", "link:2", robot, tool).with_values(np.zeros(2))
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, ArmStiffness(joints=np.full(6, 1e6), terms=(beam.to_file(),)))
    again, _ = compile_terms(load_stiffness(file).terms, robot, tool)
    state = robot.compute_state(np.zeros((1, 6)), tool, bodies=True)
    assert np.isfinite(again[0].values).all()
    np.testing.assert_array_equal(again[0].compute_response(state, np.ones((1, 6))) @ again[0].values, 0.0)


KNEE = StiffnessTerm(
    "joint_nonlinear_stiffness", "joint:3", {"law": "knee", "extra_rad_per_Nm": -3e-6, "knee_Nm": 100.0}
)
DRAG = StiffnessTerm(
    "joint_hysteresis", "joint:3", {"law": "bouc_wen", "drag_arcmin": 10.0, "reach_Nm": 100.0, "beta": 0.6}
)  # reduces the compliance by 29 rad/(MN·m)


@pytest.mark.parametrize("soft", [KNEE, DRAG], ids=lambda t: str(t.parameters["law"]))
def test_finding_that_moves_against_its_load_is_not_written(soft: StiffnessTerm) -> None:
    """Only terms that the planner accepts are written: the joint gets the stiffness fitted without the term, other
    findings remain."""
    made = build_extended_stiffness(CELL, build_diagnosis({2: 1e-6, 3: 2e-6}, (soft, LINK)))
    assert made.after is not None
    assert made.after.terms == (LINK,)
    assert made.after.joints[1:3] == pytest.approx([1e6, 2.5e5])  # joint 3 from the fit without the term
    assert made.withheld == (soft,)
    (output,) = made.notes
    assert re.match(r"(nonlinear stiffness|hysteresis) of joint 3 is not in stiffness.yaml", output)
    assert "from joint 3, which has 2e-06 (1/stiffness); less than that would work" in output
    limits = CELL.limits.lower[:6], CELL.limits.upper[:6]
    ArmElasticity(load_robot(CELL), CELL.tool.T_flange_tcp, made.after, limits)
    fits = replace(
        soft, parameters={**soft.parameters, **({"extra_rad_per_Nm": -1e-6} if soft is KNEE else {"drag_arcmin": 0.5})}
    )
    made = build_extended_stiffness(CELL, build_diagnosis({2: 1e-6, 3: 2e-6}, (fits,)))
    assert made.after is not None
    assert (made.after.terms, made.withheld) == ((fits,), ())


def test_matrix_with_a_negative_eigenvalue_is_not_written() -> None:
    """A matrix fitted to noise may have a negative eigenvalue: it is not written to a file, and the diagnosis gets a
    note."""
    C = np.diag([1e-9, 1e-9, 0.0, 1e-6, -1e-6, 0.0]).tolist()
    wrong = StiffnessTerm("tool_compliance", "tool", {"compliance": C})
    own = replace(wrong, parameters={"compliance": np.diag([1e-9] * 3 + [1e-7] * 3).tolist()})
    assert CELL.stiffness is not None
    cell = replace(CELL, stiffness=replace(CELL.stiffness, terms=(own,)))
    made = build_extended_stiffness(cell, build_diagnosis({2: 1e-6}, (wrong, LINK)))
    assert made.after is not None
    assert made.after.terms == (own, LINK)
    assert made.after.joints[1] == pytest.approx(5e5)  # fitted without the term
    assert made.withheld == (wrong,)
    (output,) = made.notes
    assert "tool compliance is not in stiffness.yaml" in output
    assert "deflects against the load" in output


def test_terms_with_negative_total_compliance_are_not_written_together() -> None:
    """First two findings at one joint, then one finding with a term of the cell, which remains."""
    half = replace(KNEE, parameters={**KNEE.parameters, "extra_rad_per_Nm": -1.5e-6})
    drag = replace(DRAG, parameters={**DRAG.parameters, "drag_arcmin": 0.5})
    made = build_extended_stiffness(CELL, build_diagnosis({3: 2e-6}, (half, drag)))
    assert made.after is not None
    assert len(made.after.terms) == len(made.withheld) == 1
    assert CELL.stiffness is not None
    cell = replace(CELL, stiffness=replace(CELL.stiffness, terms=(half,)))
    made = build_extended_stiffness(cell, build_diagnosis({3: 2e-6}, (drag,)))
    assert made.after is not None
    assert made.after.terms == (half,)
    assert len(made.withheld) == 1


def test_unwritten_finding_remains_in_the_diagnosis() -> None:
    made = ExtendedStiffness(None, None, (KNEE,), ("said",))
    f = Finding(
        effect="e",
        location="joint:3",
        law="",
        equation="",
        note="",
        one_of=(),
        parameters={},
        before=1.0,
        after=0.5,
        p_value=0.0,
    )
    d = DiagnosisResult.__new__(DiagnosisResult)
    for field in fields(DiagnosisResult):
        object.__setattr__(d, field.name, ())
    object.__setattr__(d, "findings", (replace(f, correction=KNEE), replace(f, correction=LINK), f))
    message = add_withheld_notes(d, made)
    assert message.findings[0].correction == RecordCorrection(KNEE.effect, KNEE.location, KNEE.parameters)
    assert message.findings[1:] == d.findings[1:]
    assert message.warnings == ("said",)


def test_unobserved_joint_stiffness_comes_from_the_cell() -> None:
    """Weight applies hardly any torque to joint 6: the cell value is used; without a cell value the smallest
    accepted stiffness is used."""
    assert CELL.stiffness is not None
    made = build_extended_stiffness(CELL, build_diagnosis({6: 0.09}, ()))
    assert made.after is not None
    np.testing.assert_array_equal(made.after.joints, CELL.stiffness.joints)
    alone = build_extended_stiffness(
        replace(CELL, stiffness=None), build_diagnosis({j: 0.09 if j == 6 else 1e-6 for j in range(1, 7)}, ())
    )
    assert alone.after is not None
    assert alone.after.joints == pytest.approx([1e6] * 5 + [1e2])


def test_implausible_spring_from_poses_without_load_is_not_written() -> None:
    """A joint 4 that is thirty times softer is a residual geometric error; joint 2 within a factor of two is a valid
    spring."""
    assert CELL.stiffness is not None
    k = CELL.stiffness.joints
    d = build_diagnosis({2: 1.4 / k[1], 4: 30.0 / k[3]}, ())
    alone, loaded = build_extended_stiffness(CELL, d, weight_alone=True), build_extended_stiffness(CELL, d)
    assert alone.before is not None
    assert alone.after is not None
    assert loaded.after is not None
    assert alone.after.joints / k == pytest.approx([1.0, 1.0 / 1.4, 1.0, 1.0, 1.0, 1.0])
    assert alone.before.joints[1] == pytest.approx(k[1] / 2.8)  # twice as soft in the fit without the findings
    assert loaded.after.joints[3] == pytest.approx(k[3] / 30.0)
    assert len(alone.notes) == 1
    assert "joint 4 keeps the cell's spring" in alone.notes[0]
    assert not loaded.notes
