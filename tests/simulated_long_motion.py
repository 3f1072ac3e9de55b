"""Long motion of a six-axis arm by an independent Newton–Euler recursion, as cell and recording folders."""

from __future__ import annotations

from pathlib import Path

import numpy as np

GRAVITY = 9.80665
# axis, origin in the parent (m), mass (kg), centre of mass (m), principal inertia (kg·m²)
LINKS = (
    ("0 0 1", (0.0, 0.0, 0.4), 260.0, (0.2, 0.0, 0.2), (12.0, 14.0, 11.0)),
    ("0 1 0", (0.35, 0.0, 0.3), 210.0, (0.0, 0.05, 0.5), (24.0, 23.0, 4.0)),
    ("0 1 0", (0.0, 0.0, 1.15), 120.0, (0.25, 0.0, 0.05), (3.0, 8.0, 8.5)),
    ("1 0 0", (1.0, 0.0, 0.0), 42.0, (0.1, 0.0, 0.0), (0.4, 0.7, 0.7)),
    ("0 1 0", (0.25, 0.0, 0.0), 30.0, (0.08, 0.0, 0.0), (0.2, 0.3, 0.3)),
    ("1 0 0", (0.2, 0.0, 0.0), 16.0, (0.05, 0.0, 0.0), (0.08, 0.1, 0.1)),
)
COULOMB = np.array([180.0, 220.0, 150.0, 35.0, 30.0, 18.0])  # N·m
VISCOUS = np.array([260.0, 300.0, 190.0, 40.0, 35.0, 20.0])  # N·m·s/rad
NOISE = np.array([30.0, 30.0, 20.0, 5.0, 5.0, 3.0])  # N·m, 1 sigma
CELL = """machopt_cell: 1
name: long motion
robot:
  urdf: robot.urdf
  base_link: base
  flange_link: l6
  home_deg: [0, 0, 0, 0, 0, 0]
  limits:
    velocity_deg_s: [120, 120, 120, 180, 180, 240]
    acceleration_deg_s2: [400, 400, 400, 600, 600, 800]
    jerk_deg_s3: [4000, 4000, 4000, 6000, 6000, 8000]
tool: {tcp: {xyz_mm: [200, 0, 0]}}
workpiece: {pose: {xyz_mm: [2000, 0, 500]}}
"""


def urdf() -> str:
    out = ['<robot name="long"><link name="base"/>']
    for i, (axis, origin, mass, centre, inertia) in enumerate(LINKS, 1):
        ixx, iyy, izz = inertia
        out.append(
            f'<link name="l{i}"><inertial><origin xyz="{centre[0]} {centre[1]} {centre[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="a{i}" type="revolute"><parent link="{"base" if i == 1 else f"l{i - 1}"}"/>'
            f'<child link="l{i}"/><origin xyz="{origin[0]} {origin[1]} {origin[2]}"/><axis xyz="{axis}"/>'
            '<limit lower="-3.2" upper="3.2" velocity="5" effort="0"/></joint>'
        )
    return "".join(out) + "</robot>"


def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Compute joint torques (N, 6) in N·m by forward and backward recursion in link axes, for all samples at once."""
    n = len(q)
    w, dw, acc = np.zeros((n, 3)), np.zeros((n, 3)), np.tile([0.0, 0.0, GRAVITY], (n, 1))
    turns, forces, moments = [], [], []
    for j, (words, origin, mass, centre, inertia) in enumerate(LINKS):
        axis, p, c, tensor = np.array(words.split(), float), np.array(origin), np.array(centre), np.diag(inertia)
        R = _turn(axis, q[:, j])  # child to parent
        turns.append(R)
        acc = acc + np.cross(dw, p) + np.cross(w, np.cross(w, p))
        w, dw, acc = (np.einsum("nba,nb->na", R, x) for x in (w, dw, acc))
        dw = dw + axis * a[:, j, None] + np.cross(w, axis * v[:, j, None])
        w = w + axis * v[:, j, None]
        forces.append(mass * (acc + np.cross(dw, c) + np.cross(w, np.cross(w, c))))
        moments.append(dw @ tensor + np.cross(w, w @ tensor) + np.cross(c, forces[-1]))
    out = np.empty_like(q)
    f, m = np.zeros((n, 3)), np.zeros((n, 3))
    for j in reversed(range(6)):
        axis = np.array(LINKS[j][0].split(), float)
        if j < 5:  # wrench of the next link, transformed to this link's axes
            p = np.array(LINKS[j + 1][1])
            f, m = (np.einsum("nab,nb->na", turns[j + 1], x) for x in (f, m))
            m = m + np.cross(p, f)
        f, m = f + forces[j], m + moments[j]
        out[:, j] = m @ axis
    return out


def _turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)


def motion(samples: int, rate: float, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return time, q, q̇, q̈ of sines without a common period: the motion does not repeat."""
    t = np.arange(samples) / rate
    q, v, a = (np.zeros((samples, 6)) for _ in range(3))
    for j in range(6):
        for _ in range(7):
            w, phase, size = 2 * np.pi * rng.uniform(0.05, 0.6), rng.uniform(0, 6.28), rng.uniform(0.1, 0.3)
            q[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w**2 * np.sin(w * t + phase)
    return t, q, v, a


def tip(q: np.ndarray) -> np.ndarray:
    """Return the TCP (N, 3) in m."""
    p = np.tile([0.2, 0.0, 0.0], (len(q), 1))
    for j in reversed(range(6)):
        p = np.einsum("nab,nb->na", _turn(np.array(LINKS[j][0].split(), float), q[:, j]), p) + np.array(LINKS[j][1])
    return p


def write_long_motion(
    folder: Path, samples: int, rate: float, seed: int, stribeck: float = 0.0, shows: str = "tau"
) -> tuple[Path, Path]:
    """Write cell and recording; with a Stribeck peak (N·m) at joint 2, otherwise without effects beyond the base model.

    Args:
        folder: created by this function.
        samples, rate: number of samples, Hz.
        seed: of motion and noise.
        stribeck: N·m.
        shows: in addition to the torque, ``qse`` for link-side encoders or ``tip`` for a tracked TCP.
    """
    rng = np.random.default_rng(seed)
    t, q, v, a = motion(samples, rate, rng)
    tau = torque(q, v, a) + COULOMB * np.tanh(v / 1e-3) + VISCOUS * v + NOISE * rng.normal(size=q.shape)
    tau[:, 1] += stribeck * np.tanh(v[:, 1] / 1e-3) / (1.0 + (v[:, 1] / 0.08) ** 2)
    cell, recording = folder / "cell", folder / "recording"
    cell.mkdir(parents=True, exist_ok=True)
    recording.mkdir(exist_ok=True)
    (cell / "robot.urdf").write_text(urdf(), encoding="utf-8")
    (cell / "cell.yaml").write_text(CELL, encoding="utf-8")
    (recording / "recording.yaml").write_text("machopt_recording: 1\nkind: motion\ndata: data.csv\n", encoding="utf-8")
    names = ["time_s", *(f"{k.format(j)}" for k in ("q{}_deg", "qd{}_deg_s", "tau{}_Nm") for j in range(1, 7))]
    observed = np.degrees(q) + 2e-4 * rng.normal(size=q.shape)
    speed = np.degrees(v) + 0.01 * rng.normal(size=q.shape)
    table = np.column_stack([t, observed, speed, tau])
    bent = q - torque(q, v, a) * np.array([0.3, 0.5, 0.7, 2.0, 2.5, 3.0]) * 1e-6
    if shows == "qse":
        names += [f"qse{j}_deg" for j in range(1, 7)]
        table = np.column_stack([table, np.degrees(bent + 2e-5 * rng.normal(size=q.shape))])
    elif shows == "tip":
        names += ["x_mm", "y_mm", "z_mm"]
        table = np.column_stack([table, 1e3 * (tip(bent) + 2e-5 * rng.normal(size=(samples, 3)))])
    np.savetxt(recording / "data.csv", table, "%.10g", ",", header=",".join(names), comments="")
    return cell, recording
