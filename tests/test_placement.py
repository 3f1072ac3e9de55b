"""Placement: sampled positions, moved bodies, supports, and the best position of all."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML
from sample_placement import build_sample_placement
from small_cell import pose, small_cell

import machopt
from machopt.cell.cell_reader import load_cell
from machopt.cell.moved_cell_writer import write_moved_cell
from machopt.cli import main
from machopt.commands.place.document import _format_verdict
from machopt.data_types.cell import Cell, CollisionShape
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError
from machopt.placement.journal import SearchJournal
from machopt.placement.moved_cell import (
    MovedBodies,
    check_robot_movable,
    compute_rotation_centre,
    move_cell,
    select_moved_obstacles,
)
from machopt.placement.placement_site import PlacementSite
from machopt.placement.search import find_best_placement
from machopt.placement.search_options import (
    NO_SHIFT,
    ROTATION_LEVER_M,
    PlacementOptions,
    PlacementShift,
    build_shift_grid,
    clip_shift,
    compute_grid_steps,
)
from machopt.placement.search_result import PlacementCandidate, PlacementSearchResult, PlannedPlacement
from machopt.placement.support_check import SupportModel
from machopt.report.pages.placement_page import build_placement_html
from machopt.toolpath.toolpath_reader import read_toolpath

CELLS = Path(__file__).resolve().parents[1] / "cells"
HOLES = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "".join(
    f"{x},{y},20,0,0,1,rapid,\n{x},{y},-2,0,0,1,cut,300\n{x},{y},20,0,0,1,retract,3000\n"
    for x in (-80, 80)
    for y in (-60, 60)
)


def test_first_place_is_that_of_the_cell_and_the_others_an_even_grid() -> None:
    search = PlacementOptions(x=(-0.2, 0.2), y=(-0.1, 0.1), z=(0.0, 0.0), turn=(0.0, 0.0), places=15)
    found = build_shift_grid(search)
    assert found[0] == NO_SHIFT
    assert len(found) <= 16
    assert len({s.x for s in found}) == 5
    assert len({s.y for s in found}) == 3
    assert compute_grid_steps(search).x == pytest.approx(0.1)
    assert len(set(found)) == len(found)  # the original position is not included twice


@given(
    st.tuples(*[st.floats(0.0, 1.0)] * 3, st.floats(0.0, 3.0)).filter(lambda v: max(v) > 1e-3),
    st.integers(1, 300),
)
def test_number_of_places_is_limited(spans: tuple[float, ...], most: int) -> None:
    search = PlacementOptions(
        **{n: (0.1, 0.1 + v) for n, v in zip(("x", "y", "z", "turn"), spans, strict=True)}, places=most
    )
    found = build_shift_grid(search)
    assert 2 <= len(found) <= most + 1
    for name in ("x", "y", "z", "turn"):
        low, high = getattr(search, name)
        assert all(low - 1e-9 <= getattr(s, name) <= high + 1e-9 for s in found[1:])
    assert all(clip_shift(search, s) == s for s in found[1:])


@pytest.mark.parametrize(
    ("asked", "works"),
    [
        ({"x": (0.1, -0.1)}, "least before greatest"),
        ({"y": (0.0, 300.0)}, "at most 20 m"),
        ({"turn": (0.0, 90.0)}, "at most 6.28 rad"),
        ({"x": (0.0, float("nan"))}, "least before greatest"),
        ({"places": 0}, "1 or more"),
        ({"seconds": 0.0}, "positive number"),
    ],
)
def test_invalid_ranges_are_refused(asked: dict[str, object], works: str) -> None:
    with pytest.raises(InputError, match=works):
        PlacementOptions(**asked)  # type: ignore[arg-type]


def test_range_without_another_place_is_refused() -> None:
    with pytest.raises(InputError, match="--x-mm -300 300"):
        build_shift_grid(PlacementOptions(x=(0.0, 0.0), y=(0.0, 0.0)))


def test_rotation_preserves_the_centre_and_moves_the_fixture(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    middle = compute_rotation_centre(cell, np.array([[-0.1, -0.2, 0.0], [0.1, 0.2, 0.0]]), base=False)
    np.testing.assert_allclose(middle, [1.5, 0, 0.6])
    carried = MovedBodies(False, frozenset({"table"}), middle)
    at = move_cell(cell, carried, PlacementShift(0.1, 0.0, 0.05, np.pi / 2))
    np.testing.assert_allclose(at.workpiece.T_link_workpiece[:3, 3], [1.6, 0, 0.65], atol=1e-12)
    np.testing.assert_allclose(at.workpiece.T_link_workpiece[:3, 0], [0, 1, 0], atol=1e-12)
    relative = [np.linalg.inv(c.workpiece.T_link_workpiece) @ c.obstacles[0].T_parent_shape for c in (cell, at)]
    np.testing.assert_allclose(*relative, atol=1e-12)
    assert at.obstacles[1] is cell.obstacles[1]  # the post does not move


def test_moving_the_robot_equals_moving_everything_else_inversely(tmp_path: Path) -> None:
    cell, shift = small_cell(tmp_path), PlacementShift(0.2, -0.1, 0.0, 0.3)
    at = move_cell(cell, MovedBodies(True, frozenset(), cell.T_world_base[:3, 3]), shift)
    S = shift.build_matrix(cell.T_world_base[:3, 3])
    np.testing.assert_allclose(
        np.linalg.inv(at.T_world_base) @ at.workpiece.T_link_workpiece,
        np.linalg.inv(S) @ cell.workpiece.T_link_workpiece,
        atol=1e-12,
    )


def test_fixture_moves_with_the_part_and_the_floor_does_not(tmp_path: Path) -> None:
    floor = CollisionShape(
        name="floor", kind="box", size=(6.0, 6.0, 0.1), mesh=None, T_parent_shape=pose(1.0, 0, -0.05)
    )
    leg = CollisionShape(name="leg", kind="box", size=(0.2, 0.2, 0.39), mesh=None, T_parent_shape=pose(1.5, 0, 0.195))
    cell = small_cell(tmp_path)
    standing = SupportModel.build(replace(cell, obstacles=(*cell.obstacles, leg, floor)))
    assert standing.find_moved_obstacles(base=False) == {"table", "leg"}  # the post next to it does not touch the table
    assert standing.find_moved_obstacles(base=True) == set()  # robot and leg are on the floor


def test_common_table_of_robot_and_part_is_fixed(tmp_path: Path) -> None:
    bench = CollisionShape(
        name="bench", kind="box", size=(3.0, 2.0, 0.49), mesh=None, T_parent_shape=pose(1.0, 0, 0.245)
    )
    pedestal = CollisionShape(
        name="pedestal", kind="box", size=(0.5, 0.5, 0.5), mesh=None, T_parent_shape=pose(0.0, 0, 0.74)
    )
    vice = CollisionShape(name="vice", kind="box", size=(0.3, 0.3, 0.06), mesh=None, T_parent_shape=pose(1.5, 0, 0.52))
    cell = small_cell(tmp_path, T_world_base=pose(0, 0, 0.99), obstacles=(bench, pedestal, vice))
    cell = replace(cell, workpiece=replace(cell.workpiece, T_link_workpiece=pose(1.5, 0, 0.65)))
    assert SupportModel.build(cell).find_moved_obstacles(base=False) == {"vice"}
    assert SupportModel.build(cell).find_moved_obstacles(base=True) == {"pedestal"}
    ceiling = CollisionShape(
        name="ceiling", kind="box", size=(3.0, 2.0, 0.1), mesh=None, T_parent_shape=pose(1.0, 0, 3.05)
    )
    wall = CollisionShape(name="wall", kind="box", size=(0.1, 2.0, 3.0), mesh=None, T_parent_shape=pose(2.45, 0, 1.5))
    hung = np.diag([1.0, -1.0, -1.0, 1.0])
    hung[2, 3] = 3.0
    cell = replace(cell, T_world_base=hung, obstacles=(bench, vice, ceiling, wall))
    assert SupportModel.build(cell).find_moved_obstacles(base=False) == {"vice", "bench"}


def test_no_body_is_moved_into_another(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    standing = SupportModel.build(cell)
    centre = np.array([1.5, 0, 0.6])
    refusal = standing.build_shift_check(frozenset(), base=False)  # the block alone; the table does not move

    def why(shift: PlacementShift) -> str:
        return refusal.find_refusal_reason(shift, shift.build_matrix(centre))

    assert why(NO_SHIFT) == ""
    assert why(PlacementShift(x=0.1)) == ""
    assert "table" in why(PlacementShift(z=-0.05))
    assert why(PlacementShift(z=-0.005)) == ""  # the gap is 10 mm
    assert "post" in why(PlacementShift(x=-0.2, y=0.5))
    inside_it = SupportModel.build(
        replace(
            cell,
            obstacles=(
                CollisionShape(
                    name="hall", kind="box", size=(1.0, 1.0, 1.0), mesh=None, T_parent_shape=pose(1.5, 3.0, 0.6)
                ),
            ),
        )
    )
    far = PlacementShift(y=3.0)
    swallowed = inside_it.build_shift_check(frozenset(), base=False).find_refusal_reason(far, far.build_matrix(centre))
    assert swallowed == "workpiece would intersect hall"


def test_part_does_not_sink_into_its_support(tmp_path: Path) -> None:
    cell = small_cell(
        tmp_path,
        obstacles=(
            CollisionShape(
                name="table", kind="box", size=(1.0, 1.4, 0.1), mesh=None, T_parent_shape=pose(1.5, 0, 0.45)
            ),
        ),
    )
    refusal = SupportModel.build(cell).build_shift_check(frozenset(), base=False)
    down, aside = PlacementShift(z=-0.02), PlacementShift(x=0.1)
    assert (
        refusal.find_refusal_reason(down, down.build_matrix(np.zeros(3))) == "it rests on table and would sink into it"
    )
    assert refusal.find_refusal_reason(aside, aside.build_matrix(np.zeros(3))) == ""


def test_obstacles_have_correct_names(tmp_path: Path) -> None:
    cell, holding = small_cell(tmp_path), frozenset({"table"})
    assert select_moved_obstacles(cell, PlacementOptions(), holding) == {"table"}
    assert select_moved_obstacles(cell, PlacementOptions(stay=("table",)), holding) == frozenset()
    assert select_moved_obstacles(cell, PlacementOptions(carry=("post",)), holding) == {"post"}
    with pytest.raises(InputError, match="did you mean 'table'"):
        select_moved_obstacles(cell, PlacementOptions(carry=("tabel",)), holding)


def test_robot_beside_a_positioner_is_not_moved(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    with pytest.raises(InputError, match="--move workpiece"):
        check_robot_movable(replace(cell, workpiece=replace(cell.workpiece, link="table")), base=True)


def test_journal_matches_its_request_and_survives_truncation(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    first = SearchJournal(file, "a")
    place = first.append(PlacementCandidate(number=3, shift=PlacementShift(0.1), bound=0.5, worst=float("inf")))
    done = first.append(PlannedPlacement(place=place, worst=0.7, shares=(0.5,) * 6))
    with file.open("a") as out:
        out.write('{"place": {"numb')
    again = SearchJournal(file, "a")
    assert again.find_candidate(3, PlacementShift(0.1)) == place
    assert again.find_candidate(3, PlacementShift(0.2)) is None
    found = again.find_planned(place)
    assert found is not None
    assert found.worst == done.worst
    assert found.shares == done.shares
    # another search starts from the beginning
    assert SearchJournal(file, "b").find_candidate(3, PlacementShift(0.1)) is None
    assert SearchJournal(file, "a").find_candidate(3, PlacementShift(0.1)) is None
    SearchJournal(file, "a").remove()
    assert not file.exists()


@pytest.mark.parametrize("base", [False, True])
def test_moved_cell_loads_as_planned(tmp_path: Path, base: bool) -> None:
    cell = load_cell(CELLS / "kr240_drilling")
    carried = MovedBodies(base, frozenset({"leg_1", "frame_left"}), np.array([1.7, 0.0, 0.8]))
    at = move_cell(cell, carried, PlacementShift(0.123, -0.2, 0.01, 0.7))
    file = write_moved_cell(tmp_path / "cell", cell, at, "a head")
    found = load_cell(file.parent)
    np.testing.assert_allclose(found.T_world_base, at.T_world_base, atol=2e-8)
    np.testing.assert_allclose(found.workpiece.T_link_workpiece, at.workpiece.T_link_workpiece, atol=2e-8)
    for a, b in zip(found.obstacles, at.obstacles, strict=True):
        np.testing.assert_allclose(a.T_parent_shape, b.T_parent_shape, atol=2e-8)
    text = file.read_text("utf-8")
    assert text.startswith("# a head\n")
    assert "# an assumption: README.md" in text


def _site(folder: Path, search: PlacementOptions) -> PlacementSite:
    cell: Cell = replace(
        small_cell(folder), stiffness=ArmStiffness(joints=np.array([2.0, 2.0, 1.5, 0.5, 0.4, 0.3]) * 1e6)
    )
    (folder / "holes.csv").write_text(HOLES)
    options = PlanOptions(rotation_step=np.radians(15.0))
    return PlacementSite.build(cell, (read_toolpath(folder / "holes.csv"),), options, search)


@dataclass(frozen=True, eq=False)
class _Eager:
    """Requests results in advance, as several processes do, and computes them on a copy of the site."""

    site: PlacementSite
    worker_count: int = 3

    def map_items(self, ask: Callable[[PlacementSite, Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        copied, questions = replace(self.site), pickle.loads(pickle.dumps((ask, list(items))))
        return iter([questions[0](copied, item) for item in questions[1]])


@pytest.mark.slow
def test_best_place_is_the_best_of_all_and_early_stopping_changes_nothing(tmp_path: Path) -> None:
    """Compared with a complete plan of every position, which the bound avoids."""
    search = PlacementOptions(x=(-0.3, 0.5), y=(-0.2, 0.2), places=12, best=1)
    site = _site(tmp_path, search)
    file = tmp_path / "journal.jsonl"
    found = find_best_placement(site, search, SearchJournal(file, "q"))
    every = [site.plan_candidate(p) for p in found.places[: len(build_shift_grid(search))] if p.is_feasible]
    assert len(every) > 6
    done = {p.place.number: p for p in every if not p.refused}
    for p in done.values():
        assert p.worst >= p.place.bound * (1 - 2e-3)  # the bound is valid except between grid rotations
    best = min(p.worst for p in done.values())
    assert found.is_optimal
    assert found.best[0].worst <= best * (1 + 2e-3)
    assert len(found.planned) < len(every)
    message: list[str] = []
    again = find_best_placement(site, search, SearchJournal(file, "q"), message.append)
    assert [(p.place, p.worst, p.shares) for p in again.planned] == [
        (p.place, p.worst, p.shares) for p in found.planned
    ]
    many = find_best_placement(site, search, SearchJournal(None, ""), executor=_Eager(site))
    assert [(p.place, p.worst, p.shares) for p in many.planned] == [(p.place, p.worst, p.shares) for p in found.planned]
    assert (many.places, many.around, many.open_limit) == (found.places, found.around, found.open_limit)
    few = find_best_placement(site, replace(search, plans=1), SearchJournal(None, ""))
    assert few.stopped
    assert not few.is_optimal
    assert few.open_bound <= few.best[0].worst


WIDE_HOLES = HOLES.replace("20,0,0,1", "60,0,0,1")


@dataclass(frozen=True)
class PlacedJob:
    """The files and output of ``machopt place --json`` for WIDE_HOLES at four positions along x."""

    holes: Path
    out: Path
    told: dict[str, Any]


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> PlacedJob:
    """One search for all tests that compare with it."""
    folder, printed = tmp_path_factory.mktemp("placed"), io.StringIO()
    (folder / "holes.csv").write_text(WIDE_HOLES)
    arguments = ["place", str(CELLS / "kr240_drilling"), str(folder / "holes.csv"), "-o", str(folder / "out")]
    arguments += ["--places", "4", "--x-mm", "-100", "100", "--y-mm", "0", "0", "--best", "1", "--json", "--jobs", "2"]
    with contextlib.redirect_stdout(printed):
        assert main([*arguments, "--set", "rotation_step_deg=15", "--tables", "parquet"]) == 0
    return PlacedJob(folder / "holes.csv", folder / "out", json.loads(printed.getvalue()))


@pytest.mark.slow
def test_command_writes_verified_plans_in_moved_cells(placed: PlacedJob) -> None:
    out, message = placed.out, placed.told
    assert message["proven"]
    assert message["best"][0]["folder"] == "best-1"
    assert set(message["carried"]) >= {"frame_near", "clamp_1", "leg_4"}
    assert "pedestal" not in message["carried"]
    assert json.loads((out / "best-1" / "holes" / "result.json").read_text())["verdict"].startswith("done")
    checked = ["verify", str(out / "best-1" / "cell"), str(placed.holes), str(out / "best-1" / "holes")]
    assert main([*checked, "--quiet", "--set", "rotation_step_deg=15"]) == 0
    tables = {str(p.relative_to(out).with_suffix("")) for p in out.rglob("*.csv")}
    assert tables >= {"places", "best-1/holes/points", "best-1/holes/trajectory"}
    assert tables == {str(p.relative_to(out).with_suffix("")) for p in out.rglob("*.parquet")}
    rows = (out / "places.csv").read_text().splitlines()
    assert len(rows) == 1 + message["looked_at"]
    assert rows[1].startswith("0,0,0,0,,")
    assert not (out.parent / "out.progress.jsonl").exists()


@pytest.mark.slow
def test_library_finds_what_the_command_finds(tmp_path: Path, placed: PlacedJob) -> None:
    (tmp_path / "holes.csv").write_text(WIDE_HOLES)
    requested = {"x_mm": (-100, 100), "y_mm": (0, 0), "places": 4, "best": 1, "rotation_step_deg": 15.0}
    found = machopt.place(CELLS / "kr240_drilling", tmp_path / "holes.csv", **requested)
    assert found.proven
    assert found.result.best[0].worst == placed.told["best"][0]["worst"]
    assert found.places.rows == found.result.looked_at
    result = found.save(tmp_path / "out")
    before = found.result
    assert result.best[0].worst == before.best[0].worst
    assert before.best[0].folder is None
    assert (tmp_path / "out" / str(result.best[0].folder) / "holes" / "trajectory.csv").is_file()
    with pytest.raises(machopt.InputError, match="rotation_step_deg"):
        machopt.place(CELLS / "kr240_drilling", tmp_path / "holes.csv", rotation_stp_deg=15.0)


def test_unknown_argument_suggests_library_names_first() -> None:
    for word, meant in (("plcaes", "places"), ("rotation_stp_deg", "rotation_step_deg")):
        with pytest.raises(InputError, match=f"unknown option '{word}'; did you mean '{meant}'. valid: x_mm, y_mm"):
            machopt.place(CELLS / "kr240_drilling", "holes.csv", **{word: 3})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--set", "method=jiao2022"], "global would work"),
        (["--set", "allow_gaps=true"], "leaving the soft points out"),
        (["--x-mm", "300", "-300"], "least before greatest"),
        (["--seed", "-1"], "seed"),
        (["--carry", "clampp_1"], "did you mean 'clamp_1'"),
    ],
)
def test_incomparable_request_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], says: str
) -> None:
    (tmp_path / "holes.csv").write_text(HOLES)
    arguments = [
        "place",
        str(CELLS / "kr240_drilling"),
        str(tmp_path / "holes.csv"),
        "-o",
        str(tmp_path / "out"),
        *more,
    ]
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["holes.csv"]


@pytest.mark.slow
def test_unreachable_part_may_be_moved_into_reach(tmp_path: Path) -> None:
    """A shift brings the part into reach; if none does, the message asks about the unit, and nothing is written."""
    holes = HOLES.replace("\n-80,", "\n4920,").replace("\n80,", "\n5080,").replace(",20,0,0,1", ",60,0,0,1")
    (tmp_path / "holes.csv").write_text(holes)
    cell, requested = CELLS / "kr240_drilling", {"y_mm": (0, 0), "places": 2, "rotation_step_deg": 15.0}
    with pytest.raises(machopt.InputError, match="inches that are mm"):
        machopt.place(cell, tmp_path / "holes.csv", x_mm=(-100, 100), **requested)
    found = machopt.place(cell, tmp_path / "holes.csv", x_mm=(-5000, -4900), **requested)
    assert found.result.best[0].shift_mm[0] <= -4900
    assert found.result.as_it_stands is not None
    assert "out of reach" in found.result.as_it_stands.verdict


@pytest.mark.slow
def test_cluster_workers_find_what_processes_find(
    tmp_path: Path, scheduler: str, placed: PlacedJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Includes relative paths: the working directory of the workers is another one."""
    (tmp_path / "holes.csv").write_text(WIDE_HOLES)
    monkeypatch.chdir(tmp_path)
    arguments = ["place", str(CELLS / "kr240_drilling"), "holes.csv", "-o", "out", "--places", "4", "--best", "1"]
    arguments += [
        "--x-mm",
        "-100",
        "100",
        "--y-mm",
        "0",
        "0",
        "--set",
        "rotation_step_deg=15",
        "--scheduler",
        scheduler,
    ]
    assert main([*arguments, "--quiet"]) == 0
    message = json.loads((tmp_path / "out" / "place.json").read_text())
    assert message["best"][0]["worst"] == placed.told["best"][0]["worst"]
    assert (tmp_path / "out" / "best-1" / "holes" / "report.html").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["holes.csv", "out"]


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--scheduler", "nowhere", "no Dask scheduler answers at nowhere"),
        ("--places", "3", "--places: 3 leave one place"),
    ],
)
def test_invalid_request_is_refused_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, told: str
) -> None:
    (tmp_path / "holes.csv").write_text(HOLES)
    arguments = ["place", str(CELLS / "kr240_drilling"), str(tmp_path / "holes.csv"), "-o", str(tmp_path / "out")]
    assert main([*arguments, option, value]) == 2
    assert told in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["holes.csv"]


@pytest.mark.slow
def test_worker_processes_end_with_their_parent(tmp_path: Path) -> None:
    """The parent is killed, so no cleanup is possible: its output stays open while one of its processes is alive."""
    script = tmp_path / "asks.py"
    script.write_text(
        "import os, time\nfrom machopt.batch.placement_workers import _open_process_pool\nif __name__ == '__main__':\n"
        "    with _open_process_pool(1) as pool:\n        print(pool.submit(os.getpid).result(), flush=True)\n"
        "        time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as asker:
        assert asker.stdout is not None
        worker = int(asker.stdout.readline())
        asker.kill()
        try:
            assert asker.communicate(timeout=20)[0] == b""
        except subprocess.TimeoutExpired:
            os.kill(worker, signal.SIGKILL)
            raise


def test_stopped_search_states_that_it_can_be_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("machopt.commands.place.run.run_place", stopped)
    (tmp_path / "holes.csv").write_text(HOLES)
    arguments = ["place", str(CELLS / "kr240_drilling"), str(tmp_path / "holes.csv"), "-o", str(tmp_path / "out")]
    assert main([*arguments, "--jobs", "1"]) == 130
    assert "what was found is kept, the same command goes on" in capsys.readouterr().err


def test_places_weigh_rotations_like_shifts() -> None:
    found = compute_grid_steps(PlacementOptions(x=(0, 0.3), y=(0, 0), turn=(0, 1.0), places=16))
    assert found.x == pytest.approx(0.1)
    assert found.turn == pytest.approx(0.1 / ROTATION_LEVER_M)


@pytest.mark.parametrize(
    ("numbers", "open_bound", "says"),
    [
        (
            [0],
            1.6,
            "no place was planned but the one where the cell has it; stopped after 10 min, a place left out may",
        ),
        ([0, 3], 1.6, "the best place of the 2 that were planned is where the cell has it; stopped after 10 min"),
        ([0], 2.0, "the best place is where the cell has it; no other of the 5 places can be better"),
    ],
)
def test_stopped_search_names_no_uncompared_best(numbers: list[int], open_bound: float, says: str) -> None:
    planned = [
        PlannedPlacement(
            place=PlacementCandidate(number=n, shift=PlacementShift()), worst=2.0 + n, mean=1.0, cycle_time=1.0
        )
        for n in numbers
    ]
    siting = PlacementSearchResult(
        carried=None,
        places=(None,) * 5,
        planned=tuple(planned),
        around={},
        open_limit=(0.0, open_bound),
        stopped="" if open_bound == 2.0 else "after 10 min",
    )  # type: ignore[arg-type]
    assert _format_verdict(siting, 0.0, 0, (), of_grid=False).startswith(says)


@pytest.mark.parametrize("x", [-1.2, -0.8, -0.57, -0.4, -0.1, 0.0, 0.2, 0.5, 0.58, 0.7, 1.5])
@pytest.mark.parametrize("z", [0.0, 0.005, 0.02])
def test_part_that_leaves_its_table_is_named(tmp_path: Path, x: float, z: float) -> None:
    """A plate of 100 mm on a table of 1 m: it leaves the table when no part of it is within 10 mm of the table."""
    table = CollisionShape(
        name="table", kind="box", size=(1.0, 1.0, 0.1), mesh=None, T_parent_shape=pose(1.5, 0.0, -0.05)
    )
    plate = CollisionShape(
        name="plate", kind="box", size=(0.1, 0.1, 0.02), mesh=None, T_parent_shape=pose(0.0, 0.0, 0.01)
    )
    cell = replace(small_cell(tmp_path), obstacles=(table,))
    part = replace(cell.workpiece, link="world", T_link_workpiece=pose(1.5, 0.0, 0.0), geometry=(plate,))
    refusal = SupportModel.build(replace(cell, workpiece=part)).build_shift_check(frozenset(), base=False)
    assert refusal.existing_supports == ("table",)
    gap = np.hypot(max(abs(x) - 0.55, 0.0), z)
    assert refusal.find_lost_supports(PlacementShift(x=x, z=z).build_matrix(np.zeros(3))) == (
        ("table",) if gap > 0.010 else ()
    )


def test_place_is_shown_in_cell_format() -> None:
    one = (
        build_sample_placement()
        .result.best[0]
        .model_copy(update={"xyz_mm": (1234.567891, -0.0, 5e5), "rpy_deg": (0.0, -90.0, 12.5)})
    )
    assert YAML(typ="safe").load(one.pose_text) == {"xyz_mm": [1234.567891, 0, 500000], "rpy_deg": [0, -90, 12.5]}
    page = build_placement_html(build_sample_placement())
    assert one.plans[0] in page
    assert "workpiece.pose" in page
