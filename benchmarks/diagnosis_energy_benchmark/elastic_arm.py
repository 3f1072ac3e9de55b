"""The elastic arm: where does it come to rest? Least total energy with finite motions, gears and bodies giving way.

Every place that gives way has its own small finite motion in the chain of dual quaternions. With levers taken
where the arm stands, the potential's derivative by such a motion is the wrench across that place; rest is where
each element's law returns just the motion it has. Found by descent preconditioned with the elements' own stiffness.
No Jacobian, no C = J K⁻¹ Jᵀ: large motions, K_C and the sag's effect on the levers are all in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import dual_quaternions as dq
import numpy as np
from dual_quaternions import Array
from robot_models import Robot, frames_of

GRAVITY = 9.80665  # m/s²
Gear = Callable[[Array, "Script"], Array]  # torque (N,) N·m about the joint's axis -> angle (N,) rad
Body = Callable[[Array], Array]  # wrench (N, 6) in the place's own axes about it -> flexure (N, 6)


@dataclass(frozen=True)
class Script:
    """What happens to the arm, in order: every state of rest, recorded or not."""

    q: Array  # (N, 6) rad, encoders
    wrench: Array  # (N, 6) N, N·m in base axes at the TCP, what really acts
    time: Array  # (N,) s
    visit: Array  # (N,) int, arrivals at a pose
    cycle: Array  # (N,) int, load cycles
    session: Array  # (N,) int


@dataclass
class ElasticArm:
    """How the arm is built: springs and whatever else is concealed in it."""

    robot: Robot
    gears: list[tuple[int, Gear]] = field(default_factory=list)  # joint 0-5, extra angle
    cross: Array = field(default_factory=lambda: np.zeros((6, 6)))  # rad/(N·m) off the diagonal
    links: dict[int, Array] = field(default_factory=dict)  # 0-5 -> (6, 6) end compliance
    base: Body | None = None
    tool: Array | None = None  # (6, 6)
    angles: list[Callable[[Array], Array]] = field(default_factory=list)  # load-free joint errors (N, 6) of q (N, 6)
    twists: Array = field(default_factory=lambda: np.zeros((6, 6)))  # geometry: motion behind each joint origin
    tool_twist: Array = field(default_factory=lambda: np.zeros(6))
    parallel: list[tuple[int, Callable[[Array], Array]]] = field(default_factory=list)  # torque beside a gear, of q_j
    hung: list[tuple[float, Array]] = field(default_factory=list)  # further mass kg at (3,) in flange
    extra_wrench: Callable[[dict[str, Array]], tuple[Array, Array]] | None = None  # force, moment on the flange
    loose_links: dict[int, Body] = field(default_factory=dict)  # bodies of other laws


def chain(build: ElasticArm, q: Array, flex: dict[str, Array]) -> dict[str, Array]:
    """Frames (N, 8) with the flexures taken: ``joint0…5`` (before turning), ``link0…5``, ``end0…5``, flange, tcp."""
    robot = build.robot
    origins, flange, tool = frames_of(robot)
    T = np.zeros((len(q), 8))
    T[:, 0] = 1.0
    out: dict[str, Array] = {}
    if "base" in flex:
        T = dq.times(T, dq.twist(flex["base"]))
    q = q + sum((a(q) for a in build.angles), np.zeros_like(q))
    for i in range(6):
        T = dq.times(T, origins[i])
        if np.any(build.twists[i]):
            T = dq.times(T, dq.twist(build.twists[i]))
        turn = (q[:, i] + flex["joints"][:, i])[:, None] * robot.axes[i]
        T = dq.times(T, dq.of(dq.turned(turn), np.zeros(3)))
        out[f"link{i}"] = T
        if f"end{i}" in flex:
            span = robot.ends()[i, :3]
            bent = dq.times(dq.times(dq.shifted(span), dq.twist(flex[f"end{i}"])), dq.shifted(-span))
            T = dq.times(T, bent)
        out[f"bent{i}"] = T
    T = dq.times(T, flange)
    out["flange"] = T
    if np.any(build.tool_twist):
        T = dq.times(T, dq.twist(build.tool_twist))
    out["mounted"] = T
    tip = dq.times(T, dq.shifted(robot.tcp[:3]))
    if "tool" in flex:
        tip = dq.times(tip, dq.twist(flex["tool"]))
    out["tcp"] = dq.times(tip, dq.times(dq.shifted(-robot.tcp[:3]), tool))
    return out


def loads(build: ElasticArm, frames: dict[str, Array], wrench: Array) -> dict[str, Array]:
    """Torques at the joints (N, 6) and wrenches across the bodies, in their own axes, from weights and the load."""
    robot = build.robot
    down = np.array([0.0, 0.0, -GRAVITY])
    tip = dq.place(frames["tcp"])
    force, moment = wrench[:, :3].copy(), wrench[:, 3:] + np.cross(tip, wrench[:, :3])  # about the base's origin
    if build.extra_wrench is not None:
        f, m = build.extra_wrench(frames)
        force, moment = force + f, moment + m
    out: dict[str, Array] = {}
    R = dq.matrix(frames["mounted"])
    at_tip = np.concatenate([wrench[:, :3], wrench[:, 3:]], axis=1)
    out["tool"] = np.concatenate(
        [np.einsum("nji,nj->ni", R, at_tip[:, :3]), np.einsum("nji,nj->ni", R, at_tip[:, 3:])], axis=1
    )
    pieces = [(robot.tool_mass, robot.tool_centre), *build.hung]
    for mass, centre in pieces:
        at = dq.place(frames["flange"]) + np.einsum("nij,j->ni", dq.matrix(frames["flange"]), centre)
        force = force + mass * down
        moment = moment + np.cross(at, mass * down)
    torque = np.zeros((len(wrench), 6))
    for i in reversed(range(6)):
        R, p = dq.matrix(frames[f"link{i}"]), dq.place(frames[f"link{i}"])
        end = p + np.einsum("nij,j->ni", R, robot.ends()[i, :3])
        about = moment - np.cross(end, force)
        out[f"end{i}"] = np.concatenate([np.einsum("nji,nj->ni", R, force), np.einsum("nji,nj->ni", R, about)], axis=1)
        at = p + np.einsum("nij,j->ni", R, robot.centres[i])
        force = force + robot.masses[i] * down
        moment = moment + np.cross(at, robot.masses[i] * down)
        axis = np.einsum("nij,j->ni", R, robot.axes[i])
        torque[:, i] = np.sum(axis * (moment - np.cross(p, force)), axis=1)
    out["base"] = np.concatenate([force, moment], axis=1)
    out["joints"] = torque
    return out


def solve_rest_states(build: ElasticArm, script: Script, precision: float = 1e-10) -> tuple[dict[str, Array], Array]:
    """Frames at rest of every state and the joints' torques (N, 6). ``precision``: last step in rad or m."""
    n = len(script.q)
    flex: dict[str, Array] = {"joints": np.zeros((n, 6))}
    for i in [*build.links, *build.loose_links]:
        flex[f"end{i}"] = np.zeros((n, 6))
    if build.base is not None:
        flex["base"] = np.zeros((n, 6))
    if build.tool is not None:
        flex["tool"] = np.zeros((n, 6))
    step = np.inf
    for _ in range(30):
        frames = chain(build, script.q, flex)
        acting = loads(build, frames, script.wrench)
        new = compute_element_responses(build, script, acting, flex)
        step = max(float(np.max(np.abs(new[k] - flex[k]))) for k in flex)
        flex = new
        if step < precision:
            break
    else:
        raise RuntimeError(f"the arm does not come to rest: last step {step:.1e}; is a spring weaker than the load?")
    frames = chain(build, script.q, flex)
    return frames, acting["joints"]


def compute_element_responses(
    build: ElasticArm, script: Script, acting: dict[str, Array], flex: dict[str, Array]
) -> dict[str, Array]:
    """What every element's law makes of the load across it."""
    torque = acting["joints"].copy()
    for joint, law in build.parallel:
        torque[:, joint] += law(script.q[:, joint])
    acting["joints"] = torque
    angle = torque / build.robot.stiffness + torque @ build.cross.T
    for joint, gear in build.gears:
        angle[:, joint] += gear(torque[:, joint], script)
    new = {"joints": angle}
    for i, C in build.links.items():
        new[f"end{i}"] = acting[f"end{i}"] @ C.T
    for i, body in build.loose_links.items():
        new[f"end{i}"] = body(acting[f"end{i}"])
    if build.base is not None:
        new["base"] = build.base(acting["base"])
    if build.tool is not None:
        new["tool"] = acting["tool"] @ build.tool.T
    return new
