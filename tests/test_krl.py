"""KRL programs parsed back by a reader that shares nothing with the writer."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from machopt.formats.krl import (
    LIN,
    PTP,
    ArmLengths,
    JointMap,
    RobotProgram,
    abc_deg,
    krl_name,
    status_bits,
    turn_bits,
    write_krl,
)

XYZ_MM, ABC_DEG, AXIS_DEG = 0.51e-4, 0.51e-5, 0.51e-5  # half of the last printed decimal


def rz_ry_rx(a: float, b: float, c: float) -> np.ndarray:
    """KUKA's definition, written out from three elementary rotations."""
    a, b, c = np.radians([a, b, c])
    rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return rz @ ry @ rx


@dataclass
class Parsed:
    moves: list[tuple[str, dict[str, float], bool, float]] = field(default_factory=list)  # kind, target, C_DIS, speed
    frames: dict[str, dict[str, float]] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)
    longest: int = 0


def parse(folder: Path, name: str) -> Parsed:
    """Run a .src as the interpreter would: main program first, calls followed, modal speed kept."""
    raw = (folder / f"{name}.src").read_bytes()
    assert raw.count(b"\n") == raw.count(b"\r\n")
    routines: dict[str, list[str]] = {}
    current: list[str] | None = None
    for line in raw.decode("ascii").split("\r\n"):
        if m := re.fullmatch(r"DEF (\w+)\( \)", line):
            assert current is None
            current = routines.setdefault(m[1], [])
        elif line == "END":
            assert current is not None
            current = None
        elif current is not None:
            current.append(line)
        else:
            assert line in ("", "&ACCESS RVP")
    out = Parsed(longest=max(len(r) for r in routines.values()))
    for line in (folder / f"{name}.dat").read_text().splitlines():
        if m := re.fullmatch(r"DECL FRAME (\w+)=\{(.*)\}", line):
            out.frames[m[1]] = aggregate(m[2])
    speed = [float("nan")]

    def run(routine: str) -> None:
        for line in routines[routine]:
            code, _, comment = line.partition(";")
            code = code.strip()
            if comment:
                out.comments.append(comment.strip())
            if m := re.fullmatch(r"(PTP|LIN) \{(.*)\}( C_DIS)?", code):
                out.moves.append((m[1], aggregate(m[2]), bool(m[3]), speed[0]))
            elif m := re.fullmatch(r"\$VEL\.CP=([\d.]+)", code):
                speed[0] = float(m[1])
            elif m := re.fullmatch(r"(\w+)\( \)", code):
                run(m[1])
            else:
                assert code == "" or code.startswith(("$", "BAS(")), code

    run(name)
    return out


def aggregate(text: str) -> dict[str, float]:
    return {k: float(v) for k, v in (item.split(" ") for item in text.split(","))}


def program(moves: int, seed: int = 1, **changes: object) -> RobotProgram:
    rng = np.random.default_rng(seed)
    kind = np.full(moves, LIN, np.int8)
    kind[0] = PTP
    kind[5::7] = PTP
    T = np.tile(np.eye(4), (moves, 1, 1))
    q, r = np.linalg.qr(rng.normal(size=(moves, 3, 3)))
    q *= np.sign(np.einsum("kii->ki", r))[:, None, :]
    T[:, :3, :3] = q * np.sign(np.linalg.det(q))[:, None, None]
    T[:, :3, 3] = rng.uniform(-2, 2, (moves, 3))
    frame = T[0].copy()
    feed = np.where(kind == LIN, np.repeat(rng.uniform(0.001, 0.5, moves // 3 + 1), 3)[:moves], np.nan)
    made = RobotProgram(
        kind=kind, q=rng.uniform(-3, 3, (moves, 6)), T_workpiece_tcp=T, feed=feed, cutting=kind == LIN,
        operation=(np.arange(moves) * 2 // moves).astype(np.int32), operations=("Bohren ø6", "slot"),
        T_flange_tcp=frame, T_base_workpiece=frame,
        events=((2, "SPINDL/9000,RPM,CLW"), (9, "COOLNT/ON")), source="a.apt",
    )  # fmt: skip
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("moves", [1, 40, 9001])
def test_a_program_comes_back(tmp_path: Path, moves: int) -> None:
    p = program(moves)
    p = replace(p, events=tuple(e for e in p.events if e[0] < moves))
    write_krl(tmp_path, "part", p)
    back = parse(tmp_path, "part")
    assert [m[0] for m in back.moves] == ["PTP" if k == PTP else "LIN" for k in p.kind]
    for k, (kind, target, blended, speed) in enumerate(back.moves):
        assert not blended
        if kind == "PTP":
            axes = [target[f"A{i}"] for i in range(1, 7)]
            np.testing.assert_allclose(axes, np.degrees(p.q[k]), atol=AXIS_DEG, rtol=0)
        else:
            xyz, abc = [target[c] for c in "XYZ"], [target[c] for c in "ABC"]
            np.testing.assert_allclose(xyz, p.T_workpiece_tcp[k, :3, 3] * 1e3, atol=XYZ_MM, rtol=0)
            # three angles, each off by half a decimal
            np.testing.assert_allclose(
                rz_ry_rx(*abc), p.T_workpiece_tcp[k, :3, :3], atol=3 * np.radians(ABC_DEG), rtol=0
            )
            assert speed == pytest.approx(p.feed[k], abs=0.51e-6)
    for name, T in (("MO_TOOL", p.T_flange_tcp), ("MO_BASE", p.T_base_workpiece)):
        f = back.frames[name]
        np.testing.assert_allclose([f[c] for c in "XYZ"], T[:3, 3] * 1e3, atol=XYZ_MM, rtol=0)
        np.testing.assert_allclose(rz_ry_rx(*(f[c] for c in "ABC")), T[:3, :3], atol=3 * np.radians(ABC_DEG), rtol=0)
    assert back.longest < 4000 * 2  # moves and their speed lines


def test_operations_and_events_stand_where_they_happen(tmp_path: Path) -> None:
    write_krl(tmp_path, "part", program(20))
    text = (tmp_path / "part.src").read_text()
    order = ("; operation: Bohren ?6", "; CAM: SPINDL/9000,RPM,CLW", "; operation: slot")
    assert sorted(order, key=text.index) == list(order)
    assert ";FOLD" not in text


def test_rounding_is_off_unless_asked_for_and_stops_at_breaks(tmp_path: Path) -> None:
    p = program(30)
    write_krl(tmp_path, "part", replace(p, blend=5e-5))
    back = parse(tmp_path, "part")
    assert any("within 0.05 mm" in c for c in back.comments)
    for k, (kind, _, blended, _) in enumerate(back.moves):
        last = k == 29 or p.operation[k + 1] != p.operation[k] or p.kind[k + 1] == PTP or k + 1 in (2, 9)
        assert blended == (kind == "LIN" and not last), k


def test_the_joint_map_and_external_axes(tmp_path: Path) -> None:
    p = program(9, external=np.linspace(0, 1, 18).reshape(9, 2), external_prismatic=(True, False))
    joint_map = JointMap(np.array([-1.0, 1, 1, -1, 1, -1]), np.array([0.0, -90, 90, 0, 0, 0]))
    write_krl(tmp_path, "part", p, joint_map=joint_map)
    for k, (kind, target, _, _) in enumerate(parse(tmp_path, "part").moves):
        assert target["E1"] == pytest.approx(p.external[k, 0] * 1e3, abs=1e-4)
        assert target["E2"] == pytest.approx(np.degrees(p.external[k, 1]), abs=1e-4)
        if kind == "PTP":
            assert target["A1"] == pytest.approx(-np.degrees(p.q[k, 0]), abs=AXIS_DEG)
            assert target["A2"] == pytest.approx(np.degrees(p.q[k, 1]) - 90, abs=AXIS_DEG)


KR = ArmLengths(shoulder=0.35, upper_arm=1.25, forearm=1.1, elbow=-0.055)


@pytest.mark.parametrize(
    ("axes", "status"),
    [
        ((0, -90, 90, 0, 30, 0), 0b010),  # the pose of the data sheet: in front, elbow up
        ((0, -90, 90, 0, -30, 0), 0b110),
        ((0, -120, -60, 0, 30, 0), 0b001),  # folded back over the shoulder, elbow down: x = 0.35 − 0.63 − 1.1
        ((0, -20, -10, 0, 30, 0), 0b000),  # almost stretched, elbow below the line
        ((0, -170, 10, 0, 30, 0), 0b011),  # lying back
    ],
)
def test_status_of_known_postures(axes: tuple[float, ...], status: int) -> None:
    assert status_bits(np.array(axes, float), KR) == status


def test_the_elbow_bit_changes_where_the_arm_is_stretched() -> None:
    """Distance from axis 2 to the wrist root is longest exactly where bit 1 changes."""
    a3 = np.linspace(-30, 30, 60_001)
    x = 1.25 + 1.1 * np.cos(np.radians(a3)) - 0.055 * np.sin(np.radians(a3))
    z = -1.1 * np.sin(np.radians(a3)) - 0.055 * np.cos(np.radians(a3))
    longest = a3[np.argmax(np.hypot(x, z))]
    axes = np.zeros((len(a3), 6))
    axes[:, 2], axes[:, 4] = a3, 10
    bit = status_bits(axes, KR) >> 1 & 1
    assert a3[np.argmax(bit)] == pytest.approx(longest, abs=0.01)


def test_turn_bits_agree_with_points_seen_on_robots() -> None:
    assert turn_bits(np.array([-5.0, -60, 90, 10, 40, -3])) == 35  # S 2,T 35
    assert turn_bits(np.array([5.0, -60, 90, 10, -40, -3])) == 50  # S 6,T 50


def test_status_is_left_out_rather_than_guessed(tmp_path: Path) -> None:
    write_krl(tmp_path, "without", program(9))
    write_krl(tmp_path, "with_arm", program(9), arm=KR)
    assert all("S" not in m[1] for m in parse(tmp_path, "without").moves)
    assert all("S" in m[1] and "T" in m[1] for m in parse(tmp_path, "with_arm").moves if m[0] == "LIN")


@settings(max_examples=200, deadline=None)
@given(*[st.floats(-180, 180)] * 3)
def test_abc_turns_back_into_the_rotation(a: float, b: float, c: float) -> None:
    R = rz_ry_rx(a, b, c)
    np.testing.assert_allclose(rz_ry_rx(*abc_deg(R)), R, atol=1e-9)


@pytest.mark.parametrize("b", [90.0, -90.0, 89.9999999])
def test_abc_at_the_pole(b: float) -> None:
    R = rz_ry_rx(20.0, b, -50.0)
    np.testing.assert_allclose(rz_ry_rx(*abc_deg(R)), R, atol=5e-9)  # cos B below 1e-9 is taken as 0


@pytest.mark.parametrize(
    ("text", "name"),
    [("2nd op-A", "p2nd_op_A"), ("part", "part"), ("ü", "p"), ("x" * 40, "x" * 24)],
)
def test_names(text: str, name: str) -> None:
    assert krl_name(text) == name


def test_what_krl_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no KRL module name"):
        write_krl(tmp_path, "1part", program(3))
    with pytest.raises(ValueError, match="begins with a PTP"):
        program(3, kind=np.full(3, LIN, np.int8))
    with pytest.raises(ValueError, match="needs a feed"):
        program(3, feed=np.array([np.nan, np.nan, 0.1]))
    with pytest.raises(ValueError, match="external_prismatic"):
        program(3, external_prismatic=(True,))
