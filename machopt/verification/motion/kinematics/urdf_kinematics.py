"""Kinematics of the whole URDF: joint placements and axes by pinocchio, all configurations in one compiled loop.

Joints that mimic another (``<mimic>``) follow it. With A_i the placement of joint i in its parent p, E_i(q) its
rotation about or translation along its axis:

  T_i = T_p A_i E_i(q_i),    E = I + sin q [w]× + (1 − cos q) [w]×²  or  I with q v in the last column.

The tests compare this with pinocchio's own forward kinematics, row by row.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.errors import OutputFolderError
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.verification.motion.kinematics.arm_configuration import ArmConfiguration, build_twist_columns
from machopt.verification.motion.kinematics.as_built_frames import apply_as_built_geometry, has_as_built_geometry

BLOCK_ROWS = 20_000  # rows whose frames of all joints are held at a time
NEWTON_STEPS = 6  # Newton steps between two arms that differ by millimetres; the third is exact


class UrdfKinematics:
    """World poses of everything the joints move.

    Args:
        cell: URDF, names of base, flange, arm and external joints, poses of robot and workpiece in the world.
        drawn: as the controller reckons, without what kinematics.yaml says of how the arm is built.

    Raises:
        InputError: a name is not in the URDF.
    """

    def __init__(self, cell: Cell, *, drawn: bool = False) -> None:
        import pinocchio as pin

        self.cell, self._drawn = cell, drawn
        self.model: Any = pin.buildModelFromXML(cell.urdf_text)
        self._data = self.model.createData()
        self._forward = pin.framesForwardKinematics
        self.rest: Array = pin.neutral(self.model)
        for name in (*cell.arm_joints, *cell.external_joints):
            if not self.model.existJointName(name):
                raise OutputFolderError(f"joint {name!r} is not in the URDF", file=cell.urdf)
        self.joints = [int(self.model.getJointId(name)) for name in cell.arm_joints]
        self._external = [int(self.model.getJointId(name)) for name in cell.external_joints]
        driven = {name: n for n, name in enumerate((*cell.arm_joints, *cell.external_joints))}
        # joint of the URDF that follows, column of what it follows (−1: fixed), multiplier, offset
        self._follow = [
            (int(self.model.getJointId(m.joint)), driven.get(m.source, -1), m.multiplier, m.offset)
            for m in cell.mimics
            if self.model.existJointName(m.joint)
        ]
        self._flange, self._base = (self._find_frame(name) for name in (cell.flange_link, cell.base_link))
        if not drawn:
            apply_as_built_geometry(self.model, cell, self._base, self._flange, self.rest)
            self._data = self.model.createData()
        self._part = None if cell.workpiece.link == "world" else self._find_frame(cell.workpiece.link)

    def _find_frame(self, name: str) -> int:
        if not self.model.existFrame(name):
            raise OutputFolderError(f"link {name!r} is not in the URDF", file=self.cell.urdf)
        return int(self.model.getFrameId(name))

    def link_of(self, frame: int) -> int:
        """Return the arm link (0 … 6) that carries a link of the URDF.

        In a cell with external joints it is −1 for everything not below base_link: the hall, rails and their
        carriages, a positioner.

        Args:
            frame: Number of the URDF link's frame in pinocchio's model.
        """
        joint = int(self.model.frames[frame].parentJoint)
        while joint > 0:
            if joint in self.joints:
                return self.joints.index(joint) + 1
            if joint in self._external and joint not in self.list_moving_joints(
                self.base
            ):  # a table that hangs on base_link
                return -1
            joint = int(self.model.parents[joint])
        while self._external and frame != self._base:
            if frame == 0:
                return -1
            frame = int(self.model.frames[frame].parentFrame)
        return 0

    @property
    def is_workpiece_on_base(self) -> bool:
        """Whether the workpiece's link is fixed to base_link; its neighbours are then those of base_link."""
        frame = 0 if self._part is None else self._part
        while frame not in (0, self._base):
            frame = int(self.model.frames[frame].parentFrame)
        return frame != 0

    def list_moving_joints(self, carrier: int) -> frozenset[int]:
        """Return the URDF joints that move an entry of :meth:`compute_placements` in the world; none for −1.

        Joints that nothing drives move nothing.

        Args:
            carrier: Number of the entry.
        """
        driven = {*self.joints, *self._external, *(j for j, source, *_ in self._follow if source >= 0)}
        out, parent = set(), self._chain[0]
        while carrier >= 0:
            out |= {carrier} & driven
            carrier = int(parent[carrier])
        return frozenset(out)

    @property
    def external_joints(self) -> frozenset[int]:
        """Joints of the URDF that are the cell's external ones."""
        return frozenset(self._external)

    def find_placement(self, link: str) -> tuple[int, Array]:
        """Return the entry of :meth:`compute_placements` that carries a link, and the (4, 4) link pose there.

        Args:
            link: Name of a URDF link, or ``world`` (entry −1).
        """
        if link == "world":
            return -1, np.eye(4)
        frame = self.model.frames[self._find_frame(link)]
        return int(frame.parentJoint), np.asarray(frame.placement.homogeneous)

    @property
    def base(self) -> int:
        """Entry of :meth:`compute_placements` that carries base_link."""
        return int(self.model.frames[self._base].parentJoint)

    @property
    def workpiece_placement(self) -> int:
        """Entry of :meth:`compute_placements` of the workpiece frame."""
        return int(self.model.njoints) + 1

    def compute_placements(self, q: Array, external: Array) -> Array:
        """Where everything is.

        Args:
            q: (S, 6) rad.
            external: (S, E) rad or m.

        Returns:
            (S, J + 2, 4, 4) in world: every joint of the URDF (entry 0 the URDF's root), then the flange, then the
            workpiece frame.
        """
        return np.asarray(_compute_frames(self._compute_joint_values(q, external), *self._chain, self._to_world))

    def _joint_frames(self, q: Array, external: Array) -> Array:
        """(S, J, 4, 4) of every joint in the URDF's root; joints that neither arm nor external are stay at rest."""
        return np.asarray(_compute_frames(self._compute_joint_values(q, external), *self._chain, np.eye(4)))[
            :, : self.model.njoints
        ]

    def _compute_joint_values(self, q: Array, external: Array) -> Array:
        """(S, J + 2) rad or m of every joint, zero where it stays at rest; flange and workpiece have none."""
        out = np.zeros((len(q), self.model.njoints + 2))
        out[:, self.joints], out[:, self._external] = q, external
        both = np.hstack([q, external])
        for joint, source, multiplier, offset in self._follow:
            out[:, joint] = offset + (multiplier * both[:, source] if source >= 0 else 0.0)
        return out

    @cached_property
    def total_rotation(self) -> Array:
        """(6 + E,) motion of all joints together per unit of one: more than 1 where others follow it."""
        out = np.ones(len(self.joints) + len(self._external))
        for _, source, multiplier, _ in self._follow:
            if source >= 0:
                out[source] += abs(multiplier)
        return out

    @cached_property
    def slides(self) -> NDArray[np.bool_]:
        """(6 + E,) which of the driven joints are prismatic."""
        return np.array([bool(self._steps[j][1].any()) for j in (*self.joints, *self._external)])

    @cached_property
    def _chain(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Of every joint, then of flange and workpiece: (J + 2,) what carries it, −1 the world; (J + 2, 4, 4) its place
        there at rest; (J + 2, 3) direction of its shift; (J + 2, 3) axis of its turn."""
        fixed = [self.model.frames[f] for f in (self._flange, *(() if self._part is None else (self._part,)))]
        parent = [-1, *(int(self.model.parents[j]) for j in range(1, self.model.njoints))]
        parent += [int(f.parentJoint) for f in fixed]
        place = [step[0] for step in self._steps] + [f.placement.homogeneous for f in fixed]
        if self._part is None:
            parent.append(-1)
            place.append(np.linalg.inv(self._to_world))
        place[-1] = place[-1] @ self.cell.workpiece.T_link_workpiece
        rest = [np.zeros(3)] * 2
        return (
            np.array(parent),
            np.array(place),
            np.array([*(step[1] for step in self._steps), *rest]),
            np.array([*(step[2] for step in self._steps), *rest]),
        )

    def _compute_fixed_link_pose(self, joints: Array, frame: int) -> Array:
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

    def build_full_configuration(self, q: Array, external: Array) -> Array:
        """Return the configuration of the whole URDF; a continuous joint is cosine and sine there.

        Args:
            q: (6,) rad, joints of the arm.
            external: (E,) rad or m.
        """
        full = self.rest.copy()
        values = self._compute_joint_values(q[None], external[None])[0]
        for j in (*self.joints, *self._external, *(j for j, *_ in self._follow)):
            value = values[j]
            at = self.model.idx_qs[j]
            if self.model.nqs[j] == 2:
                full[at : at + 2] = np.cos(value), np.sin(value)
            else:
                full[at] = value
        return full

    @cached_property
    def _to_world(self) -> Array:
        """Return the (4, 4) pose of the URDF's root in world: the cell places base_link with external axes at zero."""
        self._forward(self.model, self._data, self.rest)
        to_world: Array = self.cell.T_world_base @ np.linalg.inv(self._data.oMf[self._base].homogeneous)
        return to_world

    def T_base_workpiece(self, external: Array) -> Array:
        """Return (N, 4, 4) poses of the CAM frame in base_link; one for all rows if E = 0.

        Args:
            external: (N, E) positions of the external joints, rad or m.
        """
        if external.shape[1] == 0 and len(external) > 1:
            return np.broadcast_to(self.T_base_workpiece(external[:1]), (len(external), 4, 4))
        values = np.zeros((len(external), 6)), external
        base = self._compute_fixed_link_pose(self._joint_frames(*values), self._base)
        return np.asarray(np.linalg.inv(self._to_world @ base) @ self.compute_placements(*values)[:, -1])

    def _check_external_positions(self, q: Array, external: Array | None) -> Array:
        """(N, E) external joints; only a cell that has none may leave them out.

        Raises:
            ValueError: it has some.
        """
        if external is None and self._external:
            raise ValueError("this cell has external joints: give their positions")
        return np.empty((len(q), 0)) if external is None else external

    def compute_configuration(self, q: Array, external: Array | None = None) -> ArmConfiguration:
        """Return axes, frames and TCP in base_link.

        Args:
            q: (N, 6) joint positions by encoder, rad.
            external: (N, E) positions of the external joints, rad or m; None for the home position.
        """
        external = self._check_external_positions(q, external)
        joints = self._joint_frames(q, external)
        back = np.linalg.inv(self._compute_fixed_link_pose(joints, self._base))
        frames = np.empty((len(q), 7, 4, 4))
        frames[:, 0] = np.eye(4)
        frames[:, 1:] = back[:, None] @ joints[:, self.joints]
        turn = np.stack([self._steps[j][2] for j in self.joints])
        axis = np.einsum("njab,jb->nja", frames[:, 1:, :3, :3], turn)
        flange = back @ self._compute_fixed_link_pose(joints, self._flange)
        tcp = flange @ self.cell.tool.T_flange_tcp
        linked = np.zeros((len(q), 6, 6))
        above = self._list_supporting_joints(int(self.model.frames[self._flange].parentJoint))
        for j, source, multiplier, _ in self._follow:
            if j in above and source >= 0:
                T = back @ joints[:, j]
                column = build_twist_columns((T[:, :3, :3] @ self._steps[j][2])[:, None], T[:, None, :3, 3], tcp)
                linked[:, :, source] += multiplier * column[:, :, 0]
        return ArmConfiguration(
            q=q,
            external=external,
            axis=axis,
            origin=frames[:, 1:, :3, 3],
            tcp=tcp,
            frames=frames,
            flange=flange,
            linked_joints=linked,
        )

    def compute_external_joint_state(self, name: str, stance: ArmConfiguration) -> tuple[Array, Array, bool]:
        """Return link pose, axis and type of an external joint.

        Args:
            name: Name of the external joint.
            stance: The arm at N configurations, base_link axes.

        Returns:
            (N, 4, 4) the link it moves and (N, 3) its axis, both in base_link, and whether the joint is prismatic.
        """
        joint = self._external[self.cell.external_joints.index(name)]
        joints = self._joint_frames(stance.q, stance.external)
        link = np.linalg.inv(self._compute_fixed_link_pose(joints, self._base)) @ joints[:, joint]
        _, shift, turn = self._steps[joint]
        return link, np.asarray(link[:, :3, :3] @ (shift + turn)), bool(shift.any())

    def build_nominal(self, stance: ArmConfiguration) -> ArmConfiguration:
        """Return the nominal arm with its flange at the same poses; branches and singularities refer to it.

        Args:
            stance: The arm at N configurations, base_link axes.
        """
        if self._drawn or not has_as_built_geometry(self.cell):
            return stance
        drawn, q = UrdfKinematics(self.cell, drawn=True), stance.q
        for _ in range(NEWTON_STEPS):
            there = drawn.compute_configuration(q, stance.external)
            off = stance.flange[:, :3, :3] @ np.swapaxes(there.flange[:, :3, :3], 1, 2)
            turn = 0.5 * np.stack(
                [off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]], 1
            )
            J = build_twist_columns(there.axis, there.origin, there.flange) + there.moved_to_flange()
            away = np.concatenate([stance.flange[:, :3, 3] - there.flange[:, :3, 3], turn], axis=1)
            q = q + np.einsum("nij,nj->ni", np.linalg.pinv(J), away)
        return drawn.compute_configuration(q, stance.external)

    def _list_supporting_joints(self, joint: int) -> list[int]:
        """A joint of the URDF and all that carry it."""
        out = []
        while joint > 0:
            out.append(joint)
            joint = int(self.model.parents[joint])
        return out

    def compute_gravity_torque(self, q: Array, external: Array | None = None) -> Array:
        """Return (N, 6) joint torques of the weight of links and tool, N·m; the tool is a point mass.

        Weight acts along −z of world with 9.80665 m/s². What is missing in the URDF weighs nothing.

        Args:
            q: (N, 6) joint positions by encoder, rad.
            external: (N, E) positions of the external joints, rad or m; None for the home position.
        """
        import pinocchio as pin

        model = self.model.copy()
        model.gravity.linear = self._to_world[:3, :3].T @ np.array([0.0, 0.0, -9.80665])
        tool, frame = self.cell.tool, model.frames[self._flange]
        if tool.mass > 0.0:
            own = pin.Inertia(tool.mass, np.asarray(tool.com, float), np.zeros((3, 3)))
            model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + frame.placement.act(own)
        data, column = model.createData(), [model.idx_vs[j] for j in self.joints]
        rows = zip(q, self._check_external_positions(q, external), strict=True)
        holding = np.array(
            [pin.computeGeneralizedGravity(model, data, self.build_full_configuration(*row)) for row in rows]
        )
        holding = holding.reshape(len(q), -1)
        torque = -holding[:, column]
        for j, source, multiplier, _ in self._follow:  # work of a joint that follows is work of the one it follows
            if 0 <= source < len(self.joints):
                torque[:, source] -= multiplier * holding[:, model.idx_vs[j]]
        return np.asarray(torque)

    def compute_tcp_in_workpiece(self, q: Array, external: Array, *, rows: int = 4) -> Array:
        """Return (S, 4, 4) poses of the TCP in the CAM frame.

        Args:
            q: (S, 6) joint positions by encoder, rad.
            external: (S, E) positions of the external joints, rad or m.
            rows: Rows of each matrix; 3 without the constant last one, (S, 3, 4), for the samples of a long motion.
        """
        out = np.empty((len(q), rows, 4))
        still = slice(0, 1) if self._part is None else slice(None)  # one that no joint turns is the same in all rows
        for start in range(0, len(q), BLOCK_ROWS):  # the frames of all joints need many times the memory of the result
            some = slice(start, start + BLOCK_ROWS)
            T = self.compute_placements(q[some], external[some])
            out[some] = (np.linalg.inv(T[still, -1]) @ T[:, -2] @ self.cell.tool.T_flange_tcp)[:, :rows]
        return out


@jit_compile
def _compute_frames(
    value: Array, parent: NDArray[np.int64], place: Array, linear: Array, turn: Array, root: Array
) -> Array:
    """(S, F, 4, 4) of F frames that follow one another, each turned about or shifted along its own axis by ``value``.

    Args:
        value: (S, F) rad or m.
        parent, place, linear, turn: of :meth:`UrdfKinematics._chain`.
        root: (4, 4) frame −1.
    """
    count, frames = value.shape
    out = np.zeros((count, frames, 4, 4))
    step, about = np.empty((frames, 3, 3, 3)), np.empty((3, 3))  # place, place [w]×, place [w]×²
    for f in range(frames):
        x, y, z = turn[f]
        about[0, 0] = about[1, 1] = about[2, 2] = 0.0
        about[0, 1], about[0, 2], about[1, 2] = -z, y, -x
        about[1, 0], about[2, 0], about[2, 1] = z, -y, x
        for i in range(3):
            for j in range(3):
                step[f, 0, i, j] = place[f, i, j]
        for n in range(2):
            for i in range(3):
                for j in range(3):
                    step[f, n + 1, i, j] = (
                        step[f, n, i, 0] * about[0, j] + step[f, n, i, 1] * about[1, j] + step[f, n, i, 2] * about[2, j]
                    )
    own = np.empty((3, 4))
    for s in range(count):
        for f in range(frames):
            sine, rise = np.sin(value[s, f]), 1.0 - np.cos(value[s, f])
            for i in range(3):
                for j in range(3):
                    own[i, j] = step[f, 0, i, j] + sine * step[f, 1, i, j] + rise * step[f, 2, i, j]
                way = place[f, i, 0] * linear[f, 0] + place[f, i, 1] * linear[f, 1] + place[f, i, 2] * linear[f, 2]
                own[i, 3] = place[f, i, 3] + value[s, f] * way
            before = root if parent[f] < 0 else out[s, parent[f]]
            for i in range(3):
                for j in range(4):
                    out[s, f, i, j] = before[i, 0] * own[0, j] + before[i, 1] * own[1, j] + before[i, 2] * own[2, j]
                out[s, f, i, 3] += before[i, 3]
            out[s, f, 3, 3] = 1.0
    return out
