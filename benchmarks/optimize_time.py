"""The whole command on 1,000 cutting points × 72 rotations × all branches with a 20,000-triangle workpiece.

Run: ``python benchmarks/optimize_time.py``. Prints wall time and peak memory of ``machopt optimize`` as a process (the
first run also compiles; the later ones are what a user sees), its stages, and in the same run how long a plain
pinocchio loop takes for the Jacobians and stiffness of the same number of configurations, so that the ratio holds
on any machine.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
POINTS = 1000
RUNS = 3


def make_job(folder: Path) -> tuple[Path, Path]:
    """The shipped KR500 cell with a fine workpiece mesh, and a closed 5-axis contour over it."""
    import trimesh

    cell = folder / "cell"
    shutil.copytree(ROOT / "cells" / "kr500_milling", cell)
    mesh = trimesh.load_mesh(cell / "meshes" / "workpiece.stl")
    while len(mesh.faces) < 20_000:
        mesh = mesh.subdivide()
    mesh.export(cell / "meshes" / "workpiece.stl")
    angle = np.linspace(0, 2 * np.pi, POINTS)
    position = np.c_[180 * np.cos(angle), 70 * np.sin(angle), 6 + 4 * np.sin(3 * angle)]
    axis = np.c_[0.15 * np.cos(angle), 0.15 * np.sin(angle), np.ones(POINTS)]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    above = position[0] + 60 * axis[0]
    rows.append(",".join(f"{v:.6f}" for v in (*above, *axis[0])) + ",rapid,")
    rows += [",".join(f"{v:.6f}" for v in (*p, *a)) + ",cut,1500" for p, a in zip(position, axis, strict=True)]
    path = folder / "contour.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    print(f"workpiece: {len(mesh.faces)} triangles; {POINTS} cutting points")
    return cell, path


def textbook(cell_folder: Path, configurations: int = 3000) -> float:
    """Seconds per configuration of the plain loop: pinocchio Jacobian, C = J K⁻¹ Jᵀ, 1/(eᵀCe)."""
    import pinocchio as pin

    from machopt.cell.cell_reader import load_cell

    cell = load_cell(cell_folder)
    model = pin.buildModelFromUrdf(str(cell.urdf))
    data, frame = model.createData(), model.getFrameId(cell.flange_link)
    assert cell.stiffness is not None
    k = cell.stiffness.joints
    q = np.random.default_rng(0).uniform(-1, 1, (configurations, 6))
    start = time.perf_counter()
    for row in q:
        J = pin.computeFrameJacobian(model, data, row, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        C = J @ np.diag(1 / k) @ J.T
        1.0 / C[2, 2]
    return (time.perf_counter() - start) / configurations


def ours(cell_folder: Path, configurations: int = 30_000) -> float:
    """Seconds per configuration of the batched kernels doing the same."""
    from machopt.cell.cell_reader import load_cell
    from machopt.kinematics.urdf_loading import load_robot
    from machopt.stiffness.joint_compliance import compute_directional_compliance

    cell = load_cell(cell_folder)
    robot = load_robot(cell)
    q = np.random.default_rng(0).uniform(-1, 1, (configurations, 6))
    robot.compute_fk_jacobian(q[:1], cell.tool.T_flange_tcp)  # what is compiled is loaded
    start = time.perf_counter()
    assert cell.stiffness is not None
    _, J = robot.compute_fk_jacobian(q, cell.tool.T_flange_tcp)
    1.0 / compute_directional_compliance(
        J, np.broadcast_to(cell.stiffness.joints, q.shape), np.tile([0.0, 0.0, 1.0], (len(q), 1))
    )
    return (time.perf_counter() - start) / configurations


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cell, path = make_job(folder)
        command = [sys.executable, "-m", "machopt.cli", "optimize", str(cell), str(path), "--quiet", "-o"]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has its code compiled
        for n in range(RUNS):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            start = time.perf_counter()
            done = subprocess.run([*command, str(folder / f"out{n}")], env=environment, check=False)
            wall = time.perf_counter() - start
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            peak = after.ru_maxrss / 1024
            print(f"run {n}: exit {done.returncode}, {wall:.2f} s wall, {cpu:.2f} s CPU, peak {peak:.0f} MiB")
        result = json.loads((folder / f"out{RUNS - 1}" / "result.json").read_text(encoding="utf-8"))
        print("stages:", ", ".join(f"{k} {v:.2f} s" for k, v in result["timings_s"].items()))
        same = [(folder / f"out{n}" / t).read_bytes() for t in ("trajectory.csv", "points.csv") for n in range(RUNS)]
        print("tables identical over the runs:", len(set(same)) == 2)
        plain, batched = textbook(cell), ours(cell)
        print(
            f"Jacobian and stiffness: pinocchio loop {1e6 * plain:.1f} µs, batched {1e6 * batched:.2f} µs "
            f"a configuration, ratio {plain / batched:.0f}"
        )


if __name__ == "__main__":
    main()
