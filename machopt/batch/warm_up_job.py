"""Warm-up job: a tiny complete job, run once in every process server so that its jobs find everything compiled.

Only one process of a machine compiles; the others wait for it and load what it stored.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from machopt.batch.job_key import compute_program_version

_AXES = (  # origin of the joint in m, axis: an arm of common proportions with a spherical wrist
    ("0 0 0.67", "0 0 -1"),
    ("0.35 0 0", "0 1 0"),
    ("1.15 0 0", "0 1 0"),
    ("1.0 0 0.04", "-1 0 0"),
    ("0 {offset} 0", "0 1 0"),
    ("0.21 0 0", "-1 0 0"),
)
_BODY = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'
_CELL = """\
machopt_cell: 1
name: warm-up
robot:
  urdf: robot.urdf
  base_link: l0
  flange_link: flange
  home_deg: [0, -90, 90, 0, 45, 0]
  limits:
    velocity_deg_s: [120, 115, 120, 190, 180, 260]
    acceleration_deg_s2: [300, 300, 300, 500, 500, 800]
    jerk_deg_s3: [2000, 2000, 2000, 4000, 4000, 6000]
tool:
  tcp: {xyz_mm: [0, 0, 300], rpy_deg: [0, 30, 0]}
  geometry: [{name: spindle, box_mm: [60, 60, 100], xyz_mm: [0, 0, 60]}]
  cutter: {diameter_mm: 10, length_mm: 60}
workpiece:
  pose: {xyz_mm: [1500, 0, 700]}
  geometry: [{name: block, box_mm: [200, 200, 50], xyz_mm: [0, 0, -25]}]
stiffness: stiffness.yaml
plan: {force_N: {normal: 100}, rotation_step_deg: 30}
"""
_STIFFNESS = "machopt_stiffness: 1\njoints_Nm_per_rad: [1.4e6, 1.2e6, 9.0e5, 3.0e5, 3.0e5, 2.0e5]\n"
_PATH = """\
x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min
-20,0,40,0,0,1,rapid,
-20,0,5,0,0,1,approach,1000
-20,0,-0.5,0,0,1,cut,1000
0,0,-0.5,0,0,1,cut,1000
0,20,-0.5,0,0,1,cut,1000
0,20,40,0,0,1,retract,1000
60,20,40,0,0,1,rapid,
60,20,-0.5,0,0,1,cut,1000
60,20,40,0,0,1,retract,1000
"""


def run_warm_up_job(folder: Path) -> int:
    """Run the job; return its exit code, 0.

    Args:
        folder: An empty folder.
    """
    from machopt.commands.optimize.request import OptimizeRequest
    from machopt.commands.optimize.run import run_optimize

    cell = folder / "cell"
    cell.mkdir()
    (cell / "cell.yaml").write_text(_CELL, encoding="utf-8")
    (cell / "stiffness.yaml").write_text(_STIFFNESS, encoding="utf-8")
    (folder / "path.csv").write_text(_PATH, encoding="utf-8")
    with lock_first_warm_up():
        _solve_general_arm(cell)
        (cell / "robot.urdf").write_text(_build_urdf(), encoding="utf-8")
        return run_optimize(
            OptimizeRequest(cell=cell, toolpath=folder / "path.csv", out=folder / "out", posts=("krl",))
        ).exit_code


def _solve_general_arm(cell: Path) -> None:
    """Inverse kinematics of an arm without spherical wrist, which the tiny job does not need."""
    import numpy as np

    from machopt.cell.cell_reader import load_cell
    from machopt.kinematics.inverse.general_solver import GeneralSolver
    from machopt.kinematics.urdf_loading import load_robot

    (cell / "robot.urdf").write_text(_build_urdf(wrist_offset=0.1), encoding="utf-8")
    robot = load_robot(load_cell(cell))
    q = 0.1 + 0.05 * np.arange(6.0).reshape(3, 2, 1) + np.zeros(6)  # rad, six neighbouring configurations
    solver = GeneralSolver.with_first_elimination(robot)
    solver.solve_grid(robot.compute_fk(q.reshape(-1, 6)).reshape(3, 2, 4, 4))


@contextlib.contextmanager
def lock_first_warm_up() -> Iterator[None]:
    """Let the first warm-up of this program on this machine run alone; later ones find its mark and do not wait."""
    compiled_for = hashlib.sha256(
        f"{compute_program_version()} {os.environ.get('NUMBA_CACHE_DIR')}".encode()
    ).hexdigest()[:12]
    with contextlib.ExitStack() as lock_stack:
        mark: Path | None = None
        with contextlib.suppress(ImportError, OSError, RuntimeError):  # Windows, or no place of one's own: all compile
            import fcntl

            place = _get_user_lock_folder()
            mark = place / f"warm-{compiled_for}.done"
            if not mark.exists():
                lock = lock_stack.enter_context((place / f"warm-{compiled_for}.lock").open("a"))
                fcntl.flock(lock, fcntl.LOCK_EX)
                if mark.exists():  # another one did it meanwhile
                    fcntl.flock(lock, fcntl.LOCK_UN)
        yield
        if mark is not None:
            with contextlib.suppress(OSError):
                mark.touch()


def _get_user_lock_folder() -> Path:
    """Return a private folder of the user, where no other user can create a file or a link."""
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    place = Path(base).expanduser() / "machopt"
    place.mkdir(mode=0o700, parents=True, exist_ok=True)
    return place


def _build_urdf(wrist_offset: float = 0.0) -> str:
    links = "".join(f'<link name="l{i}">{_BODY}</link>' for i in range(7))
    joints = "".join(
        f'<joint name="a{i + 1}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{xyz.format(offset=wrist_offset)}"/><axis xyz="{axis}"/>'
        '<limit lower="-3.1" upper="3.1" velocity="3" effort="1000"/></joint>'
        for i, (xyz, axis) in enumerate(_AXES)
    )
    flange = '<link name="flange"/><joint name="f" type="fixed"><parent link="l6"/><child link="flange"/>'
    turned = '<origin xyz="0 0 0" rpy="0 1.5707963267948966 0"/></joint>'
    return f'<robot name="warm">{links}{joints}{flange}{turned}</robot>'
