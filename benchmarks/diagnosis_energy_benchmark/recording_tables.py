"""Recordings as the lab writes them: noise put on, units and axes as announced, one CSV and one YAML."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import load_test_effects
import numpy as np
from dual_quaternions import Array
from effect_strength import NoiseFreeRecord
from instrument_noise import errors, rounded
from load_test import LoadTest


@dataclass
class Table:
    """Columns in the order of the file, and what recording.yaml says."""

    columns: dict[str, Array]
    about: dict[str, Any]
    outliers: list[int] = field(default_factory=list)  # 1-based rows spoilt on purpose
    noise: float = 0.0  # r.m.s. of all that is not signal, in the unit of the channel, a coordinate, outliers apart


def load_table(scene: LoadTest, clean: NoiseFreeRecord, rng: np.random.Generator) -> Table:
    """A load test with its instruments' errors."""
    lab, c = scene.lab, clean.columns
    n = len(clean.y)
    S = load_test_effects.axes_of(scene, lab.wrench_frame)
    D = load_test_effects.axes_of(scene, lab.displacement_frame)
    force = np.einsum("nji,nj->ni", S, c["wrench"][:, :3])
    moment = np.einsum("nji,nj->ni", S, c["wrench"][:, 3:])
    moved = 1e3 * np.einsum("nji,nj->ni", D, c["moved"])
    turned = 1e3 * np.einsum("nji,nj->ni", D, c["turned"])
    uncertain = lab.force * scene.largest
    wobble = errors(lab.displacement, c["cycle"], 3, rng)
    gains = 1.0 + lab.session_gain * rng.normal(size=int(c["session"].max()) + 1)
    force = (force + uncertain * rng.normal(size=force.shape)) * gains[c["session"]][:, None]
    moment = (moment + 0.3 * uncertain * rng.normal(size=moment.shape)) * gains[c["session"]][:, None]
    table: dict[str, Array] = {"pose": c["pose"] + 1, "cycle": c["cycle"], "session": c["session"] + 1}
    if lab.clock:
        table["time_s"] = np.round(c["time"], 1)
    q = np.degrees(c["q"])
    table |= {f"q{j + 1}_deg": np.round(q[:, j], 4) for j in range(6)}
    table |= {f"f{a}_N": np.round(force[:, k], 3) for k, a in enumerate("xyz")}
    if lab.moments != "none":
        table |= {f"m{a}_Nm": np.round(moment[:, k], 3) for k, a in enumerate("xyz")}
    outliers: list[int] = []
    if lab.outliers:
        spoilt = rng.choice(n, max(1, round(lab.outliers * n)), replace=False)
        wobble[spoilt] += rng.choice([-1, 1], (len(spoilt), 3)) * rng.uniform(0.2, 0.8, (len(spoilt), 3))
        outliers = sorted(int(r) + 1 for r in spoilt)
    moved = rounded(moved + wobble, lab.displacement.step)
    table |= {f"d{a}_mm": np.round(moved[:, k], 5) for k, a in enumerate("xyz")}
    if lab.turning:
        turned = turned + errors(lab.rotation, c["cycle"], 3, rng)
        table |= {f"r{a}_mrad": np.round(turned[:, k], 5) for k, a in enumerate("xyz")}
    if lab.branch:
        table["branch"] = np.where(c["unloading"], "unload", "load")
    about: dict[str, Any] = {
        "machopt_recording": 1,
        "kind": "deflection",
        "data": "data.csv",
        "wrench_frame": lab.wrench_frame,
        "displacement_frame": lab.displacement_frame,
    }
    if lab.stated:
        sigma = float(np.hypot(lab.displacement.reading, lab.displacement.shared))
        stated = {"displacement_mm": round(sigma, 4), "force_N": round(uncertain, 2), "joint_deg": 0.0005}
        if lab.moments != "none":
            stated["moment_Nm"] = round(0.3 * uncertain, 2)
        if lab.turning:
            stated["rotation_mrad"] = round(float(np.hypot(lab.rotation.reading, lab.rotation.shared)), 4)
        about["standard_uncertainty"] = stated
    total = clean.sigma[:, :3] ** 2 + clean.shared[:, :3] ** 2
    return Table(table, about, outliers, 1e3 * float(np.sqrt(np.mean(total))))


def write(table: Table, folder: Path) -> None:
    """recording.yaml and data.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    for key, value in table.about.items():
        if isinstance(value, dict):
            inner = ", ".join(f"{k}: {list(v) if isinstance(v, list | tuple) else v}" for k, v in value.items())
            lines.append(f"{key}: {{{inner}}}")
        else:
            lines.append(f"{key}: {value}")
    (folder / "recording.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    names = list(table.columns)
    rows = zip(*(table.columns[n] for n in names), strict=True)
    with (folder / "data.csv").open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        for row in rows:
            file.write(",".join(str(v) if isinstance(v, str) else f"{v:.10g}" for v in row) + "\n")
