"""Cells of points.csv are filled only together with the cell that they depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from machopt.verification.motion.checks.empty_cells import INTERVALS, OWNERS, check_empty_cells
from machopt.verification.tables.csv_columns import TEXT_COLUMNS
from machopt.verification.tables.exported_tables import OPTIONAL_COLUMNS, POINT_COLUMNS, ExportedPoints

FREE = {  # columns that may have values in every row, or that other checks compare cell by cell
    *("outcome", "stiffness_from", "status", "reason", "operation", "move", "point", "gamma_deg", "dwell_s", "f1_Hz"),
    *("x_mm", "y_mm", "z_mm", "i", "j", "k", "feed_mm_min", "feed_advised_mm_min"),
    *("f_travel_N", "f_normal_N", "f_axial_N", *(f"q{n}_deg" for n in range(1, 7))),
    *("ae_mm", "ap_mm", "phi_in_deg", "phi_out_deg", "f_peak_N", "m_axial_Nm"),
    *(nominal for _, _, nominal in INTERVALS),
}


def build_points() -> ExportedPoints:
    """Two points: the first has every value, the second none."""
    names = {*OWNERS, *OWNERS.values()}
    return ExportedPoints(
        point=np.arange(2),
        q=np.zeros((2, 6)),
        external=np.zeros((2, 0)),
        status=("ok", "ok"),
        numbers={name: np.array([1.0, np.nan]) for name in names - TEXT_COLUMNS},
        words=dict.fromkeys(names & TEXT_COLUMNS, ("word", "")),
    )


def test_every_column_has_an_owner_or_is_free() -> None:
    assert {*POINT_COLUMNS, *OPTIONAL_COLUMNS} == {*OWNERS, *FREE}


@pytest.mark.parametrize("name", sorted(OWNERS))
def test_filled_cell_without_its_owner_fails(name: str) -> None:
    points = build_points()
    assert check_empty_cells(points).passed
    if name in TEXT_COLUMNS:
        wrong = replace(points, words={**points.words, name: ("word", "word")})
    else:
        wrong = replace(points, numbers={**points.numbers, name: np.ones(2)})
    found = check_empty_cells(wrong)
    assert not found.passed
    assert f"point 1: {name} without {OWNERS[name]}" in found.where


def test_unknown_stability_needs_no_modes_of_the_arm() -> None:
    points = build_points()
    numbers = {name: column.copy() for name, column in points.numbers.items()}
    # tool and spindle limit the depth, also at an unreached point
    numbers["ap_mm"][1], numbers["a_lim_mm"][1] = 2.0, 1.0
    words = {**points.words, "chatter": ("stable", "spindle")}
    assert np.isnan(numbers.setdefault("f1_Hz", np.full(2, np.nan))).any()
    assert check_empty_cells(replace(points, numbers=numbers, words=words)).passed


@pytest.mark.parametrize("change", [np.nan, 2.0])
def test_error_without_an_interval_fails(change: float) -> None:
    points = build_points()
    low, high, _ = INTERVALS[0]
    wrong = replace(points, numbers={**points.numbers, low: np.array([change, np.nan])})
    found = check_empty_cells(wrong)
    assert not found.passed
    assert f"{low} and {high} are no interval" in found.where
