"""Locations as text and as separate fields."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from machopt.data_types.effect_locations import (
    NamedLocation,
    format_column_location,
    format_joint_location,
    format_joint_pair_location,
    format_link_location,
    format_rows_location,
    format_sensor_location,
    parse_joint_location,
    parse_link_location,
    parse_location,
)
from machopt.effects import registry

PACKAGE = Path(__file__).resolve().parents[1] / "machopt"


def test_text_and_parts_of_a_place_are_equivalent() -> None:
    listed = {place for effect in registry.EFFECTS.values() for place in effect.places}
    written = {
        format_joint_location(3),
        format_joint_pair_location(4, 5),
        format_link_location(2),
        format_sensor_location("force"),
        format_rows_location((7, 9)),
        format_column_location("fx_N"),
        "base",
        "",
    }
    for text in listed | written | {format_column_location("fx_N"), "base", ""}:
        assert str(parse_location(text)) == text
    assert parse_location(format_joint_pair_location(4, 5)) == NamedLocation("joint", "4-5")
    assert parse_location(format_rows_location((7, 9))).is_row_location
    assert parse_location(format_rows_location(())).is_row_location
    assert parse_location(format_column_location("fx_N")).is_row_location
    assert parse_location("joint:4-5").numbers == (4, 5)
    assert parse_location(format_rows_location((7,))).numbers == ()


def test_joints_and_links_have_numbers_and_others_have_none() -> None:
    assert (parse_joint_location("joint:4-5"), parse_joint_location("joint:3"), parse_link_location("link:6")) == (
        (3, 4),
        (2, 2),
        6,
    )
    for wrong in ("base", "link:3", "joint", "joint:", "joint:a", "jointed:3", "3"):
        with pytest.raises(ValueError, match="is neither a joint nor a pair of joints"):
            parse_joint_location(wrong)
    for wrong in ("joint:3", "link", "link:1-2", "tool"):
        with pytest.raises(ValueError, match="is no link"):
            parse_link_location(wrong)


def test_places_are_parsed_in_one_module() -> None:
    """No other module searches for a colon or a prefix in a location: they use its fields."""
    taken = "|".join(
        (
            r"location\w*\.(split|r?partition|startswith|removeprefix)\(",
            r"""(startswith|removeprefix)\(["'](joint|link):""",
            r"""f["'](joint|link|sensor|rows|column):\{""",
        )
    )
    found = [
        f"{path.relative_to(PACKAGE)}: {line.strip()}"
        for path in PACKAGE.rglob("*.py")
        if path.name != "location.py"
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(taken, line)
    ]
    assert found == []
