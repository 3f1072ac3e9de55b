"""The whole machine as one chain that begins at the part: positioner, hall, rail or gantry, arm.

::

    part ─(−e of the positioner, last joint first)→ hall ─(+e of the rail)→ base ─ q1 … q6 → flange → tool
    link 0   1 … P−1                                  P                     P+1 … P+L   P+L+1 … P+L+6

Every joint is a line, given in base_link where all joints are zero, about which it rotates or along which it
translates. A joint that carries the part has a negative sign: relative to the part its line moves by −e. A body of
link k that is at X (in base_link) at zero is, relative to the part, at

    E₁ E₂ … E_k X,    E_i = exp(ξ_i θ_i),    θ = sign · x[column]   (Lynch & Park 2017, section 4.1)

with x = (q, e) the joints of the arm, then the external ones in the order of the cell. Without external joints this is
the arm alone, and part, hall and base are one link.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.errors import CellError
from machopt.kinematics import product_of_exponentials
from machopt.kinematics.mimic_joints import compute_rest_configuration
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import find_frame, load_urdf_model
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import build_transform, invert_transform

Ints = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Machine:
    """n = 6 + E lines in the order of the chain, in base_link where all joints are zero."""

    robot: Robot
    axis: Array  # (n, 3) unit: direction of the line
    point: Array  # (n, 3) m, on it; meaningless for sliding joints
    slides: Bools  # (n,) the joint slides along its line
    column: Ints  # (n,) entry of x = (q, e) that moves it
    sign: Array  # (n,) −1 for joints that carry the part
    positioner: int  # P, number of joints that carry the part
    rail: int  # L, number of joints that carry the base
    T_base_workpiece_zero: Array  # (4, 4)
    T_world_base_zero: Array  # (4, 4)
    names: tuple[str, ...] = ()  # (E,) of the external joints, in the order of the chain
    bodies: Array | None = None  # (E, 4, 4) the URDF links moved by these, in base_link where all joints are zero

    @property
    def external_count(self) -> int:
        """E, number of external joints."""
        return self.positioner + self.rail

    @property
    def world_link(self) -> int:
        """Link of the chain that is fixed in the world."""
        return self.positioner

    @property
    def base_link(self) -> int:
        """Link of the chain that is base_link; link i of the arm is this plus i."""
        return self.external_count

    def compute_line_positions(self, x: Array) -> Array:
        """Return θ (..., n), the displacement of each line.

        Args:
            x: (..., n) rad or m, joints.
        """
        x = np.asarray(x, float)
        both = np.concatenate([self.robot.compute_line_angles(x[..., :6]), x[..., 6:]], axis=-1)
        return np.asarray(both[..., self.column] * self.sign)

    def compute_links(self, x: Array) -> tuple[Array, Array]:
        """Return the poses of the links relative to the part.

        Args:
            x: (M, n) rad or m.

        Returns:
            R (M, n + 1, 3, 3) and p (M, n + 1, 3) m: a point y (in base_link) of link k at zero is at R[k] y + p[k];
            entry 0 the identity.
        """
        theta = np.array(self.compute_line_positions(x), float, order="C").reshape(-1, len(self.axis))
        n = len(self.axis)
        R, p = np.empty((len(theta), n + 1, 3, 3)), np.empty((len(theta), n + 1, 3))
        product_of_exponentials.compute_chain_motions(
            _copy_array(self.axis), _copy_array(self.point), np.array(self.slides), theta, R, p
        )
        return R, p

    def compute_fk(self, x: Array, T_flange_tool: Array | None = None) -> Array:
        """Return the pose of the flange, or of a frame fixed to it, in the workpiece frame: (M, 4, 4).

        Args:
            x: (M, n) rad or m, joints.
            T_flange_tool: (4, 4) that frame relative to the flange; None: the flange.
        """
        zero = self.robot.T_base_flange_zero if T_flange_tool is None else self.robot.T_base_flange_zero @ T_flange_tool
        R, p = self.compute_links(x)
        seen = build_transform(R[:, -1], p[:, -1]) @ zero
        return np.asarray(invert_transform(self.T_base_workpiece_zero) @ seen)

    def compute_fk_jacobian(self, x: Array, T_flange_tool: Array | None = None) -> tuple[Array, Array]:
        """Return :meth:`compute_fk`, and the Jacobian (M, 6, n) in the columns of x.

        It maps joint velocity to the twist of the tool's origin relative to the part, in workpiece axes, linear part
        first. The feed is measured in it.

        Args:
            x: (M, n) rad or m, joints.
            T_flange_tool: (4, 4) frame relative to the flange; None: the flange.
        """
        R, p = self.compute_links(x)
        zero = self.robot.T_base_flange_zero if T_flange_tool is None else self.robot.T_base_flange_zero @ T_flange_tool
        seen = build_transform(R[:, -1], p[:, -1]) @ zero
        M, n = len(R), len(self.axis)
        h = np.einsum("mkij,kj->mki", R[:, :-1], self.axis)
        o = np.einsum("mkij,kj->mki", R[:, :-1], self.point) + p[:, :-1]
        slides = np.asarray(self.slides)[None, :, None]
        linear = np.where(slides, h, np.cross(h, seen[:, None, :3, 3] - o))
        angular = np.where(slides, 0.0, h)
        own = np.concatenate([linear, angular], axis=-1) * self.sign[None, :, None]
        J = np.empty((M, 6, n))
        J[:, :, self.column] = np.swapaxes(own, 1, 2)
        if self.robot.coupling is not None:
            J[:, :, :6] = J[:, :, :6] @ self.robot.coupling
        back = self.T_base_workpiece_zero[:3, :3].T
        J = np.concatenate([back @ J[:, :3], back @ J[:, 3:]], axis=1)
        return np.asarray(invert_transform(self.T_base_workpiece_zero) @ seen), J

    def compute_T_base_workpiece(self, external: Array) -> Array:
        """Return the (M, 4, 4) workpiece frame in base_link.

        Args:
            external: (M, E) rad or m, external joints.
        """
        E = self.external_count
        if not E:
            return np.broadcast_to(self.T_base_workpiece_zero, (len(external), 4, 4))
        theta = np.array(np.asarray(external, float)[:, self.column[:E] - 6] * self.sign[:E], order="C")
        T_part_base = np.empty((len(theta), 4, 4))
        product_of_exponentials.compute_relative_motion(
            _copy_array(self.axis), _copy_array(self.point), np.array(self.slides), 0, E, theta, T_part_base
        )
        return np.asarray(invert_transform(T_part_base) @ self.T_base_workpiece_zero)

    def compute_T_base_workpiece_jets(self, external: Array) -> Array:
        """Return (M, 4, 4, 4) :meth:`compute_T_base_workpiece` and its derivatives 1 … 3 along a path, entry k the k-th
        one.

        exp(ξ e(u)) is differentiated with the angle's own derivatives, and a product by Leibniz's rule.

        Args:
            external: (M, 4, E) the joints and their derivatives.
        """
        out = np.zeros((len(external), 4, 4, 4))
        out[:, 0] = self.T_base_workpiece_zero
        for k in range(self.positioner):  # from the part's side on
            out = multiply_jets(self._compute_exponential_jets(k, external, 1.0), out)
        for k in range(self.positioner, self.external_count):
            out = multiply_jets(self._compute_exponential_jets(k, external, -1.0), out)
        return out

    def _compute_exponential_jets(self, k: int, external: Array, sign: float) -> Array:
        """(M, 4, 4, 4) of line k moved by ``sign`` times its joint."""
        e = sign * external[:, :, self.column[k] - 6]
        out = np.zeros((len(e), 4, 4, 4))
        out[:, 0] = compute_line_exponential(self.axis[k], self.point[k], bool(self.slides[k]), e[:, 0])
        h = self.axis[k]
        if self.slides[k]:
            out[:, 1:, :3, 3] = e[:, 1:, None] * h
            return out
        K = np.array([[0.0, -h[2], h[1]], [h[2], 0.0, -h[0]], [-h[1], h[0], 0.0]])
        s, c = np.sin(e[:, 0]), np.cos(e[:, 0])
        e1, e2, e3 = e[:, 1], e[:, 2], e[:, 3]
        sine = [c * e1, c * e2 - s * e1**2, c * (e3 - e1**3) - 3.0 * s * e1 * e2]
        rise = [s * e1, s * e2 + c * e1**2, s * (e3 - e1**3) + 3.0 * c * e1 * e2]  # of 1 − cos
        for order in range(3):
            R = sine[order][:, None, None] * K + rise[order][:, None, None] * (K @ K)
            out[:, order + 1, :3, :3] = R
            out[:, order + 1, :3, 3] = -R @ self.point[k]
        return out

    def compute_T_world_base(self, external: Array) -> Array:
        """Return (M, 4, 4) base_link in world.

        Args:
            external: (M, E) rad or m, external joints.
        """
        return np.asarray(self.T_world_base_zero @ self._compute_base_motion(external))

    def compute_T_world_workpiece(self, external: Array) -> Array:
        """Return the (M, 4, 4) workpiece frame in world.

        Args:
            external: (M, E) rad or m, external joints.
        """
        return np.asarray(self.T_world_base_zero @ self._compute_part_motion(external) @ self.T_base_workpiece_zero)

    def _compute_part_motion(self, external: Array) -> Array:
        """Return the (M, 4, 4) motion of the positioner's load from its pose at zero, in base_link at zero."""
        return self._multiply_line_motions(external, range(self.positioner - 1, -1, -1))

    def _compute_base_motion(self, external: Array) -> Array:
        """Return the (M, 4, 4) motion of base_link from its pose at zero."""
        return self._multiply_line_motions(external, range(self.positioner, self.external_count))

    def _multiply_line_motions(self, external: Array, lines: range) -> Array:
        external = np.asarray(external, float)
        out = np.broadcast_to(np.eye(4), (len(external), 4, 4))
        for k in lines:
            step = compute_line_exponential(
                self.axis[k], self.point[k], bool(self.slides[k]), external[:, self.column[k] - 6]
            )
            out = out @ step
        return np.asarray(out)


def multiply_jets(A: Array, B: Array) -> Array:
    """Return (M, 4, 4, 4) jets of a product of matrices.

    Args:
        A: (M, 4, 4, 4) jets of the first factor.
        B: (M, 4, 4, 4) jets of the second factor.
    """
    return np.stack(
        [
            A[:, 0] @ B[:, 0],
            A[:, 1] @ B[:, 0] + A[:, 0] @ B[:, 1],
            A[:, 2] @ B[:, 0] + 2.0 * (A[:, 1] @ B[:, 1]) + A[:, 0] @ B[:, 2],
            A[:, 3] @ B[:, 0] + 3.0 * (A[:, 2] @ B[:, 1] + A[:, 1] @ B[:, 2]) + A[:, 0] @ B[:, 3],
        ],
        axis=1,
    )


def compute_line_exponential(axis: Array, point: Array, slides: bool, by: Array) -> Array:
    """Return the (M, 4, 4) rotations about a line, or translations along it.

    Args:
        axis: (3,) unit.
        point: (3,) m, a point of the line.
        slides: translation instead of rotation.
        by: (M,) rad or m.
    """
    out = np.tile(np.eye(4), (len(by), 1, 1))
    if slides:
        out[:, :3, 3] = by[:, None] * axis
        return out
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    out[:, :3, :3] += np.sin(by)[:, None, None] * K + (1.0 - np.cos(by))[:, None, None] * (K @ K)
    out[:, :3, 3] = point - out[:, :3, :3] @ point
    return out


def load_machine(cell: Cell, robot: Robot) -> Machine:
    """Read the chain from the part to the tool.

    Args:
        cell: cell with the external joints.
        robot: the arm of the same cell.

    Raises:
        InputError: an external joint moves both base and part, or is not listed.
    """
    from_part, from_base, T_base_part, lines = _read_external_joints(cell)
    P, L = len(from_part), len(from_base)
    order = [*reversed(from_part), *from_base]
    columns = [6 + cell.external_joints.index(name) for name in order]
    return Machine(
        robot=robot,
        axis=np.array([*(lines[name].axis for name in order), *robot.axis]).reshape(-1, 3),
        point=np.array([*(lines[name].T_base_link[:3, 3] for name in order), *robot.point]).reshape(-1, 3),
        slides=np.array([*(lines[name].slides for name in order), *([False] * 6)]),
        column=np.array([*columns, *range(6)], np.intp),
        sign=np.array([-1.0] * P + [1.0] * (L + 6)),
        positioner=P,
        rail=L,
        T_base_workpiece_zero=T_base_part,
        T_world_base_zero=cell.T_world_base,
        names=tuple(order),
        bodies=np.array([lines[name].T_base_link for name in order]).reshape(-1, 4, 4),
    )


@dataclass(frozen=True)
class _ExternalLine:
    """An external joint as a line, in base_link where all joints are zero."""

    axis: Array  # (3,) unit
    T_base_link: Array  # (4, 4) the link it moves, whose origin is on the line
    slides: bool


def _read_external_joints(cell: Cell) -> tuple[list[str], list[str], Array, dict[str, _ExternalLine]]:
    """Return the external joints that carry the part and those that carry the base, root first; ``T_base_workpiece`` at
    zero; the line of each.
    """
    if not cell.external_joints and cell.workpiece.link == "world":  # no URDF need be read
        return [], [], np.asarray(invert_transform(cell.T_world_base) @ cell.workpiece.T_link_workpiece), {}
    import pinocchio as pin

    model = load_urdf_model(cell)
    data, rest = model.createData(), compute_rest_configuration(cell, model)
    pin.computeJointJacobians(model, data, rest)
    pin.updateFramePlacements(model, data)
    base = model.frames[find_frame(cell, model, cell.base_link)]
    T_root_base = data.oMi[base.parentJoint].homogeneous @ base.placement.homogeneous
    T_base_root = invert_transform(T_root_base)
    from_base = _list_carrying_joints(model, int(base.parentJoint))
    if cell.workpiece.link == "world":
        from_part, T_base_part = [], invert_transform(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    else:
        part = model.frames[find_frame(cell, model, cell.workpiece.link)]
        from_part = _list_carrying_joints(model, int(part.parentJoint))
        T_root_link = data.oMi[part.parentJoint].homogeneous @ part.placement.homogeneous
        T_base_part = T_base_root @ T_root_link @ cell.workpiece.T_link_workpiece
    both = [name for name in from_part if name in from_base]
    if both:
        raise CellError(
            f"joint {both[0]!r} moves the robot's base and the workpiece alike; a rail that carries only the base, or "
            "a positioner that carries only the workpiece, would work",
            file=cell.urdf,
            where="robot.external_joints",
        )
    lines = {}
    for name in (*from_part, *from_base):
        if name not in cell.external_joints:
            raise CellError(
                f"joint {name!r} moves the base or the workpiece and is not listed",
                file=cell.urdf,
                where="robot.external_joints",
            )
        lines[name] = _read_line(model, data, int(model.getJointId(name)), T_base_root)
    return from_part, from_base, np.asarray(T_base_part), lines


def _list_carrying_joints(model: Any, joint: int) -> list[str]:
    """Names of the moving joints from the root to this one, root first."""
    out = []
    while joint > 0:
        out.append(str(model.names[joint]))
        joint = int(model.parents[joint])
    return out[::-1]


def _read_line(model: Any, data: Any, joint: int, T_base_root: Array) -> _ExternalLine:
    import pinocchio as pin

    own = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)[:, model.idx_vs[joint]]
    T = T_base_root @ data.oMi[joint].homogeneous
    slides = bool(np.linalg.norm(own[3:]) < 0.5)
    return _ExternalLine(T[:3, :3] @ (own[:3] if slides else own[3:]), np.asarray(T), slides)


def _copy_array(array: Array) -> Array:
    """A plain copy, so that the kernel is compiled once (:mod:`.robot`)."""
    return np.array(array, float, order="C")
