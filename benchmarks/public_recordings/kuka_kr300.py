"""KUKA KR300 R2500 ultra, motor- and link-side encoders and motor torque: ``python
benchmarks/public_recordings/kuka_kr300.py DATA OUT``.

Converts the three runs into a cell folder and a recording folder under OUT, then runs the command ``machopt diagnose``
on them, once for each channel that the signals allow. The data are those of Weigand,
Robot_Identification (MIT licence); nothing of them is stored in the project. The nominal numbers are the source's
published parameters; its link inertias and the payload are not, so the channel torque refits motor inertias and may
name a payload.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.recording import write_recording
from machopt.numerics.rigid_transforms import build_transform

D = (-0.675, -0.189, 0.189, -1.0, 0.0, -0.24)
A = (0.350, 1.150, 0.041, 0.0, 0.0, 0.0)
ALPHA = (np.pi / 2, 0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, np.pi)
OFFSET = (0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0)
MASS = (395.40, 339.12, 105.21, 35.80, 31.46, 17.78)
COM_MM = ((-353, 174, -4), (-709, -1, 23), (-18, -18, -76), (0, 236, 1), (0, -80, -9), (0, 0, -50))
RATIO = (1798 / 7, 1872 / 7, 757 / 3, 221.0, 5032 / 21, 206793 / 1340)
MOTOR = (0.00923, 0.0118, 0.0118, 0.00173, 0.00173, 0.00173)
LITERATURE = (
    "motor inertias of the source, above; its link-side angle was never fitted. Springs of a smaller arm for scale: "
    "KR240-2, dumas2011, 1.41, 0.40 and 0.94 MN·m/rad at joints 1 to 3"
)


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    R = [[c, -s, 0], [s, c, 0], [0, 0, 1]] if axis == "z" else [[1, 0, 0], [0, c, -s], [0, s, c]]
    return build_transform(np.array(R), np.zeros(3))


def rpy(R: np.ndarray) -> tuple[float, float, float]:
    return (
        float(np.arctan2(R[2, 1], R[2, 2])),
        float(np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))),
        float(np.arctan2(R[1, 0], R[0, 0])),
    )


def urdf() -> str:
    """Standard DH as joints that turn about z; what follows the turn belongs to the next joint's origin."""
    out = ['<robot name="kr300">', '<link name="base_link"/>']
    before, parent = turn("x", np.pi), "base_link"
    for i in range(6):
        at = before @ turn("z", OFFSET[i])
        before = build_transform(np.eye(3), np.array([0, 0, D[i]])) @ build_transform(np.eye(3), np.array([A[i], 0, 0]))
        before = before @ turn("x", ALPHA[i])
        com = (before @ np.array([*(np.array(COM_MM[i]) / 1e3), 1.0]))[:3]
        out += [
            f'<link name="link_{i + 1}"><inertial><origin xyz="{_three(com)}"/><mass value="{MASS[i]}"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>',
            f'<joint name="a{i + 1}" type="revolute"><parent link="{parent}"/><child link="link_{i + 1}"/>'
            f'<origin xyz="{_three(at[:3, 3])}" rpy="{_three(np.array(rpy(at[:3, :3])))}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.2" upper="6.2" velocity="4" effort="0"/></joint>',
        ]
        parent = f"link_{i + 1}"
    out += [
        '<link name="flange"/>',
        f'<joint name="fixed" type="fixed"><parent link="{parent}"/><child link="flange"/>'
        f'<origin xyz="{_three(before[:3, 3])}" rpy="{_three(np.array(rpy(before[:3, :3])))}"/></joint>',
        "</robot>",
    ]
    return "\n".join(out) + "\n"


def _three(v: np.ndarray) -> str:
    return " ".join(f"{float(x):.9f}" for x in v)


def cell(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf(), encoding="utf-8")
    (folder / "cell.yaml").write_text(
        "machopt_cell: 1\nname: KR300 R2500 ultra of a published data set, payload not documented\n"
        "robot:\n  urdf: robot.urdf\n  base_link: base_link\n  flange_link: flange\n"
        "  pose: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}\n"
        "  home_deg: [0, -90, 90, 0, 0, 0]\n"
        "  limits:\n    velocity_deg_s: [105, 107, 114, 179, 172, 219]\n"
        "    acceleration_deg_s2: [300, 300, 300, 500, 500, 600]\n"
        "    jerk_deg_s3: [2000, 2000, 2000, 4000, 4000, 5000]\n"
        "tool:\n  tcp: {xyz_mm: [0, 0, 200], rpy_deg: [0, 0, 0]}\n  mass_kg: 0\n  com_mm: [0, 0, 0]\n  geometry: []\n"
        "  cutter: {diameter_mm: 10, length_mm: 40}\n"
        "workpiece:\n  link: world\n  pose: {xyz_mm: [2000, 0, 800], rpy_deg: [0, 0, 0]}\n  geometry: []\n"
        "obstacles: []\n",
        encoding="utf-8",
    )
    return folder


def recording(data: Path, folder: Path) -> Path:
    """Three runs as three sessions; torque at the joint is motor torque times the gear ratio."""
    parts: dict[str, list[np.ndarray]] = {k: [] for k in ("q", "v", "tau", "qse", "t", "session")}
    for k, name in enumerate("ABC"):
        rec = scipy.io.loadmat(str(data / f"run_{name}.mat"), squeeze_me=True, struct_as_record=False)["rec"]
        q = np.radians(rec.act_pos_mot_deg.T)
        other = np.full_like(q, np.nan)
        other[:, :3] = np.radians(rec.act_pos_se_deg.T[:, :3])
        parts["q"].append(q)
        parts["v"].append(np.radians(rec.act_vel_mot_deg_per_s.T))
        parts["tau"].append(rec.act_torque_abs_nm.T * np.array(RATIO))
        parts["qse"].append(other)
        parts["t"].append(0.004 * np.arange(len(q)))
        parts["session"].append(np.full(len(q), k))
    joined = {k: np.concatenate(v) for k, v in parts.items()}
    n = len(joined["q"])
    write_recording(
        folder,
        Recording(
            kind="motion",
            source="kr300",
            q=joined["q"],
            pose=np.zeros(n, np.int64),
            cycle=np.arange(n),
            session=joined["session"].astype(np.int64),
            line=np.arange(n) + 2,
            time=joined["t"],
            q_secondary=joined["qse"],
            velocity=joined["v"],
            torque=joined["tau"],
            stated_labels=frozenset({"session"}),
            notes="three runs of 10 s at 4 ms without process load",
        ),
    )
    return folder


def report(said: dict[str, Any]) -> None:
    """One channel's diagnosis.json for a terminal."""
    unit, first, last = said["rmse_unit"], said["baseline"], said["final"]
    print(f"\n{said['predicted']}: {said['sentence']}")
    print(*(f"  {n}" for n in said["notes"]), sep="\n")
    print(
        f"  {said['verdict']}: held-out error {first['heldout_rmse']:.4g} → {last['heldout_rmse']:.4g} {unit}, noise "
        f"{first['noise_floor']:.4g}"
    )
    for f in said["findings"]:
        sizes = ", ".join(f"{k} {v['value']:.4g} {v['unit']}" for k, v in list(f["parameters"].items())[:4])
        others = ", ".join(f"{e} {where}" for e, where in f["one_of"][1:])
        print(f"  {f['effect']} {f['location']} ({f['law']}): {sizes}" + (f"; or {others}" if others else ""))
    for s in said["mismatch"][:4]:
        print(f"    mismatch at {s['axis']}: {100 * s['share']:.0f} % {s['note']}")
    for c in said["coefficients"]:
        extra = ""
        if c["name"].startswith("motor inertia"):
            j = int(c["name"].split()[-1]) - 1
            extra = f" (published {MOTOR[j] * RATIO[j] ** 2:.4g})"
        print(f"    {c['name']}: {c['value']:.4g} ± {c['sigma']:.2g} {c['unit']}{extra}")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with run_A.mat, run_B.mat, run_C.mat")
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    place, record = cell(options.out / "cell"), recording(options.data, options.out / "recording")
    for channel in ("link", "torque"):
        result = options.out / channel
        subprocess.run(
            [
                sys.executable,
                "-m",
                "machopt.cli",
                "diagnose",
                str(place),
                str(record),
                "-o",
                str(result),
                "--channel",
                channel,
                "--seed",
                str(options.seed),
                "--quiet",
            ],
            check=True,
        )
        report(json.loads((result / "diagnosis.json").read_text(encoding="utf-8")))
    print(f"\nbeside it: {LITERATURE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
