"""Bands of rotations in contact along a whole cut are excluded together."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from test_cli import ROOT
from test_collision_free_sequence import assert_closed_by_themselves

from machopt.cell.cell_reader import load_cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools
from machopt.options.plan_option_reader import load_options
from machopt.planning.collision_handling.exclusions import ExclusionTracker
from machopt.planning.pipeline import collision_free_search
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions, TransitionCollector
from machopt.toolpath.toolpath_reader import read_toolpath

BOXES = """
  - {name: box_0, box_mm: [78.5, 83.1, 85.3], xyz_mm: [416.8, -113.8, 809.5]}
  - {name: box_2, box_mm: [137.4, 82.1, 85.3], xyz_mm: [290.3, 162.9, 821.8]}
  - {name: box_4, box_mm: [90.5, 127.7, 67.9], xyz_mm: [544.6, -133.8, 777.6]}
"""


def test_swings_over_a_closed_band_are_checked_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cobot with 12 mm required clearance along one pass; when excluded one at a time, the search did not end
    within a minute."""
    monkeypatch.setattr(collision_free_search, "ROUNDS", 60)
    folder = shutil.copytree(ROOT / "cells" / "cutting_cobot", tmp_path / "cell")
    text = (folder / "cell.yaml").read_text()
    head = text[: text.index("obstacles:")].replace("xyz_mm: [470, 110, 900]", "xyz_mm: [540, 163, 796]")
    (folder / "cell.yaml").write_text(f"{head}obstacles:{BOXES}stiffness: stiffness.yaml\n")
    begin, step = np.array([-24.21083, 98.981462]), np.array([-3.129047, -7.618662])
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for k in range(21):
        x, y = begin + k * step
        for z, move, feed in (
            ((40, "rapid", ""), (3, "approach", 1500), (0, "cut", 600)) if not k else ((0, "cut", 600),)
        ):
            rows.append(f"{x:.6f},{y:.6f},{z},0,0,1,{move},{feed}")
    rows.append(f"{x:.6f},{y:.6f},40,0,0,1,retract,3000")
    (tmp_path / "pass.csv").write_text("\n".join(rows) + "\n")
    options = load_options({}, None, ["clearance_mm=12", "force_N={axial: 460}"])
    p = plan_path(load_cell(folder), read_toolpath(tmp_path / "pass.csv"), options)
    assert p.found is not None
    assert p.found.check.free
    assert p.found.rounds < 30
    assert len(p.found.edges.closed) > 100
    assert_closed_by_themselves(p)


class Bands:
    """A checker stub: the first joint is the rotation, and each pair is in contact in bands (rad) of it."""

    def __init__(self, *bands: tuple[tuple[float, float], ...]) -> None:
        self.bands, self.model, self.step, self.asked = bands, self, 0.01, 0
        self.pairs = [SimpleNamespace(unless_cutting=False, clearance=0.0) for _ in bands]

    def check_single_pairs(self, q: Array, pair: Any) -> Bools:
        bands = self.bands[int(pair[0])] if len(pair) else ()
        hits = [(q[:, 0] > low) & (q[:, 0] < high) for low, high in bands]
        return np.asarray(np.any([np.zeros(len(q), bool), *hits], axis=0))

    def stretch(self, rows: Any, phi: Array, q: Array) -> tuple[Bools, Any, Bools]:
        dense = np.zeros((301, 6))
        dense[:, 0] = np.linspace(q[0, 0], q[1, 0], 301)
        hits = [
            (int(np.argmax(hit)), p)
            for p in range(len(self.bands))
            if (hit := self.check_single_pairs(dense, [p])).any()
        ]
        first = min(hits)[1] if hits else -1
        return np.array([False, first >= 0]), np.array([-1, first], np.int32), np.zeros(2, bool)

    def on_the_way(self, row: int, phi: Any, q: Any, wanted: Array) -> tuple[Array, Array, Bools]:
        self.asked += len(wanted)
        return wanted, q[0] + wanted[:, None] * (q[1] - q[0]), (wanted > 0.0) & (wanted < 1.0)


def build_banded_tracker(checker: Bands, stations: int, rotations: int = 36) -> ExclusionTracker:
    """Build a tracker for a cut with the bands at all stations, in one branch and turn."""
    S, R = stations, rotations
    phi: Array = np.asarray(np.arange(R) * (2 * np.pi / R) - np.pi, float)
    q = np.zeros((S, R, 1, 6))
    q[..., 0, 0] = phi
    free = np.array(
        [
            not any(checker.check_single_pairs(row[None], [p])[0] for p in range(len(checker.bands)))
            for row in q[0, :, 0]
        ]
    )
    path = SimpleNamespace(
        stations=np.arange(S), run=np.zeros(S, int), may_touch=np.zeros(S, bool), external=np.zeros((S, 0))
    )
    candidates = CandidateGrid(
        branch=np.arange(1),
        phi=phi,
        q=q,
        turns=np.zeros((1, 6)),
        reason=np.full((S, R, 1), int(InfeasibilityReason.OK), np.uint8),
        feasible=np.broadcast_to(free[None, :, None, None], (S, R, 1, 1)).copy(),
        stable=True,
        shortfall=np.zeros(S),
    )
    strikes: Any = ExclusionTracker
    return cast(ExclusionTracker, strikes(path=path, candidates=candidates, checker=checker, progress=lambda _: None))


def build_swing(strikes: ExclusionTracker, s: int, before: float, here: float) -> SequenceChoice:
    """Return a sequence with one rotation (deg) before a station and another one from there on."""
    S, phi = len(strikes.candidates.q), np.degrees(strikes.candidates.phi)
    r = np.where(np.arange(S) < s, np.argmin(np.abs(phi - before)), np.argmin(np.abs(phi - here))).astype(np.int32)
    nothing = np.zeros(S, np.int32)
    return SequenceChoice(
        rotation=r, branch=nothing, turn=nothing, q=strikes.candidates.q[np.arange(S), r, 0], broken=()
    )


def add_contacts(strikes: ExclusionTracker, choice: SequenceChoice, *stations: int) -> None:
    hit = np.zeros(len(choice.rotation), bool)
    hit[list(stations)] = True
    check = SimpleNamespace(hit=hit, lost=np.zeros_like(hit), pair=np.where(hit, 0, -1))
    plain = SimpleNamespace(reason=np.full(len(hit), int(InfeasibilityReason.OK)))
    untyped: Any = strikes
    untyped.grid(choice, plain, check, len(hit))


def list_crossing_rotations(strikes: ExclusionTracker, degrees: float) -> list[set[int]]:
    """Return for each station the source rotations of excluded edges that increase past an angle."""
    phi, out = np.degrees(strikes.candidates.phi), [set[int]() for _ in strikes.candidates.q]
    for s, u, v in strikes.edges.closed:
        if phi[u] < degrees < phi[v] <= phi[u] + 90.0:
            out[s].add(int(u))
    return out


def test_first_contact_of_the_chosen_way_is_searched() -> None:
    """Below the band there is another one, which slightly different edges touch first."""
    checker = Bands(((np.radians(2.0), np.radians(8.0)),), ((np.radians(-48.0), np.radians(-42.0)),))
    strikes = build_banded_tracker(checker, 12)
    add_contacts(strikes, build_swing(strikes, 5, -40.0, 20.0), 5)
    assert strikes.banned[5] == 0
    assert all(list_crossing_rotations(strikes, 5.0)[1:])


@pytest.mark.parametrize("gap", [4.0, 30.0])
def test_way_with_two_contacts_closes_swings_over_either(gap: float) -> None:
    """Between the two bands there is no contact."""
    low, high = (tuple(np.radians([at - 2.0, at + 2.0])) for at in (-gap / 2 - 3.0, gap / 2 + 3.0))
    checker = Bands(((low[0], low[1]), (high[0], high[1])))
    strikes = build_banded_tracker(checker, 12)
    add_contacts(strikes, build_swing(strikes, 5, -40.0, 40.0), 5)
    for at in (-gap / 2 - 3.0, gap / 2 + 3.0):
        assert all(list_crossing_rotations(strikes, at)[1:])


def test_closed_bands_are_not_checked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many swings over one band: its edges are checked once and merged once per iteration."""
    merges: list[int] = []
    plus_closed = ForbiddenTransitions.plus_closed

    def counted(self: ForbiddenTransitions, ways: Any) -> ForbiddenTransitions:
        merges.append(len(ways))
        return plus_closed(self, ways)

    monkeypatch.setattr(ForbiddenTransitions, "plus_closed", counted)
    checker = Bands(((np.radians(2.0), np.radians(8.0)),))
    strikes = build_banded_tracker(checker, 40)
    add_contacts(strikes, build_swing(strikes, 20, -10.0, 20.0), 20)
    assert len(merges) == 1
    first, closed = checker.asked, strikes.edges.closed
    assert len(np.unique(closed, axis=0)) == len(closed) > 1000
    add_contacts(strikes, build_swing(strikes, 12, -20.0, 30.0), 12)
    assert checker.asked - first < first / 10
    again = checker.asked
    add_contacts(strikes, build_swing(strikes, 30, -20.0, 30.0), 30)
    assert checker.asked - again <= 65 + 40


def test_ways_gathered_equal_those_added_one_by_one() -> None:
    rng = np.random.default_rng(3)
    ways = np.column_stack([rng.integers(1, 9, 400), rng.integers(0, 2**31 - 1, 400) % 7, rng.integers(0, 5, 400)])
    begun = ForbiddenTransitions.none().plus_closed(ways[:100])
    closing, one_by_one = TransitionCollector(begun, 9), begun
    for s, u, v in ways[100:]:
        new = closing.open(int(s), np.array([u]), np.array([v]))[0]
        assert new == (not (one_by_one.closed == (s, u, v)).all(axis=1).any())
        closing.add(int(s), np.array([u]), np.array([v]))
        one_by_one = one_by_one.plus_closed(np.array([[s, u, v]]))
    assert (closing.merged().closed == one_by_one.closed).all()
    assert (one_by_one.closed == np.unique(ways, axis=0)).all()
    assert (begun.plus(*ways.astype(np.int32).T).target == np.unique(ways, axis=0)[:, 2]).all()
