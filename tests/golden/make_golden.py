"""Write the golden programs: ``python tests/golden/make_golden.py`` (from the repository root).

One short job for every post: rapid moves, a drilled hole with dwell and spindle, a milled corner with rounding. Check
every change before committing it: a golden file is a program that an engineer has compared once with the controller's
manual.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from sample_robot_programs import ARM, MAPPED, TOOL, WORKPIECE, find_controller_posture  # noqa: E402

from machopt.data_types.robot_program import LIN, PTP, RobotProgram  # noqa: E402
from machopt.data_types.toolpath import MoveKind, ToolpathEvent  # noqa: E402
from machopt.programs.program_writer import format_program_name, list_post_names, write_program  # noqa: E402


def job() -> RobotProgram:
    """Return twelve moves with integer joint angles."""
    degrees = np.array(
        [
            [0, -90, 90, 0, 45, 0],
            [-10, -70, 100, 10, 40, -20],
            [-10, -68, 98, 10, 40, -20],
            [-10, -66, 96, 10, 40, -20],
            [-10, -68, 98, 10, 40, -20],
            [0, -80, 110, 0, 60, 190],
            [0, -78, 112, -5, 60, 190],
            [2, -77, 112, -5, 58, 192],
            [4, -76, 112, -5, 56, 194],
            [4, -75, 110, -6, 54, 196],
            [4, -79, 110, -6, 54, 196],
            [0, -90, 90, 0, 45, 0],
        ],
        float,
    )
    q = np.radians(degrees)
    kind = np.array([PTP, PTP, LIN, LIN, LIN, PTP, LIN, LIN, LIN, LIN, LIN, PTP], np.int8)
    move = np.array([1, 1, 2, 0, 3, 1, 0, 0, 0, 0, 3, 1], np.int8)
    feed = np.array([np.nan, np.nan, 0.02, 0.0025, 0.02, np.nan, 0.025, 0.025, 0.025, 0.0125, 0.05, np.nan])
    behind, up = find_controller_posture(ARM, q, MAPPED)  # type: ignore[misc]
    return RobotProgram(
        kind=kind,
        q=q,
        T_workpiece_tcp=np.linalg.inv(WORKPIECE) @ ARM.compute_fk(q, TOOL),
        feed=feed,
        move=move,
        cutting=(kind == LIN) & (move == MoveKind.CUT),
        operation=np.array([-1, 0, 0, 0, 0, *[1] * 6, -1], np.int32),
        operations=("Bohren ø6", 'face <1>; "fine"'),
        T_flange_tcp=TOOL,
        T_base_workpiece=WORKPIECE,
        events=(
            ToolpathEvent(1, "tool", "LOADTL/12", 12.0),
            ToolpathEvent(2, "spindle", "SPINDL/9000,RPM,CLW", 9000.0),
            ToolpathEvent(4, "dwell", "DELAY/0.5", 0.5),
            ToolpathEvent(6, "coolant", "COOLNT/ON"),
            ToolpathEvent(8, "comment", "PPRINT/look"),
            ToolpathEvent(11, "spindle", "SPINDL/OFF", 0.0),
            ToolpathEvent(11, "stop", "STOP"),
        ),
        blend=1e-4,
        source="golden cell; part.apt",
        wrist_behind=behind,
        elbow_up=up,
        time=np.arange(12) * 0.5,
        joint_names=ARM.joints,
        tool_mass=45.0,
        tool_com=np.array([0.01, 0.0, 0.15]),
        axis_acceleration=np.radians([300.0, 290.0, 300.0, 390.0, 370.0, 590.0]),
    )


def write(folder: Path, post: str) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    return write_program(folder, format_program_name("golden", post), job(), post, MAPPED)


def main() -> None:
    for post in list_post_names():
        shutil.rmtree(HERE / post, ignore_errors=True)
        for path in write(HERE / post, post):
            sys.stdout.write(f"{path.relative_to(HERE)}\n")


if __name__ == "__main__":
    main()
