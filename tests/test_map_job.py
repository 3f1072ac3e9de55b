"""``machopt map`` under the forces of a job: error, probability and stability of each operation."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.commands.map.computation import compute_map
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.errors import InputError
from machopt.job_map import job_quantities
from machopt.kinematics.urdf_loading import load_chain
from machopt.planning.error_probability.random_draws import build_draws
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.workspace_map.request import MapRequest
from machopt.workspace_map.sample_posture_computation import build_map_settings

CELLS = Path(__file__).resolve().parents[1] / "cells"
DRILLING = """machopt_process: 1
materials:
  al: {drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300, thrust_spread_percent: 30,
    torque_spread_percent: 25, source: t}}
operations:
  holes: {kind: drilling, spindle_rpm: 4000, layers: [{material: al, thickness_mm: 12}], depth_mm: 12,
    tolerance: {position_mm: 0.3, reference: relative}}
  push: {kind: force, force_N: {travel: 100, normal: 0, axial: 40}, spread_percent: 20, surface: floor,
    tolerance: {surface_mm: 0.2, reference: relative}}
"""
ROWS = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},0,{z},0,0,1,{move},{feed},{label}"
    for x, z, move, feed, label in (
        (-50, 40, "rapid", "", "holes"),
        (-50, 25, "rapid", "", "holes"),
        (-50, 0, "cut", 420, "holes"),
        (-50, 40, "retract", "", "holes"),
        (0, 40, "rapid", "", "push"),
        (0, 0, "cut", 420, "push"),
        (50, 0, "cut", 420, "push"),
    )
)


def build_request(folder: Path, process: str = DRILLING, **options: object) -> MapRequest:
    (folder / "job.csv").write_text(ROWS)
    (folder / "mine.yaml").write_text(process)
    given: dict[str, object] = {"slice": "xy", "at": 900.0, "steps": ("300",), "fixed_rotation": True, **options}
    return MapRequest(
        cell=CELLS / "kr240_drilling",
        out=folder / "out",
        process=folder / "mine.yaml",
        toolpath=folder / "job.csv",
        **given,  # type: ignore[arg-type]
    )


def test_error_equals_the_compliance_times_the_stated_force(tmp_path: Path) -> None:
    """The error is C f of the same configurations, with the force along the map's x axis and the tool axis."""
    found = compute_map(build_request(tmp_path), lambda _: None)
    (layer,) = found.layers
    value, q = layer.values.value, layer.postures.q
    reached = np.flatnonzero(layer.postures.ok)
    assert len(reached) > 10
    assert {"error_1", "p_in_1", "error_2", "p_in_2"} <= set(value)
    assert "stability_1" not in value
    load = compute_map(
        build_request(tmp_path, force="100,0,40", collision="self"),
        lambda _: None,
    )
    setting = load.layers[0].values
    from machopt.kinematics.urdf_loading import load_chain
    from machopt.workspace_map.sample_posture_computation import build_map_settings

    cell = load_cell(CELLS / "kr240_drilling")
    robot, _ = load_chain(cell)
    states = build_map_settings(cell, robot, load.options).evaluate_states(q[reached])
    twist = np.einsum("mij,mj->mi", states.compliance, states.wrench)
    np.testing.assert_allclose(value["error_2"][reached], np.abs(twist[:, 2]), rtol=1e-6)
    assert np.isfinite(setting.value["error_2"][reached]).all()
    p = value["p_in_1"][reached]
    assert ((p >= 0) & (p <= 1)).all()
    order = np.argsort(value["error_1"][reached])
    assert p[order[0]] >= p[order[-1]]  # the smallest error has no lower probability than the largest


def test_worst_direction_of_travel_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a pass along x and one along y, the error is the larger one of both maps."""
    text = DRILLING.replace("travel: 100, normal: 0, axial: 40", "travel: 400, normal: 0, axial: 40")
    head, *rows = ROWS.split("\n")
    along = rows[-1].replace("50,0,0", "0,50,0")
    maps = {}
    for name, last in (("x", [rows[-1]]), ("y", [along]), ("both", [rows[-1], *rows[-3:-1], along])):
        monkeypatch.setattr(f"{__name__}.ROWS", "\n".join([head, *rows[:-1], *last]))
        (tmp_path / name).mkdir()
        (layer,) = compute_map(build_request(tmp_path / name, text), lambda _: None).layers
        maps[name] = layer.values.value
    known = np.isfinite(maps["both"]["error_2"])
    assert np.abs(maps["x"]["error_2"][known] - maps["y"]["error_2"][known]).max() > 1e-6
    both = np.maximum(maps["x"]["error_2"], maps["y"]["error_2"])
    np.testing.assert_allclose(maps["both"]["error_2"][known], both[known], rtol=1e-9)
    least = np.minimum(maps["x"]["p_in_2"], maps["y"]["p_in_2"])
    np.testing.assert_array_equal(maps["both"]["p_in_2"][known], least[known])


@pytest.mark.slow
def test_probability_equals_that_of_the_planner_in_its_configurations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hole and floor of the job at the configurations of a plan,
    compared with the tolerance cost with as many draws."""
    monkeypatch.setattr(job_quantities, "DRAWS", 8192)
    request = build_request(tmp_path)
    given = load_optimize_inputs(
        OptimizeRequest(
            cell=request.cell,
            toolpath=request.toolpath,
            out=tmp_path / "plan",
            process=request.process,
            direct={"objective": "tolerance", "rotation_step_deg": 30},
        )
    )
    segment = given.segments[0]
    plan = find_best_plan(segment.cell, segment.toolpath, segment.restrict_options(given.options))
    assert plan.pricing is not None
    planned = plan.pricing.tolerance
    assert planned is not None
    pricing = replace(planned, draws=build_draws(planned.spread, 8192))
    q = plan.chosen.assignment.q
    found = compute_map(request, lambda _: None)
    robot, _ = load_chain(segment.cell)
    setting = build_map_settings(segment.cell, robot, found.options)
    quantities, _ = job_quantities.build_job_quantities(segment.cell, segment.toolpath, setting)
    by_key = {quantity.key: quantity for quantity in quantities}
    for is_hole, key, rows in ((True, "p_in_1", pricing.holes.row), (False, "p_in_2", pricing.surfaces.row)):
        points = np.searchsorted(plan.path.index, rows - 1e-6)
        wanted = pricing.compute_probability(segment.cell, is_hole, np.arange(len(rows)), points, q[points])
        at = q[points]
        if is_hole:  # the position of a hole is defined at its entry
            at = pricing._shift_to_entry(np.arange(len(rows)), points, at)
        found_p = by_key[key].function(setting.evaluate_states(at))
        np.testing.assert_allclose(found_p, wanted, rtol=0, atol=0.02)
        assert ((wanted > 0.02) & (wanted < 0.9999)).any()


@pytest.mark.parametrize(
    "change",
    [
        ("thrust_spread_percent: 30", "thrust_spread_percent: 80"),
        ("clamp_N: 5000,", "clamp_N: 5000, wear: [1.0, 3.0],"),
    ],
)
def test_clamp_above_the_thrust_has_no_spread(tmp_path: Path, change: tuple[str, str]) -> None:
    text = DRILLING.replace("depth_mm: 12,", "depth_mm: 12, clamp_N: 5000,").replace(
        "position_mm: 0.3", "position_mm: 0.5"
    )
    plain, changed = (
        compute_map(build_request(tmp_path, one), lambda _: None).layers[0].values.value["p_in_1"]
        for one in (text, text.replace(*change))
    )
    known = np.isfinite(plain)
    assert np.ptp(plain[known]) > 0.0
    # torque and lateral force are still drawn; they move the hole only slightly
    np.testing.assert_allclose(changed[known], plain[known], atol=0.03)


def test_stated_normal_gives_no_mapped_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head, *rows = ROWS.split("\n")
    monkeypatch.setattr(f"{__name__}.ROWS", "\n".join([f"{head},nx,ny,nz", *(f"{row},1,0,0" for row in rows)]))
    found = compute_map(build_request(tmp_path, DRILLING.replace("surface: floor", "surface: table")), lambda _: None)
    assert "error_2" not in found.layers[0].values.value
    assert any(w.startswith("push: no error is mapped") for w in found.result.warnings)


def test_stated_normal_in_a_weaker_direction_gives_no_mapped_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lateral pass is added whose points alone state a normal: the worst direction is unknown."""
    head, *rows = ROWS.split("\n")
    lines = [f"{head},nx,ny,nz", *(f"{row},,," for row in rows)]
    lines += [f"50,{y},0,0,0,1,cut,420,push,1,0,0" for y in (20, 40)]
    monkeypatch.setattr(f"{__name__}.ROWS", "\n".join(lines))
    found = compute_map(build_request(tmp_path), lambda _: None)
    assert "error_1" in found.layers[0].values.value
    assert not {"error_2", "p_in_2"} & set(found.layers[0].values.value)


def test_missing_probability_inputs_leave_only_the_error(tmp_path: Path) -> None:
    found = compute_map(build_request(tmp_path, DRILLING.replace("thrust_spread_percent: 30,", "")), lambda _: None)
    value = found.layers[0].values.value
    assert "error_1" in value
    assert "p_in_1" not in value
    assert any(w.startswith("holes: no probability") for w in found.result.warnings)


def test_job_without_a_process_is_refused(tmp_path: Path) -> None:
    request = build_request(tmp_path)
    with pytest.raises(InputError) as refused:
        compute_map(MapRequest(cell=request.cell, out=request.out, toolpath=request.toolpath), lambda _: None)
    assert refused.value.where == "--toolpath"
    text = DRILLING.replace("surface_mm: 0.2", "surface_mm: -1")
    with pytest.raises(InputError):
        compute_map(build_request(tmp_path, text), lambda _: None)


@pytest.mark.slow
def test_command_writes_columns_fields_and_a_legend(tmp_path: Path) -> None:
    """A milled wall also has a stability column."""
    cell, job = CELLS / "kr500_milling", tmp_path / "wall.csv"
    job.write_text(
        "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n-60,0,20,0,0,1,rapid,,wall\n-50,0,20,0,0,1,cut,1200,wall\n"
        "50,0,20,0,0,1,cut,1200,wall\n"
    )
    out = tmp_path / "out"
    words = ["map", str(cell), "-o", str(out), "--toolpath", str(job), "--process", str(cell / "process.yaml")]
    assert main([*words, "--slice", "xy", "--at", "900", "--step", "400", "--quiet"]) == 0
    message = json.loads((out / "map.json").read_text())
    fields = message["layers"]["given"]["fields"]
    assert fields["error_1_mm"]["better"] == "less"
    assert fields["p_in_1"]["max"] <= 1.0
    assert 0.0 < fields["stability_1"]["min"] <= fields["stability_1"]["max"] <= 4.0
    with (out / "map.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {"error_1_mm", "p_in_1", "stability_1"} <= set(rows[0])
    assert "wall.csv" in message["inputs"]
    page = (out / "report.html").read_text()
    assert "Probability of default in tolerance" in page
