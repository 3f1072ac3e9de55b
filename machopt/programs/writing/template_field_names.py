"""Names of the fields that the lines of a post template may use, by kind of line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

PART_FIELDS = (
    "name",
    "part",
    "part_number",
    "first_move",
    "last_move",
    "count",
    "parts",
    "single",
    "speeds_count",
    "zones_count",
    "corners_count",
    "vias_count",
    "positions",
    "line_count",
)
MOVE_FIELDS = (
    "number",
    "first",
    "speed",
    "speed_number",
    "zone_number",
    "corner",
    "corner_number",
    "via",
)  # in addition to the columns
ITEM_FIELDS = ("number", "text", "value")  # of items that are no moves
SPEED_FIELDS = ("speed", "number", "feed_m_s", "feed_mm_s", "feed_mm_min")
ZONE_FIELDS = ("number", "blend_m", "blend_mm")
TABLES: Mapping[str, Sequence[str]] = {
    "speed": SPEED_FIELDS,
    "zone": ZONE_FIELDS,
    "corner": ("corner", *SPEED_FIELDS[1:], *ZONE_FIELDS[1:]),
    "via": ("via", *ZONE_FIELDS),
}

OF_MOVES = ("ptp", "lin", "run", "ptp_change", "lin_change")
