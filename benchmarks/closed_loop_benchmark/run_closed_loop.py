"""Closed loops: what machopt says of a job against what the hidden arm does.

``python benchmarks/closed_loop_benchmark/run_closed_loop.py --set dev --arms 4 --jobs mill,drill [--diagnose]``

One loop, as a customer goes: the cell with the maker's springs; load tests by ``plan-poses``; ``identify`` (and
``diagnose`` with ``--diagnose``); ``optimize`` with the stiffness that came out, without and with compensation. Then
the arm itself drives the plan: its true deflection at every planning point that is cut. Compared are

gain         the stated 90 % interval of the gain over the CAM's rotation against the true gain
deflection   the mean along the cut, and the worst point: the stated 90 % interval against the truth
removed      the share of the mean error that compensation removes, said and true, and its 90 % interval
left         what it leaves in the mean and at worst, said and true, each with its 90 % interval

Services are called in process, as the command line does; plans are not retimed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices of sixty columns: threads only wait for each other
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
import hidden_arm
import mean_cost_std
import numpy as np
import recording_tables
import robot_models

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import write_stiffness
from machopt.commands.diagnose.run import compute_diagnosis
from machopt.commands.identify.computation import compute_identification
from machopt.commands.plan_poses.computation import compute_pose_plan
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions, ProcessForce
from machopt.data_types.stiffness import ArmStiffness
from machopt.measurement.design.request import PosesRequest
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.measurement.identification.request import IdentifyRequest
from machopt.planning.compensation.expected_deflection_reduction import predict_removals
from machopt.planning.compensation.plan_compensation import compensate_plan
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.uncertainty.stiffness_uncertainty import NINETY, compute_gains
from machopt.toolpath.toolpath_reader import read_toolpath

JOBS = ("mill", "drill")
POSES, CYCLES = 18, 2
ROTATION_STEP = np.radians(15.0)  # the search is quadratic in it, and what is said of the found plan is what counts
LEAST = 0.3  # of a load test's force: the least that the jobs below have


def ignore_progress(_: str) -> None:
    """No progress."""


def cell_of(h: hidden_arm.HiddenArm, folder: Path, stiffness: ArmStiffness | None = None) -> Path:
    """The customer's cell; CAM coordinates are those of the base."""
    robot_models.write_cell(h.nominal, folder)
    text = (folder / "cell.yaml").read_text(encoding="utf-8").replace("xyz_mm: [1500, 0, 500]", "xyz_mm: [0, 0, 0]")
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    if stiffness is not None:
        write_stiffness(folder / "stiffness.yaml", stiffness)
    return folder / "cell.yaml"


def job(h: hidden_arm.HiddenArm, kind: str, rng: np.random.Generator, folder: Path) -> tuple[Path, ProcessForce]:
    """About 60 points around the home pose, gamma = 0 at its rotation; a force a third to all of a load test's."""
    at, R = (x[0] for x in h.tip(h.nominal.home[None]))
    axis, across, along = -R[:, 2], R[:, 1], R[:, 0]
    size = 0.12 * h.nominal.reach()
    rows = []
    head = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation,rx,ry,rz"
    tail = ",".join(f"{v:.9f}" for v in along)

    def row(p: np.ndarray, move: str, label: str) -> None:
        place = ",".join(f"{v:.6f}" for v in (*(1e3 * p), *axis))
        rows.append(f"{place},{move},600,{label},{tail}")

    if kind == "mill":
        for k, s in enumerate(np.linspace(-1.0, 1.0, 60)):
            p = at + size * (s * along + 0.4 * np.cos(2.5 * s) * across)
            row(p, "rapid" if k == 0 else "cut", "contour")
    else:
        for k, (a, b) in enumerate(np.stack(np.meshgrid(np.linspace(-1, 1, 5), [-0.6, 0.0, 0.6]), -1).reshape(-1, 2)):
            p = at + size * (a * along + b * across)
            row(p + 0.02 * axis, "rapid", f"hole {k + 1}")
            row(p, "cut", f"hole {k + 1}")
            row(p + 0.02 * axis, "retract", f"hole {k + 1}")
    path = folder / f"{kind}.csv"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    force = hidden_arm.test_force(h.nominal) * rng.uniform(LEAST, 1.0)
    if kind == "drill":
        return path, ProcessForce(axial=force)
    way = rng.normal(size=3)
    way[2] = abs(way[2])
    way *= force / np.linalg.norm(way)
    return path, ProcessForce(*(float(v) for v in way))


def compute_true_deflection(h: hidden_arm.HiddenArm, p: Plan, q: np.ndarray) -> np.ndarray:
    """(P, 3) m: the arm's own deflection at planning points under the plan's force; zero where nothing is cut."""
    out = np.zeros((len(q), 3))
    rows = np.flatnonzero(p.path.counted & np.isfinite(q).all(axis=1))
    force = p.directions.force[rows]
    out[rows] = h.moves(q[rows], np.concatenate([force, np.zeros_like(force)], axis=1))
    return out


def compute_residual_error(h: hidden_arm.HiddenArm, p: Plan) -> tuple[float, float, float]:
    """Mean of what a compensation leaves and of the deflection, and the worst left, m: at the places and under the
    force of :func:`machopt.planning.compensation.shifted_path.compute_residual`."""
    assert p.compensation is not None
    q, path, offset = p.chosen.assignment.q, p.path, p.compensation.offset
    end = 1 + np.flatnonzero(path.counted[1:] & (path.run[1:] == path.run[:-1]))
    length = np.linalg.norm(path.position[end] - path.position[end - 1], axis=1)
    force = p.directions.force[end - 1]
    left, bent, worst = 0.0, 0.0, 0.0
    for share, rule in zip((0.0, 0.25, 0.5, 0.75, 1.0), (0.125, 0.25, 0.25, 0.25, 0.125), strict=True):
        between, shift = (x[end - 1] + share * (x[end] - x[end - 1]) for x in (q, offset))
        d = h.moves(between, np.concatenate([force, np.zeros_like(force)], axis=1))
        rest = np.linalg.norm(shift + d, axis=1)
        left += rule * float(length @ rest) / float(length.sum())
        bent += rule * float(length @ np.linalg.norm(d, axis=1)) / float(length.sum())
        worst = max(worst, float(rest.max()))
    return left, bent, worst


def loop(h: hidden_arm.HiddenArm, cell: Cell, path: Path, force: ProcessForce) -> dict[str, Any] | None:
    """One plan, said against true."""
    toolpath = read_toolpath(path)
    options = PlanOptions(
        index="deflection", force=force, collision=False, rotation_step=ROTATION_STEP, compensation_max=0.01
    )
    found = plan_path(cell, toolpath, options)
    gain = compute_gains(found)[0]
    if not np.isfinite(gain.mean) or len(found.missing):
        return None
    w = found.path.weight
    bent = compute_true_deflection(h, found, found.chosen.assignment.q)
    other = compute_true_deflection(h, found, found.cam_default.assignment.q)
    size, beside = np.linalg.norm(bent, axis=1), np.linalg.norm(other, axis=1)
    said = np.where(found.path.counted, found.chosen.cost, 0.0)
    out: dict[str, Any] = {
        "gain": {"said": gain.mean, "std": gain.std, "true": 1.0 - float(w @ size) / float(w @ beside)},
        "mean": {"said": float(w @ said), "true": float(w @ size)},
    }
    out["mean"]["std"], stds = mean_cost_std.compute_mean_cost_std(found)
    worst = int(np.argmax(said))
    out["worst"] = {"said": float(said[worst]), "std": float(stds[worst]), "true": float(size[worst])}
    shifted = compensate_plan(found, toolpath)
    if not len(shifted.missing) and shifted.compensation is not None:
        from machopt.planning.compensation.shifted_path import compute_residual

        told = compute_residual(shifted)
        left, bent, worst_left = compute_residual_error(h, shifted)
        assert told is not None
        out["removed"] = {
            "said": 1.0 - told.mean / told.uncompensated,
            "true": 1.0 - left / bent,
            "worst_said": told.worst,
            "worst_true": worst_left,
        }
        sure = predict_removals(shifted, toolpath.operation, tuple(o.label for o in toolpath.operations))[0]
        out["removed"] |= {"ci90": sure.removed90, "worst90": sure.worst90}
        out["left"] = {"mean90": sure.left90, "mean_true": left, "worst90": sure.worst90, "worst_true": worst_left}
        out["left"]["bent_true"] = bent
    return out


def measure(h: hidden_arm.HiddenArm, maker: Path, folder: Path, rng: np.random.Generator) -> None:
    """Load tests by plan-poses, into folder/recording."""
    pull = hidden_arm.test_force(h.nominal)
    request = PosesRequest(
        cell=maker, out=folder / "poses", poses=POSES, loads=3, cycles=CYCLES, pull_N=(0.5 * pull, pull),
        candidates=400, starts=1, floor_mm=-5000.0, ceiling_mm=9000.0, arms_mm=(0.0,), no_collision=True,
        target_percent=None, max_nu_p=0.5, max_nu_r_deg=5.0, force_N=(LEAST * pull, pull),
    )  # fmt: skip
    tests = compute_pose_plan(request, ignore_progress).table
    assert tests is not None
    labels = {k: getattr(tests, k) for k in ("pose", "cycle", "session")}
    recording_tables.write(hidden_arm.simulate_load_tests(h, tests.q, tests.wrench, labels, rng), folder / "recording")


def loops(kind: str, seed: int, jobs: tuple[str, ...], diagnose: bool, folder: Path) -> list[dict[str, Any]]:
    """Everything of one arm."""
    h = hidden_arm.build_hidden_arm(kind, seed)
    rng, work = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2])
    maker = cell_of(h, folder / "maker")
    if not (folder / "recording").exists():
        measure(h, maker, folder, rng)

    models: dict[str, ArmStiffness] = {}
    ask = IdentifyRequest(cell=maker, recordings=(folder / "recording",), out=folder / "identified", studies=False)
    models["identify"] = compute_identification(ask, ignore_progress).identification.stiffness
    verdict = ""
    if diagnose:
        found = compute_diagnosis(
            DiagnoseRequest(cell=maker, recordings=(folder / "recording",), out=folder / "diagnosed"),
            (),
            ignore_progress,
        )
        verdict = (
            found.diagnosis.verdict + ": " + "; ".join(f"{f.effect} {f.location}" for f in found.diagnosis.findings)
        )
        if found.model is not None:
            models["diagnose"] = found.model
    out = []
    cells = {by: load_cell(cell_of(h, folder / by, stiffness)) for by, stiffness in models.items()}
    for name in jobs:
        path, force = job(h, name, work, folder)
        for by, cell in cells.items():
            result = loop(h, cell, path, force)
            if result is not None:
                head = {"arm": h.nominal.name, "seed": seed, "kind": kind, "job": name, "by": by, "concealed": h.told}
                out.append(head | ({"verdict": verdict} if by == "diagnose" else {}) | result)
    return out


def is_truth_in_interval(part: dict[str, Any]) -> bool | None:
    """Whether a stated 90 % interval holds the truth; None: none is stated."""
    if not np.isfinite(part.get("std", np.nan)):
        return None
    return bool(abs(part["true"] - part["said"]) <= NINETY * part["std"])


def line(r: dict[str, Any]) -> str:
    """One loop on one line."""
    g, m, c = r["gain"], r["mean"], r.get("removed")
    words = f"{r['kind']:7s} {r['arm']:10s} {r['seed']:6d} {r['job']:5s} {r['by']:8s} "
    words += f"gain {100 * g['said']:5.1f} ± {100 * g['std']:4.1f} true {100 * g['true']:5.1f} %  "
    words += f"mean {1e3 * m['said']:.3f} ± {1e3 * m['std']:.3f} true {1e3 * m['true']:.3f} mm  "
    if c is not None:
        words += f"removed {100 * c['said']:5.1f}"
        if c["ci90"] is not None:
            words += " [{:.1f}, {:.1f}]".format(*(100 * v for v in c["ci90"]))
        words += f" true {100 * c['true']:5.1f} %"
    return words + (f"  {r['verdict']}" if "verdict" in r else "")


def counted(held: int, of: int) -> str:
    """``held/of [low, high]``: the 95 % interval of the share, Clopper & Pearson 1934, in percent."""
    from scipy.stats import beta

    low = beta.ppf(0.025, held, of - held + 1) if held else 0.0
    high = beta.ppf(0.975, held + 1, of - held) if held < of else 1.0
    return f"{held}/{of} [{100 * low:.0f}, {100 * high:.0f}]" if of else "-"


def table(results: list[dict[str, Any]]) -> str:
    """Coverage with counts, by kind and model, and how far what is said is off in the middle of the loops."""
    heads = ("gain held", "mean held", "worst held", "removed held", "left held", "left worst held")
    out = [f"{'kind':7s} {'by':8s} {'loops':>5s}  " + "  ".join(f"{h:>16s}" for h in heads) + "  mean off  removed"]
    keys = sorted({(r["kind"], r["by"]) for r in results})
    for kind, by in [*keys, *(("all", b) for b in sorted({k[1] for k in keys})), ("all", "all")]:
        mine = [r for r in results if kind in (r["kind"], "all") and by in (r["by"], "all")]
        cells = []
        for what in ("gain", "mean", "worst"):
            known = [h for h in (is_truth_in_interval(r[what]) for r in mine) if h is not None]
            cells.append(counted(sum(known), len(known)))
        told = [r["removed"] for r in mine if r.get("removed", {}).get("ci90")]
        cells.append(counted(sum(c["ci90"][0] <= c["true"] <= c["ci90"][1] for c in told), len(told)))
        left = [r["left"] for r in mine if r.get("left", {}).get("mean90")]
        for what in ("mean", "worst"):
            held = [one[f"{what}90"][0] <= one[f"{what}_true"] <= one[f"{what}90"][1] for one in left]
            cells.append(counted(sum(held), len(held)))
        off = 100 * float(np.median([abs(r["mean"]["said"] / r["mean"]["true"] - 1.0) for r in mine]))
        gone = f"{100 * float(np.median([c['true'] for c in told])):.1f} %" if told else "-"
        out.append(
            f"{kind:7s} {by:8s} {len(mine):5d}  " + "  ".join(f"{c:>16s}" for c in cells) + f"  {off:6.2f} %  {gone}"
        )
    return "\n".join(out)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=sorted(hidden_arm.SETS), default="dev")
    parser.add_argument("--arms", type=int, default=4, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first arm")
    parser.add_argument("--kinds", default=",".join(hidden_arm.KINDS))
    parser.add_argument("--jobs", default=",".join(JOBS))
    parser.add_argument("--diagnose", action="store_true", help="also with the stiffness that diagnose writes")
    parser.add_argument("--work", type=Path, help="folder for cells and recordings, which are taken up again")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    results: list[dict[str, Any]] = []
    for kind in asked.kinds.split(","):
        for n in range(asked.first, asked.first + asked.arms):
            with tempfile.TemporaryDirectory() as temporary:
                seed = hidden_arm.SETS[asked.set] + n
                folder = Path(temporary) if asked.work is None else asked.work / f"{kind}-{seed}"
                some = loops(kind, seed, tuple(asked.jobs.split(",")), asked.diagnose, folder)
            for r in some:
                print(line(r), flush=True)
            results += some
    print(table(results))
    if asked.json is not None:
        asked.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
