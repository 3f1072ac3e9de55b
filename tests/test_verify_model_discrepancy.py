"""Model discrepancy of a stiffness file, recomputed by the verifier term by term."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_compensation import corner
from test_planning_pipeline import FREE, K, small_job

from machopt.data_types.cell import Cell
from machopt.data_types.discrepancy_names import LOADED
from machopt.data_types.stiffness import ArmStiffness, ModelDiscrepancy, StiffnessTerm
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.numerics.rigid_transforms import build_transform, convert_vector_to_rotation
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel, compute_reported_std
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.discrepancy_columns import CURVE_SMOOTHING, LOOP_COLUMN, list_elastic_columns, list_gear_columns
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel
from machopt.verification.motion.stiffness.spring_terms import UnknownTermError

TERMS = (
    (StiffnessTerm("link_compliance", "link:2", {"EI_Nm2": 2e6, "GJ_Nm2": 1e6}), 2),
    (StiffnessTerm("base_compliance", "base", {"compliance_diagonal": [1e-9, 1e-9, 1e-9, 2e-7, 2e-7, 1e-7]}), 6),
    (
        StiffnessTerm(
            "joint_nonlinear_stiffness",
            "joint:3",
            {"law": "knees", "extra_rad_per_Nm": [1e-7, 5e-8], "knees_Nm": [90.0, 400.0]},
        ),
        2,
    ),
    (StiffnessTerm("joint_backlash", "joint:2", {"width_arcmin": 0.5, "transition_Nm": 60.0}), 1),
    (StiffnessTerm("joint_coupling", "joint:2-3", {"compliance_rad_per_Nm": 1e-8}), 1),
    (StiffnessTerm("joint_pose_dependent_stiffness", "joint:1", {"cos_rad_per_Nm": 1e-8, "sin_rad_per_Nm": -1e-8}), 2),
)

LOOPS = tuple(f"{LOOP_COLUMN} {j}" for j in range(1, 7))


def stiffness(*, counted: bool, geometric: bool = False) -> ArmStiffness:
    """Return a file with every kind of discrepancy; ``geometric`` includes the effect of the load on the lever arms."""
    rng = np.random.default_rng(4)
    own = [f"term {n} {p}" for n, (_, count) in enumerate(TERMS) for p in range(count)]
    names = (*(f"joint {j}" for j in range(1, 7)), *own, *list_elastic_columns(), *list_gear_columns(), *LOOPS, LOADED)
    size = np.full(len(names), 3e-8)
    for n, name in enumerate(names):
        if name.split(" ")[0] in (*CURVE_SMOOTHING, LOOP_COLUMN) or name == "term 3 0":
            size[n] = 1e-4
        elif name.endswith((" x", " y", " z")) or name in ("term 1 0", "term 1 1", "term 1 2"):
            size[n] = 1e-9
    size[-1] = 0.7
    shift, modes = size * rng.uniform(-1, 1, len(size)), 0.2 * size * rng.normal(size=(5, len(size)))
    found = ModelDiscrepancy(
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
    terms = (*own_terms, StiffnessTerm("geometric_stiffness", "arm", {})) if geometric else own_terms
    return ArmStiffness(joints=np.asarray(K), terms=terms, discrepancy=found)


@pytest.mark.parametrize(("counted", "geometric"), [(True, False), (False, False), (True, True)])
def test_verifier_and_planner_agree_on_the_discrepancy(tmp_path: Path, *, counted: bool, geometric: bool) -> None:
    setup = small_job(tmp_path, corner(), FREE, stiffness=stiffness(counted=counted, geometric=geometric)).setup
    rng = np.random.default_rng(1)
    q, force = setup.cell.home + rng.normal(0, 0.4, (20, 6)), rng.normal(0, 500, (20, 3))
    e = rng.normal(size=(20, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    elastic, doubt = setup.elasticity.evaluate(q), DiscrepancyModel.build(setup.elasticity)
    assert doubt is not None
    arm = UrdfKinematics(setup.cell)
    stance = arm.compute_configuration(q)
    law = ComplianceModel(setup.cell, arm, setup.elasticity.stiffness)
    soft = law.evaluate(stance, stance.tcp[:, :3, 3])
    d = elastic.compute_deflection(force)
    np.testing.assert_allclose(soft.compute_displacement(force), d, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(soft.compute_stiffness_along(e), 1.0 / elastic.compute_compliance_along(e), rtol=1e-7)
    np.testing.assert_allclose(soft.compute_jiao_stiffness(e), elastic.compute_jiao_index(e), rtol=1e-7)
    along = d / np.linalg.norm(d, axis=1, keepdims=True)
    ways = np.einsum("mc,mcr->mr", along, doubt.moves(elastic, q, force))
    bend = compute_reported_std(ways, (doubt.local * np.linalg.norm(force, axis=1)) ** 2)
    np.testing.assert_allclose(law.compute_deflection_std(soft, force), bend, rtol=1e-6)
    axial = compute_reported_std(doubt.axial(elastic, q, e), doubt.local**2) / elastic.compute_compliance_along(e) ** 2
    np.testing.assert_allclose(law.compute_axial_std(soft, e), axial, rtol=1e-6)


STACK = {"cylinders": [{"diameter_mm": 40, "length_mm": 90, "youngs_GPa": 210}], "sensor_N_per_mm": [9e4, 9e4, 2e5]}
ALONE = (
    StiffnessTerm("tool_compliance", "tool", {**STACK, "scale": 1.3}),
    StiffnessTerm("tool_compliance", "tool", {"compliance_diagonal": [1e-9, 2e-9, 3e-9, 1e-7, 2e-7, 1e-7]}),
    StiffnessTerm("joint_nonlinear_stiffness", "joint:2", {"law": "cubic", "cubic_rad_per_Nm3": -1e-12}),
    StiffnessTerm("joint_nonlinear_stiffness", "joint:3", {"law": "cubic", "cubic_rad_per_Nm3": 1e-13}),
)


@pytest.fixture(scope="module")
def tilted_cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """A cell with a spindle at an angle to the flange."""
    cell = small_job(tmp_path_factory.mktemp("tilted"), corner(), FREE).setup.cell
    T = build_transform(convert_vector_to_rotation(np.array([0.3, -0.5, 0.2])), np.array([0.05, 0.02, 0.25]))
    return replace(cell, tool=replace(cell.tool, T_flange_tcp=T))


@pytest.mark.parametrize("term", ALONE, ids=lambda t: "-".join([t.effect, *t.parameters]))
def test_verifier_and_planner_agree_on_the_discrepancy_of_a_term(tilted_cell: Cell, term: StiffnessTerm) -> None:
    cell, rng = tilted_cell, np.random.default_rng(0)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    limits = cell.limits.lower[:6], cell.limits.upper[:6]
    own = ArmElasticity(robot, T, ArmStiffness(joints=np.asarray(K), terms=(term,)), limits, load_masses(cell)).terms[0]
    size = np.r_[1e-7, 0.2 * np.abs(own.values), 1e-8]
    parts = ("joint 1", *(f"term 0 {p}" for p in range(len(own.values))), "tool rx")
    found = ModelDiscrepancy(
        parts=parts,
        torque=np.full(6, 400.0),
        shift=0.3 * size,
        modes=size * rng.normal(size=(3, len(size))),
        left=3e-4,
        noise=3e-5,
    )
    stiffness = ArmStiffness(joints=np.asarray(K), terms=(term,), discrepancy=found)
    elasticity = ArmElasticity(robot, T, stiffness, limits, load_masses(cell), counted=True)
    q, force = cell.home[:6] + rng.normal(0, 0.4, (20, 6)), rng.normal(0, 500, (20, 3))
    arm = UrdfKinematics(cell)
    stance = arm.compute_configuration(q)
    law = ComplianceModel(cell, arm, stiffness)
    soft, elastic, doubt = (
        law.evaluate(stance, stance.tcp[:, :3, 3]),
        elasticity.evaluate(q),
        DiscrepancyModel.build(elasticity),
    )
    assert doubt is not None
    d = elastic.compute_deflection(force)
    np.testing.assert_allclose(soft.compute_displacement(force), d, rtol=1e-7, atol=1e-12)
    along = d / np.linalg.norm(d, axis=1, keepdims=True)
    ways = np.einsum("mc,mcr->mr", along, doubt.moves(elastic, q, force))
    np.testing.assert_allclose(law.compute_deflection_std(soft, force), compute_reported_std(ways), rtol=1e-6)


def test_part_without_a_term_is_reported(tilted_cell: Cell) -> None:
    lacks = ModelDiscrepancy(
        parts=("term 4 0",),
        torque=np.full(6, 400.0),
        shift=np.array([0.1]),
        modes=np.array([[0.1]]),
        left=3e-4,
        noise=3e-5,
    )
    with pytest.raises(UnknownTermError, match="term 4 0"):
        ComplianceModel(
            tilted_cell, UrdfKinematics(tilted_cell), replace(stiffness(counted=True), terms=ALONE, discrepancy=lacks)
        )
