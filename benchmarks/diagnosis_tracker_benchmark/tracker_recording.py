"""What a tracker writes of an arm, as a cell folder and a recording folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from dh_arms import Arm, Array, about, placed, turned

STATION = np.array([2.8, -2.0, 1.1])  # m, where the tracker stands
WIDE_DEG = np.array([110, 35, 40, 120, 60, 150])  # to either side of home
PAUSE_S, DAY_S = 60.0, 7e4


@dataclass(frozen=True, kw_only=True)
class Habit:
    """How a lab measures."""

    poses: int = 40
    sessions: int = 2
    fit: bool = True  # the tracker's own frame and the reflector's place are not known
    hall: bool = False  # it stands anywhere; else within a milliradian of base_link
    six: bool = False  # quaternions too
    stated: bool = True
    reflectors: int = 0
    tilt: int | None = None  # link that carries an inclinometer, 0 the base
    noise_mm: tuple[float, float, float] = (0.008, 0.006, 0.015)  # along the beam, per m across it, the arm's return
    drift: float = 0.0  # of a day, m a metre and as much upwards
    moved_mm: float = 0.0  # the tracker was put down again before the last session
    fault: str = ""


@dataclass(frozen=True)
class Seen:
    """Readings before a clerk touches them."""

    q: Array  # (N, 6) rad
    p: Array  # (N, 3) m
    R: Array  # (N, 3, 3)
    tilt: Array | None  # (N, 2) mrad
    pose: Array
    session: Array
    target: Array
    visit: Array
    time_s: Array
    places: Array  # (T, 3) m, nominal, of reflectors


def seen(arm: Arm, habit: Habit, rng: np.random.Generator) -> Seen:
    """Visit every pose once a session, in an order of its own, and read every reflector."""
    drawn = arm.home + rng.uniform(-1, 1, (habit.poses, 6)) * np.radians(WIDE_DEG)
    drawn = np.radians(np.round(np.degrees(drawn), 4))
    order = np.concatenate([rng.permutation(habit.poses) for _ in range(habit.sessions)])
    session = np.repeat(np.arange(habit.sessions), habit.poses)
    n, each = len(order), max(habit.reflectors, 1)
    q = drawn[order]
    links, flange = arm.stands(q + np.radians(rng.normal(0, 0.0005, (n, 6))))
    time = np.arange(n) * PAUSE_S + session * DAY_S
    if habit.reflectors:
        angle = 2 * np.pi * np.arange(each) / each + 0.3
        places = np.stack([0.12 * np.cos(angle), 0.1 * np.sin(angle), 0.03 + 0.02 * np.arange(each)], axis=1)
        there = places + rng.normal(0, 2e-4, places.shape)
    else:
        places = arm.tool[None]
        there = places + (rng.normal(0, 3e-4, (1, 3)) if habit.fit else 0.0)
    row, target = np.repeat(np.arange(n), each), np.tile(np.arange(each), n)
    p = flange[row, :3, 3] + np.einsum("nij,nj->ni", flange[row, :3, :3], there[target])
    p += rng.normal(0, 1e-3 * habit.noise_mm[2], (n, 3))[row]
    if habit.drift:  # the pedestal and the arm warm up anew each day, in forty minutes
        warm = (habit.drift * (1 - np.exp(-(time - DAY_S * session) / 2500.0)))[row, None]
        p += warm * np.array([0.3, -0.2, 1.0]) + 0.6 * warm * p
    p = _through_the_beam(p, habit, rng)
    R = flange[row, :3, :3] @ turned(rng.normal(0, 4e-5, (len(p), 3)))
    if habit.moved_mm:
        last, size = session[row] == habit.sessions - 1, 1e-3 * habit.moved_mm
        twist = turned(size * np.array([0.2, 0.3, -0.5]))
        p[last], R[last] = p[last] @ twist.T + size * np.array([0.5, -0.7, 0.4]), twist @ R[last]
    if habit.fit:
        turn = turned(1.2 * rng.normal(size=3) if habit.hall else rng.normal(0, 8e-4, 3))
        p = p @ turn.T + (rng.uniform(-3, 3, 3) if habit.hall else rng.normal(0, 2e-3, 3))
        R = turn @ R
    tilt = None if habit.tilt is None else _tilted(arm, habit.tilt, q, links, rng)[row]
    return Seen(q[row], p, R, tilt, order[row], session[row], target, row, time[row], places)


def _through_the_beam(p: Array, habit: Habit, rng: np.random.Generator) -> Array:
    away = p - STATION
    far = np.linalg.norm(away, axis=1, keepdims=True)
    beam, error = away / far, rng.normal(size=p.shape)
    across = error - (error * beam).sum(axis=1, keepdims=True) * beam
    along = rng.normal(size=(len(p), 1)) * beam
    return np.asarray(p + 1e-3 * (habit.noise_mm[0] * along + habit.noise_mm[1] * far * across))


def _tilted(arm: Arm, link: int, q: Array, links: Array, rng: np.random.Generator) -> Array:
    """(N, 2) mrad that an inclinometer reads beyond the encoders; its own zero is anywhere."""
    if link == 0:
        turn = turned(arm.base_turn(q))
    else:
        plain = type(arm)(arm.name, type(arm.concealed)()).frames(q)[0]
        turn = links[:, link - 1, :3, :3] @ np.swapaxes(plain[:, link - 1, :3, :3], 1, 2)
    read = 500 * np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0]], axis=1)
    return np.asarray(read + rng.normal(0, 0.01, read.shape) + np.array([0.8, -0.4]))


def spoilt(s: Seen, fault: str, sessions: int) -> tuple[Array, Array, Array | None]:
    """Degrees (N, 6), mm (N, 3) and tilt (N, 2) mrad as a clerk with a bad day writes them down."""
    q, mm, tilt = np.degrees(s.q), 1e3 * s.p, s.tilt
    last = s.session == sessions - 1
    if fault == "radians last":
        q[last] = np.radians(q[last])
    elif fault == "turns":
        q = q / 360
    elif fault == "gon last":
        q[last] /= 0.9
    elif fault == "metres last":
        mm[last] /= 1e3
    elif fault == "inches last":
        mm[last] /= 25.4
    elif fault == "mirrored":
        mm = mm * np.array([1, -1, 1])
    elif fault == "x and y last":
        mm[last] = mm[last][:, [1, 0, 2]]
    elif fault == "sign of 5":
        q[:, 4] *= -1
    elif fault == "zero of 3 last":
        q[last, 2] += 0.15
    elif fault == "4 for 5":
        q[:, [3, 4]] = q[:, [4, 3]]
    elif fault == "tilt exchanged" and tilt is not None:
        tilt = tilt[:, ::-1]
    elif fault == "tilt in degrees" and tilt is not None:
        tilt = np.degrees(1e-3 * tilt)
    return q, mm, tilt


def write(room: Path, arm: Arm, s: Seen, habit: Habit, nominal_tool: Array) -> None:
    """``room/cell`` and ``room/rec``."""
    cell, record = room / "cell", room / "rec"
    cell.mkdir(parents=True)
    record.mkdir()
    (cell / "robot.urdf").write_text(_urdf(arm), encoding="utf-8")
    each = "[100, 100, 100, 100, 100, 100]"
    (cell / "cell.yaml").write_text(
        f"""machopt_cell: 1
name: yard {arm.name}
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  arm_joints: [j1, j2, j3, j4, j5, j6]
  home_deg: {np.degrees(arm.home).round(3).tolist()}
  limits: {{velocity_deg_s: {each}, acceleration_deg_s2: {each}, jerk_deg_s3: {each}}}
tool:
  tcp: {{xyz_mm: {(1e3 * nominal_tool).tolist()}, rpy_deg: [0, 0, 0]}}
  mass_kg: {arm.design.tool_mass}
  com_mm: {(1e3 * arm.tool_centre).tolist()}
workpiece: {{link: world, pose: {{xyz_mm: [1500, 0, 500], rpy_deg: [0, 0, 0]}}}}
stiffness: stiffness.yaml
""",
        encoding="utf-8",
    )
    (cell / "stiffness.yaml").write_text(
        f"machopt_stiffness: 1\njoints_Nm_per_rad: {arm.spring.tolist()}\n", encoding="utf-8"
    )
    q, mm, tilt = spoilt(s, habit.fault, habit.sessions)
    columns = {"pose": s.pose + 1, "cycle": s.visit + 1, "session": s.session + 1}
    if habit.reflectors:
        columns["target"] = s.target + 1
    columns["time_s"] = np.round(s.time_s, 1)
    columns |= {f"q{j + 1}_deg": np.round(q[:, j], 6) for j in range(6)}
    columns |= {f"{a}_mm": np.round(mm[:, k], 5) for k, a in enumerate("xyz")}
    if habit.six:
        quat = np.array([_quaternion(R) for R in s.R])
        columns |= {name: np.round(quat[:, k], 9) for k, name in enumerate(("qw", "qx", "qy", "qz"))}
    if tilt is not None:
        columns |= {f"tilt_{a}_mrad": np.round(tilt[:, k], 5) for k, a in enumerate("xy")}
    lines = [",".join(columns), *(",".join(repr(v.item()) for v in row) for row in zip(*columns.values(), strict=True))]
    (record / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (record / "recording.yaml").write_text(_header(s, habit), encoding="utf-8")


def _header(s: Seen, habit: Habit) -> str:
    fit = "fit" if habit.fit else "fixed"
    out = f"machopt_recording: 1\nkind: absolute\ndata: data.csv\nregistration: {fit}\n"
    if habit.tilt is not None:
        out += f"tilt_link: {'base_link' if habit.tilt == 0 else f'l{habit.tilt}'}\n"
    if habit.reflectors:
        at = ", ".join(f"{k + 1}: {np.round(1e3 * v, 2).tolist()}" for k, v in enumerate(s.places))
        out += f"targets_mm: {{{at}}}\n"
    if habit.stated:
        stated = {"displacement_mm": round(float(np.hypot(habit.noise_mm[2], 3.3 * habit.noise_mm[1])), 3)}
        stated |= {"rotation_mrad": 0.04} if habit.six else {}
        stated |= {"tilt_mrad": 0.01} if habit.tilt is not None else {}
        stated |= {"target_mm": 0.3} if habit.reflectors else {}
        out += "standard_uncertainty: {" + ", ".join(f"{k}: {v}" for k, v in stated.items()) + "}\n"
    return out


def _quaternion(R: Array) -> Array:
    """w, x, y, z by the largest eigenvector (Bar-Itzhack 2000)."""
    K = np.zeros((4, 4))
    K[0, 0] = np.trace(R)
    K[0, 1:] = K[1:, 0] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    v = np.linalg.eigh(K)[1][:, -1]
    return np.asarray(v if v[0] >= 0 else -v)


def _urdf(arm: Arm) -> str:
    """The arm of the drawing."""
    out = ['<robot name="yard">', '<link name="base_link"/>']
    T, parent = np.eye(4), "base_link"
    for i in range(6):
        out.append(
            f'<joint name="j{i + 1}" type="revolute"><parent link="{parent}"/><child link="l{i + 1}"/>'
            f'{_origin(T @ placed(about(2, arm.offset[i])))}<axis xyz="0 0 1"/>'
            '<limit lower="-3.1" upper="3.1" velocity="2" effort="9999"/></joint>'
        )
        x, y, z = arm.centre[i]
        out.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{arm.mass[i]}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        T, parent = arm.end(i, drawn=True), f"l{i + 1}"
    out.append(
        f'<joint name="jf" type="fixed"><parent link="l6"/><child link="flange"/>{_origin(T)}</joint>'
        '<link name="flange"/></robot>'
    )
    return "\n".join(out)


def _origin(T: Array) -> str:
    R = T[:3, :3]
    rpy = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(-R[2, 0], np.hypot(R[2, 1], R[2, 2])), np.arctan2(R[1, 0], R[0, 0])
    text = (" ".join(repr(float(v)) for v in vector) for vector in (T[:3, 3], rpy))
    return '<origin xyz="{}" rpy="{}"/>'.format(*text)
