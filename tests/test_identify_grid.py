"""Grid-variable joint stiffness: geometry, likelihood, shrinkage, unmeasured cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from grid_measurement_poses import grid_plan
from simulated_arm import Compliance, Noise, Simulated, SmoothField, TrueArm, random_loads, record

from machopt.cell.cell_reader import load_cell
from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.stiffness import ArmStiffness, StiffnessGrid
from machopt.errors import InputError
from machopt.kinematics.inverse.solver import InverseKinematicsSolver, SingularityMargins, build_solver
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.estimation.tiled_linear_algebra import (
    invert_positive_definite,
    multiply_matrices,
    multiply_vector,
)
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit, fit_stiffness
from machopt.measurement.identification.grid_stiffness.grid_cells import (
    GridRegion,
    find_measured_cells,
    interpolate_by_kriging,
)
from machopt.measurement.identification.grid_stiffness.grid_equations import GridEquations
from machopt.measurement.identification.grid_stiffness.grid_fit import (
    FACE_TOLERANCE,
    GridFit,
    _compute_pose_positions,
    fit_grid,
)
from machopt.measurement.identification.grid_stiffness.grid_prior import GridPrior
from machopt.numerics.rigid_transforms import build_transform, convert_vector_to_rotation, invert_transform
from machopt.stiffness.joint_stiffness import GRID_FACE_TOLERANCE_M, compute_joint_stiffness
from machopt.stiffness.terms import build_fitted_term

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr500_milling"
ORIGIN = np.array([1.8407, -0.6, 0.1843])  # origin of the calibration space, in base_link
SIZE = np.array([0.6, 1.2, 0.6])
MARGINS = SingularityMargins(np.radians(5), np.radians(3), 0.05, np.radians(2))
BRANCH = 5  # elbow up, arm forward, wrist as in the home position
BASE_SEEDS = (1, 5)
NO_TERMS = np.zeros(0, bool)
Law = np.ndarray | Compliance


class Rig:
    """The KR 500 with the functions needed to load it anywhere in the calibration space."""

    def __init__(self) -> None:
        self.cell: Cell = load_cell(CELL)
        self.robot: Robot = load_robot(self.cell)
        self.solver: InverseKinematicsSolver = build_solver(self.robot)
        self.T = self.cell.tool.T_flange_tcp
        assert self.cell.stiffness is not None
        self.c = 1.0 / self.cell.stiffness.joints

    def poses(self, position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return poses with the TCP at the given positions; the tool orientation is that of home plus a few degrees."""
        turned = convert_vector_to_rotation(np.radians(12) * rng.uniform(-1, 1, (len(position), 3)))
        R = self.robot.compute_fk(self.cell.home, self.T)[:3, :3] @ turned
        q = self.solver.solve(build_transform(R, position) @ invert_transform(self.T)).q[:, BRANCH]
        return q[np.isfinite(q).all(axis=1)]

    def anywhere(self, rng: np.random.Generator, count: int) -> np.ndarray:
        return self.poses(ORIGIN + SIZE * rng.random((count, 3)), rng)

    def measure(
        self,
        law: Law,
        q: np.ndarray,
        rng: np.random.Generator,
        loads: int = 6,
        share: np.ndarray | None = None,
        noise: Noise | None = None,
        rotations: bool = False,
    ) -> tuple[StiffnessFit, Simulated]:
        w = random_loads(rng, len(q), loads, 1000, 300) * (1.0 if share is None else share[:, None, None])
        arm = TrueArm(self.robot, self.T, law)
        made = record(arm, q, w, rng, loads_per_cycle=3, noise=noise, rotations=rotations)
        return fit_stiffness(build_load_test_experiment(made.recording, self.robot, self.T)), made

    def fresh_error(self, law: Law, stiffness: ArmStiffness, rng: np.random.Generator) -> float:
        """Return the rms error in m of predicted coordinates at 80 new poses, compared with the noise-free values."""
        q = self.anywhere(rng, 80)
        made = record(
            TrueArm(self.robot, self.T, law), q, random_loads(rng, len(q), 4, 1000, 300), rng, noise=Noise.none()
        )
        e = build_load_test_experiment(made.recording, self.robot, self.T)
        k = compute_joint_stiffness(stiffness, e.T_base_tcp[:, :3, 3]).k
        return float(np.sqrt(np.mean((np.einsum("ndj,nj->nd", e.response(), 1 / k) - e.measured) ** 2)))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig()


def cellwise(region: GridRegion, joints: np.ndarray) -> ArmStiffness:
    return ArmStiffness(
        joints=joints.mean(axis=0), grid=StiffnessGrid(region.origin, region.cell, region.shape, joints)
    )


def law_of(stiffness: ArmStiffness) -> Compliance:
    return lambda q, p: 1.0 / compute_joint_stiffness(stiffness, p).k


def drawn_cells(rig: Rig, region: GridRegion, rng: np.random.Generator, spread: float) -> np.ndarray:
    return np.exp(spread * rng.standard_normal((len(region), 6))) / rig.c


# ------------------------------------------------------------------------------------------------------- geometry


def test_cells_of_a_position_equal_those_of_the_planner() -> None:
    rng = np.random.default_rng(0)
    region = GridRegion(np.array([0.1, -0.2, 0.3]), 0.15, (3, 2, 4))
    inner = region.origin + rng.random((200, 3)) * 0.15 * np.array(region.shape)
    lattice = region.origin + 0.15 * np.stack(np.meshgrid(*[np.arange(n + 1) for n in region.shape]), -1).reshape(-1, 3)
    on_edge = lattice + np.array([0.07, 0, 0])
    on_face = lattice + np.array([0.07, 0.02, 0])
    position = np.concatenate([inner, lattice, on_edge, on_face, lattice + 5e-7, region.origin - rng.random((20, 3))])
    stiffness = cellwise(region, rng.uniform(1e5, 1e7, (len(region), 6)))
    expected = compute_joint_stiffness(stiffness, position)
    cells = region.cells(position, GRID_FACE_TOLERANCE_M)
    np.testing.assert_array_equal((cells >= 0).any(axis=1), expected.is_in_grid)
    assert stiffness.grid is not None
    for row, k in zip(cells[expected.is_in_grid], expected.k[expected.is_in_grid], strict=True):
        own = row[row >= 0]
        assert len(set(own)) == len(own)
        np.testing.assert_allclose(stiffness.grid.joints[own].mean(axis=0), k, rtol=1e-14)
    assert ((cells >= 0).sum(axis=1) == 8).sum() >= 2 * (2 * 1 * 3)  # every inner corner, exact and offset by 0.5 µm


def test_relative_compliance_of_a_place_and_its_derivative() -> None:
    """ρ is the harmonic mean of the relative compliances of the cells; its derivative equals finite differences."""
    rng = np.random.default_rng(1)
    region = GridRegion(np.zeros(3), 1.0, (2, 2, 1))
    places = find_measured_cells(
        region, np.array([[0.5, 0.5, 0.5], [1, 0.5, 0.5], [1, 1, 0.5], [1.5, 1.5, 0.2]]), FACE_TOLERANCE
    )
    z = 0.3 * rng.standard_normal((len(places.cells), 6))
    E, u = places.linear(z, 2)
    beta = np.concatenate([z.ravel(), [0.7, -0.2]])
    r = u + (E @ beta).reshape(u.shape)
    np.testing.assert_allclose(r[:, 6:], [[0.7, -0.2]] * len(u), atol=1e-15)
    for row, share in zip(r, places.share, strict=True):
        own = share > 0
        np.testing.assert_allclose(1 / row[:6], np.exp(-z[own]).mean(axis=0), rtol=1e-13)
    d, h = rng.standard_normal(z.shape), 1e-6

    def exact(z: np.ndarray) -> np.ndarray:
        E, u = places.linear(z, 0)
        return u + (E @ z.ravel()).reshape(u.shape)

    slope = (exact(z + h * d) - exact(z - h * d)) / (2 * h)
    np.testing.assert_allclose(slope.ravel(), places.linear(z, 0)[0] @ d.ravel(), atol=1e-9)


def test_unmeasured_cells_follow_their_neighbours_and_the_mean() -> None:
    region, used = GridRegion(np.zeros(3), 1.0, (4, 1, 1)), np.array([0, 1])
    weight, left, mean, unsure = interpolate_by_kriging(region, used, 0.0)
    np.testing.assert_allclose(weight[2:], [[0.5, 0.5]] * 2)  # without correlation: the mean
    np.testing.assert_allclose(left, [0, 0, 1.5, 1.5])  # 1 for the cell itself plus 0.5 for the mean of two
    np.testing.assert_allclose(mean, [0.5, 0.5])
    assert unsure == pytest.approx(0.5)
    weight, left, *_ = interpolate_by_kriging(region, used, 2.0)
    np.testing.assert_allclose(weight.sum(axis=1), 1.0, atol=1e-12)  # unbiased
    assert weight[2, 1] > weight[2, 0]
    assert 0 < left[2] < left[3]


def test_grid_around_planned_poses_equals_the_planned_one(rig: Rig) -> None:
    rng = np.random.default_rng(0)
    plan = grid_plan(rig.cell, rig.robot, rig.solver, GridRegion(ORIGIN, 0.3, (2, 4, 2)), MARGINS)
    f, _ = rig.measure(rig.c, plan.q[plan.reached], rng, loads=3)  # encoder errors of fractions of a millimetre
    g = fit_grid(f, 0.3)
    assert g.grid.shape == (2, 4, 2)
    np.testing.assert_allclose(g.grid.origin, ORIGIN, atol=2e-3)
    assert g.inside.all()
    assert g.readings.sum() == pytest.approx(g.weighting.robust.mean(axis=1).sum(), rel=1e-9)


# ------------------------------------------------------------------------------------------------------ likelihood


@pytest.mark.parametrize("n", [1, 63, 64, 65, 200])
def test_tiled_algebra_equals_the_plain_one(n: int) -> None:
    rng = np.random.default_rng(n)
    X = rng.standard_normal((n, n + 5))
    A = X @ X.T / n + 0.1 * np.eye(n)
    inverse, log = invert_positive_definite(A)
    np.testing.assert_allclose(inverse @ A, np.eye(n), atol=1e-11)  # rounding times a condition of about 100
    np.testing.assert_array_equal(inverse, inverse.T)
    assert log == pytest.approx(np.linalg.slogdet(A)[1], rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(multiply_matrices(A, X), A @ X, atol=1e-12 * n)
    np.testing.assert_allclose(multiply_vector(A, X[:, 0]), A @ X[:, 0], atol=1e-12 * n)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        invert_positive_definite(A - 1e3 * np.eye(n))


def work_of(f: StiffnessFit, region: GridRegion) -> GridEquations:
    position, _ = _compute_pose_positions(f)
    everywhere = np.ones(len(f.y), bool)
    places = find_measured_cells(region, position, FACE_TOLERANCE)
    return GridEquations.from_fit(f, everywhere, places, np.ones(6, bool), f.compliance, True, NO_TERMS)


def test_gradient_of_the_likelihood(rig: Rig) -> None:
    rng = np.random.default_rng(2)
    region = GridRegion(ORIGIN, 0.3, (2, 4, 2))
    plan = grid_plan(rig.cell, rig.robot, rig.solver, region, MARGINS)
    field = SmoothField.draw(rig.c, rng, scale=0.4)
    f, _ = rig.measure(field, plan.q[plan.reached], rng, rotations=True)
    work = work_of(f, region)
    evidence, prior = work.evidence(work.start()), work.prior(work.start())
    beta = work.first_unknowns() + 0.1 * rng.standard_normal(len(work.first_unknowns()))
    linear = work.linear(beta)
    x = evidence.parameters(prior) + 0.2 * rng.standard_normal(len(evidence.parameters(prior)))
    _, slope = evidence.misfit(evidence.prior(x), linear)
    assert len(x) == 2 * 3 + 6 + 1 + 1  # noise of two channels, spreads, variation within a cell, correlation range
    for i, given in enumerate(slope):
        d = 1e-4 * np.eye(len(x))[i]
        ends = [evidence.misfit(evidence.prior(x + s * d), linear)[0] for s in (1, -1)]
        # one-sided steps of 1e-5 in the noise give an error of 1e-5 times a curvature of about the number of readings
        assert given == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=0.01, rel=1e-4)


def test_closed_form_of_held_out_poses_equals_refits(rig: Rig) -> None:
    rng = np.random.default_rng(3)
    region = GridRegion(ORIGIN, 0.6, (1, 2, 1))
    f, _ = rig.measure(SmoothField.draw(rig.c, rng, scale=0.4), rig.anywhere(rng, 24), rng, noise=Noise(outliers=0.0))
    g = fit_grid(f, 0.6, ORIGIN, (1, 2, 1), robust=False)
    work = work_of(f, region)
    pose = work.groups.pose
    prior = _prior_of(g)
    linear = work.linear(_unknowns_of(g, work))
    for p in (0, 7, 23):
        retained = pose != p
        places = replace(work.places, site=np.delete(work.places.site, p))
        rest = GridEquations.from_fit(
            fit_stiffness(f.experiment.select_readings(retained)),
            np.ones(retained.sum(), bool),
            places,
            work.varying_joints,
            work.reference,
            True,
            NO_TERMS,
        )
        weighting = replace(
            g.weighting, covariance=g.weighting.covariance[:, retained], robust=g.weighting.robust[retained]
        )
        posterior = rest.evidence(weighting).posterior(prior, linear)
        r = posterior.response[work.places.place[work.places.site[p]]]
        error = work.y[~retained] - work.A[~retained] @ r
        # the whole fit ends within a fraction of a standard error of its mode: nanometres, compared with 50 µm
        np.testing.assert_allclose(g.heldout.grid[~retained], error, atol=2e-7)


def _prior_of(g: GridFit) -> GridPrior:
    return GridPrior(g.spread, g.range / g.grid.cell, float(g.place_spread[0] / g.spread[0]), g.weighting.components)


def _unknowns_of(g: GridFit, work: GridEquations) -> np.ndarray:
    return np.log(1 / g.grid.joints / work.reference)[work.places.cells].ravel()


# ------------------------------------------------------------------------------------------------- estimation accuracy


def test_cells_are_estimated_with_correct_uncertainty(rig: Rig) -> None:
    """The true field is drawn from the model: errors divided by the stated sigma have variance 1."""
    region = GridRegion(ORIGIN, 0.3, (2, 4, 2))
    scores, better = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = drawn_cells(rig, region, rng, 0.2)
        f, _ = rig.measure(law_of(cellwise(region, truth)), rig.anywhere(rng, 160), rng)
        g = fit_grid(f, 0.3, ORIGIN, (2, 4, 2), smooth=False)
        assert g.grid.std is not None
        error, constant = np.log(g.grid.joints / truth), np.log(1 / f.compliance / truth)
        scores.append(error / (g.grid.std / g.grid.joints))
        better.append(np.sqrt(np.mean(error**2) / np.mean(constant**2)))
        assert (g.grid.joints > 0).all()
        # 16 cells determine the spread to 18 %, fewer observable joints less; 3 sigma allowed
        np.testing.assert_allclose(np.median(g.spread), 0.2, rtol=0.4)
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(g.covariance, axis1=1, axis2=2)) * g.grid.joints**2, g.grid.std, rtol=1e-9
        )
    z = np.concatenate(scores)
    # 64 cells × 6 joints, correlated within a cell: standard error of a standard deviation about 6 %
    assert 0.8 < z.std() < 1.25
    assert 0.84 < np.mean(np.abs(z) < 1.645) < 0.95  # the 90 % interval
    assert np.max(better) < 0.5  # at most half of the variation remains


def test_grid_without_variation_equals_the_constant_model(rig: Rig) -> None:
    worse, gains = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        f, _ = rig.measure(rig.c, rig.anywhere(rng, 80), rng)
        g = fit_grid(f, 0.3, ORIGIN, (2, 4, 2))
        k = 1 / f.compliance
        rng = np.random.default_rng(100 + seed)
        here = rig.fresh_error(rig.c, ArmStiffness(joints=k, grid=g.grid), rng)
        rng = np.random.default_rng(100 + seed)
        worse.append(here - rig.fresh_error(rig.c, ArmStiffness(joints=k), rng))
        gains.append(g.heldout.gain)
        assert np.median(g.spread) < 0.02
    gain, error = np.array(gains).T
    # not worse on held-out poses, within the standard error over the seeds
    assert gain.mean() > -gain.std(ddof=1) / np.sqrt(len(gain)) - error.mean() / np.sqrt(len(gain))
    assert np.mean(worse) < 1e-6  # at new poses: worse by less than 1 µm, with noise of 35 µm


def test_grid_with_variation_is_better_on_held_out_poses(rig: Rig) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        field = SmoothField.draw(rig.c, rng, amplitude=0.3, scale=0.5)
        f, _ = rig.measure(field, rig.anywhere(rng, 120), rng)
        g = fit_grid(f, 0.3, ORIGIN, (2, 4, 2))
        gain, error = g.heldout.gain
        assert gain > 3 * error
        here, constant = g.heldout.rmse
        assert here < 0.9 * constant
        k = 1 / f.compliance
        fresh = rig.fresh_error(field, ArmStiffness(joints=k, grid=g.grid), np.random.default_rng(50 + seed))
        assert fresh < 0.75 * rig.fresh_error(field, ArmStiffness(joints=k), np.random.default_rng(50 + seed))
        # the site component is identifiable: the field varies fully over 50 cm and a cell measures 30 cm
        assert (g.place_spread < g.spread + 1e-12).all()
        assert g.place_spread.max() > 0.01


def test_weakly_measured_cell_stays_near_the_mean_and_is_marked(rig: Rig) -> None:
    """Cell 0 has no reading, cell 1 one pose under 1/50 of the load, the others twenty poses each."""
    rng = np.random.default_rng(4)
    region = GridRegion(ORIGIN, 0.3, (2, 4, 2))
    truth = drawn_cells(rig, region, rng, 0.25)
    many = region.origin + SIZE * rng.random((900, 3))
    cell = region.cells(many, 0.0)[:, 0]
    chosen = np.concatenate([np.flatnonzero(cell == n)[: 1 if n == 1 else 20] for n in range(1, 16)])
    share = np.where(np.arange(len(chosen)) == 0, 0.02, 1.0)
    f, _ = rig.measure(law_of(cellwise(region, truth)), rig.poses(many[chosen], rng), rng, share=share)
    g = fit_grid(f, 0.3, ORIGIN, (2, 4, 2), smooth=False)
    assert g.grid.std is not None
    relative = g.grid.std / g.grid.joints
    np.testing.assert_allclose(g.grid.joints[0], g.centre, rtol=1e-9)  # without readings: the mean value
    assert (relative[0] >= g.spread).all()  # with the full spread and the standard error of the mean
    assert (relative[0] < 1.3 * g.spread).all()
    assert g.readings[0] == 0
    assert (g.information_gain[0] < 1e-9).all()
    assert (relative[1] <= relative[0]).all()
    assert (relative[1] > relative[2:].mean(axis=0)).all()
    assert g.information_gain[1].mean() < g.information_gain[2:].mean()
    # the estimate is less extreme than a separate fit to the readings of this cell
    alone = fit_stiffness(f.experiment.select_readings(f.experiment.pose == 0)).compliance
    assert np.abs(1 / g.grid.joints[1] * truth[1] - 1).max() < 0.6  # 2.5 times the spread of the true values
    assert np.abs(alone * truth[1] - 1).max() >= 1.0  # one joint rigid, another twice as soft
    np.testing.assert_allclose(
        np.sqrt(np.diag(g.centre_covariance)) * g.centre, relative[0], rtol=1e-6
    )  # the cell without readings


def test_neighbours_help_where_the_truth_is_smooth(rig: Rig) -> None:
    rng = np.random.default_rng(6)
    field = SmoothField.draw(rig.c, rng, amplitude=0.3, scale=0.6)
    q = rig.anywhere(rng, 90)
    f, _ = rig.measure(field, q, rng)
    errors = []
    for smooth in (True, False):
        g = fit_grid(f, 0.2, ORIGIN, (3, 6, 3), smooth=smooth)
        truth = 1 / field(np.zeros((54, 6)), GridRegion(ORIGIN, 0.2, (3, 6, 3)).centres())
        errors.append(np.sqrt(np.mean(np.log(g.grid.joints / truth) ** 2)))
        assert (g.range > 0) == smooth
    assert errors[0] < 0.9 * errors[1]


def test_outliers_do_not_move_cells(rig: Rig) -> None:
    region = GridRegion(ORIGIN, 0.3, (2, 4, 2))
    found = []
    for outliers in (0.0, 0.05):
        rng = np.random.default_rng(8)
        truth = drawn_cells(rig, region, rng, 0.2)
        f, made = rig.measure(
            law_of(cellwise(region, truth)), rig.anywhere(rng, 120), rng, noise=Noise(outliers=outliers)
        )
        g = fit_grid(f, 0.3, ORIGIN, (2, 4, 2), smooth=False)
        found.append(np.sqrt(np.mean(np.log(g.grid.joints / truth) ** 2)))
        if outliers:
            flagged = (g.weighting.robust < 0.5).any(axis=1)
            assert flagged[made.outlier].mean() > 0.9  # a few outliers of 0.25 mm are not detectable
            assert flagged[~made.outlier].mean() < 0.05
    assert found[1] < 1.25 * found[0]  # 5 % outliers of 0.5 mm cost the information of 5 % of the readings


def test_unobserved_joint_is_fixed(rig: Rig) -> None:
    """The TCP is on axis 6 and the forces have no moment: joint 6 has no effect."""
    rng = np.random.default_rng(0)
    flange = np.eye(4)
    q = rig.anywhere(rng, 60)
    arm = TrueArm(rig.robot, flange, rig.c)
    made = record(arm, q, random_loads(rng, len(q), 4, 1000), rng, noise=Noise(joint=0.0))
    f = fit_stiffness(build_load_test_experiment(made.recording, rig.robot, flange))
    with pytest.raises(InputError, match="no reading moves joint 6"):
        fit_grid(f, 0.6)
    hold = np.array([np.nan] * 5 + [3.49e5])
    g = fit_grid(f, 0.6, hold=hold)
    assert g.constant_joints == (6,)
    np.testing.assert_allclose(g.grid.joints[:, 5], 3.49e5, rtol=1e-12)
    assert g.grid.std is not None
    assert (g.grid.std[:, 5] == 0).all()
    assert (g.grid.std[:, :5] > 0).all()


def test_additional_term_is_fitted_with_the_grid(rig: Rig) -> None:
    rng = np.random.default_rng(2)
    region = GridRegion(ORIGIN, 0.6, (1, 2, 1))
    truth = drawn_cells(rig, region, rng, 0.2)
    link = build_fitted_term("link_compliance", "link:2", rig.robot, rig.T)
    x = np.array([1 / 4e6, 1 / 3e6])  # 1/(N·m²): 0.2 mm per kN at the end of the upper arm
    q = rig.anywhere(rng, 150)
    arm = TrueArm(rig.robot, rig.T, law_of(cellwise(region, truth)))
    made = record(arm, q, random_loads(rng, len(q), 6, 1000, 300), rng, rotations=True, loads_per_cycle=3)
    e = build_load_test_experiment(made.recording, rig.robot, rig.T)
    extra = link.compute_response(e.state, e.wrench) @ x
    e = replace(e, measured=e.measured + extra)
    f = fit_stiffness(e, [link])
    g = fit_grid(f, 0.6, ORIGIN, (1, 2, 1), smooth=False)
    with_term = np.sqrt(np.mean(np.log(g.grid.joints / truth) ** 2))
    without = fit_grid(fit_stiffness(e), 0.6, ORIGIN, (1, 2, 1), smooth=False)
    assert with_term < 0.5 * np.sqrt(np.mean(np.log(without.grid.joints / truth) ** 2))
    np.testing.assert_allclose(g.terms, x, rtol=0.1)  # bending and torsion of one link, separated from six joints


def test_recording_unsuitable_for_a_grid_is_reported(rig: Rig) -> None:
    rng = np.random.default_rng(0)
    f, _ = rig.measure(rig.c, rig.anywhere(rng, 30), rng)
    with pytest.raises(InputError, match=r"no reading lies inside the grid .* TCPs measured lie within"):
        fit_grid(f, 0.3, np.array([10.0, 0, 0]), (2, 2, 2))
    with pytest.raises(InputError, match="larger cell"):
        fit_grid(f, 0.001)
    with pytest.raises(InputError, match="three whole numbers"):
        fit_grid(f, 0.3, ORIGIN, (0, 2, 2))
    half = fit_grid(f, 0.3, ORIGIN, (2, 2, 2))  # readings outside the grid are excluded and reported
    assert 0 < half.inside.sum() < len(half.inside)
    assert len(half.heldout.grid) == half.inside.sum()


@pytest.mark.proof
def test_ten_thousand_readings_and_128_cells(rig: Rig) -> None:
    rng = np.random.default_rng(0)
    field = SmoothField.draw(rig.c, rng, scale=0.4)
    f, made = rig.measure(field, rig.anywhere(rng, 1000), rng, loads=10)
    assert len(made.recording) > 9900
    g = fit_grid(f, 0.15, ORIGIN, (4, 8, 4))
    assert g.heldout.rmse[0] < 0.75 * g.heldout.rmse[1]


# ------------------------------------------------------------------------------------------------------------ plan


@pytest.mark.parametrize(("edge", "positions"), [(0.6, 12 + 2), (0.3, 45 + 16), (0.15, 225 + 128)])
def test_nine_positions_per_cell_and_three_configurations(rig: Rig, edge: float, positions: int) -> None:
    shape = tuple(round(s / edge) for s in SIZE)
    region = GridRegion(ORIGIN, edge, shape)  # type: ignore[arg-type]
    plan = grid_plan(rig.cell, rig.robot, rig.solver, region, MARGINS)
    assert len(plan.position) == positions  # corners are shared
    assert len(plan.q) == 3 * positions
    for n in (0, len(region) - 1):
        rows = plan.of_cell(n)
        assert len(set(rows.tolist())) == 27
        p = plan.T_base_tcp[rows, :3, 3]
        offset = np.unique(np.round((p - region.centres()[n]) / (edge / 2), 9), axis=0)
        assert {tuple(v) for v in np.abs(offset)} == {(0, 0, 0), (1, 1, 1)}
        assert len(offset) == 9
        assert (region.cells(p, FACE_TOLERANCE) == n).any(axis=1).all()
    ok = plan.reached
    assert ok.mean() > 0.9
    # tolerance: rounding of the closed form
    np.testing.assert_allclose(rig.robot.compute_fk(plan.q[ok], rig.T), plan.T_base_tcp[ok], atol=1e-9)
    assert len(set(plan.branch[ok].tolist())) == 1
    limits = rig.cell.limits
    assert ((plan.q[ok] > limits.lower[:6]) & (plan.q[ok] < limits.upper[:6])).all()
    assert np.isnan(plan.q[~ok]).all()
    assert (plan.branch[~ok] == -1).all()
    # the initial orientation is along the edges; the others are rotated by 10° about the tool's y axis
    R = plan.T_base_tcp[:3, :3, :3]
    assert {0.0, 1.0} == set(np.abs(R[0]).round(12).ravel().tolist())
    np.testing.assert_allclose(np.degrees(plan.angle), [0, -10, 10])
    for turned in R[1:]:
        np.testing.assert_allclose(turned[:, 1], R[0][:, 1], atol=1e-12)
        assert turned[:, 0] @ R[0][:, 0] == pytest.approx(np.cos(np.radians(10)))


def test_unmeasurable_cells_have_a_reason(rig: Rig) -> None:
    far = grid_plan(rig.cell, rig.robot, rig.solver, GridRegion(np.array([9.0, 0, 0]), 0.3, (1, 1, 1)), MARGINS)
    assert (far.reason == InfeasibilityReason.UNREACHABLE).all()
    assert not far.reached.any()
    region = GridRegion(ORIGIN, 0.3, (2, 4, 2))
    robot, shapes = load_chain(rig.cell)
    collision = CollisionModel(rig.cell, robot, shapes, 0.0)
    plan = grid_plan(rig.cell, rig.robot, rig.solver, region, MARGINS, collision=collision)
    assert (plan.reason == InfeasibilityReason.COLLIDING).any()  # the table is inside the calibration space
    assert collision.check_configurations(plan.q[plan.reached], np.zeros(plan.reached.sum(), bool)).hit.sum() == 0
    other = grid_plan(rig.cell, rig.robot, rig.solver, region, MARGINS, branch=1)
    assert set(other.branch.tolist()) <= {-1, 1}


def test_coefficients_of_terms_stay_within_their_bounds(rig: Rig) -> None:
    """Readings of an arm on a rigid base: the fitted base compliances are noise, but none is negative."""
    region = GridRegion(ORIGIN, 0.6, (1, 2, 1))
    base = build_fitted_term("base_compliance", "base", rig.robot, rig.T)
    for seed in BASE_SEEDS:
        rng = np.random.default_rng(seed)
        arm = TrueArm(rig.robot, rig.T, law_of(cellwise(region, drawn_cells(rig, region, rng, 0.2))))
        q = rig.anywhere(rng, 40)
        made = record(arm, q, random_loads(rng, len(q), 6, 1000, 300), rng, rotations=True, loads_per_cycle=3)
        f = fit_stiffness(build_load_test_experiment(made.recording, rig.robot, rig.T), [base])
        g = fit_grid(f, 0.6, ORIGIN, (1, 2, 1), smooth=False)
        assert (f.x[6:] > 0).any(), seed
        assert (g.terms >= 0).all(), seed
