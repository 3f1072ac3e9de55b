"""The trade-off front: what dominates what, what is refused, and the file as it is written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from machopt.commands.optimize.trade_off_front import FRONT_COLUMNS, write_trade_off_front
from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.errors import InputError
from machopt.planning.cost.objective import PlanObjective, compute_total
from machopt.planning.job.pareto_front import (
    FrontPlan,
    check_front_options,
    describe_better_plans,
    describe_missing_plans,
    list_front_variants,
    mark_dominated_plans,
)
from machopt.report.page_types.optimize_report import TradeOffPoint
from machopt.report.pages.optimize.trade_off_section import build_trade_off_section

A = FrontPlan(
    plan="a", changed="", mean_index=0.4, worst_index=0.5, cycle_time_s=10.0, joint_travel_deg=1000.0, clearance_mm=20.0
)


def test_a_plan_is_dominated_by_one_that_is_nowhere_worse() -> None:
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
def test_what_makes_no_sense_is_refused_with_what_works(options: PlanOptions, works: str) -> None:
    with pytest.raises(InputError, match=works):
        check_front_options(options)
    check_front_options(PlanOptions())


def test_differences_that_nobody_could_measure_are_none() -> None:
    slower = replace(A, plan="slower", cycle_time_s=10.2, clearance_mm=20.0007)  # 0.2 s for 0.7 µm
    assert [p.dominated for p in mark_dominated_plans([A, slower])] == [False, True]
    assert [p.dominated for p in mark_dominated_plans([slower, A])] == [True, False]
    for other in (
        replace(A, cycle_time_s=9.8, clearance_mm=19.98),
        replace(A, mean_index=0.4 * 1.002, joint_travel_deg=998.0),
    ):
        assert not any(p.dominated for p in mark_dominated_plans([A, other]))
    # alike pair by pair, yet the last is better than the first by what counts: one of them stays, not the first
    steps = [replace(A, plan=str(k), cycle_time_s=10.0 - 0.06 * k) for k in range(3)]
    assert [p.dominated for p in mark_dominated_plans(steps)] == [True, False, True]
    # each better than the next in one thing: in a ring, not all may go
    ring = [(0.0, 0.6, 1.2), (1.2, 0.0, 0.6), (0.6, 1.2, 0.0)]
    round_about = [
        replace(A, cycle_time_s=10 + 0.1 * a, joint_travel_deg=1e3 + b, clearance_mm=20 - 0.01 * c) for a, b, c in ring
    ]
    assert not all(p.dominated for p in mark_dominated_plans(round_about))


def test_clearance_is_asked_for_only_where_it_is_checked() -> None:
    assert "wider clearance" in [name for name, _, _ in list_front_variants(PlanOptions())]
    assert "wider clearance" not in [name for name, _, _ in list_front_variants(PlanOptions(collision=False))]


def test_file_holds_what_is_not_dominated(tmp_path: Path) -> None:
    write_trade_off_front(tmp_path / "front.csv", mark_dominated_plans([A, replace(A, plan="b", clearance_mm=10.0)]))
    assert (tmp_path / "front.csv").read_text("utf-8").splitlines() == [
        ",".join(name for name in FRONT_COLUMNS if name != "in_tolerance"),  # no tolerance, no column
        "a,,0.4,0.5,10,1000,20,0,",
    ]


def test_a_plan_that_could_not_be_driven_is_told() -> None:
    names = [name for name, _, _ in list_front_variants(PlanOptions())]
    every = [A, *(replace(A, plan=name) for name in names)]
    assert describe_missing_plans(every, PlanOptions()) == ()
    assert describe_missing_plans([], PlanOptions()) == ()  # no front was asked for
    (told,) = describe_missing_plans(every[:-1], PlanOptions())
    assert names[-1] in told
    assert names[0] not in told


def test_a_further_plan_that_is_better_by_the_weights_asked_for_is_said() -> None:
    """The objective of other weights' plans, found where the plan asked for is only the best near by."""
    own, better = replace(A, objective=1.41884), replace(A, plan="travel", changed="× 4", objective=1.41414)
    (said,) = describe_better_plans([own, replace(A, plan="worse", objective=1.5), better])
    assert all(word in said for word in ("'travel'", "× 4", "1.4141", "0.33 %"))
    assert describe_better_plans([own, replace(better, objective=1.4184)]) == ()  # within what the choice claims
    assert describe_better_plans([]) == describe_better_plans([A, better]) == ()


def test_the_objective_of_parts_is_priced_by_any_weights() -> None:
    parts = PlanObjective(
        total=9.9, mean=1.0, worst=2.0, travel=3.0, rotation=4.0, feed=0.5, preferred=0.25, clearance=0.125
    )
    weights = ObjectiveWeights(mean=1.0, worst=10.0, travel=0.1, rotation=0.01, feed=2.0, clearance=4.0)
    assert compute_total(parts, weights) == pytest.approx(1.0 + 20.0 + 0.3 + 0.04 + 1.0 + 0.25 + 0.5)
    assert compute_total(parts, weights, elsewhere=3.0) == pytest.approx(compute_total(parts, weights) + 10.0)


def test_picture_of_the_front_has_axes_even_where_all_plans_are_one() -> None:
    point = TradeOffPoint(
        name="as asked", changed="", mean=0.4, worst=0.5, cycle=10.0, travel=1000.0, clearance=None, dominated=False
    )
    for points in ((point,), (point, replace(point, name="travel counts more", mean=0.42, cycle=11.0, dominated=True))):
        page = str(
            build_trade_off_section(SimpleNamespace(front=points, summary=SimpleNamespace(quantity="deflection")))
        )  # type: ignore[arg-type]
        assert "cycle time (s)" in page
        assert "mean deflection (mm)</text>" in page
        assert "nan" not in page


@pytest.mark.parametrize(("kind", "width"), [("broad", 640), ("narrow", 372)])
def test_no_names_of_the_picture_lie_on_one_another_or_leave_it(kind: str, width: int) -> None:
    """Plans of nearly one time and mean: their dots are apart, and so are the lines of their names."""
    one = TradeOffPoint(
        name="as asked, and a little more of it",
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
