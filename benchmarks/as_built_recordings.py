"""Arms whose geometry is not the drawing's, measured by a tracker: ``python benchmarks/as_built_recordings.py OUT``.

Makes recordings of poses with pinocchio alone (joint frames moved in its tree, springs solved at equilibrium under
weight; nothing of machopt's effects), conceals geometry at one joint, with or without one more effect, or nothing, and
counts what ``machopt diagnose`` names. ``--cases geometry,both,null`` and ``--seeds 20`` choose; one line a recording.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

CELLS = Path(__file__).parents[1] / "cells"
BESIDE = ("transmission_error", "joint_zero_offset", "payload")


@dataclass
class Truth:
    """What is concealed."""

    geometry: str = ""  # "joint:3"
    size_mm: float = 0.0  # shift and, per 1 m, turn
    beside: str = ""
    where: str = ""
    notes: dict[str, float] = field(default_factory=dict)


class Measured:
    """An arm with what is concealed in it, and a tracker.

    Args:
        cell: folder of a cell whose robot it is.
        truth: what differs from the drawing.
        rng: of the concealed sizes and of noise.
    """

    def __init__(self, cell: Path, truth: Truth, rng: np.random.Generator) -> None:
        said = yaml.safe_load((cell / "cell.yaml").read_text())
        self.model = pin.buildModelFromUrdf(str(cell / said["robot"]["urdf"]))
        names = said["robot"].get("arm_joints") or [n for n in self.model.names if n != "universe"][:6]
        self.ids = [self.model.getJointId(n) for n in names]
        self.flange = self.model.getFrameId(said["robot"]["flange_link"])
        tool = said["tool"]
        self.tcp = pin.SE3(
            pin.rpy.rpyToMatrix(*np.radians(tool["tcp"]["rpy_deg"])), np.array(tool["tcp"]["xyz_mm"]) / 1e3
        )
        self.compliance = 1.0 / np.array(
            yaml.safe_load((cell / "stiffness.yaml").read_text())["joints_Nm_per_rad"], float
        )
        self.compliance *= rng.uniform(0.8, 1.25, 6)
        self.rng, self.truth = rng, truth
        mass = float(tool["mass_kg"])
        com = np.array(tool["com_mm"], float) / 1e3
        if truth.beside == "payload":
            mass += float(rng.uniform(0.3, 0.6)) * mass
        place = self.model.frames[self.flange].placement
        joint = self.model.frames[self.flange].parentJoint
        self.model.inertias[joint] = self.model.inertias[joint] + place.act(pin.Inertia(mass, com, np.zeros((3, 3))))
        if truth.geometry:
            self._move(int(truth.geometry[-1]) - 1, truth.size_mm)
        self.wave = (int(rng.integers(6)), float(rng.choice([1, 2, 3, 6, 12])), float(rng.uniform(0, 6.28)))
        self.offset = (int(rng.integers(1, 5)), float(np.radians(rng.choice([-1, 1]) * rng.uniform(0.01, 0.03))))
        if truth.beside == "transmission_error":
            truth.where = f"joint:{self.wave[0] + 1}"
        elif truth.beside == "joint_zero_offset":
            truth.where = f"joint:{self.offset[0] + 1}"
        elif truth.beside:
            truth.where = "tool"
        self.data = self.model.createData()

    def _move(self, k: int, size: float) -> None:
        """Joint k's frame in its own axes: across its line, which is what a joint can be off by."""
        j = self.ids[k]
        way = self.rng.normal(size=2)
        tilt = self.rng.normal(size=2)
        shift = np.r_[1e-3 * size * way / np.linalg.norm(way), 0.0]
        turn = np.r_[1e-3 * size * tilt / np.linalg.norm(tilt), 0.0]
        self.model.jointPlacements[j] = self.model.jointPlacements[j] * pin.SE3(pin.exp3(turn), shift)

    def tip(self, q: np.ndarray) -> pin.SE3:
        """The tool where it really is when the encoders say q."""
        asked = q.copy()
        if self.truth.beside == "transmission_error":
            j, n, at = self.wave
            asked[j] += 1.6e-4 * np.sin(n * q[j] + at)
        elif self.truth.beside == "joint_zero_offset":
            asked[self.offset[0]] += self.offset[1]
        full = pin.neutral(self.model)
        index = [self.model.idx_qs[j] for j in self.ids]
        bent = asked
        for _ in range(6):
            full[index] = bent
            weight = pin.computeGeneralizedGravity(self.model, self.data, full)
            bent = asked - self.compliance * weight[[self.model.idx_vs[j] for j in self.ids]]
        full[index] = bent
        pin.framesForwardKinematics(self.model, self.data, full)
        return self.data.oMf[self.flange] * self.tcp


def record(folder: Path, arm: Measured, poses: int, sessions: int, full: bool) -> None:
    """A recording folder: every pose in every session, tracker frame and target a little off."""
    rng, rows = arm.rng, []
    said = yaml.safe_load((folder.parent / "cell" / "cell.yaml").read_text())
    home = np.radians(np.array(said["robot"]["home_deg"][:6], float))
    reach = np.radians([80, 35, 40, 120, 80, 150])
    frame = pin.SE3(pin.exp3(rng.normal(0, 1e-3, 3)), rng.normal(0, 1e-3, 3))
    target = pin.SE3(np.eye(3), rng.normal(0, 3e-4, 3))
    q = np.array([home + np.array([0, 0, 0, 0, 0.6, 0]) + rng.uniform(-reach, reach) for _ in range(poses)])
    for session in range(sessions):
        for pose in rng.permutation(poses):
            T = frame * arm.tip(q[pose]) * target
            p = T.translation + rng.normal(0, 1.2e-5, 3) + rng.normal(0, 1.0e-5, 3)
            angles = np.degrees(q[pose])
            rest = []
            if full:
                turn = pin.Quaternion(T.rotation @ pin.exp3(rng.normal(0, 5e-5, 3))).coeffs()
                rest = [turn[3], *turn[:3]]
            rows.append([pose + 1, session + 1, *np.round(angles, 7), *np.round(1e3 * p, 6), *np.round(rest, 9)])
    folder.mkdir(parents=True)
    head = ["pose", "session", *(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"]
    with (folder / "data.csv").open("w", newline="") as f:
        csv.writer(f).writerows([head + (["qw", "qx", "qy", "qz"] if full else []), *rows])
    stated = "displacement_mm: 0.016" + (", rotation_mrad: 0.05" if full else "")
    text = "machopt_recording: 1\nkind: absolute\ndata: data.csv\nregistration: fit\n"
    (folder / "recording.yaml").write_text(text + f"standard_uncertainty: {{{stated}}}\n")


def one(out: Path, case: str, seed: int, options: argparse.Namespace) -> dict[str, object]:
    """Make a recording, diagnose it, and say what was right."""
    rng = np.random.default_rng([seed, {"geometry": 1, "both": 2, "null": 3, "other": 4}[case]])
    truth = Truth()
    if case in ("geometry", "both"):
        truth = Truth(f"joint:{int(rng.integers(2, 7))}", float(rng.uniform(0.15, 0.5)))
    if case in ("both", "other"):
        truth.beside = str(rng.choice(BESIDE))
    folder = out / f"{case}_{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    name = str(rng.choice(["kr240_drilling", "irb6700_drilling", "cutting_cobot"]))
    shutil.copytree(CELLS / name, folder / "cell")
    arm = Measured(folder / "cell", truth, rng)
    record(folder / "recording", arm, options.poses, options.sessions, options.full)
    command = [sys.executable, "-m", "machopt.cli", "diagnose", str(folder / "cell"), str(folder / "recording")]
    subprocess.run([*command, "-o", str(folder / "out"), "--quiet"], check=True)
    said = json.loads((folder / "out" / "diagnosis.json").read_text())
    sets = [[tuple(o) for o in f["one_of"]] for f in said["findings"]]
    wanted = [("geometry", truth.geometry)] if truth.geometry else []
    wanted += [(truth.beside, truth.where)] if truth.beside else []
    first = [s[0] for s in sets]
    return {
        "case": f"{case}_{seed}",
        "cell": name,
        "true": wanted,
        "said": first,
        "verdict": said["verdict"],
        "geometry": (
            bool(truth.geometry),
            wanted[:1] and wanted[0] in first,
            any(wanted[:1] and wanted[0] in s for s in sets),
        ),
        "all": all(any(w in s for s in sets) for w in wanted),
        "none_else": all(any(w in s for w in wanted) for s in sets),
        "geometry_named": any(f[0] == "geometry" for f in first),
        "heldout": (said["baseline"]["heldout_rmse"], said["final"]["heldout_rmse"], said["baseline"]["noise_floor"]),
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", default="geometry,both,other,null")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--poses", type=int, default=60)
    parser.add_argument("--sessions", type=int, default=2)
    parser.add_argument("--full", action="store_true", help="orientations are measured too")
    options = parser.parse_args(arguments)
    rows = []
    for case in options.cases.split(","):
        for seed in range(options.first, options.first + options.seeds):
            rows.append(one(options.out, case, seed, options))
            print(*(f"{k} {v};" for k, v in rows[-1].items()), flush=True)
    for case in options.cases.split(","):
        mine = [r for r in rows if str(r["case"]).startswith(case)]
        count = {k: sum(bool(r[k]) for r in mine) for k in ("all", "none_else", "geometry_named")}
        print(
            f"{case}: {len(mine)} recordings, all named {count['all']}, nothing else named {count['none_else']},",
            end=" ",
        )
        print(f"geometry named in {count['geometry_named']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
