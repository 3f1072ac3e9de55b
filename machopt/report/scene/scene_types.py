"""Types of the 3-D scene of a page: a tree of joints, the bodies they carry, and postures to show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Ints
from machopt.report.scene.mesh_decimation import Faces

BodyKind = Literal["link", "tool", "cutter", "workpiece", "stock", "obstacle"]


@dataclass(frozen=True, kw_only=True)
class SceneJoint:
    """Joint of the tree, as a line in root axes with every joint at zero."""

    name: str
    parent: int  # the joint that carries it; −1: the root
    axis: Array  # (3,) unit
    point: Array  # (3,) m, on the line
    prismatic: bool
    lower: float  # rad or m
    upper: float


@dataclass(frozen=True, kw_only=True)
class SceneBody:
    """A surface that one joint carries."""

    name: str
    kind: BodyKind
    joint: int  # −1: fixed
    vertices: Array  # (V, 3) m, root axes, every joint at zero
    faces: Faces  # (F, 3)
    tools: tuple[int, ...] = ()  # of the scene's, with which it is there; none: with every one


@dataclass(frozen=True, kw_only=True)
class CellScene:
    """A cell: joint i turns what it carries about its line, so M_i = M_parent · exp(line_i θ_i), θ = C q of the arm."""

    T_world_root: Array  # (4, 4)
    joints: tuple[SceneJoint, ...]  # the arm's six, then external ones in the order of the cell
    bodies: tuple[SceneBody, ...]
    T_root_tool: Array  # (4, 4) TCP with every joint at zero
    T_root_part: Array  # (4, 4) the same of the frame of the toolpath
    tool_joint: int  # the joint that carries the tool
    part_joint: int = -1  # … the workpiece
    base_joint: int = -1  # … base_link, in whose axes forces and compliances are given
    coupling: Array | None = None  # (6, 6) C of the arm's joints; None: identity
    tools: tuple[tuple[str, Array], ...] = ()  # name and T_root_tool of each where the job changes them; none: one


@dataclass(frozen=True, kw_only=True)
class ToolpathScene:
    """The toolpath in the frame of the workpiece; P points."""

    position: Array  # (P, 3) m
    point: Array  # (P,) toolpath point
    cutting: NDArray[np.bool_]  # (P,) the segment that ends here cuts
    value: Array  # (P,) what colours it, NaN where unknown
    label: str  # what that is, with its unit
    large_is_good: bool
    outcome: NDArray[np.uint8] | None = None  # (P,) 0: no tolerance, else 1 + index in OUTCOMES; None: no process
    p_in: Array | None = None  # (P,) probability that the tolerances hold
    cause: tuple[str, ...] = ()  # (P,) largest cause of the error, as in points.csv


@dataclass(frozen=True, kw_only=True)
class StationPostures:
    """What the picture says at the places of the map; N stations, R rotations, J joints."""

    q: Array  # (N, R, J) rad or m: the posture of each cell of the map, NaN where no posture reaches
    chosen: Array  # (N, J), NaN where there is none
    k: Array  # (N, 6) N·m/rad, springs of the arm's joints
    force: Array | None  # (N, 3) N in base_link; None: none was given
    compliance: Array  # (N, 6) m/N at the chosen posture: xx, yy, zz, xy, xz, yz in base_link, NaN where there is none
    bend: Array | None  # (N, 3) m in base_link, deflection at the chosen posture; None: no force was given
    clearance: Array  # (N,) m at the chosen posture
    nearest: tuple[str, ...]  # (N,) the two bodies
    singularity: Array  # (N,) rad
    tool: NDArray[np.int64] | None = None  # (N,) which of the scene's tools is on; None: it has one
    terms: tuple[str, ...] = ()  # further stiffness terms, not included for other rotations


@dataclass(frozen=True, kw_only=True)
class MotionScene:
    """The motion as it is played; M samples, J joints."""

    time: Array  # (M,) s
    q: Array  # (M, J) rad or m, true joint angles
    point: Array  # (M,) fractional toolpath point, NaN outside the toolpath
    s: Array  # (M,) m of path length, NaN outside
    phi: Array  # (M,) rad, NaN where there is none
    gamma: Array  # (M,) rad
    tool: NDArray[np.int64] | None = None  # (M,) which of the scene's tools is on; None: it has one


@dataclass(frozen=True)
class OptimizeScene:
    """Everything the 3-D picture of optimize shows."""

    scene: CellScene
    path: ToolpathScene
    stations: StationPostures | None = None  # of the map; None: there is none
    motion: MotionScene | None = None
    corrected: bool = False  # shown joints are true angles; the robot gets encoder angles


@dataclass(frozen=True)
class PostureVectors:
    """One vector at the tool for each posture."""

    name: str  # what it is, and how long it is drawn
    color: str
    values: Array  # (N, 3) in root axes, of any unit; the longest is drawn a seventh of the picture long
    longest: float | None = None  # what is drawn so long instead: vectors that are compared share it


@dataclass(frozen=True)
class PostureNeedles:
    """Many vectors at once, each a line from the tip of its posture; M of them."""

    color: str
    posture_index: Ints  # (M,) posture
    values: Array  # (M, 3) as in Vectors
    longest: float  # as in Vectors


@dataclass(frozen=True, kw_only=True)
class ScenePostures:
    """Postures to step through; N of them."""

    q: Array  # (N, J) rad or m
    label: str  # of the slider
    names: tuple[str, ...]  # (N,)
    words: tuple[tuple[tuple[str, str], ...], ...] = ()  # (N,) name and value pairs
    vectors: tuple[PostureVectors, ...] = ()
    needles: tuple[PostureNeedles, ...] = ()
