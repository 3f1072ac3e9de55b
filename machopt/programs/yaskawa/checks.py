"""Checks of Yaskawa jobs: RCONF of positions and positioning levels of moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.robot_program import RobotProgram
from machopt.numerics.array_types import Array, Bools
from machopt.programs.checking.program_checks import (
    ZONE_STEP_RATIO,
    ArmPosture,
    ProgramChecks,
    Words,
    ZoneCase,
    read_whole_number,
)
from machopt.programs.writing.blend_zones import HALF, LEAST, SHARP, BlendZones


def _compare_words(program_words: Words, posture: ArmPosture) -> list[bool]:
    bits = program_words.get("rconf")
    if not isinstance(bits, tuple):
        return []
    out = [bool(bits[0]) in posture.is_negative[4]]
    if posture.wrist_behind is not None:
        out += [bool(bits[1]) != posture.elbow_up, bool(bits[2]) == posture.wrist_behind]
    for bit, k in zip(bits[3:], (3, 5, 0), strict=True):
        out.append(bool(bit) in {abs(v[k]) >= 180.0 for v in (posture.low, posture.high, posture.axes_deg)})
    return out


def _is_undecided(program: RobotProgram, law: BlendZones, printed: float) -> Bools:
    """(M,) True where the decimals of the program decide whether its line ends in a stop or may be rounded at will."""
    length = np.linalg.norm(np.diff(program.T_workpiece_tcp[:, :3, 3], axis=0, append=np.full((1, 3), np.nan)), axis=1)
    before = np.append(np.nan, length[:-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        shorter = np.fmin(before, length)
        angle = 2.0 * printed / shorter  # by which the turn between the two lines may be off
        reach = program.blend / np.tan((np.nan_to_num(law.turn) + angle) / 4.0)
        barely = law.free & ~(reach > HALF * (shorter + printed))
        cosine = _compute_turn_cosines(program)
        sharp = np.abs(np.arccos(np.clip(cosine, -1.0, 1.0)) - SHARP) < angle
    return np.asarray(barely | sharp | (np.abs(shorter - LEAST) < printed))


def _compute_turn_cosines(program: RobotProgram) -> Array:
    """(M,) cosine of the turn between the line that ends at each target and the next."""
    way = np.diff(program.T_workpiece_tcp[:, :3, 3], axis=0)
    size = np.linalg.norm(way, axis=1)
    out = np.full(len(program), np.nan)
    out[1:-1] = np.einsum("ij,ij->i", way[:-1], way[1:]) / (size[:-1] * size[1:])
    return out


def _find_wrong_zones(case: ZoneCase) -> list[tuple[int, str]]:
    law, out = case.law, []
    unsure = _is_undecided(case.program, law, case.printed)
    stated = case.controller.position_levels
    for k, words in enumerate(case.parsed.configuration):
        level = read_whole_number(words, "pl")
        if "pl" not in words:
            out.append((k, "no PL: the controller rounds its end as it is set up"))
            continue
        if (level == 0 and not law.free[k]) or unsure[k]:
            continue
        if level and law.rapid is not None and law.rapid[k] > 0.0:
            known = stated is not None and level <= len(stated)
            if not (known and stated[level - 1] <= law.rapid[k] + case.printed):  # type: ignore[index]  # known
                out.append((k, f"PL={level} where the checked corner begins {1e3 * law.rapid[k]:.2f} mm before it"))
            continue
        room, reach = float(law.room[k]), float(law.distance[k])
        if not np.isfinite(law.turn[k]):
            out += [(k, f"PL={level} where the robot has to stop")] if level else []
            continue
        size = room if stated is None or not 0 < level <= len(stated) else min(float(stated[level - 1]), room)
        edge = room <= reach * ZONE_STEP_RATIO  # half the line is about what the tolerance lets it
        if level and size > max(reach * ZONE_STEP_RATIO, 0.0) and not law.free[k] and not edge:
            out.append((k, f"PL={level} begins {1e3 * size:.2f} mm before it, {1e3 * reach:.2f} keep to the tolerance"))
        elif level == 0 and law.free[k] and not edge:
            out.append((k, "PL=0 brakes where any rounding keeps to the tolerance"))
        elif stated is None and level > 1:
            out.append((k, f"PL={level}, but no controller.position_levels_mm say how far that is"))
    return out


def _copy_printed_columns(words: Sequence[Words]) -> dict[str, Sequence[object]]:
    rconf = [w.get("rconf") for w in words]
    return {
        "rapid_pl": [read_whole_number(w, "pl") or 0 for w in words],
        "pl": [read_whole_number(w, "pl") for w in words],
        "rconf": [",".join(map(str, r)) if isinstance(r, tuple) else "" for r in rconf],
    }


CHECKS = ProgramChecks(
    compare_words=_compare_words, find_wrong_zones=_find_wrong_zones, copy_printed_columns=_copy_printed_columns
)
