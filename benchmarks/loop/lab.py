"""The hidden arm of a closed loop: the stranger's physics, what is concealed in it, and its load tests.

Nothing here imports machopt. What a copy of an arm conceals is drawn by its seed; how far its TCP moves under a load is
the difference of two rests of :mod:`arm`, unloaded and loaded, each a load cycle of its own (what a gear remembers of
other cycles does not count in a job either).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "stranger"))
import arm
import concealed_load
import dualquat as dq
import numpy as np
import robots
import tables
from dualquat import Array
from noise import Instrument, errors
from scene import Effect

ARCMIN = np.pi / 10800
KINDS = ("plain", "bodies", "gears", "both")
SETS = {"dev": 100, "sealed": 777_000}
READING = Instrument(0.010, 0.010)  # mm, of a tracker; what a load cycle shares as much again
SHORT = 0.05  # m
FORCE = 0.004  # 1 sigma of a load cell, share of the largest load


@dataclass(frozen=True)
class Hidden:
    """One arm: what its maker says, and how it is."""

    kind: str
    nominal: robots.Robot
    build: arm.Build
    told: str  # what is concealed, in words

    def moves(self, q: Array, wrench: Array) -> Array:
        """(N, 3) m how far the TCP moves from its unloaded state under wrenches (N, 6) in base axes at the TCP."""
        n = len(q)
        twice = np.repeat(q, 2, axis=0)
        load = np.zeros((2 * n, 6))
        load[1::2] = wrench
        cycle = np.repeat(np.arange(n), 2)
        script = arm.Script(twice, load, 60.0 * np.arange(2.0 * n), cycle, cycle, np.zeros(2 * n, dtype=int))
        frames, _ = arm.rest(self.build, script)
        at = dq.place(frames["tcp"])
        return np.asarray(at[1::2] - at[::2])

    def tip(self, q: Array) -> tuple[Array, Array]:
        """(N, 3) m and (N, 3, 3): the TCP of the rigid nominal arm."""
        frames = arm.chain(arm.Build(self.nominal), q, {"joints": np.zeros_like(q)})
        return dq.place(frames["tcp"]), dq.matrix(frames["tcp"])


def hidden(kind: str, seed: int) -> Hidden:
    """An arm by its seed; ``kind``: springs only, bodies that bend beside them, gears that are no springs, or both."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    names = sorted(robots.CATALOGUE)
    nominal = robots.draw(names[seed % len(names)], rng)
    built = robots.as_built(nominal, rng)
    build = arm.Build(built)
    scene: Any = SimpleNamespace(built=built, nominal=nominal)
    told = []

    def conceal(name: str, location: str, amplitude: float, **detail: Any) -> None:
        concealed_load._one(Effect(name, location, amplitude, np.inf, detail=detail), build, scene)
        told.append(f"{name} {location} {amplitude:.3g}")

    if kind in ("bodies", "both"):
        for link in rng.choice([1, 2], size=int(rng.integers(1, 3)), replace=False):
            if np.linalg.norm(built.ends()[link, :3]) < SHORT:  # axes that cross: no link between them
                continue
            conceal("link_compliance", f"link:{link + 1}", rng.uniform(0.15, 0.6), link=int(link), taper=0.7)
        uneven = tuple(float(u) for u in rng.uniform(0.6, 1.6, 3))
        conceal("base_compliance", "base", rng.uniform(0.1, 0.6), uneven=uneven, foot=-1)
    if kind in ("gears", "both"):
        load = test_force(nominal) * nominal.reach()
        j = int(rng.choice([1, 2]))
        knee = 0.15 * load
        conceal("joint_nonlinear_stiffness", f"joint:{j + 1}", rng.uniform(0.3, 1.2), joint=j, knee=knee)
        j = int(rng.choice([0, 1, 2]))
        conceal("joint_backlash", f"joint:{j + 1}", rng.uniform(0.3, 1.2) * ARCMIN, joint=j, drag=0.02 * load)
    return Hidden(kind, nominal, build, ", ".join(told) or "springs only")


def test_force(robot: robots.Robot) -> float:
    """N that move the TCP by about two millimetres."""
    return float(round(4e-3 / (robot.reach() ** 2 * np.mean(1.0 / robot.stiffness[:3])), 1))


def measured(h: Hidden, q: Array, wrench: Array, labels: dict[str, Array], rng: np.random.Generator) -> tables.Table:
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
    return tables.Table(columns, about)
