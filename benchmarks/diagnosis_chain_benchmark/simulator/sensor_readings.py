"""What ends up in the file: sensors with gain, offset, frame and noise, in clusters; then the clerk's mistakes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.measurement_design import LoadTestSequence, PoseSequence
from simulator.measurement_setup import MeasurementSetup, Noise
from simulator.static_simulation import Deflections, Poses

Array = NDArray[np.float64]
Columns = dict[str, Array | list[str]]
FORCE, MOMENT = ("fx_N", "fy_N", "fz_N"), ("mx_Nm", "my_Nm", "mz_Nm")
SHIFT, TURN = ("dx_mm", "dy_mm", "dz_mm"), ("rx_mrad", "ry_mrad", "rz_mrad")


@dataclass(frozen=True)
class Table:
    """A data file and what only the simulator knows about it."""

    columns: Columns
    clean: Array  # (N, 3 or 6) m, rad: the measured channel without noise
    cluster: NDArray[np.int64]  # (N,) readings that share an error
    noise: Array  # (N, 3) m, what noise added; outliers in it
    outliers: NDArray[np.int64]  # 1-based rows
    recorded_wrench: Array  # (N, 6) base axes, noise-free as the record has it
    wrench_noise: Array  # (N, 6) base axes
    row: tuple[NDArray[np.int64], NDArray[np.int64]]  # sequence and state of each reading


def recorded_wrench(world: MeasurementSetup, wrench: Array, rotation: Array) -> Array:
    """What the record says (N, 6) in base axes when ``wrench`` (N, 6) acts; ``rotation`` (N, 3, 3) of the tip."""
    f, m = wrench[:, :3], wrench[:, 3:]
    fault = world.faults
    tool = world.wrench_frame == "tool"
    if tool:
        f, m = np.einsum("nji,nj->ni", rotation, f), np.einsum("nji,nj->ni", rotation, m)
    f, m = f @ fault.force_frame, m @ fault.force_frame
    f = fault.force_gain * f
    f = f + fault.force_bend * f * np.abs(f)
    f, m = f + fault.force_offset[:3], m + fault.force_offset[3:]
    if tool:
        f, m = np.einsum("nij,nj->ni", rotation, f), np.einsum("nij,nj->ni", rotation, m)
    return np.concatenate([f, m], axis=1)


def acting_wrench(world: MeasurementSetup, programme_wrench: Array) -> Array:
    """What really pulls when the load was set up along ``programme_wrench`` (…, 6): a pulley stands askew."""
    if world.faults.pulley is None:
        return programme_wrench
    f = programme_wrench[..., :3]
    size = np.linalg.norm(f, axis=-1, keepdims=True)
    e = np.divide(f, size, out=np.zeros_like(f), where=size > 0) + world.faults.pulley
    real = size * e / np.linalg.norm(e, axis=-1, keepdims=True)
    return np.concatenate([real, programme_wrench[..., 3:]], axis=-1)


def _white(noise: Noise, shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> Array:
    if noise.tails is None:
        return np.asarray(sigma * rng.normal(size=shape))
    return np.asarray(sigma * rng.standard_t(noise.tails, size=shape))


def deflection_table(
    world: MeasurementSetup, programme: LoadTestSequence, run: Deflections, rng: np.random.Generator
) -> Table:
    """Readings of load cycles."""
    noise, (B, S) = world.noise, programme.hold.shape
    keep = np.broadcast_to(~programme.zero, (B, S)).copy()
    if noise.missing > 0:
        keep &= rng.random((B, S)) >= noise.missing
    b, s = np.nonzero(keep)
    cycles = int(programme.cycle.max()) + 1
    cluster = b * cycles + programme.cycle[s]
    wide = 6 if world.six else 3
    frame = world.faults.displacement_frame
    true = run.displacement[b, s]
    clean = np.concatenate([true[:, :3] @ frame, true[:, 3:] @ frame], axis=1)[:, :wide]
    added = _white(noise, (len(b), 3), noise.reading, rng)
    added += noise.cycle * rng.normal(size=(B * cycles, 3))[cluster]
    added += noise.session * rng.normal(size=(B, 3))[b]
    # the tracker creeps while a cycle lasts
    along = (programme.time[b, s] - programme.time[b, 0]) / np.maximum(np.ptp(programme.time, axis=1)[b], 1.0)
    added += 0.3 * noise.cycle * along[:, None] * rng.normal(size=(B, 3))[b]
    d = clean[:, :3] + added
    turn = clean[:, 3:] + _white(noise, (len(b), wide - 3), noise.turn_reading, rng)
    turn = turn + noise.turn_cycle * rng.normal(size=(B * cycles, wide - 3))[cluster]

    # the record holds what the pulley was set up for, not where it stands
    rotation = run.rotation[b, s]
    stated = recorded_wrench(world, programme.wrench[b, s], rotation)
    gain_axis = 1.0 + noise.gain_session * rng.normal(size=int(programme.session.max()) + 1)[programme.session[b]]
    gain_axis = gain_axis * (1.0 + noise.gain_cycle * rng.normal(size=B * cycles)[cluster])
    w = stated * gain_axis[:, None]
    w[:, :3] += noise.force * rng.normal(size=(len(b), 3))
    has_moment = bool(np.any(programme.wrench[..., 3:])) or bool(np.any(world.faults.force_offset[3:]))
    if has_moment:
        w[:, 3:] += noise.moment * rng.normal(size=(len(b), 3))
    wrench_noise = w - stated
    if world.wrench_frame == "tool":
        w = np.concatenate(
            [np.einsum("nji,nj->ni", rotation, w[:, :3]), np.einsum("nji,nj->ni", rotation, w[:, 3:])], axis=1
        )
    rows = _outliers(d, noise.outliers, 2.5e-4, rng)
    added = d - clean[:, :3]
    columns: Columns = {
        "pose": programme.pose[b].astype(float),
        "cycle": (programme.session[b] * cycles + programme.cycle[s]) * 1.0,
        "session": programme.session[b] * 1.0,
        "time_s": np.round(programme.time[b, s], 1),
        "branch": ["load" if v > 0 else "unload" for v in programme.branch[s]],
    }
    _joints(columns, "q{}_deg", programme.encoder[b] + 3e-6 * rng.normal(size=(len(b), 6)))
    for i, name in enumerate(FORCE):
        columns[name] = np.round(w[:, i], 2)
    if has_moment:
        for i, name in enumerate(MOMENT):
            columns[name] = np.round(w[:, 3 + i], 3)
    step = noise.quantum
    for i, name in enumerate(SHIFT):
        columns[name] = np.round(d[:, i] / step) * step * 1e3
    for i, name in enumerate(TURN[: wide - 3]):
        columns[name] = np.round(turn[:, i] * 1e3, 4)
    rows = _clerk(world, columns, SHIFT, rows, rng)
    return Table(columns, clean, cluster, added, rows, stated, wrench_noise, (b, s))


def pose_table(
    world: MeasurementSetup, visits: PoseSequence, run: Poses, still: Poses, rng: np.random.Generator, *, fit: bool
) -> Table:
    """Readings of absolute poses; ``still`` is the run without errors of return."""
    noise, (B, S, _) = world.noise, visits.wrench.shape
    b, s = (a.reshape(-1) for a in np.indices((B, S)))
    N = len(b)
    offset, turn = np.zeros(3), np.eye(3)
    target = np.zeros(3)
    if fit:
        offset, turn = 1.5e-3 * rng.normal(size=3), turned_small(4e-4 * rng.normal(size=3))
        target = 4e-4 * rng.normal(size=3)
    p, p0 = run.position[b, s], still.position[b, s]
    R = run.rotation[b, s]
    added = p - p0  # what the arm's return did
    kick = np.zeros((N, 3))
    when = visits.time[b] / visits.time.max()
    for share, twist in world.faults.kicks:
        late = when > share
        kick[late] += twist[:3] + np.cross(twist[3:], p[late])
    if world.faults.wander > 0:
        walk = np.cumsum(rng.normal(size=(B, 3)), axis=0)
        walk -= walk.mean(axis=0)
        kick += world.faults.wander * (walk / np.sqrt(np.mean(walk**2)))[np.argsort(np.argsort(visits.time))[b]]
    extra = _white(noise, (N, 3), noise.reading, rng) + 0.5 * noise.cycle * rng.normal(size=(B, 3))[b]
    if world.kind == "absolute" and noise.session > 0:
        extra += noise.session * rng.normal(size=(int(visits.session.max()) + 1, 3))[visits.session[b]]
    at = p + np.einsum("nij,j->ni", R, target)
    measured = at @ turn.T + offset + kick + extra
    added = added + extra
    before = measured.copy()
    rows = _outliers(measured, noise.outliers, 4e-4, rng)
    added = added + measured - before
    columns: Columns = {
        "pose": visits.pose[b] * 1.0,
        "cycle": visits.cycle[b] * 1.0,
        "session": visits.session[b] * 1.0,
        "time_s": np.round(visits.time[b] + 8.0 * s, 1),
    }
    if world.heat is not None or world.noise.tails is None:
        rise, hall = world.heat.temperatures(visits.time) if world.heat is not None else _mild(visits.time)
        columns["temperature_C"] = np.round((hall + 0.9 * rise)[b] + 0.15 * rng.normal(size=N), 2)
    _joints(columns, "q{}_deg", visits.encoder[b] + 3e-6 * rng.normal(size=(N, 6)))
    wrench = visits.wrench[b, s]
    if np.any(wrench):
        for i, name in enumerate(FORCE):
            columns[name] = np.round(wrench[:, i] + 0.2 * rng.normal(size=N), 2)
    step = noise.quantum
    for i, name in enumerate(("x_mm", "y_mm", "z_mm")):
        columns[name] = np.round(measured[:, i] / step) * step * 1e3
    if world.six:
        Rm = turn @ R @ _small(noise.turn_reading * rng.normal(size=(N, 3)))
        for name, value in zip(("qw", "qx", "qy", "qz"), _quaternion(Rm).T, strict=True):
            columns[name] = value
    rows = _clerk(world, columns, ("x_mm", "y_mm", "z_mm"), rows, rng)
    clean = p0 + kick if world.faults.wander == 0 else p0
    return Table(columns, clean, b, added, rows, wrench, 0.0 * wrench, (b, s))


def _mild(time: Array) -> tuple[Array, Array]:
    """A hall that warms a little while the arm does not."""
    return np.zeros_like(time), 21.0 + 0.8 * np.sin(2 * np.pi * time / 86400.0)


def turned_small(v: Array) -> Array:
    return np.asarray(_small(v[None])[0])


def _small(v: Array) -> Array:
    """Rotations (N, 3, 3) of small rotation vectors."""
    angle = np.maximum(np.linalg.norm(v, axis=1), 1e-300)
    K = np.zeros((len(v), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = v.T
    K -= np.swapaxes(K, 1, 2)
    s, c = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + s[:, None, None] * K + c[:, None, None] * (K @ K))


def _quaternion(R: Array) -> Array:
    from scipy.spatial.transform import Rotation

    x = Rotation.from_matrix(R).as_quat()
    return np.asarray(np.roll(x, 1, axis=1) * np.where(x[:, 3:] < 0, -1.0, 1.0))


def _joints(columns: Columns, name: str, q: Array) -> None:
    for i in range(6):
        columns[name.format(i + 1)] = np.round(np.degrees(q[:, i]), 6)


def _outliers(d: Array, share: float, size: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """Spoil some rows in place: a target that moved, a reflection, a reading in the wrong line."""
    hit = np.flatnonzero(rng.random(len(d)) < share)
    for n in hit:
        kind = rng.integers(3)
        if kind == 0:
            d[n, rng.integers(3)] += rng.choice([-1, 1]) * size * np.exp(rng.uniform(0, 2.0))
        elif kind == 1:
            d[n] += size * rng.standard_normal(3) * np.exp(rng.uniform(0.3, 2.0))
        else:
            d[n] = d[rng.integers(len(d))] if size < 3e-4 else d[n] + 3 * size * rng.standard_normal(3)
    return np.asarray(hit + 1)


def _clerk(
    world: MeasurementSetup, columns: Columns, names: tuple[str, ...], rows: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Slipped decimals, rows copied twice, columns in another unit."""
    n = len(columns["pose"])
    fault = world.faults
    spoilt = rng.choice(np.arange(1, n), fault.slipped + fault.repeated, replace=False)
    for row in spoilt[: fault.slipped]:
        # the largest coordinate, so that the slip is a slip
        values = [abs(float(columns[c][row])) for c in names]  # type: ignore[arg-type]
        name = names[int(np.argmax(values))]
        columns[name][row] *= 10.0 if rng.random() < 0.7 else 0.1  # type: ignore[index, operator]
    for row in spoilt[fault.slipped :]:
        for name in names:
            columns[name][row] = columns[name][row - 1]  # type: ignore[index]
    for first, factor in fault.units.items():
        for name in _group(first):
            if name in columns:
                columns[name] = np.asarray(columns[name], float) * factor
    return np.unique(np.concatenate([rows, spoilt + 1]))


def _group(first: str) -> tuple[str, ...]:
    groups = (FORCE, MOMENT, SHIFT, TURN, ("x_mm", "y_mm", "z_mm"), tuple(f"q{i}_deg" for i in range(1, 7)))
    return next(g for g in groups if g[0] == first)
