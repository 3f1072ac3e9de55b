"""Plain random draws of stiffness, load and position for the check of probabilities."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.stiffness import ArmStiffness

DRAWS = 20_000
SEED = 7


def find_unsupported_draws(cell: Cell) -> str:
    """Return why the probabilities of a cell are not recomputed; empty where they are.

    Args:
        cell: The cell.
    """
    stiffness, accuracy = cell.stiffness, cell.accuracy
    assert stiffness is not None
    if stiffness.discrepancy is not None:
        return "the draws of a model discrepancy have no second implementation"
    if stiffness.grid is not None and stiffness.grid.std is not None:
        return "the draws of a stiffness grid have no second implementation"
    if any(term.covariance is not None for term in stiffness.terms):
        return "the draws of terms have no second implementation"
    if accuracy is not None and accuracy.lost_motion and not accuracy.includes_lost_motion:
        return "the draws of lost motion have no second implementation"
    return ""


def draw_compliances(stiffness: ArmStiffness, rng: np.random.Generator) -> np.ndarray | None:
    """Return (D, 6) drawn joint compliances relative to nominal; None where no spread is stated.

    Args:
        stiffness: The stiffness.
        rng: Random numbers.
    """
    if stiffness.covariance is not None:
        nominal = 1.0 / stiffness.joints
        drawn = rng.multivariate_normal(nominal, stiffness.covariance, size=2 * DRAWS, method="svd")
        drawn = drawn[(drawn > 0).all(axis=1)][:DRAWS]
        return np.asarray(drawn / nominal)
    if stiffness.spread is not None:
        return np.asarray(np.exp(-stiffness.spread * rng.standard_normal((DRAWS, 6))))
    return None


def draw_load_factors(
    process: CuttingProcess, one: ProcessOperation, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return (D,) factors of force and torque, relative to an unworn tool.

    Args:
        process: Content of process.yaml.
        one: The operation.
        rng: Random numbers.
    """
    wear = rng.uniform(one.wear[0], one.wear[1], DRAWS)
    scatter = one.scatter * rng.standard_normal(DRAWS)
    z, z_torque = rng.standard_normal((2, DRAWS))
    s, s_torque = _get_sigmas(process, one)
    exponent = s * z
    if one.kind == "drilling" and one.pilot == 0:
        drills = [process.materials[layer.material].drilling for layer in one.layers]
        if any(c is not None and c.chisel_Pa is None for c in drills):
            exponent = np.where(z > 0, 2.0 * exponent, exponent)
    return wear * np.exp(exponent + scatter), wear * np.exp(s_torque * z_torque + scatter)


def _get_sigmas(process: CuttingProcess, one: ProcessOperation) -> tuple[float, float]:
    if one.kind == "force":
        return one.spread or 0.0, 0.0
    if one.kind == "milling":
        milling = process.materials[one.material].milling
        return (0.0 if milling is None else milling.sigma_log), 0.0
    thrust = torque = 0.0
    for layer in one.layers:
        c = process.materials[layer.material].drilling
        if c is not None:
            thrust, torque = max(thrust, c.thrust_sigma_log), max(torque, c.torque_sigma_log)
    return thrust, torque


def get_position_std(cell: Cell, reference: str) -> float:
    """Return 1 sigma of a coordinate of the TCP in m; NaN where it is not stated.

    Args:
        cell: The cell.
        reference: ``absolute`` or ``relative``.
    """
    assert cell.stiffness is not None
    if reference == "relative":
        return math.nan if cell.accuracy is None else cell.accuracy.repeatability
    measured = cell.stiffness.position
    if measured is not None:
        return measured.std if cell.kinematics is not None else measured.plain
    return math.nan if cell.accuracy is None else cell.accuracy.absolute
