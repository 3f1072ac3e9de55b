"""Coverage and width of the 90 % intervals of ``machopt identify`` on arms that have more than joint springs.

``python benchmarks/identify_coverage.py`` draws load tests from the energy simulator (``diagnosis_energy_benchmark``),
which shares no code and no law with machopt. Each arm hides one effect: a soft base, link or tool, or a gear with
play, hysteresis or nonlinear stiffness, that leaves 1, 2.5 or 6 times the noise after a refit of the springs. It prints
how many intervals of the joint springs hold the truth, and of the deflection at six poses of a job: where the load
rises to its value, and where it comes down to it. The width is compared with that of
a fit which knows law and place: with that body fitted beside the springs (``--fit``), or of a gear the same arm without
the effect.

``--draws N`` (default 4) records per effect and size, ``--first K`` the first draw, ``--effects A,B`` only these.
``--diagnose`` asks ``machopt diagnose`` about the hidden effect; the springs then get their intervals from the written
covariance.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "diagnosis_energy_benchmark"))
import channel_dispatch  # noqa: E402
import dual_quaternions as dq  # noqa: E402
import elastic_arm  # noqa: E402
import recording_tables  # noqa: E402
import robot_models  # noqa: E402
from case_catalogue import Case  # noqa: E402
from load_test import LoadTest  # noqa: E402
from load_test_effects import applied  # noqa: E402
from make_cases import draw_case  # noqa: E402

from machopt.commands.diagnose.run import compute_diagnosis  # noqa: E402
from machopt.commands.identify.computation import IdentifyComputation, compute_identification  # noqa: E402
from machopt.data_types.cell import Cell  # noqa: E402
from machopt.data_types.stiffness import ArmStiffness  # noqa: E402
from machopt.errors import InputError  # noqa: E402
from machopt.kinematics.urdf_loading import load_masses, load_robot  # noqa: E402
from machopt.measurement.diagnosis.request import DiagnoseRequest  # noqa: E402
from machopt.measurement.identification.request import IdentifyRequest  # noqa: E402
from machopt.planning.error_probability.model_discrepancy import (  # noqa: E402
    NINETY,
    DiscrepancyModel,
    compute_reported_std,
)
from machopt.stiffness.arm_stiffness import ArmElasticity  # noqa: E402

EFFECTS = (
    "base_compliance",
    "link_compliance",
    "tool_compliance",
    "joint_backlash",
    "joint_hysteresis",
    "joint_nonlinear_stiffness",
)
SIZES = (1.0, 2.5, 6.0)
LABS = ("plain", "full", "one_day")
JOB_POSES, JOB_SHARE = 6, 0.5  # poses of the job; its force per the largest of the load tests
SIDES = {"rising": (0.0, 0.5, 1.0), "falling": (0.0, 1.6, 1.0)}  # force steps per that of the job


@dataclass
class Tally:
    """What the intervals of one effect did."""

    springs: list[bool] = field(default_factory=list)
    rising: list[bool] = field(default_factory=list)
    falling: list[bool] = field(default_factory=list)
    spring_widths: list[float] = field(default_factory=list)  # per that of a fit which knows law and place
    job_widths: list[float] = field(default_factory=list)
    refused: int = 0


@dataclass(frozen=True)
class Job:
    """Poses and forces of a job with the true deflections."""

    q: np.ndarray  # (6, 6) rad
    force: np.ndarray  # (6, 3) N, base axes
    moved: dict[str, np.ndarray]  # (6, 3) m by side of arrival


def build_job(scene: LoadTest, effects: list, rng: np.random.Generator) -> Job:
    """Draw a job about the poses of the load tests, and let the arm as built carry it."""
    build, _ = applied(effects, scene)
    known = np.unique(scene.script.q, axis=0)
    q = known[rng.choice(len(known), JOB_POSES)] + rng.normal(0.0, 0.15, (JOB_POSES, 6))
    way = rng.normal(size=(JOB_POSES, 3))
    force = JOB_SHARE * scene.largest * way / np.linalg.norm(way, axis=1, keepdims=True)
    moved = {}
    for side, steps in SIDES.items():
        count = len(steps)
        share = np.tile(steps, JOB_POSES)[:, None]
        wrench = np.concatenate([share * np.repeat(force, count, axis=0), np.zeros((JOB_POSES * count, 3))], axis=1)
        label = np.repeat(np.arange(JOB_POSES), count)
        time = 15.0 * np.arange(len(label)) + 90.0 * label
        script = elastic_arm.Script(np.repeat(q, count, axis=0), wrench, time, label, label, np.zeros_like(label))
        frames, _ = elastic_arm.solve_rest_states(build, script)
        p = dq.place(frames["tcp"]).reshape(JOB_POSES, count, 3)
        moved[side] = p[:, -1] - p[:, 0]
    return Job(q, force, moved)


@dataclass(frozen=True)
class Answer:
    """Intervals of one identification."""

    springs: dict[int, tuple[float, float]]  # compliance interval by joint, rad/(N·m)
    deflection: np.ndarray  # (6,) m along the predicted deflection
    along: np.ndarray  # (6, 3)
    half: np.ndarray  # (6,) m, half width of the 90 % interval


def identify(folder: Path, fit: tuple[str, ...] = ()) -> IdentifyComputation:
    """Identify the recording of a case, with terms fitted beside the springs."""
    request = IdentifyRequest(
        cell=folder / "cell", recordings=(folder / "recording",), out=folder / "out", studies=False, terms=fit
    )
    return compute_identification(request, lambda _: None)


def read_answer(done: IdentifyComputation, job: Job) -> Answer:
    """Return the intervals of springs and of the deflection at the job."""
    springs = {}
    for j in done.result.joints:
        if j.ci90 is not None:
            low, high = j.ci90
            springs[j.joint] = (0.0 if high is None else 1.0 / high, 1.0 / max(low or 0.0, 1e-300))
    return predict_job(done.cell, done.identification.stiffness, springs, job)


def diagnose(folder: Path, job: Job) -> Answer | None:
    """Return the intervals of the stiffness that ``diagnose`` writes; None where it writes no model discrepancy."""
    request = DiagnoseRequest(cell=folder / "cell", recordings=(folder / "recording",), out=folder / "diagnosed")
    done = compute_diagnosis(request, (), lambda _: None)
    written = done.model
    if written is None or written.discrepancy is None or written.covariance is None:
        return None
    compliance, half = 1.0 / written.joints, NINETY * np.sqrt(np.diag(written.covariance))
    springs = {j + 1: (c - h, c + h) for j, (c, h) in enumerate(zip(compliance, half, strict=True))}
    return predict_job(done.cell, written, springs, job)


def predict_job(cell: Cell, stiffness: ArmStiffness, springs: dict[int, tuple[float, float]], job: Job) -> Answer:
    """Return the predicted deflection at the job with its interval, beside the intervals of the springs."""
    arm = ArmElasticity(  # as a plan builds it
        load_robot(cell), cell.tool.T_flange_tcp, stiffness, cell.arm_limits, load_masses(cell), counted=True
    )
    said = arm.evaluate(job.q).compute_deflection(job.force)
    along = said / np.linalg.norm(said, axis=1, keepdims=True)
    known = DiscrepancyModel.build(arm)
    assert known is not None
    ways = np.einsum("mc,mcr->mr", along, known.moves(arm.evaluate(job.q), job.q, job.force))
    half = NINETY * compute_reported_std(ways, (known.local * np.linalg.norm(job.force, axis=1)) ** 2)
    return Answer(springs, np.einsum("mc,mc->m", said, along), along, half)


def score(folder: Path, case: Case, draw: int, tally: Tally, by_diagnose: bool) -> None:
    """Identify (or diagnose) a case without, and identify it with knowledge of its effect, and count."""
    nominal, scene, quiet, effects, rng = draw_case(case, "dev", draw)
    assert isinstance(scene, LoadTest)
    job = build_job(scene, effects, rng)
    robot_models.write_cell(nominal, folder / "hidden" / "cell")
    robot_models.write_cell(nominal, folder / "plain" / "cell")
    for name, clean in (("hidden", scene.clean(effects)), ("plain", quiet)):
        recording_tables.write(channel_dispatch.table(scene, clean, rng), folder / name / "recording")
    try:
        found = diagnose(folder / "hidden", job) if by_diagnose else read_answer(identify(folder / "hidden"), job)
        if found is None:
            tally.refused += 1
            return
        effect = effects[0]
        known = effect.effect.endswith("_compliance")
        fit = (f"{effect.effect}@{effect.location}",) if known else ()
        plain = read_answer(identify(folder / ("hidden" if known else "plain"), fit), job)
    except InputError as problem:
        tally.refused += 1
        print(f"  {case.key}: {problem}", file=sys.stderr)
        return
    true = 1.0 / scene.built.stiffness
    for j, (low, high) in found.springs.items():
        tally.springs.append(bool(low <= true[j - 1] <= high))
        if j in plain.springs:
            least, most = plain.springs[j]
            tally.spring_widths.append((high - low) / (most - least))
    for side, held in (("rising", tally.rising), ("falling", tally.falling)):
        error = np.abs(np.einsum("mc,mc->m", found.along, job.moved[side]) - found.deflection)
        held.extend((error <= found.half).tolist())
    tally.job_widths += (found.half / plain.half).tolist()


def print_table(tallies: dict[str, Tally]) -> None:
    """Print one row for each effect, and all together."""
    print(f"{'effect':26s} records   springs held  width    job, rising   job, falling  width  refused or no model")
    every = Tally()
    for name, t in [*tallies.items(), ("all", every)]:
        if t is not every:
            for key in ("springs", "rising", "falling", "spring_widths", "job_widths"):
                getattr(every, key).extend(getattr(t, key))
            every.refused += t.refused
        held = [
            f"{sum(v):4d}/{len(v):4d} {100 * np.mean(v):3.0f} %" if v else "-" for v in (t.springs, t.rising, t.falling)
        ]
        wide = [f"{np.median(w):.2f}" if w else "-" for w in (t.spring_widths, t.job_widths)]
        count = len(t.rising) // JOB_POSES
        print(
            f"{name:26s} {count:7d} {held[0]:>14s} {wide[0]:>6s} {held[1]:>14s} {held[2]:>14s} {wide[1]:>6s} "
            f"{t.refused:8d}"
        )


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--effects", default=",".join(EFFECTS))
    parser.add_argument("--diagnose", action="store_true", help="the stiffness that diagnose writes")
    parser.add_argument("--json", type=Path, help="write the counts")
    args = parser.parse_args()
    tallies: dict[str, Tally] = defaultdict(Tally)
    for n, effect in enumerate(EFFECTS):
        if effect not in args.effects.split(","):
            continue
        for m, size in enumerate(SIZES):
            for draw in range(args.first, args.first + args.draws):
                lab = LABS[(n + m + draw) % len(LABS)]
                case = Case("coverage", "load", lab, ((effect, size),), number=draw)
                with tempfile.TemporaryDirectory() as folder:
                    score(Path(folder), case, draw, tallies[effect], args.diagnose)
        print_table({effect: tallies[effect]})
    print_table(tallies)
    if args.json is not None:
        counts = {n: {"springs": t.springs, "rising": t.rising, "falling": t.falling} for n, t in tallies.items()}
        args.json.write_text(json.dumps(counts) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
