"""Contact columns of points.csv: ae_mm, ap_mm, phi_in_deg and phi_out_deg, from process.yaml or from engagement.csv."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.process import CutSide
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.process.contact_load import find_slice_shapes
from machopt.verification.motion.process.point_loads import RecomputedLoads
from machopt.verification.motion.process.stability import find_given_arc
from machopt.verification.tables.exported_tables import ExportedPoints

CONTACT_COLUMNS, CONTACT_LIMIT = ("ae_mm", "ap_mm", "phi_in_deg", "phi_out_deg"), 2e-3  # printed decimals
SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


def check_contact_columns(
    cell: Cell, toolpath: Toolpath, points: ExportedPoints, loads: RecomputedLoads
) -> list[VerificationCheck]:
    """Return the checks of the columns; none where the cell has no cutter.

    Args:
        cell: The cell with the tool and the process.
        toolpath: The toolpath, with the arcs of engagement.csv.
        points: Rows of points.csv, one a toolpath point.
        loads: The recomputed loads.
    """
    if cell.tool.cutter is None:
        return []
    wanted = np.full((len(CONTACT_COLUMNS), len(toolpath)), np.nan)
    _add_given_contacts(wanted, cell, toolpath, loads)
    _add_stock_contacts(wanted, cell, toolpath)
    limit = np.full(len(toolpath), CONTACT_LIMIT)
    return [compare_column(points, name, wanted[n], limit) for n, name in enumerate(CONTACT_COLUMNS)]


def _add_given_contacts(wanted: Array, cell: Cell, toolpath: Toolpath, loads: RecomputedLoads) -> None:
    """Write the columns of milled points whose depths process.yaml states."""
    process, cutter = cell.process, cell.tool.cutter
    assert process is not None
    assert cutter is not None
    for k, one in enumerate(process.operations):
        if one.kind != "milling" or one.takes_stock:
            continue
        assert one.ap is not None
        ae = cutter.diameter if one.ae is None else one.ae
        mine = (toolpath.move == MoveKind.CUT) & (loads.operation == k)
        for code, side in SIDES.items():
            _, start, end = find_given_arc(cell, side, ae)
            values = [1e3 * ae, 1e3 * one.ap, np.degrees(start), np.degrees(end)]
            wanted[:, mine & (loads.side == code)] = np.array(values)[:, None]


def _add_stock_contacts(wanted: Array, cell: Cell, toolpath: Toolpath) -> None:
    """Write the columns of points whose contact engagement.csv states."""
    arcs, cutter = toolpath.engagement, cell.tool.cutter
    assert cutter is not None
    if arcs is None:
        return
    radius = find_slice_shapes(cutter, arcs)[0]
    for p in np.unique(arcs.point).tolist():
        mine = slice(*np.searchsorted(arcs.point, (p, p + 1)))
        start, end = arcs.start[mine], arcs.end[mine]
        left, right = np.max(radius[mine] * np.cos(start)), np.min(radius[mine] * np.cos(end))
        height = np.max(arcs.high[mine]) - np.min(arcs.low[mine])
        wanted[:, p] = 1e3 * (left - right), 1e3 * height, np.degrees(start.min()), np.degrees(end.max())


def compare_column(points: ExportedPoints, name: str, wanted: Array, limit: Array) -> VerificationCheck:
    """Return the check of a column of numbers; a field is empty where nothing follows, and nowhere else.

    Args:
        points: Rows of points.csv, one a toolpath point.
        name: Name of the column.
        wanted: (N,) recomputed values, NaN where nothing follows.
        limit: (N,) greatest allowed differences, in the unit of the column.
    """
    stated = points.numbers.get(name)
    if stated is None:
        return build_count_check(f"points.csv {name}", ["the column is missing"], "columns")
    both = np.isfinite(stated) & np.isfinite(wanted)
    one = np.isfinite(stated) != np.isfinite(wanted)
    off = np.where(both, np.abs(stated - wanted) / limit, np.where(one, np.inf, 0.0))

    def describe(n: int) -> str:
        follows = f"{wanted[n]:.6g} follows" if np.isfinite(wanted[n]) else "none follows"
        return f"point {points.point[n]}: {f'{stated[n]:.6g}' if np.isfinite(stated[n]) else 'none'}, {follows}"

    return build_worst_value_check(f"points.csv {name}", "of its limit", off, 1.0, describe)
