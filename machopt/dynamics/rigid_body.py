"""Torques of a moving arm: rigid-body dynamics from the URDF's inertias and the cell's tool, through pinocchio.

Any chain of one-degree joints, revolute or prismatic, so that a single axis on a test bench works too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import CellError, InputError
from machopt.kinematics.robot import GRAVITY
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import skew_matrix

_BLOCK = 10  # inertial parameters of a body: m, m c (3), Ixx Ixy Iyy Ixz Iyz Izz about the joint's origin


@dataclass(frozen=True, kw_only=True)
class RigidBodyDynamics:
    """Pinocchio model of the arm: n joints, all other joints of the URDF locked at zero."""

    model: Any  # pinocchio.Model, tool included
    bodies: tuple[int, ...]  # 0-based body (joint) indices that have mass in the URDF
    R_last_flange: Array  # (3, 3) flange axes in the last joint's frame
    p_last_flange: Array  # (3,) m
    tool_com: Array  # (3,) m in flange; assumed position of an unknown payload
    tool_mass: float  # kg

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.model.nv)

    def is_prismatic(self, joint: int) -> bool:
        """Return whether a joint slides.

        Args:
            joint: joint, 0-based.
        """
        return "P" in str(self.model.joints[joint + 1].shortname()).removeprefix("JointModel")[:1]

    def compute_torque(self, q: Array, v: Array, a: Array) -> Array:
        """Return the inverse dynamics τ = M(q) a + c(q, v) + g(q).

        Args:
            q: (N, n) rad, or m for a prismatic joint.
            v: (N, n) rad/s or m/s.
            a: (N, n) rad/s² or m/s².

        Returns:
            (N, n) N·m (N of a prismatic joint) that the joints must provide.

        Source:
            Recursive Newton–Euler, Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5.
        """
        import pinocchio as pin

        data = self.model.createData()
        out = np.empty_like(q)
        for k in range(len(q)):
            out[k] = pin.rnea(self.model, data, q[k], v[k], a[k])
        return out

    def compute_mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix, (N, n, n) kg·m², without the rotors.

        Args:
            q: (N, n) rad or m.

        Source:
            Composite rigid bodies, Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 6.
        """
        import pinocchio as pin

        data = self.model.createData()
        out = np.empty((len(q), self.joints, self.joints))
        for k in range(len(q)):
            out[k] = pin.crba(self.model, data, q[k])
        return _fill_lower_triangles(out)

    def compute_body_mass_matrices(self, q: Array) -> Array:
        """Return the part of each body in the mass matrix, (n, N, n, n) kg·m²; their sum is the mass matrix.

        Args:
            q: (N, n) rad or m.
        """
        import pinocchio as pin

        out = np.zeros((self.joints, len(q), self.joints, self.joints))
        for body in range(self.joints):
            alone = pin.Model(self.model)
            for other in range(1, self.joints + 1):
                if other != body + 1:
                    alone.inertias[other] = pin.Inertia.Zero()
            data = alone.createData()
            for k in range(len(q)):
                out[body, k] = pin.crba(alone, data, q[k])
        return _fill_lower_triangles(out)

    def compute_own_inertia(self, q: Array) -> Array:
        """Return the diagonal of the mass matrix, (N, n) kg·m²: inertia of the arm at each joint.

        Args:
            q: (N, n) rad or m.
        """
        import pinocchio as pin

        data = self.model.createData()
        out = np.empty_like(q)
        for k in range(len(q)):
            out[k] = pin.crba(self.model, data, q[k]).diagonal()
        return out

    def compute_regressors(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of the torques by inertias, exactly linear except for the payload's inertia about its
        own centre.

        Args:
            q: (N, n) rad or m.
            v: (N, n) rad/s or m/s.
            a: (N, n) rad/s² or m/s².

        Returns:
            payload (N, n, 4): per kg at the tool's centre of mass, and per kg·m of first moment along the flange's
            x, y, z (its inertia linearised there);
            tool (N, n, 1): per kg·m² of a rotational inertia of the tool that is equal about every axis;
            links (N, n, B): per unit scale of each link that has mass (mass, moment and inertia together).

        Source:
            τ = Y(q, q̇, q̈) π, Atkeson, An & Hollerbach, Int. J. Robotics Res. 5 (1986) 101.
        """
        import pinocchio as pin

        n = self.joints
        last = slice(_BLOCK * (n - 1), _BLOCK * n)
        at = self.R_last_flange @ self.tool_com + self.p_last_flange
        mass = np.concatenate([[1.0], at, _list_inertia_components(-skew_matrix(at) @ skew_matrix(at))])
        tool = np.zeros((_BLOCK, 4))
        tool[:, 0] = mass
        for axis in range(3):
            d = self.R_last_flange[:, axis]
            # m c → m c + h: the inertia about the origin changes by −([c][d] + [d][c])
            tool[1:4, axis + 1] = d
            tool[4:, axis + 1] = _list_inertia_components(
                -(skew_matrix(at) @ skew_matrix(d) + skew_matrix(d) @ skew_matrix(at))
            )
        ball = np.concatenate([np.zeros(4), _list_inertia_components(np.eye(3))])
        scale = np.zeros((_BLOCK * n, len(self.bodies)))
        for column, body in enumerate(self.bodies):
            scale[_BLOCK * body : _BLOCK * (body + 1), column] = self.model.inertias[body + 1].toDynamicParameters()
        data = self.model.createData()
        P, T, L = np.empty((len(q), n, 4)), np.empty((len(q), n, 1)), np.empty((len(q), n, len(self.bodies)))
        for k in range(len(q)):
            Y = pin.computeJointTorqueRegressor(self.model, data, q[k], v[k], a[k]).reshape(n, -1)
            P[k], T[k, :, 0], L[k] = Y[:, last] @ tool, Y[:, last] @ ball, Y @ scale
        return P, T, L


class MissingInertiaError(InputError):
    """Error for a URDF without masses and inertias of moving links."""


def _build_arm_model(cell: Cell) -> Any:  # a pinocchio model
    """Return the model of the arm joints alone, in their order.

    Raises:
        InputError: a joint is missing, or has more than one degree of freedom.
    """
    import pinocchio as pin

    full = pin.buildModelFromXML(_replace_continuous_joints(cell))
    arm_joints = set(cell.arm_joints)
    missing = [name for name in cell.arm_joints if not full.existJointName(name)]
    if missing:
        raise CellError(
            f"arm joint {missing[0]!r} is not a moving joint of the URDF; it has {', '.join(full.names[1:])}",
            file=cell.urdf,
            where="robot.arm_joints",
        )
    locked = [full.getJointId(name) for name in full.names[1:] if name not in arm_joints]
    model = pin.buildReducedModel(full, locked, pin.neutral(full)) if locked else full
    if model.nq != model.nv or model.nv != len(cell.arm_joints) or list(model.names[1:]) != list(cell.arm_joints):
        raise CellError(
            f"the arm joints {', '.join(cell.arm_joints)} are not a chain of bounded revolute or prismatic joints "
            f"(found {', '.join(model.names[1:])})",
            file=cell.urdf,
            where="robot.arm_joints",
        )
    return model


def load_dynamics(cell: Cell) -> RigidBodyDynamics:
    """Read the chain of the cell's arm joints with its inertias and those of the tool, gravity along −z of world.

    Where the cell states no ``tool.inertia_kg_m2``, the tool's inertia about its own centre is zero here. It can be
    identified (``compute_regressors``).

    Args:
        cell: robot cell.

    Raises:
        InputError: a joint is missing, has more than one degree of freedom, or no moving link has mass.
    """
    import pinocchio as pin

    model = _build_arm_model(cell)
    bodies = tuple(i for i in range(model.nv) if model.inertias[i + 1].mass > 0.0)
    if not bodies:
        raise MissingInertiaError(
            "no moving link has an <inertial>; joint torques need masses and inertias", file=cell.urdf
        )
    for name in (cell.base_link, cell.flange_link):
        if not model.existFrame(name):
            raise CellError(f"link {name!r} is not in the URDF", file=cell.urdf)
    base, flange = model.frames[model.getFrameId(cell.base_link)], model.frames[model.getFrameId(cell.flange_link)]
    at = flange.placement
    if cell.tool.mass > 0.0:
        model.inertias[model.nv] = model.inertias[model.nv] + at.act(
            pin.Inertia(
                cell.tool.mass,
                np.asarray(cell.tool.com, float),
                np.zeros((3, 3)) if cell.tool.inertia is None else np.array(cell.tool.inertia, float),
            )
        )
    # the chain's root may differ from base_link; base_link is not attached to a moving joint
    R_root_world = base.placement.rotation @ cell.T_world_base[:3, :3].T
    model.gravity.linear = R_root_world @ np.array([0.0, 0.0, -GRAVITY])
    com = np.asarray(cell.tool.com, float) if cell.tool.mass > 0.0 else 0.5 * cell.tool.T_flange_tcp[:3, 3]
    return RigidBodyDynamics(
        model=model,
        bodies=bodies,
        R_last_flange=np.array(at.rotation),
        p_last_flange=np.array(at.translation),
        tool_com=np.array(com),
        tool_mass=float(cell.tool.mass),
    )


def _replace_continuous_joints(cell: Cell) -> str:
    """Return the URDF with continuous joints as joints with an angle: pinocchio uses cos and sin for continuous
    ones.
    """
    root = ElementTree.fromstring(cell.urdf_text)
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", velocity="10", effort="0")
            limit.set("lower", "-1000")
            limit.set("upper", "1000")
    return ElementTree.tostring(root, encoding="unicode")


def _fill_lower_triangles(upper: Array) -> Array:
    """Return symmetric matrices (..., n, n) from their upper triangles: pinocchio may leave the lower ones unset."""
    half = np.triu(upper)
    return np.asarray(half + np.swapaxes(np.triu(half, 1), -1, -2))


def _list_inertia_components(I: Array) -> Array:  # noqa: E741 - the field's own symbol
    """Ixx, Ixy, Iyy, Ixz, Iyz, Izz."""
    return np.array([I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]])
