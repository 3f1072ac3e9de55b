"""Rotation map of the optimize report: feasible rotations and their cost along the path."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.plan_output.collision_map import CollisionMap, find_best_branch, find_cut_stations
from machopt.report.page_data.optimize_series import interpolate_path_length
from machopt.report.page_types import optimize_page_data as page
from machopt.report.page_types.map_sample_states import PlaceCode, convert_to_place_codes

_DISPLAYED_CODE = {PlaceCode.NO_PATH: PlaceCode.NOT_CHECKED}  # this map has no word for it


def build_rotation_map(
    plan: Plan, collision_map: CollisionMap, s: Array, before: Plan | None = None
) -> page.RotationMap | None:
    """Return the best branch per station and rotation, with a mark where its pose was not checked for collisions.

    The rotation is shown as the angle phi of gamma's transported reference.

    Args:
        plan: The plan.
        collision_map: The map of feasible rotations and branches.
        s: (N,) path length at the toolpath's points, m.
        before: Another plan of the same toolpath, whose line is drawn too.
    """
    st, c = plan.path.stations, collision_map.candidates
    cut = find_cut_stations(plan)
    if not len(cut):
        return None
    first, best = find_best_branch(plan, collision_map, cut)
    known = np.take_along_axis(collision_map.known[cut], first[:, :, None], axis=2)[:, :, 0]
    value = np.where(np.isfinite(best), best, np.nan)
    if plan.scores.index != "deflection":
        value = 1.0 / value
    status = convert_to_place_codes(c.reason_of_rotation()[cut])
    status[(status == PlaceCode.OK) & ~known] = PlaceCode.NOT_CHECKED
    for code, said_as in _DISPLAYED_CODE.items():
        status[status == code] = said_as

    def line(scored: ScoredAssignment) -> Array:
        ok = scored.assignment.reason == InfeasibilityReason.OK
        return np.asarray(wrap_angle(np.where(ok, scored.assignment.phi, np.nan)[st[cut]]))

    return page.RotationMap(
        s=interpolate_path_length(s, plan.path.index[st[cut]]),
        point=plan.path.index[st[cut]],
        rotation=c.phi,
        index=value,
        status=status,
        chosen=line(plan.chosen),
        jiao2022=line(plan.jiao2022),
        cam_default=line(plan.cam_default),
        offset=plan.path.offset[st[cut]],
        collisions=_describe_collision_coverage(plan, collision_map),
        before=line(before.chosen) if before is not None and len(before.path.index) == len(plan.path.index) else None,
    )


def _describe_collision_coverage(plan: Plan, collision_map: CollisionMap) -> str:
    """How much of the map has been checked for collisions, in words."""
    if plan.setup.collision is None:
        return "Collisions were not checked."
    known, left = collision_map.looked_at, collision_map.open
    some = f"{known:,} of {known + left:,} configurations within reach, limits and margins were checked for collisions"
    if not collision_map.is_full_check:
        return (
            f"{some}, where the choice wanted to go; dotted places are reachable, but not proven free "
            "(--map-collisions full checks them all)."
        )
    if left:
        return (
            f"{some} in the {collision_map.seconds:.0f} s that --map-collisions full may take; dotted places were left "
            "and are not proven free."
        )
    return f"{some} (--map-collisions full, {collision_map.seconds:.1f} s)."
