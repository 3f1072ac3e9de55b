"""``machopt place`` with a process: positions are compared first by the number of holes and points within tolerance."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import machopt
from machopt.cli import main
from machopt.commands.place.request import PlaceRequest
from machopt.commands.place.site_loading import build_placement_site, read_request_files
from machopt.data_types.process_columns import OUTCOMES, ToleranceSummary
from machopt.placement import placement_estimate
from machopt.placement.journal import SearchJournal
from machopt.placement.placed_outcomes import add_outcomes, summarise_outcomes
from machopt.placement.placement_site import PlacementSite
from machopt.placement.search_options import NO_SHIFT, PlacementShift
from machopt.placement.search_result import PlacementCandidate, PlacementSearchResult, PlannedPlacement, can_beat
from machopt.placement.tolerance_estimate import BOUND_DRAWS, SAMPLING_SIGMAS, ToleranceEstimator

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
PROCESS = """machopt_process: 1
quantile: 0.9
materials:
  al: {drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300, thrust_spread_percent: 30,
    torque_spread_percent: 25, source: t}}
operations:
  default: {kind: drilling, spindle_rpm: 4000, layers: [{material: al, thickness_mm: 4}], depth_mm: 7,
    tolerance: {position_mm: 0.3, axis_deg: 0.5, depth_mm: 2.5, reference: relative}}
"""
HOLES = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},{y},{z},0,0,1,{move},{feed},holes"
    for x, y in ((-150, -400), (-50, -200), (50, 200), (150, 420))
    for z, move, feed in ((40, "rapid", ""), (25, "rapid", ""), (0, "cut", 420), (40, "retract", ""))
)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a cell without process, and a process.yaml outside it."""
    folder = tmp_path_factory.mktemp("job")
    shutil.copytree(CELL, folder / "cell")
    (folder / "other").mkdir()
    (folder / "other" / "mine.yaml").write_text(PROCESS)
    (folder / "holes.csv").write_text(HOLES)
    return folder


def load_site(
    job: Path, text: str = PROCESS, direct: dict[str, object] | None = None, cell: Path | None = None
) -> PlacementSite:
    file = job / "other" / "other.yaml"
    file.write_text(text)
    request = PlaceRequest(
        cell=job / "cell" if cell is None else cell,
        toolpaths=(job / "holes.csv",),
        readings=({},),
        out=job / "nowhere",
        process=file,
        direct={"rotation_step_deg": 20.0, **(direct or {})},
    )
    return build_placement_site(request, *read_request_files(request))[0]


def get_estimator(site: PlacementSite) -> ToleranceEstimator:
    found = site.jobs[0][0].tolerances
    assert found is not None
    return found


@pytest.mark.slow
def test_bound_counts_what_passes_in_no_configuration(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compared with all configurations one by one;
    the best sequence of the grid has no more points within tolerance."""
    grids = []
    enumerate_candidates = placement_estimate.enumerate_candidates

    def keep(*args: object) -> object:
        grids.append(enumerate_candidates(*args))  # type: ignore[arg-type]
        return grids[-1]

    monkeypatch.setattr(placement_estimate, "enumerate_candidates", keep)
    observed = set()
    for limit, x, y in ((0.3, 0.0, 0.0), (0.33, -0.3, 0.0), (0.38, -0.3, 0.3), (0.45, 0.0, 0.0), (0.6, 0.0, 0.0)):
        site = load_site(job, PROCESS.replace("position_mm: 0.3", f"position_mm: {limit}"))
        shift = PlacementShift(x=x, y=y)
        (found,) = site.estimate_jobs(shift)
        candidates = grids[-1]
        task = site.jobs[0][0]
        moved = get_estimator(site).move_to(
            *_place(task, site, shift)  # type: ignore[arg-type]
        )
        pricing = replace(moved.pricing, draws=moved.pricing.draws.take_first(BOUND_DRAWS))
        stations = pricing.find_nearest_stations(pricing.holes.row)
        most = []
        for n, s in enumerate(stations.tolist()):
            r, b = np.nonzero(candidates.usable[s])
            points = np.full(len(r), pricing.path.stations[s])
            p = pricing.compute_probability(site.cell, True, np.full(len(r), n), points, candidates.q[s, r, b])
            most.append(p.max())
        q = pricing.process.quantile
        least = q - SAMPLING_SIGMAS * np.sqrt(q * (1 - q) / BOUND_DRAWS)
        assert found.missed == sum(p < least for p in most)
        assert sum(found.outcomes) == 4
        assert found.missed <= sum(found.outcomes[1:])
        observed.add(found.missed)
    assert len(observed) > 1


def _place(task: object, site: PlacementSite, shift: PlacementShift) -> tuple[object, object, object]:
    from machopt.kinematics.machine import load_machine
    from machopt.placement.moved_cell import move_cell
    from machopt.planning.cost.stiffness_index import compute_load_directions
    from machopt.planning.sampling.planning_arm import PlanningArm

    setup, path = task.setup, task.path  # type: ignore[attr-defined]
    cell = move_cell(setup.driven, site.moved_bodies, shift)
    arm = PlanningArm.build(cell, setup.arm.solver, load_machine(cell, setup.robot), site.options)
    return arm, path, compute_load_directions(path, arm, setup.elasticity, site.options.force)


def test_unknown_never_counts_as_in_tolerance(job: Path) -> None:
    (found,) = load_site(job, PROCESS.replace("reference: relative", "reference: absolute")).estimate_jobs(NO_SHIFT)
    known = found.outcomes
    (found,) = load_site(job, PROCESS.replace("thrust_spread_percent: 30,", "")).estimate_jobs(NO_SHIFT)
    assert found.outcomes == (0, 0, 0, 4)
    assert found.missed == 4
    assert known != found.outcomes


def test_hole_outside_the_stiffness_grid_is_unknown_as_in_the_plan(job: Path, tmp_path: Path) -> None:
    """The grid contains the holes of one side; its springs have a stated spread, the constant ones have none."""
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    springs = "[1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5]"
    T = machopt.Cell.load(cell).description
    inside = np.linalg.inv(T.T_world_base) @ T.workpiece.T_link_workpiece @ [-0.1, -0.3, 0.0, 1.0]
    corner = [round(1e3 * float(v) - 250) for v in inside[:3]]
    (cell / "stiffness.yaml").write_text(
        f"machopt_stiffness: 1\njoints_Nm_per_rad: {springs}\ngrid: {{origin_mm: {corner}, cell_mm: 500, "
        f"shape: [1, 1, 1], joints_Nm_per_rad: [{springs}], std_Nm_per_rad: [[1e5, 4e4, 9e4, 3e4, 3e4, 3e4]]}}\n"
    )
    site = load_site(job, PROCESS, cell=cell)
    (found,) = site.estimate_jobs(NO_SHIFT)
    plan = machopt.optimize(
        machopt.Cell.load(cell, process=job / "other" / "mine.yaml"), job / "holes.csv", rotation_step_deg=20.0
    )
    plan.save(tmp_path / "out")
    with (tmp_path / "out" / "points.csv").open() as text:
        outcomes = [row["outcome"] for row in csv.DictReader(text) if row["outcome"]]
    assert outcomes.count("unknown") == 2
    assert found.outcomes[OUTCOMES.index("unknown")] == 2
    assert found.missed >= 2
    (away,) = site.estimate_jobs(PlacementShift(y=1.0))  # all holes are outside the grid
    assert away.outcomes[OUTCOMES.index("unknown")] == 4
    assert away.missed == 4


def test_nothing_is_counted_without_tolerances(job: Path) -> None:
    text = PROCESS[: PROCESS.index(",\n    tolerance")] + "}\n"
    site = load_site(job, text)
    assert site.jobs[0][0].tolerances is None
    (found,) = site.estimate_jobs(NO_SHIFT)
    assert (found.missed, found.outcomes) == (0, ())


def test_tolerance_objective_has_no_fewer_in_tolerance(job: Path) -> None:
    (by_index,) = load_site(job).estimate_jobs(NO_SHIFT)
    (by_tolerance,) = load_site(job, direct={"objective": "tolerance"}).estimate_jobs(NO_SHIFT)
    assert by_tolerance.outcomes[0] >= by_index.outcomes[0]
    assert by_tolerance.worst >= by_index.bound


def build_planned(number: int, outcomes: tuple[int, ...], worst: float, bound: float = 0.0) -> PlannedPlacement:
    place = PlacementCandidate(
        number=number, shift=PlacementShift(), bound=bound, worst=worst, outcomes=outcomes, least_missed=0
    )
    return PlannedPlacement(place=place, worst=worst, mean=worst, outcomes=outcomes)


def test_places_are_compared_by_tolerance_then_by_index() -> None:
    planned = (
        build_planned(0, (3, 1, 0, 0), 1.0),
        build_planned(1, (4, 0, 0, 0), 2.0),
        build_planned(2, (4, 0, 0, 0), 1.5),
        build_planned(3, (3, 0, 1, 0), 0.9),
    )
    result = PlacementSearchResult(
        carried=None,  # type: ignore[arg-type]
        places=tuple(p.place for p in planned),
        planned=planned,
        around={},
        open_limit=(0.0, 1.5),
        stopped="",
    )
    assert [p.place.number for p in result.best] == [2, 1, 3, 0]
    assert result.is_optimal
    assert not replace(result, open_limit=(0.0, 1.4)).is_optimal
    assert replace(result, open_limit=(1.0, 0.1)).is_optimal
    assert can_beat((1.0, 9.0), (2.0, 0.1))


def test_outcomes_of_jobs_are_added_and_the_worst_is_found() -> None:
    def row(p: float, error: float, counts: tuple[int, ...], *, angle: bool = False) -> ToleranceSummary:
        return ToleranceSummary(
            operation="o",
            is_hole=True,
            limits={},
            reference="relative",
            counts=dict(zip(OUTCOMES, counts, strict=True)),
            worst_point=int(100 * p),
            worst_number=1,
            worst_error=error,
            worst_p_in=p,
            worst_cause="",
            is_angle=angle,
        )

    found = summarise_outcomes(
        [(row(0.9, 1e-4, (2, 1, 0, 0)),), (), (row(0.4, 2e-4, (0, 0, 1, 1)), row(0.4, 3e-4, (1, 0, 0, 0)))]
    )
    assert found["outcomes"] == (3, 1, 1, 1)
    assert (found["tolerance_job"], found["tolerance_point"], found["tolerance_error"]) == (2, 40, 3e-4)
    assert np.isnan(summarise_outcomes([(row(0.4, 3e-4, (1, 0, 0, 0), angle=True),)])["tolerance_error"])
    assert summarise_outcomes([(), ()])["outcomes"] == ()
    assert add_outcomes([(), (1, 2, 3, 4)]) == (1, 2, 3, 4)


def test_journal_stores_outcomes(tmp_path: Path) -> None:
    one = replace(build_planned(3, (4, 1, 0, 2), 0.5, bound=0.4), tolerance_error=np.inf, shares=(0.5, 0.5))
    one = replace(one, point=2.0, cycle_time=1.0, tolerance_p_in=0.5)
    SearchJournal(tmp_path / "j", "q").append(one)
    assert SearchJournal(tmp_path / "j", "q").find_planned(one.place) == one


@pytest.mark.slow
def test_best_places_have_the_values_of_their_plans(job: Path) -> None:
    """place.json and places.csv are compared with result.json of the written plan,
    whose cell contains the process.yaml."""
    out = job / "out"
    arguments = ["place", str(job / "cell"), str(job / "holes.csv"), "-o", str(out), "--places", "4", "--best", "2"]
    options = ["--process", str(job / "other" / "mine.yaml"), "--x-mm", "-200", "0", "--y-mm", "0", "0"]
    code = main([*arguments, *options, "--jobs", "1", "--quiet", "--set", "rotation_step_deg=15"])
    assert code == 0
    message = json.loads((out / "place.json").read_text())
    with (out / "places.csv").open(encoding="utf-8") as file:
        rows = {(float(r["dx_mm"]), float(r["dy_mm"])): r for r in csv.DictReader(file)}
    assert len(message["best"]) == 2
    for entry in message["best"]:
        result = json.loads((out / entry["folder"] / "holes" / "result.json").read_text())
        counts = result["process"]["in_tolerance"]["after"]
        found = entry["tolerances"]
        assert [found[w] for w in ("in_tolerance", "marginal", "fail", "unknown")] == [counts[w] for w in OUTCOMES]
        (tolerance,) = result["process"]["tolerances"]
        assert found["worst_error_point"] == tolerance["worst_point"]
        assert found["worst_error_mm"] == pytest.approx(tolerance["worst_error_mm"], rel=1e-9)
        row = rows[round(entry["shift_mm"][0], 6), round(entry["shift_mm"][1], 6)]
        assert int(row["in_tolerance"]) == counts["pass"]
        assert int(row["bound_in_tolerance"]) >= counts["pass"]
        assert float(row["worst_error_mm"]) == pytest.approx(found["worst_error_mm"], rel=1e-8)
    missed = [sum(e["tolerances"][w] for w in ("marginal", "fail", "unknown")) for e in message["best"]]
    assert missed == sorted(missed)
    cell = out / message["best"][0]["folder"] / "cell"
    folder = out / message["best"][0]["folder"] / "holes"
    assert main(["verify", str(cell), str(job / "holes.csv"), str(folder), "--quiet"]) == 0
    assert "In tolerance" in (out / "report.html").read_text()
