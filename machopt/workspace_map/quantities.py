"""Quantities of a map at a posture: stiffness by direction, deflection, dexterity, influence of the load, margins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from machopt.kinematics.robot import ArmState, Robot
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity, ElasticState
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance
from machopt.stiffness.joint_compliance import compute_translational_compliance
from machopt.stiffness.kinetostatic_indices import (
    compute_conditioning_index,
    compute_directional_stiffness,
    compute_geometric_influence,
    compute_geometric_stiffness,
)

QuantityUnit = Literal["N/m", "m", "rad", "1"]
RIGID_COMPLIANCE = 1e-18  # of the largest compliance (m/N and rad/(N·m) mixed): rounding, no motion that way


@dataclass(frozen=True)
class MapLoad:
    """Wrench on the TCP for all quantities of deflection."""

    wrench: Array  # (6,) N, N·m, moment about the TCP
    axes: Literal["frame", "tool"]  # whose axes its components are along


@dataclass(frozen=True, kw_only=True)
class MapSettings:
    """Constant inputs of the quantities, besides the posture."""

    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    elasticity: ArmElasticity | None  # None: the cell has no stiffness
    length: float  # m, characteristic length of the dexterity
    lower: Array  # (6,) rad, the robot's limits themselves
    upper: Array  # (6,)
    R_base_frame: Array  # (3, 3) columns: the map's x, y, z in base_link
    load: MapLoad | None = None
    external_compliance: ExternalJointCompliance | None = None  # compliance of external joints; None: they are rigid
    external: Array | None = None  # (E,) rad or m, values of the external joints
    of_job: tuple[MapQuantity, ...] = ()  # under the forces of a job, by operation
    job_notes: tuple[str, ...] = ()  # why some of these are missing

    def evaluate_states(self, q: Array) -> PostureStates:
        """Return the states of postures.

        Args:
            q: (M, 6) rad.
        """
        if self.elasticity is None:
            return PostureStates(self, self.robot.compute_state(q, self.T_flange_tcp), None)
        if self.external_compliance is None or self.external is None:
            elastic = self.elasticity.evaluate(q)
        else:
            place = self.robot.compute_fk(q, self.T_flange_tcp)[..., :3, 3]
            external = np.tile(self.external, (len(q), 1))
            elastic = self.elasticity.evaluate(q, beside=self.external_compliance.compute_compliance(external, place))
        return PostureStates(self, elastic.state, elastic)


@dataclass(frozen=True)
class PostureStates:
    """M postures with their elasticity; values shared by several quantities are computed once."""

    setting: MapSettings
    state: ArmState
    known: ElasticState | None

    @property
    def elasticity(self) -> ElasticState:
        """Elastic state of the postures.

        Raises:
            ValueError: the cell has no stiffness; such quantities are not offered then.
        """
        if self.known is None:
            raise ValueError("a field of stiffness needs a cell with stiffness")
        return self.known

    @cached_property
    def compliance(self) -> Array:
        """C (M, 6, 6) for a small load."""
        return self.elasticity.compute_compliance()

    @cached_property
    def translational_compliance(self) -> Array:
        """C_tt (M, 3, 3) m/N for a small load, symmetric."""
        if not self.elasticity.terms:
            return compute_translational_compliance(self.state.J, self.elasticity.k)
        C = self.compliance[:, :3, :3]
        return np.asarray(0.5 * (C + np.swapaxes(C, -1, -2)))

    @cached_property
    def principal_compliances(self) -> Array:
        """Eigenvalues (M, 3) m/N of C_tt, rising."""
        return np.asarray(np.linalg.eigvalsh(self.translational_compliance), float)

    @property
    def tool_axes(self) -> Array:
        """(M, 3, 3) columns: x, y, z of the TCP in base_link."""
        return self.state.T_base_tool[:, :3, :3]

    def compute_axis(self, number: int) -> Array:
        """Return (M, 3) x, y or z of the map's frame in base_link.

        Args:
            number: 0, 1 or 2.
        """
        return np.broadcast_to(self.setting.R_base_frame[:, number], (len(self.state.q), 3))

    @cached_property
    def wrench(self) -> Array:
        """(M, 6) the load in base_link axes."""
        load = self.setting.load
        if load is None:
            raise ValueError("a field of deflection needs a load; such fields are not offered without")
        R = self.setting.R_base_frame if load.axes == "frame" else self.tool_axes
        both = np.stack([R @ load.wrench[:3], R @ load.wrench[3:]], axis=-2)
        return np.broadcast_to(both.reshape(*both.shape[:-2], 6), (len(self.state.q), 6))

    @cached_property
    def geometric_influence(self) -> tuple[Array, Array]:
        """ν_p (M,) and ν_r (M,) rad of the joint springs alone."""
        J, k, w = self.state.J, self.elasticity.k, self.wrench
        found = compute_geometric_influence(J, k, compute_geometric_stiffness(J, w), w)
        return found.nu_p, found.nu_r

    def compute_held_stiffness(self, direction: Array) -> Array:
        """Return eᵀ C⁻¹ e with the 6×6 compliance: all five other motions constrained. inf where a singularity blocks
        it.

        Args:
            direction: (M, 3) unit, in base_link.
        """
        if not self.elasticity.terms:
            return compute_directional_stiffness(self.state.J, self.elasticity.k, direction, "pose")
        values, vectors = np.linalg.eigh(self.compliance)
        share = np.einsum("mcj,mc->mj", vectors[:, :3], direction) ** 2
        lost = values <= RIGID_COMPLIANCE * values[:, -1:]
        stiffness = np.sum(np.where(lost, 0.0, share / np.where(lost, 1.0, values)), axis=1)
        return np.where((lost & (share > RIGID_COMPLIANCE)).any(axis=1), np.inf, stiffness)


@dataclass(frozen=True, kw_only=True)
class MapQuantity:
    """One number at every posture."""

    key: str
    name: str  # for headings, plain text
    unit: QuantityUnit
    better: Literal["more", "less"]
    needs: frozenset[str]  # "stiffness", "load"
    note: str  # definition and limits of validity
    function: Callable[[PostureStates], Array]  # → (M,) SI

    def compute_goodness(self, at: PostureStates) -> Array:
        """Return (M,) a rating, larger is better; −inf where there is no number.

        Args:
            at: states of M postures.
        """
        value = self.function(at)
        return np.where(np.isfinite(value), value if self.better == "more" else -value, -np.inf)


def _compute_axis_stiffness(number: int) -> Callable[[PostureStates], Array]:
    return lambda s: 1.0 / s.elasticity.compute_compliance_along(s.compute_axis(number))


def _compute_held_stiffness(number: int) -> Callable[[PostureStates], Array]:
    return lambda s: s.compute_held_stiffness(s.compute_axis(number))


def _compute_lateral_stiffness(s: PostureStates) -> Array:
    """1/λmax of the part of C_tt normal to the tool axis, closed form of the 2×2 block."""
    side = s.tool_axes[:, :, :2]
    C = np.swapaxes(side, -1, -2) @ s.translational_compliance @ side
    mean, half = (C[:, 0, 0] + C[:, 1, 1]) / 2, (C[:, 0, 0] - C[:, 1, 1]) / 2
    return np.asarray(1.0 / (mean + np.hypot(half, (C[:, 0, 1] + C[:, 1, 0]) / 2)))


def _compute_limit_margin(s: PostureStates) -> Array:
    q = s.state.q
    return np.asarray(np.minimum(q - s.setting.lower, s.setting.upper - q).min(axis=1))


_STIFFNESS_NOTE, _LOAD_NOTE = frozenset({"stiffness"}), frozenset({"stiffness", "load"})
_SMALL_FORCE_NOTE = (
    "1/(eᵀCe), stiffness for a small force along it, with the tool free to move and turn in every direction."
)
_HELD_STIFFNESS_NOTE = (
    "Diagonal entry of J⁻ᵀ K J⁻¹ (tian2025 eq. 9): no other motion of the tool allowed. Peaks at singularities, "
    "where the arm cannot move that way at all; no cutting force feels it, so never choose a place by it."
)

QUANTITIES: tuple[MapQuantity, ...] = (
    MapQuantity(
        key="k_min",
        name="Stiffness, softest direction",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note="1/λmax of the translational compliance: the smallest stiffness of all directions.",
        function=lambda s: 1.0 / s.principal_compliances[:, 2],
    ),
    MapQuantity(
        key="k_axial",
        name="Stiffness along the tool axis",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_SMALL_FORCE_NOTE,
        function=lambda s: 1.0 / s.elasticity.compute_compliance_along(s.tool_axes[:, :, 2]),
    ),
    MapQuantity(
        key="k_across",
        name="Stiffness across the tool axis, softest",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note="1/λmax of the translational compliance in the plane normal to the tool axis: side milling.",
        function=_compute_lateral_stiffness,
    ),
    MapQuantity(
        key="k_x",
        name="Stiffness along x",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_SMALL_FORCE_NOTE,
        function=_compute_axis_stiffness(0),
    ),
    MapQuantity(
        key="k_y",
        name="Stiffness along y",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_SMALL_FORCE_NOTE,
        function=_compute_axis_stiffness(1),
    ),
    MapQuantity(
        key="k_z",
        name="Stiffness along z",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_SMALL_FORCE_NOTE,
        function=_compute_axis_stiffness(2),
    ),
    MapQuantity(
        key="k_max",
        name="Stiffness, stiffest direction",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note="1/λmin of the translational compliance.",
        function=lambda s: 1.0 / s.principal_compliances[:, 0],
    ),
    MapQuantity(
        key="deflection",
        name="Deflection under the load",
        unit="m",
        better="less",
        needs=_LOAD_NOTE,
        note="Length of the TCP's displacement under the stated load; K_C counts where the stiffness file has it.",
        function=lambda s: np.linalg.norm(s.elasticity.compute_twist(s.wrench)[:, :3], axis=1),
    ),
    MapQuantity(
        key="dexterity",
        name="Dexterity 1/κ_F",
        unit="1",
        better="more",
        needs=frozenset(),
        note="Inverse Frobenius condition number of the Jacobian over the characteristic length (dumas2011 eqs. "
        "11–12): 1 isotropic, 0 singular.",
        function=lambda s: compute_conditioning_index(s.state.J, s.setting.length),
    ),
    MapQuantity(
        key="nu_p",
        name="ν_p, influence of K_C on translation",
        unit="1",
        better="less",
        needs=_LOAD_NOTE,
        note="Share of the displacement that neglecting the load's own stiffness K_C gets wrong (dumas2011 eq. 14); "
        "joint springs only.",
        function=lambda s: s.geometric_influence[0],
    ),
    MapQuantity(
        key="nu_r",
        name="ν_r, influence of K_C on rotation",
        unit="rad",
        better="less",
        needs=_LOAD_NOTE,
        note="Largest rotation about x, y or z of base that neglecting K_C gets wrong (dumas2011 eq. 15); joint "
        "springs only.",
        function=lambda s: s.geometric_influence[1],
    ),
    MapQuantity(
        key="limit_margin",
        name="Distance to the nearest joint limit",
        unit="rad",
        better="more",
        needs=frozenset(),
        note="Least angle between a joint and its limit.",
        function=_compute_limit_margin,
    ),
    MapQuantity(
        key="held_x",
        name="K_m xx, other directions fixed",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_HELD_STIFFNESS_NOTE,
        function=_compute_held_stiffness(0),
    ),
    MapQuantity(
        key="held_y",
        name="K_m yy, other directions fixed",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_HELD_STIFFNESS_NOTE,
        function=_compute_held_stiffness(1),
    ),
    MapQuantity(
        key="held_z",
        name="K_m zz, other directions fixed",
        unit="N/m",
        better="more",
        needs=_STIFFNESS_NOTE,
        note=_HELD_STIFFNESS_NOTE,
        function=_compute_held_stiffness(2),
    ),
)


def list_quantities(setting: MapSettings) -> tuple[MapQuantity, ...]:
    """Return the quantities that this cell and load allow.

    Args:
        setting: constant inputs of the quantities.
    """
    have = {word for word, there in (("stiffness", setting.elasticity), ("load", setting.load)) if there is not None}
    return tuple(field for field in (*QUANTITIES, *setting.of_job) if field.needs <= have)


def select_default_criterion(setting: MapSettings) -> str:
    """Return the default criterion for postures: deflection under a load, else the softest direction, else dexterity.

    Args:
        setting: constant inputs of the quantities.
    """
    if setting.elasticity is None:
        return "dexterity"
    return "k_min" if setting.load is None else "deflection"
