"""How near the default choice of external axes is to the best of several runs with other options.

    python benchmarks/external_axis_gap.py [--job CELL TOOLPATH] … [--shipped] [--made-up] [--random N] [--seed S]
                                           [--save FILE] [--keep FOLDER] [--estimates]

``--made-up`` adds six made-up cells (rail, turntable, tilting turntable, rail with either, tilt alone), ``--random`` N
random ones: joints, part, path (weaving passes, closed contours with the tool leaning outwards, holes) and force are
drawn. All of them come from ``tests/external_axis_cells.py``. ``--shipped``, or none of these options, plans the
shipped cells.

Each job is planned by default and with ten variants: lighter and heavier travel of the external joints, one value for
each operation, and joints locked at places of their ranges. Each of them ends with the local refinement over continuous
values. Every J is that of the default's weights, with the index in the default's unit. The table states by how much the
best variant is below the default, in percent of its J; the goal is 1 %, and negative where the default is the best.

The default is planned by ``machopt optimize`` as a process, whose processor time is stated, and checked by ``machopt
verify``. The variants are planned in this process. ``--keep`` keeps the folders of the default.

``--estimates`` measures ``UNSURE`` of :mod:`machopt.planning.external_axis_optimization.refinement_starts` instead.
All candidates of each job are planned in full. The excess of a plan is its value divided by its estimate. The table
states by how much the excess of a candidate falls below the least one of all candidates before it, which is what the
search expects of it.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from external_axis_cells import external_folder

from machopt.cell.cell_reader import load_cell
from machopt.options.plan_option_reader import load_options
from machopt.planning.cache import use_temporary_cache
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axis_optimization import refinement_starts
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.motion.trajectory_builder import has_motion
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
JOBS = (
    (ROOT / "cells/kr500_rail", ROOT / "toolpaths/beam_passes.csv"),
    (ROOT / "cells/kr240_turntable", ROOT / "toolpaths/drum_holes.csv"),
)
WEIGHTS = (0.0, 0.1, 0.3, 0.6, 2.0)
LOCKED = (0.1, 0.35, 0.65, 0.9)  # place in the range of the first joint
KINDS = {  # external joints of the made-up cells, and the path of each
    "rail": ({"rail": True}, "passes"),
    "turntable": ({"table": True}, "contour"),
    "tilting turntable": ({"table": True, "tilt": True}, "contour"),
    "rail and turntable": ({"rail": True, "table": True}, "contour"),
    "turntable, holes": ({"table": True}, "holes"),
    "rail, holes": ({"rail": True}, "holes"),
}
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"
CLEAR, DEPTH = 40.0, 1.0  # mm above and below the part's surface
Row = tuple[float, float, float, float, float, float, str, str, str]


def draw_passes(rng: np.random.Generator, half: tuple[float, float], points: int) -> list[Row]:
    """Return two weaving passes along y over a part of half sizes in mm."""
    rows: list[Row] = []
    wave, period = rng.uniform(0.0, 0.3) * half[0], rng.uniform(0.3, 1.0) * half[1]
    for n, side in enumerate((-0.4, 0.4)):
        y = np.linspace(-0.9, 0.9, points // 2) * half[1] * (1 if n == 0 else -1)
        x = side * half[0] + wave * np.sin(y / period)
        rows += link_cut([(float(a), float(b), 0.0, 0.0, 1.0) for a, b in zip(x, y, strict=True)], f"pass {n + 1}")
    return rows


def draw_contour(rng: np.random.Generator, half: tuple[float, float], points: int) -> list[Row]:
    """Return a closed contour on top of the part, of one or two turns, the tool leaning outwards by up to 25°."""
    turn = np.linspace(0.0, 2 * np.pi * int(rng.integers(1, 3)), points)
    size, lean = rng.uniform(0.4, 0.85, 2) * half, float(np.radians(rng.uniform(0.0, 25.0)))
    start = float(rng.uniform(0.0, 2 * np.pi))
    c, s = np.cos(turn + start), np.sin(turn + start)
    return link_cut(
        [
            (float(size[0] * a), float(size[1] * b), float(np.sin(lean) * a), float(np.sin(lean) * b), np.cos(lean))
            for a, b in zip(c, s, strict=True)
        ],
        "contour",
    )


def draw_holes(rng: np.random.Generator, half: tuple[float, float], points: int) -> list[Row]:
    """Return short strokes along the axis at random places, in a sweep along y."""
    count = max(points // 4, 6)
    places = np.column_stack([rng.uniform(-0.8, 0.8, count) * half[0], np.linspace(-0.85, 0.85, count) * half[1]])
    rows: list[Row] = []
    for x, y in places.tolist():
        for z, move, feed in ((CLEAR, "rapid", ""), (2.0, "approach", "1500"), (-8.0, "cut", "300")):
            rows.append((x, y, z, 0.0, 0.0, 1.0, move, feed, "holes"))
        rows.append((x, y, CLEAR, 0.0, 0.0, 1.0, "retract", "3000", "holes"))
    return rows


def link_cut(places: list[tuple[float, float, float, float, float]], name: str) -> list[Row]:
    """Return a cut through places (x, y, axis) with approach and retract along the axis."""

    def row(place: tuple[float, float, float, float, float], out: float, move: str, feed: str) -> Row:
        x, y, i, j, k = place
        return (x + out * i, y + out * j, out * k, i, j, k, move, feed, name)

    cuts = [row(place, -DEPTH, "cut", "2500") for place in places]
    return [
        row(places[0], CLEAR, "rapid", ""),
        row(places[0], 3.0, "approach", "1500"),
        *cuts,
        row(places[-1], CLEAR, "retract", "3000"),
    ]


DRAWN = {"passes": draw_passes, "contour": draw_contour, "holes": draw_holes}


def make_job(folder: Path, kind: str, seed: int, points: int) -> tuple[Path, Path]:
    """Write a cell and a toolpath; return both.

    Args:
        folder: where to, empty.
        kind: of KINDS; the path's sizes follow from the seed.
        seed: of the path and, above 0, of force and place of the part.
        points: of the cut.
    """
    axes, path = KINDS[kind]
    folder.mkdir()
    external_folder(folder, **axes)
    rng = np.random.default_rng(seed)
    text = (folder / "cell.yaml").read_text(encoding="utf-8")
    if seed:
        force = f"{{axial: {rng.uniform(50, 400):.0f}, normal: {rng.uniform(0, 300):.0f}}}"
        text = text.replace("{axial: 200, normal: 100}", force)
        if "table" in axes:  # the part is elsewhere on the plate
            text = text.replace("xyz_mm: [50, 0, 110]", f"xyz_mm: [{rng.uniform(-120, 120):.0f}, 0, 110]")
        (folder / "cell.yaml").write_text(text, encoding="utf-8")
    half = (200.0, 250.0) if "table" in axes else (200.0, 1200.0)
    rows = DRAWN[path](rng, half, points)
    lines = [",".join(f"{v:.5f}" if isinstance(v, float) else v for v in row) for row in rows]
    toolpath = folder.parent / f"{folder.name}.csv"
    toolpath.write_text("\n".join([HEADER, *lines]) + "\n", encoding="utf-8")
    return folder, toolpath


def list_made_up(folder: Path, random: int, seed: int, made_up: bool, points: int) -> list[tuple[Path, Path]]:
    """Return the made-up jobs, then the random ones."""
    kinds = list(KINDS)
    jobs = [make_job(folder / kind.replace(",", "").replace(" ", "_"), kind, 0, points) for kind in kinds if made_up]
    for n in range(seed, seed + random):
        kind = kinds[int(np.random.default_rng(1000 + n).integers(len(kinds)))]
        jobs.append(make_job(folder / f"random_{n}_{kind.replace(',', '').replace(' ', '_')}", kind, 1 + n, points))
    return jobs


def list_variants(cell_folder: Path) -> dict[str, list[str]]:
    """Return the options of each variant by its name."""
    cell = load_cell(cell_folder)
    out = {f"weight {w:g}": [f"external.{name}.weight={w:g}" for name in cell.external_joints] for w in WEIGHTS}
    out["one value each"] = [f"external.{name}.mode=operation" for name in cell.external_joints]
    name, slides = cell.external_joints[0], cell.external_prismatic[0]
    low, high = float(cell.limits.lower[6]), float(cell.limits.upper[6])
    for share in LOCKED:
        value = low + share * (high - low)
        at = f"at_mm={1e3 * value:.3f}" if slides else f"at_deg={np.degrees(value):.3f}"
        out[f"{name} locked at {share:g}"] = [f"external.{name}.mode=locked", f"external.{name}.{at}"]
    return out


def plan_by_default(cell: Path, toolpath: Path, out: Path) -> tuple[dict[str, object] | None, float, bool]:
    """Return result.json, None where there is no plan, the CPU time in s, and whether the plan passes verification."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "machopt.cli"]
    words = [*command, "optimize", str(cell), str(toolpath), "-o", str(out), "--quiet", "--force"]
    done = subprocess.run(words, cwd=ROOT, check=False, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode:
        return None, cpu, False
    checked = subprocess.run(
        [*command, "verify", str(cell), str(toolpath), str(out)], cwd=ROOT, check=False, capture_output=True
    )
    return json.loads((out / "result.json").read_text(encoding="utf-8")), cpu, checked.returncode == 0


def compute_variant_value(cell: Path, toolpath: Path, words: list[str], unit: float) -> float | None:
    """Return J of a variant with the index in units of ``unit``; None where its plan is not complete."""
    loaded = load_cell(cell)
    options = load_options(loaded.plan, None, words)
    path = read_toolpath(toolpath)
    with use_temporary_cache():
        found = find_best_plan(loaded, path, options)
        if found.breaks or len(found.missing) or not has_motion(found, path):
            return None
    own, w = found.chosen.objective, options.weights
    return float(own.total + (found.scores.scale / unit - 1.0) * (w.mean * own.mean + w.worst * own.worst))


def measure_estimates(jobs: list[tuple[Path, Path]]) -> None:
    """Print by how much a candidate's excess falls below the least one before it: per job, and quantiles over all."""
    tries: list[tuple[Sequence[tuple[refinement_starts.Key, Plan]], int, float]] = []

    def record_try(
        estimate: float, estimates: Sequence[float], planned: Sequence[tuple[refinement_starts.Key, Plan]], count: int
    ) -> bool:
        tries.append((planned, len(planned), estimate))
        return True

    refinement_starts._may_win = record_try
    below: list[float] = []
    print("| job | candidates | excess below the least one before, percent |\n|---|---|---|")
    for folder, toolpath in jobs:
        cell = load_cell(folder)
        options = load_options(cell.plan, None, [])
        tries.clear()
        with use_temporary_cache():
            refinement_starts.find_refinement_starts(
                refinement_starts.SearchRequest(
                    cell=cell,
                    toolpath=read_toolpath(toolpath),
                    options=options,
                    clock=StageTimings(),
                    before=None,
                    axes=resolve_axis_options(cell, options),
                    scale=None,
                )
            )
        least: dict[int, float] = {}
        own: list[float] = []
        for planned, n, estimate in tries:
            lost, value = planned[n][0]
            if lost:
                continue
            if id(planned) in least:
                own.append(100.0 * max(1.0 - value / estimate / least[id(planned)], 0.0))
            least[id(planned)] = min(value / estimate, least.get(id(planned), np.inf))
        below += own
        print(f"| {folder.name} | {len(tries)} | {', '.join(f'{v:.2f}' for v in own)} |", flush=True)
    levels = ", ".join(f"{100 * q:g} %: {np.quantile(below, q):.2f} %" for q in (0.5, 0.75, 0.9, 0.95, 1.0))
    print(f"{len(below)} candidates after the first; quantiles {levels}")


def main() -> None:
    """Read the arguments and run the jobs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--job", nargs=2, type=Path, action="append", default=[])
    parser.add_argument("--shipped", action="store_true", help="the two shipped cells")
    parser.add_argument("--made-up", action="store_true", help="six made-up cells")
    parser.add_argument("--random", type=int, default=0, help="random cells")
    parser.add_argument("--seed", type=int, default=0, help="of the first random cell")
    parser.add_argument("--points", type=int, default=80, help="of each cut of these cells")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for the plans of the default")
    parser.add_argument("--estimates", action="store_true", help="measure the scatter of the estimates instead")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        keep = Path(name) / "kept" if args.keep is None else args.keep
        keep.mkdir(parents=True, exist_ok=True)
        made = list_made_up(keep, args.random, args.seed, args.made_up, args.points)
        given = [(a, b) for a, b in args.job]
        jobs = [*given, *(JOBS if args.shipped or not (given or made) else ()), *made]
        if args.estimates:
            measure_estimates(jobs)
        else:
            compare(jobs, keep, args.save)


def compare(jobs: list[tuple[Path, Path]], keep: Path, save: Path | None) -> None:
    """Plan the jobs with all variants and print the table."""
    rows: list[dict[str, object]] = []
    print(
        "| job | J | best variant | its J | below the default (%) | verified | CPU (s) |\n|---|---|---|---|---|---|---|"
    )
    for cell, toolpath in jobs:
        own, cpu, is_verified = plan_by_default(cell, toolpath, keep / f"out_{cell.name}")
        if own is None:
            print(f"| {cell.name} | no plan |")
            continue
        unit = float(own["index_scale"])  # type: ignore[arg-type]
        mine = float(own["objective"]["chosen"]["total"])  # type: ignore[index]
        found = {
            name: compute_variant_value(cell, toolpath, words, unit) for name, words in list_variants(cell).items()
        }
        values = {name: value for name, value in found.items() if value is not None}
        best = min(values, key=lambda v: values[v], default="")
        gap = 100.0 * (1.0 - values[best] / mine) if best else -np.inf
        rows.append({"job": cell.name, "J": mine, "variants": values, "gap_percent": gap, "verified": is_verified})
        rows[-1]["cpu_s"] = cpu
        least = f"{best} | {values[best]:.4f} | {gap:.2f}" if best else "| |"
        print(f"| {cell.name} | {mine:.4f} | {least} | {'yes' if is_verified else 'no'} | {cpu:.1f} |", flush=True)
        if save:
            save.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    gaps = [float(row["gap_percent"]) for row in rows]  # type: ignore[arg-type]
    if gaps:
        print(f"{len(gaps)} jobs: median {np.median(gaps):.2f} %, worst {max(gaps):.2f} %, CPU {sum_cpu(rows):.0f} s")


def sum_cpu(rows: list[dict[str, object]]) -> float:
    """Return the processor time of the default in s."""
    return sum(float(row["cpu_s"]) for row in rows)  # type: ignore[arg-type, misc]


if __name__ == "__main__":
    main()
