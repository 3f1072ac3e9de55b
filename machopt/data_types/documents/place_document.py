"""place.json of ``machopt place``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator

from machopt.data_types.documents.document_base import (
    Count,
    DocumentModel,
    First,
    Flag,
    Hashes,
    Known,
    Number,
    Numbers,
    Settings,
    Text,
    check_literal_integer,
)


class PlaceSearchSection(DocumentModel):
    """Places, objective and limits of the search."""

    x_mm: Numbers
    y_mm: Numbers
    z_mm: Numbers
    turn_deg: Numbers
    step_mm: Numbers
    step_deg: Number
    places: Count
    plans: Count
    minutes: Number


class NeighbourPlaceEntry(DocumentModel):
    """A place beside one of the best; null where nothing can be reached or stand there."""

    moved: Text
    worst: Known
    change_percent: Known
    refused: Text


class PlaceTolerancesSection(DocumentModel):
    """Holes and points of all toolpaths by outcome at the driven feed, and the one with the lowest probability."""

    in_tolerance: Count
    marginal: Count
    fail: Count
    unknown: Count
    worst_error_mm: Known  # nominal; null where an angle decides
    worst_error_toolpath: Text
    worst_error_point: Count
    worst_p_in: Known


class PlaceEntry(DocumentModel):
    """A place that was planned wholly; the shift is along the axes of world from where the cell has what moves."""

    folder: Text | None
    shift_mm: Numbers
    turn_deg: Number
    xyz_mm: Numbers  # the pose as cell.yaml has it: of the workpiece in its link, or of base_link in world
    rpy_deg: Numbers
    plans: tuple[Text, ...] = ()  # report of each toolpath's plan there, relative to the page
    leaves: tuple[Text, ...] = ()  # bodies that hold today what moves, and do not there
    worst: Known
    mean: Known
    bound: Known
    gain_percent: Known
    cycle_time_s: Known
    worst_toolpath: Text | None
    worst_point: Known
    joint_share_percent: Numbers
    tolerances: PlaceTolerancesSection | None = None  # null where nothing has a tolerance
    around: tuple[NeighbourPlaceEntry, ...]
    verdict: Text

    @property
    def pose_text(self) -> str:
        """The pose as cell.yaml takes it."""
        xyz, rpy = (", ".join(f"{round(v, 6) + 0.0:.10g}" for v in values) for values in (self.xyz_mm, self.rpy_deg))
        return f"{{xyz_mm: [{xyz}], rpy_deg: [{rpy}]}}"


class PlaceDocument(DocumentModel):
    """The whole file; worst and mean in ``unit``, less is better."""

    machopt_place: First
    version: Text
    verdict: Text
    exit_code: Annotated[Literal[0, 3, 4], BeforeValidator(check_literal_integer)]
    inputs: Hashes
    cell: Text
    toolpaths: tuple[Text, ...]
    moved: Literal["workpiece", "base_link"]
    carried: tuple[Text, ...]
    turn_about_mm: Numbers
    index: Text
    unit: Text
    search: PlaceSearchSection
    looked_at: Count
    within_reach: Count
    planned: Count
    proven: Flag
    stopped: Text
    open_bound: Known
    open_in_tolerance: Count | None = None  # most holes and points in tolerance at a place that was not planned
    gain_percent: Known
    at_edge: tuple[Text, ...]
    as_it_stands: PlaceEntry | None
    best: tuple[PlaceEntry, ...]
    options: Settings
    warnings: tuple[Text, ...]
