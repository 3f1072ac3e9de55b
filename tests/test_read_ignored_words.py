"""Words that move points are not ignored; expected values follow the rules of the control."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

FANUC = "%\nO1\nG21 G90 G17\nG0 X0. Y0. Z10.\nG1 Z0. F100.\n"
SIEMENS = "G71 G90 G17\nR1=5\nG0 X0 Y0 Z0\nG1 X10 F100\n"
HEIDENHAIN = "BEGIN PGM A MM\n1 TOOL CALL 1 Z S1000 F200\n2 L X+0 Y+0 Z+10 R0 FMAX\n3 L Z+0 F100\n"


def read(tmp_path: Path, text: str, **options: object) -> Toolpath:
    file = tmp_path / "part.txt"
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def mm(toolpath: Toolpath) -> list[list[float]]:
    return np.round(toolpath.position * 1e3, 6).tolist()  # type: ignore[no-any-return]


def feeds(toolpath: Toolpath) -> list[float]:
    return np.round(toolpath.feed[toolpath.cutting] * 60e3, 6).tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("G13 D0 I5.", "circular pocket"),
        ("G12 I5. D1", "circular pocket"),
        ("G150 P9 X5. Q1.", "mills a pocket"),
        # was read as inches before: every later coordinate was 25.4 times too large
        ("G70 I10. J0. L6", "in a pattern"),
        ("G72 I10. J0. L6", "in a pattern"),
        ("G1 U5. W-5.", "further axis"),
        ("G60 X10.", "from one side"),
        ("G2 X0. Y0. I5. J0. Q1. L2", "spiral or cone"),
        ("G54.2 P1", "dynamic fixture offset"),
        ("G54.4 P1", "workpiece's seat"),
        ("(RPT,3)", "line 6: a statement in brackets"),
        ("N9 (UAO,2)", "line 6: a statement in brackets"),
    ],
)
def test_unsupported_motion_words_are_refused(tmp_path: Path, block: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, f"{FANUC}{block}\nG1 X10.\nM30\n")


@pytest.mark.parametrize(("block", "name"), [("MYPART", "MYPART"), ("N5 MYPART(3,4)", "MYPART"), ("OVR=50", "OVR")])
def test_unsupported_siemens_motion_word_is_refused(tmp_path: Path, block: str, name: str) -> None:
    with pytest.raises(InputError, match=name):
        read(tmp_path, f"{SIEMENS}{block}\nG1 Y3\nM30\n")


def test_feed_for_one_block(tmp_path: Path) -> None:
    t = read(tmp_path, SIEMENS + "X20 FB=50\nX30\nM30\n")
    assert feeds(t) == [100.0, 50.0, 100.0]


def test_modal_rounding_and_angles_beside_parameters(tmp_path: Path) -> None:
    """R1=5 enables variables: RNDM= and ANG= were then read as variables."""
    t = read(tmp_path, SIEMENS + "RNDM=2\nG1 X20\nY10\nRNDM=0\nX30 ANG=45\nM30\n")
    points = np.array(mm(t))
    assert [18, 0, 0] in points.tolist()
    assert [20, 2, 0] in points.tolist()
    assert points[-1].tolist() == [30, 20, 0]


def test_siemens_exact_stop_and_quoted_brackets(tmp_path: Path) -> None:
    t = read(tmp_path, SIEMENS + 'MSG("G1 X50 (a; b)") ; G1 X60\nG1 G60 X20\nCYCLE80\nM30\n')
    assert mm(t)[1:] == [[10, 0, 0], [20, 0, 0]]


def test_feed_of_the_tool_call(tmp_path: Path) -> None:
    t = read(tmp_path, HEIDENHAIN + "4 L X+10 F AUTO\n5 L X+20 F50\n6 L X+30 FAUTO\nEND PGM A MM\n")
    assert feeds(t) == [100.0, 200.0, 50.0, 200.0]
    first = read(tmp_path, "BEGIN PGM A MM\n1 TOOL CALL 1 Z F300\n2 L X+0 Y+0 Z+0\n3 L X+9\nEND PGM A MM\n")
    assert feeds(first) == [300.0, 300.0]


def test_formulas_with_multiplication(tmp_path: Path) -> None:
    """A formula ended at the asterisk of a product, which ends a block in DIN/ISO only."""
    t = read(
        tmp_path,
        HEIDENHAIN + "4 Q1 = 10\n5 Q3 = SQRT(Q1*Q1 + 5^2) - 1\n6 FN 3: Q4 = +Q1 * +2\n7 L X+Q3 Y+Q4\nEND PGM A MM\n",
    )
    assert mm(t)[-1] == [10.18034, 20, 0]


def test_headings_and_oversize_of_heidenhain(tmp_path: Path) -> None:
    text = HEIDENHAIN.replace("F200", "F200 DL+0.5").replace("2 L", "2 * - SECTION X+3\n3 L", 1)
    t = read(tmp_path, text + "5 L X+9\nEND PGM A MM\n")
    assert not [w for w in t.ignored if not w.understood]
    assert [w for w in t.warnings if "oversize" in w]


def test_mirror_of_din_iso(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "%A G71 *\nN30 T1 G17 S1000*\nN40 G00 G90 X+0 Y+0 Z+0*\nN80 G28 X*\nN90 G01 X+5 Y+1 F100*\nN95 G28*\n"
        "N99 X+6*\nN9999 %A G71 *\n",
    )
    assert mm(t) == [[0, 0, 0], [-5, 1, 0], [6, 1, 0]]


@pytest.mark.parametrize(
    ("blocks", "kept"),
    [
        ("G0 G53 Z0.\nX200. Y200.\nM30\n", 2),
        ("G91 G28 Z0.\nG90 G0 X200.\nM30\n", 2),
        ("G0 G53 Z0.\nX200. Y200.\nZ5.\nM30\n", 4),  # its height follows later
    ],
)
def test_last_rapids_of_unknown_height_are_left_out(tmp_path: Path, blocks: str, kept: int) -> None:
    """They ran at the last known height, which is the height at the end of the cut."""
    t = read(tmp_path, FANUC + blocks)
    assert len(t) == kept
    assert (t.position[2:, 2] >= 0.005).all()
    assert bool([w for w in t.warnings if "left out" in w]) == (kept == 2)
    assert all(e.index <= kept for e in t.events)


def test_last_rapids_after_m91(tmp_path: Path) -> None:
    t = read(tmp_path, HEIDENHAIN + "4 L Z-1 R0 FMAX M91\n5 L X+200 FMAX M5\nEND PGM A MM\n")
    assert [MoveKind(m).word for m in t.move] == ["rapid", "cut"]


def test_bare_number_among_marked_ones_is_asked_for(tmp_path: Path) -> None:
    text = FANUC + "X20. Y5.\nX5\nX12.5\nM30\n"
    with pytest.raises(InputError, match=r"X5 has no decimal point.*--decimals"):
        read(tmp_path, text)
    assert mm(read(tmp_path, text, decimals=3))[3] == [0.005, 5, 0]
    assert mm(read(tmp_path, text, decimals=0))[3] == [5, 5, 0]
    mixed = text.replace("X12.5", "Y7\nX8 Y9\nX12.5")  # both notations occur equally often
    with pytest.raises(InputError, match=r"X5 has no decimal point.*--decimals"):
        read(tmp_path, mixed)


def test_block_delete_is_reported(tmp_path: Path) -> None:
    t = read(tmp_path, FANUC + "/G1 X50.\nG1 Y5.\nM30\n")
    assert len(t) == 4
    assert [w for w in t.warnings if "block-delete" in w]


def test_feeds_under_velset(tmp_path: Path) -> None:
    place = "[[{},0,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    text = (
        "MODULE M\nPROC main()\n" + f"MoveL {place.format(0)},v10,fine,tool0;\nVelSet 100,5000;\n"
        f"MoveL {place.format(9)},v10,fine,tool0;\nENDPROC\nENDMODULE\n"
    )
    assert feeds(read(tmp_path, text))[-1] == 600.0
    with pytest.raises(InputError, match="VelSet"):
        read(tmp_path, text.replace("VelSet 100", "VelSet 50"))


def test_headerless_table_of_tool_axes_is_not_read_as_angles(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="tool axis i, j, k"):
        read(tmp_path, "0,0,0,0,0,1\n1,0,0,0,0,1\n2,0,0,0,0,1\n", default_feed=0.01)


def test_radius_in_a_straight_block_is_reported(tmp_path: Path) -> None:
    """Without a comma, R rounds a corner on some controls and has no meaning on others."""
    t = read(tmp_path, FANUC + "G1 X10. R2.\nY5.\nG54.2 P0\nM30\n")
    assert [w.word for w in t.ignored if not w.understood] == ["R"]


def test_file_of_another_control_keeps_its_unit_word(tmp_path: Path) -> None:
    """X=V1 resembles Sinumerik; G21 nevertheless states the unit of the feeds."""
    assert feeds(read(tmp_path, FANUC + "V1=5\nG1 X=V1\nM30\n")) == [100.0, 100.0]


@pytest.mark.parametrize(
    ("lines", "feed", "strange"),
    [
        ("4 L X+10 F0.1 M136\n5 L X+20\n", 100.0, []),
        ("4 L X+10 F50 M120 LA5\n5 L X+20\n", 50.0, []),
        ("4 L X+10 F50 M103 F20\n5 L X+20\n", 50.0, []),
        ("4 L X+10 F50 M118 X1 Y1\n5 L X+20 M126 M116\n", 50.0, []),
        ("4 PRESET SELECT #3\n5 L X+10 F50\n6 L X+20\n", 50.0, None),
    ],
)
def test_words_of_m_functions_are_no_coordinates(
    tmp_path: Path, lines: str, feed: float, strange: list[str] | None
) -> None:
    text = HEIDENHAIN + lines + "END PGM A MM\n"
    if strange is None:  # the points before the first named preset are in that preset, too
        assert mm(read(tmp_path, text))[-1] == [20, 0, 0]
        text = text.replace("3 L Z+0 F100\n", "3 CYCL DEF 247 ~\nQ339=+1\nL Z+0 F100\n")
        with pytest.raises(InputError, match="from preset 1 to preset 3"):
            read(tmp_path, text)
        return
    t = read(tmp_path, text)
    assert mm(t)[-2:] == [[10, 0, 0], [20, 0, 0]]
    assert feeds(t)[1:] == [feed, feed]
    assert [w.word for w in t.ignored if not w.understood] == strange


def test_other_tool_axis_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 2: the tool axis is Y"):
        read(tmp_path, HEIDENHAIN.replace("TOOL CALL 1 Z", "TOOL CALL 1 Y") + "END PGM A MM\n")
    with pytest.raises(InputError, match=r"line 4: .*FU0.1.*post F in mm/min"):
        read(tmp_path, HEIDENHAIN.replace("F100", "FU0.1") + "END PGM A MM\n")


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("TRAORI\nG1 X20 LEAD=10 TILT=0", "LEAD=: the tool axis counts from the path"),
        ("TRAORI\nG1 X20 A2=0 B2=30 C2=0", "A2=: tool axes by turns"),
        ("G1 X20 FZ=0.1", "FZ=: feed per tooth"),
        ("G247 DISR=5 DISCL=2 X20", "come to and leave a contour"),
    ],
)
def test_words_are_not_read_as_variables(tmp_path: Path, block: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, f"{SIEMENS}{block}\nG1 Y3\nM30\n")


def test_names_beside_a_move_are_no_variables(tmp_path: Path) -> None:
    t = read(tmp_path, SIEMENS + "DEF REAL DEPTH\nDEPTH=3\nG1 X20 FD=50\nG4 S2\nX=DEPTH\nM30\n")
    assert [w.word for w in t.ignored if not w.understood] == ["FD="]
    assert mm(t)[-1] == [3, 0, 0]
    assert not [e for e in t.events if e.kind == "spindle"]


@pytest.mark.parametrize("name", ["CIRCUL", "MILL", "THREAD"])
def test_cycles_other_than_holes_are_refused(tmp_path: Path, name: str) -> None:
    text = f"PARTNO/A\nUNITS/MM\nRAPID\nGOTO/0,0,9\nFEDRAT/100,MMPM\nCYCLE/{name},DEPTH,5,CLEAR,2\nGOTO/1,0,0\nFINI\n"
    with pytest.raises(InputError, match=rf"line 6: CYCLE: CYCLE/{name} .*not read"):
        read(tmp_path, text)
