"""Kinematics of the whole URDF by pinocchio, one configuration after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.errors import InputError

Array = NDArray[np.float64]


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
        full = self.rest.copy()
        at = [self.model.idx_qs[j] for j in (*self.joints, *self._external)]
        to_world = None
        for n in range(len(q)):
            full[at] = np.concatenate([q[n], external[n]])
            self._forward(self.model, self._data, full)
            for j in range(self.model.njoints):
                out[n, j] = self._data.oMi[j].homogeneous
            out[n, -2] = self._data.oMf[self._flange].homogeneous
            out[n, -1] = np.eye(4) if self._part is None else self._data.oMf[self._part].homogeneous
            if to_world is None:  # base_link stands where cell.yaml puts it with the external axes at rest
                self._forward(self.model, self._data, self.rest)
                to_world = self.cell.T_world_base @ np.linalg.inv(self._data.oMf[self._base].homogeneous)
        out[:, :-1] = (to_world if to_world is not None else np.eye(4)) @ out[:, :-1]
        if self._part is not None and to_world is not None:
            out[:, -1] = to_world @ out[:, -1]
        out[:, -1] = out[:, -1] @ self.cell.workpiece.T_link_workpiece
        return out

    def jacobian(self, q: Array) -> tuple[Array, Array, Array]:
        """Translational Jacobian (3, 6) of the TCP in world axes at q (6,), poses of base_link and workpiece in world.

        External joints at rest.
        """
        import pinocchio as pin

        full = self.rest.copy()
        full[[self.model.idx_qs[j] for j in self.joints]] = q
        pin.computeJointJacobians(self.model, self._data, full)
        pin.updateFramePlacements(self.model, self._data)
        J = pin.getFrameJacobian(self.model, self._data, self._flange, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        J = np.asarray(J[:, [self.model.idx_vs[j] for j in self.joints]], float)
        lever = self._data.oMf[self._flange].rotation @ self.cell.tool.T_flange_tcp[:3, 3]
        at_tcp = J[:3] + np.cross(J[3:].T, lever).T
        places = self.placements(q[None], np.zeros((1, len(self._external))))[0]
        to_world = self.cell.T_world_base[:3, :3] @ np.linalg.inv(self._data.oMf[self._base].homogeneous)[:3, :3]
        return to_world @ at_tcp, self.cell.T_world_base, places[-1]

    def tcp_in_workpiece(self, q: Array, external: Array) -> Array:
        """(S, 4, 4) pose of the TCP in the CAM frame."""
        T = self.placements(q, external)
        tcp: Array = np.linalg.inv(T[:, -1]) @ T[:, -2] @ self.cell.tool.T_flange_tcp
        return tcp
