"""The lines that move the bodies of a machine, in the order of its chain, and which of them carries what."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree

import numpy as np

from machopt.data_types.cell import Cell
from machopt.kinematics import product_of_exponentials
from machopt.kinematics.machine import Machine
from machopt.kinematics.mimic_joints import compute_rest_configuration
from machopt.kinematics.robot import LinkShape, find_frame, load_urdf_model
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import build_transform, invert_transform


@dataclass(frozen=True, eq=False)
class MachineLines:
    """n lines from the part to the tool; θ (n,) rad or m says how far each moves, x (n,) where the joints are.

    Between links i < j of the chain lie the lines i … j − 1, counted from 0.
    """

    machine: Machine
    lower: Array  # (6 + E,) rad or m, of the cell's joints
    upper: Array  # (6 + E,)
    fixed_external_joints: Array | None = (
        None  # (E,) where external joints stand for good, x being the arm's alone; None: x has all
    )

    @classmethod
    def build(cls, cell: Cell, machine: Machine, *, still: bool = False) -> MachineLines:
        """With the ranges of the robot's joints, and the cell's of external ones.

        Args:
            still: the external joints stand at home.
        """
        robot, limits = machine.robot, cell.limits
        low, high = np.append(robot.lower, limits.lower[6:]), np.append(robot.upper, limits.upper[6:])
        return cls(machine, low, high, cell.external_home if still and machine.external_count else None)

    @property
    def columns(self) -> int:
        """How many joints x has."""
        return len(self.lower) if self.fixed_external_joints is None else 6

    @property
    def count(self) -> int:
        """n."""
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
        """(n,) moves along its line."""
        return self.machine.slides

    @cached_property
    def stroke(self) -> Array:
        """(n,) m, how far a line that slides is ever shifted; 0 for those that turn."""
        most = np.maximum(np.abs(self.lower), np.abs(self.upper))[self.machine.column]
        return np.where(self.slides, most, 0.0)

    def compute_line_positions(self, x: Array) -> Array:
        """θ (..., n) at joints x (..., n or 6): with linkages, signs and the chain's order."""
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
        """(..., n + 1, 4, 4) motion of each link from where it is at zero, seen from the part (link 0); θ (..., n)."""
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
        """(S, 4, 4) motion of link j > i from where it is at zero, seen from link i; θ (S, n)."""
        rows = np.array(theta, float, order="C")
        T = np.empty((len(rows), 4, 4))
        product_of_exponentials.compute_relative_motion(
            np.array(self.axis), np.array(self.point), np.array(self.slides), i, j, rows, T
        )
        return T


@dataclass(frozen=True)
class LinkCarrier:
    """What carries a body: a link of the chain, and which links next to it do not hang on it."""

    link: int
    unattached_links: tuple[int, ...] = ()


class LinkCarriers:
    """Which link of a machine's chain carries the links of the URDF.

    What no joint of the chain carries stands in the hall. On what stands there a positioner or the arm hangs only where
    the URDF says so, link by link: the robot's base and the foot of a table are both of the hall.

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
        """What carries a collision body of the URDF."""
        if not self.machine.external_count:
            return LinkCarrier(shape.link)
        link = self._find_carrier(shape.above)
        if link != self.machine.world_link:
            return LinkCarrier(link)
        return LinkCarrier(link, tuple(k for k, above in self._above_next.items() if shape.part not in above))

    def locate_link(self, link: str) -> tuple[int, Array]:
        """What carries a link of the URDF, and (4, 4) its frame in base_link with all joints at zero."""
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
        """Of each link next to the hall: the links of the URDF on which its joint hangs."""
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
