"""What else would explain a record as well: columns of every body and sensor. No name is asked that data cannot."""

from __future__ import annotations

import dual_quaternions as dq
import load_test_effects
import numpy as np
from body_compliance import _across
from dual_quaternions import Array
from effect_strength import Named, NoiseFreeRecord
from loading_rig import Rig, joint_columns

PAIRS = ((3, 4), (4, 5), (3, 5))


def load_rivals(scene: Rig, clean: NoiseFreeRecord) -> dict[Named, Array]:
    """Columns (N, D, K) of what a load test may be explained by; springs rigidly placed, first order."""
    robot, rigid = scene.nominal, scene.rigid
    load = clean.columns["wrench"].copy()
    if scene.lab.moments == "none":
        load[:, 3:] = 0.0
    motion, sight = joint_columns(robot, rigid)
    J = np.concatenate([motion, sight], axis=2)  # (N, 6 joints, 6)
    tip = dq.place(rigid["tcp"])
    torque = np.einsum("njc,nc->nj", J, load)
    out: dict[Named, list[Array]] = {}

    def add(effect: str, where: str, *columns: Array) -> None:
        out.setdefault((effect, where), []).extend(columns)

    for j in range(6):
        own = J[:, j] * torque[:, j, None]
        q = clean.columns["q"][:, j, None]
        add(
            "joint_pose_dependent_stiffness",
            f"joint:{j + 1}",
            *(f(n * q) * own for n in (1, 2) for f in (np.cos, np.sin)),
        )
    for a, b in PAIRS:
        add("joint_coupling", f"joint:{a + 1}-{b + 1}", J[:, a] * torque[:, b, None] + J[:, b] * torque[:, a, None])
    for i in range(6):
        R = dq.matrix(rigid[f"link{i}"])
        span = robot.ends()[i, :3]
        if np.linalg.norm(span) < 1e-6:
            continue
        end = dq.place(rigid[f"link{i}"]) + R @ span
        for C in beam_parts(span):
            add("link_compliance", f"link:{i + 1}", through(C, R, end, tip, load))
    zero = np.zeros_like(tip)
    for k in range(6):
        C = np.diag(np.eye(6)[k])
        add("base_compliance", "base", through(C, np.broadcast_to(np.eye(3), (len(tip), 3, 3)), zero, tip, load))
        add("tool_compliance", "tool", through(C, dq.matrix(rigid["tcp"]), tip, tip, load))
    for C in beam_parts(robot.tcp[:3]):
        add("tool_compliance", "tool", through(C, dq.matrix(rigid["mounted"]), tip, tip, load))
    # what a wrong load makes through the springs
    C = np.einsum("njd,njc,j->ndc", J, J, 1.0 / robot.stiffness)
    S = load_test_effects.axes_of(scene, scene.lab.wrench_frame)
    T = dq.matrix(rigid["tcp"])
    force = np.einsum("nji,nj->ni", S, load[:, :3])
    for k in range(3):
        e = np.eye(3)[k]
        for name, f in (
            ("force_sensor_offset", np.broadcast_to(e, force.shape)),
            ("force_sensor_gain", force * e),
            ("force_sensor_frame", np.cross(e, force)),
            ("load_geometry", np.cross(e, force)),
        ):
            add(name, "sensor:force", np.einsum("ndc,ncf,nf->nd", C[:, :, :3], S, f))
        add("load_geometry", "sensor:force", np.einsum("ndc,nc->nd", C[:, :, 3:], np.cross(T @ e, load[:, :3])))
        moved, turned = clean.columns["moved"], clean.columns["turned"]
        way = load_test_effects.axes_of(scene, scene.lab.displacement_frame) @ e
        frame = np.concatenate([np.cross(way, moved), np.cross(way, turned)], axis=1)
        add("displacement_frame", "sensor:displacement", frame)
    width = clean.y.shape[1]
    return {name: np.stack(columns, axis=2)[:, :width] for name, columns in out.items()}


def beam_parts(span: Array) -> list[Array]:
    """Unit compliances of a uniform beam: bending in two planes, torsion, stretch."""
    length = float(np.linalg.norm(span))
    B = np.kron(np.eye(2), _across(span))
    out = []
    for lateral, turn, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        C = np.zeros((6, 6))
        C[lateral, lateral], C[turn, turn] = length**3 / 3, length
        C[lateral, turn] = C[turn, lateral] = sign * length**2 / 2
        out.append(B @ C @ B.T)
    return [*out, B @ np.diag(np.eye(6)[3]) @ B.T, B @ np.diag(np.eye(6)[0]) @ B.T]


def through(C: Array, R: Array, at: Array, tip: Array, load: Array) -> Array:
    """(N, 6) motion of the tip by a body of compliance C in axes R, whose section stands at ``at``."""
    lever = tip - at
    moment = load[:, 3:] + np.cross(lever, load[:, :3])
    own = np.concatenate([np.einsum("nji,nj->ni", R, load[:, :3]), np.einsum("nji,nj->ni", R, moment)], axis=1)
    twist = own @ C.T
    v = np.einsum("nij,nj->ni", R, twist[:, :3])
    w = np.einsum("nij,nj->ni", R, twist[:, 3:])
    return np.concatenate([v + np.cross(w, lever), w], axis=1)
