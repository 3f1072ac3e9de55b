"""Targets closer than 0.1 mm are removed where the path does not need them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.programs.writing.target_insertion import ProgramTolerance, compare_with_line
from machopt.programs.writing.target_thinning import find_needed_targets

ROOT = Path(__file__).resolve().parents[1]
TOLERANCE = ProgramTolerance()


def poses(place: np.ndarray, tilt: np.ndarray | None = None) -> np.ndarray:
    """Return (M, 4, 4) at positions (M, 3) mm, tilted about y by (M,) rad."""
    T = np.tile(np.eye(4), (len(place), 1, 1))
    T[:, :3, 3] = 1e-3 * place
    if tilt is not None:
        T[:, 0, 0] = T[:, 2, 2] = np.cos(tilt)
        T[:, 0, 2], T[:, 2, 0] = np.sin(tilt), -np.sin(tilt)
    return T


def find_needed(T: np.ndarray, feed: float = 0.02, fixed: tuple[int, ...] = ()) -> np.ndarray:
    marks = np.zeros(len(T), bool)
    marks[list(fixed)] = True
    return find_needed_targets(T, np.empty((len(T), 0)), np.full(len(T), feed), marks, TOLERANCE)


def departures(T: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return (M, 4) the deviation of every removed target from the line."""
    rows = np.setdiff1d(np.arange(len(T)), kept)
    after = np.searchsorted(kept, rows)
    return compare_with_line(T[rows], T[kept[after - 1]], T[kept[after]])


@pytest.mark.parametrize("step", [0.001, 0.01, 0.05, 0.09])
@pytest.mark.parametrize("shape", ["line", "sine", "circle", "noise"])
def test_dense_points_are_thinned_within_the_tolerance(shape: str, step: float) -> None:
    s = step * np.arange(1000)
    across = {
        "line": 0 * s,
        "sine": 3 * np.sin(s / 4),
        "circle": 10 - np.sqrt(np.maximum(100 - (s / 20) ** 2, 0)),
        "noise": 0.004 * np.random.default_rng(1).standard_normal(len(s)),
    }[shape]
    T = poses(np.column_stack([s, across, 0 * s]))
    retained = find_needed(T)
    off = departures(T, retained)
    assert off[:, 0].max() <= 2e-5  # m, deviation from the points of the CAM file
    if shape != "noise":
        lengths = np.linalg.norm(np.diff(T[retained, :3, 3], axis=0), axis=1)
        assert (lengths[:-1] >= 1e-4).all()  # m
    assert len(retained) < len(T) / 2 or step > 0.05


def test_targets_needed_by_the_path_remain() -> None:
    corner = np.array([[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0], [0.1, 0.05, 0], [0.1, 0.1, 0]])
    assert 2 in find_needed(poses(corner))  # a corner 35 µm away from any line without it
    line = poses(np.column_stack([0.01 * np.arange(100), np.zeros((100, 2))]))
    assert {30, 60} <= set(find_needed(line, fixed=(30, 60)).tolist())
    turning = poses(np.zeros((30, 3)), np.radians(3.0) * np.arange(30))
    retained = find_needed(turning)
    assert departures(turning, retained)[:, 1].max(initial=0.0) <= np.radians(0.05)
    far = poses(np.column_stack([np.arange(10.0), np.zeros((10, 2))]))
    assert find_needed(far).tolist() == list(range(10))  # a path with distant points loses no target


@pytest.mark.slow
def test_feed_is_held_on_points_a_hundredth_of_a_millimetre_apart(tmp_path: Path) -> None:
    s = np.arange(0, 30, 0.01)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation", "0,0,60,0,0,1,rapid,,f"]
    rows += [f"{x:.6f},{3 * np.sin(x / 4):.6f},20,0,0,1,cut,1200,f" for x in s]
    file = tmp_path / "dense.csv"
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    posts = ("krl", "rapid", "urscript", "val3", "jbi", "fanuc_joint")
    cell = ROOT / "cells" / "kr500_milling"
    outcome = run_optimize(OptimizeRequest(cell=cell, toolpath=file, out=tmp_path / "out", posts=posts))
    assert outcome.exit_code == 0
    for program in outcome.result.programs:
        assert program.feed_model is not None
        assert program.feed_model.mean_percent >= 95.0, program.post
        assert program.feed_model.exact_stops <= 2, program.post
