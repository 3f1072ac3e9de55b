"""What of a diagnosis reaches stiffness.yaml: joints and terms that the data show, whatever else they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from machopt.diagnose.extended import stiffness_of
from machopt.diagnose.problem import Unknown
from machopt.diagnose.result import Coefficient, Diagnosis
from machopt.domain.parameters import ParameterKey, joint_spring
from machopt.domain.stiffness import Stiffness, Term
from machopt.formats.cell import load_cell
from machopt.formats.stiffness import load_stiffness, write_stiffness
from machopt.model.robot import load_robot
from machopt.model.terms import compile_terms, term_of

ROOT = Path(__file__).resolve().parent.parent
CELL = load_cell(ROOT / "cells" / "kr240_drilling")
LINK = Term("link_compliance", "link:3", {"EI_Nm2": 1e7})


def diagnosed(joints: dict[int, float], terms: tuple[Term, ...], sigma: float = 0.1) -> Diagnosis:
    """Only what is looked at: compliances under the names of a motion's channel, and findings."""
    other = Coefficient(Unknown("offset 1", "rad", location="joint:1"), 0.0, 1e-3, 1e-5)
    springs = [
        Coefficient(
            Unknown(f"compliance {j}", "rad/(N·m)", 0.0, f"joint:{j}", key=joint_spring(j)), 2 * c, c, sigma * c
        )
        for j, c in joints.items()
    ]
    found = [SimpleNamespace(effect=t.effect, location=t.location, correction=t) for t in terms]
    return cast("Diagnosis", SimpleNamespace(coefficients=(other, *springs), findings=tuple(found)))


def test_joints_that_are_shown_are_written_and_the_others_are_the_cell_s() -> None:
    assert CELL.stiffness is not None
    before, after = stiffness_of(CELL, diagnosed({2: 1e-6, 3: 2e-6}, (LINK,)))
    assert before is not None
    assert after is not None
    expected = CELL.stiffness.joints.copy()
    expected[1:3] = 1e6, 5e5
    np.testing.assert_allclose(after.joints, expected, rtol=1e-12)
    expected[1:3] = 5e5, 2.5e5
    np.testing.assert_allclose(before.joints, expected, rtol=1e-12)
    assert after.terms == (LINK,)
    assert before.terms == ()
    _, unsure = stiffness_of(CELL, diagnosed({2: 1e-6}, (), sigma=0.9))
    assert unsure is not None
    np.testing.assert_array_equal(unsure.joints, CELL.stiffness.joints)


def test_a_term_is_written_where_no_joint_is_shown_and_replaces_its_own() -> None:
    assert CELL.stiffness is not None
    old = Term("link_compliance", "link:3", {"EI_Nm2": 5e7})
    cell = replace(CELL, stiffness=replace(CELL.stiffness, terms=(old,)))
    before, after = stiffness_of(cell, diagnosed({}, (LINK,)))
    assert before is cell.stiffness
    assert after is not None
    assert after.terms == (LINK,)
    assert stiffness_of(replace(CELL, stiffness=None), diagnosed({2: 1e-6}, (LINK,))) == (None, None)


def test_keys_name_single_joints() -> None:
    assert joint_spring(3).joint == 3
    with pytest.raises(ValueError, match="no single joint"):
        _ = ParameterKey("joint_coupling", "joint:4-5", "ratio").joint


def test_a_beam_that_gives_nothing_stays_one(tmp_path: Path) -> None:
    """Zero is a finding; it must not come back as a term that is still to be fitted."""
    robot, tool = load_robot(CELL), CELL.tool.T_flange_tcp
    beam = term_of("link_compliance", "link:2", robot, tool).with_values(np.zeros(2))
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, Stiffness(np.full(6, 1e6), terms=(beam.to_file(),)))
    again, _ = compile_terms(load_stiffness(file).terms, robot, tool)
    state = robot.state(np.zeros((1, 6)), tool, bodies=True)
    assert np.isfinite(again[0].values).all()
    np.testing.assert_array_equal(again[0].response(state, np.ones((1, 6))) @ again[0].values, 0.0)
