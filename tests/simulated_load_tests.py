"""Load tests on a simulated KR240 with known true values, independent of the fit.

Displacements are differences of pinocchio's forward kinematics after finite joint rotations c τ, with τ from
pinocchio's Jacobian; errors are drawn for each reading.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment

CELL = Path(__file__).resolve().parent.parent / "cells" / "kr240_drilling"
TRUE_K = np.array([3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5])  # N·m/rad, dumas2011 table 2
CENTRE, SPREAD = np.radians([0, -80, 100, 30, 60, 30.0]), np.radians([40, 30, 30, 60, 40, 90.0])
WHITE, CYCLE, POSE = 12e-6, 15e-6, 30e-6  # m, 1 sigma: typical noise
PER_METRE = 2.0  # rad per m: rotations are measured with targets half a metre apart
FORCE_SHARE, OUTLIERS = 0.007, 0.01


@cache
def cell() -> tuple[Cell, Robot, np.ndarray]:
    found = load_cell(CELL)
    return found, load_robot(found), found.tool.T_flange_tcp


@dataclass(frozen=True)
class PlannedLoadTests:
    """Poses and loads with their exact displacements; one row per reading."""

    q: np.ndarray
    wrench: np.ndarray  # (N, 6) base axes, at the TCP
    exact: np.ndarray  # (N, 6) m, rad
    pose: np.ndarray
    cycle: np.ndarray


def plan_load_tests(
    rng: np.random.Generator,
    poses: int = 20,
    loads: int = 4,
    repeats: int = 2,
    force: float = 1500.0,
    moment: float = 150.0,
    k: np.ndarray = TRUE_K,
    q: np.ndarray | None = None,
    wrench: np.ndarray | None = None,
) -> PlannedLoadTests:
    """Plan random poses and load directions (the same loads in each cycle of a pose)."""
    q = CENTRE + SPREAD * rng.uniform(-1, 1, (poses, 6)) if q is None else q
    poses = len(q)
    if wrench is None:
        wrench = rng.standard_normal((poses, loads, 6))
        for part, size in ((slice(0, 3), force), (slice(3, 6), moment)):
            wrench[..., part] *= size / np.linalg.norm(wrench[..., part], axis=-1, keepdims=True)
        wrench *= rng.uniform(0.3, 1.0, (poses, loads, 1))
    wrench = np.broadcast_to(wrench, (poses, *wrench.shape[-2:]))
    loads = wrench.shape[1]
    exact = np.array([[_compute_displacement(q[p], w, k) for w in wrench[p]] for p in range(poses)])
    pose, cycle = np.repeat(np.arange(poses), repeats * loads), np.repeat(np.arange(poses * repeats), loads)
    load = np.tile(np.arange(loads), poses * repeats)
    return PlannedLoadTests(q[pose], wrench[pose, load], exact[pose, load], pose, cycle)


def add_measurement_errors(
    made: PlannedLoadTests,
    rng: np.random.Generator,
    *,
    rotations: bool = False,
    noise: float = 1.0,
    outliers: float = OUTLIERS,
    labels: bool = True,
    stated: bool = True,
) -> Recording:
    """Return one recording of the tests with typical noise and gross outliers (shifted decimal points, wrong
    readings)."""
    N, D = len(made.q), 6 if rotations else 3
    size = noise * np.array([1, 1, 1, PER_METRE, PER_METRE, PER_METRE])[:D]
    d = made.exact[:, :D] + WHITE * size * rng.standard_normal((N, D))
    d += (CYCLE * size * rng.standard_normal((made.cycle.max() + 1, D)))[made.cycle]
    d += (POSE * size * rng.standard_normal((made.pose.max() + 1, D)))[made.pose]
    w = made.wrench * (1.0 + noise * FORCE_SHARE * rng.standard_normal(made.wrench.shape))
    for n in np.flatnonzero(rng.random(N) < outliers):
        kind = rng.integers(3)
        if kind == 0:
            d[n, rng.integers(D)] *= 10.0
        elif kind == 1:
            d[n, :3] += 0.5e-3 * rng.standard_normal(3)
        else:
            w[n, rng.integers(3)] *= 0.1
    force = FORCE_SHARE * float(np.sqrt(np.mean(made.wrench[:, :3] ** 2)))
    return Recording(
        kind="deflection",
        source="made up",
        q=made.q,
        pose=made.pose,
        cycle=made.cycle if labels else np.arange(N),
        session=np.zeros(N, np.int64),
        line=np.arange(2, N + 2),
        wrench=w,
        displacement=d,
        stated_labels=frozenset({"pose", "cycle"}) if labels else frozenset(),
        uncertainty=StandardUncertainty(
            displacement=WHITE, rotation=PER_METRE * WHITE if rotations else None, force=force
        )
        if stated
        else StandardUncertainty(),
    )


def draw_load_tests(
    rng: np.random.Generator, *, rotations: bool = False, noise: float = 1.0, **design: object
) -> LoadTestExperiment:
    """Plan new tests and simulate their measurement."""
    _, robot, T = cell()
    made = plan_load_tests(rng, **design)  # type: ignore[arg-type]
    return build_load_test_experiment(add_measurement_errors(made, rng, rotations=rotations, noise=noise), robot, T)


@cache
def _model() -> tuple[pin.Model, pin.Data, int, pin.SE3, pin.SE3]:
    found, _, T = cell()
    model = pin.buildModelFromUrdf(str(found.urdf))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    base = data.oMf[model.getFrameId(found.base_link)].copy()
    return model, data, model.getFrameId(found.flange_link), base, pin.SE3(T)


def _compute_displacement(q: np.ndarray, wrench: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return displacement and rotation vector (6,) of the TCP in base axes."""
    model, data, flange, base, tool = _model()

    def tcp(angles: np.ndarray) -> pin.SE3:
        pin.framesForwardKinematics(model, data, angles)
        return base.actInv(data.oMf[flange]) * tool

    before = tcp(q)
    J = pin.computeFrameJacobian(model, data, q, flange, pin.ReferenceFrame.LOCAL)
    at_tcp = tool.actInv(pin.SE3.Identity()).toActionMatrix() @ J  # twist of the TCP in its own axes
    turn = np.kron(np.eye(2), before.rotation)
    after = tcp(q + (turn @ at_tcp).T @ wrench / k)
    return np.concatenate([after.translation - before.translation, pin.log3(after.rotation @ before.rotation.T)])
