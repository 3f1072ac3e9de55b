"""Point tables: CSV, Parquet and headerless XYZWPR lists."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

GOOD = """# by hand
x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation,rx,ry,rz,tolerance_mm

0,0,10,0,0,1,rapid,,drill,,,,
0,0,0,0,0,1,cut,120,drill,1,0,0,0.05
0,0,10,0,0,1,retract,,drill,,,,
50,0,0,0,0,2,approach,,face,0,2,0,0.1
60,0,0,0,0,1,,600,face,0,1,0,
"""


def read(tmp_path: Path, text: str, **options: object) -> Toolpath:
    file = tmp_path / "path.csv"
    file.write_bytes(text.encode())
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def test_every_column_is_read(tmp_path: Path) -> None:
    t = read(tmp_path, GOOD)
    assert t.format == "csv"
    assert len(t) == 5
    assert t.position[4] * 1e3 == pytest.approx([60, 0, 0])
    assert [MoveKind(m).word for m in t.move] == ["rapid", "cut", "retract", "approach", "cut"]
    assert t.feed[[1, 4]] == pytest.approx([0.002, 0.01])
    assert [(o.label, o.kind) for o in t.operations] == [("drill", "point"), ("face", "trajectory")]
    assert t.reference[3] == pytest.approx([0, 1, 0])
    assert np.isnan(t.reference[0]).all()
    assert t.tolerance[1] == pytest.approx(5e-5)
    assert np.isnan(t.tolerance[4])
    assert t.line.tolist() == [4, 5, 6, 7, 8]
    assert np.allclose(np.linalg.norm(t.axis, axis=1), 1.0)
    assert any("unit length" in w for w in t.warnings)


def test_empty_feed_repeats_the_previous_cut_of_its_operation(tmp_path: Path) -> None:
    """Tool and offset are repeated likewise, within an operation only; a feed given by the user has priority."""
    rows = ["0,0,9,rapid,,a", "0,0,0,cut,60,a", "1,0,0,cut,,a", "1,0,9,rapid,,a", "2,0,0,cut,,a", "3,0,0,cut,30,b"]
    head = "x_mm,y_mm,z_mm,move,feed_mm_min,operation\n"
    t = read(tmp_path, head + "\n".join(rows) + "\n")
    np.testing.assert_allclose(t.feed[1:], [0.001, 0.001, np.nan, 0.001, 0.0005])
    assert any("2 cuts with an empty feed have that of the cut before, the first in line 4" in w for w in t.warnings)
    with pytest.raises(InputError, match="line 7: cutting move without a feed"):
        read(tmp_path, head + "\n".join([*rows[:5], "3,0,0,cut,,b"]) + "\n")
    np.testing.assert_allclose(read(tmp_path, head + "\n".join(rows) + "\n", default_feed=0.002).feed[2], 0.002)


def test_bom_crlf_and_defaults(tmp_path: Path) -> None:
    t = read(tmp_path, "\ufeffx_mm,y_mm,z_mm,feed_mm_min\r\n1,2,3,60\r\n4,5,6,60\r\n", kind="path")
    assert t.cutting.all()
    assert t.axis.tolist() == [[0, 0, 1]] * 2
    assert t.operations[0].label == "main"


def test_units_by_column_or_option(tmp_path: Path) -> None:
    assert read(tmp_path, "x,y,z,feed\n1,0,0,10\n2,0,0,10\n", unit="inch", kind="path").position[0, 0] == pytest.approx(
        0.0254
    )
    assert read(tmp_path, "x_inch,y_inch,z_inch,feed\n1,0,0,10\n", kind="path").feed[0] == pytest.approx(254 / 60e3)
    with pytest.raises(InputError, match="give --unit"):
        read(tmp_path, "x,y,z\n1,0,0\n")
    with pytest.raises(InputError, match="'x_mm' is in mm but --unit inch"):
        read(tmp_path, GOOD, unit="inch")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_mm,y_mm,z_mm,feed_mm_min\n", "no rows"),
        ("x_mm,y_mm,feed_mm_min\n1,2,3\n", "z_mm are missing"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,2,3\n", "line 2: 3 columns; expected 4"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,2,3,4\n1,nan,3,4\n", "line 3, column y_mm: found 'nan'"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,2,inf,4\n", "line 2, column z_mm"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,,3,4\n", "line 2, column y_mm: found ''"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,abc,3,4\n", "found 'abc'; expected a number"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,2,2e6,4\n", "line 2: coordinate 2e\\+06 mm"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "line 2: cutting move without a feed"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,2,3,0\n", "line 2: feed 0"),
        ("x_mm,y_mm,z_mm,feed_mm_min\n1,2,3,-4\n", "column feed_mm_min: feed -4"),
        ("x_mm,y_mm,z_mm,i,j,k,feed_mm_min\n1,2,3,0,0,0,9\n", "line 2: the tool axis is zero"),
        ("x_mm,y_mm,z_mm,i,j,feed_mm_min\n1,2,3,0,0,9\n", "k is missing; it is required with i, j"),
        ("x_mm,y_mm,z_mm,move,feed_mm_min\n1,2,3,plunge,9\n", "line 2, column move: move 'plunge'"),
        ("x_mm,y_mm,z_mm,feed_mm_mim\n1,2,3,9\n", "'feed_mm_min' is a column"),
        ("x_mm,y_mm,z_mm,x_mm\n1,2,3,9\n", "is given twice"),
        ("x_mm,y_mm,z_inch,feed\n1,2,3,9\n", "mix mm and inch"),
        ("x_mm,y_mm,z_mm,move,feed_mm_min\n1,2,3,rapid,\n", "no cutting move"),
        ("x_mm;y_mm;z_mm\n1;2;3,5\n", "semicolons"),
        ("1,2,3\n4,5,6\n", "without a header"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, text)


def test_unknown_column_is_counted(tmp_path: Path) -> None:
    text = "x_mm,y_mm,z_mm,feed_mm_min,colour\n1,2,3,9,red\n"
    assert [w.word for w in read(tmp_path, text, kind="path").ignored] == ["column colour"]
    with pytest.raises(InputError, match="strict"):
        read(tmp_path, text, strict=True)


def test_xyzwpr_list(tmp_path: Path) -> None:
    t = read(tmp_path, "0,0,100,180,0,0,0\n10,0,100,180,0,90,1\n20,0,100,90,0,0,2\n", default_feed=0.01, kind="path")
    assert t.format == "csv/xyzwpr"
    assert t.axis == pytest.approx(np.array([[0, 0, 1], [0, 0, 1], [0, 1, 0]]))
    assert t.reference == pytest.approx(np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0]]))
    with pytest.raises(InputError, match="--feed"):
        read(tmp_path, "0,0,100,180,0,0\n1,0,100,180,0,0\n")


def test_parquet_is_read_or_refused_clearly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "path.parquet"
    file.write_bytes(b"PAR1 and so on")
    with monkeypatch.context() as m:
        m.setitem(sys.modules, "pyarrow", None)
        with pytest.raises(InputError, match=r"\[parquet\]"):
            read_toolpath(file)
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is an optional dependency")
    parquet = pytest.importorskip("pyarrow.parquet")
    with pytest.raises(InputError, match="not readable as Parquet"):
        read_toolpath(file)
    columns = {
        "x_mm": [1.0, 2.0],
        "y_mm": [0, 0],
        "z_mm": [0.0, 0.1],
        "feed_mm_min": [None, 60.0],
        "move": ["rapid", "cut"],
    }
    parquet.write_table(pyarrow.table(columns), file)
    t = read_toolpath(file)
    assert t.position[1] == pytest.approx([0.002, 0.0, 0.0001])
    assert t.move.tolist() == [MoveKind.RAPID, MoveKind.CUT]


# ---- robot poses


def _rotation(axis: str, degrees: float) -> np.ndarray:  # type: ignore[type-arg]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


R_TCP = _rotation("z", 25.0) @ _rotation("y", -40.0) @ _rotation("x", 170.0)


def _quaternion(R: np.ndarray) -> list[float]:  # type: ignore[type-arg]
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return [w, x, y, z]


def _vector(R: np.ndarray) -> list[float]:  # type: ignore[type-arg]
    from scipy.spatial.transform import Rotation

    return [float(v) for v in Rotation.from_matrix(R).as_rotvec()]


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("a_deg,b_deg,c_deg", [25.0, -40.0, 170.0]),
        ("w_deg,p_deg,r_deg", [170.0, -40.0, 25.0]),
        ("roll_rad,pitch_rad,yaw_rad", np.radians([170.0, -40.0, 25.0]).tolist()),
        ("qw,qx,qy,qz", _quaternion(R_TCP)),
        ("q1,q2,q3,q4", _quaternion(R_TCP)),
        ("rvx_rad,rvy_rad,rvz_rad", _vector(R_TCP)),
    ],
)
def test_robot_poses_in_every_notation(tmp_path: Path, columns: str, values: list[float]) -> None:
    row = ",".join(f"{v:.12f}" for v in values)
    t = read(tmp_path, f"x_mm,y_mm,z_mm,{columns},feed_mm_min\n1,2,3,{row},600\n4,5,6,{row},600\n", kind="path")
    assert np.allclose(t.axis, -R_TCP[:, 2], atol=1e-9)
    assert np.allclose(t.reference, R_TCP[:, 0], atol=1e-9)
    assert np.allclose(t.position[0] * 1e3, [1, 2, 3])
    assert "tool axis -z" in t.meta["attitude"]


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("x_mm,y_mm,z_mm,a,b,c", "1,2,3,0,0,0", "a, b, c carry no unit; name them a_deg"),
        ("x_mm,y_mm,z_mm,rx_rad,ry_rad,rz_rad", "1,2,3,0,0,0", "rotation vector or angles"),
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz", "1,2,3,1,1,0,0", "line 2.*not of unit length"),
        ("x_mm,y_mm,z_mm,qw,qx,qy", "1,2,3,1,0,0", "qz is missing; it is required with"),
        ("x_mm,y_mm,z_mm,i,j,k,a_deg,b_deg,c_deg", "1,2,3,0,0,1,0,0,0", "expected one of them"),
        ("x_mm,y_mm,z_mm,qw,qx,qy,qz,a_deg,b_deg,c_deg", "1,2,3,1,0,0,0,0,0,0", "in two ways"),
        ("x_mm,y_mm,z_mm,feed_mm_min", "1,2,3,1e300", "not larger than 1e\\+15"),
    ],
)
def test_ambiguous_poses_are_refused(tmp_path: Path, header: str, row: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, f"{header}\n{row}\n{row}\n", default_feed=0.01)


def test_last_line_without_a_line_end_is_reported(tmp_path: Path) -> None:
    t = read(tmp_path, "x_mm,y_mm,z_mm,feed_mm_min\n1,2,3,60\n4,5,6,60", kind="path")
    assert any("last line does not end" in w for w in t.warnings)


def test_rows_are_read_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from machopt.file_formats import csv_columns

    text = "x_mm,y_mm,z_mm,feed_mm_min,operation\n" + "".join(f"{k},0,0,{60 + k},op{k // 3}\n" for k in range(10))
    whole = read(tmp_path, text, kind="path")
    monkeypatch.setattr(csv_columns, "_ROWS", 4)
    parts = read(tmp_path, text, kind="path")
    assert np.array_equal(whole.position, parts.position)
    assert np.array_equal(whole.feed, parts.feed)
    assert np.array_equal(whole.operation, parts.operation)
    assert whole.operations == parts.operations
