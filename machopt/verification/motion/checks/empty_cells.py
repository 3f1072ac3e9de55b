"""Cells of points.csv that must be empty: those of values that need another value which is empty.

A stability limit needs a judgement of stability (``unknown`` counts: modes of tool and spindle limit the depth where
those of the arm are unknown), and a judgement needs a depth of cut.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Bools
from machopt.verification.check_results import VerificationCheck, build_count_check
from machopt.verification.tables.exported_tables import ExportedPoints

ERRORS = (("along", "mm"), ("across", "mm"), ("normal", "mm"), ("axis", "deg"))
INTERVALS = tuple(
    (f"error_{name}_lo_{unit}", f"error_{name}_hi_{unit}", f"error_{name}_{unit}") for name, unit in ERRORS
)
OWNERS = {  # column: the column whose value it belongs to
    **{end: nominal for low, high, nominal in INTERVALS for end in (low, high)},
    **dict.fromkeys(("tolerance_mm", "p_in", "p_in_deflection_only", "cause", "feed_max_mm_min"), "outcome"),
    "a_lim_mm": "chatter",
    "chatter": "ap_mm",
    **dict.fromkeys(("branch", "k_axial_N_mm", "clearance_mm", "limit_margin_deg", "singularity"), "gamma_deg"),
    **dict.fromkeys(("k_normal_N_mm", "k_jiao_x_N_mm", "k_axial_std_N_mm", "deflection_mm"), "k_axial_N_mm"),
    "deflection_std_mm": "deflection_mm",
    "nearest_pair": "clearance_mm",
}


def check_empty_cells(points: ExportedPoints) -> VerificationCheck:
    """Return the check that no cell is filled whose owner is empty, and that each error has its interval.

    Args:
        points: Rows of points.csv.
    """
    wrong = []
    for name, owner in OWNERS.items():
        filled = _find_filled(points, name)
        if filled is None:
            continue
        has_owner = _find_filled(points, owner)
        has_owner = np.zeros(len(filled), bool) if has_owner is None else has_owner
        wrong += [f"point {p}: {name} without {owner}" for p in points.point[filled & ~has_owner].tolist()]
    for low, high, nominal in INTERVALS:
        if low in points.numbers and high in points.numbers and nominal in points.numbers:
            lower, upper = points.numbers[low], points.numbers[high]
            stated = np.isfinite(points.numbers[nominal])
            bad = stated & ~(lower <= upper)
            wrong += [f"point {p}: {low} and {high} are no interval" for p in points.point[bad].tolist()]
    return build_count_check("points.csv empty cells", wrong, "cells")


def _find_filled(points: ExportedPoints, name: str) -> Bools | None:
    """Return (N,) whether a column has a value; None where the table has no such column."""
    if name in points.words:
        return np.array([bool(word) for word in points.words[name]], bool)
    return np.isfinite(points.numbers[name]) if name in points.numbers else None
