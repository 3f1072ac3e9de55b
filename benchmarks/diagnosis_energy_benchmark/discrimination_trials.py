"""Test whether the proposed next experiment separates rival explanations.

Run: ``python benchmarks/diagnosis_energy_benchmark/discrimination_trials.py --cases 10 --out out/split``.

Load tests of this lab whose diagnosis ends in a set of rivals that holds the truth. ``plan-poses --discriminate`` says
what to measure next; the lab measures it, on the arm as it is and on an arm that has a rival instead (of its places,
forms and sizes the one that the first record tells least from the truth), and diagnoses the new record alone, and with
the first. Counted is how often what is concealed is named, or stands in its set, and the other is excluded; where the
plan says that a pair is told apart, nine in ten are promised.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import channel_dispatch
import elastic_arm
import make_cases
import numpy as np
import recording_tables
import robot_models
import run_energy_benchmark
from case_catalogue import SETS, Case, load_cases
from dual_quaternions import Array, place, turning
from effect_strength import Effect, NoiseFreeRecord, list_accepted_names, scale_effect
from load_test import LoadTest
from load_test_effects import applied, record_changes
from loading_rig import Lab

ALIKE = 0.6  # cosine of what two effects leave of the first record: below it is another rival than the diagnosis means
FORMS = 12  # of a rival tried
BETWEEN, HOLD = 90.0, 10.0  # s
Name = tuple[str, str]


class Next(LoadTest):
    """The load tests of a plan on the arm of another scene."""

    def __init__(self, of: LoadTest, rows: list[dict[str, str]], rng: np.random.Generator) -> None:
        self.of, self.rows = of, rows
        moments = any(float(r[f"m{a}_Nm"]) for r in rows for a in "xyz")
        lab: Lab = replace(
            of.lab, wrench_frame="base", displacement_frame="base", moments="lever" if moments else "none", outliers=0.0
        )
        super().__init__(of.nominal, of.built, lab, rng)

    def _design(self, rng: np.random.Generator) -> tuple[elastic_arm.Script, Array, Array, Array, Array]:
        self.largest = self.of.largest  # an instrument errs as it did
        out: list[tuple[Any, ...]] = []
        clock, visit, cycle, first, before, share = 0.0, 0, 0, 0, ("", "", ""), 0.0
        for row in self.rows:
            at = (row["session"], row["pose"], row["cycle"])
            q = np.radians([float(row[f"q{j}_deg"]) for j in range(1, 7)])
            load = np.array([float(row[f"f{a}_N"]) for a in "xyz"] + [float(row[f"m{a}_Nm"]) for a in "xyz"])
            session, pose = int(row["session"]) - 1, int(row["pose"]) - 1
            if at != before:
                visit += at[:2] != before[:2]
                cycle += 1
                clock += BETWEEN + (50_000.0 if at[0] != before[0] else 0.0)
                first, share, before = len(out), 0.0, at
                out.append((q, np.zeros(6), clock, visit, cycle, session, first, pose, False, False))
            clock += HOLD * rng.uniform(0.9, 1.1)
            size = float(np.linalg.norm(load))
            out.append((q, load, clock, visit, cycle, session, first, pose, True, size < share))
            share = size
        q, w, t, v, c, s, zero, pose_of, shown, back = (np.array(x) for x in zip(*out, strict=True))
        return elastic_arm.Script(q, w, t, v, c, s), zero, pose_of, shown, back

    def clean(self, effects: list[Effect]) -> NoiseFreeRecord:
        build, _ = applied(effects, self.of)  # the same arm
        _, script = applied([e for e in effects if e.effect == "load_geometry"], self)
        frames, _ = elastic_arm.solve_rest_states(build, script)
        p, tip = place(frames["tcp"]), frames["tcp"]
        moved, turned = (p - p[self.zero])[self.shown], turning(tip, tip[self.zero])[self.shown]
        return self._clean(*record_changes(effects, self, self.script.wrench[self.shown], moved, turned))


def rival(
    scene: LoadTest, name: Name, quiet: NoiseFreeRecord, truth: Effect, rng: np.random.Generator
) -> Effect | None:
    """The form of a rival that this record tells least from the truth; None where all differ, or the lab has none."""
    rest = scene.clean([truth]).left() - quiet.left()
    best: tuple[float, Effect] | None = None
    for _ in range(FORMS):
        try:
            forms = channel_dispatch.draw(scene, name[0], rng, float(np.sqrt(np.mean(rest**2))))
        except ValueError:
            return None
        for one in [e for e in forms if e.location == name[1]]:
            scale_effect(scene, one, quiet)
            other = scene.clean([one]).left() - quiet.left()
            alike = float(rest @ other) / max(float(np.linalg.norm(rest)) * float(np.linalg.norm(other)), 1e-30)
            if best is None or alike > best[0]:
                best = alike, one
    return best[1] if best is not None and best[0] >= ALIKE else None


def machopt(*words: str) -> int:
    """The command; its exit code."""
    path = os.pathsep.join(p for p in (str(run_energy_benchmark.ROOT), os.environ.get("PYTHONPATH", "")) if p)
    room = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-m", "machopt.cli", *words, "--quiet"], env=room, check=False)
    return done.returncode


def open_sets(said: dict[str, Any], names: set[Name]) -> list[Name]:
    """The rivals left beside the truth; empty where no set holds it."""
    for f in said["findings"]:
        one_of = [(e, p) for e, p in f["one_of"]]
        if len(one_of) > 1 and names & set(one_of):
            return [n for n in one_of if n not in names]
    return []


def is_discriminated(folder: Path, names: set[Name], other: Name) -> bool:
    """What is concealed is named or in its set, and the other is not."""
    said = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    sets = [{(e, p) for e, p in f["one_of"]} for f in said["findings"]]
    return any(names & s for s in sets) and not any(other in s for s in sets)


def plan_next_measurement(folder: Path, scene: LoadTest, poses: int) -> dict[str, Any] | None:
    """Plan.json of the next measurement by the command, in folder/next."""
    pulls = f"{0.5 * scene.largest:.0f},{scene.largest:.0f}"
    free = ("--no-collision", "--floor-mm", "-5000", "--ceiling-mm", "9000", "--max-nu-p", "0.5", "--max-nu-r-deg", "5")
    size = ("--poses", str(poses), "--candidates", "400", "--starts", "1", "--pull-N", pulls)
    where = ("plan-poses", str(folder / "cell"), "--discriminate", str(folder / "out"), "-o", str(folder / "next"))
    if machopt(*where, *free, *size):
        return None
    plan: dict[str, Any] = json.loads((folder / "next" / "plan.json").read_text(encoding="utf-8"))
    return plan


def one(case: Case, which: str, draw: int, out: Path, poses: int) -> list[dict[str, Any]]:
    """Everything of one case; empty where its diagnosis leaves no rival."""
    nominal, scene, quiet, effects, rng = make_cases.draw_case(case, which, draw)
    assert isinstance(scene, LoadTest)
    (truth,) = effects
    folder = out / case.name
    if not (folder / "out" / "diagnosis.json").is_file():
        robot_models.write_cell(nominal, folder / "cell")
        recording_tables.write(channel_dispatch.table(scene, scene.clean(effects), rng), folder / "recording")
        run_energy_benchmark.diagnose(folder, [])
    file = folder / "out" / "diagnosis.json"
    if not file.is_file():
        return []
    names = set(list_accepted_names(scene, truth, quiet)[0])
    rivals = open_sets(json.loads(file.read_text(encoding="utf-8")), names)
    if not rivals:
        return []
    plan = plan_next_measurement(folder, scene, poses)
    if plan is None or "discriminate" not in plan:
        return [{"case": case.key, "rivals": rivals, "plan": None}]
    with (folder / "next" / "poses.csv").open(encoding="utf-8") as rows:
        scene_next = Next(scene, list(csv.DictReader(rows)), np.random.default_rng([draw, 1]))
    results: list[dict[str, Any]] = []
    for pair in plan["discriminate"]["pairs"]:
        both = {(pair[k]["effect"], pair[k]["location"]) for k in ("one", "two")}
        other = [n for n in both if n in rivals]
        if len(other) != 1 or not both & names:
            continue
        instead = rival(scene, other[0], quiet, truth, np.random.default_rng([draw, 2]))
        mine = {"case": case.key, "pair": pair["words"], "told_apart": pair["told_apart"], "truths": []}
        mine |= {"until": pair["cycles_until_diagnose_excludes"], "cycles": plan["discriminate"]["cycles"]}
        mine |= {"noncentrality": pair["noncentrality_planned"], "readings": plan["readings"]}
        for concealed, against in ((truth, other[0]), (instead, (truth.effect, truth.location))):
            if concealed is None:
                continue
            right = names if concealed is truth else {other[0]}
            label = f"{concealed.effect}-{concealed.location}".replace(":", "")
            noise = np.random.default_rng([draw, 3, zlib.crc32(f"{case.key} {label}".encode())])
            there = folder / label
            recording_tables.write(
                recording_tables.load_table(scene_next, scene_next.clean([concealed]), noise), there / "recording"
            )
            answer: dict[str, Any] = {"concealed": [concealed.effect, concealed.location]}
            first = folder / "recording"
            if concealed is not truth:  # the other arm's own
                first = there / "first"
                recording_tables.write(channel_dispatch.table(scene, scene.clean([concealed]), noise), first)
            for how, records in (("alone", ()), ("together", (first,))):
                words = [str(folder / "cell"), *map(str, records), str(there / "recording")]
                code = machopt("diagnose", *words, "-o", str(there / how))
                answer[how] = bool(not code and is_discriminated(there / how, right, against))
            mine["truths"].append(answer)
        results.append(mine)
        print(json.dumps(mine), flush=True)
    return results


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=sorted(SETS), default="dev")
    parser.add_argument("--seed", type=int, default=601, help="draw")
    parser.add_argument("--cases", type=int, default=10, help="that end in a set of rivals")
    parser.add_argument("--poses", type=int, default=12, help="of the next measurement")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    found: list[list[dict[str, Any]]] = []
    for case in [c for c in load_cases() if c.group == "single"]:
        some = one(case, asked.set, asked.seed, asked.out, asked.poses)
        if some:
            found.append(some)
        if len(found) >= asked.cases:
            break
    pairs = [r for some in found for r in some if r.get("truths")]
    (asked.out / "split.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    for what, mine in (("promised", True), ("not promised", False)):
        said = [t for r in pairs if r["told_apart"] is mine for t in r["truths"]]
        alone, whole = [t["alone"] for t in said], [t["together"] for t in said]
        print(
            f"{what}: told apart alone {sum(alone)} of {len(alone)}, with the first record {sum(whole)} of {len(whole)}"
        )
    print(f"{len(found)} cases with a set of rivals, {len(pairs)} pairs")


if __name__ == "__main__":
    main()
