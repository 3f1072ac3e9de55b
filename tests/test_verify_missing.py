"""What a stiffness file says it lacks, recomputed by the verifier's own law: the planner's numbers, term by term."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_compensate import corner
from test_pipeline import FREE, K, small_job

from machopt.domain.stiffness import Discrepancy, Stiffness, Term
from machopt.model.suspects import LOADED, elastic_names, gear_names
from machopt.plan.doubt import Doubt, told_std
from machopt.verify.arm import Arm
from machopt.verify.elastic import Elasticity
from machopt.verify.springs import UnknownTermError

TERMS = (
    (Term("link_compliance", "link:2", {"EI_Nm2": 2e6, "GJ_Nm2": 1e6}), 2),
    (Term("base_compliance", "base", {"compliance_diagonal": [1e-9, 1e-9, 1e-9, 2e-7, 2e-7, 1e-7]}), 6),
    (
        Term(
            "joint_nonlinear_stiffness",
            "joint:3",
            {"law": "knees", "extra_rad_per_Nm": [1e-7, 5e-8], "knees_Nm": [90.0, 400.0]},
        ),
        2,
    ),
    (Term("joint_backlash", "joint:2", {"width_arcmin": 0.5, "transition_Nm": 60.0}), 1),
    (Term("joint_coupling", "joint:2-3", {"compliance_rad_per_Nm": 1e-8}), 1),
    (Term("joint_pose_dependent_stiffness", "joint:1", {"cos_rad_per_Nm": 1e-8, "sin_rad_per_Nm": -1e-8}), 2),
)


def stiffness(*, counted: bool) -> Stiffness:
    """A file with a little of everything missing."""
    rng = np.random.default_rng(4)
    own = [f"term {n} {p}" for n, (_, count) in enumerate(TERMS) for p in range(count)]
    names = (*(f"joint {j}" for j in range(1, 7)), *own, *elastic_names(), *gear_names(), LOADED)
    size = np.full(len(names), 3e-8)
    for n, name in enumerate(names):
        if name.startswith(("play", "knee")) or name == "term 3 0":
            size[n] = 1e-4
        elif name.endswith((" x", " y", " z")) or name in ("term 1 0", "term 1 1", "term 1 2"):
            size[n] = 1e-9
    size[-1] = 0.7
    shift, modes = size * rng.uniform(-1, 1, len(size)), 0.2 * size * rng.normal(size=(5, len(size)))
    found = Discrepancy(names, np.full(6, 400.0), shift, modes, 3e-4, 3e-5, local=1e-8, counted=counted)
    return Stiffness(np.asarray(K), terms=tuple(term for term, _ in TERMS), discrepancy=found)


@pytest.mark.parametrize("counted", [True, False])
def test_both_laws_say_the_same(tmp_path: Path, *, counted: bool) -> None:
    setup = small_job(tmp_path, corner(), FREE, stiffness=stiffness(counted=counted)).setup
    rng = np.random.default_rng(1)
    q, force = setup.cell.home + rng.normal(0, 0.4, (20, 6)), rng.normal(0, 500, (20, 3))
    e = rng.normal(size=(20, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    elastic, doubt = setup.elasticity.at(q), Doubt.of(setup.elasticity)
    assert doubt is not None
    arm = Arm(setup.cell)
    stance = arm.stance(q)
    law = Elasticity(setup.cell, arm, setup.elasticity.stiffness)
    soft = law.at(stance, stance.tcp[:, :3, 3])
    d = elastic.deflection(force)
    np.testing.assert_allclose(soft.displacement(force), d, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(soft.along(e), 1.0 / elastic.along(e), rtol=1e-7)
    np.testing.assert_allclose(soft.held(e), elastic.jiao_index(e), rtol=1e-7)
    along = d / np.linalg.norm(d, axis=1, keepdims=True)
    ways = np.einsum("mc,mcr->mr", along, doubt.moves(elastic, q, force))
    bend = told_std(ways, (doubt.local * np.linalg.norm(force, axis=1)) ** 2)
    np.testing.assert_allclose(law.bend_std(soft, force), bend, rtol=1e-6)
    axial = told_std(doubt.axial(elastic, q, e), doubt.local**2) / elastic.along(e) ** 2
    np.testing.assert_allclose(law.axial_std(soft, e), axial, rtol=1e-6)


def test_a_term_without_a_second_law_is_said(tmp_path: Path) -> None:
    tool = Term("tool_compliance", "tool", {"cylinders": [{"diameter_mm": 40, "length_mm": 90, "youngs_GPa": 210}]})
    lacks = Discrepancy(("term 0 0",), np.full(6, 400.0), np.array([0.1]), np.array([[0.1]]), 3e-4, 3e-5)
    setup = small_job(tmp_path, corner(), FREE).setup
    with pytest.raises(UnknownTermError, match="tool_compliance"):
        Elasticity(setup.cell, Arm(setup.cell), replace(stiffness(counted=True), terms=(tool,), discrepancy=lacks))
