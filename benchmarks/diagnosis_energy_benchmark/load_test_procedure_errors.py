"""Simulate load tests with errors of procedure that neither simulator has.

Run: ``python benchmarks/diagnosis_energy_benchmark/load_test_procedure_errors.py --out out/shopfloor``.

Load tests of the stranger's arms, springs and nothing else, spoilt by how they were done: a dial gauge for each axis
in a set-up of its own, a jack whose friction the pressure hides, weights on a rope that is not quite straight, air
that warms up along a laser's way, eight poses, encoders behind the gears, one zero a visit, brakes that let go. Of
those that leave a mark every name of the record is right, and of the brakes every name of their joint; what a joint, a
body or geometry is blamed for otherwise is wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import evaluate_answers
import numpy as np
import recording_tables
import robot_models
import run_energy_benchmark
from dual_quaternions import Array
from effect_strength import NoiseFreeRecord
from load_test import LoadTest
from loading_rig import LABS, Lab, joint_columns

PLAIN = LABS["plain"]
FORCE = tuple((f"force_sensor_{n}", "sensor:force") for n in ("gain", "offset", "frame"))
RECORD = (*FORCE, ("load_geometry", "sensor:force"), ("displacement_frame", "sensor:displacement"))
HEAT = (("thermal_drift", "environment"),)
BRAKED = 1  # 0-based joint whose brake lets go
BRAKE = tuple((f"joint_{n}", f"joint:{BRAKED + 1}") for n in ("backlash", "hysteresis", "creep"))
HABITS: dict[str, tuple[Lab, tuple[tuple[str, str], ...]]] = {  # lab, what may be named; nothing: a null
    "eight_poses": (replace(PLAIN, poses=8), ()),
    "link_side": (PLAIN, ()),
    "one_zero": (PLAIN, ()),
    "dials": (PLAIN, (("displacement_frame", "sensor:displacement"),)),
    "jack": (PLAIN, RECORD),
    "rope": (replace(PLAIN, stated=False), RECORD),
    "warm_air": (PLAIN, HEAT),
    "brakes": (PLAIN, BRAKE),
}


def spoil(habit: str, scene: LoadTest, clean: NoiseFreeRecord, rng: np.random.Generator) -> NoiseFreeRecord:
    """The same load test as this habit leaves it."""
    c = {k: np.array(v) for k, v in clean.columns.items()}
    visit = c["pose"] + 1000 * c["session"]
    moved, turned = np.array(c["moved"]), c["turned"]
    J, Z = joint_columns(scene.nominal, scene.rigid)
    soft = 1.0 / scene.built.stiffness

    def by(wrench: Array) -> Array:
        """(N, 3) m of the true springs, linear."""
        return np.einsum("njd,nj->nd", J, soft * np.einsum("njc,nc->nj", np.concatenate([J, Z], axis=2), wrench))

    if habit == "dials":  # each gauge stands askew, and its stem sticks a little
        askew = np.eye(3) + np.radians(0.4) * rng.normal(size=(3, 3))
        moved = moved @ askew.T + 1e-6 * np.where(c["unloading"], 1.0, -1.0)[:, None] * np.sign(moved)
        for axis in range(3):  # in a visit of its own, with its own zero
            labels, which = np.unique(visit, return_inverse=True)
            moved[:, axis] += 3e-6 * rng.normal(size=len(labels))[which]
    elif habit == "jack":  # the seal takes three hundredths either way
        lost = np.where(c["unloading"], 0.03, -0.03)[:, None]
        moved = moved + by(c["wrench"] * lost)
    elif habit == "rope":  # another way in each pose and direction, the same on both days
        kind = c["pose"] * 1000 + np.round(50 * c["wrench"][:, 0] / np.linalg.norm(c["wrench"][:, :3], axis=1)).astype(
            int
        )
        labels, which = np.unique(kind, return_inverse=True)
        about = np.radians(1.5) * rng.normal(size=(len(labels), 3))[which]
        moved = moved + by(np.concatenate([np.cross(about, c["wrench"][:, :3]), np.zeros((len(visit), 3))], axis=1))
    elif habit == "warm_air":  # the day's heat bends the ray: slowly, and not from the same hour on
        zero = np.array([c["time"][np.flatnonzero(c["cycle"] == k)[0]] for k in c["cycle"]]) - scene.lab.hold
        day = c["session"] * 0.7

        def bent(t: Array) -> Array:
            return 2.5e-4 * np.sin(2 * np.pi * (t / 5400.0) + day)

        moved[:, 2] += bent(c["time"]) - bent(zero)
    elif habit == "brakes":  # beyond seven tenths of the largest torque one slips, and stays so until the visit ends
        load = np.einsum("nc,nc->n", np.concatenate([J, Z], axis=2)[:, BRAKED], c["wrench"])
        slip = np.zeros(len(load))
        for k in np.unique(visit):
            rows = np.flatnonzero(visit == k)
            over = np.maximum.accumulate(np.abs(load[rows]) > 0.7 * np.abs(load).max())
            first = rows[int(over.argmax())]
            cycle = c["cycle"][rows] == c["cycle"][first]
            slip[rows] = np.where(over & cycle, np.sign(load[first]), 0.0)  # each cycle counts from its own zero
        moved = moved + 6e-5 * slip[:, None] * J[:, BRAKED]
    elif habit == "one_zero":
        labels, which = np.unique(visit, return_inverse=True)
        moved = moved + 8e-6 * rng.normal(size=(len(labels), 3))[which]
    elif habit == "link_side":  # what is recorded moves with the load
        c["q"] = c["q"] + soft * np.einsum("njc,nc->nj", np.concatenate([J, Z], axis=2), c["wrench"])
    return replace(clean, columns=c | {"moved": moved, "turned": turned})


def make(habit: str, number: int, out: Path) -> str:
    """One case; its folder."""
    key = f"shopfloor/{habit}/{number}"
    name = f"s{zlib.crc32(key.encode()):08x}"
    rng = np.random.default_rng([61, zlib.crc32(key.encode())])
    lab, accepted = HABITS[habit]
    nominal = robot_models.draw(str(rng.choice(list(robot_models.CATALOGUE))), rng)
    scene = LoadTest(nominal, robot_models.as_built(nominal, rng), lab, rng)
    clean = spoil(habit, scene, scene.clean([]), rng)
    robot_models.write_cell(nominal, out / name / "cell")
    recording_tables.write(recording_tables.load_table(scene, clean, rng), out / name / "recording")
    said = {
        "effect": "unnamed",
        "location": habit,
        "size": {"value": 1.0, "unit": "own"},
        "parameters": {},
        "accepted": [list(a) for a in accepted],
        "noncentrality": None,
        "absorbed": False,
    }
    truth = {
        "case": name,
        "key": key,
        "group": "outside" if accepted else "null",
        "channel": "deflection",
        "lab": habit,
        "robot": nominal.name,
        "fault": "",
        "ugly": True,
        "repeats": True,
        "effects": [said] if accepted else [],
        "ambient": [{"effect": "geometric_stiffness", "location": "arm"}],
        "outlier_rows": [],
        "oracle": {"rmse": 0.0, "unit": "mm"},
    }
    (out / f"{name}.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return name


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--copies", type=int, default=3, help="robots a habit")
    parser.add_argument("--only", nargs="*", default=list(HABITS), choices=list(HABITS))
    parser.add_argument("--make", action="store_true", help="make the cases and stop")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    for habit in options.only:
        for number in range(options.copies):
            name = make(habit, number, options.out)
            print(f"{name}  {habit}", flush=True)
            if not options.make:
                _, seconds, problem = run_energy_benchmark.diagnose(options.out / name, [])
                print(f"    {seconds:.0f} s  {problem[:160]}".rstrip(), flush=True)
    return 0 if options.make else evaluate_answers.main([str(options.out)])


if __name__ == "__main__":
    sys.exit(main())
