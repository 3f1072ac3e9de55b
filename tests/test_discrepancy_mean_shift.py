"""Mean model discrepancy of a stiffness file: equals the candidate columns, and is included in a plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import simulated_load_tests as made
from test_compensation import corner
from test_planning_path import toolpath as made_path
from test_planning_pipeline import FORCE, FREE, K, small_job

from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.discrepancy_names import LOADED
from machopt.data_types.stiffness import ArmStiffness, ModelDiscrepancy, StiffnessTerm
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.kinematics.robot import RobotMasses
from machopt.planning.compensation.plan_compensation import compensate_plan
from machopt.planning.compensation.shifted_path import compute_residual
from machopt.planning.error_probability.model_discrepancy import DiscrepancyModel
from machopt.planning.plan_output.plan_remarks import describe_model_misfit
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.discrepancy_columns import CURVE_SMOOTHING, LOOP_COLUMN, list_elastic_columns, list_gear_columns

LINK = StiffnessTerm("link_compliance", "link:2", {"EI_Nm2": 2e6, "GJ_Nm2": 1e6})
MASSES = RobotMasses(
    np.array([2, 3, 6]), np.array([80.0, 60.0, 20.0]), np.full((3, 3), 0.2), np.array([0.0, 0.0, -9.8])
)
LOOPS = tuple(f"{LOOP_COLUMN} {j}" for j in range(1, 7))
NAMES = (
    *(f"joint {j}" for j in range(1, 7)),
    "term 0 0",
    "term 0 1",
    *list_elastic_columns(),
    *list_gear_columns(),
    *LOOPS,
    LOADED,
)


def doubt(*, counted: bool = True) -> ModelDiscrepancy:
    """Return a discrepancy with a contribution of every type."""
    rng = np.random.default_rng(3)
    size = np.where([n.split(" ")[0] in (*CURVE_SMOOTHING, LOOP_COLUMN) for n in NAMES], 1e-4, 3e-8)
    size[[" x" in n or " y" in n or " z" in n for n in NAMES]] = 1e-9
    size[-1] = 0.7
    shift = size * rng.uniform(-1.0, 1.0, len(NAMES))
    return ModelDiscrepancy(
        parts=NAMES,
        torque=np.array([400.0, 700.0, 350.0, 120.0, 90.0, 60.0]),
        shift=shift,
        modes=0.1 * size[None],
        left=3e-4,
        noise=3e-5,
        counted=counted,
    )


def test_shift_equals_the_sum_of_candidate_columns() -> None:
    _, robot, T = made.cell()
    rng = np.random.default_rng(5)
    q, w = made.CENTRE + rng.normal(0, 0.4, (7, 6)), np.hstack([rng.normal(0, 500, (7, 3)), rng.normal(0, 50, (7, 3))])
    stiffness = ArmStiffness(joints=made.TRUE_K, terms=(LINK,), discrepancy=doubt())
    alone = ArmElasticity(robot, T, stiffness, masses=MASSES)
    counted = ArmElasticity(robot, T, stiffness, masses=MASSES, counted=True)
    suspects = DiscrepancyModel.build(alone)
    assert suspects is not None
    state, k = robot.compute_state(q, T, bodies=True), np.tile(made.TRUE_K, (7, 1))
    more = suspects.suspects.compute_columns(state, k, w) @ doubt().shift
    np.testing.assert_allclose(
        counted.evaluate(q).compute_twist(w) - alone.evaluate(q).compute_twist(w), more, rtol=1e-9, atol=1e-14
    )
    small = suspects.suspects.compute_columns(state, k, w, small=True) @ doubt().shift
    C = counted.evaluate(q).compute_compliance() - alone.evaluate(q).compute_compliance()
    np.testing.assert_allclose(np.einsum("mij,mj->mi", C, w), small, rtol=1e-7, atol=1e-13)
    about = DiscrepancyModel.build(counted)
    assert about is not None
    assert not about.ways[0].any()  # only the mean is included
    assert suspects.ways[0].any()


def test_loaded_weight_and_geometric_stiffness_count_once() -> None:
    """K_C of the load alone and the term ``loaded`` together equal the equilibrium under weight and load, without
    double counting."""
    _, robot, T = made.cell()
    rng = np.random.default_rng(6)
    q, w = made.CENTRE + rng.normal(0, 0.4, (7, 6)), np.hstack([rng.normal(0, 1500, (7, 3)), np.zeros((7, 3))])
    masses = RobotMasses(np.array([2, 3, 6]), np.array([400.0, 300.0, 150.0]), np.full((3, 3), 0.2), MASSES.gravity)
    k, state = np.tile(0.2 * made.TRUE_K, (7, 1)), robot.compute_state(q, T, bodies=True)
    g, _ = compute_gravity_torque(robot, masses, state)
    tau = np.zeros_like(g)
    turned = {}
    for load in (0.0, 1.0):  # q + c τ(q + c τ), iterated to convergence
        tau = g
        for _ in range(60):
            bent = robot.compute_state(q + tau / k, T, bodies=True)
            tau = compute_gravity_torque(robot, masses, bent)[0] + load * np.einsum("mci,mc->mi", bent.J, w)
        turned[load] = robot.compute_fk(q + tau / k, T)[:, :3, 3]
    true = turned[1.0] - turned[0.0]
    one = np.ones(1)
    found = ModelDiscrepancy(
        parts=(LOADED,), torque=np.full(6, 400.0), shift=one, modes=0.01 * one[None], left=3e-4, noise=3e-5
    )
    off = {}
    for terms in ((), (StiffnessTerm("geometric_stiffness", "arm", {}),)):
        stiffness = ArmStiffness(joints=0.2 * made.TRUE_K, terms=terms, discrepancy=found)
        for counted in (False, True):
            output = (
                ArmElasticity(robot, T, stiffness, masses=masses, counted=counted).evaluate(q).compute_twist(w)[:, :3]
            )
            off[len(terms), counted] = np.linalg.norm(output - true) / np.linalg.norm(true)
    assert off[0, True] < 0.3 * off[0, False]
    assert off[1, True] < 0.3 * off[1, False]
    assert off[1, True] < 1.2 * off[0, True]


def test_stiffness_file_may_exclude_the_shift(tmp_path: Path) -> None:
    write_stiffness(
        tmp_path / "stiffness.yaml", ArmStiffness(joints=made.TRUE_K, terms=(LINK,), discrepancy=doubt(counted=False))
    )
    read = load_stiffness(tmp_path / "stiffness.yaml")
    assert read.discrepancy is not None
    assert not read.discrepancy.counted
    _, robot, T = made.cell()
    assert ArmElasticity(robot, T, read, counted=True).shift is None


def test_included_shift_is_compensated_and_reported(tmp_path: Path) -> None:
    options = replace(FREE, force=FORCE, rotation_step=np.radians(15.0), compensation_max=0.01)
    found = ModelDiscrepancy(
        parts=("base ry",),
        torque=np.full(6, 500.0),
        shift=np.array([2e-7]),
        modes=np.array([[5e-9]]),
        left=3e-4,
        noise=3e-5,
    )
    left = {}
    for counted in (False, True):
        stiffness = ArmStiffness(joints=np.asarray(K), discrepancy=replace(found, counted=counted))
        p = compensate_plan(small_job(tmp_path, corner(), options, stiffness=stiffness), made_path(corner()))
        true = ArmElasticity(
            p.setup.robot, p.setup.arm.T_flange_tcp, replace(stiffness, discrepancy=found), counted=True
        )
        rows = np.flatnonzero(p.path.counted)
        d = true.evaluate(p.chosen.assignment.q[rows]).compute_deflection(p.directions.force[rows])
        assert p.compensation is not None
        left[counted] = np.linalg.norm(p.compensation.offset[rows] + d, axis=1)
        assert compute_residual(p) is not None
        assert ("count in" in describe_model_misfit(p)) is counted
    assert np.median(left[True]) < 0.2 * np.median(left[False])  # corners leave a remainder
