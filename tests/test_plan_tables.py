"""Tables and output folders: round trip; no partial output; foreign files are not overwritten."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from independent_trajectory_reader import read_trajectory_csv

from machopt.data_types.documents.table_rows import PointsTableRow, TrajectoryTableRow
from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.process_columns import ERROR_NAMES, ProcessColumns
from machopt.data_types.trajectory import Trajectory
from machopt.errors import InputError
from machopt.output import write_json
from machopt.output.tables.plan_tables import write_compensation_csv, write_points_csv, write_trajectory_csv


def smooth_motion(samples: int, external: int = 0, dt: float = 0.012) -> Trajectory:
    t = dt * np.arange(samples)
    phase = np.arange(6 + external)
    joints = 0.8 * np.sin(0.5 * t[:, None] + phase)
    point = np.clip(t * 3.0 - 1.0, 0.0, None)
    point[:5] = np.nan
    return Trajectory(
        time=t,
        q=joints[:, :6],
        external=joints[:, 6:],
        point=point,
        move=(np.arange(samples) % 5).astype(np.int8),
        operation=np.where(np.arange(samples) < 5, -1, np.arange(samples) // 20 % 2).astype(np.int32),
        gamma=np.where(np.arange(samples) < 5, np.nan, 0.3 * np.cos(t)),
        feed=np.abs(0.02 * np.sin(t)),
    )


def points_table(n: int) -> PointsTable:
    nan = np.full(n, np.nan)
    axis = np.tile([0.0, 0.0, 1.0], (n, 1))
    return PointsTable(
        position=np.linspace(0, 1, 3 * n).reshape(n, 3),
        axis=axis,
        move=np.zeros(n, np.int8),
        operation=np.zeros(n, np.int32),
        operations=('side, "rough"',),
        gamma=np.full(n, 0.5),
        branch=np.where(np.arange(n) == 1, -1, 3).astype(np.int8),
        q=np.full((n, 6), 0.1),
        external=np.empty((n, 0)),
        external_prismatic=(),
        k_axial=np.full(n, 1.5e6),
        k_normal=np.full(n, 4e5),
        deflection=np.full(n, 1e-4),
        clearance=nan,
        limit_margin=np.full(n, 0.2),
        singularity=np.full(n, 0.4),
        status=("ok",) * n,
        reason=("", "joint 3, 4.2° beyond", *("",) * (n - 2)),
        feed=np.full(n, 0.01),
        k_jiao_x=np.full(n, 1.2e6),
    )


def process_columns(n: int) -> ProcessColumns:
    numbers = ("moment", "peak_force", "ae", "ap", "entry_angle", "exit_angle", "tolerance", "p_in", "f1", "feed_max")
    errors = {name: np.full(n, 1e-4) for name in ERROR_NAMES}
    return ProcessColumns(
        force=np.ones((n, 3)),
        errors=errors,
        lower=errors,
        upper=errors,
        p_in_deflection_only=np.full(n, np.nan),
        depth_limit=np.full(n, 0.01),
        outcome=("pass",) * n,
        cause=("joint:2 0.61",) * n,
        chatter=("stable",) * n,
        **{name: np.ones(n) for name in numbers},
    )


@pytest.mark.parametrize("prismatic", [(), (True,), (False, True)])
def test_trajectory_is_read_back_unchanged(tmp_path: Path, prismatic: tuple[bool, ...]) -> None:
    t = smooth_motion(200, external=len(prismatic))
    labels = ("drill, ø6", 'face "A"')
    write_trajectory_csv(tmp_path / "t.csv", t, labels, prismatic)
    table = read_trajectory_csv(tmp_path / "t.csv")
    back = table.trajectory
    assert table.operations == labels
    assert table.external_prismatic == prismatic
    np.testing.assert_array_equal(back.move, t.move)
    np.testing.assert_array_equal(back.operation, t.operation)
    # half a unit of the last printed decimal
    np.testing.assert_allclose(np.degrees(back.q), np.degrees(t.q), atol=0.51e-9, rtol=0)
    np.testing.assert_allclose(back.external, t.external, atol=1e-11, rtol=0)
    np.testing.assert_allclose(back.point, t.point, atol=0.51e-6, rtol=0)
    np.testing.assert_allclose(back.gamma, t.gamma, atol=1e-8, rtol=0)
    np.testing.assert_allclose(back.feed * 6e4, t.feed * 6e4, atol=0.51e-3, rtol=0)
    np.testing.assert_allclose(np.diff(back.time), 0.012, atol=1e-13, rtol=0)


def test_columns_are_those_of_the_contract(tmp_path: Path) -> None:
    write_trajectory_csv(tmp_path / "t.csv", smooth_motion(10, external=2), ("a", "b"), (True, False))
    write_points_csv(tmp_path / "p.csv", points_table(3))
    q = ",".join(f"q{i}_deg" for i in range(1, 7))
    head, *rows = (tmp_path / "t.csv").read_text().splitlines()
    assert head == f"time_s,point,operation,move,{q},e1_mm,e2_deg,gamma_deg,feed_mm_min"
    assert rows[0].startswith("0.000,,,cut,0.000000000,")
    head, *rows = (tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()
    assert head.startswith(
        f"point,operation,move,x_mm,y_mm,z_mm,i,j,k,gamma_deg,branch,{q},k_axial_N_mm,k_normal_N_mm,deflection_mm,"
        "clearance_mm,limit_margin_deg,singularity,status,reason"
    )
    assert rows[0].startswith('0,"side, ""rough""",cut,0.000000,125.000000,250.000000,0.000000000,')
    assert '"joint 3, 4.2° beyond"' in rows[1]
    assert ",1500.0000,400.0000,0.1000000,," in rows[0]


def test_additional_columns_are_last_and_only_where_needed(tmp_path: Path) -> None:
    table = replace(
        points_table(3),
        deflection_std=np.array([1e-6, np.nan, 2e-6]),
        k_axial_std=np.full(3, 1e4),
        compensation=np.array([[1e-4, -2e-4, 0.0]] * 3),
    )
    write_points_csv(tmp_path / "p.csv", table)
    head, first, second, _ = (tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()
    assert head.endswith("k_jiao_x_N_mm,deflection_std_mm,k_axial_std_N_mm,comp_dx_mm,comp_dy_mm,comp_dz_mm")
    assert first.endswith(",0.0010000,10.0000,0.100000,-0.200000,0.000000")
    assert second.endswith(",,10.0000,0.100000,-0.200000,0.000000")
    write_compensation_csv(tmp_path / "c.csv", np.array([0.0, 0.5]), np.full((2, 3), 1e-4), np.full((2, 3), 12.5))
    assert (tmp_path / "c.csv").read_text().splitlines() == [
        "point,dx_mm,dy_mm,dz_mm,fx_N,fy_N,fz_N",
        "0.000000000,0.100000,0.100000,0.100000,12.500000,12.500000,12.500000",
        "0.500000000,0.100000,0.100000,0.100000,12.500000,12.500000,12.500000",
    ]


@pytest.mark.parametrize("prismatic", [(), (True, False, True)])
def test_tables_agree_with_their_published_schema(tmp_path: Path, prismatic: tuple[bool, ...]) -> None:
    """Every written column is described, in the same order, and every row matches the schema."""
    n, E = 4, len(prismatic)
    table = replace(
        points_table(n),
        external=np.full((n, E), 0.1),
        external_prismatic=prismatic,
        nearest_pair=("",) * n,
        in_grid=np.arange(n) > 1,
        deflection_std=np.full(n, np.nan),
        k_axial_std=np.full(n, 1e4),
        dwell=np.zeros(n),
        compensation=np.zeros((n, 3)),
        lead=np.zeros(n),
        side=np.full(n, np.nan),
        process=process_columns(n),
        feed_advised=np.full(n, 0.02),
    )
    write_points_csv(tmp_path / "points.csv", table)
    motion = replace(smooth_motion(n, E), lead=np.zeros(n), side=np.full(n, np.nan))
    write_trajectory_csv(tmp_path / "motion.csv", motion, ["a"], prismatic, ["mill"])
    observed: set[str] = set()
    for file, model in (("points.csv", PointsTableRow), ("motion.csv", TrajectoryTableRow)):
        with (tmp_path / file).open(encoding="utf-8", newline="") as text:
            for given in csv.DictReader(text):
                words = {
                    n for n, f in model.model_fields.items() if f.annotation is str or n in ("move", "stiffness_from")
                }
                row = {k: v if k in words else (json.loads(v) if v else None) for k, v in given.items()}
                model.model_validate(row)
                assert list(row) == [name for name in model.model_fields if name in row]
                observed |= {name for name in row if model is PointsTableRow}
    optional = {f"e{k}_{unit}" for k in (1, 2, 3) for unit in ("mm", "deg")}
    assert set(PointsTableRow.model_fields) - observed == optional - {
        f"e{k + 1}_{'mm' if p else 'deg'}" for k, p in enumerate(prismatic)
    }


def test_third_differences_survive_the_rounding(tmp_path: Path) -> None:
    """The jerk from third differences of the file agrees
    with the exact motion far better than any jerk limit requires."""
    t = smooth_motion(500)
    write_trajectory_csv(tmp_path / "t.csv", t, ("a", "b"))
    back = read_trajectory_csv(tmp_path / "t.csv").trajectory
    exact, printed = (np.degrees(np.diff(q, n=3, axis=0)) / 0.012**3 for q in (t.q, back.q))
    assert np.abs(printed - exact).max() < 8 * 0.51e-9 / 0.012**3  # 2.4e-3 deg/s³; coefficients 1 3 3 1


def test_unusual_sample_time_gets_more_decimals(tmp_path: Path) -> None:
    t = smooth_motion(50, dt=1 / 240)
    write_trajectory_csv(tmp_path / "t.csv", t, ("a", "b"))
    np.testing.assert_allclose(read_trajectory_csv(tmp_path / "t.csv").trajectory.time, t.time, atol=1e-9, rtol=0)


def test_writing_is_deterministic(tmp_path: Path) -> None:
    t = smooth_motion(50_000)
    write_trajectory_csv(tmp_path / "a.csv", t, ("a", "b"))
    write_trajectory_csv(tmp_path / "b.csv", t, ("a", "b"))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert "-0.000000000" not in (tmp_path / "a.csv").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.replace("q3_deg", "q3"), r"header: column q3_deg is missing"),
        (lambda s: s.replace("\n", ",1\n").replace("mm_min,1", "mm_min,colour"), "header: column colour is unknown"),
        (lambda s: s.replace("0.012,", "abc,", 1), "line 3, column time_s: found 'abc'"),
        (lambda s: s.replace("0.012,", "nan,", 1), "line 3, column time_s: found 'nan'"),
        (lambda s: s.replace("0.024,", "0.012,", 1), "line 4, column time_s: time does not rise"),
        (lambda s: s.replace("rapid", "jump", 1), "line 3, column move: found 'jump', expected one of"),
        (lambda s: s.replace(",cut", ",cut,1", 1), "line 2: found 13 fields, expected 12"),
        (lambda s: s.split("\n")[0], "found no rows"),
    ],
)
def test_broken_file_is_refused_with_its_place(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "t.csv"
    write_trajectory_csv(file, smooth_motion(20), ("a", "b"))
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=message):
        read_trajectory_csv(file)


def test_bom_crlf_and_comments_are_accepted(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    write_trajectory_csv(file, smooth_motion(20), ("a", "b"))
    plain = read_trajectory_csv(file).trajectory
    text = "\ufeff# made by hand\n" + file.read_text()
    file.write_bytes(text.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(read_trajectory_csv(file).trajectory.q, plain.q)


def test_external_axis_without_a_kind_is_an_internal_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="1 external axes but 0"):
        write_trajectory_csv(tmp_path / "t.csv", smooth_motion(5, external=1), ("a", "b"))
    with pytest.raises(ValueError, match="external axes"):
        write_points_csv(tmp_path / "p.csv", replace(points_table(3), external=np.zeros((3, 1))))


def test_json_refuses_unrepresentable_values(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="set has no JSON form"):
        write_json(tmp_path / "x.json", {"a": {1, 2}})
