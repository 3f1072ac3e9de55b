"""Pecks, chip breaks and pre-drilled depths of Heidenhain and Sinumerik cycles, computed by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

CUT, RAPID, IN, OUT = MoveKind.CUT, MoveKind.RAPID, MoveKind.APPROACH, MoveKind.RETRACT


def read_cycle(folder: Path, number: int, unit: str = "MM", **q: float) -> Toolpath:
    words = {"Q200": 2, "Q201": -12, "Q206": 150, "Q202": 5, "Q203": 0, "Q204": 20, "Q211": 0} | q
    text = "".join(f" {name}={value}\n" for name, value in words.items())
    file = folder / "x.h"
    file.write_text(
        f"0 BEGIN PGM T {unit}\n1 TOOL CALL 1 Z S1000\n2 L X+0 Y+0 Z+50 R0 FMAX\n3 CYCL DEF {number} X\n{text}"
        f"4 CYCL CALL\n5 L Z+60 FMAX M2\n6 END PGM T {unit}\n",
        encoding="utf-8",
    )
    return read_toolpath(file)


def list_strokes(path: Toolpath) -> list[tuple[float, MoveKind, float]]:
    """Return height, move and feed (0: rapid) after the clearance height, without the rapid moves at the end."""
    z, feed = np.round(path.position[:, 2] * 1e3, 6), np.nan_to_num(np.round(path.feed * 6e4, 6))
    rows = [(float(a), MoveKind(int(m)), float(f)) for a, m, f in zip(z, path.move, feed, strict=True)][2:]
    while rows[-1][1] == RAPID:
        rows.pop()
    return rows


def cut(z: float, feed: float = 150.0) -> tuple[float, MoveKind, float]:
    return (z, CUT, feed)


def out(z: float, feed: float = 0.0) -> tuple[float, MoveKind, float]:
    return (z, OUT, feed)


def back(z: float, feed: float = 0.0) -> tuple[float, MoveKind, float]:
    return (z, IN, feed)


STROKES = {  # cycle, parameters, strokes
    "shorter pecks": (
        203,
        {"Q212": 1, "Q205": 3, "Q256": 0.2},
        [cut(-5), out(2), back(-4.8), cut(-9), out(2), back(-8.8), cut(-12), out(20)],
    ),
    "shorter pecks to the least": (
        203,
        {"Q201": -16, "Q212": 2, "Q205": 4, "Q256": 0.5},
        [cut(-5), out(2), back(-4.5), cut(-9), out(2), back(-8.5), cut(-13), out(2), back(-12.5), cut(-16), out(20)],
    ),
    "the way out at a feed": (
        203,
        {"Q202": 12, "Q208": 250},
        [cut(-12), out(2, 250)],
    ),
    "the way out at the feed of the way in": (203, {"Q202": 12, "Q208": 0}, [cut(-12), out(2, 150)]),
    "the way out at MAX": (203, {"Q202": 12, "Q208": 99999}, [cut(-12), out(20)]),
    "one chip break, then out": (
        203,
        {"Q202": 3, "Q213": 1, "Q256": 0.5},
        [cut(-3), out(-2.5), cut(-6), out(2), back(-5.5), cut(-9), out(-8.5), cut(-12), out(20)],
    ),
    "chip breaks only": (
        203,
        {"Q202": 4, "Q213": 9, "Q256": 0.5},
        [cut(-4), out(-3.5), cut(-8), out(-7.5), cut(-12), out(20)],
    ),
    "205, shorter pecks": (
        205,
        {"Q212": 1, "Q205": 3, "Q258": 0.5, "Q259": 0.5},
        [cut(-5), out(2), back(-4.5), cut(-9), out(2), back(-8.5), cut(-12), out(20)],
    ),
    "205, distances that change": (
        205,
        {"Q202": 3, "Q258": 0.6, "Q259": 0.2},
        [cut(-3), out(2), back(-2.4), cut(-6), out(2), back(-5.6), cut(-9), out(2), back(-8.8), cut(-12), out(20)],
    ),
    "205, chip breaks in a peck": (
        205,
        {"Q202": 6, "Q257": 4, "Q256": 0.5, "Q258": 1},
        [cut(-4), out(-3.5), cut(-6), out(2), back(-5), cut(-10), out(-9.5), cut(-12), out(20)],
    ),
    "205, pre-drilled": (
        205,
        {"Q202": 12, "Q257": 4, "Q256": 0.5, "Q379": 6, "Q253": 750},
        [back(-6, 750), cut(-10), out(-9.5), cut(-12), out(20)],
    ),
    "205, pre-drilled, pecks": (
        205,
        {"Q202": 4, "Q379": 6, "Q253": 750, "Q258": 0.5},
        [back(-6, 750), cut(-10), out(2), back(-9.5), cut(-12), out(20)],
    ),
    "241, pre-drilled": (241, {"Q379": 6, "Q253": 750, "Q208": 1000}, [back(-6, 750), cut(-12), out(2, 1000)]),
    "209, chip breaks of a turn's part": (
        209,
        {"Q201": -10, "Q239": 2, "Q257": 4, "Q256": 0.2},
        [cut(-4, 2000), out(-3.6, 2000), cut(-8, 2000), out(-7.6, 2000), cut(-10, 2000), out(2, 2000)],
    ),
    "209, out of the hole": (
        209,
        {"Q201": -10, "Q239": 1, "Q257": 6, "Q256": 0},
        [cut(-6, 1000), out(2, 1000), cut(-10, 1000), out(2, 1000)],
    ),
    "209, faster way out": (209, {"Q239": 1, "Q403": 2}, [cut(-12, 1000), out(2, 2000)]),
    "204, back boring": (
        204,
        {"Q203": 20, "Q249": 5, "Q250": 20, "Q251": 3.5, "Q252": 15, "Q253": 750, "Q254": 200, "Q214": 1, "Q204": 50},
        [
            (22, RAPID, 0.0),
            back(-17, 750),
            back(-17, 750),
            cut(-10, 200),
            out(-17, 750),
            out(-17, 750),
            out(22, 750),
        ],
    ),
}


@pytest.mark.parametrize("name", STROKES)
def test_strokes_agree_with_the_manual(name: str, tmp_path: Path) -> None:
    number, q, expected = STROKES[name]
    assert list_strokes(read_cycle(tmp_path, number, **q)) == expected


@pytest.mark.parametrize("name", [n for n in STROKES if n not in ("204, back boring",)])
def test_inches_scale_every_height(name: str, tmp_path: Path) -> None:
    number, q, expected = STROKES[name]
    found = list_strokes(read_cycle(tmp_path, number, "INCH", **q))
    assert [h for h, _, _ in found] == pytest.approx([25.4 * h for h, _, _ in expected])


@pytest.mark.parametrize(("side", "place"), [(1, (-3.5, 0)), (2, (0, -3.5)), (3, (3.5, 0)), (4, (0, 3.5))])
def test_back_boring_passes_the_hole_beside_its_axis(side: int, place: tuple[float, float], tmp_path: Path) -> None:
    q = STROKES["204, back boring"][1] | {"Q214": side, "Q255": 0.5}
    path = read_cycle(tmp_path, 204, **q)
    aside = np.round(path.position[:, :2] * 1e3, 6)
    deep = path.move == IN
    assert tuple(aside[deep][0]) == place
    assert tuple(aside[path.move == CUT][0]) == (0, 0)
    assert path.dwells.sum() == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("number", "q", "word"),
    [
        (203, {"Q212": 2, "Q205": 0}, "least peck"),
        (205, {"Q379": 12}, "starts"),
        (204, {"Q249": -5, "Q250": 20, "Q251": 3, "Q252": 9, "Q214": 1}, "Q249"),
        (204, {"Q249": 5, "Q250": 20, "Q251": 3, "Q252": 9, "Q214": 0}, "Q214"),
        (204, {"Q249": 5, "Q250": 20, "Q252": 9, "Q214": 1}, "Q251"),
        (200, {"Q395": 1}, "Q395"),
        (205, {"Q202": 12, "Q257": 0.0001}, "chip breaks"),
    ],
)
def test_parameters_without_strokes_are_refused(number: int, q: dict[str, float], word: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=word):
        read_cycle(tmp_path, number, **q)
