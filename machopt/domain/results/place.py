"""place.json of ``machopt place``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator

from machopt.domain.results.base import Count, First, Flag, Hashes, Known, Number, Numbers, Part, Settings, Text, whole


class SearchTold(Part):
    """What was searched, as asked for."""

    x_mm: Numbers
    y_mm: Numbers
    z_mm: Numbers
    turn_deg: Numbers
    step_mm: Numbers
    step_deg: Number
    places: Count
    plans: Count
    minutes: Number


class NearTold(Part):
    """A place beside one of the best; null where nothing can be reached or stand there."""

    moved: Text
    worst: Known
    change_percent: Known
    refused: Text


class PlaceTold(Part):
    """A place that was planned wholly; the shift is along the axes of world from where the cell has what moves."""

    folder: Text | None
    shift_mm: Numbers
    turn_deg: Number
    xyz_mm: Numbers
    rpy_deg: Numbers
    worst: Known
    mean: Known
    bound: Known
    gain_percent: Known
    cycle_time_s: Known
    worst_toolpath: Text | None
    worst_point: Known
    joint_share_percent: Numbers
    around: tuple[NearTold, ...]
    verdict: Text


class PlaceResult(Part):
    """The whole file; worst and mean in ``unit``, less is better."""

    machopt_place: First
    version: Text
    verdict: Text
    exit_code: Annotated[Literal[0, 3, 4], BeforeValidator(whole)]
    inputs: Hashes
    cell: Text
    toolpaths: tuple[Text, ...]
    moved: Literal["workpiece", "base_link"]
    carried: tuple[Text, ...]
    turn_about_mm: Numbers
    index: Text
    unit: Text
    search: SearchTold
    looked_at: Count
    within_reach: Count
    planned: Count
    proven: Flag
    stopped: Text
    open_bound: Known
    gain_percent: Known
    at_edge: tuple[Text, ...]
    as_it_stands: PlaceTold | None
    best: tuple[PlaceTold, ...]
    options: Settings
    warnings: tuple[Text, ...]
