"""Arm, random drivable paths and their programs, for tests of posts and readers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.robot_program import LIN, PTP, JointMap, RobotController, RobotProgram
from machopt.data_types.toolpath import MoveKind, ToolpathEvent
from machopt.kinematics.controller_posture import compute_posture_sides
from machopt.kinematics.robot import Robot

# dimensions of a KR 210 as in URDFs: axis 1 downwards, arm stretched forward at zero
ARM = Robot(
    joints=tuple(f"a{i}" for i in range(1, 7)),
    axis=np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], float),
    point=np.array(
        [[0, 0, 0.675], [0.35, 0, 0.675], [1.5, 0, 0.675], [2.5, 0, 0.716], [2.5, 0, 0.716], [2.715, 0, 0.716]]
    ),
    T_base_flange_zero=np.array([[0, 0, 1, 2.715], [0, 1, 0, 0], [-1, 0, 0, 0.716], [0, 0, 0, 1.0]]),
    lower=np.radians([-185, -140, -120, -350, -125, -350]),
    upper=np.radians([185, -5, 155, 350, 125, 350]),
)
TOOL = np.array([[0.6, 0, 0.8, 0.18], [0, 1, 0, -0.02], [-0.8, 0, 0.6, 0.43], [0, 0, 0, 1]])
WORKPIECE = np.array([[0.8, -0.6, 0, 1.5], [0.6, 0.8, 0, 0.1], [0, 0, 1, 0.6], [0, 0, 0, 1]])
C30, S30 = np.cos(np.pi / 6), 0.5
# rotated, which also rotates the zero of axis 1
ROOT = np.array([[C30, -S30, 0, 0.01], [S30, C30, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1.0]])
MOUNT = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.01], [0, 0, 0, 1.0]])

# FANUC convention: the vertical upper arm is 0, axis 3 is the angle of the forearm to the horizontal
MAPPED = RobotController(
    joint_map=JointMap(
        np.array([-1.0, 1, 1, -1, 1, -1]),
        np.array([-30.0, 90, -90, 0, 0, 180]),
        np.array([[0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0], *[[0.0] * 6] * 3]),
    ),
    T_base_root=ROOT,
    T_flange_mount=MOUNT,
    tool_number=3,
    base_number=2,
    nonflip_j5="negative",
)
PLAIN = RobotController(nonflip_j5="positive")

EVENTS = (
    ("spindle", "SPINDL/9000,RPM,CLW", 9000.0),
    ("coolant", "COOLNT/ON", np.nan),
    ("dwell", "DELAY/1.5", 1.5),
    ("tool", "LOADTL/12", 12.0),
    ("coolant", "COOLNT/OFF", np.nan),
    ("comment", "MESSAGE to all", np.nan),
)


@dataclass(frozen=True)
class Recipe:
    """Parameters of a random program; hypothesis draws these numbers."""

    seed: int
    moves: int = 12
    blend: float = 0.0
    slowest: float = 2e-4  # m/s
    feeds: int = 3
    operations: tuple[str, ...] = ("Bohren 6", "slot")
    events: int = 3


def program(recipe: Recipe, controller: RobotController = PLAIN, robot: Robot = ARM) -> RobotProgram:
    """Return a path within the joint limits: short steps with some rapid moves between them."""
    rng = np.random.default_rng(recipe.seed)
    n = recipe.moves
    kind = np.full(n, LIN, np.int8)
    kind[0] = PTP
    kind[1:][rng.random(n - 1) < 0.15] = PTP
    span = robot.upper - robot.lower
    q = np.empty((n, 6))
    q[0] = rng.uniform(robot.lower, robot.upper)
    for k in range(1, n):
        step = 0.3 if kind[k] == PTP else 0.01
        q[k] = np.clip(q[k - 1] + rng.uniform(-step, step, 6) * span, robot.lower, robot.upper)
    feeds = np.exp(rng.uniform(np.log(recipe.slowest), 0.0, recipe.feeds))
    feed = np.where(kind == LIN, feeds[np.arange(n) * recipe.feeds // n], np.nan)
    cutting = (kind == LIN) & (rng.random(n) < 0.8)
    move = np.where(kind == PTP, MoveKind.RAPID, np.where(cutting, MoveKind.CUT, rng.choice([2, 3, 4], n))).astype(
        np.int8
    )
    if not cutting.any() and (kind == LIN).any():
        first = int(np.argmax(kind == LIN))
        cutting[first], move[first] = True, MoveKind.CUT
    operation = np.minimum(np.arange(n) * len(recipe.operations) // n, len(recipe.operations) - 1).astype(np.int32)
    at = np.sort(rng.integers(0, n, recipe.events))
    chosen = rng.integers(0, len(EVENTS), recipe.events)
    events = tuple(ToolpathEvent(int(k), *EVENTS[c]) for k, c in zip(at, chosen, strict=True))  # type: ignore[arg-type]
    T = np.linalg.inv(WORKPIECE) @ robot.compute_fk(q, TOOL)
    standing = find_controller_posture(robot, q, controller)
    return RobotProgram(
        kind=kind,
        q=q,
        T_workpiece_tcp=T,
        feed=feed,
        cutting=cutting,
        move=move,
        operation=operation,
        operations=recipe.operations,
        T_flange_tcp=TOOL,
        T_base_workpiece=WORKPIECE,
        events=events,
        blend=recipe.blend,
        source="cell; a.apt",
        wrist_behind=None if standing is None else standing[0],
        elbow_up=None if standing is None else standing[1],
        time=0.012 * np.arange(n),
        joint_names=robot.joints,
        tool_mass=45.0,
        tool_com=np.array([0.01, 0, 0.15]),
    )


def find_controller_posture(
    robot: Robot, q: np.ndarray, controller: RobotController
) -> tuple[np.ndarray, np.ndarray] | None:
    root = np.eye(4) if controller.T_base_root is None else controller.T_base_root
    m = controller.joint_map
    return compute_posture_sides(robot, q, root[:3, 0], 0.0 if m is None else np.radians(-m.offset_deg[0] * m.sign[0]))
