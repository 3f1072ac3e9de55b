"""Lines that move the bodies of a machine, in the order of its chain, and the link that carries each body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree

import numpy as np

from machopt.data_types.cell import Cell
from machopt.kinematics import product_of_exponentials
from machopt.kinematics.machine import Machine
from machopt.kinematics.mimic_joints import compute_rest_configuration
from machopt.kinematics.robot import LinkShape
from machopt.kinematics.urdf_loading import find_frame, load_urdf_model
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import build_transform, invert_transform


@dataclass(frozen=True, eq=False)
class MachineLines:
    """n lines from the part to the tool; θ (n,) rad or m is the displacement of each, x (n,) are the joints.

    Between links i < j of the chain lie the lines i … j − 1, counted from 0.
    """

    machine: Machine
    lower: Array  # (6 + E,) rad or m, of the cell's joints
    upper: Array  # (6 + E,)
    fixed_external_joints: Array | None = (
        None  # (E,) fixed external joints, x has the arm's joints only; None: x has all
    )

    @classmethod
    def build(cls, cell: Cell, machine: Machine, *, still: bool = False) -> MachineLines:
        """Return the lines with the ranges of the robot's joints, and the cell's for external ones.

        Args:
            cell: cell with the limits.
            machine: chain of the cell.
            still: the external joints are fixed at home.
        """
        robot, limits = machine.robot, cell.limits
        low, high = np.append(robot.lower, limits.lower[6:]), np.append(robot.upper, limits.upper[6:])
        return cls(machine, low, high, cell.external_home if still and machine.external_count else None)

    @property
    def columns(self) -> int:
        """Number of joints in x."""
        return len(self.lower) if self.fixed_external_joints is None else 6

    @property
    def count(self) -> int:
        """Number of lines n."""
        return len(self.machine.axis)

    @property
    def axis(self) -> Array:
        """(n, 3) unit, in base_link where all joints are at zero."""
        return self.machine.axis

    @property
    def point(self) -> Array:
        """(n, 3) m, on each line."""
        return self.machine.point

    @property
    def slides(self) -> Bools:
        """(n,) whether the joint moves along its line."""
        return self.machine.slides

    @cached_property
    def stroke(self) -> Array:
        """(n,) m, largest displacement of a sliding line; 0 for rotating ones."""
        most = np.maximum(np.abs(self.lower), np.abs(self.upper))[self.machine.column]
        return np.where(self.slides, most, 0.0)

    def compute_line_positions(self, x: Array) -> Array:
        """Return θ (..., n), with linkages, signs and the chain's order.

        Args:
            x: (..., n or 6) rad or m, joints.
        """
        if self.fixed_external_joints is not None:
            x = np.concatenate(
                [x, np.broadcast_to(self.fixed_external_joints, (*np.shape(x)[:-1], len(self.fixed_external_joints)))],
                axis=-1,
            )
        return (
            self.machine.compute_line_positions(x)
            if self.machine.external_count
            else self.machine.robot.compute_line_angles(np.asarray(x)[..., :6])
        )

    def compute_link_poses(self, theta: Array) -> Array:
        """Return the (..., n + 1, 4, 4) motion of each link from its pose at zero, relative to the part (link 0).

        Args:
            theta: (..., n) rad or m.
        """
        if not self.machine.external_count:
            return self.machine.robot.uncoupled_robot.compute_link_poses(theta)
        n, lead = self.count, np.shape(theta)[:-1]
        rows = np.array(theta, float, order="C").reshape(-1, n)
        R, p = np.empty((len(rows), n + 1, 3, 3)), np.empty((len(rows), n + 1, 3))
        # plain copies, so that the kernel is compiled once
        product_of_exponentials.compute_chain_motions(
            np.array(self.axis), np.array(self.point), np.array(self.slides), rows, R, p
        )
        return build_transform(R, p).reshape(*lead, n + 1, 4, 4)

    def compute_relative_motion(self, i: int, j: int, theta: Array) -> Array:
        """Return the (S, 4, 4) motion of link j from its pose at zero, relative to link i.

        Args:
            i: first link.
            j: second link, j > i.
            theta: (S, n) rad or m.
        """
        rows = np.array(theta, float, order="C")
        T = np.empty((len(rows), 4, 4))
        product_of_exponentials.compute_relative_motion(
            np.array(self.axis), np.array(self.point), np.array(self.slides), i, j, rows, T
        )
        return T


@dataclass(frozen=True)
class LinkCarrier:
    """Link of the chain that carries a body, and the neighbouring links that are not attached to it."""

    link: int
    unattached_links: tuple[int, ...] = ()


class LinkCarriers:
    """Carriers of the links of the URDF in a machine's chain.

    A link that no joint of the chain carries is fixed in the hall. The URDF decides, link by link, whether a positioner
    or
    the arm is attached to it: the robot's base and the foot of a table both belong to the hall.

    Args:
        cell: URDF, and names of the joints.
        machine: of the same cell.
    """

    def __init__(self, cell: Cell, machine: Machine) -> None:
        self._cell, self.machine = cell, machine
        names = (*cell.arm_joints, *cell.external_joints)
        order = [names[c] for c in machine.column]
        P = machine.positioner
        self._link = {name: k if k < P else k + 1 for k, name in enumerate(order)}
        self._next = {k: order[line] for k, line in ((P - 1, P - 1), (P + 1, P)) if line >= 0}

    def find_for_shape(self, shape: LinkShape) -> LinkCarrier:
        """Return the carrier of a collision body of the URDF.

        Args:
            shape: collision body.
        """
        if not self.machine.external_count:
            return LinkCarrier(shape.link)
        link = self._find_carrier(shape.above)
        if link != self.machine.world_link:
            return LinkCarrier(link)
        return LinkCarrier(link, tuple(k for k, above in self._above_next.items() if shape.part not in above))

    def locate_link(self, link: str) -> tuple[int, Array]:
        """Return the carrier of a link of the URDF, and (4, 4) its frame in base_link with all joints at zero.

        Args:
            link: name of the link.
        """
        import pinocchio as pin

        cell = self._cell
        model = load_urdf_model(cell)
        data = model.createData()
        pin.framesForwardKinematics(model, data, compute_rest_configuration(cell, model))
        base, frame = (find_frame(cell, model, name) for name in (cell.base_link, link))
        joint, above = int(model.frames[frame].parentJoint), []
        while joint > 0:
            above.append(str(model.names[joint]))
            joint = int(model.parents[joint])
        T = invert_transform(data.oMf[base].homogeneous) @ data.oMf[frame].homogeneous
        return self._find_carrier(tuple(above)), np.asarray(T)

    def _find_carrier(self, above: tuple[str, ...]) -> int:
        return next((self._link[name] for name in above if name in self._link), self.machine.world_link)

    @cached_property
    def _above_next(self) -> dict[int, set[str]]:
        """Links of the URDF to which the joint of each link next to the hall is attached."""
        root = ElementTree.fromstring(self._cell.urdf_text)
        parent, child = {}, {}
        for joint in root.findall("{*}joint"):
            ends = joint.find("{*}parent"), joint.find("{*}child")
            if ends[0] is not None and ends[1] is not None:
                parent[joint.get("name")] = ends[0].get("link", "")
                child[ends[1].get("link", "")] = joint.get("name")
        out = {}
        for k, name in self._next.items():
            link: str | None = parent.get(name)
            above: set[str] = set()
            while link is not None:
                above.add(link)
                link = parent.get(child.get(link))
            out[k] = above
        return out
