"""The record before the robot: units, frames, signs, rows that cannot be, too little data.

A broken record explains more published mismatches than exotic physics does. An *error* is refused (unless the user
accepts it by its code), because its result would be wrong by a factor or by nature; a *warning* stands beside the
result.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.errors import InputError
from machopt.identify.experiment import Experiment
from machopt.identify.rivals import Reading, readings
from machopt.identify.robust import start
from machopt.model.robot import Robot

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
GENERIC_STIFFNESS, GENERIC_REACH = 1e6, 2.5  # N·m/rad of a joint of an arm that reaches so far (m); grows with reach³
MOST_GENERIC = 60.0  # ratio to the generic arm beyond which units are wrong, where the cell has no stiffness
MOST_GENERIC_TOO = 15.0  # the same where the cell's stiffness is off by more than a hundred, too
MOST_NOMINAL, DOUBTFUL_NOMINAL = 100.0, 8.0  # ratio to the cell's stiffness: wrong units, and worth a warning
BETTER, MUCH_BETTER = 0.6, 0.35  # unexplained share of a rival reading per that of the stated one
WINS = 0.8  # share of poses in which a rival must be better
A_LITTLE_BETTER, WINS_EVERYWHERE, MANY_POSES = 0.8, 0.95, 8  # enough for a warning, too: less better, but everywhere
EXPLAINS = 0.9  # unexplained share beyond which a record says nothing about units
MOST_MOVED = 0.02  # of the reach; no arm gives way that far
LEAST_MOMENT = 1.0  # N·m
SCREW = 0.2  # |f·m| / (|f| |m|) that no force through a point makes; rounding and noise make less
COARSE_STEP = 5e-6  # m; displacements read to a finer step do not repeat by chance in all their axes
READ_AS = {"rad": 1e-3, "degrees": float(np.degrees(1e-3)), "µrad": 1e3}  # number read per number meant, for mrad
SHOWN = 6


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a record."""

    code: str
    severity: Literal["error", "warning"]
    message: str  # what, and what would work
    rows: tuple[int, ...] = ()  # 0-based readings it concerns; empty: all


def check_experiment(
    experiment: Experiment, robot: Robot, T_flange_tcp: Array, prior: Array | None = None, unknowns: int = 6
) -> list[Finding]:
    """Look for what would spoil an identification.

    Args:
        experiment: as the recording states it.
        robot, T_flange_tcp: for reach and flange.
        prior: (6,) N·m/rad, the cell's stiffness; None where it has none.
        unknowns: coefficients to be fitted.

    Returns:
        errors first.

    Raises:
        InputError: no load or no displacement at all.
    """
    e = experiment
    for values, what in ((e.wrench, "load"), (e.measured, "displacement")):
        if not values.any():
            raise InputError(f"every {what} is zero; there is nothing to identify from", file=e.source)
    reach = _reach(robot, T_flange_tcp)
    flange = robot.fk(e.state.q)
    ways = readings(e, flange)
    found = _other_reading(ways)
    if not any(f.severity == "error" for f in found):  # in a wrong frame, sizes mean nothing
        found += _units(e, ways[0], reach, prior)
    found += [*_lever(e, reach), *_too_little(e, unknowns), *_screws(e), *_repeated(e), *_far(e, reach), *_unloaded(e)]
    return sorted(found, key=lambda f: f.severity != "error")


def refuse(experiment: Experiment, findings: Sequence[Finding], accept: Collection[str] = ()) -> list[str]:
    """Raise on errors that are not accepted; the rest as sentences.

    Args:
        accept: codes of errors to be taken as warnings.

    Raises:
        InputError: names every error.
    """
    errors = [f for f in findings if f.severity == "error" and f.code not in accept]
    if errors:
        text = "; ".join(f"{f.message} [{f.code}]" for f in errors)
        raise InputError(f"{text}. If the record is right as it is, accept {errors[0].code}", file=experiment.source)
    return [f.message for f in findings]


def _other_reading(ways: list[Reading]) -> list[Finding]:
    """A frame, sign or reference point that explains the record clearly better than the stated one."""
    stated, rivals = ways[0], ways[1:]
    best = min(rivals, key=lambda r: r.unexplained)
    ratio = best.unexplained / max(stated.unexplained, 1e-300)
    wins = float(np.mean(best.by_pose < stated.by_pose))
    everywhere = ratio <= A_LITTLE_BETTER and wins >= WINS_EVERYWHERE and len(best.by_pose) >= MANY_POSES
    if not everywhere and (ratio > BETTER or wins < WINS):
        return []
    share = (
        f"{100 * (1 - best.unexplained):.0f} % of the displacement is explained then, {_explained(stated)} as stated"
    )
    sure = ratio <= MUCH_BETTER and stated.unexplained > MUCH_BETTER
    return [Finding(best.name, "error" if sure else "warning", f"{best.message} ({share})")]


def _explained(way: Reading) -> str:
    return f"{100 * max(1 - way.unexplained, 0.0):.0f} %"


def _units(e: Experiment, stated: Reading, reach: float, prior: Array | None) -> list[Finding]:
    """Displacement per load against the cell's stiffness and against robots of this size."""
    generic = np.full(6, GENERIC_STIFFNESS * (reach / GENERIC_REACH) ** 3)
    A = e.response()[..., :6]
    parts = {"displacement": _ratio(e, A, generic, slice(0, 3))}
    if e.dimensions == 6:
        parts["rotation"] = _ratio(e, A, generic, slice(3, 6))
    nominal = _ratio(e, A, prior, slice(0, 3)) if prior is not None else np.nan
    if stated.unexplained > EXPLAINS or not parts["displacement"] > 0:
        return []
    out = []
    s = parts["displacement"]
    if prior is None:
        wrong = not 1 / MOST_GENERIC < s < MOST_GENERIC
    else:
        wrong = not 1 / MOST_NOMINAL < nominal < MOST_NOMINAL and not 1 / MOST_GENERIC_TOO < s < MOST_GENERIC_TOO
    if wrong:
        against = f"{_times(nominal)} the cell's" if prior is not None else f"{_times(s)} that of robots of this reach"
        out.append(Finding("units", "error", f"displacement per load is {against}: {_culprit(e, s)}"))
    elif prior is not None and not 1 / DOUBTFUL_NOMINAL < nominal < DOUBTFUL_NOMINAL:
        out.append(Finding(
            "far_from_nominal", "warning",
            f"displacement per load is {_times(nominal)} what the cell's stiffness gives; check the units of load "
            "(kg or N) and displacement, or the cell's stiffness",
        ))  # fmt: skip
    turned = parts.get("rotation", np.nan)
    if turned > 0 and not 1 / DOUBTFUL_NOMINAL < turned / s < DOUBTFUL_NOMINAL and not wrong:
        guess = min(READ_AS, key=lambda unit: abs(np.log(turned / s / READ_AS[unit])))
        out.append(Finding(
            "rotation_units", "error",
            f"rotations are {_times(turned / s)} what the translations of the same readings imply: columns rx_mrad … "
            f"seem to hold {guess}; mrad would work",
        ))  # fmt: skip
    return out


def _ratio(e: Experiment, A: Array, stiffness: Array, rows: slice) -> float:
    """Measured displacement per displacement that a stiffness predicts, robustly."""
    predicted = A[:, rows] @ (1.0 / stiffness)
    load = np.linalg.norm(e.wrench[:, :3], axis=1) + np.linalg.norm(e.wrench[:, 3:], axis=1)
    if not predicted.any() or not e.measured[:, rows].any():
        return float("nan")
    return float(start(predicted[:, :, None], e.measured[:, rows], load)[0])


def _culprit(e: Experiment, ratio: float) -> str:
    """Which column seems to be in another unit."""
    force = float(np.median(np.linalg.norm(e.wrench[:, :3], axis=1)))
    moved = float(np.median(np.linalg.norm(e.measured[:, :3], axis=1)))
    if ratio < 1:
        return (
            f"with a median displacement of {1e3 * moved:.2g} mm under {force:.3g} N the columns dx_mm … seem to hold "
            "metres; millimetres would work"
        )
    if force < 10.0:  # N; nothing bends visibly under less
        return f"with a median force of {force:.2g} N the columns fx_N … seem to hold kilonewtons; newtons would work"
    return (
        f"with a median displacement of {1e3 * moved:.3g} mm under {force:.3g} N the columns dx_mm … seem to hold "
        "micrometres (or fx_N … a thousandth of newtons); millimetres would work"
    )


def _lever(e: Experiment, reach: float) -> list[Finding]:
    """Moments far beyond what the forces can make on an arm of this size."""
    force, moment = np.linalg.norm(e.wrench[:, :3], axis=1), np.linalg.norm(e.wrench[:, 3:], axis=1)
    both = (force > 0) & (moment > LEAST_MOMENT)
    if not both.any():
        return []
    lever: Array = np.where(both, moment / np.where(both, force, 1.0), 0.0)
    if np.median(lever[both]) > 10.0 * reach:
        return [Finding(
            "moment_units", "error",
            f"moments are {np.median(lever[both]):.3g} m times the forces, the arm reaches {reach:.2g} m: columns "
            "mx_Nm … seem to hold N·mm; N·m would work",
        )]  # fmt: skip
    rows = np.flatnonzero(lever > max(3.0 * reach, 20.0 * float(np.median(lever[both]))))
    if not len(rows):
        return []
    return [Finding(
        "lever_arm", "warning",
        f"{_rows(e, rows)}: the moment is more than {lever[rows].min():.2g} m times the force, beyond the arm's reach "
        f"of {reach:.2g} m; check the moments there", tuple(rows.tolist()),
    )]  # fmt: skip


def _screws(e: Experiment) -> list[Finding]:
    """Moments along the force where all other readings are forces through a point (f · m = 0)."""
    force, moment = e.wrench[:, :3], e.wrench[:, 3:]
    size = np.linalg.norm(force, axis=1) * np.linalg.norm(moment, axis=1)
    there = (np.linalg.norm(moment, axis=1) > LEAST_MOMENT) & (size > 0)
    if there.sum() < 10:
        return []
    share = np.where(there, np.abs(np.einsum("nc,nc->n", force, moment)) / np.where(there, size, 1.0), 0.0)
    if np.quantile(share[there], 0.9) > SCREW / 10:
        return []  # couples were applied, or the noise hides it
    rows = np.flatnonzero(share > SCREW)
    if not len(rows):
        return []
    return [Finding(
        "moment_along_force", "warning",
        f"{_rows(e, rows)}: the moment has a part along the force, which no single force makes, unlike in all other "
        "readings; check sign and axes of the moments there", tuple(rows.tolist()),
    )]  # fmt: skip


def _repeated(e: Experiment) -> list[Finding]:
    """Readings that are copies of others."""
    steps = e.measured[:, :3] / COARSE_STEP
    fine = bool(np.abs(steps - np.round(steps)).max() > 0.02)
    keys = [e.wrench, e.measured] if fine else [
        e.wrench, e.measured, e.state.q, np.stack([e.pose, e.cycle, e.session], axis=1),
    ]  # fmt: skip
    table = np.concatenate([np.asarray(k, float) for k in keys], axis=1)
    moved = e.measured.any(axis=1)
    _, first, back = np.unique(table, axis=0, return_index=True, return_inverse=True)
    rows = np.flatnonzero((first[back.reshape(-1)] != np.arange(len(e))) & moved)
    if not len(rows):
        return []
    original = e.place(int(first[back.reshape(-1)[rows[0]]]))
    return [Finding(
        "repeated_rows", "warning",
        f"{_rows(e, rows)}: the same loads and displacements to the last digit as before ({original} at first); copies "
        "make the result look surer than it is, remove them", tuple(rows.tolist()),
    )]  # fmt: skip


def _far(e: Experiment, reach: float) -> list[Finding]:
    rows = np.flatnonzero(np.linalg.norm(e.measured[:, :3], axis=1) > MOST_MOVED * reach)
    if not len(rows):
        return []
    return [Finding(
        "impossible_displacement", "warning",
        f"{_rows(e, rows)}: displaced by more than {1e3 * MOST_MOVED * reach:.0f} mm, more than an arm of this reach "
        "gives way; check these rows, or the unit of the displacement", tuple(rows.tolist()),
    )]  # fmt: skip


def _unloaded(e: Experiment) -> list[Finding]:
    """Displacement without any load."""
    loaded = e.wrench.any(axis=1)
    if loaded.all():
        return []
    size = np.linalg.norm(e.measured[:, :3], axis=1)
    rows = np.flatnonzero(~loaded & (size > 0.3 * float(np.median(size[loaded]))))
    if not len(rows):
        return []
    return [Finding(
        "moved_without_load", "warning",
        f"{_rows(e, rows)}: displaced although no load is recorded; displacements count from the unloaded state of the "
        "same cycle", tuple(rows.tolist()),
    )]  # fmt: skip


def _too_little(e: Experiment, unknowns: int) -> list[Finding]:
    poses, equations = len(np.unique(e.pose)), e.measured.size
    out = []
    if poses < 4:
        out.append(Finding(
            "few_poses", "warning",
            f"only {poses} pose{'s' if poses > 1 else ''}: joints are told apart by posture, and errors shared by a "
            "pose cannot be seen; ten poses or more would work (machopt plan-poses chooses them)",
        ))  # fmt: skip
    if equations < 3 * unknowns:
        out.append(Finding(
            "few_readings", "warning",
            f"{len(e)} readings of {e.dimensions} coordinates are {equations} equations for {unknowns} unknowns; three "
            "times as many as unknowns, better more, would tell how sure the result is",
        ))  # fmt: skip
    return out


def _reach(robot: Robot, T_flange_tcp: Array) -> float:
    """m, no more than the arm can stretch from its second axis, roughly."""
    points = [*robot.point[1:], robot.T_base_flange_zero[:3, 3]]
    arm = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(points))
    return arm + float(np.linalg.norm(T_flange_tcp[:3, 3]))


def _rows(e: Experiment, rows: Ints) -> str:
    shown = ", ".join(e.place(int(r)) for r in rows[:SHOWN])
    return shown + (f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else "")


def _times(ratio: float) -> str:
    return f"{ratio:.3g} times" if ratio >= 1 else f"1/{1 / ratio:.3g} of"
