"""The EMPS benchmark: one motor-driven ball-screw axis, ``python benchmarks/real/emps.py DATA_FOLDER``.

Janot, Gautier & Brunot, Data set and reference models of EMPS (nonlinearbenchmark.org, 2019): an inverse model with
symmetric friction, force = M a + Fv v + Fc sgn(v) + offset, leaves a relative error of 4.08 %. The same code as
``machopt diagnose`` gets the axis as a chain of one prismatic joint; errors are of stretches of time that no fit saw.
The record repeats one motion with a few speeds four times; stretches of one second are held out while the other
repeats stay in the fit (the published figure is of data that its fit saw). Nothing of the data is stored.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import scipy.io

from machopt.diagnose import engine, motion
from machopt.domain.cell import Cell, JointLimits, Tool, Workpiece
from machopt.domain.recording import Recording

PUBLISHED = {"relative error": 4.08, "M": 95.11, "Fv": 203.5, "Fc": 20.39, "offset": -3.16}
URDF = """<robot name="emps"><link name="base"/><link name="carriage"><inertial><origin xyz="0 0 0"/>
<mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="2" effort="0"/></joint></robot>
"""


def axis(folder: Path) -> Cell:
    """The axis as a cell: a carriage of the published mass on a horizontal slide."""
    urdf = folder / "emps.urdf"
    urdf.write_text(URDF.format(mass=PUBLISHED["M"]), encoding="utf-8")
    one = np.ones(1)
    return Cell(
        "EMPS", folder, urdf, {}, "base", "carriage", ("x",), (), (), np.zeros(1), np.zeros(0), np.eye(4),
        JointLimits(-one, one, one, one, one), Tool(np.eye(4)), Workpiece("world", np.eye(4)), (), None,
    )  # fmt: skip


def record(file: Path) -> Recording:
    """Motor force and carriage position."""
    data = scipy.io.loadmat(str(file), squeeze_me=True)
    n = len(data["t"])
    force = float(data["gtau"]) * np.asarray(data["vir"], float)
    zeros = np.zeros(n, np.int64)
    return Recording(
        "motion", file.stem, np.asarray(data["qm"], float)[:, None], zeros, np.arange(n), zeros, np.arange(n) + 2,
        time=np.asarray(data["t"], float), torque=force[:, None],
        q_command=np.asarray(data["qg"], float)[:, None],
    )  # fmt: skip


def relative(residual: np.ndarray, force: np.ndarray) -> float:
    """100 ‖F − F̂‖ / ‖F‖."""
    return 100.0 * float(np.linalg.norm(residual) / np.linalg.norm(force))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder with DATA_EMPS.mat")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        cell = axis(Path(folder))
        recording = record(options.data / "DATA_EMPS.mat")
        problem, catalogue, notes, _ = motion.build(
            recording, cell, "torque", np.random.default_rng(options.seed), repeats=False
        )
        found = engine.diagnose(
            problem, catalogue, engine.Options(predicted=motion.WORDS["torque"]), np.random.default_rng(options.seed)
        )
        force = recording.torque[problem.row - 1, 0]
        print(*notes, sep="\n")
        print(f"verdict {found.verdict}; noise floor {found.noise_floor:.3f} N")
        print("                                         held-out error   relative")
        print(f"published, symmetric friction, all data                  {PUBLISHED['relative error']:10.2f} %")
        x = np.linalg.lstsq(problem.base[:, 0], problem.y[:, 0], rcond=None)[0]
        seen = relative(problem.y[:, 0] - problem.base[:, 0] @ x, force)
        print(f"the same model, all data, these filters                  {seen:10.2f} %")
        for words, residual in (
            ("baseline: offset, Coulomb, viscous, mass", found.errors.residual),
            ("with what was found", found.errors.final),
        ):
            print(f"{words:<42}{np.std(residual):9.3f} N {relative(residual[:, 0], force):10.2f} %")
        for c in found.coefficients:
            print(f"  {c.unknown.name}: {c.before:.4g} → {c.value:.4g} ± {c.sigma:.2g} {c.unknown.unit}")
        for f in found.findings:
            sizes = ", ".join(f"{k} {v.value:.4g} {v.unit}" for k, v in f.parameters.items())
            others = ", ".join(f"{e} {where}" for e, where in f.one_of[1:])
            print(f"{f.effect} {f.location} ({f.law}): {sizes}" + (f"; or {others}" if others else ""))
            print(f"  {f.equation}")
        for s in found.mismatch[:4]:
            print(f"mismatch at {s.axis}: {100 * s.share:.0f} % {s.note}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
