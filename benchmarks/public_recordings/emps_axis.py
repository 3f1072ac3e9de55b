"""The EMPS benchmark: one motor-driven ball-screw axis, ``python benchmarks/public_recordings/emps_axis.py DATA_FOLDER
OUT``.

Janot, Gautier & Brunot, Data set and reference models of EMPS (nonlinearbenchmark.org, 2019): an inverse model with
symmetric friction, force = M a + Fv v + Fc sgn(v) + offset, leaves a relative error 100 ‖F − F̂‖ / ‖F‖ of 4.08 % on
the data that it was fitted to. The axis becomes a cell with one prismatic joint and a recording folder under OUT, and
the command ``machopt diagnose`` runs on them as anybody would run it. Its errors are of stretches of time that no fit
saw; the published model is refitted here at the very same stretches. Nothing of the data is stored in the project.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import scipy.io

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.recording import write_recording

PUBLISHED = {"relative error": 4.08, "M": 95.11, "Fv": 203.5, "Fc": 20.39, "offset": -3.16}
URDF = """<robot name="emps"><link name="base"/><link name="carriage"><inertial><origin xyz="0 0 0"/>
<mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="2" effort="0"/></joint></robot>
"""
CELL = """machopt_cell: 1
name: EMPS, one ball-screw axis
robot:
  urdf: emps.urdf
  base_link: base
  flange_link: carriage
  home_deg: [0]
  limits: {velocity_deg_s: [500], acceleration_deg_s2: [5000], jerk_deg_s3: [100000]}
"""


def cell(folder: Path) -> Path:
    """The axis as a cell: a carriage of the published mass on a horizontal slide."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "emps.urdf").write_text(URDF.format(mass=PUBLISHED["M"]), encoding="utf-8")
    (folder / "cell.yaml").write_text(CELL, encoding="utf-8")
    return folder


def recording(file: Path, folder: Path) -> tuple[Path, np.ndarray]:
    """Motor force and carriage position as a recording; and the force (N,) N."""
    data = scipy.io.loadmat(str(file), squeeze_me=True)
    n = len(data["t"])
    force = float(data["gtau"]) * np.asarray(data["vir"], float)
    zeros = np.zeros(n, np.int64)
    write_recording(
        folder,
        Recording(
            kind="motion",
            source="emps",
            q=np.asarray(data["qm"], float)[:, None],
            pose=zeros,
            cycle=np.arange(n),
            session=zeros,
            line=np.arange(n) + 2,
            time=np.asarray(data["t"], float),
            torque=force[:, None],
            q_command=np.asarray(data["qg"], float)[:, None],
            prismatic=(True,),
            notes="EMPS benchmark, Janot, Gautier & Brunot 2019",
        ),
    )
    return folder, force


def relative(residual: np.ndarray, force: np.ndarray) -> float:
    """100 ‖F − F̂‖ / ‖F‖."""
    return 100.0 * float(np.linalg.norm(residual) / np.linalg.norm(force))


def blocks(rows: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Force averaged over the samples that each reading stands for; rows are 1-based first samples."""
    step = int(np.median(np.diff(np.sort(rows))))
    return np.array([force[r - 1 : r - 1 + step].mean() for r in rows])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with DATA_EMPS.mat")
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    place = cell(options.out / "cell")
    folder, force = recording(options.data / "DATA_EMPS.mat", options.out / "recording")
    result = options.out / "diagnosis"
    subprocess.run(
        [
            sys.executable,
            "-m",
            "machopt.cli",
            "diagnose",
            str(place),
            str(folder),
            "-o",
            str(result),
            "--seed",
            str(options.seed),
            "--quiet",
        ],
        check=True,
    )
    said = json.loads((result / "diagnosis.json").read_text(encoding="utf-8"))
    with (result / "residuals.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    before = np.array([float(r["before_jointtorque_N"]) for r in table])
    after = np.array([float(r["after_jointtorque_N"]) for r in table])
    used = np.array([r["used"] == "1" for r in table])
    rows = np.array([int(r["row"]) for r in table])
    F = blocks(rows, force)
    print(said["sentence"])
    print(*(f"  note: {n}" for n in said["notes"]), sep="\n")
    print(f"verdict {said['verdict']}; noise floor {said['baseline']['noise_floor']:.3f} N")
    print(f"{'':<60}held-out error  100 ‖F − F̂‖/‖F‖")
    print(f"{'published, symmetric friction, fitted to all of it':<60}{'':>14}{PUBLISHED['relative error']:10.2f} %")
    for words, e in (("the same model refitted, stretches that no fit saw", before), ("with what was found", after)):
        print(f"{words:<60}{np.sqrt(np.mean(e[used] ** 2)):12.3f} N{relative(e, F):10.2f} %")
    for c in said["coefficients"]:
        print(f"  {c['name']}: {c['before']:.4g} → {c['value']:.4g} ± {c['sigma']:.2g} {c['unit']}")
    for f in said["findings"]:
        sizes = ", ".join(f"{k} {v['value']:.4g} {v['unit']}" for k, v in f["parameters"].items())
        others = ", ".join(f"{e} {where}" for e, where in f["one_of"][1:])
        print(f"{f['effect']} {f['location']} ({f['law']}): {sizes}" + (f"; or {others}" if others else ""))
        print(f"  {f['equation']}")
    for s in said["mismatch"][:4]:
        print(f"mismatch at {s['axis']}: {100 * s['share']:.0f} % {s['note']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
