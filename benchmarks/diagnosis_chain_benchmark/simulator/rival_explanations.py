"""Which other explanations a load test cannot rule out: they reproduce what the refit leaves, to within the noise.

For every elastic or sensor effect of the vocabulary the displacements it can cause are columns; an explanation is
indistinguishable when, with its columns refitted too, a perfect test of the rest has no power (noncentrality below 2)
and nine tenths of what was to be explained are gone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.detectability import Base, jacobians
from simulator.measurement_setup import MeasurementSetup

Array = NDArray[np.float64]
POWERLESS = 2.0


def rivals(world: MeasurementSetup, base: Base, left: Array, encoder: Array, wrench: Array) -> list[tuple[str, str]]:
    """Effects and locations that explain ``left`` (N, C) as well as the truth does.

    Args:
        world: for nominal geometry and true stiffness.
        base: columns of the joint springs.
        left: noise-free contribution of the concealed effect.
        encoder: (N, 6) rad.
        wrench: (N, 6) recorded, base axes.
    """
    _, before = base.left(left)
    if before < 2.0 * POWERLESS:
        return []
    out = []
    for name, columns in candidates(world, encoder, wrench).items():
        _, after = base.left(left, columns[:, : left.shape[1]])
        if after < min(POWERLESS, 0.1 * before):
            out.append(name)
    return out


def candidates(world: MeasurementSetup, encoder: Array, wrench: Array) -> dict[tuple[str, str], Array]:
    """Columns (N, 6, P) by effect and location."""
    J, tip, R = jacobians(world, encoder)
    tau = np.einsum("nci,nc->ni", J, wrench)
    soft = 1.0 / world.nominal.stiffness
    f = wrench[:, :3]
    out: dict[tuple[str, str], Array] = {}
    for i in range(6):
        spring = J[:, :, i] * tau[:, i, None]
        angle = encoder[:, i, None]
        waves = [np.cos(angle), np.sin(angle)] + ([np.cos(2 * angle), np.sin(2 * angle)] if i == 1 else [])
        columns = np.stack([spring * w for w in waves], axis=2)
        out["joint_pose_dependent_stiffness", f"joint:{i + 1}"] = columns
        if i == 1:
            out["gravity_compensator", "joint:2"] = columns
    for i, j in ((3, 4), (4, 5), (3, 5), (1, 2)):
        both = J[:, :, i] * tau[:, j, None] + J[:, :, j] * tau[:, i, None]
        out["joint_coupling", f"joint:{i + 1}-{j + 1}"] = both[:, :, None]
    for body in range(7):
        turn, centre = _body(world, encoder, body)
        if body == 0:
            out["base_compliance", "base"] = _spring(turn, tip - centre, wrench)
            continue
        line = world.nominal.joints[body].t if body < 6 else world.nominal.flange.t
        out["link_compliance", f"link:{body}"] = _spring(turn @ along(line), tip - centre, wrench)
    turn, centre = _body(world, encoder, 7)
    out["tool_compliance", "tool"] = _spring(turn @ along(world.nominal.tcp.t), tip - centre, wrench)

    def through(w: Array) -> Array:
        return np.asarray(np.einsum("nci,i,ndi,nd->nc", J, soft, J, w))

    axes = R if world.wrench_frame == "tool" else np.broadcast_to(np.eye(3), R.shape)
    zero = np.zeros_like(f)
    offset, gain, frame, lever, shift = [], [], [], [], []
    d = through(wrench)
    for k in range(3):
        e = axes[:, :, k]
        offset.append(through(np.concatenate([e, zero], axis=1)))
        gain.append(through(np.concatenate([e * np.einsum("nc,nc->n", e, f)[:, None], zero], axis=1)))
        frame.append(through(np.concatenate([np.cross(e, f), np.cross(e, wrench[:, 3:])], axis=1)))
        lever.append(through(np.concatenate([zero, np.cross(R[:, :, k], f)], axis=1)))
        fixed = np.eye(3)[k]
        shift.append(np.concatenate([np.cross(fixed, d[:, :3]), np.cross(fixed, d[:, 3:])], axis=1))
    out["force_sensor_offset", "sensor:force"] = np.stack(offset, axis=2)
    out["force_sensor_gain", "sensor:force"] = np.stack(gain, axis=2)
    out["force_sensor_frame", "sensor:force"] = np.stack(frame, axis=2)
    out["load_geometry", "sensor:force"] = np.stack(lever, axis=2)
    out["displacement_frame", "sensor:displacement"] = np.stack(shift, axis=2)
    return out


def _body(world: MeasurementSetup, encoder: Array, body: int) -> tuple[Array, Array]:
    """Rotation (N, 3, 3) and origin (N, 3) of a body; 7 is the flange."""
    from simulator.arm_model import arm_of
    from simulator.static_equilibrium import Statics

    statics = Statics(arm_of(world.nominal))
    x = np.zeros((len(encoder), len(statics.model.chain)))
    x[:, statics.model.joint] = encoder
    posture = statics.model.chain.forward(x)
    if body == 7:
        frame, place = statics.model.flange
        return posture.R[:, frame] @ place.R, posture.point(frame, place.t)
    frame = statics.model.frames[body]
    return posture.R[:, frame], posture.p[:, frame]


def along(line: Array) -> Array:
    """(3, 3) rotation whose x lies along ``line``."""
    x = line / np.linalg.norm(line)
    y = np.cross(np.eye(3)[int(np.argmin(np.abs(x)))], x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _spring(turn: Array, r: Array, wrench: Array) -> Array:
    """(N, 6, 8): gives way along and about each axis at its origin, and as a beam along x (shift with turn)."""
    f, m = wrench[:, :3], wrench[:, 3:] + np.cross(r, wrench[:, :3])
    load = np.concatenate([np.einsum("nck,nc->nk", turn, f), np.einsum("nck,nc->nk", turn, m)], axis=1)
    columns = []
    for pairs in ([(k, k)] for k in range(6)):
        columns.append(_moved(turn, r, load, pairs))
    columns.append(_moved(turn, r, load, [(1, 5), (5, 1)]))
    columns.append(_moved(turn, r, load, [(2, 4), (4, 2)]))
    return np.stack(columns, axis=2)


def _moved(turn: Array, r: Array, load: Array, pairs: list[tuple[int, int]]) -> Array:
    """(N, 6) at the tip: local motion i per local load j, for each pair."""
    local = np.zeros_like(load)
    for i, j in pairs:
        local[:, i] += load[:, j]
    shift = np.einsum("nck,nk->nc", turn, local[:, :3])
    spin = np.einsum("nck,nk->nc", turn, local[:, 3:])
    return np.concatenate([shift + np.cross(spin, r), spin], axis=1)
