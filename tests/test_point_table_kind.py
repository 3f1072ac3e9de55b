"""Rows of a point table are holes or path points: stated by the table or the option, or requested."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from machopt.cli import main
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words

Rows = list[tuple[float, ...]]  # x y z i j k, and optionally a feed
RNG = np.random.default_rng(7)


def on_cylinder(angle: float, y: float, radius: float = 900.0) -> tuple[float, ...]:
    n = (math.sin(angle), 0.0, math.cos(angle))
    return (radius * n[0], y, radius * n[2] - radius, *n)


def build_flat_rows(points: list[tuple[float, float]], z: float = 0.0) -> Rows:
    return [(x, y, z, 0.0, 0.0, 1.0) for x, y in points]


def circle(radius: float, count: int, turn: float = 1.0) -> list[tuple[float, float]]:
    return [
        (radius * math.cos(turn * math.tau * k / count), radius * math.sin(turn * math.tau * k / count))
        for k in range(count)
    ]


HOLES: dict[str, Rows] = {
    "a row": build_flat_rows([(40.0 * k, 0.0) for k in range(8)]),
    "a grid": build_flat_rows([(25.0 * i, 25.0 * j) for j in range(5) for i in range(6)]),
    "a snake grid": build_flat_rows(
        [(25.0 * (i if j % 2 == 0 else 5 - i), 25.0 * j) for j in range(5) for i in range(6)]
    ),
    "a bolt circle": build_flat_rows(circle(60.0, 12)),
    "many on a circle": build_flat_rows(circle(200.0, 90)),
    "at random": build_flat_rows([(float(x), float(y)) for x, y in RNG.uniform(0, 800, (40, 2))]),
    "one hole": build_flat_rows([(10.0, 20.0)]),
    "two holes": build_flat_rows([(0.0, 0.0), (300.0, 0.0)]),
    "on a drum": [on_cylinder(0.05 * k, 30.0 * j) for j in range(3) for k in range(-8, 9)],
    "steps in height": [(30.0 * k, 0.0, -15.0 * (k % 3), 0.0, 0.0, 1.0) for k in range(9)],
    "bosses": [(12.0 * k, 0.0, 40.0 * (k % 2), 0.0, 0.0, 1.0) for k in range(10)],
    "a fine pitch": build_flat_rows([(4.0 * i, 4.0 * j) for j in range(6) for i in range(10)]),
    "a double row": build_flat_rows([(20.0 * k, 0.0) for k in range(9) for _ in range(2 if k == 4 else 1)]),
    "a close pair among many": build_flat_rows([*((30.0 * k, 0.0) for k in range(30)), (871.5, 0.0)]),
    "one feed": [(*row, 120.0) for row in build_flat_rows([(40.0 * k, 0.0) for k in range(8)])],
    "top and bottom": [(40.0 * k, 0.0, z, 0.0, 0.0, 1.0) for k in range(6) for z in (2.0, -8.0)],
    "tilted holes": [(50.0 * k, 0.0, 0.0, 0.2 * (k % 2), 0.3, 0.9) for k in range(9)],
}
PATHS: dict[str, Rows] = {
    "a dense line": build_flat_rows([(0.5 * k, 0.0) for k in range(200)]),
    "a dense circle": build_flat_rows(circle(40.0, 300)),
    "a closed rectangle": build_flat_rows([(0, 0), (100, 0), (100, 60), (0, 60), (0, 0)]),
    "a closed coarse contour": build_flat_rows([*circle(150.0, 24), (150.0, 0.0)]),
    "a plunge first": [
        (0, 0, 20, 0, 0, 1),
        (0, 0, 0, 0, 0, 1),
        *build_flat_rows([(50.0 * k, 0.0) for k in range(1, 5)]),
    ],
    "plunge and retract": [
        (0, 0, 20, 0, 0, 1),
        *build_flat_rows([(0, 0), (50, 0), (100, 0), (100, 50), (100, 100)]),
        (100, 100, 20, 0, 0, 1),
    ],
    "feed changes": [
        (*row, 200.0 if k < 2 else 800.0) for k, row in enumerate(build_flat_rows([(30.0 * k, 0.0) for k in range(6)]))
    ],
    "a dense spiral": build_flat_rows(
        [(0.02 * k * math.cos(0.05 * k), 0.02 * k * math.sin(0.05 * k)) for k in range(900)]
    ),
    "rounded corners": build_flat_rows(
        [(0, 0), *((90 + 10 * math.sin(a), 10 - 10 * math.cos(a)) for a in np.linspace(0, 1.5, 20)), (100, 90)]
    ),
    "a swept drum": [on_cylinder(0.001 * k, 0.0) for k in range(400)],
    "a helix": [(20 * math.cos(0.05 * k), 20 * math.sin(0.05 * k), -0.01 * k, 0, 0, 1) for k in range(500)],
    "a five-axis swarf": [
        (0.8 * k, 5 * math.sin(0.05 * k), 0.0, 0.3 * math.sin(0.02 * k), 0.2, 0.9) for k in range(200)
    ],
    "a coarse zigzag with short steps": build_flat_rows(
        [(100.0 * ((k + 1) // 2 % 2), 1.5 * (k // 2)) for k in range(40)]
    ),
}


def write(folder: Path, rows: Rows, head: str = "", tail: str = "") -> Path:
    file = folder / "table.csv"
    feed = ",feed_mm_min" if len(rows[0]) == 7 else ""
    lines = [f"x_mm,y_mm,z_mm,i,j,k{feed}{head}"] + [",".join(f"{v:.6g}" for v in row) + tail for row in rows]
    file.write_text("\n".join(lines) + "\n")
    return file


def read(file: Path, **options: object) -> Toolpath:
    return read_toolpath(file, default_feed=0.01, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", HOLES)
def test_ambiguous_rows_lead_to_a_question(tmp_path: Path, name: str) -> None:
    file = write(tmp_path, HOLES[name])
    with pytest.raises(InputError) as refused:
        read(file)
    assert refused.value.where == "line 2"
    assert "--kind" in refused.value.reason
    assert "depth_mm" in refused.value.reason
    assert len(read(file, kind="path")) == len(HOLES[name])


@pytest.mark.parametrize("name", PATHS)
def test_path_rows_are_read_without_a_question(tmp_path: Path, name: str) -> None:
    found = read(write(tmp_path, PATHS[name]))
    assert len(found) == len(PATHS[name])
    assert found.cutting.all()


def test_holes_of_one_operation_among_paths_are_found(tmp_path: Path) -> None:
    file = tmp_path / "mixed.csv"
    path = [f"{0.5 * k},0,0,edge" for k in range(50)]
    holes = [f"{40 * k},80,0,rivets" for k in range(5)]
    file.write_text("\n".join(["x_mm,y_mm,z_mm,operation", *path, *holes]) + "\n")
    with pytest.raises(InputError) as refused:
        read(file)
    assert refused.value.where == "line 52"


@pytest.mark.parametrize("by_option", [True, False])
def test_each_hole_is_drilled_along_its_axis(tmp_path: Path, by_option: bool) -> None:
    rows = HOLES["on a drum"]
    kind, tail = ("", ",6,4") if by_option else (",kind", ",6,4,holes")
    file = write(tmp_path, rows, ",depth_mm,approach_mm" + kind, tail)
    t = read(file, kind="holes") if by_option else read(file)
    assert [MoveKind(m).word for m in t.move[:3]] == ["rapid", "cut", "retract"]
    assert len(t) == 3 * len(rows)
    assert [o.kind for o in t.operations] == ["point"]
    bottom = np.array([row[:3] for row in rows])
    assert np.allclose(t.position[1::3] * 1e3, bottom, atol=1e-2)
    for other in (t.position[0::3], t.position[2::3]):
        assert np.allclose((other - t.position[1::3]) * 1e3, 10.0 * t.axis[1::3], atol=1e-9)
    assert t.line[:6].tolist() == [2, 2, 2, 3, 3, 3]
    assert np.isfinite(t.feed).tolist() == [False, True, False] * len(rows)


def test_holes_and_path_in_one_table(tmp_path: Path) -> None:
    file = tmp_path / "mixed.csv"
    file.write_text(
        "x_inch,y_inch,z_inch,kind,depth_inch,approach_inch,operation,tool\n0,0,0,path,,,edge,1\n1,0,0,,,,edge,1\n"
        "2,0,0,holes,0.1,0.2,rivets,2\n3,0,0,,0.1,0.2,rivets,2\n"
    )
    t = read(file)
    assert [MoveKind(m).word for m in t.move] == ["cut", "cut", *["rapid", "cut", "retract"] * 2]
    assert t.position[2, 2] == pytest.approx(0.3 * 0.0254)
    assert [(o.label, o.tool, o.kind) for o in t.operations] == [("edge", "1", "trajectory"), ("rivets", "2", "point")]
    assert t.operation.tolist() == [0, 0, *[1] * 6]


@pytest.mark.parametrize(
    ("head", "tail", "options", "part"),
    [
        (",depth_mm", ",5", {"kind": "holes"}, "approach_mm"),
        ("", "", {"kind": "holes"}, "depth_mm"),
        (",depth_mm,approach_mm", ",0,5", {"kind": "holes"}, "above zero"),
        (",depth_mm,approach_mm", ",,5", {"kind": "holes"}, "above zero"),
        (",depth_mm,approach_mm", ",5,5", {}, "--kind"),
        (",kind", ",slots", {}, "path or holes"),
        (",kind", ",", {}, "first row"),
        (",kind", ",path", {"kind": "path"}, "no effect"),
        (",move", ",cut", {"kind": "holes"}, "no effect"),
        (",kind,move,depth_mm,approach_mm", ",holes,rapid,5,5", {}, "another kind"),
    ],
)
def test_contradictory_table_is_refused(
    tmp_path: Path, head: str, tail: str, options: dict[str, str], part: str
) -> None:
    file = write(tmp_path, PATHS["a dense line"], head, tail)
    with pytest.raises(InputError) as refused:
        read(file, **options)
    assert part in refused.value.reason


def test_commands_accept_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path, HOLES["a grid"], ",depth_mm,approach_mm", ",5,5")
    assert main(["inspect", str(file), "--feed", "100"]) == 2
    assert "--kind" in capsys.readouterr().err
    assert main(["inspect", str(file), "--feed", "100", "--kind", "holes"]) == 0


def test_shipped_tables_state_their_kind() -> None:
    for file in sorted((Path(__file__).resolve().parents[1] / "toolpaths").glob("*.csv")):
        assert len(read(file)) > 0


MOVING = (
    "dx_mm",
    "shift_x_mm",
    "theta_deg",
    "lead_deg",
    "tool_offset_mm",
    "frame",
    "wcs",
    "uframe",
    "mirror",
    "scale_x",
    "z2_inch",
)
HARMLESS = (
    "colour",
    "comment",
    "id",
    "hole",
    "diameter_mm",
    "thickness_mm",
    "gamma_deg",
    "q1_deg",
    "s_mm",
    "spindle_rpm",
)


@pytest.mark.parametrize("column", MOVING)
def test_unknown_column_that_may_move_points_stops_a_plan(tmp_path: Path, column: str) -> None:
    file = write(tmp_path, PATHS["a dense line"], f",{column}", ",1")
    with pytest.raises(InputError) as refused:
        refuse_unknown_words(read(file), file)
    assert f"--accept-unknown 'column {column}'" in refused.value.reason
    refuse_unknown_words(read(file, accept_unknown=(f"column {column}",)), file)


@pytest.mark.parametrize("column", HARMLESS)
def test_other_columns_are_counted(tmp_path: Path, column: str) -> None:
    file = write(tmp_path, PATHS["a dense line"], f",{column}", ",1")
    found = refuse_unknown_words(read(file), file)
    assert [w.word for w in found.ignored] == [f"column {column}"]
