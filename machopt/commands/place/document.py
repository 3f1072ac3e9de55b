"""Output of ``machopt place``: place.json, places.csv and the data of the page."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.documents.place_document import (
    NeighbourPlaceEntry,
    PlaceDocument,
    PlaceEntry,
    PlaceSearchSection,
    PlaceTolerancesSection,
)
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process_columns import OUTCOMES
from machopt.file_formats.csv_text_escaping import escape_formula_text
from machopt.options.plan_option_reader import format_user_options
from machopt.placement.moved_cell import move_cell
from machopt.placement.placement_site import PlacementSite
from machopt.placement.search_options import PlacementOptions, PlacementShift, compute_grid_steps
from machopt.placement.search_result import PlacementCandidate, PlacementSearchResult, PlannedPlacement
from machopt.planning.cost.stiffness_index import resolve_index
from machopt.report.pages.placement_page import PlacementPageData
from machopt.report.svg.placement_map import PlaceMark
from machopt.version import __version__


@dataclass(frozen=True)
class ConfirmedPlacement:
    """One of the best placements, as ``optimize`` wrote and verified it."""

    planned: PlannedPlacement
    folder: str
    verdict: str
    exit_code: int
    plans: tuple[str, ...] = ()  # the report of each toolpath's plan, relative to the output folder


def get_index_unit(options: PlanOptions) -> tuple[str, float]:
    """Return the displayed unit of the index, and the factor from m or m/N.

    Args:
        options: The planning options in force.
    """
    return ("mm", 1e3) if resolve_index(options) == "deflection" else ("mm/kN", 1e6)


def _build_search_section(search: PlacementOptions) -> PlaceSearchSection:
    grid = compute_grid_steps(search)
    return PlaceSearchSection(
        x_mm=_convert_to_mm(search.x),
        y_mm=_convert_to_mm(search.y),
        z_mm=_convert_to_mm(search.z),
        turn_deg=tuple(degrees(v) for v in search.turn),
        step_mm=_convert_to_mm(grid.translation),
        step_deg=degrees(grid.turn),
        places=search.places,
        plans=search.plans,
        minutes=search.seconds / 60,
    )


def build_place_document(
    site: PlacementSite,
    search: PlacementOptions,
    siting: PlacementSearchResult,
    confirmed: tuple[ConfirmedPlacement, ...] | None,
    inputs: dict[str, str],
) -> PlaceDocument:
    """Return the content of place.json.

    Args:
        site: The cell, the jobs and the options of the search.
        search: Options of the placement search.
        siting: Result of the placement search.
        confirmed: The best placements as written; None before that.
        inputs: SHA-256 of the input files by name.
    """
    cell, unit = site.cell, get_index_unit(site.options)
    here = next((p for p in siting.planned if p.place.number == 0), None)
    base = here.worst if here is not None and not here.refused else np.nan
    if confirmed is None:
        best = [_build_place_entry(site, siting, p, base, None) for p in siting.best[: search.best]]
    else:
        best = [_build_place_entry(site, siting, c.planned, base, c) for c in confirmed]
    code = 3 if not best else max((c.exit_code for c in confirmed or ()), default=0)
    top = siting.best[0] if siting.best else None
    gain = 100 * (1 - top.worst / base) if top is not None else np.nan
    return PlaceDocument(
        machopt_place=1,
        version=__version__,
        verdict=_format_verdict(siting, gain, code, describe_range_edges(search, top), site.has_free_external_joints),
        exit_code=0 if code == 0 else 3 if code == 3 else 4,
        inputs=inputs,
        cell=cell.name,
        toolpaths=tuple(t.source for t in site.toolpaths),
        moved="base_link" if siting.carried.base else "workpiece",
        carried=tuple(sorted(siting.carried.names)),
        turn_about_mm=_convert_to_mm(siting.carried.centre),
        index=resolve_index(site.options),
        unit=unit[0],
        search=_build_search_section(search),
        looked_at=len(siting.places),
        within_reach=sum(p.is_feasible for p in siting.places),
        planned=len(siting.planned),
        proven=siting.is_optimal,
        stopped=siting.stopped,
        open_bound=unit[1] * siting.open_bound,
        open_in_tolerance=_count_open(siting),
        gain_percent=gain,
        at_edge=describe_range_edges(search, top),
        as_it_stands=_build_place_entry(site, siting, here, base, None)
        if here is not None
        else _build_refused_entry(site, siting.places[0]),
        best=tuple(best),
        options=format_user_options(site.options),
        warnings=(*_list_support_warnings(site, best), *cell.warnings),
    )


def describe_range_edges(search: PlacementOptions, top: PlannedPlacement | None) -> tuple[str, ...]:
    """Return messages where the best placement lies at the end of a range; a better one may lie beyond it.

    Args:
        search: Options of the placement search.
        top: The best placement; None where there is none.
    """
    if top is None:
        return ()
    out = []
    for name in ("x", "y", "z", "turn"):
        low, high = getattr(search, name)
        value = getattr(top.place.shift, name)
        if high > low and min(value - low, high - value) < 1e-9:
            out.append(f"{name} {'least' if value - low < 1e-9 else 'greatest'}")
    return tuple(out)


def _format_verdict(siting: PlacementSearchResult, gain: float, code: int, edge: tuple[str, ...], of_grid: bool) -> str:
    if not siting.best:
        return f"infeasible: no plan at any of {len(siting.places)} places"
    if code:
        return "verification failed at one of the best places"
    top = siting.best[0]
    tried = "" if siting.is_optimal else f" of the {len(siting.planned)} that were planned"  # others may be better
    if top.place.number == 0:
        text = f"the best place{tried} is where the cell has it"
        if len(siting.planned) == 1 and not siting.is_optimal:
            text = "no place was planned but the one where the cell has it"
    else:
        less = f", worst index {gain:.1f} % less" if np.isfinite(gain) else "; where the cell has it nothing is planned"
        text = f"best place{tried}: {top.place.shift.text}{less}"
    text += f"; {count}" if (count := _format_outcomes(siting, top)) else ""
    if siting.is_optimal:
        text += f"; no other of the {len(siting.places)} places can be better"
        text += ", by a grid of values of the external joints" if of_grid else ""
    elif siting.stopped:
        text += f"; stopped {siting.stopped}, a place left out may be better{_format_rest(siting, top)}"
    else:
        text += "; at the programmed feed no other place has more in tolerance, a motion that is slower may have"
    return text + (f"; at the edge of the range ({', '.join(edge)})" if edge else "")


def _format_outcomes(siting: PlacementSearchResult, top: PlannedPlacement) -> str:
    """Return how many holes and points the best place has in tolerance, and the cell's own; empty without any."""
    if not top.outcomes:
        return ""
    text = f"{top.outcomes[0]} of {sum(top.outcomes)} holes and points in tolerance"
    here = next((p for p in siting.planned if p.place.number == 0 and not p.refused), None)
    if here is None or here is top or not here.outcomes:
        return text
    return f"{text} instead of {here.outcomes[0]}"


def _format_rest(siting: PlacementSearchResult, top: PlannedPlacement) -> str:
    """Return by how much a place that was not planned may be better."""
    missed, bound = siting.open_limit
    if missed < top.missed:
        return f" by {top.missed - missed:.0f} holes and points at most"
    return f" by {100 * (1 - bound / top.worst):.1f} % at most" if np.isfinite(bound) else " at most"


def _count_open(siting: PlacementSearchResult) -> int | None:
    """Return the most holes and points in tolerance at a place that was not planned; None where none is left."""
    counted = [sum(p.outcomes) for p in siting.planned if p.outcomes]
    if not counted or not np.isfinite(siting.open_limit[0]):
        return None
    return counted[0] - int(siting.open_limit[0])


def _build_tolerances(site: PlacementSite, one: PlannedPlacement) -> PlaceTolerancesSection | None:
    if not one.outcomes or one.tolerance_point < 0:
        return None
    passed, marginal, failed, unknown = one.outcomes
    return PlaceTolerancesSection(
        in_tolerance=passed,
        marginal=marginal,
        fail=failed,
        unknown=unknown,
        worst_error_mm=1e3 * one.tolerance_error,
        worst_error_toolpath=site.toolpaths[one.tolerance_job].source,
        worst_error_point=one.tolerance_point,
        worst_p_in=one.tolerance_p_in,
    )


def _build_place_entry(
    site: PlacementSite,
    siting: PlacementSearchResult,
    one: PlannedPlacement,
    base: float,
    done: ConfirmedPlacement | None,
) -> PlaceEntry:
    unit = get_index_unit(site.options)[1]
    pose = _compute_pose(site.cell, siting, one.place.shift)
    around = tuple(
        NeighbourPlaceEntry(
            moved=n.moved,
            worst=unit * n.worst,
            change_percent=100 * (n.worst / one.place.worst - 1) if one.place.worst > 0 else np.nan,
            refused=n.refused,
        )
        for n in siting.around.get(one.place.number, ())
    )
    return PlaceEntry(
        folder=done.folder if done is not None else None,
        shift_mm=_convert_to_mm(one.place.shift.translation),
        turn_deg=degrees(one.place.shift.turn),
        xyz_mm=pose[0],
        rpy_deg=pose[1],
        plans=done.plans if done is not None else (),
        leaves=_list_lost_supports(site, one),
        worst=unit * one.worst,
        mean=unit * one.mean,
        bound=unit * one.place.bound,
        gain_percent=100 * (1 - one.worst / base),
        cycle_time_s=one.cycle_time,
        worst_toolpath=site.toolpaths[one.job].source if not one.refused else None,
        worst_point=one.point,
        joint_share_percent=tuple(100 * s for s in one.shares),
        tolerances=_build_tolerances(site, one),
        around=around,
        verdict=done.verdict if done is not None else one.refused or "planned",
    )


def _list_lost_supports(site: PlacementSite, one: PlannedPlacement) -> tuple[str, ...]:
    """What holds today what moves, and does not at the place."""
    refusal = site.supports.build_shift_check(site.moved_bodies.names, base=site.moved_bodies.base)
    return refusal.find_lost_supports(one.place.shift.build_matrix(site.moved_bodies.centre))


def _list_support_warnings(site: PlacementSite, best: Sequence[PlaceEntry]) -> list[str]:
    """A warning for each of the best places where what moves leaves what holds it today."""
    name = "base_link" if site.moved_bodies.base else "workpiece"
    what = " with ".join(filter(None, [name, ", ".join(sorted(site.moved_bodies.names))]))
    return [
        f"place {k}: {what} leaves {', '.join(p.leaves)}, which holds it today; that has to be moved or built anew"
        for k, p in enumerate(best, 1)
        if p.leaves
    ]


def _build_refused_entry(site: PlacementSite, place: PlacementCandidate) -> PlaceEntry:
    """Where the cell has it, if nothing can be planned there."""
    return PlaceEntry(
        folder=None,
        shift_mm=(0.0, 0.0, 0.0),
        turn_deg=0.0,
        xyz_mm=_convert_to_mm(site.cell.workpiece.T_link_workpiece[:3, 3]),
        rpy_deg=(),
        worst=None,
        mean=None,
        bound=None,
        gain_percent=None,
        cycle_time_s=None,
        worst_toolpath=None,
        worst_point=None,
        joint_share_percent=(),
        around=(),
        verdict=place.refused,
    )


def _compute_pose(
    cell: Cell, siting: PlacementSearchResult, shift: PlacementShift
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """xyz_mm and rpy_deg in world of what moves, as cell.yaml has them."""
    from scipy.spatial.transform import Rotation

    at = move_cell(cell, siting.carried, shift)
    T = at.T_world_base if siting.carried.base else at.workpiece.T_link_workpiece
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
    return _convert_to_mm(T[:3, 3]), tuple(round(float(v), 9) + 0.0 for v in angles)


def build_place_columns(site: PlacementSite, siting: PlacementSearchResult) -> dict[str, NDArray[Any]]:
    """Return places.csv by column: every evaluated placement, the cell's own first; the index in its displayed unit.

    Args:
        site: The cell, the jobs and the options of the search.
        siting: Result of the placement search.
    """
    unit = get_index_unit(site.options)[1]
    planned = {p.place.number: p for p in siting.planned}
    every = siting.places
    whole = [planned.get(p.number) for p in every]
    refused = [p.refused or ("" if one is None else one.refused) for p, one in zip(every, whole, strict=True)]
    return {
        **{f"d{a}_mm": np.array([1e3 * getattr(p.shift, a) for p in every]) for a in "xyz"},
        "turn_deg": np.degrees([p.shift.turn for p in every]),
        "refused": np.array(refused),
        "bound": unit * np.array([p.bound for p in every]),
        "outlook": unit * np.array([p.worst for p in every]),
        "planned_worst": unit * np.array([np.nan if one is None else one.worst for one in whole]),
        "cycle_time_s": np.array([np.nan if one is None else one.cycle_time for one in whole]),
        **_build_outcome_columns(siting, whole),
    }


def _build_outcome_columns(
    siting: PlacementSearchResult, planned: Sequence[PlannedPlacement | None]
) -> dict[str, NDArray[Any]]:
    """Return the columns about tolerances; empty where nothing has one, or where it is not estimated."""
    estimates = [p.outcomes for p in siting.places]
    made = [() if one is None else one.outcomes for one in planned]
    missed = [p.least_missed if p.outcomes else np.nan for p in siting.places]
    out = {"bound_in_tolerance": np.array([sum(e) - m for e, m in zip(estimates, missed, strict=True)], float)}
    for prefix, counts in (("outlook_", estimates), ("", made)):
        for k, word in enumerate(("in_tolerance", *OUTCOMES[1:])):
            out[prefix + word] = np.array([c[k] if c else np.nan for c in counts], float)
    known = [None if one is None or one.tolerance_point < 0 else one for one in planned]
    out["worst_error_mm"] = np.array([np.nan if one is None else 1e3 * one.tolerance_error for one in known])
    out["worst_error_point"] = np.array([np.nan if one is None else one.tolerance_point for one in known])
    out["worst_p_in"] = np.array([np.nan if one is None else one.tolerance_p_in for one in known])
    return out


def write_place_table(path: Path, site: PlacementSite, siting: PlacementSearchResult) -> None:
    """Write places.csv.

    Args:
        path: The file to write.
        site: The cell, the jobs and the options of the search.
        siting: Result of the placement search.
    """
    columns = build_place_columns(site, siting)
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            rows.writerow([escape_formula_text(str(v)) if isinstance(v, np.str_) else _format_number(v) for v in row])


def build_placement_page_data(
    site: PlacementSite, siting: PlacementSearchResult, result: PlaceDocument
) -> PlacementPageData:
    """Return the data of the page.

    Args:
        site: The cell, the jobs and the options of the search.
        siting: Result of the placement search.
        result: Content of place.json.
    """
    unit = get_index_unit(site.options)[1]
    planned = {p.place.number: p for p in siting.planned}
    marks = tuple(
        PlaceMark(
            x=1e3 * p.shift.x,
            y=1e3 * p.shift.y,
            value=unit * (planned[p.number].worst if p.number in planned else p.worst),
            planned=p.number in planned,
            words=p.shift.text,
            refused=p.refused or (planned[p.number].refused if p.number in planned else ""),
            outcomes=planned[p.number].outcomes if p.number in planned else p.outcomes,
        )
        for p in siting.places
    )
    return PlacementPageData(result, marks)


def _convert_to_mm(values: object) -> tuple[float, ...]:
    return tuple(round(1e3 * float(v), 9) + 0.0 for v in np.asarray(values, float))


def _format_number(value: float) -> str:
    return f"{value:.9g}" if np.isfinite(value) else ""
