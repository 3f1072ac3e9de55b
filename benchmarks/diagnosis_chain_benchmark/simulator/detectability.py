"""How much of an effect is left in the record once the joint springs (and what else belongs to the base) are refitted.

Linear algebra on the simulator's own Jacobians: the columns a refit may use, whitened by the clusters of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.arm_model import arm_of
from simulator.measurement_setup import MeasurementSetup
from simulator.static_equilibrium import Setting, Statics

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Base:
    """What a refit of the base can absorb."""

    columns: Array  # (N, C, P): readings, coordinates, parameters
    cluster: NDArray[np.int64]  # (N,)
    white: Array  # (C,) 1 sigma of a reading
    shared: Array  # (C,) 1 sigma of a cluster
    step: int = 1  # the columns are those of every step-th row only

    def whiten(self, y: Array) -> Array:
        """(N, C, P) with unit covariance where errors are white plus one shared by each cluster."""
        _, inverse = np.unique(self.cluster, return_inverse=True)
        counts = np.bincount(inverse)
        mean = np.zeros((len(counts), *y.shape[1:]))
        np.add.at(mean, inverse, y)
        mean /= counts[:, None, None]
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + np.outer(counts, (self.shared / self.white) ** 2))
        return np.asarray((y - (shrink[:, :, None] * mean)[inverse]) / self.white[:, None])

    def left(self, y: Array, more: Array | None = None) -> tuple[Array, float]:
        """Residual (N, C) after a weighted refit, and its noncentrality √(rᵀ Σ⁻¹ r): what a perfect test could use."""
        y = y[:: self.step]
        columns = self.columns if more is None else np.concatenate([self.columns, more], axis=2)
        P = columns.shape[2]
        Xw, yw = self.whiten(columns).reshape(-1, P), self.whiten(y[:, :, None]).reshape(-1)
        size = np.linalg.norm(Xw, axis=0)
        used = size > 0
        solution = np.zeros(P)
        solution[used] = np.linalg.lstsq(Xw[:, used] / size[used], yw, rcond=1e-10)[0] / size[used]
        return y - columns @ solution, float(np.linalg.norm(yw - Xw @ solution) * np.sqrt(self.step))


def jacobians(world: MeasurementSetup, encoder: Array) -> tuple[Array, Array, Array]:
    """J (N, 6, 6) of the nominal arm at the tip, tip position (N, 3) and rotation (N, 3, 3)."""
    statics = Statics(arm_of(world.nominal))
    x = np.zeros((len(encoder), len(statics.model.chain)))
    x[:, statics.model.joint] = encoder
    posture = statics.model.chain.forward(x)
    tip, rotation = posture.tip()
    return posture.jacobian(), tip, rotation


def deflection_base(world: MeasurementSetup, encoder: Array, wrench: Array, cluster: NDArray[np.int64]) -> Base:
    """Six joint compliances under the recorded wrench."""
    J, _, _ = jacobians(world, encoder)
    tau = np.einsum("nci,nc->ni", J, wrench)
    C = 6 if world.six else 3
    n = world.noise
    white = np.array([n.reading] * 3 + [n.turn_reading] * 3)[:C]
    shared = np.array([np.hypot(n.cycle, n.session)] * 3 + [n.turn_cycle] * 3)[:C]
    return Base((J * tau[:, None, :])[:, :C], cluster, white, shared)


def pose_base(world: MeasurementSetup, encoder: Array, wrench: Array, cluster: NDArray[np.int64], fit: bool) -> Base:
    """Six joint compliances under weight and load, and the registration of tracker and target."""
    statics = Statics(arm_of(world.nominal))
    e = statics.settle(Setting(encoder, wrench))
    J, tip, R = e.posture.jacobian()[:, :3, statics.model.joint], e.position, e.rotation
    columns = [J * e.torque[:, None, :]]
    if fit:
        turn = np.zeros((len(tip), 3, 3))
        turn[:, 0, 1], turn[:, 0, 2], turn[:, 1, 2] = tip[:, 2], -tip[:, 1], tip[:, 0]
        turn -= np.swapaxes(turn, 1, 2)
        columns += [np.broadcast_to(np.eye(3), turn.shape), turn, R]
    n = world.noise
    shared = np.full(3, np.sqrt(n.pose_return**2 / 3.0 + (0.5 * n.cycle) ** 2))
    return Base(np.concatenate(columns, axis=2), cluster, np.full(3, n.reading), shared)


def rms(y: Array) -> float:
    """Of one coordinate."""
    return float(np.sqrt(np.mean(y**2)))
