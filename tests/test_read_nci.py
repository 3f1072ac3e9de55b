"""Mastercam NCI files, from handwritten records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toolpath_file_samples import NCI

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "1050\n1 2 3\n1012\n0 0 0\n1002\n1 100 10 7 0 0 0 0 0\n"


def read(tmp_path: Path, text: str, **options: object) -> Toolpath:
    file = tmp_path / "part.nci"
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **{"unit": "mm", **options})  # type: ignore[arg-type]


def mm(toolpath: Toolpath) -> np.ndarray:  # type: ignore[type-arg]
    return np.round(toolpath.position * 1e3, 9)


def test_lines_feeds_arcs_and_five_axes(tmp_path: Path) -> None:
    t = read(tmp_path, NCI.text)
    p = mm(t)
    assert t.format == "nci"
    assert [MoveKind(m).word for m in t.move[:3]] == ["rapid", "cut", "cut"]
    assert t.feed[1] == t.feed[2] == pytest.approx(250.0 / 60e3)  # -1: unchanged
    arc = p[2:-3]
    assert np.allclose(np.hypot(arc[:, 0], arc[:, 1] - 5.0), 10.0)
    assert (arc[1:, 1] > 5.0).all()  # record 3: counter-clockwise from (10, 5) to (0, 15)
    assert t.axis[-2:].tolist() == [[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]]
    assert t.operations[0].label == "Contour"
    assert t.operations[0].tool == "5"


@pytest.mark.parametrize(
    ("arc", "five"),
    [
        ("40 0 -7. 4. 0. 3. 4. 0. 90. 0", "40 1. 5. 0. 0. 0.6 0.8 90. 0"),
        ("40 -7. 4. 0. 3. 4. 0. 0 90.", "1. 5. 0. 0. 0.6 0.8 90."),
        ("0 -7. 4. 0. 3. 4. 0. 90.", "1. 5. 0. 1. 65. 80. 90."),
    ],
)
def test_order_of_the_numbers_follows_from_geometry(tmp_path: Path, arc: str, five: str) -> None:
    second = five.replace("5.", "9.", 1).replace("65.", "69.")
    body = f"0\n40 13. 4. 5. -2. 0\n1\n40 13. 4. -0. 90. 0\n3\n{arc}\n11\n{five}\n11\n{second}\n1003\n0\n"
    t = read(tmp_path, HEAD + body)
    p = mm(t)
    assert np.allclose(np.linalg.norm(p[1:-2, :2] - [3.0, 4.0], axis=1), 10.0)
    assert t.axis[-1] == pytest.approx([0.0, 0.6, 0.8])
    assert t.feed[t.cutting] == pytest.approx(90.0 / 60e3)


def test_order_that_fits_nothing_is_refused(tmp_path: Path) -> None:
    body = "0\n40 10. 0. 0. -2. 0\n3\n40 0 -10. 0. 0. 3. 0. 0. 90. 0\n1003\n0\n"
    with pytest.raises(InputError, match=r"line 9: the numbers of the arcs"):
        read(tmp_path, HEAD + body)
    with pytest.raises(InputError, match="five-axis records"):
        read(
            tmp_path, HEAD + "0\n40 1. 0. 0. -2. 0\n11\n1. 2. 3. 4. 5. 6. 7. 8.\n11\n2. 2. 9. 1. 5. 6. 7. 8.\n1003\n0\n"
        )


def test_tool_planes_are_transformed_into_the_first_one(tmp_path: Path) -> None:
    side = "1014\n0. 1. 0. 0. 0. 1. 1. 0. 0.\n"  # x along y, y along z, tool along x
    body = "1014\n1. 0. 0. 0. 1. 0. 0. 0. 1.\n0\n40 1. 2. 3. -2. 0\n1\n40 1. 2. 0. 90. 0\n"
    t = read(tmp_path, HEAD + body + side + "1\n40 1. 2. 3. 90. 0\n1003\n0\n")
    assert mm(t)[-1].tolist() == [3.0, 1.0, 2.0]
    assert t.axis[-1].tolist() == [1.0, 0.0, 0.0]
    assert any("tool plane changes" in w for w in t.warnings)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (HEAD + "1\n40 0. 0. 0. 5. 0\n1003\n0\n", {"unit": None}, "does not state its unit"),
        (HEAD + "81\n1 2 3\n", {}, "drilling cycle"),
        (HEAD + "hello\n1 2 3\n", {}, "expected the number of an NCI record"),
        (HEAD + "1\n40 0.\n", {}, "2 numbers"),
        (HEAD + "1\n40 0. 0. 0. -1. 0\n1003\n0\n", {}, "without a feed"),
        (HEAD + "1014\n1 0 0 0 1 0 0 0 2\n", {}, "right angles"),
    ],
)
def test_refusals(tmp_path: Path, text: str, options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, text, **options)


def test_truncated_and_unknown_records_are_reported(tmp_path: Path) -> None:
    t = read(tmp_path, HEAD + "777\n1 2\n0\n40 0. 0. 9. -2. 0\n1\n40 0. 0. 0. 5. 0\n1\n")
    assert t.warnings[0].startswith("INCOMPLETE FILE?")
    assert [(w.word, w.first_line) for w in t.ignored if not w.understood] == [("777", 7)]
