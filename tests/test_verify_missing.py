"""What a stiffness file says it lacks, recomputed by the verifier's own law: the planner's numbers, term by term."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_compensate import corner
from test_pipeline import FREE, K, small_job

from machopt.domain.cell import Cell
from machopt.domain.lacking import LOADED
from machopt.domain.stiffness import Discrepancy, Stiffness, Term
from machopt.model.elastic import ArmElasticity
from machopt.model.robot import load_masses, load_robot
from machopt.model.suspects import BENDS, elastic_names, gear_names
from machopt.plan.certainty.discrepancy import Doubt, told_std
from machopt.se3 import rotation_from_vector, transform
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


def stiffness(*, counted: bool, geometric: bool = False) -> Stiffness:
    """A file with a little of everything missing; ``geometric``: that counts what the load does to levers."""
    rng = np.random.default_rng(4)
    own = [f"term {n} {p}" for n, (_, count) in enumerate(TERMS) for p in range(count)]
    names = (*(f"joint {j}" for j in range(1, 7)), *own, *elastic_names(), *gear_names(), LOADED)
    size = np.full(len(names), 3e-8)
    for n, name in enumerate(names):
        if name.split(" ")[0] in BENDS or name == "term 3 0":
            size[n] = 1e-4
        elif name.endswith((" x", " y", " z")) or name in ("term 1 0", "term 1 1", "term 1 2"):
            size[n] = 1e-9
    size[-1] = 0.7
    shift, modes = size * rng.uniform(-1, 1, len(size)), 0.2 * size * rng.normal(size=(5, len(size)))
    found = Discrepancy(
        parts=names,
        torque=np.full(6, 400.0),
        shift=shift,
        modes=modes,
        left=3e-4,
        noise=3e-5,
        local=1e-8,
        counted=counted,
    )
    own_terms = tuple(term for term, _ in TERMS)
    terms = (*own_terms, Term("geometric_stiffness", "arm", {})) if geometric else own_terms
    return Stiffness(joints=np.asarray(K), terms=terms, discrepancy=found)


@pytest.mark.parametrize(("counted", "geometric"), [(True, False), (False, False), (True, True)])
def test_both_laws_say_the_same(tmp_path: Path, *, counted: bool, geometric: bool) -> None:
    setup = small_job(tmp_path, corner(), FREE, stiffness=stiffness(counted=counted, geometric=geometric)).setup
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


STACK = {"cylinders": [{"diameter_mm": 40, "length_mm": 90, "youngs_GPa": 210}], "sensor_N_per_mm": [9e4, 9e4, 2e5]}
ALONE = (
    Term("tool_compliance", "tool", {**STACK, "scale": 1.3}),
    Term("tool_compliance", "tool", {"compliance_diagonal": [1e-9, 2e-9, 3e-9, 1e-7, 2e-7, 1e-7]}),
    Term("joint_nonlinear_stiffness", "joint:2", {"law": "cubic", "cubic_rad_per_Nm3": -1e-12}),
    Term("joint_nonlinear_stiffness", "joint:3", {"law": "cubic", "cubic_rad_per_Nm3": 1e-13}),
)


@pytest.fixture(scope="module")
def tilted_cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """A spindle at an angle to the flange."""
    cell = small_job(tmp_path_factory.mktemp("tilted"), corner(), FREE).setup.cell
    T = transform(rotation_from_vector(np.array([0.3, -0.5, 0.2])), np.array([0.05, 0.02, 0.25]))
    return replace(cell, tool=replace(cell.tool, T_flange_tcp=T))


@pytest.mark.parametrize("term", ALONE, ids=lambda t: "-".join([t.effect, *t.parameters]))
def test_what_a_term_itself_may_lack_is_the_same_by_both(tilted_cell: Cell, term: Term) -> None:
    cell, rng = tilted_cell, np.random.default_rng(0)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    limits = cell.limits.lower[:6], cell.limits.upper[:6]
    own = ArmElasticity(robot, T, Stiffness(joints=np.asarray(K), terms=(term,)), limits, load_masses(cell)).terms[0]
    size = np.r_[1e-7, 0.2 * np.abs(own.values), 1e-8]
    parts = ("joint 1", *(f"term 0 {p}" for p in range(len(own.values))), "tool rx")
    found = Discrepancy(
        parts=parts,
        torque=np.full(6, 400.0),
        shift=0.3 * size,
        modes=size * rng.normal(size=(3, len(size))),
        left=3e-4,
        noise=3e-5,
    )
    stiffness = Stiffness(joints=np.asarray(K), terms=(term,), discrepancy=found)
    elasticity = ArmElasticity(robot, T, stiffness, limits, load_masses(cell), counted=True)
    q, force = cell.home[:6] + rng.normal(0, 0.4, (20, 6)), rng.normal(0, 500, (20, 3))
    arm = Arm(cell)
    stance = arm.stance(q)
    law = Elasticity(cell, arm, stiffness)
    soft, elastic, doubt = law.at(stance, stance.tcp[:, :3, 3]), elasticity.at(q), Doubt.of(elasticity)
    assert doubt is not None
    d = elastic.deflection(force)
    np.testing.assert_allclose(soft.displacement(force), d, rtol=1e-7, atol=1e-12)
    along = d / np.linalg.norm(d, axis=1, keepdims=True)
    ways = np.einsum("mc,mcr->mr", along, doubt.moves(elastic, q, force))
    np.testing.assert_allclose(law.bend_std(soft, force), told_std(ways), rtol=1e-6)


def test_a_part_without_a_term_is_said(tilted_cell: Cell) -> None:
    lacks = Discrepancy(
        parts=("term 4 0",),
        torque=np.full(6, 400.0),
        shift=np.array([0.1]),
        modes=np.array([[0.1]]),
        left=3e-4,
        noise=3e-5,
    )
    with pytest.raises(UnknownTermError, match="term 4 0"):
        Elasticity(tilted_cell, Arm(tilted_cell), replace(stiffness(counted=True), terms=ALONE, discrepancy=lacks))
