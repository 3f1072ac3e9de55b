"""Faults of the record: what a person or a program does to a table after the measurement.

Each fault changes the columns of a table in place and returns the names that describe it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Table = dict[str, np.ndarray]
Names = tuple[tuple[str, str], ...]
MOVED, FORCE, PLACE = ("dx_mm", "dy_mm", "dz_mm"), ("fx_N", "fy_N", "fz_N"), ("x_mm", "y_mm", "z_mm")


def _list_names(effects: tuple[str, ...], columns: tuple[str, ...]) -> Names:
    return tuple((e, f"column:{c}") for e in effects for c in columns)


def _find_session(table: Table) -> np.ndarray:
    return table["session"] == table["session"].max()


def scale_columns(
    columns: tuple[str, ...], factor: float, session: bool
) -> Callable[[Table, np.random.Generator], Names]:
    """Return a fault: another unit in some columns, in all rows or in the last session."""

    def apply(table: Table, rng: np.random.Generator) -> Names:
        rows = _find_session(table) if session else np.ones(len(table["session"]), bool)
        for c in columns:
            table[c][rows] *= factor
        group = next((g for g in (MOVED, FORCE, PLACE) if columns[0] in g), columns)  # named by its first column
        return _list_names(("units", "columns"), group)

    return apply


def swap_columns(a: str, b: str, session: bool) -> Callable[[Table, np.random.Generator], Names]:
    """Return a fault: two columns exchanged."""

    def apply(table: Table, rng: np.random.Generator) -> Names:
        rows = _find_session(table) if session else np.ones(len(table["session"]), bool)
        table[a][rows], table[b][rows] = table[b][rows].copy(), table[a][rows].copy()
        group = next((g for g in (MOVED, FORCE, PLACE) if a in g), (a, b))
        return _list_names(("columns",), tuple(dict.fromkeys((*group, a, b))))

    return apply


def copy_rows(table: Table, rng: np.random.Generator) -> Names:
    """Copy a block of readings over the next one: labels stay, readings repeat. No name is asked for."""
    count = len(table["session"])
    for start in rng.choice(count // 24 - 2, 3, replace=False) * 24:
        for c in (*MOVED, *PLACE):
            if c in table:
                table[c][start + 12 : start + 24] = table[c][start : start + 12]
    return (*_list_names(("columns",), (*MOVED, *PLACE)), ("outliers", "rows:*"))


def spoil_rows(table: Table, rng: np.random.Generator) -> Names:
    """Make 4 % of the readings gross outliers."""
    columns = [c for c in (*MOVED, *PLACE) if c in table]
    count = len(table["session"])
    rows = rng.choice(count, max(count // 25, 3), replace=False)
    for c in columns:
        table[c][rows] += rng.normal(0.0, 2.0, len(rows))
    return (("outliers", "rows:*"),)


def shift_rows(table: Table, rng: np.random.Generator) -> Names:
    """Shift the readings of the last session by one row against its labels."""
    rows = np.flatnonzero(_find_session(table))
    columns = [c for c in (*MOVED, *PLACE) if c in table]
    for c in columns:
        table[c][rows] = np.roll(table[c][rows], 1)
    return (*_list_names(("columns",), tuple(columns)), *_list_names(("columns",), (*FORCE, "q1_deg")))


def reseat_target(table: Table, rng: np.random.Generator) -> Names:
    """Move one reflector (the instrument where there is only one) in the last session by 0.8 mm in its own frame."""
    rows = _find_session(table)
    rows &= table["target"] == table["target"].max()
    shift = rng.normal(size=3)
    shift *= 0.8 / np.linalg.norm(shift)
    for axis, c in enumerate(PLACE):
        table[c][rows] += table["_flange"][rows, axis] @ shift
    return _list_names(("columns",), ("target", *PLACE))


LOAD_FAULTS: dict[str, Callable[[Table, np.random.Generator], Names]] = {
    "force_kgf": scale_columns(FORCE, 1 / 9.80665, False),
    "moved_inch_session": scale_columns(MOVED, 1 / 25.4, True),
    "swapped_dx_dy": swap_columns("dx_mm", "dy_mm", False),
    "sign_dz_session": scale_columns(("dz_mm",), -1.0, True),
    "copied_rows": copy_rows,
    "outliers": spoil_rows,
    "shifted_rows": shift_rows,
    "sign_fx": scale_columns(("fx_N",), -1.0, False),
}
POSE_FAULTS: dict[str, Callable[[Table, np.random.Generator], Names]] = {
    "metres": scale_columns(PLACE, 1e-3, False),
    "sign_q4": scale_columns(("q4_deg",), -1.0, False),
    "swapped_x_y_session": swap_columns("x_mm", "y_mm", True),
    "outliers": spoil_rows,
    "reseated_target": reseat_target,
    "swapped_q5_q6": swap_columns("q5_deg", "q6_deg", False),
    "radians_q1": scale_columns(("q1_deg",), np.pi / 180, False),
}
