"""Kinematics of the whole URDF: the joints' places and axes by pinocchio, all configurations at once by numpy.

With A_i the place of joint i in its parent p, E_i(q) its turn about or shift along its own axis:

    T_i = T_p A_i E_i(q_i),    E = I + sin q [w]× + (1 − cos q) [w]×²  or  I with q v in the last column.

The tests hold this against pinocchio's own forward kinematics, row by row.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stance:
    """The arm at N configurations, external axes at rest: lines of its six axes and what they carry, in base_link."""

    q: Array  # (N, 6) rad, true angles
    axis: Array  # (N, 6, 3) unit
    origin: Array  # (N, 6, 3) m, of each joint's frame
    tcp: Array  # (N, 4, 4)
    frames: Array  # (N, 7, 4, 4) base_link and the frame of each joint; what a link carries moves with it
    flange: Array  # (N, 4, 4)

    @cached_property
    def J(self) -> Array:
        """(N, 6, 6) geometric Jacobian at the TCP: column i is (z_i × (p − o_i), z_i)."""
        lever = self.tcp[:, None, :3, 3] - self.origin
        return np.swapaxes(np.concatenate([np.cross(self.axis, lever), self.axis], axis=-1), 1, 2)

    def rows(self, keep: NDArray[Any]) -> Stance:
        """Some of the configurations."""
        return Stance(*(v[keep] for v in (self.q, self.axis, self.origin, self.tcp, self.frames, self.flange)))


class Arm:
    """World poses of everything the joints move.

    Args:
        cell: URDF, names of base, flange, arm and external joints, poses of robot and workpiece in the world.

    Raises:
        InputError: a name is not in the URDF.
    """

    def __init__(self, cell: Cell) -> None:
        import pinocchio as pin

        self.cell = cell
        self.model: Any = pin.buildModelFromUrdf(str(cell.urdf))
        self._data = self.model.createData()
        self._forward = pin.framesForwardKinematics
        self.rest: Array = pin.neutral(self.model)
        for name in (*cell.arm_joints, *cell.external_joints):
            if not self.model.existJointName(name):
                raise InputError(f"joint {name!r} is not in the URDF", file=cell.urdf)
        self.joints = [int(self.model.getJointId(name)) for name in cell.arm_joints]
        self._external = [int(self.model.getJointId(name)) for name in cell.external_joints]
        self._flange, self._base = (self._frame(name) for name in (cell.flange_link, cell.base_link))
        self._part = None if cell.workpiece.link == "world" else self._frame(cell.workpiece.link)

    def _frame(self, name: str) -> int:
        if not self.model.existFrame(name):
            raise InputError(f"link {name!r} is not in the URDF", file=self.cell.urdf)
        return int(self.model.getFrameId(name))

    def link_of(self, joint: int) -> int:
        """Arm link (0 … 6) that moves with a joint of the URDF."""
        while joint > 0:
            if joint in self.joints:
                return self.joints.index(joint) + 1
            joint = int(self.model.parents[joint])
        return 0

    def placements(self, q: Array, external: Array) -> Array:
        """Where everything is.

        Args:
            q: (S, 6) rad.
            external: (S, E) rad or m.

        Returns:
            (S, J + 2, 4, 4) in world: every joint of the URDF (entry 0 the URDF's root), then the flange, then the
            workpiece frame.
        """
        out = np.empty((len(q), self.model.njoints + 2, 4, 4))
        out[:, :-2] = self._joint_frames(q, external)
        out[:, -2] = self._carried(out, self._flange)
        out[:, -1] = np.eye(4) if self._part is None else self._carried(out, self._part)
        out[:, :-1] = self._to_world @ out[:, :-1]
        if self._part is not None:
            out[:, -1] = self._to_world @ out[:, -1]
        out[:, -1] = out[:, -1] @ self.cell.workpiece.T_link_workpiece
        return out

    def _joint_frames(self, q: Array, external: Array) -> Array:
        """(S, J, 4, 4) of every joint in the URDF's root; joints that neither arm nor external are stay at rest."""
        value = dict(zip((*self.joints, *self._external), (*q.T, *external.T), strict=True))
        out = np.empty((len(q), self.model.njoints, 4, 4))
        out[:, 0] = np.eye(4)
        for j in range(1, self.model.njoints):
            place, linear, turn = self._steps[j]
            step = place if j not in value else place @ _motion(value[j], linear, turn)
            np.matmul(out[:, int(self.model.parents[j])], step, out=out[:, j])
        return out

    def _carried(self, joints: Array, frame: int) -> Array:
        """(S, 4, 4) of a link that is fixed to a joint."""
        of = self.model.frames[frame]
        return np.asarray(joints[:, int(of.parentJoint)] @ of.placement.homogeneous)

    @cached_property
    def _steps(self) -> list[tuple[Array, Array, Array]]:
        """Of each joint: (4, 4) its place at rest in its parent, (3,) direction of its shift, (3,) axis of its turn."""
        import pinocchio as pin

        data = self.model.createData()
        pin.computeJointJacobians(self.model, data, self.rest)
        out = [(np.eye(4), np.zeros(3), np.zeros(3))]
        for j in range(1, self.model.njoints):
            own = pin.getJointJacobian(self.model, data, j, pin.ReferenceFrame.LOCAL)[:, self.model.idx_vs[j]]
            out.append((data.liMi[j].homogeneous, own[:3], own[3:]))
        return out

    def _full(self, q: Array, external: Array) -> Array:
        """Configuration of the whole URDF; a joint that turns without end is held as cosine and sine there."""
        full = self.rest.copy()
        for j, value in zip((*self.joints, *self._external), (*q, *external), strict=True):
            at = self.model.idx_qs[j]
            if self.model.nqs[j] == 2:
                full[at : at + 2] = np.cos(value), np.sin(value)
            else:
                full[at] = value
        return full

    @cached_property
    def _to_world(self) -> Array:
        """(4, 4) the URDF's root in world: base_link stands where cell.yaml puts it with the external axes at rest."""
        self._forward(self.model, self._data, self.rest)
        to_world: Array = self.cell.T_world_base @ np.linalg.inv(self._data.oMf[self._base].homogeneous)
        return to_world

    @cached_property
    def T_base_workpiece(self) -> Array:
        """(4, 4) the CAM frame in base_link, external axes at rest."""
        T = self.placements(np.zeros((1, 6)), np.zeros((1, len(self._external))))[0, -1]
        return np.asarray(np.linalg.inv(self.cell.T_world_base) @ T)

    def stance(self, q: Array) -> Stance:
        """Axes, frames and TCP at q (N, 6) rad in base_link, external joints at rest."""
        joints = self._joint_frames(q, np.zeros((len(q), len(self._external))))
        back = np.linalg.inv(self._carried(joints, self._base))
        frames = np.empty((len(q), 7, 4, 4))
        frames[:, 0] = np.eye(4)
        frames[:, 1:] = back[:, None] @ joints[:, self.joints]
        turn = np.stack([self._steps[j][2] for j in self.joints])
        axis = np.einsum("njab,jb->nja", frames[:, 1:, :3, :3], turn)
        flange = back @ self._carried(joints, self._flange)
        return Stance(q, axis, frames[:, 1:, :3, 3], flange @ self.cell.tool.T_flange_tcp, frames, flange)

    def gravity(self, q: Array) -> Array:
        """(N, 6) N·m that the weight of links and tool does to the joints at q (N, 6) rad; the tool a point mass.

        Weight acts along −z of world with 9.80665 m/s². What is missing in the URDF weighs nothing.
        """
        import pinocchio as pin

        model = self.model.copy()
        model.gravity.linear = self._to_world[:3, :3].T @ np.array([0.0, 0.0, -9.80665])
        tool, frame = self.cell.tool, model.frames[self._flange]
        if tool.mass > 0.0:
            own = pin.Inertia(tool.mass, np.asarray(tool.com, float), np.zeros((3, 3)))
            model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + frame.placement.act(own)
        data, column = model.createData(), [model.idx_vs[j] for j in self.joints]
        rest = np.zeros(len(self._external))
        holding = [pin.computeGeneralizedGravity(model, data, self._full(row, rest))[column] for row in q]
        return -np.array(holding).reshape(len(q), 6)

    def tcp_in_workpiece(self, q: Array, external: Array) -> Array:
        """(S, 4, 4) pose of the TCP in the CAM frame."""
        T = self.placements(q, external)
        still = slice(0, 1) if self._part is None else slice(None)  # one that no joint turns is the same in all rows
        tcp: Array = np.linalg.inv(T[still, -1]) @ T[:, -2] @ self.cell.tool.T_flange_tcp
        return tcp


def _motion(value: Array, linear: Array, turn: Array) -> Array:
    """(S, 4, 4) of a joint turned by, or shifted by, ``value`` (S,) rad or m along its own unit axis."""
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((len(value), 4, 4))
    out[:, :3, :3] = (
        np.eye(3) + np.sin(value)[:, None, None] * cross + (1.0 - np.cos(value))[:, None, None] * (cross @ cross)
    )
    out[:, :3, 3] = value[:, None] * linear
    out[:, 3, 3] = 1.0
    return out
