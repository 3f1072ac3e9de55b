"""Places as text and in parts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from machopt.domain.location import (
    Location,
    column_at,
    joint_at,
    joints_at,
    joints_of,
    link_at,
    link_of,
    located,
    rows_at,
    sensor_at,
)
from machopt.effects import registry

PACKAGE = Path(__file__).resolve().parents[1] / "machopt"


def test_text_and_parts_are_two_ways_to_say_one_place() -> None:
    listed = {place for effect in registry.EFFECTS.values() for place in effect.places}
    written = {
        joint_at(3),
        joints_at(4, 5),
        link_at(2),
        sensor_at("force"),
        rows_at((7, 9)),
        column_at("fx_N"),
        "base",
        "",
    }
    for text in listed | written | {column_at("fx_N"), "base", ""}:
        assert str(located(text)) == text
    assert located(joints_at(4, 5)) == Location("joint", "4-5")
    assert located(rows_at((7, 9))).of_rows
    assert located(rows_at(())).of_rows
    assert located(column_at("fx_N")).of_rows
    assert located("joint:4-5").numbers == (4, 5)
    assert located(rows_at((7,))).numbers == ()


def test_joints_and_links_have_numbers_and_others_have_none() -> None:
    assert (joints_of("joint:4-5"), joints_of("joint:3"), link_of("link:6")) == ((3, 4), (2, 2), 6)
    for wrong in ("base", "link:3", "joint", "joint:", "joint:a", "jointed:3", "3"):
        with pytest.raises(ValueError, match="is neither a joint nor a pair of joints"):
            joints_of(wrong)
    for wrong in ("joint:3", "link", "link:1-2", "tool"):
        with pytest.raises(ValueError, match="is no link"):
            link_of(wrong)


def test_nobody_else_takes_a_place_apart() -> None:
    """Neither by its colon nor by how it begins: its parts are asked for."""
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
