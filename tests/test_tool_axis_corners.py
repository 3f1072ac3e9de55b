"""Corners of the tool axis end with exit 0 in every post."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from property_example_count import NIGHTLY
from random_small_jobs import POSTS, ROOT, UP, Row, axis_corner, write_job

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize


def corner_job(number: int) -> list[Row]:
    """Return the n-th of 25 corners of the tool axis: at a point, in one to four moves,
    over a radius of 0.02 to 1 mm."""
    rng = np.random.default_rng(number)
    angle, steps = np.radians([5, 10, 15, 20, 30, 45][number % 6]), 1 + number % 4
    radius = [0.0, 0.0, 0.02, 0.1, 1.0][number % 5]
    direction = 0.7 * number
    end = np.array([np.sin(angle) * np.cos(direction), np.sin(angle) * np.sin(direction), np.cos(angle)])
    leave = [np.array([40.0, 0.0, 0.0]), 20.0 * end, np.array([0.0, 40.0, 0.0])][number % 3]
    start = np.array([-60.0, 0.0, 0.0])
    feed = float(rng.choice([600.0, 1500.0, 3000.0]))
    rows = [Row(start + 40 * UP, UP, "rapid", None), Row(start, UP, "cut", feed)]
    rows += [Row(p, a, "cut", feed) for p, a in axis_corner(np.zeros(3), angle, steps, radius, direction, leave)]
    if number % 3 == 1:  # after a move along the axis, another one perpendicular to it
        rows.append(Row(rows[-1].place + np.array([30.0, 0.0, 0.0]), end, "cut", feed))
    return [*rows, Row(rows[-1].place + 40 * end, end, "rapid", None)]


def run_corner(cell: str, number: int, folder: Path, *overrides: str, posts: tuple[str, ...] = POSTS) -> int:
    file = write_job(folder / "corner.csv", corner_job(number), np.array([0.0, 0.0, 30.0]), UP)
    request = OptimizeRequest(
        cell=ROOT / "cells" / cell, toolpath=file, out=folder / "out", posts=posts, overrides=overrides
    )
    return run_optimize(request).exit_code


@pytest.mark.slow
@pytest.mark.parametrize("number", [10, 14])
def test_cut_may_rotate_the_tool_axis_on_the_spot(number: int, tmp_path: Path) -> None:
    assert run_corner("kr500_milling", number, tmp_path) == 0


@pytest.mark.slow
@pytest.mark.parametrize("number", [6, 15])
def test_points_of_a_rotation_on_the_spot_are_found_between_samples(number: int, tmp_path: Path) -> None:
    assert run_corner("cutting_cobot", number, tmp_path, "collision=false", posts=("ros", "csv")) == 0


@pytest.mark.proof
@pytest.mark.parametrize("cell", ["kr500_milling", "cutting_cobot", "irb6700_drilling"])
def test_corners_of_the_tool_axis_are_verified_in_every_post(cell: str, tmp_path: Path) -> None:
    codes = {}
    # each angle, radius and kind of departure from the corner
    each = [(7 * n + 3) % 25 for n in range(25 if NIGHTLY else 12)]
    for number in each if cell == "kr500_milling" else range(0, 25, 3):
        folder = tmp_path / str(number)
        folder.mkdir()
        codes[number] = run_corner(cell, number, folder)
    wrong = {n: code for n, code in codes.items() if code not in (0, 3)}
    assert wrong == {}
    assert sum(code == 0 for code in codes.values()) >= 0.8 * len(codes)  # a few exceed the joint limits of an arm
