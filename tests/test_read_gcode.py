"""G-code and Heidenhain programs, read from small snippets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.path_building.rotary_axes import MACHINES, RotaryMachine
from machopt.toolpath.toolpath_reader import read_toolpath


def read(tmp_path: Path, text: str, **options: object) -> Toolpath:
    file = tmp_path / "part.nc"
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def mm(toolpath: Toolpath) -> np.ndarray:  # type: ignore[type-arg]
    return np.round(toolpath.position * 1e3, 9)  # the conversion to metres and back loses the last bits


def compute_turned_angle(p: np.ndarray, a: int = 0, b: int = 1) -> float:  # type: ignore[type-arg]
    angle = np.unwrap(np.arctan2(p[:, b], p[:, a]))
    return float(angle[-1] - angle[0])


def test_modal_words_blanks_and_unusual_numbers(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "%\nO0001 (PART (nested) NAME)\nN10 G21 G90 G17\n(OPERATION: FACE)\nT5 M6\nS8000 M3\n"
        "G0 X  10. Y-.5 Z5.\nG1 Z-1. F300\nX-1.\n Y .25\nG0Z5.\nM30\nG1 X99.\n",
    )
    assert mm(t).tolist() == [[10, -0.5, 5], [10, -0.5, -1], [-1, -0.5, -1], [-1, 0.25, -1], [-1, 0.25, 5]]
    assert [MoveKind(m).word for m in t.move] == ["rapid", "cut", "cut", "cut", "rapid"]
    assert t.feed[1] == pytest.approx(0.005)
    assert t.axis.tolist() == [[0.0, 0.0, 1.0]] * 5
    assert {e.kind for e in t.events} >= {"tool", "spindle"}
    assert any("after the program end" in w.word for w in t.ignored)


def test_spindle_starts_once_with_its_speed(tmp_path: Path) -> None:
    found = read(tmp_path, "G21 G90 G17\nS6000 M3\nG0 X0 Y0 Z5\nG1 Z-1 F300\nS8000\nG1 X20\nM5\nM30\n")
    assert [(e.text, e.value) for e in found.events if e.kind == "spindle"] == [
        ("M3", 6000.0),
        ("S8000", 8000.0),
        ("M5", 0.0),
    ]


def test_arcs_full_circle_helix_radius_and_planes(tmp_path: Path) -> None:
    head = "G21 G90\nG0 X10 Y0 Z0\nG1 F100 X10\n"
    full = mm(read(tmp_path, head + "G3 I-10\n"))[1:]
    assert compute_turned_angle(full) == pytest.approx(2 * np.pi)
    helix = mm(read(tmp_path, head + "G2 X10 Z-3 I-10 J0\n"))[1:]
    assert compute_turned_angle(helix) == pytest.approx(-2 * np.pi)
    assert helix[-1, 2] == -3.0
    short = mm(read(tmp_path, head + "G3 X0 Y10 R10\n"))[1:]
    assert compute_turned_angle(short) == pytest.approx(np.pi / 2)
    long = mm(read(tmp_path, head + "G3 X0 Y10 R-10\n"))[1:]
    assert compute_turned_angle(long - np.array([10.0, 10.0, 0.0])) == pytest.approx(1.5 * np.pi)
    modal = mm(read(tmp_path, head + "G3 X0 Y10 I-10\nX-10 Y0 J-10\n"))[1:]
    assert compute_turned_angle(modal) == pytest.approx(np.pi)
    # G18: counter-clockwise as seen from +Y, which rotates z towards x
    g18 = mm(read(tmp_path, head + "G18 G3 X0 Z10 I-10 K0\n"))[1:]
    assert compute_turned_angle(g18, 2, 0) == pytest.approx(np.pi / 2 - 2 * np.pi) or compute_turned_angle(
        g18, 2, 0
    ) == pytest.approx(1.5 * np.pi)
    g19 = mm(read(tmp_path, "G21 G90\nG0 X0 Y10 Z0\nG1 F100 X0\nG19 G3 Y0 Z10 J-10 K0\n"))[1:]
    assert compute_turned_angle(g19, 1, 2) == pytest.approx(np.pi / 2)


def test_absolute_centres_are_found_and_reported(tmp_path: Path) -> None:
    t = read(tmp_path, "G21 G90\nG0 X60 Y50 Z0\nG1 F100 X60\nG3 X50 Y60 I50 J50\n")
    assert any("absolute" in w for w in t.warnings)
    assert compute_turned_angle(mm(t)[1:] - np.array([50.0, 50.0, 0.0])) == pytest.approx(np.pi / 2)


def test_inch_incremental_and_feed_modes(tmp_path: Path) -> None:
    t = read(tmp_path, "G20 G90\nG0 X1 Y0 Z0\nG91 G1 X1 F10\nG93 X2 F4\nG94 G95 S600 X1 F.01\n")
    assert mm(t)[:, 0] == pytest.approx([25.4, 50.8, 101.6, 127.0])
    assert t.feed[1] == pytest.approx(254.0 / 60e3)
    assert t.feed[2] == pytest.approx(4 * 50.8 / 60e3)  # 1/4 minute for two inches
    assert t.feed[3] == pytest.approx(0.254 * 600 / 60e3)


@pytest.mark.parametrize("cut", ["G1 X2\n", "X2\n", "G2 X2 R1\n", "G81 X2 Z-1 R1\n"])
def test_feed_before_a_unit_change_is_asked_for_again(tmp_path: Path, cut: str) -> None:
    text = "G21 G90\nG0 X0 Y0 Z0\nG1 X1 F300\nG20\n"
    with pytest.raises(InputError, match=r"line 5: cuts by F300 of line 3, which was in mm, .*write F in inch after"):
        read(tmp_path, text + cut)
    for own in (text + "F10\n" + cut, text + cut.replace("2", "2 F10", 1), text.replace("G20", "G20 F10") + cut):
        assert read(tmp_path, own).feed[-1 if "81" not in cut else -2] == pytest.approx(254.0 / 60e3)
    assert mm(read(tmp_path, text + "G0 X2\nG21\nG1 X3\n"))[-1, 0] == 3.0  # no cut is programmed in inch


def test_cycles_with_g98_g99_repeats_and_pecks(tmp_path: Path) -> None:
    t = read(tmp_path, "G21 G90\nT1 M6\nG0 X0 Y0 Z50\nG99 G81 X10 Y5 Z-4 R2 F120\nX20\nG98 X30\nG80\nG0 Z100\n")
    assert mm(t)[t.cutting].tolist() == [[10, 5, -4], [20, 5, -4], [30, 5, -4]]
    assert mm(t)[t.move == MoveKind.RETRACT, 2].tolist() == [2, 2, 50]
    assert t.operations[0].kind == "point"
    peck = read(tmp_path, "G21 G90\nG0 X0 Y0 Z10\nG83 Z-7 R1 Q3 F100\n")
    assert mm(peck)[peck.cutting, 2].tolist() == [-2, -5, -7]
    row = read(tmp_path, "G21 G90\nG0 X0 Y0 Z10\nG91 G81 X10 Y0 Z-5 R-8 L3 F100\n")
    assert mm(row)[row.cutting].tolist() == [[10, 0, -3], [20, 0, -3], [30, 0, -3]]


def test_machine_frame_moves_are_not_path_points(tmp_path: Path) -> None:
    t = read(tmp_path, "G21 G90 G54\nG0 X0 Y0 Z10\nG1 Z-1 F50\nG53 G0 Z0\nG0 X50\nZ5\nG1 Z-1\nG28 G91 Z0\nM30\n")
    assert mm(t)[:, 2].tolist() == [10, -1, 5, 5, -1]
    assert any("G53" in w.word for w in t.ignored)
    with pytest.raises(InputError, match=r"line 5: cuts while Z is not known"):
        read(tmp_path, "G21 G90\nG0 X0 Y0 Z10\nG1 Z-1 F50\nG53 Z0\nG1 X5\n")


# ---- five axes


@pytest.mark.parametrize("machine", ["table-ac", "head-ac", "mixed-ac"])
def test_iso_signs_of_a_and_c(tmp_path: Path, machine: str) -> None:
    a, c = np.radians(30.0), np.radians(50.0)
    t = read(tmp_path, "G21 G90\nG43.4 H1\nG0 X0 Y0 Z9 A30 C50\nG1 X1 F99\nA0 C0\n", machine=machine)
    assert t.axis[1] == pytest.approx([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)])
    assert t.axis[-1] == pytest.approx([0.0, 0.0, 1.0])
    assert mm(t)[2].tolist() == [1.0, 0.0, 9.0]


def test_every_machine_gives_a_unit_axis_and_z_at_zero() -> None:
    for name in MACHINES:
        machine = RotaryMachine(name)
        assert machine.tool_axis({}) == pytest.approx((0.0, 0.0, 1.0))
        assert np.linalg.norm(machine.tool_axis({"A": 20.0, "B": -33.0, "C": 200.0})) == pytest.approx(1.0)
    assert RotaryMachine("table-b").tool_axis({"B": 90.0}) == pytest.approx((1.0, 0.0, 0.0))


def test_wrong_rotary_signs_are_detected_from_plunges(tmp_path: Path) -> None:
    # three plunges along the axis of the reversed machine
    s, c = np.sin(np.radians(40.0)), np.cos(np.radians(40.0))
    rows = "".join(f"G0 X{n}. Y{10 * s:.6f} Z{10 * c:.6f} A40. C0.\nG1 X{n}. Y0. Z0. F100\n" for n in range(3))
    result = read(tmp_path, "G21 G90\nG43.4 H1\n" + rows, machine="table-ac")
    quiet = read(tmp_path, "G21 G90\nG43.4 H1\n" + rows, machine="table-ac-reversed")
    assert any("table-ac-reversed" in w for w in result.warnings)
    assert not any("plunges" in w for w in quiet.warnings)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("G21 G90\nG43.5 H1\nG0 X0 Y0 Z9 I0 J3 K4\nG1 X1 F99\n", (0.0, 0.6, 0.8)),
        ("G71 G90\nTRAORI\nG0 X0 Y0 Z9 A3=0 B3=3 C3=4\nG1 X1 F99\nTRAFOOF\n", (0.0, 0.6, 0.8)),
        (
            "BEGIN PGM A MM\nM128\nLN X+0 Y+0 Z+9 NX0 NY0 NZ1 TX+0 TY+0.6 TZ+0.8 FMAX\nL X+1 F99\nEND PGM A MM\n",
            (0.0, 0.6, 0.8),
        ),
    ],
)
def test_tool_vectors(tmp_path: Path, text: str, expected: tuple[float, float, float]) -> None:
    t = read(tmp_path, text)
    assert t.axis[0] == pytest.approx(expected)
    assert t.axis[1] == pytest.approx(expected)
    assert mm(t)[1].tolist() == [1.0, 0.0, 9.0]


def test_rotary_words_need_a_machine_and_tool_centre_point_control(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 3: .*--machine, one of table-ac"):
        read(tmp_path, "G21 G90\nG43.4 H1\nG0 X0 Y0 Z9 A30\nG1 X1 F99\n")
    with pytest.raises(InputError, match=r"without tool-centre-point control"):
        read(tmp_path, "G21 G90\nG0 X0 Y0 Z9 A30\nG1 X1 F99\n", machine="table-ac")
    with pytest.raises(InputError, match="no such axis"):
        read(tmp_path, "G21 G90\nG43.4 H1\nG0 X0 Y0 Z9 B30\nG1 X1 F99\n", machine="table-ac")
    with pytest.raises(InputError, match="unknown machine"):
        read(tmp_path, "G21 G90\nG0 X0\nG1 X1 F99\n", machine="table-xy")
    assert len(read(tmp_path, "G21 G90\nG0 X0 Y0 Z9 A0 C0.\nG1 X1 F99\n")) == 2  # angles of zero need no machine


# ---- control dialects


def test_siemens_cycles_radius_and_calls(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        'G71 G90 G17\nMSG("TOOLPATH :HOLES")\nG0 X0 Y0 Z100\nF120\nMCALL CYCLE81(103., 100., 3., 82., )\nX10 Y5\nX20\n'
        "MCALL\nG0 Z110\nG1 X0 Y0 F500\nG3 X10 Y10 CR=10\nM202(0.5)\n",
    )
    assert t.operations[0].label == "HOLES"
    assert mm(t)[t.cutting][:2].tolist() == [[10, 5, 82], [20, 5, 82]]
    assert mm(t)[-1].tolist() == [10, 10, 110]


def test_linuxcnc_expressions(tmp_path: Path) -> None:
    t = read(tmp_path, "G21 G90\n#<z> = [2*3-1]\n#1=10\nG0 X#1 Y[#1/4] Z#<z>\nG1 X[SIN[30]*2+#<z>**2] F[10+20]\n")
    assert mm(t).tolist() == [[10, 2.5, 5], [26, 2.5, 5]]
    assert t.feed[1] == pytest.approx(30 / 60e3)
    with pytest.raises(InputError, match="read before it is set"):
        read(tmp_path, "G21 G90\nG1 X#5 F1\nG1 X1\n")


def test_heidenhain_circles_pole_and_drilling(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "0 BEGIN PGM TEST MM\n1 BLK FORM 0.1 Z X+0 Y+0 Z-20\n2 TOOL CALL 7 Z S2000\n3 L X+10 Y+0 Z+5 R0 FMAX M3\n"
        "4 L Z+0 F200\n5 CC X+0 Y+0\n6 C X-10 Y+0 DR+\n7 C X+10 Y+0 DR+\n8 CR X+0 Y-10 R+10 DR-\n9 L Z+50 FMAX\n"
        "10 CYCL DEF 200 DRILLING ~\n    Q200=2 ;SET-UP CLEARANCE ~\n    Q201=-9 ;DEPTH ~\n    Q206=150 ;FEED ~\n"
        "    Q202=9 ;PECK ~\n    Q203=+1 ;SURFACE ~\n    Q204=20\n"
        "11 L X+30 Y+30 FMAX M99\n12 L Z-1 FMAX M91\n13 END PGM TEST MM\n",
    )
    p = mm(t)
    circle = p[1 : int(np.flatnonzero(np.abs(p[:, 0]) < 1e-9)[-1])]
    assert t.format == "heidenhain"
    assert compute_turned_angle(circle[:-20]) > 1.5 * np.pi  # the pole of CC applies to both arcs
    assert p[t.cutting][-1].tolist() == [30.0, 30.0, -8.0]
    assert t.feed[t.cutting][-1] == pytest.approx(150 / 60e3)
    assert t.operations[0].label == "T7"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G0 X0 Y0 Z0\nG1 X1 F5\n", "--unit"),
        ("G21 G90\nG0 X0 Y0 Z0\nG1 X1\n", "line 3.*--feed"),
        ("G21\nX1 Y1\nG1 X2 F5\n", "line 2: moves before any G0"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 X2 F5\n", "line 3: X is given twice"),
        ("G21\nG0 X0 Y0 Z0\nG1 X--5 F5\n", "line 3: found 'X--5 F5'"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1.5.2 F5\n", "line 3: found 'X1.5.2 F5'"),
        ("G21\nG0 X0 Y0 Z0\nG1 F5 XY10\n", "line 3: found 'XY10'"),
        ('G71 G90\nMSG("A")\nG0 X0 Y0 Z0\nL140(1)\nG1 X1 F5\n', "line 4: L140"),
        ("G21\nG0 X0 Y0 Z0\nG51 X2\nG1 X1 F5\n", "line 3: G51 without a factor"),
        ("G21\nG0 X0 Y0 Z0\nG68.2 P2 X0\nG1 X1 F5\n", "line 3: G68.2 P2"),
        ("G21\nG0 X0 Y0 Z0\nG68.2 X0 Y0 Z0 I0 J30 K0\nG1 X1 F5\n", "line 4: cuts in a tilted plane before"),
        ("G21\nG0 X0 Y0 Z9\nG18 G81 X1 Z-3 R1 F5\n", "line 3: G81 without Y"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\nG10 L2 P1 X5\n", "line 4: G10 L2 changes G54"),
        ("G7 A5=0 B5=0 C5=0 L1=1\nG21\nG0 X0\n", "MillPlus"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\nM98 P100\n", "line 4: M98"),
        ("G21 G54\nG0 X0 Y0 Z0\nG1 X1 F5\nG55 X2\n", "line 4: the work offset changes"),
        ("G21 G91\nG0 X0 Y0 Z0\nG1 X1 F5\nG53 X0\nG92 X0\n", "line 5: G92 X where X is not known"),
        ("G21\nG0 X0 Y0 Z0\nG1 X9 F5\nG2 X0 Y10\n", "line 4: an arc without"),
        ("G21\nG0 X0 Y0 Z0\nG1 X9 F5\nG2 X0 Y10 I3 J0\n", "line 4: start and end"),
        ("G21\nG0 X0 Y0 Z0\nG1 X9 F5\nG2 X0 Y10 R2\n", "line 4: radius"),
        ("G21\nG0 X0 Y0 Z9\nG81 X1 Z-3 F5\n", "line 3: G81 without R"),
        ("G21\nG0 X0 Y0 Z0\nG93 G1 X1 F5\nX2\n", "line 4: a cutting block without F under G93"),
        ("G21\nG0 X0 Y0 Z0\nG93 G2 X2 I1 F5\nG3 X0 I-1\n", "line 4: a cutting block without F under G93"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F100\nG93 G1 X2\n", "line 4: a cutting block without F under G93"),
        ("G21\nG0 X0 Y0 Z9\nG93 G81 X1 Z-3 R1 F5\n", "line 3: G81 under G93"),
        ("G21\nG0 X0 Y0 Z0\nG93 G1 X1 F5\nG94 X2\n", "line 4.*--feed"),
        ("G21\nG0 X0 Y0 Z9\nG223 X1\nG1 X1 F5\n", "line 3: G223 is not known"),
        ("G21\nG0 X0 Y0 Z0\nG0 X5\n", "no cutting move"),
        ("G21\nG0 X0 Y0 Z0\nG1 X9999999. F5\n", "line 3: coordinate"),
        ("ISO-10303-21;\nHEADER;\n", "STEP"),
        ("hello\nworld\n", "not recognised"),
        ("BEGIN PGM A MM\nL X0 Y0 Z0 FMAX\nCALL LBL 3\nEND PGM A MM\n", "line 3: label 3 is not in this file"),
    ],
)
def test_refusals(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, text)


def test_binary_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    file.write_bytes(bytes(range(256)) * 4)
    with pytest.raises(InputError, match="is binary"):
        read_toolpath(file)
    file.write_bytes(b"\x1f\x8b\x08\x00abc")
    with pytest.raises(InputError, match="gzip"):
        read_toolpath(file)
    with pytest.raises(InputError, match="no such file"):
        read_toolpath(tmp_path / "absent.nc")


def test_named_operation_keeps_its_name_over_the_tool_change(tmp_path: Path) -> None:
    t = read(tmp_path, "G21\n(Operation Name: POCKET)\nT3 M6\nG0 X0 Y0 Z5\nG1 Z-1 F50\nT4 M6\nG0 Z5\nG1 X9 F50\n")
    assert [(o.label, o.tool, o.kind) for o in t.operations] == [("POCKET", "3", "point"), ("T4", "4", "trajectory")]


def test_heidenhain_inch_datum_and_cycle_one(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "0 BEGIN PGM A INCH\n1 CYCL DEF 7.0 DATUM SHIFT\n2 CYCL DEF 7.1 X+5\n3 L X+0 Y+0 Z+1 FMAX\n4 L IX+1 F50\n"
        "5 CYCL DEF 7.1 X+6\n6 CYCL DEF 1.0 PECKING\n7 CYCL DEF 1.1 DIST1.0\n8 CYCL DEF 1.2 DEPTH-.5\n"
        "9 CYCL DEF 1.3 PLNGNG.2\n10 CYCL DEF 1.4 DWELL0\n11 CYCL DEF 1.5 F50\n12 L X+0 FMAX M99\n13 END PGM A INCH\n",
    )
    assert mm(t)[1, 0] == pytest.approx(6 * 25.4)  # the first datum is at X5 of the preset
    assert mm(t)[-1, 0] == pytest.approx(6 * 25.4)  # X0 of the second datum
    assert mm(t)[-2:, 2] / 25.4 == pytest.approx([-0.5, 1.0])
    assert t.feed[1] == pytest.approx(5 * 25.4 / 60e3)
    assert any("tenths of an inch" in w for w in t.warnings)


def test_truncated_program_is_reported(tmp_path: Path) -> None:
    t = read(tmp_path, "G21\nG0 X0 Y0 Z5\nG1 Z-1 F50\nG1 X12")
    assert t.warnings[0].startswith("INCOMPLETE FILE? no program end")
    assert "last number" in t.meta["incomplete"]
    assert read(tmp_path, "G21\nG0 X0 Y0 Z5\nG1 Z-1 F50\nG1 X12\n").meta["incomplete"]
    assert "incomplete" not in read(tmp_path, "%\nG21\nG0 X0 Y0 Z5\nG1 Z-1 F50\nG1 X12\n%\n").meta
    assert read(tmp_path, "G21\nG0 X0 Y0 Z5\nG1 Z-1 F50\nG1 X12\nM30").warnings == ()


def test_siemens_five_axis_program_of_a_post(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        '%_N_PART_MPF\n;$PATH=/_N_WKS_DIR\nN10 G17 G71 G90 G94 G54\nN20 T="MILL_D10" D1\nN30 M6\n'
        "N40 S8000 M3\nN50 TRAORI\nN60 ORIWKS ORIAXES\n"
        "N70 CYCLE832(0.01,102001)\nN80 G642 ADIS=0.05\nN90 G0 X10. Y20. Z50. A3=0. B3=.6 C3=.8\n"
        "N100 G1 Z-1. F1000 M8\nN110 X11. A3=0. B3=.1 C3=1.\nN120 X12.\nN130 TRAFOOF\nN140 SUPA G0 Z0 D0\nN150 M30\n",
        strict=True,
    )
    assert mm(t).tolist() == [[10, 20, 50], [10, 20, -1], [11, 20, -1], [12, 20, -1]]
    assert t.axis[1] == pytest.approx([0.0, 0.6, 0.8])
    assert t.axis[3] == pytest.approx(np.array([0.0, 0.1, 1.0]) / np.sqrt(1.01))
    assert t.operations[0].tool == "MILL_D10"
    assert t.operations[0].label == "TMILL_D10"  # not the folder on the control
    assert t.warnings == ()
    assert t.meta["unit"] == "mm"


@pytest.mark.parametrize("word", ["ORIEULER", "ORIRPY", "ORIRPY2", "ORIVIRT1", "ORIPLANE"])
def test_message_about_turns_does_not_apply_to_vectors(tmp_path: Path, word: str) -> None:
    """The word was reported as a missing subprogram; angles (A2, B2, C2) are refused as before."""
    lines = "G71 G90 G54\nTRAORI\n{}G0 X10 Y20 Z50 A3=0 B3=.6 C3=.8\nG1 Z-1 F1000\nX12 {}\nM30\n"
    plain, message = (read(tmp_path, lines.format(v, "A3=0 B3=0 C3=1"), strict=True) for v in ("", f"{word}\n"))
    np.testing.assert_array_equal(message.axis, plain.axis)
    np.testing.assert_array_equal(message.position, plain.position)
    with pytest.raises(InputError, match="A2"):
        read(tmp_path, lines.format(f"{word}\n", "A2=10 B2=0 C2=0"))


@pytest.mark.parametrize(
    ("name", "head", "tail"),
    [
        ("a.nc", "G21 G90\nG52 X10 Y-4\nG0 X0 Y0 Z5\nG1 Z-1 F50\nX20\n", ""),
        ("a.mpf", "G71 G90\nTRANS X10 Y-4\nG0 X0 Y0 Z5\nG1 Z-1 F50\nX20\n", ""),
        (
            "a.h",
            "BEGIN PGM A MM\nCYCL DEF 7.0\nCYCL DEF 7.1 X+10\nCYCL DEF 7.2 Y-4\nL X+0 Y+0 Z+5 FMAX\nL Z-1 F50\n"
            "L X+20\n",
            "END PGM A MM\n",
        ),
    ],
)
def test_shift_before_the_first_move_moves_every_point(tmp_path: Path, name: str, head: str, tail: str) -> None:
    """The shift is a number of the file: the path refers to the work offset, wherever the shift is programmed."""
    (tmp_path / name).write_text(head + tail)
    t = read_toolpath(tmp_path / name)
    assert np.allclose(mm(t), [[10, -4, 5], [10, -4, -1], [30, -4, -1]])


@pytest.mark.parametrize("between", ["", "T2 M6\n", "M8\n"])
def test_spindle_speed_on_its_own_line_starts_it_once(tmp_path: Path, between: str) -> None:
    found = read(tmp_path, f"G21 G90 G17\nS6000\n{between}M3\nG0 X0 Y0 Z5\nG1 Z-1 F300\nS8000\nG1 X20\nM5\nM30\n")
    spindle = [(e.text, e.value) for e in found.events if e.kind == "spindle"]
    assert spindle == [("M3", 6000.0), ("S8000", 8000.0), ("M5", 0.0)]


@pytest.mark.parametrize(
    ("tail", "depths", "feed", "dwell"),
    [
        # each peck is 3 mm smaller, never below 3; the last two are equal
        ("-8,,3,0.5,0,1,0", [-8, -13, -16, -18, -20], 100.0, 0.5),
        ("-8,,,,,0.5,1", [-8, -16, -20], 50.0, 0.0),  # no degression; the first stroke at half the feed
        # half of the peck before, at least 2 mm
        (",6,-0.5,,,50,0,,2", [-6, -9, -11, -13, -15, -17, -19, -20], 50.0, 0.0),
    ],
)
def test_siemens_deep_holes_have_decreasing_pecks(
    tmp_path: Path, tail: str, depths: list[float], feed: float, dwell: float
) -> None:
    """CYCLE83(RTP, RFP, SDIS, DP, DPR, FDEP, FDPR, DAM, DTB, DTS, FRF, VARI, axis, MDEP): DAM was read as the dwell."""
    text = f"G71 G90 G17\nG0 X0 Y0 Z50\nF100\nCYCLE83(10,0,2,-20,,{tail})\nM30\n"
    t = read(tmp_path, text)
    cut = t.move == MoveKind.CUT
    np.testing.assert_allclose(1e3 * t.position[cut, 2], depths, atol=1e-9)
    np.testing.assert_allclose(60e3 * t.feed[cut], [feed] + [100.0] * (len(depths) - 1))
    assert float(t.dwells.sum()) == pytest.approx(dwell)


def test_siemens_holes_use_the_active_feed(tmp_path: Path) -> None:
    """Feeds per revolution were read as mm/min, and F between call and hole was lost."""
    text = "G71 G90 G17 G95\nS1000 M3\nG0 X0 Y0 Z50\nF0.2\nMCALL CYCLE81(10,0,2,-20)\nX10\nX20 F0.1\nMCALL\nM30\n"
    t = read(tmp_path, text)
    np.testing.assert_allclose(60e3 * t.feed[t.move == MoveKind.CUT], [200.0, 100.0])
    with pytest.raises(InputError, match=r"line 6: CYCLE81 under G93.*G94"):
        read(tmp_path, text.replace("F0.2", "G93 F2"))


@pytest.mark.parametrize("tail", ["-8,,-3", "-8,,,,,-1", "-8,,inf", "-8,,-0.001,,,,,,0"])
def test_invalid_siemens_deep_holes_are_refused(tmp_path: Path, tail: str) -> None:
    text = f"G71 G90 G17\nG0 X0 Y0 Z50\nF100\nCYCLE83(10,0,2,-200,,{tail})\nM30\n"
    with pytest.raises(InputError, match=r"line 4: .*(CYCLE83: |pecks)"):
        read(tmp_path, text)
