"""``advised_feed_share``: slowed points are within tolerance, the least slowed come first; refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_small_jobs import ROOT

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.errors import InputError
from machopt.planning.posture_and_feed.advised_feeds import AdvisedFeeds
from machopt.verification.tables.csv_columns import read_columns

CELL = ROOT / "cells" / "kr500_milling"
HEAD = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"


def write_pass(file: Path) -> Path:
    """Write a pass of 0.1 m along the rim with an oscillating tool axis, at a feed above the tolerance limit."""
    rows = [HEAD, "60,-81,40,0,0,1,rapid,,finish"]
    for n in range(26):
        u = n / 25
        lean = 0.1 * np.sin(2 * np.pi * u)
        size = np.hypot(lean, 1.0)
        rows.append(f"{60 - 100 * u:.4f},-81,-0.5,{lean / size:.7f},0,{1 / size:.7f},cut,2880,finish")
    rows.append("-40,-81,40,0,0,1,rapid,,finish")
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


def optimize(job: Path, out: Path, **options: object) -> OptimizeDocument:
    text = (CELL / "process.yaml").read_text(encoding="utf-8")
    process = out.parent / "process.yaml"
    process.write_text(text.replace("surface_mm: 0.1", "surface_mm: 0.086"), encoding="utf-8")
    request = OptimizeRequest(
        cell=CELL, toolpath=job, out=out, process=process, direct={"rotation_step_deg": 15, **options}
    )
    found = run_optimize(request)
    assert found.exit_code == 0
    return found.result


@pytest.mark.slow
def test_slowed_points_pass_and_the_share_counts_points(tmp_path: Path) -> None:
    job = write_pass(tmp_path / "pass.csv")
    plain = optimize(job, tmp_path / "plain")
    assert plain.process is not None
    assert plain.process.advised_feed is None
    before = dict(plain.process.in_tolerance.after)
    passing = {}
    for share in (0.4, 1.0):
        out = tmp_path / str(share)
        result = optimize(job, out, advised_feed_share=share)
        assert result.process is not None
        stated = result.process.advised_feed
        assert stated is not None
        assert stated.file_feed_s == pytest.approx(plain.cycle_time_s)
        assert stated.needed > 5
        assert stated.slowed == np.ceil(share * stated.needed - 1e-9)
        table = read_columns(out / "points.csv")
        slowed = [
            n
            for n, (advised, of_file) in enumerate(zip(table["feed_advised_mm_min"], table["feed_mm_min"], strict=True))
            if advised and float(advised) < float(of_file) - 1e-3
        ]
        assert len(slowed) == stated.slowed
        assert {table["outcome"][n] for n in slowed} == {"pass"}
        passing[share] = result.process.in_tolerance.after["pass"]
        assert result.cycle_time_s is not None
        assert plain.cycle_time_s is not None
        assert result.cycle_time_s > plain.cycle_time_s - 0.024  # two samples: the axes may be slower than the feed
    assert before["pass"] <= passing[0.4] <= passing[1.0]


def test_least_slowed_points_come_first() -> None:
    reached = np.full(6, 10.0)
    advised = AdvisedFeeds(np.array([9.0, 5.0, 8.0, 0.0, np.nan, 20.0]), 0)
    some = advised.select_share(reached, np.zeros(6, bool), 0.5)
    assert (some.places.tolist(), some.needed) == ([0, 2], 3)
    assert np.isfinite(some.feed).tolist() == [True, False, True, False, False, False]
    every = advised.select_share(reached, np.zeros(6, bool), 1.0)
    assert len(every.places) == 3
    assert (every.limit_feeds()[[3, 4, 5]] == np.inf).all()


def test_points_within_tolerance_at_the_programmed_feed_are_not_slowed() -> None:
    advised = AdvisedFeeds(np.array([9.0, 5.0, 8.0, 7.0]), 0, target=np.array([0, 1, 2, 2]))
    reached, passes = np.array([10.0, 4.0, 10.0, 10.0]), np.array([False, False, True, False])
    # at point 1 the axes limit the feed below its advice; point 3 belongs to hole 2
    some = advised.select_share(reached, passes, 1.0)
    assert (some.places.tolist(), some.needed) == ([0], 1)
    assert (some.limit_feeds()[1:] == np.inf).all()


def test_all_moves_of_a_hole_count_as_one() -> None:
    target = np.array([2, 2, 2, 5, 5, 5])
    advised = AdvisedFeeds(np.array([4.0, 4.0, 4.0, 9.0, 9.0, 9.0]), 0, target=target)
    some = advised.select_share(np.full(6, 10.0), np.zeros(6, bool), 0.5)
    assert (some.places.tolist(), some.needed) == ([5], 2)
    assert np.isfinite(some.feed).tolist() == [False, False, False, True, True, True]


def test_advised_feed_is_lowered_to_that_of_the_driven_configurations() -> None:
    planned = AdvisedFeeds(np.array([4.0, np.nan, 6.0]), 0)
    assert planned.lower_to(AdvisedFeeds(np.array([5.0, 1.0, 6.0]), 0)) is None
    lowered = planned.lower_to(AdvisedFeeds(np.array([3.0, 1.0, 0.0]), 0))
    assert lowered is not None
    assert np.array_equal(lowered.feed, [3.0, np.nan, 6.0], equal_nan=True)


@pytest.mark.parametrize("options", [{"compensate": True}, {"advised_feed_share": 0.0}, {"advised_feed_share": 1.5}])
def test_inconsistent_options_are_refused(tmp_path: Path, options: dict[str, object]) -> None:
    with pytest.raises(InputError):
        optimize(write_pass(tmp_path / "pass.csv"), tmp_path / "out", **{"advised_feed_share": 1.0, **options})


def test_job_without_tolerances_is_refused(tmp_path: Path) -> None:
    job = write_pass(tmp_path / "pass.csv")
    request = OptimizeRequest(cell=CELL, toolpath=job, out=tmp_path / "out", direct={"advised_feed_share": 1.0})
    with pytest.raises(InputError) as error:
        run_optimize(request)
    assert error.value.where == "advised_feed_share"
