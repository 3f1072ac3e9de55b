"""Sample data of an optimize report."""

from __future__ import annotations

import numpy as np

from machopt.data_types.toolpath import IgnoredWord, ToolpathEvent
from machopt.report.page_types.optimize_page_data import (
    CheckRow,
    ExcludedPairRow,
    FeedDipRow,
    GainOverBaseline,
    InfeasiblePointRow,
    MotionSeries,
    OperationRow,
    PathSeries,
    ProgramRow,
    ReportData,
    ResultSummary,
    RotationMap,
    WorstPointRow,
)

JOINTS = ("a1", "a2", "a3", "a4", "a5", "a6")


def full_result(points: int = 800, rotations: int = 72, samples: int = 20_000) -> ReportData:
    rng = np.random.default_rng(4)
    u = np.linspace(0, 1, points)
    s = 3.2 * u
    grid = np.radians(np.linspace(-180, 175, rotations))
    gamma = 0.9 * np.sin(5 * u) + 0.4
    index = 9.4e-5 * (1.0 + 0.2 * np.sin(7 * u))[:, None] * (1 + 0.9 * np.sin((grid - gamma[:, None]) / 2) ** 2)
    status = np.full(index.shape, 7, np.uint8)
    near = np.abs(np.angle(np.exp(1j * (grid - gamma[:, None])))) < 0.5
    status[near] = 0
    G, U = np.broadcast_arrays(grid, u[:, None])
    status[2.5 + 0.3 * np.sin(6 * U) < G] = 1
    status[G < -2.6] = 2
    status[np.abs(G + 1.6 - 0.6 * np.sin(4 * U)) < 0.12] = 3
    status[(G > 1.7) & (G < 2.1) & (U > 0.35) & (U < 0.6)] = 4
    status[(G < -2.0) & (G > -2.6) & (U > 0.8)] = 5
    status[(G > 1.5) & (U > 0.72) & (U < 0.85)] = 6
    index[(status != 0) & (status != 7)] = np.nan
    nan, nan_ = np.full(points, np.nan), float("nan")
    chosen = 9.0e-5 * (1 + 0.2 * np.sin(7 * u))
    operation = np.minimum((u * 4).astype(np.int32), 3)
    labels = ("face rough", "slot", "contour finish", "drill d6")
    clearance = 0.035 + 0.02 * np.sin(9 * u) + 0.002 * rng.normal(size=points)
    path = PathSeries(
        s=s,
        operation=operation,
        cutting=np.ones(points, bool),
        index_default=np.where((u > 0.4) & (u < 0.5), np.nan, 1.4e-4 * (1 + 0.3 * np.sin(7 * u))),
        index_jiao2022=1.05e-4 * (1 + 0.25 * np.sin(7 * u + 0.3)),
        index_chosen=chosen,
        k_axial=1.6e6 * (1 + 0.2 * np.cos(5 * u)),
        k_normal=7e5 * (1 + 0.1 * np.cos(8 * u)),
        k_jiao2022=2.9e6 * (1 + 0.15 * np.cos(5 * u)),
        deflection=chosen,
        tolerance=np.where(operation == 2, 1.0e-4, nan),
        clearance=clearance,
        nearest_pair=tuple("link5 – fixture" if c < 0.03 else "spindle – workpiece" for c in clearance),
        singularity=np.radians(20 + 10 * np.sin(6 * u)),
        limit_margin=np.radians(35 + 20 * np.cos(3 * u)),
        phi=gamma,
        gamma=gamma + 0.2,
    )
    return ReportData(
        title="Drilling cell KR240: bracket_op10",
        cell="KR240 drilling cell",
        toolpath="bracket_op10.aptsource",
        version="0.1.0",
        summary=ResultSummary(
            outcome="done",
            verification="passed",
            quantity="deflection",
            worst_default=1.82e-4,
            worst_jiao2022=1.31e-4,
            worst_chosen=1.08e-4,
            mean_default=1.4e-4,
            mean_chosen=9.0e-5,
            gains=(
                GainOverBaseline("the CAM's default rotation", 0.36, 0.06, (0.26, 0.46)),
                GainOverBaseline("Jiao 2022", 0.14),
            ),
            feed_held=0.991,
            cycle_time=240.0,
            cutting_time=188.0,
            path_length=3.2,
            points=points,
            nearest_miss=0.0124,
            nearest_pair="link5 – fixture",
            nearest_point=211,
        ),
        hashes=(("cell.yaml", "3f" * 32), ("bracket_op10.aptsource", "a1" * 32)),
        options=(("index", "deflection"), ("rotation step", "5 deg"), ("sample", "12 ms"), ("seed", "0")),
        map=RotationMap(
            s=s,
            point=np.arange(points),
            rotation=grid,
            index=index,
            status=status,
            chosen=gamma,
            jiao2022=gamma + 0.3 + 0.1 * np.sin(20 * u),
            cam_default=np.where((u > 0.4) & (u < 0.5), np.nan, 0.0),
            offset=0.2 + 0.0 * u,
        ),
        path=path,
        motion=_motion(samples, s),
        dips=(
            FeedDipRow(
                point=311.4,
                s=1.24,
                time=35.8,
                duration=0.42,
                feed_programmed=0.02,
                feed_lowest=0.0112,
                cause="a4 acceleration",
            ),
            FeedDipRow(
                point=655.0, s=2.61, time=150.7, duration=1.1, feed_programmed=0.02, feed_lowest=0.0163, cause="a6 jerk"
            ),
        ),
        worst=tuple(
            WorstPointRow(
                point=p,
                operation="slot",
                value=1.08e-4 - k * 1e-7,
                value_default=1.82e-4,
                gamma=0.6,
                phi=0.4,
                deflection=1.08e-4,
                tolerance=np.nan,
                k_axial=1.5e6,
                clearance=0.03,
                reason="arm stretched; joint 2 carries 61 % of the deflection",
            )
            for k, p in enumerate((180, 181, 182, 640, 12))
        ),
        operations=tuple(
            OperationRow(
                label=label,
                kind="point" if "drill" in label else "trajectory",
                points=points // 4,
                length=0.8,
                time=47.0,
                worst_default=1.8e-4,
                worst_chosen=1.05e-4,
                nearest_miss=0.0124,
                feed_held=0.99,
            )
            for label in labels
        ),
        ignored=(IgnoredWord("PPRINT", 14, 3, True), IgnoredWord("GOFWDX", 1, 812, False)),
        warnings=("line 211: arc direction disagrees with the tangent before it; the tangent was followed",),
        excluded_pairs=(ExcludedPairRow("link2", "link3", "neighbours touch at the joint"),),
        checks=(
            CheckRow("TCP follows the toolpath", True, "3.1 µm", "15 µm", "t = 71.244 s"),
            CheckRow("joint velocity", True, "96.8 %", "100 %", "a4, t = 71.3 s"),
            CheckRow("collision between samples", None, "", "", "no meshes"),
        ),
        programs=(
            ProgramRow(
                post="krl",
                files=("krl/bracket_op10.src", "krl/bracket_op10.dat"),
                lines=1210,
                added=3,
                tolerance=5e-5,
                moves=812,
                position_error=2.1e-8,
                angle_error=2.4e-7,
                joint_error=nan_,
                feed_error=9e-8,
                path_error=1.6e-5,
                axis_error=1.2e-4,
                turn_error=8e-4,
                configuration_equal=True,
            ),
            ProgramRow(
                post="jbi",
                files=("jbi/BRACKET.JBI",),
                lines=1650,
                added=3,
                tolerance=5e-5,
                moves=812,
                position_error=2.6e-6,
                angle_error=8e-6,
                joint_error=8e-6,
                feed_error=8e-7,
                path_error=1.8e-5,
                axis_error=1.4e-4,
                turn_error=9e-4,
            ),
            ProgramRow(
                post="ros_json",
                files=("ros_json/bracket_op10.json",),
                lines=20100,
                added=0,
                tolerance=5e-5,
                moves=20000,
                position_error=1e-9,
                angle_error=1e-9,
                joint_error=1e-9,
            ),
            ProgramRow(
                post="mine.toml", files=("mine/bracket_op10.own",), lines=900, added=3, tolerance=5e-5, checked=False
            ),
        ),
        timings=(("read", 0.21), ("candidates", 0.12), ("score", 0.2), ("choose", 0.31), ("smooth", 0.4)),
        events=(ToolpathEvent(0, "spindle", "SPINDL/9000,RPM,CLW", 9000.0), ToolpathEvent(200, "coolant", "COOLNT/ON")),
    )


def infeasible_result() -> ReportData:
    """Return an infeasible result (exit code 3) with only the points without a solution."""
    nan = float("nan")
    return ReportData(
        title="Part out of reach",
        cell="KR240 drilling cell",
        toolpath="far.csv",
        version="0.1.0",
        summary=ResultSummary(
            outcome="infeasible",
            verification="not run",
            quantity="deflection",
            worst_default=nan,
            worst_jiao2022=nan,
            worst_chosen=nan,
            mean_default=nan,
            mean_chosen=nan,
            points=40,
            infeasible_points=2,
        ),
        infeasible=(
            InfeasiblePointRow(
                point=7,
                operation="hole <3>",
                position=np.array([2.9, 0.1, 0.4]),
                status="unreachable",
                reason="no inverse solution",
                shortfall="38 mm out",
            ),
            InfeasiblePointRow(
                point=8,
                operation="hole <3>",
                position=np.array([2.9, 0.2, 0.4]),
                status="joint limit",
                reason="axis 5 at 128°",
                shortfall="3.1° beyond",
            ),
        ),
    )


def _motion(samples: int, s: np.ndarray) -> MotionSeries:
    t = 0.012 * np.arange(samples)
    w = 2 * np.pi * t / max(t[-1], 1.0)
    j = np.arange(6)
    cutting = (np.sin(6 * w) > -0.8) & (w > 0.2) & (w < 6.0)
    dip = np.exp(-(((t - 0.15 * t[-1]) / 0.4) ** 2))
    return MotionSeries(
        time=t,
        s=np.where(cutting, s[-1] * t / max(t[-1], 1.0), np.nan),
        q=np.radians(60) * np.sin(w[:, None] * (1 + j / 3) + j),
        velocity_ratio=np.abs(0.5 * np.cos(w[:, None] * (1 + j / 3) + j)),
        acceleration_ratio=np.abs(0.7 * np.cos(w[:, None] * (9 + j) + j)),
        jerk_ratio=np.abs(0.9 * np.cos(w[:, None] * (25 + j) + j)),
        joint_names=JOINTS,
        prismatic=(False,) * 6,
        lower=np.radians([-185, -140, -120, -350, -122.5, -350]),
        upper=np.radians([185, -5, 155, 350, 122.5, 350]),
        feed_programmed=np.where(cutting, 0.02, np.nan),
        feed_actual=0.02 - 0.009 * dip,
        cutting=cutting,
    )
