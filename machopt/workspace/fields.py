"""What a map shows at a posture: stiffness by direction, deflection, dexterity, influence of the load, margins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.model.beside import Beside
from machopt.model.elastic import ArmElasticity, Elastic, joint_stiffness, translational_compliance
from machopt.model.kinetostatic import geometric_stiffness, influence_of_geometric, kci, stiffness_along
from machopt.model.robot import ArmState, Robot

Unit = Literal["N/m", "m", "rad", "1"]
RIGID = 1e-18  # of the largest compliance (m/N and rad/(N·m) mixed): rounding, no motion that way


@dataclass(frozen=True)
class Load:
    """A wrench on the TCP that all fields of deflection are for."""

    wrench: Array  # (6,) N, N·m, moment about the TCP
    axes: Literal["frame", "tool"]  # whose axes its components are along


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What fields are computed from, beside the posture."""

    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    elasticity: ArmElasticity | None  # None: the cell has no stiffness
    length: float  # m, characteristic length of the dexterity
    lower: Array  # (6,) rad, the robot's limits themselves
    upper: Array  # (6,)
    R_base_frame: Array  # (3, 3) columns: the map's x, y, z in base_link
    load: Load | None = None
    beside: Beside | None = None  # what external joints give; None: they are rigid
    external: Array | None = None  # (E,) rad or m, where these stand

    def at(self, q: Array) -> Situation:
        """The situation at postures q (M, 6) rad."""
        if self.elasticity is None:
            return Situation(self, self.robot.state(q, self.T_flange_tcp), None)
        if self.beside is None or self.external is None:
            elastic = self.elasticity.at(q)
        else:
            place = self.robot.fk(q, self.T_flange_tcp)[..., :3, 3]
            stands = np.tile(self.external, (len(q), 1))
            elastic = self.elasticity.at(q, beside=self.beside.compliance(stands, place))
        return Situation(self, elastic.state, elastic)


@dataclass(frozen=True)
class Situation:
    """M postures and their elasticity; what several fields share is computed once."""

    setting: Setting
    state: ArmState
    known: Elastic | None

    @property
    def elastic(self) -> Elastic:
        """The elasticity.

        Raises:
            ValueError: the cell has no stiffness; such fields are not offered then.
        """
        if self.known is None:
            raise ValueError("a field of stiffness needs a cell with stiffness")
        return self.known

    @cached_property
    def compliance(self) -> Array:
        """C (M, 6, 6) for a small load."""
        return self.elastic.compliance()

    @cached_property
    def tip(self) -> Array:
        """C_tt (M, 3, 3) m/N for a small load, symmetric."""
        if not self.elastic.terms:
            return translational_compliance(self.state.J, self.elastic.k)
        C = self.compliance[:, :3, :3]
        return np.asarray(0.5 * (C + np.swapaxes(C, -1, -2)))

    @cached_property
    def principal(self) -> Array:
        """Eigenvalues (M, 3) m/N of C_tt, rising."""
        return np.asarray(np.linalg.eigvalsh(self.tip), float)

    @property
    def tool(self) -> Array:
        """(M, 3, 3) columns: x, y, z of the TCP in base_link."""
        return self.state.T_base_tool[:, :3, :3]

    def axis(self, number: int) -> Array:
        """(M, 3) x, y or z of the map's frame in base_link."""
        return np.broadcast_to(self.setting.R_base_frame[:, number], (len(self.state.q), 3))

    @cached_property
    def wrench(self) -> Array:
        """(M, 6) the load in base_link axes."""
        load = self.setting.load
        if load is None:
            raise ValueError("a field of deflection needs a load; such fields are not offered without")
        R = self.setting.R_base_frame if load.axes == "frame" else self.tool
        both = np.stack([R @ load.wrench[:3], R @ load.wrench[3:]], axis=-2)
        return np.broadcast_to(both.reshape(*both.shape[:-2], 6), (len(self.state.q), 6))

    @cached_property
    def influence(self) -> tuple[Array, Array]:
        """ν_p (M,) and ν_r (M,) rad of the joint springs alone."""
        J, k, w = self.state.J, self.elastic.k, self.wrench
        found = influence_of_geometric(J, k, geometric_stiffness(J, w), w)
        return found.nu_p, found.nu_r

    def held(self, direction: Array) -> Array:
        """eᵀ C⁻¹ e with the 6×6 compliance: all five other motions held. inf where a singularity blocks it."""
        if not self.elastic.terms:
            return stiffness_along(self.state.J, self.elastic.k, direction, "pose")
        values, vectors = np.linalg.eigh(self.compliance)
        share = np.einsum("mcj,mc->mj", vectors[:, :3], direction) ** 2
        lost = values <= RIGID * values[:, -1:]
        stiffness = np.sum(np.where(lost, 0.0, share / np.where(lost, 1.0, values)), axis=1)
        return np.where((lost & (share > RIGID)).any(axis=1), np.inf, stiffness)


@dataclass(frozen=True, kw_only=True)
class Field:
    """One number at every posture."""

    key: str
    name: str  # for headings, plain text
    unit: Unit
    better: Literal["more", "less"]
    needs: frozenset[str]  # "stiffness", "load"
    note: str  # what it is and when it does not hold
    of: Callable[[Situation], Array]  # → (M,) SI

    def goodness(self, at: Situation) -> Array:
        """(M,) larger is better; −inf where there is no number."""
        value = self.of(at)
        return np.where(np.isfinite(value), value if self.better == "more" else -value, -np.inf)


def _along(number: int) -> Callable[[Situation], Array]:
    return lambda s: 1.0 / s.elastic.along(s.axis(number))


def _held(number: int) -> Callable[[Situation], Array]:
    return lambda s: s.held(s.axis(number))


def _across(s: Situation) -> Array:
    """1/λmax of the part of C_tt normal to the tool axis, closed form of the 2×2 block."""
    side = s.tool[:, :, :2]
    C = np.swapaxes(side, -1, -2) @ s.tip @ side
    mean, half = (C[:, 0, 0] + C[:, 1, 1]) / 2, (C[:, 0, 0] - C[:, 1, 1]) / 2
    return np.asarray(1.0 / (mean + np.hypot(half, (C[:, 0, 1] + C[:, 1, 0]) / 2)))


def _limit_margin(s: Situation) -> Array:
    q = s.state.q
    return np.asarray(np.minimum(q - s.setting.lower, s.setting.upper - q).min(axis=1))


_STIFF, _LOADED = frozenset({"stiffness"}), frozenset({"stiffness", "load"})
_SMALL = "1/(eᵀCe), what a small force along it meets, the tool free to give way and turn in every direction."
_HOLDS = (
    "Diagonal entry of J⁻ᵀ K J⁻¹ (tian2025 eq. 9): no other motion of the tool allowed. Peaks at singularities, "
    "where the arm cannot move that way at all; no cutting force feels it, so never choose a place by it."
)

FIELDS: tuple[Field, ...] = (
    Field(
        key="k_min",
        name="Stiffness, softest direction",
        unit="N/m",
        better="more",
        needs=_STIFF,
        note="1/λmax of the translational compliance: no force meets less.",
        of=lambda s: 1.0 / s.principal[:, 2],
    ),
    Field(
        key="k_axial",
        name="Stiffness along the tool axis",
        unit="N/m",
        better="more",
        needs=_STIFF,
        note=_SMALL,
        of=lambda s: 1.0 / s.elastic.along(s.tool[:, :, 2]),
    ),
    Field(
        key="k_across",
        name="Stiffness across the tool axis, softest",
        unit="N/m",
        better="more",
        needs=_STIFF,
        note="1/λmax of the translational compliance in the plane normal to the tool axis: side milling.",
        of=_across,
    ),
    Field(key="k_x", name="Stiffness along x", unit="N/m", better="more", needs=_STIFF, note=_SMALL, of=_along(0)),
    Field(key="k_y", name="Stiffness along y", unit="N/m", better="more", needs=_STIFF, note=_SMALL, of=_along(1)),
    Field(key="k_z", name="Stiffness along z", unit="N/m", better="more", needs=_STIFF, note=_SMALL, of=_along(2)),
    Field(
        key="k_max",
        name="Stiffness, stiffest direction",
        unit="N/m",
        better="more",
        needs=_STIFF,
        note="1/λmin of the translational compliance.",
        of=lambda s: 1.0 / s.principal[:, 0],
    ),
    Field(
        key="deflection",
        name="Deflection under the load",
        unit="m",
        better="less",
        needs=_LOADED,
        note="Length of the TCP's displacement under the stated load; K_C counts where the stiffness file has it.",
        of=lambda s: np.linalg.norm(s.elastic.respond(s.wrench)[:, :3], axis=1),
    ),
    Field(
        key="dexterity",
        name="Dexterity 1/κ_F",
        unit="1",
        better="more",
        needs=frozenset(),
        note="Inverse Frobenius condition number of the Jacobian over the characteristic length (dumas2011 eqs. "
        "11–12): 1 isotropic, 0 singular.",
        of=lambda s: kci(s.state.J, s.setting.length),
    ),
    Field(
        key="nu_p",
        name="ν_p, influence of K_C on translation",
        unit="1",
        better="less",
        needs=_LOADED,
        note="Share of the displacement that neglecting the load's own stiffness K_C gets wrong (dumas2011 eq. 14); "
        "joint springs only.",
        of=lambda s: s.influence[0],
    ),
    Field(
        key="nu_r",
        name="ν_r, influence of K_C on rotation",
        unit="rad",
        better="less",
        needs=_LOADED,
        note="Largest rotation about x, y or z of base that neglecting K_C gets wrong (dumas2011 eq. 15); joint "
        "springs only.",
        of=lambda s: s.influence[1],
    ),
    Field(
        key="limit_margin",
        name="Distance to the nearest joint limit",
        unit="rad",
        better="more",
        needs=frozenset(),
        note="Least angle between a joint and its limit.",
        of=_limit_margin,
    ),
    Field(
        key="held_x", name="K_m xx, all else held", unit="N/m", better="more", needs=_STIFF, note=_HOLDS, of=_held(0)
    ),
    Field(
        key="held_y", name="K_m yy, all else held", unit="N/m", better="more", needs=_STIFF, note=_HOLDS, of=_held(1)
    ),
    Field(
        key="held_z", name="K_m zz, all else held", unit="N/m", better="more", needs=_STIFF, note=_HOLDS, of=_held(2)
    ),
)


def offered(setting: Setting) -> tuple[Field, ...]:
    """The fields that this cell and load allow."""
    have = {word for word, there in (("stiffness", setting.elasticity), ("load", setting.load)) if there is not None}
    return tuple(field for field in FIELDS if field.needs <= have)


def default_criterion(setting: Setting) -> str:
    """What postures are chosen by unless told: deflection under a load, else the softest direction, else dexterity."""
    if setting.elasticity is None:
        return "dexterity"
    return "k_min" if setting.load is None else "deflection"


@dataclass(frozen=True)
class Values:
    """Every field at M postures, NaN where there is no posture."""

    fields: tuple[Field, ...]
    value: dict[str, Array]  # key → (M,) SI
    T_base_tcp: Array  # (M, 4, 4)
    softest: Array | None  # (M, 3) unit, direction in the map's frame that gives way most, +z (else +y, +x) half
    in_grid: NDArray[np.bool_] | None  # (M,) False: outside the stiffness grid; None where there is no grid


def evaluate(setting: Setting, q: Array, at_once: int = 16_384) -> Values:
    """All fields at postures q (M, 6) rad; rows of NaN stay NaN."""
    fields, M = offered(setting), len(q)
    value = {field.key: np.full(M, np.nan) for field in fields}
    T = np.full((M, 4, 4), np.nan)
    softest = None if setting.elasticity is None else np.full((M, 3), np.nan)
    there = np.flatnonzero(np.isfinite(q).all(axis=1))
    for a in range(0, len(there), at_once):
        rows = there[a : a + at_once]
        at = setting.at(q[rows])
        for field in fields:
            number = field.of(at)
            value[field.key][rows] = np.where(np.isfinite(number), number, np.nan)
        T[rows] = at.state.T_base_tool
        if softest is not None:
            softest[rows] = _pointing_up(np.linalg.eigh(at.tip)[1][:, :, 2] @ setting.R_base_frame)
    in_grid = None
    if setting.elasticity is not None and setting.elasticity.stiffness.grid is not None:
        in_grid = np.zeros(M, bool)
        in_grid[there] = joint_stiffness(setting.elasticity.stiffness, T[there, :3, 3]).in_grid
    return Values(fields, value, T, softest, in_grid)


def _pointing_up(direction: Array) -> Array:
    """A direction and its opposite are the same: the one with positive z (else y, else x)."""
    out = direction.copy()
    undecided = np.ones(len(out), bool)
    for c in (2, 1, 0):
        turn = undecided & (out[:, c] < -1e-9)
        out[turn] *= -1
        undecided &= np.abs(out[:, c]) <= 1e-9
    return out
