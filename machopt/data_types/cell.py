"""Cell model: robot, tool, workpiece, obstacles, limits. Built by :mod:`machopt.cell.cell_reader`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.process import ArmAccuracy, CuttingProcess
from machopt.data_types.robot_program import RobotController
from machopt.data_types.stiffness import ArmStiffness
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class CollisionShape:
    """One collision body, placed in its parent frame (flange for the tool, workpiece, or ``link``)."""

    name: str
    kind: Literal["mesh", "box", "cylinder", "sphere"]
    size: tuple[float, ...]  # m. box: (x, y, z); cylinder: (radius, height along z); sphere: (radius,); mesh: (scale,)
    mesh: Path | None
    T_parent_shape: Array  # (4, 4)
    link: str = "world"  # of obstacles: what carries it, world or a link of the URDF (a rail's or a positioner's)


@dataclass(frozen=True, kw_only=True)
class ToolMode:
    """Mode of vibration of tool and spindle at the tip."""

    frequency: float  # Hz
    damping: float  # ratio
    stiffness: float  # N/m, modal
    direction: tuple[float, float, float]  # unit, in TCP axes


BALL_TOLERANCE = 1e-9  # m, rounding of the millimetres of a file


@dataclass(frozen=True)
class CutterGeometry:
    """Rotating cutter: a cylinder from the TCP back along −z of the TCP, rounded at its tip's edge.

    Collision checks use the whole cylinder; the corner radius counts in the gouge check against the finished part.
    """

    diameter: float  # m
    length: float  # m
    corner: float = 0.0  # m, radius of the corner: 0 is an end mill, half the diameter a ball
    _: KW_ONLY
    teeth: int | None = None
    helix: float | None = None  # rad, + for a right-hand helix
    point_angle: float | None = None  # rad, included
    web: float | None = None  # m
    runout: float = 0.0  # m
    side_stiffness: float | None = None  # N/m, of tool and spindle at the tip; None: rigid
    modes: tuple[ToolMode, ...] = ()

    @property
    def is_ball(self) -> bool:
        """Whether its end is half a sphere, so that it cuts the same surface with its axis tilted."""
        return self.corner > 0 and abs(2.0 * self.corner - self.diameter) < BALL_TOLERANCE


@dataclass(frozen=True, kw_only=True)
class Tool:
    """Tool at the flange with TCP, mass and shapes."""

    T_flange_tcp: Array  # (4, 4)
    mass: float = 0.0  # kg
    com: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, in flange
    geometry: tuple[CollisionShape, ...] = ()
    cutter: CutterGeometry | None = None
    inertia: Array | None = None  # (3, 3) kg·m² about the centre of mass, flange axes; None: not stated
    number: int | None = None  # of the tool stored in the controller; None: ``controller.tool_number``


@dataclass(frozen=True)
class Workpiece:
    """Workpiece with its frame and shapes."""

    link: str  # "world" or a link of the URDF
    T_link_workpiece: Array  # (4, 4)
    geometry: tuple[CollisionShape, ...] = ()
    stiffness: Array | None = None  # (3,) N/m along the CAM axes; None: the part counts as rigid
    pose_covariance: Array | None = None  # (6, 6) m and rad, CAM axes at the CAM origin


@dataclass(frozen=True)
class JointLimits:
    """One value per moving joint: arm joints first, then external joints. rad or m, per s."""

    lower: Array  # (6 + E,) rad or m
    upper: Array  # (6 + E,) rad or m
    velocity: Array  # (6 + E,) rad/s or m/s
    acceleration: Array  # (6 + E,) rad/s² or m/s²
    jerk: Array  # (6 + E,) rad/s³ or m/s³


@dataclass(frozen=True)
class MimicJoint:
    """Joint that follows another: its value is ``multiplier`` times that one's value plus ``offset``."""

    joint: str
    source: str  # a joint of the arm, or a fixed one
    multiplier: float  # rad or m per unit of the source joint
    offset: float  # rad or m


@dataclass(frozen=True)
class IgnoredPair:
    """Bodies that the cell allows to touch: every one of ``first`` each of ``second``."""

    a: str  # as the cell or SRDF names them: a link, a body, tool, workpiece or cutter
    b: str
    first: tuple[str, ...]  # names of bodies; a link's n-th collision body is called LINK_n, n from 0
    second: tuple[str, ...]
    source: str  # its place in the file, for messages


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A robot cell as cell.yaml describes it; positions and angles in SI."""

    name: str
    folder: Path  # everything relative is relative to it
    urdf: Path
    packages: dict[str, Path]  # package:// names to folders
    base_link: str
    flange_link: str
    arm_joints: tuple[str, ...]  # in chain order; six revolute joints but where only a motion is diagnosed
    external_joints: tuple[str, ...]
    external_prismatic: tuple[bool, ...]
    home: Array  # (6,) rad; one a joint of the arm
    external_home: Array  # (E,) rad or m
    T_world_base: Array  # (4, 4) with all joints at zero
    limits: JointLimits
    tool: Tool
    workpiece: Workpiece
    obstacles: tuple[CollisionShape, ...]  # placed in their ``link``, mostly world
    stiffness: ArmStiffness | None
    plan: dict[str, object] = field(default_factory=dict)  # the cell's planning defaults, validated like --plan
    controller: RobotController = field(default_factory=RobotController)  # what programs are written for
    kinematics: KinematicCorrections | None = (
        None  # between encoder and true joint angles; home and limits are encoder angles
    )
    files: tuple[Path, ...] = ()  # every file read for this cell, for the hash of inputs
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # what was read and is not used; nothing to worry about
    expanded: str | None = None  # the URDF as text where ``urdf`` is a xacro file
    mimics: tuple[MimicJoint, ...] = ()  # every joint of the URDF that follows another
    may_touch: tuple[IgnoredPair, ...] = ()
    tools: Mapping[str, Tool] = field(default_factory=dict)  # the tool table by the CAM file's words; empty: one tool
    tool_name: str | None = None  # which of the table ``tool`` is; the first one until a toolpath says, None: several
    tool_change: Array | None = None  # (6 + E,) rad or m by encoder, where tools are changed; None: at home
    offsets: Mapping[str, Array] = field(default_factory=dict)  # work offsets by name: (4, 4) in workpiece
    fixtures: tuple[str, ...] = ()  # obstacles that hold the part of an offset: they stand in its frame
    process: CuttingProcess | None = None  # cutting conditions and tolerances; None: not stated
    accuracy: ArmAccuracy | None = None  # None: not stated
    gravity_compensator: Literal["fitted", "none", "unknown"] = "unknown"
    rated_payload: float | None = None  # kg
    arm_prismatic: tuple[bool, ...] = ()  # which joints of the arm slide; empty: all turn

    @property
    def urdf_text(self) -> str:
        """Text of the robot's URDF."""
        return self.urdf.read_text(encoding="utf-8-sig") if self.expanded is None else self.expanded

    @property
    def arm_limits(self) -> tuple[Array, Array]:
        """Lower and upper (6,) rad of the arm's joints, by encoder."""
        joints = len(self.home)
        return self.limits.lower[:joints], self.limits.upper[:joints]

    @property
    def joints_at_home(self) -> Array:
        """(6 + E,) rad or m by encoder, where a motion begins and ends."""
        return np.concatenate([self.home, self.external_home])

    @property
    def joints_at_tool_change(self) -> Array:
        """(6 + E,) rad or m by encoder, where tools are changed."""
        return self.joints_at_home if self.tool_change is None else self.tool_change

    @property
    def tools_on(self) -> tuple[Tool, ...]:
        """The tools of the job: ``tool``, or the whole table where the job takes several."""
        return tuple(self.tools.values()) if self.tools and self.tool_name is None else (self.tool,)


def select_geometry(cell: Cell) -> Cell:
    """Return the cell without what has no influence on its bodies and their motion, and without the list of files.

    Args:
        cell: The robot cell.
    """
    return replace(
        cell,
        name="",
        stiffness=None,
        plan={},
        controller=RobotController(),
        files=(),
        warnings=(),
        notes=(),
        process=None,
        accuracy=None,
    )


def list_geometry_files(cell: Cell) -> tuple[Path, ...]:
    """Return every file read for the cell but its tables; the COLLADA originals of converted meshes are among them.

    Args:
        cell: The robot cell.
    """
    return tuple(file for file in cell.files if file.suffix.lower() not in (".yaml", ".yml", ".json"))


def describe_fixed_external_joints(cell: Cell) -> tuple[str, ...]:
    """Return the warning that external joints are assumed fixed in recordings; none without them.

    Args:
        cell: The robot cell.
    """
    if not cell.external_joints:
        return ()
    return (
        f"external joints ({', '.join(cell.external_joints)}) are taken to stand still: a recording has no columns for "
        "them. Readings with one elsewhere are off by that; a recording for each place would work",
    )
