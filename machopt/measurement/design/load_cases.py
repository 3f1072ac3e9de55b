"""Load cases (pose × load): admissible load at each pose, expected deflection, and response of the unknown
compliances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.measurement.design.load_methods import LoadMethod, compute_unit_wrench
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.numerics.array_types import Array, Bools, Ints
from machopt.stiffness.arm_stiffness import ArmElasticity, ElasticState
from machopt.stiffness.kinetostatic_indices import compute_geometric_influence, compute_jacobian_derivative
from machopt.stiffness.terms import LinearTerm

REASONS = (
    "rope too short",
    "load above the limit",
    "deflection above the limit",
    "joint torque above the limit",
    "K_C matters too much",
    "too small to measure",
)


@dataclass(frozen=True, kw_only=True)
class LoadCriteria:
    """Limits of a load at a pose."""

    min_deflection: float = 0.0  # m
    max_deflection: float = np.inf  # m
    max_load: float = np.inf  # N
    max_torque: Array | None = None  # (6,) N·m, joint torques by the load alone
    nu_p: float = np.inf  # relative change of the translation by K_C (dumas2011 eq. 14)
    nu_r: float = np.inf  # rad, change of the rotation by K_C (eq. 15)


@dataclass(frozen=True, kw_only=True)
class LoadCases:
    """N admissible readings, sorted by pose; for each pose and load method the largest admissible magnitude."""

    pose: Ints  # (N,) index into the pool
    way: Ints  # (N,) index of the load method
    magnitude: Array  # (N,) N
    wrench: Array  # (N, 6) N, N·m at the TCP in base_link axes
    point: Array  # (N, 3) m, load point in base_link
    twist: Array  # (N, 6) m, rad, expected displacement of the TCP
    response: Array  # (N, D, P) per unit of each unknown: six joint compliances, then the terms' coefficients
    nu_p: Array  # (N,)
    nu_r: Array  # (N,) rad
    rejected: dict[str, int]  # reason: number of rejected pose × method pairs

    def __len__(self) -> int:
        return len(self.pose)


def build_load_cases(
    pool: PosePool,
    ways: Sequence[LoadMethod],
    prior: ArmElasticity,
    terms: Sequence[LinearTerm],
    criteria: LoadCriteria,
    noise: ReadingNoise,
) -> LoadCases:
    """Build every admissible pose × load.

    Args:
        pool: P poses.
        ways: G methods of load application.
        prior: Prior model of the arm; it determines the expected deflections.
        terms: Linear terms to identify together with the joints.
        criteria: Limits of each load.
        noise: Noise of a reading; determines the number of rows per reading.

    Returns:
        The load cases.
    """
    elastic = prior.evaluate(pool.q)
    dJ = compute_jacobian_derivative(pool.state.J)
    parts = [_build_method_cases(pool, way, elastic, dJ, terms, criteria, noise.dimensions) for way in ways]
    rejected = np.sum([p.rejected for p in parts], axis=0)
    ok = np.stack([p.is_admissible for p in parts], axis=1)  # (P, G): sorted by pose when picked
    pose, way = (np.asarray(i, np.int64) for i in np.nonzero(ok))

    def pick(name: str) -> Array:
        return np.asarray(np.stack([getattr(p, name) for p in parts], axis=1)[ok])

    return LoadCases(
        pose=pose,
        way=way,
        magnitude=pick("magnitude"),
        wrench=pick("wrench"),
        point=pick("point"),
        twist=pick("twist"),
        response=pick("response"),
        nu_p=pick("nu_p"),
        nu_r=pick("nu_r"),
        rejected={reason: int(n) for reason, n in zip(REASONS, rejected, strict=True) if n},
    )


@dataclass(frozen=True, kw_only=True)
class _MethodCases:
    """One load method at all poses."""

    is_admissible: Bools  # (P,)
    rejected: Ints  # (len(REASONS),)
    magnitude: Array
    wrench: Array
    point: Array
    twist: Array
    response: Array
    nu_p: Array
    nu_r: Array


def _compute_load_caps(criteria: LoadCriteria, twist: Array, torque: Array) -> dict[str, Array]:
    """Return the largest load (N,) in N within each limit, by twist (N, 6) and joint torque (N, 6) per newton."""
    most_torque = np.full(6, np.inf) if criteria.max_torque is None else criteria.max_torque
    return {
        "load above the limit": np.full(len(twist), criteria.max_load),
        "deflection above the limit": _divide_limit(criteria.max_deflection, np.linalg.norm(twist[:, :3], axis=1)),
        "joint torque above the limit": _divide_limit(most_torque, np.abs(torque)).min(axis=1),
    }


def _build_method_cases(
    pool: PosePool,
    way: LoadMethod,
    elastic: ElasticState,
    dJ: Array,
    terms: Sequence[LinearTerm],
    criteria: LoadCriteria,
    dimensions: int,
) -> _MethodCases:
    J = pool.state.J
    unit, point = compute_unit_wrench(way, pool.T_base_tcp)
    possible = np.asarray(np.isfinite(unit).all(axis=1))
    unit = np.where(possible[:, None], unit, 0.0)
    linear = replace(elastic, geometric=False).compute_twist(unit)  # per newton
    tau = np.einsum("pci,pc->pi", J, unit)
    caps = _compute_load_caps(criteria, linear, tau)
    sizes = np.array(way.magnitudes)
    level = np.searchsorted(sizes, np.min(list(caps.values()), axis=0) * (1 + 1e-12), side="right") - 1
    reason: Ints = np.full(len(pool), -1, np.int64)
    reason[~possible] = REASONS.index("rope too short")
    for name, cap in caps.items():
        reason[(reason < 0) & (level < 0) & (cap < sizes[0])] = REASONS.index(name)
    nu_p, nu_r = np.zeros(len(pool)), np.zeros(len(pool))
    K_unit = np.einsum("pkci,pc->pik", dJ, unit)  # dumas2011 eq. 9, per newton
    open_ = np.flatnonzero(reason < 0)
    while len(open_):  # reduce the magnitude until K_C is negligible
        size = sizes[level[open_]][:, None]
        found = compute_geometric_influence(
            J[open_], elastic.k[open_], K_unit[open_] * size[..., None], unit[open_] * size
        )
        nu_p[open_], nu_r[open_] = found.nu_p, found.nu_r
        negligible = np.logical_and(found.nu_p <= criteria.nu_p, found.nu_r <= criteria.nu_r)
        bad = open_[~negligible]  # NaN (unstable under the load) is not negligible
        level[bad] -= 1
        reason[bad[level[bad] < 0]] = REASONS.index("K_C matters too much")
        open_ = bad[level[bad] >= 0]
    magnitude = np.where(reason < 0, sizes[np.maximum(level, 0)], 0.0)
    wrench = unit * magnitude[:, None]
    twist = elastic.compute_twist(wrench)
    small = np.linalg.norm(twist[:, :3], axis=1) < criteria.min_deflection
    reason[(reason < 0) & small] = REASONS.index("too small to measure")
    parts = [
        J * np.einsum("pci,pc->pi", J, wrench)[:, None, :],
        *(t.compute_response(pool.state, wrench) for t in terms),
    ]
    response = np.concatenate(parts, axis=-1)[:, :dimensions]
    counts = np.bincount(reason[reason >= 0], minlength=len(REASONS))
    return _MethodCases(
        is_admissible=reason < 0,
        rejected=counts,
        magnitude=magnitude,
        wrench=wrench,
        point=point,
        twist=twist,
        response=response,
        nu_p=nu_p,
        nu_r=nu_r,
    )


def _divide_limit(limit: float | Array, value: Array) -> Array:
    """Return limit/value, infinite for zero values."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(value > 0.0, limit / np.where(value > 0.0, value, 1.0), np.inf))
