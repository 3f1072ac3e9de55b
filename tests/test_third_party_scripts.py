"""Scripts of docs/examples/neighbours with programs of the posts.

RoboDK is not available here: a stand-in of a few dozen lines has only those calls that the script makes.
"""

from __future__ import annotations

import importlib.util
import json
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sample_robot_programs import ARM, TOOL, WORKPIECE

from machopt.data_types.toolpath import MoveKind
from machopt.toolpath.toolpath_reader import read_toolpath

TESTS = Path(__file__).resolve().parent
SCRIPTS = TESTS.parents[0] / "docs" / "examples" / "neighbours"
GOLDEN = TESTS / "golden"
RUN = ("robodk_station", "ros_bag", "joint_path")


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_script_is_run() -> None:
    assert {p.stem for p in SCRIPTS.glob("*.py")} == set(RUN)


@dataclass
class Item:
    """An item of a station, with its calls in order."""

    name: str = ""
    asked: list[tuple[str, Any]] = field(default_factory=list)
    moves: list[tuple[str, int, int, int, np.ndarray, None]] = field(default_factory=list)
    turned: tuple[float, ...] = (1.0,) * 6  # sign convention of its axes

    def Valid(self) -> bool:
        return self.name != "gone"

    def Parent(self) -> Item:
        return Item("base")

    def SolveFK(self, joints: list[float]) -> np.ndarray:
        T = ARM.compute_fk(np.radians(np.array(joints) * self.turned))
        flange = np.diag([1.0, -1.0, -1.0, 1.0])  # another flange convention, as makers have
        return np.asarray(np.vstack([np.hstack([T[:3, :3], 1e3 * T[:3, 3:]]), [0, 0, 0, 1]]) @ flange)

    def AddTool(self, pose: np.ndarray, name: str) -> Item:
        self.asked.append(("AddTool", pose))
        return Item(name)

    def InstructionCount(self) -> int:
        return len(self.moves)

    def Instruction(self, k: int) -> tuple[str, int, int, int, np.ndarray, None]:
        return self.moves[k]

    def __getattr__(self, call: str) -> Any:
        known = (
            "setPose setPoseFrame setPoseTool RunInstruction setSpeed setRounding setAsJointTarget setJoints MoveJ "
            "MoveL ShowTargets"
        )
        if call not in known.split():
            raise AttributeError(call)
        return lambda *given: self.asked.append((call, *given))


@dataclass
class Station:
    robot: Item = field(default_factory=lambda: Item("KR"))
    program: Item = field(default_factory=lambda: Item("part"))
    targets: list[Item] = field(default_factory=list)
    frame: Item = field(default_factory=lambda: Item("frame"))

    def Item(self, name: str, kind: int) -> Item:
        return Item("gone") if name == "gone" else self.robot if kind == 2 else self.program

    def AddFrame(self, name: str, parent: Item) -> Item:
        assert parent.name == "base"
        return self.frame

    def AddProgram(self, name: str, robot: Item) -> Item:
        return self.program

    def AddTarget(self, name: str, frame: Item, robot: Item) -> Item:
        self.targets.append(Item(name))
        return self.targets[-1]


def test_plan_is_imported_into_a_station() -> None:
    station, push = Station(), script("robodk_station").push
    push(station, np.array, GOLDEN / "json" / "golden.json")
    message = json.loads((GOLDEN / "json" / "golden.json").read_text())
    moves = [m for m in message["moves"] if m["item"] in ("ptp", "lin")]
    assert [t.asked[-1] for t in station.targets] == [("setJoints", m["q_deg"]) for m in moves]
    assert all(t.asked[0] == ("setAsJointTarget",) for t in station.targets)
    order = [call for call, *_ in station.program.asked if call in ("MoveJ", "MoveL")]
    assert order == [{"ptp": "MoveJ", "lin": "MoveL"}[m["item"]] for m in moves]
    speeds = [v for call, *v in station.program.asked if call == "setSpeed"]
    assert speeds[0] == [moves[2]["feed_mm_min"] / 60]
    comments = [v[0] for call, *v in station.program.asked if call == "RunInstruction"]
    assert "operation: Bohren ø6" in comments
    assert "CAM: COOLNT/ON" in comments
    ((_, placed),) = station.frame.asked
    np.testing.assert_allclose(placed[:3, 3], 1e3 * WORKPIECE[:3, 3], atol=1e-5)
    # in the flange frame of the station, which has another orientation than that of the plan
    ((_, tool),) = station.robot.asked
    np.testing.assert_allclose(tool[:3, 3], 1e3 * TOOL[:3, 3] * [1, -1, -1], atol=1e-5)


def test_robot_with_other_joint_conventions_is_refused_or_reported() -> None:
    push = script("robodk_station").push
    backwards = (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    station = Station(robot=Item("KR", turned=backwards))
    with pytest.raises(SystemExit, match="is not the plan's: at the plan's joints its flange is off by"):
        push(station, np.array, GOLDEN / "json" / "golden.json")
    assert not station.targets
    push(station, np.array, GOLDEN / "json" / "golden.json", sign=backwards)
    assert station.targets[1].asked[-1][1][0] == 10.0
    with pytest.raises(SystemExit, match="has no robot 'gone'"):
        push(station, np.array, GOLDEN / "json" / "golden.json", "gone")


def test_program_of_a_station_is_read_as_a_toolpath(tmp_path: Path) -> None:
    pull = script("robodk_station").pull
    down = np.diag([1.0, -1.0, -1.0, 1.0])

    def at(x: float, z: float) -> np.ndarray:
        T = down.copy()
        T[:3, 3] = x, 0.0, z
        return T

    moves = [("Home", 0, 1, 1, at(0, 50), None), ("Set speed", 2, 0, 0, down, None)]
    moves += [("Down", 0, 2, 0, at(0, 0), None), ("Along", 0, 2, 0, at(80, 0), None)]
    station = Station(program=Item("Main", moves=moves))
    assert pull(station, "Main", tmp_path / "part.csv") == 3
    path = read_toolpath(tmp_path / "part.csv", default_feed=0.01)
    np.testing.assert_allclose(path.position, [[0, 0, 0.05], [0, 0, 0], [0.08, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(path.axis, [[0, 0, 1]] * 3, atol=1e-9)
    assert path.move.tolist() == [MoveKind.RAPID, MoveKind.CUT, MoveKind.CUT]
    station.program.moves.append(("Arc", 1, 3, 0, down, None))
    with pytest.raises(SystemExit, match="is an arc"):
        pull(station, "Main", tmp_path / "part.csv")


def test_bag_message_equals_the_json() -> None:
    document = json.loads((GOLDEN / "ros_json" / "golden.json").read_text())

    class Types(dict):  # type: ignore[type-arg]
        def __missing__(self, name: str) -> Any:
            return lambda **given: SimpleNamespace(kind=name, **given)

    message = script("ros_bag").message(document, Types(), np.array)
    assert message.kind == "trajectory_msgs/msg/JointTrajectory"
    assert message.joint_names == document["joint_names"]
    np.testing.assert_array_equal([p.positions for p in message.points], [p["positions"] for p in document["points"]])
    last = message.points[-1].time_from_start
    assert {"sec": last.sec, "nanosec": last.nanosec} == document["points"][-1]["time_from_start"]


def test_joint_path_is_read_by_a_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    module, file = script("joint_path"), GOLDEN / "compas_fab" / "golden.json"
    names, times, positions = module.joint_path(file)
    assert names == ["a1", "a2", "a3", "a4", "a5", "a6"]
    assert (np.diff(times) > 0).all()
    ros = json.loads((GOLDEN / "ros_json" / "golden.json").read_text())
    assert positions == [p["positions"] for p in ros["points"]]
    module.main([str(file)])
    assert "12 points over" in capsys.readouterr().out
