"""Every post: path → CSV → program → independent reader → CSV."""

from __future__ import annotations

import math
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from property_example_count import NIGHTLY, scale_example_count
from sample_robot_programs import ARM, MAPPED, PLAIN, ROOT, TOOL, WORKPIECE, Recipe, program

from machopt.data_types.robot_program import LIN, RobotController, RobotProgram
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.file_formats.source_file import ReadOptions
from machopt.numerics.rigid_transforms import compute_tool_rotation
from machopt.programs.program_reader import ProgramRobot, read_program, read_program_as_toolpath
from machopt.programs.program_writer import format_program_name, has_sampled_output, list_post_names, write_program
from machopt.programs.reading.joint_conversion import compute_urdf_joints
from machopt.programs.reading.parsed_program import ParsedProgram
from machopt.toolpath.toolpath_reader import read_toolpath

MAIN = {
    "rapid": "{}.mod",
    "fanuc": "{}.ls",
    "fanuc_joint": "{}.ls",
    "val3": "{0}/{0}.pjx",
    "jbi": "{}.JBI",
    "jbi_rectan": "{}.JBI",
    "csv": "{}.csv",
    "json": "{}.json",
    "ros_yaml": "{}.yaml",
    "ros_json": "{}.json",
    "compas_fab": "{}.json",
}
JOINTS_ONLY = ("fanuc_joint", "jbi", "ros_yaml", "ros_json", "compas_fab", "urscript_servoj")
NO_MAP = ("csv", "json", "ros_yaml", "ros_json", "compas_fab")
TIMED = ("ros_yaml", "ros_json", "compas_fab", "urscript_servoj")  # these have times instead of feeds
# half of the last printed decimal: mm; axis angle in deg; orientation in deg: three such angles may add up, and a
# quaternion of four numbers printed to e rotates by 4 e rad at most
POSITION_MM = {"csv": 0.5e-6, "json": 0.5e-6}
AXIS_DEG = {
    "csv": 0.5e-9,
    "json": 0.5e-9,
    "ros_yaml": 3e-9,
    "ros_json": 3e-9,
    "compas_fab": 3e-9,
    "urscript": 3e-7,
    "jbi": 0.5e-4,
}
TURN_DEG = {"rapid": 1.0e-6, "urscript": 1.2e-6, "jbi_rectan": 1.5e-4, "csv": 2e-7, "json": 2e-7}


def main_file(post: str, name: str) -> str:
    return MAIN.get(post, "{}.src" if post.startswith("krl") else "{}.script").format(name)


def tolerance(table: dict[str, float], post: str, other: float) -> float:
    return table.get(post, table.get(post.split("_", maxsplit=1)[0], other))


def write_post(folder: Path, p: RobotProgram, post: str, controller: RobotController) -> Path:
    name = format_program_name("part", post)
    write_program(folder, name, p, post, controller)
    return folder / main_file(post, name)


def urdf_q(parsed: ParsedProgram, post: str, controller: RobotController) -> np.ndarray:
    if post in NO_MAP or controller.joint_map is None:
        return np.radians(parsed.axes_deg)
    m = controller.joint_map
    return compute_urdf_joints(parsed.axes_deg, m.sign, m.offset_deg, m.coupling)


def load_known_robot(controller: RobotController) -> ProgramRobot:
    """The robot, for reading a program with a known model."""
    return ProgramRobot(ARM.compute_fk, controller, TOOL, WORKPIECE)


def compute_angle(R0: np.ndarray, R1: np.ndarray) -> float:
    """Return the largest angle in degrees between rotations; exact for small angles."""
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(R0 - R1, axis=(-2, -1)).max() / math.sqrt(8))))


def check(p: RobotProgram, parsed: ParsedProgram, post: str, controller: RobotController) -> None:
    """Check moves in order with targets, feeds, kinds, operations and events, within the printed decimals."""
    assert len(parsed) == len(p)
    np.testing.assert_array_equal(parsed.kind, p.kind)
    lin = p.kind == LIN
    np.testing.assert_array_equal(parsed.move[lin], p.moves[lin])
    joint = ~parsed.has_pose | (post in ("csv", "json"))
    q = urdf_q(parsed, post, controller)
    axis = tolerance(AXIS_DEG, post, 0.5e-5)
    np.testing.assert_allclose(
        np.degrees(q[joint]), np.degrees(p.q[joint]), rtol=0, atol=2.01 * axis
    )  # a coupled axis has two errors
    T = np.linalg.inv(WORKPIECE) @ ARM.compute_fk(q[joint], TOOL)
    # six joints, each with an error of the last decimal, at most 4 m away from the tool tip
    np.testing.assert_allclose(
        T[:, :3, 3], p.T_workpiece_tcp[joint][:, :3, 3], rtol=0, atol=6 * 2.01 * np.radians(axis) * 4 + 1e-12
    )
    pose = parsed.has_pose
    position = tolerance(POSITION_MM, post, 0.5e-4) * 1.001
    np.testing.assert_allclose(
        parsed.T_base_tcp[pose][:, :3, 3] * 1e3, p.T_workpiece_tcp[pose][:, :3, 3] * 1e3, rtol=0, atol=position
    )
    if pose.any():
        assert compute_angle(parsed.T_base_tcp[pose][:, :3, :3], p.T_workpiece_tcp[pose][:, :3, :3]) < tolerance(
            TURN_DEG, post, 1.5e-5
        )
    steps = 0.5e-4 * 1.001 if post in ("fanuc", "fanuc_joint", "jbi", "jbi_rectan") else 0.51e-6
    if post not in TIMED:
        np.testing.assert_allclose(parsed.feed[lin], p.feed[lin], rtol=0, atol=steps)
    if np.isfinite(parsed.time).any():
        np.testing.assert_allclose(parsed.time, p.time, rtol=0, atol=1e-9)
    labels = [p.operations[o] for o in p.operation]
    assert [parsed.operations[o] for o in parsed.operation] == labels
    assert [(e.index, e.text) for e in parsed.events] == [(e.index, e.text) for e in p.events]
    values = [e.kind for e in p.events if e.kind != "stop"]
    assert [e.kind for e in parsed.events if e.kind != "stop"] == values
    root = np.eye(4) if controller.T_base_root is None else controller.T_base_root
    mount = np.eye(4) if controller.T_flange_mount is None else controller.T_flange_mount
    if post in NO_MAP:
        root = mount = np.eye(4)
    used = [parsed.bases[b] for b in set(parsed.base[pose].tolist())]
    frames = [(f, np.linalg.inv(root) @ WORKPIECE) for f in used] + [
        (f, np.linalg.inv(mount) @ TOOL) for f in parsed.tools
    ]
    for frame, expected in frames:
        if frame.T is not None:
            np.testing.assert_allclose(frame.T[:3, 3], expected[:3, 3], rtol=0, atol=1.01e-7)
            assert compute_angle(frame.T[:3, :3], expected[:3, :3]) < 1.5e-5


@pytest.mark.parametrize("controller", [PLAIN, MAPPED], ids=["plain", "mapped"])
@pytest.mark.parametrize("post", list_post_names())
def test_program_is_read_back(tmp_path: Path, post: str, controller: RobotController) -> None:
    for seed in range(3):
        p = program(Recipe(seed, moves=30, blend=2e-4 * (seed % 2)), controller)
        check(p, read_program(write_post(tmp_path, p, post, controller)), post, controller)


@pytest.mark.parametrize(
    "post", [p for p in list_post_names() if not has_sampled_output(p) and p not in ("csv", "json")]
)
def test_long_program_is_split_and_read_back(tmp_path: Path, post: str) -> None:
    controller = replace(MAPPED, moves_per_part=17)
    p = program(Recipe(5, moves=60, blend=1e-4), controller)
    file = write_post(tmp_path, p, post, controller)
    parsed = read_program(file)
    check(p, parsed, post, controller)
    if not post.startswith(("krl", "urscript")):
        assert len(list(file.parent.iterdir())) >= 4  # the parts are separate files
    ends = np.flatnonzero(p.kind == LIN)
    exact = np.isfinite(parsed.blend)
    assert not (parsed.blend[16::17][exact[16::17]] > 0).any()  # no blending across the end of a part
    assert len(ends)


@pytest.mark.parametrize("post", ["krl", "rapid", "urscript", "val3", "csv"])
def test_corners_are_rounded_only_inside_a_cut_without_overlap(tmp_path: Path, post: str) -> None:
    p = program(Recipe(8, moves=60, blend=5e-3))
    parsed = read_program(write_post(tmp_path, p, post, PLAIN))
    stops = {e.index - 1 for e in p.events}
    for k in range(60):
        inside = (
            k + 1 < 60 and p.cutting[k] and p.cutting[k + 1] and p.operation[k] == p.operation[k + 1] and k not in stops
        )
        if inside:
            a, b = np.diff(p.T_workpiece_tcp[k - 1 : k + 2, :3, 3], axis=0)
            turn = np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
            inside = turn < np.radians(120)
            passed = parsed.blend[k] * np.tan(turn / 4)  # deviation of a blend arc of that size from its point
            assert passed <= 5e-3 + 1e-9
        assert (parsed.blend[k] > 0) == bool(inside), k
    if post in ("urscript", "csv"):
        step = np.linalg.norm(np.diff(p.T_workpiece_tcp[:, :3, 3], axis=0), axis=1)
        both = parsed.blend[:-1] + parsed.blend[1:]
        assert (both <= step + 1e-9)[(parsed.blend[:-1] > 0) | (parsed.blend[1:] > 0)].all()


def test_configuration_bits_and_turns_follow_from_the_joints(tmp_path: Path) -> None:
    """The bits are computed again here from the joints alone."""
    p = program(Recipe(11, moves=200), MAPPED)
    a = (MAPPED.joint_map or MAPPED).compute_axes_deg(p.q)
    assert (a.min(axis=0) < -90).any()
    assert (a.max(axis=0) > 180).any()
    parsed = {post: read_program(write_post(tmp_path / post, p, post, MAPPED)) for post in _folders(tmp_path)}
    for k in np.flatnonzero(p.kind == LIN):
        below = [axis < 0 for axis in a[k].round(5)]
        krl = parsed["krl"].configuration[k]
        assert krl["T"] == sum(1 << i for i, b in enumerate(below) if b)
        assert krl["S"] == p.wrist_behind[k] * 1 + p.elbow_up[k] * 2 + below[4] * 4
        abb = parsed["rapid"].configuration[k]
        for name, axis in (("cf1", 0), ("cf4", 3), ("cf6", 5)):
            quarter = abb[name]
            assert quarter * 90 <= a[k, axis] < (quarter + 1) * 90, (name, a[k, axis])
        assert abb["cfx"] == p.wrist_behind[k] * 4 + (not p.elbow_up[k]) * 2 + below[4] * 1
        fanuc = parsed["fanuc"].configuration[k]
        assert fanuc["config"] == ("N" if below[4] else "F") + "DU"[int(p.elbow_up[k])] + "TB"[int(p.wrist_behind[k])]
        for turn, axis in zip(fanuc["turns"], (0, 3, 5), strict=True):
            assert -180 < a[k, axis] - 360 * turn <= 180 or a[k, axis] - 360 * turn == -180
        assert parsed["val3"].configuration[k]["wrist"] == ("wnegative" if below[4] else "wpositive")
        rconf = parsed["jbi_rectan"].configuration[k]["rconf"]
        assert rconf == (
            int(below[4]),
            int(not p.elbow_up[k]),
            int(p.wrist_behind[k]),
            *(int(abs(a[k, axis]) >= 180) for axis in (3, 5, 0)),
        )


def _folders(tmp_path: Path) -> list[str]:
    posts = ["krl", "rapid", "fanuc", "val3", "jbi_rectan"]
    for post in posts:
        (tmp_path / post).mkdir()
    return posts


def test_pulses_of_a_yaskawa(tmp_path: Path) -> None:
    scale = np.array([1341.4, -1341.4, 1000.0, 900.5, 700.0, 500.0])
    controller = replace(MAPPED, pulses_per_deg=scale)
    p = program(Recipe(3, moves=20), controller)
    from machopt.file_formats.source_file import decode_source, read_bytes
    from machopt.programs.yaskawa.reader import read_jbi

    file = write_post(tmp_path, p, "jbi", controller)
    parsed = read_jbi(decode_source(file, read_bytes(file)), 5e-6, pulses_per_deg=tuple(scale))
    q = urdf_q(parsed, "jbi", controller)
    half = np.abs(0.5 / scale)  # half a pulse; axis 3 is coupled to axis 2
    np.testing.assert_allclose(
        np.degrees(q), np.degrees(p.q), rtol=0, atol=(half + np.array([0, 0, half[1], 0, 0, 0])).max()
    )
    assert np.isnan(read_program(file).axes_deg).all()  # without the scale no angles are invented
    assert [c["pulses"] for c in parsed.configuration] == [
        tuple(np.round(row * scale).astype(int)) for row in controller.joint_map.compute_axes_deg(p.q)
    ]


# ---- complete conversion: CSV → toolpath → program → toolpath → CSV

TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='";,#]['), min_size=1, max_size=12)
LABELS = st.lists(TEXT.map(lambda t: " ".join(t.split())).filter(bool), min_size=1, max_size=3, unique=True)


@st.composite
def recipes(draw: st.DrawFn) -> Recipe:
    return Recipe(
        seed=draw(st.integers(0, 2**32 - 1)),
        moves=draw(st.integers(2, 14)),
        blend=draw(st.sampled_from([0.0, 1e-4, 1e-2])),
        slowest=draw(st.sampled_from([2e-4, 1e-2])),
        feeds=draw(st.integers(1, 4)),
        operations=tuple(draw(LABELS)),
        events=draw(st.integers(0, 4)),
    )


def csv_text(t: Toolpath | None, p: RobotProgram | None = None) -> str:
    """Return a point table with the columns of the contract."""
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]
    if t is None:
        assert p is not None
        position, axis = p.T_workpiece_tcp[:, :3, 3], -p.T_workpiece_tcp[:, :3, 2]
        moves, feed, label = p.moves, p.feed, [p.operations[o] for o in p.operation]
    else:
        position, axis, moves, feed = t.position, t.axis, t.move, t.feed
        label = [t.operations[o].label for o in t.operation]
    for x, a, m, f, o in zip(position * 1e3, axis, moves, feed * 6e4, label, strict=True):
        numbers = ",".join(f"{v + 0.0:.6f}" for v in (*x, *a))
        rows.append(f"{numbers},{MoveKind(m).word},{'' if math.isnan(f) else f'{f:.6f}'},{o}")
    return "\n".join(rows) + "\n"


def numbers(text: str) -> tuple[np.ndarray, list[str], np.ndarray, list[str]]:
    rows = [r.split(",") for r in text.splitlines()[1:]]
    feed = np.array([float(r[7] or "nan") for r in rows])
    return np.array([[float(v) for v in r[:6]] for r in rows]), [r[6] for r in rows], feed, [r[8] for r in rows]


def csv_round_trip(recipe: Recipe, post: str, controller: RobotController, folder: Path) -> None:
    """CSV → toolpath → program → parsed → toolpath → CSV within the printed decimals."""
    made = program(recipe, controller)
    if not made.cutting.any():
        return
    first = csv_text(None, made)
    (folder / "path.csv").write_text(first)
    path = read_toolpath(folder / "path.csv")
    T = made.T_workpiece_tcp.copy()
    T[:, :3, 3] = path.position
    T[:, :3, :3] = compute_tool_rotation(path.axis, T[:, :3, 0], np.zeros(len(T)))
    p = replace(
        made,
        T_workpiece_tcp=T,
        feed=np.where(made.kind == LIN, path.feed, np.nan),
        operations=tuple(o.label for o in path.operations),
        operation=path.operation,
    )
    file = write_post(folder, p, post, controller)
    options = ReadOptions(default_feed=0.01)
    again = read_program_as_toolpath(file, options, robot=load_known_robot(controller))
    a, b = numbers(first), numbers(csv_text(again))
    joint = np.array(JOINTS_ONLY) == post
    by_axes = np.full(len(a[0]), joint.any()) | (p.kind != LIN)
    axis = tolerance(AXIS_DEG, post, 0.5e-5)
    lever = 6 * 2.01 * math.radians(axis) * 4e3 + 1.6e-6  # mm; two CSV files rounded at the sixth decimal
    place = np.where(by_axes, lever, tolerance(POSITION_MM, post, 0.5e-4) + 1.6e-6)
    assert (np.abs(a[0][:, :3] - b[0][:, :3]) <= place[:, None]).all()
    turn = np.where(by_axes, 6 * 2.01 * math.radians(axis), math.radians(tolerance(TURN_DEG, post, 1.5e-5)))
    assert (np.abs(a[0][:, 3:] - b[0][:, 3:]) <= turn[:, None] + 2.1e-6).all()
    assert a[1] == b[1]
    if post not in TIMED:
        lin = p.kind == LIN
        steps = 3.01 if post in ("fanuc", "fanuc_joint", "jbi", "jbi_rectan") else 0.035  # mm/min: 0.05 mm/s, 5e-7 m/s
        np.testing.assert_allclose(a[2][lin], b[2][lin], rtol=0, atol=steps)
    assert a[3] == b[3]
    assert [e.text for e in again.events] == [e.text for e in p.events]


@pytest.mark.parametrize("post", list_post_names())
def test_csv_to_program_and_back(post: str) -> None:
    @settings(
        max_examples=scale_example_count(12),
        deadline=None,
        derandomize=not NIGHTLY,
        suppress_health_check=list(HealthCheck),
        database=None,
    )
    @given(recipes(), st.sampled_from([PLAIN, MAPPED]))
    def round_trip(recipe: Recipe, controller: RobotController) -> None:
        with tempfile.TemporaryDirectory() as name:
            csv_round_trip(recipe, post, controller, Path(name))

    round_trip()


def test_root_and_flange_are_in_the_frames(tmp_path: Path) -> None:
    p = program(Recipe(1), MAPPED)
    parsed = read_program(write_post(tmp_path, p, "rapid", MAPPED))
    base = next(f for f in parsed.bases if f.name == f"w_{parsed.name}")
    assert base.T is not None
    np.testing.assert_allclose(ROOT @ base.T, WORKPIECE, atol=1e-7)


def test_two_rapid_programs_of_one_task_share_no_name(tmp_path: Path) -> None:
    names = []
    for seed, name in ((1, "one"), (2, "two")):
        p = program(Recipe(seed, moves=30, blend=1e-3), MAPPED)
        text = "".join(
            f.read_text() for f in write_program(tmp_path, name, p, "rapid", replace(MAPPED, moves_per_part=9))
        )
        found = re.findall(r"(?m)^\s*(?:MODULE|PROC|PERS \w+|CONST \w+)\s+(\w+)", text)
        assert len(found) == len(set(found)) > 8
        assert max(map(len, found)) <= 32  # the maximum length of a name in the language
        names.append({n.lower() for n in found})
    assert not names[0] & names[1]
