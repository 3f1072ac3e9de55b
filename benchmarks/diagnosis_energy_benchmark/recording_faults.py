"""What is wrong with the record, not with the robot: the clerk's mistakes, one a case, with what may be said of it.

The right answer names the fault or says that something unexplained comes back; a mechanical effect named is wrong,
and what is refused with a message is well treated too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import dual_quaternions as dq
import numpy as np
from dual_quaternions import Array
from effect_strength import Named
from recording_tables import Table

INCH, KGF, LBF = 25.4, 9.80665, 4.4482216
Accepted = list[Named]


@dataclass(frozen=True)
class Fault:
    """``spoil`` changes a table in place and returns every name that is true of it."""

    name: str
    spoil: Callable[[Table, np.random.Generator], Accepted]


def _rows(table: Table, last_session: bool) -> Array:
    s = table.columns["session"]
    return s == s.max() if last_session else np.ones(len(s), dtype=bool)


def _scaled(prefix: str, divisor: float, session: bool) -> Callable[[Table, np.random.Generator], Accepted]:
    """A group of columns in another unit than its header says."""

    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        rows, group = _rows(table, session), _group(table, prefix)
        for name in group:
            table.columns[name] = np.where(rows, np.round(table.columns[name] / divisor, 6), table.columns[name])
        return [("units", f"column:{group[0]}"), ("columns", f"column:{group[0]}"), *_all_sensor(prefix)]

    return spoil


def _all_sensor(prefix: str) -> Accepted:
    """A gain is true of forces in a wrong unit, too."""
    return [("force_sensor_gain", "sensor:force")] if prefix == "f" else []


def _group(table: Table, prefix: str) -> list[str]:
    ends = {"d": "_mm", "f": "_N", "m": "_Nm", "r": "_mrad", "q": "_deg", "": "_mm"}
    letters = "123456" if prefix == "q" else "xyz"
    return [n for n in (f"{prefix}{a}{ends[prefix]}" for a in letters) if n in table.columns]


def _swapped(prefix: str, first: int, second: int, session: bool) -> Callable[[Table, np.random.Generator], Accepted]:
    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        rows, group = _rows(table, session), _group(table, prefix)
        a, b = table.columns[group[first]].copy(), table.columns[group[second]].copy()
        table.columns[group[first]] = np.where(rows, b, a)
        table.columns[group[second]] = np.where(rows, a, b)
        return _columns(group) + _frame(prefix)

    return spoil


def _frame(prefix: str) -> Accepted:
    if prefix in ("d", "r", ""):
        return [("displacement_frame", "sensor:displacement")]
    return [("force_sensor_frame", "sensor:force"), ("load_geometry", "sensor:force")] if prefix in "fm" else []


def _columns(group: list[str]) -> Accepted:
    """Any column of the group, or the group by its first."""
    return [(e, f"column:{g}") for g in group for e in ("columns", "units")]


def _flipped(prefix: str, index: int, session: bool) -> Callable[[Table, np.random.Generator], Accepted]:
    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        rows, group = _rows(table, session), _group(table, prefix)
        table.columns[group[index]] = np.where(rows, -table.columns[group[index]], table.columns[group[index]])
        return _columns(group) + (_frame(prefix) if prefix != "q" else [])

    return spoil


def _slipped(prefix: str, by: int, session: bool) -> Callable[[Table, np.random.Generator], Accepted]:
    """Readings stand ``by`` rows too low."""

    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        rows, group = np.flatnonzero(_rows(table, session)), _group(table, prefix)
        for name in group:
            old = table.columns[name].copy()
            old[rows] = np.roll(old[rows], by)
            table.columns[name] = old
        return [*_columns(group), *_columns(_group(table, "f")), ("time_skew", "sensor:displacement")]

    return spoil


def _turned(prefix: str, degrees: float) -> Callable[[Table, np.random.Generator], Accepted]:
    """The tracker was set up anew for the last session, and nobody entered it."""

    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        axis = rng.normal(size=3)
        R = dq.matrix(dq.turned(np.radians(degrees) * axis / np.linalg.norm(axis)))
        shift = rng.normal(0, 3.0, 3) if prefix == "" else np.zeros(3)
        rows, group = _rows(table, True), _group(table, prefix)
        if not group:
            raise ValueError(f"no columns {prefix!r} to turn")
        values = np.stack([table.columns[n] for n in group], axis=1)
        moved = np.where(rows[:, None], values @ R.T + shift, values)
        for k, n in enumerate(group):
            table.columns[n] = np.round(moved[:, k], 5)
        return [*_columns(group), *_frame(prefix), ("geometry", "base")]

    return spoil


def _label(share: float, session: bool) -> Callable[[Table, np.random.Generator], Accepted]:
    """One of the weights is not what is stamped on it: the loads of one size are wrong by ``share``."""

    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        group = _group(table, "f")
        size = np.linalg.norm(np.stack([table.columns[n] for n in group]), axis=0)
        wrong = (np.abs(size / size.max() - 0.75) < 0.06) & _rows(table, session)
        for n in group + _group(table, "m"):
            table.columns[n] = np.where(wrong, np.round(table.columns[n] * (1 + share), 4), table.columns[n])
        return [*_columns(group), ("force_sensor_gain", "sensor:force"), ("load_geometry", "sensor:force")]

    return spoil


def _pasted(table: Table, rng: np.random.Generator) -> Accepted:
    """The displacements of one visit were pasted over those of another pose."""
    pose, session = table.columns["pose"], table.columns["session"]
    a, b = rng.choice(np.unique(pose), 2, replace=False)
    source, goal = np.flatnonzero((pose == a) & (session == 1)), np.flatnonzero((pose == b) & (session == 1))
    n = min(len(source), len(goal))
    group = _group(table, "d") + _group(table, "r") or _group(table, "")
    for name in group:
        table.columns[name] = table.columns[name].copy()
        table.columns[name][goal[:n]] = table.columns[name][source[:n]]
    return [*_columns(group), ("outliers", "rows:" + ",".join(str(r + 1) for r in goal[:n]))]


def _decimals(table: Table, rng: np.random.Generator) -> Accepted:
    """A decimal point slipped in some rows."""
    group = _group(table, "d") or _group(table, "")
    size = np.abs(table.columns[group[0]])
    rows = rng.choice(np.flatnonzero(size > np.median(size)), 6, replace=False)
    table.columns[group[0]] = table.columns[group[0]].copy()
    table.columns[group[0]][rows] *= 10.0
    where = "rows:" + ",".join(str(r + 1) for r in sorted(rows))
    return [("outliers", where), *_columns(group)]


def _other_axes(table: Table, rng: np.random.Generator) -> Accepted:
    """Says tool axes where base axes are meant."""
    for key in ("displacement_frame", "wrench_frame"):
        table.about[key] = "tool" if table.about[key] == "base" else "base"
    return [*_frame("d"), *_frame("f"), *_columns(_group(table, "d")), *_columns(_group(table, "f"))]


LOAD_FAULTS = [
    Fault("inch", _scaled("d", INCH, False)),
    Fault("inch_one_session", _scaled("d", INCH, True)),
    Fault("kgf", _scaled("f", KGF, False)),
    Fault("kgf_one_session", _scaled("f", KGF, True)),
    Fault("lbf", _scaled("f", LBF, False)),
    Fault("kN_one_session", _scaled("f", 1000.0, True)),
    Fault("micrometres", _scaled("d", 1e-3, False)),
    Fault("swapped_xy", _swapped("d", 0, 1, False)),
    Fault("swapped_yz_one_session", _swapped("d", 1, 2, True)),
    Fault("swapped_force_xz", _swapped("f", 0, 2, False)),
    Fault("swapped_joints_5_6", _swapped("q", 4, 5, False)),
    Fault("sign_dz_one_session", _flipped("d", 2, True)),
    Fault("sign_fx", _flipped("f", 0, False)),
    Fault("sign_q5", _flipped("q", 4, False)),
    Fault("sign_q2", _flipped("q", 1, False)),
    Fault("rows_one_late", _slipped("d", 1, False)),
    Fault("rows_one_late_one_session", _slipped("d", 1, True)),
    Fault("tracker_reseated", _turned("d", 12.0)),
    Fault("weight_label", _label(0.12, False)),
    Fault("weight_label_one_session", _label(-0.2, True)),
    Fault("pasted_visit", _pasted),
    Fault("decimal_point", _decimals),
    Fault("other_axes", _other_axes),
]
POSE_FAULTS = [
    Fault("pose_inch", _scaled("", INCH, False)),
    Fault("pose_inch_one_session", _scaled("", INCH, True)),
    Fault("pose_swapped_yz", _swapped("", 1, 2, False)),
    Fault("pose_sign_q4", _flipped("q", 3, False)),
    Fault("pose_sign_y_one_session", _flipped("", 1, True)),
    Fault("pose_rows_one_late", _slipped("", 1, True)),
    Fault("pose_tracker_reseated", _turned("", 0.05)),
    Fault("pose_pasted_visit", _pasted),
    Fault("pose_swapped_joints_4_6", _swapped("q", 3, 5, False)),
]


def _misplaced(table: Table, rng: np.random.Generator) -> Accepted:
    """One nest was measured from another edge of the plate."""
    places = table.about["targets_mm"]
    k = int(rng.choice(list(places)))
    way = rng.normal(size=3)
    places[k] = np.round(np.array(places[k]) + rng.uniform(8, 40) * way / np.linalg.norm(way), 2).tolist()
    return [("columns", "column:target")]


def _other_nest(table: Table, rng: np.random.Generator) -> Accepted:
    """Two nests change their names."""
    places = table.about["targets_mm"]
    a, b = (int(k) for k in rng.choice(list(places), 2, replace=False))
    places[a], places[b] = places[b], places[a]
    return [("columns", "column:target")]


NEST_FAULTS = [Fault("nest_misplaced", _misplaced), Fault("nests_exchanged", _other_nest)]


def _torques(number: int, change: str) -> Callable[[Table, np.random.Generator], Accepted]:
    """A torque channel of joint ``number`` with another sign, unit or owner."""

    def spoil(table: Table, rng: np.random.Generator) -> Accepted:
        own, other = f"tau{number}_Nm", f"tau{number % 6 + 1}_Nm"
        a, b = table.columns[own], table.columns[other]
        if change == "sign":
            table.columns[own] = -a
        elif change == "motor":  # torque at the motor's shaft, not at the joint
            table.columns[own] = np.round(a / 187.0, 5)
        else:
            table.columns[own], table.columns[other] = b, a
        group = [f"tau{j}_Nm" for j in range(1, 7)]
        return _columns(group)

    return spoil


def _late(table: Table, rng: np.random.Generator) -> Accepted:
    """All torques stand three rows too low."""
    for j in range(1, 7):
        table.columns[f"tau{j}_Nm"] = np.roll(table.columns[f"tau{j}_Nm"], 3)
    return [("time_skew", "sensor:tau"), *_columns([f"tau{j}_Nm" for j in range(1, 7)])]


def _radians(table: Table, rng: np.random.Generator) -> Accepted:
    """Velocities in rad/s under a header of degrees."""
    for j in range(1, 7):
        table.columns[f"qd{j}_deg_s"] = np.round(np.radians(table.columns[f"qd{j}_deg_s"]), 7)
    return _columns([f"qd{j}_deg_s" for j in range(1, 7)])


MOTION_FAULTS = [
    Fault("tau_sign_2", _torques(2, "sign")),
    Fault("tau_motor_side_3", _torques(3, "motor")),
    Fault("tau_swapped_2_3", _torques(2, "swapped")),
    Fault("tau_rows_late", _late),
    Fault("qd_radians", _radians),
    Fault("motion_sign_q4", _flipped("q", 3, False)),
]
