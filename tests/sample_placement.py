"""Sample placement result: planned, estimated and refused places."""

from __future__ import annotations

from machopt.data_types.documents.place_document import (
    NeighbourPlaceEntry,
    PlaceDocument,
    PlaceEntry,
    PlaceSearchSection,
)
from machopt.report.pages.placement_page import PlacementPageData
from machopt.report.svg.placement_map import PlaceMark


def _build_place_entry(x: float, worst: float, folder: str | None) -> PlaceEntry:
    return PlaceEntry(
        folder=folder,
        shift_mm=(x, 0.0, 0.0),
        turn_deg=-15.0,
        xyz_mm=(470.0 + x, 110.0, 900.0),
        rpy_deg=(0.0, 0.0, 90.0),
        worst=worst,
        mean=0.28,
        bound=0.2,
        gain_percent=100 * (1 - worst / 0.4),
        cycle_time_s=219.2,
        worst_toolpath="part.cls",
        worst_point=25.0,
        joint_share_percent=(0.2, 44.0, 35.3, 17.6, 1.9, 1.0),
        around=(
            NeighbourPlaceEntry(moved="x -20 mm", worst=0.19, change_percent=-9.2, refused=""),
            NeighbourPlaceEntry(moved="x +20 mm", worst=None, change_percent=None, refused="out of reach"),
        ),
        verdict="part.cls: done",
        plans=(f"{folder}/part/report.html",) if folder else (),
        leaves=("table",) if folder else (),
    )


def build_sample_placement() -> PlacementPageData:
    """Return two planned places, one estimated and one refused."""
    best = (_build_place_entry(-60.0, 0.32, "best-1"), _build_place_entry(0.0, 0.4, None))
    search = PlaceSearchSection(
        x_mm=(-60.0, 60.0),
        y_mm=(-60.0, 60.0),
        z_mm=(0.0, 0.0),
        turn_deg=(-15.0, 0.0),
        step_mm=(60.0, 60.0, 0.0),
        step_deg=15.0,
        places=12,
        plans=3,
        minutes=10.0,
    )
    result = PlaceDocument(
        machopt_place=1,
        version="0",
        verdict="best place: x -60 mm, worst index 20.0 % less; no other of the 4 places can be better",
        exit_code=0,
        inputs={},
        cell="made up",
        toolpaths=("part.cls",),
        moved="workpiece",
        carried=("vice",),
        turn_about_mm=(470.0, 95.0, 912.0),
        index="deflection",
        unit="mm",
        search=search,
        looked_at=4,
        within_reach=3,
        planned=2,
        proven=True,
        stopped="",
        open_bound=None,
        gain_percent=20.0,
        at_edge=("x least",),
        as_it_stands=best[1],
        best=best[:1],
        options={},
        warnings=("at the edge of the range",),
    )
    marks = (
        PlaceMark(x=-60.0, y=0.0, value=0.32, planned=True, words="x -60 mm", refused=""),
        PlaceMark(x=0.0, y=0.0, value=0.4, planned=True, words="unchanged", refused=""),
        PlaceMark(x=60.0, y=0.0, value=0.45, planned=False, words="x +60 mm", refused=""),
        PlaceMark(
            x=60.0,
            y=60.0,
            value=float("nan"),
            planned=False,
            words="x +60 mm, y +60 mm",
            refused="point 3 is out of reach",
        ),
    )
    return PlacementPageData(result, marks)
