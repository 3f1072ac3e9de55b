"""The hidden arm of a closed loop: the stranger's physics, what is concealed in it, and its load tests.

Nothing here imports machopt. What a copy of an arm conceals is drawn by its seed; how far its TCP moves under a load is
the difference of two rests of :mod:`elastic_arm`, unloaded and loaded, each a load cycle of its own (what a gear
remembers of other cycles does not count in a job either).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "diagnosis_energy_benchmark"))
import dual_quaternions as dq
import elastic_arm
import load_test_effects
import numpy as np
import recording_tables
import robot_models
from dual_quaternions import Array
from effect_strength import Effect
from instrument_noise import Instrument, errors

ARCMIN = np.pi / 10800
KINDS = ("plain", "bodies", "gears", "both", "base and play")
SETS = {"dev": 100, "sealed": 777_000}
READING = Instrument(0.010, 0.010)  # mm, of a tracker; what a load cycle shares as much again
SHORT = 0.05  # m
FORCE = 0.004  # 1 sigma of a load cell, share of the largest load


@dataclass(frozen=True)
class HiddenArm:
    """One arm: what its maker says, and how it is."""

    kind: str
    nominal: robot_models.Robot
    build: elastic_arm.ElasticArm
    told: str  # what is concealed, in words

    def moves(self, q: Array, wrench: Array) -> Array:
        """(N, 3) m how far the TCP moves from its unloaded state under wrenches (N, 6) in base axes at the TCP."""
        n = len(q)
        twice = np.repeat(q, 2, axis=0)
        load = np.zeros((2 * n, 6))
        load[1::2] = wrench
        cycle = np.repeat(np.arange(n), 2)
        script = elastic_arm.Script(twice, load, 60.0 * np.arange(2.0 * n), cycle, cycle, np.zeros(2 * n, dtype=int))
        frames, _ = elastic_arm.solve_rest_states(self.build, script)
        at = dq.place(frames["tcp"])
        return np.asarray(at[1::2] - at[::2])

    def tip(self, q: Array) -> tuple[Array, Array]:
        """(N, 3) m and (N, 3, 3): the TCP of the rigid nominal arm."""
        frames = elastic_arm.chain(elastic_arm.ElasticArm(self.nominal), q, {"joints": np.zeros_like(q)})
        return dq.place(frames["tcp"]), dq.matrix(frames["tcp"])


def build_hidden_arm(kind: str, seed: int) -> HiddenArm:
    """An arm by its seed; ``kind``: springs only, bodies that bend beside them, gears that are no springs, both, or a
    soft base with play in one joint.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    names = sorted(robot_models.CATALOGUE)
    nominal = robot_models.draw(names[seed % len(names)], rng)
    built = robot_models.as_built(nominal, rng)
    build = elastic_arm.ElasticArm(built)
    scene: Any = SimpleNamespace(built=built, nominal=nominal)
    told = []

    def conceal(name: str, location: str, amplitude: float, **detail: Any) -> None:
        load_test_effects._one(Effect(name, location, amplitude, np.inf, detail=detail), build, scene)
        told.append(f"{name} {location} {amplitude:.3g}")

    if kind in ("bodies", "both"):
        for link in rng.choice([1, 2], size=int(rng.integers(1, 3)), replace=False):
            if np.linalg.norm(built.ends()[link, :3]) < SHORT:  # axes that cross: no link between them
                continue
            conceal("link_compliance", f"link:{link + 1}", rng.uniform(0.15, 0.6), link=int(link), taper=0.7)
    if kind in ("bodies", "both", "base and play"):
        uneven = tuple(float(u) for u in rng.uniform(0.6, 1.6, 3))
        conceal("base_compliance", "base", rng.uniform(0.1, 0.6), uneven=uneven, foot=-1)
    if kind in ("gears", "both"):
        load = test_force(nominal) * nominal.reach()
        j = int(rng.choice([1, 2]))
        knee = 0.15 * load
        conceal("joint_nonlinear_stiffness", f"joint:{j + 1}", rng.uniform(0.3, 1.2), joint=j, knee=knee)
    if kind in ("gears", "both", "base and play"):
        load = test_force(nominal) * nominal.reach()
        j = int(rng.choice([0, 1, 2]))
        conceal("joint_backlash", f"joint:{j + 1}", rng.uniform(0.3, 1.2) * ARCMIN, joint=j, drag=0.02 * load)
    return HiddenArm(kind, nominal, build, ", ".join(told) or "springs only")


def test_force(robot: robot_models.Robot) -> float:
    """N that move the TCP by about two millimetres."""
    return float(round(4e-3 / (robot.reach() ** 2 * np.mean(1.0 / robot.stiffness[:3])), 1))


def simulate_load_tests(
    h: HiddenArm, q: Array, wrench: Array, labels: dict[str, Array], rng: np.random.Generator
) -> recording_tables.Table:
    """The recording of load tests at q (N, 6) under wrenches (N, 6), each reading against its unloaded state."""
    moved = 1e3 * h.moves(q, wrench)
    groups = np.unique(np.stack([labels[k] for k in ("session", "pose", "cycle")]), axis=1, return_inverse=True)[1]
    moved = moved + errors(READING, groups.reshape(-1), 3, rng)
    largest = float(np.linalg.norm(wrench[:, :3], axis=1).max())
    said = wrench.copy()
    said[:, :3] += FORCE * largest * rng.normal(size=(len(q), 3))
    columns: dict[str, Array] = dict(labels)
    columns |= {f"q{j + 1}_deg": np.degrees(q[:, j]) for j in range(6)}
    columns |= {f"f{a}_N": said[:, k] for k, a in enumerate("xyz")}
    if np.any(wrench[:, 3:]):
        columns |= {f"m{a}_Nm": said[:, 3 + k] for k, a in enumerate("xyz")}
    columns |= {f"d{a}_mm": moved[:, k] for k, a in enumerate("xyz")}
    about = {
        "machopt_recording": 1,
        "kind": "deflection",
        "data": "data.csv",
        "wrench_frame": "base",
        "displacement_frame": "base",
        "standard_uncertainty": {"displacement_mm": 0.0141, "force_N": round(FORCE * largest, 3), "joint_deg": 0.0005},
    }
    return recording_tables.Table(columns, about)
