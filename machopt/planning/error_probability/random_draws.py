"""Common draws of everything uncertain, for the probability that a tolerance holds.

All points of a job share one set of draws: a scrambled Sobol sequence with a fixed seed, as standard normal numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.numerics.array_types import Array
from machopt.numerics.sobol_sequence import draw_scrambled_sobol
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread

HOLE_DRAWS = 8192
SHARE_DRAWS = 1024  # of variances by source, and of the baselines, of which only outcomes are counted
SURFACE_DRAWS = 1024  # position noise is integrated exactly there
SEED = 20
DOUBLED = 2.0  # factor of the spread of a thrust above nominal, where the chisel edge is unknown
_OTHER = 4 + 6 + 6 + 3 + 2 + 3  # loads, sides, pose of the part, position, tilt, compliance of the pose alone


@dataclass(frozen=True, kw_only=True)
class UncertaintyDraws:
    """D draws; standard normal unless stated otherwise."""

    stiffness: Array  # (D, 1 + R) factors of the columns of the stiffness
    thrust: Array  # (D,) also of a milling force
    torque: Array  # (D,)
    scatter: Array  # (D,) from hole to hole
    wear: Array  # (D,) uniform 0 … 1
    side: Array  # (D, 6) ±1, side of arrival where it is undecided
    pose: Array  # (D, 6) pose of the part
    position: Array  # (D, 3)
    tilt: Array  # (D, 2)
    local: Array  # (D, 3) compliance of the pose alone

    def __len__(self) -> int:
        return len(self.thrust)

    def take_first(self, count: int) -> UncertaintyDraws:
        """Return the first draws, which are evenly spread themselves where their number is a power of two.

        Args:
            count: Number of draws.
        """
        return replace(self, **{f.name: getattr(self, f.name)[:count] for f in fields(self)})

    def compute_load_factor(self, process: CuttingProcess, one: ProcessOperation, *, torque: bool = False) -> Array:
        """Return (D,) the factor of a force relative to that of an unworn tool.

        Args:
            process: Content of process.yaml.
            one: The operation.
            torque: The factor of the drilling torque.
        """
        low, high = one.wear
        wear = low + (high - low) * self.wear
        z = self.torque if torque else self.thrust
        exponent = get_load_sigma(process, one, torque=torque) * z
        if not torque and has_unknown_chisel_edge(process, one):
            exponent = np.where(z > 0, DOUBLED * exponent, exponent)
        return np.asarray(wear * np.exp(exponent + one.scatter * self.scatter))


def build_draws(spread: StiffnessSpread, count: int) -> UncertaintyDraws:
    """Return draws for one stiffness file.

    Args:
        spread: Random part of the stiffness.
        count: Number of draws, a power of two.
    """
    from scipy.special import ndtri

    R = spread.dimensions
    u = draw_scrambled_sobol(R + _OTHER, 2 * count, np.random.default_rng(SEED))
    u = np.clip(u, 1e-12, 1.0 - 1e-12)
    z = ndtri(u)
    good = np.flatnonzero(spread.is_positive(z[:, :R]))[:count]  # a draw with a negative compliance is repeated
    z, u = z[good], u[good]
    rest = z[:, R:]
    return UncertaintyDraws(
        stiffness=spread.draw_factors(z[:, :R]),
        thrust=rest[:, 0],
        torque=rest[:, 1],
        scatter=rest[:, 2],
        wear=u[:, R + 3],
        side=np.where(rest[:, 4:10] > 0, 1.0, -1.0),
        pose=rest[:, 10:16],
        position=rest[:, 16:19],
        tilt=rest[:, 19:21],
        local=rest[:, 21:24],
    )


def build_nominal_draw(spread: StiffnessSpread) -> UncertaintyDraws:
    """Return one draw of nominal values, in the middle of the wear.

    Args:
        spread: Random part of the stiffness.
    """
    zero = np.zeros(1)
    return UncertaintyDraws(
        stiffness=np.r_[1.0, np.zeros(spread.count)][None],
        thrust=zero,
        torque=zero,
        scatter=zero,
        wear=np.full(1, 0.5),
        side=np.zeros((1, 6)),
        pose=np.zeros((1, 6)),
        position=np.zeros((1, 3)),
        tilt=np.zeros((1, 2)),
        local=np.zeros((1, 3)),
    )


def get_load_sigma(process: CuttingProcess, one: ProcessOperation, *, torque: bool = False) -> float:
    """Return 1 sigma of the logarithm of an operation's force or torque.

    Args:
        process: Content of process.yaml.
        one: The operation.
        torque: That of the drilling torque.
    """
    if one.kind == "force":
        return one.spread or 0.0
    if one.kind == "milling":
        milling = process.materials[one.material].milling
        return 0.0 if milling is None else milling.sigma_log
    found = [c for layer in one.layers if (c := process.materials[layer.material].drilling) is not None]
    return max((c.torque_sigma_log if torque else c.thrust_sigma_log for c in found), default=0.0)


def has_unknown_chisel_edge(process: CuttingProcess, one: ProcessOperation) -> bool:
    """Return whether a drill cuts with a chisel edge of unknown coefficient.

    Args:
        process: Content of process.yaml.
        one: The operation.
    """
    if one.kind != "drilling" or one.pilot > 0:
        return False
    found = [process.materials[layer.material].drilling for layer in one.layers]
    return any(c is not None and c.chisel_Pa is None for c in found)


def has_load_spread(process: CuttingProcess, one: ProcessOperation) -> bool:
    """Return whether the spread of an operation's force is stated.

    Args:
        process: Content of process.yaml.
        one: The operation.
    """
    if one.kind == "force":
        return one.spread is not None
    if one.kind == "milling":
        return process.materials[one.material].has_milling_spread
    return all(process.materials[layer.material].has_drilling_spread for layer in one.layers)
