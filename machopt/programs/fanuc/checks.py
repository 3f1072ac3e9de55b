"""Checks of FANUC programs: CONFIG of positions and CNT of moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.robot_program import LIN, RobotProgram
from machopt.numerics.array_types import Array
from machopt.programs.checking.printed_precision import compute_last_digit
from machopt.programs.checking.program_checks import (
    SLACK,
    ZONE_STEP_RATIO,
    ArmPosture,
    ProgramChecks,
    Words,
    ZoneCase,
    read_whole_number,
)
from machopt.programs.reading.parsed_program import ParsedProgram
from machopt.programs.writing.blend_zones import LEAST
from machopt.programs.writing.feed_model import compute_line_acceleration

PERCENT_TOLERANCE = (
    12.0  # of CNT: joints at a target are the motion's beside it, which moves the acceleration that n follows from
)


def _compare_words(program_words: Words, posture: ArmPosture) -> list[bool]:
    turns = program_words.get("turns")
    if "config" not in program_words or not isinstance(turns, tuple):
        return []
    flip, elbow, front = tuple(str(program_words["config"]).ljust(3)[:3])
    out: list[bool] = []
    if posture.elbow_up is not None and posture.wrist_behind is not None:
        out += [elbow == "DU"[posture.elbow_up], front == "TB"[posture.wrist_behind]]
    nonflip = posture.nonflip_j5
    if nonflip is not None:
        out.append(any((flip == "N") == (b == (nonflip == "negative")) for b in posture.is_negative[4]))
    for turn, k in zip(turns, (0, 3, 5), strict=True):
        out.append(-180.0 - SLACK <= posture.axes_deg[k] - 360.0 * turn <= 180.0 + SLACK)
    return out


def _find_wrong_zones(case: ZoneCase) -> list[tuple[int, str]]:
    parsed, program, law = case.parsed, case.program, case.law
    stated = np.array([read_whole_number(w, "cnt") for w in parsed.configuration], dtype=np.float64)
    feed = np.round(np.nan_to_num(program.feed, nan=1.0), 4)
    rows = np.flatnonzero((law.distance > 0.0) & np.isfinite(law.turn))
    bounds = []
    for a in _compute_acceleration_bounds(parsed, program):
        n = np.zeros(len(stated))
        if a is not None:
            along = 2.0 * np.minimum(a[rows], a[rows + 1]) * law.distance[rows]
            n[rows] = 100.0 * np.minimum(np.sqrt(along) / feed[rows], 1.0)
        n[law.free] = 100.0
        bounds.append(n)
    least, n, most = bounds
    exact = ~np.isfinite(law.turn) | (program.kind != LIN)
    low, high = least - np.maximum(PERCENT_TOLERANCE, 0.35 * least), most + np.maximum(PERCENT_TOLERANCE, 0.35 * most)
    off = np.where(exact, stated > 0.0, (stated < low) | (stated > high))
    near = (
        ~exact & (law.room > 0.0) & (law.distance <= LEAST * ZONE_STEP_RATIO) & (stated <= 100.0)
    )  # on the edge of a stop
    return [
        (int(k), f"CNT{stated[k]:.0f} where CNT{n[k]:.0f} keeps to the tolerance") for k in np.flatnonzero(off & ~near)
    ]


def _compute_acceleration_bounds(parsed: ParsedProgram, program: RobotProgram) -> tuple[Array | None, ...]:
    """(M,) m/s² along each line: the least, the printed and the most that the decimals of printed joints allow."""
    a = compute_line_acceleration(program)
    if a is None or program.axis_acceleration is None:
        return None, None, None
    step = float(np.radians(compute_last_digit(parsed.axes_deg))) if np.isfinite(parsed.axes_deg).any() else 0.0
    way = np.linalg.norm(np.diff(program.T_workpiece_tcp[:, :3, 3], axis=0), axis=1)
    turned = np.abs(np.diff(program.q, axis=0))
    ends = []
    for shift in (step, -step):
        share = np.max(np.maximum(turned + shift, 0.0) / program.axis_acceleration, axis=1)
        ends.append(np.append(np.nan, np.where(share > 0.0, way / np.where(share > 0.0, share, 1.0), np.inf)))
    return ends[0], a, ends[1]


def _copy_printed_columns(words: Sequence[Words]) -> dict[str, Sequence[object]]:
    cnt = [read_whole_number(w, "cnt") for w in words]
    return {"cnt": cnt, "continuous": [n > 0 for n in cnt]}


CHECKS = ProgramChecks(
    compare_words=_compare_words, find_wrong_zones=_find_wrong_zones, copy_printed_columns=_copy_printed_columns
)
