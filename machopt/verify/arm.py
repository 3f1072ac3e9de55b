"""Kinematics of the whole URDF by pinocchio, one configuration after the other."""

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
        for n in range(len(q)):
            self._forward(self.model, self._data, self._full(q[n], external[n]))
            for j in range(self.model.njoints):
                out[n, j] = self._data.oMi[j].homogeneous
            out[n, -2] = self._data.oMf[self._flange].homogeneous
            out[n, -1] = np.eye(4) if self._part is None else self._data.oMf[self._part].homogeneous
        out[:, :-1] = self._to_world @ out[:, :-1]
        if self._part is not None:
            out[:, -1] = self._to_world @ out[:, -1]
        out[:, -1] = out[:, -1] @ self.cell.workpiece.T_link_workpiece
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
        import pinocchio as pin

        n = len(q)
        axis, frames, flange = np.empty((n, 6, 3)), np.empty((n, 7, 4, 4)), np.empty((n, 4, 4))
        column = [self.model.idx_vs[j] for j in self.joints]
        for k in range(n):
            pin.computeJointJacobians(self.model, self._data, self._full(q[k], np.zeros(len(self._external))))
            pin.updateFramePlacements(self.model, self._data)
            back = np.linalg.inv(self._data.oMf[self._base].homogeneous)
            axis[k] = (
                back[:3, :3] @ self._data.J[3:, column]
            ).T  # rows 3…5 of a spatial Jacobian: the axes' directions
            frames[k, 0], flange[k] = np.eye(4), back @ self._data.oMf[self._flange].homogeneous
            for i, j in enumerate(self.joints):
                frames[k, i + 1] = back @ self._data.oMi[j].homogeneous
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
        tcp: Array = np.linalg.inv(T[:, -1]) @ T[:, -2] @ self.cell.tool.T_flange_tcp
        return tcp
