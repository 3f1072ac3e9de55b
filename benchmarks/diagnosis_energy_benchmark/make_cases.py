"""Makes cases: ``python benchmarks/diagnosis_energy_benchmark/make_cases.py --set dev --out out/energy``.

Writes OUT/<case>/cell and OUT/<case>/recording, all that a diagnosis may see, and OUT/<case>.truth.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import channel_dispatch
import numpy as np
import recording_faults
import recording_tables
import robot_models
from case_catalogue import SETS, Case, chosen
from effect_strength import Effect, NoiseFreeRecord, Scene, list_accepted_names, scale_effect

ENOUGH = 0.7  # of the loudness wanted: the next place is not tried
TRIED = 3  # places
LARGE_CAP = 2.0  # times the ordinary largest size of an effect: worn and broken arms
SOLID = ("joint_creep",)  # nothing solid creeps by more than it yields at once
MASS_SPREAD = 0.05  # 1 sigma of a link's mass about the URDF's, in the groups ``mass_null`` and ``mass_single``
DRAWN = 20  # robots, until one has a place for every effect


class NoPlaceError(ValueError):
    """No joint, link or body of this robot can have the effect in this record."""


def pick(
    scene: Scene,
    wanted: tuple[str, float],
    quiet: NoiseFreeRecord,
    taken: set[str],
    rng: np.random.Generator,
    *,
    is_large: bool = False,
) -> Effect:
    """An effect at the first place where it can be loud enough, else at the best of those tried."""
    best: tuple[float, Effect] | None = None
    name, loud = wanted
    for one in [e for e in channel_dispatch.draw(scene, name, rng, loud) if e.location not in taken][:TRIED]:
        one.is_before_refit, one.cap = is_large, one.cap * (LARGE_CAP if is_large and name not in SOLID else 1.0)
        after = scale_effect(scene, one, quiet)
        if best is None or after > best[0]:
            best = (after, one)
        if after >= ENOUGH * loud:
            break
    if best is None:
        raise NoPlaceError(f"{name} has no place in this record")
    return best[1]


def describe_truth(scene: Scene, effect: Effect, quiet: NoiseFreeRecord) -> dict[str, Any]:
    """One effect in the truth file."""
    names, figures = list_accepted_names(scene, effect, quiet)
    strength = figures["noncentrality"]
    size = {"value": effect.size(), "unit": effect.unit or "own"}
    return {
        "effect": effect.effect,
        "location": effect.location,
        "law": str(effect.detail.get("law", "")),
        "memory": str(effect.detail.get("memory", "")) if effect.effect == "joint_hysteresis" else "",
        "size": size,
        "parameters": {effect.parameter: size} if effect.parameter else {},
        "accepted": [list(n) for n in names],
        "noncentrality": strength,
        "absorbed": figures["rms_after_sigma"] < 0.03 * figures["before_sigma"] or strength < 3.0,
        "visible": {k: v for k, v in figures.items() if k != "noncentrality"},
    }


def draw_case(
    case: Case, which: str, draw: int
) -> tuple[robot_models.Robot, Scene, NoiseFreeRecord, list[Effect], np.random.Generator]:
    """The cell's arm, the scene of the arm as built, its record with nothing concealed, what is, and the generator."""
    rng = np.random.default_rng(case.seed(which, draw))
    for left in reversed(range(DRAWN)):
        nominal = robot_models.draw(str(rng.choice(list(robot_models.CATALOGUE))), rng)
        built = robot_models.as_built(nominal, rng, MASS_SPREAD if case.group.startswith("mass") else 0.0)
        scene = channel_dispatch.scene(case.channel, case.lab, nominal, built, rng)
        quiet = scene.clean([])
        effects: list[Effect] = []
        try:
            for wanted in case.effects:
                taken = {e.location for e in effects}
                effects.append(pick(scene, wanted, quiet, taken, rng, is_large=case.group.startswith("large")))
            break
        except NoPlaceError:  # a gear that weight keeps on one side has no play: another robot, another motion
            if not left:
                raise
    return nominal, scene, quiet, effects, rng


def make(job: tuple[Case, str, int, Path]) -> tuple[str, str, int, float]:
    """One case; returns folder, key, readings, seconds."""
    case, which, draw, out = job
    start = perf_counter()
    nominal, scene, quiet, effects, rng = draw_case(case, which, draw)
    clean = scene.clean(effects)
    table = channel_dispatch.table(scene, clean, rng)
    said = [describe_truth(scene, e, quiet) for e in effects]
    own = _own_refit(scene, table, clean)
    cell = nominal
    if case.fault:
        names = [("geometry", "tool"), *_TOOL] if case.fault == "tcp_length" else _spoil(case.fault, table, rng)
        if case.fault == "tcp_length":
            cell = replace(nominal, tcp=nominal.tcp + np.r_[0, 0, 0.06 * nominal.reach(), 0, 0, 0])
        first = names[0]
        said = [
            {
                "effect": first[0],
                "location": first[1],
                "size": {"value": 1.0, "unit": "own"},
                "parameters": {},
                "accepted": [list(n) for n in names],
                "noncentrality": None,
                "absorbed": False,
            }
        ]
    robot_models.write_cell(cell, out / case.name / "cell")
    recording_tables.write(table, out / case.name / "recording")
    truth = {
        "case": case.name,
        "key": case.key,
        "set": which,
        "seed": draw,
        "group": case.group,
        "channel": scene.channel,
        "lab": case.lab,
        "robot": nominal.name,
        "fault": case.fault,
        "ugly": case.lab in channel_dispatch.DISTURBED,
        "repeats": channel_dispatch.repeats(scene),
        "effects": said,
        "ambient": channel_dispatch.ambient(scene),
        "outlier_rows": table.outliers,
        "oracle": {"rmse": table.noise, "unit": scene.unit},
        "springs_leave": float(np.linalg.norm(quiet.left())),
        "own_refit": own,
    }
    (out / f"{case.name}.truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return case.name, case.key, len(clean.y), perf_counter() - start


_TOOL = [("load_geometry", "sensor:force"), ("displacement_frame", "sensor:displacement"), ("columns", "column:dx_mm")]


def _spoil(name: str, table: recording_tables.Table, rng: np.random.Generator) -> list[tuple[str, str]]:
    for fault in [
        *recording_faults.LOAD_FAULTS,
        *recording_faults.POSE_FAULTS,
        *recording_faults.NEST_FAULTS,
        *recording_faults.MOTION_FAULTS,
    ]:
        if fault.name == name:
            return fault.spoil(table, rng)
    raise ValueError(f"{name}: no such fault")


def _own_refit(scene: Scene, table: recording_tables.Table, clean: NoiseFreeRecord) -> float:
    """Residual of the springs' refit of the noisy record over its noise, before any fault: 1 for a null."""
    y = channel_dispatch.measured(scene, table, clean)
    rows = np.ones(len(y), dtype=bool)
    rows[np.array(table.outliers, dtype=int) - 1] = False
    part = NoiseFreeRecord({}, y[rows], clean.base[rows], clean.sigma[rows], clean.shared[rows], clean.groups[rows])
    left = part.left()
    return float(np.sqrt(np.sum(left**2) / max(len(left) - clean.base.shape[2], 1)))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=sorted(SETS), default="dev")
    parser.add_argument("--seed", type=int, default=0, help="another draw of the whole set, from 1")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[], metavar="PATTERN", help="keys or folders, e.g. 'null/*'")
    parser.add_argument("--fast", action="store_true", help="a subset of about thirty")
    parser.add_argument("--share", type=float, default=1.0, help="an even share of the cases, fixed by their names")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(arguments)
    listed = chosen(options.only, options.fast, options.share)
    if not listed:
        print("no case matches", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    jobs = [(c, options.set, options.seed, options.out) for c in listed]
    start = perf_counter()
    with ProcessPoolExecutor(options.jobs) as pool:
        for name, key, readings, seconds in pool.map(make, jobs):
            print(f"{name}  {key}  {readings} readings  {seconds:.1f} s", flush=True)
    print(f"{len(jobs)} cases, {perf_counter() - start:.0f} s -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
