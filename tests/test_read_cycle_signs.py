"""Invalid and ambiguous numbers of drilling cycles are refused with their line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

COMMON = {200: 2, 201: -20, 206: 150, 202: 5, 203: 0, 204: 50, 211: 0}


def write_heidenhain(tmp_path: Path, number: int, given: dict[int, float]) -> Path:
    words = {**COMMON, **given}
    lines = " ~\n".join(f"Q{name}={value:+g}" for name, value in words.items())
    file = tmp_path / "a.h"
    file.write_text(
        f"BEGIN PGM A MM\nTOOL CALL 1 Z S1000\nL X+0 Y+0 Z+50 R0 FMAX M3\nCYCL DEF {number} HOLE ~\n{lines}\n"
        "L X+10 Y+10 R0 FMAX M99\nL Z+100 R0 FMAX M30\nEND PGM A MM\n",
        encoding="utf-8",
    )
    return file


REFUSED = [
    (200, {202: 0}),
    (200, {202: -5}),
    (203, {202: 0}),
    (205, {202: 0}),
    (200, {200: -2}),
    (200, {204: -1}),
    (200, {206: -150}),
    (200, {210: -0.5}),
    (200, {211: -1}),
    (201, {208: -5}),
    (203, {212: -1}),
    (203, {213: -2}),
    (203, {205: -1}),
    (203, {256: -0.2}),
    (205, {257: -3}),
    (205, {258: -0.2}),
    (205, {259: -0.2, 258: 0.2}),
    (205, {379: -3}),
    (205, {379: 3, 253: -500}),
    (209, {239: 1, 257: -3}),
    (209, {239: 1, 403: -2}),
    (241, {379: -2}),
]


@pytest.mark.parametrize(("number", "given"), REFUSED)
def test_negative_number_and_zero_plunging_depth_are_refused(
    tmp_path: Path, number: int, given: dict[int, float]
) -> None:
    with pytest.raises(InputError) as caught:
        read_toolpath(write_heidenhain(tmp_path, number, given))
    assert any(f"Q{name}=" in str(caught.value) for name, value in given.items() if value <= 0)


@pytest.mark.parametrize(
    ("number", "given"),
    [
        (200, {202: 20}),
        (200, {202: 50}),
        (201, {202: 0}),
        (209, {239: -1, 257: 0}),
        (240, {202: 0}),
        (205, {257: 0, 202: 20}),
    ],
)
def test_single_stroke(tmp_path: Path, number: int, given: dict[int, float]) -> None:
    path = read_toolpath(write_heidenhain(tmp_path, number, given))
    np.testing.assert_allclose(path.position[path.move == MoveKind.CUT][:, 2] * 1e3, [-20.0])


@pytest.mark.parametrize("body", ["G83 X5 Z-20 R2 Q5 K3", "G73 X5 Z-20 R2 Q5 K15"])
def test_k_of_a_peck_cycle_is_refused_where_it_would_repeat_a_hole(tmp_path: Path, body: str) -> None:
    file = tmp_path / "a.nc"
    head = "G21 G90 G17 G94\nG0 X0 Y0 Z10\nF300\n"
    file.write_text(f"{head}{body}\nG80\nM30\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 4.*K"):
        read_toolpath(file)
    file.write_text(f"{head}G91 {body.replace('Z-20 R2', 'Z-22 R-8')}\nG80\nM30\n", encoding="utf-8")
    places = read_toolpath(file).position[:, 0]
    assert np.max(places) * 1e3 == pytest.approx(15.0 if "K3" in body else 75.0)
