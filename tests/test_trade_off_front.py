"""Trade-off front: domination, refusals, and the written file."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from output_damage.damage_case import Job, copy_job, edit_json, update_manifest_hashes

from machopt.cell.cell_reader import load_cell
from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.commands.optimize.trade_off_front import FRONT_COLUMNS, PROCESS_COLUMNS, write_trade_off_front
from machopt.commands.verify import run_verify
from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.errors import InputError
from machopt.planning.cost.objective import PlanObjective, compute_total
from machopt.planning.job.pareto_front import (
    FrontPlan,
    check_front_options,
    describe_better_plans,
    describe_missing_plans,
    list_front_variants,
    list_process_variants,
    mark_dominated_plans,
)
from machopt.process.binding.operation_matching import attach_process
from machopt.report.page_types.optimize_page_data import TradeOffPoint
from machopt.report.pages.optimize.outcomes_over_time import draw_outcomes, list_best_steps
from machopt.report.pages.optimize.trade_off_section import build_trade_off_section
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.folder.options_in_force import VerifyRequest
from machopt.verification.tables.csv_columns import read_columns

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr500_milling"
A = FrontPlan(
    plan="a", changed="", mean_index=0.4, worst_index=0.5, cycle_time_s=10.0, joint_travel_deg=1000.0, clearance_mm=20.0
)


def test_plan_is_dominated_by_one_that_is_nowhere_worse() -> None:
    points = [
        A,
        replace(A, plan="worse", cycle_time_s=11.0),
        replace(A, plan="trade", mean_index=0.39, joint_travel_deg=1200.0),
        replace(A, plan="the same again"),
        replace(A, plan="farther", clearance_mm=30.0, cycle_time_s=12.0),
    ]
    assert [p.dominated for p in mark_dominated_plans(points)] == [False, True, False, True, False]
    blind = [replace(p, clearance_mm=None) for p in points]
    assert [p.dominated for p in mark_dominated_plans(blind)] == [False, True, False, True, True]


@pytest.mark.parametrize(
    ("options", "works"),
    [
        (PlanOptions(method="jiao2022"), "--method global"),
        (PlanOptions(compensate=True), "without --compensate"),
        (PlanOptions(allow_gaps=True), "without it"),
    ],
)
def test_invalid_request_is_refused_with_what_is_accepted(options: PlanOptions, works: str) -> None:
    with pytest.raises(InputError, match=works):
        check_front_options(options)
    check_front_options(PlanOptions())


def test_unmeasurable_differences_count_as_equal() -> None:
    slower = replace(A, plan="slower", cycle_time_s=10.2, clearance_mm=20.0007)  # 0.2 s for 0.7 µm
    assert [p.dominated for p in mark_dominated_plans([A, slower])] == [False, True]
    assert [p.dominated for p in mark_dominated_plans([slower, A])] == [True, False]
    for other in (
        replace(A, cycle_time_s=9.8, clearance_mm=19.98),
        replace(A, mean_index=0.4 * 1.002, joint_travel_deg=998.0),
    ):
        assert not any(p.dominated for p in mark_dominated_plans([A, other]))
    # equal in pairs, each better than the one before it and worse in nothing: the last one remains, as verify requires
    steps = [replace(A, plan=str(k), cycle_time_s=10.0 - 0.06 * k) for k in range(3)]
    assert [p.dominated for p in mark_dominated_plans(steps)] == [True, True, False]
    # each is better than the next one in one criterion: in a cycle, not all may be removed
    ring = [(0.0, 0.6, 1.2), (1.2, 0.0, 0.6), (0.6, 1.2, 0.0)]
    round_about = [
        replace(A, cycle_time_s=10 + 0.1 * a, joint_travel_deg=1e3 + b, clearance_mm=20 - 0.01 * c) for a, b, c in ring
    ]
    assert not all(p.dominated for p in mark_dominated_plans(round_about))


def test_clearance_is_a_criterion_only_where_checked() -> None:
    assert "wider clearance" in [name for name, _, _ in list_front_variants(PlanOptions())]
    assert "wider clearance" not in [name for name, _, _ in list_front_variants(PlanOptions(collision=False))]


def test_file_contains_the_nondominated_plans(tmp_path: Path) -> None:
    write_trade_off_front(tmp_path / "front.csv", mark_dominated_plans([A, replace(A, plan="b", clearance_mm=10.0)]))
    assert (tmp_path / "front.csv").read_text("utf-8").splitlines() == [
        ",".join(name for name in FRONT_COLUMNS if name not in PROCESS_COLUMNS),  # without tolerance no column
        "a,,0.4,0.5,10,1000,20,0,",
    ]


def test_undrivable_plan_is_reported() -> None:
    names = [name for name, _, _ in list_front_variants(PlanOptions())]
    every = [A, *(replace(A, plan=name) for name in names)]
    assert describe_missing_plans(every, PlanOptions()) == ()
    assert describe_missing_plans([], PlanOptions()) == ()  # no front was requested
    (message,) = describe_missing_plans(every[:-1], PlanOptions())
    assert names[-1] in message
    assert names[0] not in message


def test_better_plan_of_other_weights_is_reported() -> None:
    """The plans for other weights have a better objective if the requested plan is only a local optimum."""
    own, better = replace(A, objective=1.41884), replace(A, plan="travel", changed="× 4", objective=1.41414)
    (output,) = describe_better_plans([own, replace(A, plan="worse", objective=1.5), better])
    assert all(word in output for word in ("'travel'", "× 4", "1.4141", "0.33 %"))
    assert describe_better_plans([own, replace(better, objective=1.4184)]) == ()  # within the tolerance of the search
    assert describe_better_plans([]) == describe_better_plans([A, better]) == ()


def test_objective_is_recomputed_for_any_weights() -> None:
    parts = PlanObjective(
        total=9.9, mean=1.0, worst=2.0, travel=3.0, rotation=4.0, feed=0.5, preferred=0.25, clearance=0.125
    )
    weights = ObjectiveWeights(mean=1.0, worst=10.0, travel=0.1, rotation=0.01, feed=2.0, clearance=4.0)
    assert compute_total(parts, weights) == pytest.approx(1.0 + 20.0 + 0.3 + 0.04 + 1.0 + 0.25 + 0.5)
    assert compute_total(parts, weights, elsewhere=3.0) == pytest.approx(compute_total(parts, weights) + 10.0)


def test_picture_of_the_front_has_axes_where_all_plans_are_equal() -> None:
    point = TradeOffPoint(
        name="requested", changed="", mean=0.4, worst=0.5, cycle=10.0, travel=1000.0, clearance=None, dominated=False
    )
    for points in ((point,), (point, replace(point, name="travel counts more", mean=0.42, cycle=11.0, dominated=True))):
        page = str(
            build_trade_off_section(SimpleNamespace(front=points, summary=SimpleNamespace(quantity="deflection")))
        )  # type: ignore[arg-type]
        assert "cycle time (s)" in page
        assert "mean deflection (mm)</text>" in page
        assert "nan" not in page


@pytest.mark.parametrize(("kind", "width"), [("broad", 640), ("narrow", 372)])
def test_labels_of_the_picture_do_not_overlap(kind: str, width: int) -> None:
    """Plans with nearly the same time and mean: their points are separate, and so are the lines of their names."""
    one = TradeOffPoint(
        name="requested, and a little more of it",
        changed="",
        mean=1.7727,
        worst=2.0,
        cycle=506.14,
        travel=1000.0,
        clearance=None,
        dominated=False,
    )
    near = replace(one, name="travel counts more", mean=1.77275, cycle=506.16)
    far = replace(one, name="travel counts most", mean=1.7743, cycle=505.61)
    points = (one, near, replace(near, name="third", mean=1.77285, cycle=506.13), far)
    page = str(build_trade_off_section(SimpleNamespace(front=points, summary=SimpleNamespace(quantity="deflection"))))  # type: ignore[arg-type]
    names = {p.name for p in points}
    picture = page.split("</svg>")[0 if kind == "broad" else 1]
    lines = [
        (float(re.search(r'\bx="([^"]+)"', tag)[1]), float(re.search(r'\by="([^"]+)"', tag)[1]), "end" in tag, text)  # type: ignore[index]
        for tag, text in re.findall(r"<text([^>]*)>([^<]*)</text>", picture)
        if text in names
    ]
    assert {text for *_, text in lines} == names
    boxes = [((x - 6 * len(t), x) if end else (x, x + 6 * len(t)), y) for x, y, end, t in lines]
    for n, ((left, right), y) in enumerate(boxes):
        assert 10.0 < y < 320.0
        assert 0.0 <= left < right <= width
        for (least, most), other in boxes[:n]:
            assert right < least or most < left or abs(y - other) > 11.0


def test_tolerances_errors_and_stability_are_criteria() -> None:
    own = replace(A, in_tolerance=40, mean_error_mm=0.2, least_stability_ratio=1.1)
    points = [
        own,
        replace(own, plan="more in tolerance", in_tolerance=41, cycle_time_s=20.0),
        replace(own, plan="slower alone", cycle_time_s=20.0),
        replace(own, plan="more stable", least_stability_ratio=1.2, cycle_time_s=15.0),
        replace(own, plan="less error", mean_error_mm=0.19, cycle_time_s=15.0),
        replace(own, plan="no difference", mean_error_mm=0.1995, least_stability_ratio=1.105, cycle_time_s=15.0),
    ]
    assert [p.dominated for p in mark_dominated_plans(points)] == [False, False, True, False, False, True]


def test_curve_contains_plans_with_more_in_tolerance_than_faster_ones() -> None:
    point = TradeOffPoint(
        name="", changed="", mean=0.4, worst=0.5, cycle=0.0, travel=1.0, clearance=None, dominated=False
    )
    values = [(10.0, 5), (11.0, 4), (12.0, 9), (12.0, 8), (15.0, 9), (20.0, 10)]
    plans = [replace(point, cycle=s, in_tolerance=n, others=(10 - n, 0, 0)) for s, n in values]
    assert [(p.cycle, p.in_tolerance) for p in list_best_steps(plans)] == [(10.0, 5), (12.0, 9), (20.0, 10)]
    assert "nan" not in str(draw_outcomes(plans))
    assert "nan" not in str(draw_outcomes(plans[:1]))


def test_process_variants_need_tolerances_and_stability() -> None:
    cell = load_cell(CELL, process=CELL / "process.yaml")
    toolpath = attach_process(cell.process, read_toolpath(ROOT / "toolpaths" / "plain.csv"))
    known = [name for name, _, _ in list_process_variants([(cell, toolpath)], PlanOptions())]
    assert {"tolerances first", "feed advice", "stability counts", "stable cuts"} <= set(known)
    assert list_process_variants([(replace(cell, process=None), toolpath)], PlanOptions()) == []
    assert cell.process is not None
    silent = replace(cell, process=replace(cell.process, damping=None))
    assert not [n for n, _, _ in list_process_variants([(silent, toolpath)], PlanOptions()) if "stab" in n]
    strict = list_process_variants([(cell, toolpath)], PlanOptions(min_stability_ratio=1.2))
    assert not [n for n, _, _ in strict if n.startswith("stable cuts")]


@pytest.mark.proof
def test_front_with_a_process_is_a_curve_and_is_verified(tmp_path: Path) -> None:
    rows = (ROOT / "toolpaths" / "plain.csv").read_text(encoding="utf-8").splitlines()
    rows = [line for line in rows if not line.startswith("#")]
    (tmp_path / "part.csv").write_text("\n".join(rows[:36]) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    request = OptimizeRequest(
        cell=CELL,
        toolpath=tmp_path / "part.csv",
        out=out,
        overrides=("rotation_step_deg=15",),
        process=CELL / "process.yaml",
        front=True,
    )
    found = run_optimize(request)
    assert found.exit_code == 0
    front = found.result.front
    assert front is not None
    own = front[0]
    assert own.in_tolerance is not None
    for p in front:
        assert (p.in_tolerance or 0) + (p.marginal or 0) + (p.fail or 0) + (p.unknown or 0) == own.in_tolerance + (
            own.marginal or 0
        ) + (own.fail or 0) + (own.unknown or 0)
        assert p.mean_error_mm is not None
        assert p.worst_error_mm is not None
        assert p.mean_error_mm <= p.worst_error_mm
    by_name = {p.plan: p for p in front}
    if "stable cuts" in by_name:
        assert (by_name["stable cuts"].least_stability_ratio or 0.0) >= 1.0 - 1e-6
    if "feed advice" in by_name:
        assert (by_name["feed advice"].in_tolerance or 0) >= (by_name["tolerances first"].in_tolerance or 0)
    header = (out / "front.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert set(header) == set(FRONT_COLUMNS)
    for key, value in (("marginal", 999), ("mean_error_mm", 9.0), ("least_stability_ratio", 9.0)):
        job = copy_job(Job(CELL, tmp_path / "part.csv", out), tmp_path / key)
        with edit_json(job.out / "result.json") as result:
            result["front"][0][key] = value
        columns = read_columns(job.out / "front.csv")
        columns[key][0] = str(value)
        lines = [",".join(columns), *(",".join(_quote(v) for v in row) for row in zip(*columns.values(), strict=True))]
        (job.out / "front.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        update_manifest_hashes(job.out)
        wanted = VerifyRequest(cell=CELL, toolpath=request.toolpath, out=job.out, process=request.process)
        failed = [str(c.check_name) for c in run_verify(wanted).verification.failed]
        assert any("front" in name for name in failed), (key, failed)


def _quote(text: str) -> str:
    return f'"{text}"' if "," in text else text


@pytest.mark.slow
def test_further_plans_with_rounded_rapid_corners_are_kept(tmp_path: Path) -> None:
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for x, z, move in ((0, 100, "rapid,"), (0, 20, "rapid,"), (0, 0, "approach,1500"), (60, 0, "cut,3000")):
        rows.append(f"{x},0,{z},0,0,1,{move}")
    for x, y in ((60, 0), (200, 0), (200, 100), (60, 100)):
        rows.append(f"{x},{y},100,0,0,1,rapid,")
    rows += ["60,100,0,0,0,1,approach,1500", "0,100,0,0,0,1,cut,3000", "0,100,80,0,0,1,rapid,"]
    table, out = tmp_path / "job.csv", tmp_path / "out"
    table.write_text("\n".join(rows) + "\n", encoding="utf-8")
    cell = Path(__file__).resolve().parents[1] / "cells" / "kr500_milling"
    outcome = run_optimize(OptimizeRequest(cell=cell, toolpath=table, out=out, front=True))
    assert outcome.exit_code == 0
    assert (out / "rapid_corners.csv").exists()
    assert len((out / "front.csv").read_text(encoding="utf-8").splitlines()) > 2
