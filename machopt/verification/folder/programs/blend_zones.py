"""Check of a program's blend zones: corners are rounded only where, and only as far as, the tolerance permits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.robot_program import RobotController, RobotProgram
from machopt.numerics.array_types import Array, Bools
from machopt.programs.checking.program_checks import ZONE_STEP_RATIO, ZoneCase
from machopt.programs.maker_registry import find_language, load_checks
from machopt.programs.program_reader import ParsedProgram
from machopt.programs.writing.blend_zones import HALF, SHORTEST, STRAIGHT, BlendZones
from machopt.verification.check_results import VerificationCheck, build_file_check

TOLERANCE_FACTOR = 1.2  # of the tolerance: coordinates are printed, so a zone may fall to its neighbour
PRINTED_DISTANCE_M = 1e-6  # m, of a distance
PRINTED_SHARE = 1e-6  # of a joint move
FAR = 1e3  # m, farther than any zone


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
    if not find_language(parsed.dialect).has_zones:
        return []
    find_wrong_zones, list_shares = (
        load_checks(parsed.dialect).find_wrong_zones,
        load_checks(parsed.dialect).list_rounded_shares,
    )
    if find_wrong_zones is not None:
        bad = find_wrong_zones(ZoneCase(parsed, program, law, controller, printed))
    else:
        stops = replace(law, distance=np.zeros(len(program)), room=np.zeros(len(program)))
        stated = list_shares is not None and law.rapid is not None and bool((law.rapid > 0.0).any())
        shares = np.array(list_shares(parsed.configuration) if stated and list_shares is not None else [], float)
        bad = _check_distances(parsed, program, law if zones else stops, own, shares)
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


def _check_distances(
    parsed: ParsedProgram, program: RobotProgram, law: BlendZones, own: bool, shares: Array
) -> list[tuple[int, str]]:
    """Return number and fault of each wrong zone; ``shares`` (M,) where the program states some, else empty."""
    d, out = parsed.blend, []
    rapid = np.zeros(len(d)) if law.rapid is None else law.rapid
    if len(shares) and program.rapid_share is not None:  # a share in place of a distance: as if it were all of it
        stated = np.isfinite(shares)
        d = np.where(stated, np.where(shares <= program.rapid_share + PRINTED_SHARE, rapid, FAR), d)
    inside = np.isfinite(law.turn)
    most = np.where(inside, law.room / HALF * 0.5 + PRINTED_DISTANCE_M, 0.0)
    most = np.where(rapid > 0.0, rapid + PRINTED_DISTANCE_M, most)
    passed = np.where(inside, d * np.tan(np.nan_to_num(law.turn) / 4.0), 0.0)
    unknown = np.isnan(d) & (not own)
    brakes = (d * ZONE_STEP_RATIO**2 < law.distance) & ~((d == 0.0) & _is_barely_fitting(program.blend, law))
    for k in np.flatnonzero(unknown | (d > most) | (passed > TOLERANCE_FACTOR * program.blend) | brakes):
        if unknown[k]:
            text = "no distance is known of its zone"
        elif rapid[k] > 0.0 and d[k] > most[k]:
            text = f"rounded over more than the {1e3 * rapid[k]:.3f} mm before it that the plan has checked"
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
