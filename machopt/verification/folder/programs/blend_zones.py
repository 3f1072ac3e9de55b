"""Check of a program's blend zones: corners are rounded only where, and only as far as, the tolerance permits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from machopt.data_types.robot_program import LIN, RobotController, RobotProgram
from machopt.numerics.array_types import Array, Bools
from machopt.programs.program_reader import ParsedProgram
from machopt.programs.writing.blend_zones import HALF, LEAST, SHARP, SHORTEST, STRAIGHT, BlendZones
from machopt.programs.writing.feed_model import compute_line_acceleration
from machopt.verification.checks import VerificationCheck, build_file_check
from machopt.verification.folder.programs.printed_precision import compute_last_digit

ZONE_STEP_RATIO = 1.7  # between two preferred numbers: coordinates are printed, so a zone may fall to its neighbour
TOLERANCE_FACTOR = 1.2  # of the tolerance, for the same reason
PRINTED_DISTANCE_M = 1e-6  # m, of a distance
PERCENT_TOLERANCE = (
    12.0  # of CNT: joints at a target are the motion's beside it, which moves the acceleration that n follows from
)


def check_blend_zones(
    file: str,
    parsed: ParsedProgram,
    program: RobotProgram,
    law: BlendZones,
    controller: RobotController,
    *,
    zones: bool,
    own: bool,
    printed: float = 0.0,
) -> list[VerificationCheck]:
    """Return one check of the blend zones; none where the format has no zones.

    Args:
        file: Name of the program file.
        parsed: The program as it was read.
        program: The program as the post takes it.
        law: Law of the blend zones' ends.
        controller: Controller of the cell.
        zones: The post prints some zones; else every end is a stop.
        own: A user's post, which may round by other words than distances; these are not checked.
        printed: Rounding error of two targets that mean one place, by the program's decimals, m.
    """
    if parsed.dialect == "fanuc":
        bad = _check_continuous_zones(parsed, program, law)
    elif parsed.dialect == "jbi":
        bad = _check_zone_levels(parsed, program, law, controller, printed)
    elif parsed.dialect in ("ros",):
        return []
    else:
        stops = replace(law, distance=np.zeros(len(program)), room=np.zeros(len(program)))
        bad = _check_distances(parsed, program, law if zones else stops, own)
    named = [f"move {k + 1}, line {int(parsed.line[k])}: {text}" for k, text in bad]
    return [
        build_file_check(
            file,
            "zones",
            not bad,
            float(len(bad)),
            0.0,
            "moves",
            "; ".join(named[:3]) or "exact or rounded as the tolerance lets them",
        )
    ]


def _check_distances(parsed: ParsedProgram, program: RobotProgram, law: BlendZones, own: bool) -> list[tuple[int, str]]:
    d, out = parsed.blend, []
    inside = np.isfinite(law.turn)
    most = np.where(inside, law.room / HALF * 0.5 + PRINTED_DISTANCE_M, 0.0)
    passed = np.where(inside, d * np.tan(np.nan_to_num(law.turn) / 4.0), 0.0)
    unknown = np.isnan(d) & (not own)
    brakes = (d * ZONE_STEP_RATIO**2 < law.distance) & ~((d == 0.0) & _is_barely_fitting(program.blend, law))
    for k in np.flatnonzero(unknown | (d > most) | (passed > TOLERANCE_FACTOR * program.blend) | brakes):
        if unknown[k]:
            text = "no distance is known of its zone"
        elif not inside[k] or d[k] > most[k]:
            text = f"rounded over {1e3 * d[k]:.3f} mm where {1e3 * most[k]:.3f} are allowed"
        elif passed[k] > TOLERANCE_FACTOR * program.blend:
            text = f"passes its point by {1e3 * passed[k]:.3f} mm, the tolerance is {1e3 * program.blend:g}"
        else:
            text = f"brakes: rounded over {1e3 * d[k]:.3f} mm where {1e3 * law.distance[k]:.3f} would keep to it"
        out.append((int(k), text))
    return out


def _is_barely_fitting(tolerance: float, law: BlendZones) -> Bools:
    """(M,) the least zone of all fits, but for less than what coordinates are printed with: a stop is its neighbour."""
    reach = tolerance / np.tan(np.maximum(np.nan_to_num(law.turn), STRAIGHT) / 4.0)
    return np.asarray(np.minimum(reach, law.room) < SHORTEST + PRINTED_DISTANCE_M)


def _check_continuous_zones(parsed: ParsedProgram, program: RobotProgram, law: BlendZones) -> list[tuple[int, str]]:
    said = np.array([_parse_whole_number(w, "cnt") for w in parsed.configuration], dtype=np.float64)
    feed = np.round(np.nan_to_num(program.feed, nan=1.0), 4)
    rows = np.flatnonzero(law.distance > 0.0)
    bounds = []
    for a in _compute_acceleration_bounds(parsed, program):
        n = np.zeros(len(said))
        if a is not None:
            along = 2.0 * np.minimum(a[rows], a[rows + 1]) * law.distance[rows]
            n[rows] = 100.0 * np.minimum(np.sqrt(along) / feed[rows], 1.0)
        n[law.free] = 100.0
        bounds.append(n)
    least, n, most = bounds
    exact = ~np.isfinite(law.turn) | (program.kind != LIN)
    low, high = least - np.maximum(PERCENT_TOLERANCE, 0.35 * least), most + np.maximum(PERCENT_TOLERANCE, 0.35 * most)
    off = np.where(exact, said > 0.0, (said < low) | (said > high))
    near = (
        ~exact & (law.room > 0.0) & (law.distance <= LEAST * ZONE_STEP_RATIO) & (said <= 100.0)
    )  # on the edge of a stop
    return [
        (int(k), f"CNT{said[k]:.0f} where CNT{n[k]:.0f} keeps to the tolerance") for k in np.flatnonzero(off & ~near)
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


def _check_zone_levels(
    parsed: ParsedProgram, program: RobotProgram, law: BlendZones, controller: RobotController, printed: float
) -> list[tuple[int, str]]:
    out = []
    unsure = _is_undecided(program, law, printed)
    stated = controller.position_levels
    for k, words in enumerate(parsed.configuration):
        level = _parse_whole_number(words, "pl")
        if (level == 0 and not law.free[k]) or unsure[k]:
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


def _parse_whole_number(words: Mapping[str, object], name: str) -> int:
    value = words.get(name, 0)
    return value if isinstance(value, int) else 0
