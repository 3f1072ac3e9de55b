"""Batched kinematics of a serial arm, read from a URDF through pinocchio (its only importer in the planner).

The chain is reduced to the product of exponentials: each joint is a line in base_link at q = 0
(``axis``, ``point``), the flange a fixed pose ``T_base_flange_zero`` after them. The kernels
(:mod:`machopt.kinematics.product_of_exponentials`) are compiled, accept any leading dimensions, and are tested against
pinocchio.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import CollisionShape
from machopt.kinematics import prismatic_arm, product_of_exponentials
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform

GRAVITY = 9.80665  # m/s², standard gravity


@dataclass(frozen=True)
class LinkShape:
    """A collision body of the robot: link 0 is base_link, link i is moved by arm joint i."""

    link: int
    shape: CollisionShape  # placed in base_link coordinates at q = 0
    above: tuple[str, ...] = ()  # names of the moving joints of the URDF that carry it, the nearest first
    part: str = ""  # the link of the URDF that it belongs to


@dataclass(frozen=True)
class RobotMasses:
    """Masses of the links and the tool for gravity, each as a point mass (sufficient for static torques)."""

    body: NDArray[np.int64]  # (B,) 1…n: the arm joint that moves it
    mass: Array  # (B,) kg
    com: Array  # (B, 3) m, centre of mass in base_link at q = 0
    gravity: Array  # (3,) m/s² in base_link


@dataclass(frozen=True)
class ArmState:
    """Kinematic state of an arm at configurations q, the input of elastic terms. Everything in base_link."""

    q: Array  # (..., n) rad
    T_base_tool: Array  # (..., 4, 4)
    J: Array  # (..., 6, n) at the tool frame's origin
    R_bodies: Array | None = (
        None  # (..., n + 1, 3, 3) rotation of each link from its orientation at q = 0; 0: base_link
    )
    p_bodies: Array | None = None  # (..., n + 1, 3) m; a point x of link i at q = 0 is at R_bodies[i] x + p_bodies[i]


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A serial arm as n lines (six where it is planned for) and a flange pose at q = 0, all in base_link.

    Mimic joints (``<mimic>``) are included in the lines: one on the line of its neighbour adds to
    that one's rotation, so θ = C q, J_q = J_θ C, and torques of the joints are Cᵀ times those about the lines.
    """

    joints: tuple[str, ...]
    axis: Array  # (n, 3) unit
    point: Array  # (n, 3) m, a point on each axis
    T_base_flange_zero: Array  # (4, 4)
    lower: Array  # (n,) rad
    upper: Array  # (n,) rad
    coupling: Array | None = None  # (n, n) integers: the lines rotate by C q (a parallel linkage); None: by q
    nominal: Robot | None = None  # the nominal arm, where the cell has as-built geometry
    slides: NDArray[np.bool_] | None = None  # (n,) prismatic joints, q in m: only in diagnoses

    @cached_property
    def uncoupled_robot(self) -> Robot:
        """The same lines, each with an independent angle, as closed forms and levers need them."""
        if self.coupling is None:
            return self
        return replace(self, coupling=None, nominal=None if self.nominal is None else self.nominal.uncoupled_robot)

    @property
    def nominal_robot(self) -> Robot:
        """The nominal arm, which a controller uses; usually this arm itself."""
        return self if self.nominal is None else self.nominal

    def compute_line_angles(self, q: Array) -> Array:
        """Return θ = C q (..., n) rad, the rotation of each line; exactly q without a linkage.

        Args:
            q: (..., n) rad.
        """
        return np.asarray(q, float) if self.coupling is None else np.asarray(q, float) @ self.coupling.T

    def compute_joint_positions(self, theta: Array) -> Array:
        """Return q = C⁻¹ θ (..., n) rad, the joints for given line rotations.

        Args:
            theta: (..., n) rad.
        """
        return np.asarray(theta, float) if self.coupling is None else np.asarray(theta) @ np.linalg.inv(self.coupling).T

    def compute_link_poses(self, q: Array) -> Array:
        """Return the motion of each link from its pose at q = 0.

        Args:
            q: (..., n) rad.

        Returns:
            (..., n + 1, 4, 4): entry 0 the identity (base_link), entry i the motion by joints 1…i of a body fixed to
            link i, in base_link. Multiply it onto a pose at q = 0.
        """
        rows, lead = _flatten_rows(self.compute_line_angles(q))
        return build_transform(*self._compute_link_motions(rows)).reshape(*lead, len(self.joints) + 1, 4, 4)

    def compute_fk(self, q: Array, T_flange_tool: Array | None = None) -> Array:
        """Return the pose of the flange (or of a frame fixed to it) in base_link, (..., 4, 4).

        Args:
            q: (..., n) rad.
            T_flange_tool: (4, 4) that frame relative to the flange; None: the flange.
        """
        rows, lead = _flatten_rows(self.compute_line_angles(q))
        if self.slides is not None:
            return self.compute_state(q, T_flange_tool).T_base_tool
        T = np.empty((len(rows), 4, 4))
        product_of_exponentials.compute_poses(*self._build_chain(T_flange_tool), rows, T)
        return T.reshape(*lead, 4, 4)

    def compute_fk_jacobian(self, q: Array, T_flange_tool: Array | None = None) -> tuple[Array, Array]:
        """Return pose (..., 4, 4) and geometric Jacobian (..., 6, n) of a frame fixed to the flange.

        The Jacobian maps joint velocity to the twist of the frame's origin in base_link axes, linear part first.

        Args:
            q: (..., n) rad.
            T_flange_tool: (4, 4) that frame relative to the flange; None: the flange.
        """
        state = self.compute_state(q, T_flange_tool)
        return state.T_base_tool, state.J

    def compute_state(self, q: Array, T_flange_tool: Array | None = None, *, bodies: bool = False) -> ArmState:
        """Return pose and Jacobian of a frame fixed to the flange, and the link motions if ``bodies``.

        Args:
            q: (..., n) rad.
            T_flange_tool: (4, 4) that frame relative to the flange; None: the flange.
            bodies: fill ``R_bodies`` and ``p_bodies``, at some cost for large batches.
        """
        n = len(self.joints)
        rows, lead = _flatten_rows(self.compute_line_angles(q))
        T, J = np.empty((len(rows), 4, 4)), np.empty((len(rows), 6, n))
        if self.slides is not None:
            T, J = prismatic_arm.compute_jacobians_with_slides(self.slides, *self._build_chain(T_flange_tool), rows)
        else:
            product_of_exponentials.compute_jacobians(*self._build_chain(T_flange_tool), rows, T, J)
        if self.coupling is not None:
            J = J @ self.coupling
        R_bodies = p_bodies = None
        if bodies:
            R, p = self._compute_link_motions(rows)
            R_bodies, p_bodies = R.reshape(*lead, n + 1, 3, 3), p.reshape(*lead, n + 1, 3)
        return ArmState(np.asarray(q, float), T.reshape(*lead, 4, 4), J.reshape(*lead, 6, n), R_bodies, p_bodies)

    def _compute_link_motions(self, rows: Array) -> tuple[Array, Array]:
        """Return R (M, n + 1, 3, 3) and p (M, n + 1, 3) of the links whose lines are displaced by ``rows`` (M, n)."""
        if self.slides is not None:
            return prismatic_arm.compute_link_motions_with_slides(self.slides, *self._build_chain(None)[:2], rows)
        links = len(self.joints) + 1
        R, p = np.empty((len(rows), links, 3, 3)), np.empty((len(rows), links, 3))
        product_of_exponentials.compute_link_motions(*self._build_chain(None)[:2], rows, R, p)
        return R, p

    def _build_chain(self, T_flange_tool: Array | None) -> tuple[Array, Array, Array]:
        """The lines, and the pose at q = 0 of a frame fixed to the flange."""
        zero = self.T_base_flange_zero
        return (
            _copy_array(self.axis),
            _copy_array(self.point),
            _copy_array(zero if T_flange_tool is None else zero @ T_flange_tool),
        )


def _flatten_rows(q: Array) -> tuple[Array, tuple[int, ...]]:
    """Return joints as the kernels need them, (M, n), and their leading dimensions."""
    shape = np.shape(q)
    return _copy_array(q).reshape(-1, shape[-1]), shape[:-1]


def _copy_array(array: Array) -> Array:
    """Return a plain copy: numba compiles a kernel again for read-only arrays or another memory layout."""
    return np.array(array, float, order="C")
