"""Subprograms, repeats and jumps of Sinumerik programs: points equal those of the expanded program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "%_N_X_MPF\nG71 G90 G17 G94 G54\nG0 X0 Y0 Z10\nG1 Z-1 F200\n"


def read(tmp_path: Path, text: str) -> Toolpath:
    file = tmp_path / "part.mpf"
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file)


def list_points(toolpath: Toolpath) -> list[tuple[float, ...]]:
    return [tuple(p) for p in np.round(toolpath.position[2:, :2] * 1e3, 6).tolist()]


# main program after HEAD, subprograms, x and y of every point after HEAD
CASES = {
    "L with repeats": ("G91\nL100 P2\nM30\n", "%_N_L100_SPF\nX1\nM17\n", [(1, 0), (2, 0)]),
    "P=": ("G91\nL100 P=1+2\nM30\n", "%_N_L100_SPF\nX1\nM17\n", [(1, 0), (2, 0), (3, 0)]),
    "P before the name": ("G91\nP2 L100\nM30\n", "%_N_L100_SPF\nX1\nM17\n", [(1, 0), (2, 0)]),
    "zeros of a name count": (
        "L1\nL001\nM30\n",
        "%_N_L001_SPF\nX7\nM17\n%_N_L1_SPF\nX1\nM17\n",
        [(1, 0), (7, 0)],
    ),
    "name with repeats": ("G91\nSLOT P2\nM30\n", "%_N_SLOT_SPF\nPROC SLOT\nX1\nRET\n", [(1, 0), (2, 0)]),
    "a value": ("KONTUR(5)\nM30\n", "%_N_KONTUR_SPF\nPROC KONTUR(REAL A)\nY=A\nM17\n", [(0, 5)]),
    "an expression": ("R1=2\nKONTUR(R1*4)\nM30\n", "PROC KONTUR(REAL A)\nY=A\nM17\n", [(0, 8)]),
    "a default": ("KONTUR(,3)\nM30\n", "PROC KONTUR(REAL A=2.5, INT B, REAL C=1)\nX=A Y=B\nM17\n", [(2.5, 3)]),
    "INT rounds": ("KONTUR(2.5)\nM30\n", "PROC KONTUR(INT A)\nX=A\nM17\n", [(3, 0)]),
    "BOOL": ("KONTUR(7)\nM30\n", "PROC KONTUR(BOOL A)\nX=A\nM17\n", [(1, 0)]),
    "values with repeats": ("G91\nK2(2) P2\nM30\n", "PROC K2(REAL A)\nX=A\nA=9\nM17\n", [(2, 0), (4, 0)]),
    "VAR": (
        "DEF REAL W=1\nKONTUR(W,4)\nX=W\nM30\n",
        "PROC KONTUR(VAR REAL A, REAL B)\nX=A\nA=B\nB=99\nM17\n",
        [(1, 0), (4, 0)],
    ),
    "variables are the subprogram's own": (
        "DEF REAL A=1\nKONTUR(5)\nX=A\nM30\n",
        "PROC KONTUR(REAL A)\nDEF REAL B=2\nX=A+B\nM17\n",
        [(7, 0), (1, 0)],
    ),
    "nested values": (
        "K1(2)\nM30\n",
        "PROC K1(REAL A)\nK2(A+1)\nX=A\nM17\n%_N_K2_SPF\nPROC K2(REAL A)\nX=A\nRET\n",
        [(3, 0), (2, 0)],
    ),
    "CALL": ('CALL "SLOT"\nM30\n', "%_N_SLOT_SPF\nX3\nM17\n", [(3, 0)]),
    "PCALL": ("PCALL SLOT(4)\nM30\n", "PROC SLOT(REAL A)\nX=A\nM17\n", [(4, 0)]),
    "EXTERN": ("EXTERN SLOT(REAL)\nSLOT(4)\nM30\n", "PROC SLOT(REAL A)\nX=A\nM17\n", [(4, 0)]),
    "MCALL": (
        "MCALL SLOT(1)\nX10\nY5\nMCALL\nX20\nM30\n",
        "PROC SLOT(REAL A)\nG91 X=A\nG90\nM17\n",
        [(10, 0), (11, 0), (11, 5), (12, 5), (20, 5)],
    ),
    "no M17": ("SLOT\nX9\nM30\n", "%_N_SLOT_SPF\nX3\n%_N_SLOT2_SPF\nX77\nM17\n", [(3, 0), (9, 0)]),
    "no M17 in the last one": ("SLOT\nX9\nM30\n", "%_N_SLOT_SPF\nX3\n", [(3, 0), (9, 0)]),
    "M30 in a subprogram": ("SLOT\nX9\nM30\n", "%_N_SLOT_SPF\nX3\nM30\n", [(3, 0), (9, 0)]),
    "SAVE": ("SLOT\nX9\nM30\n", "PROC SLOT SAVE\nG91 G0 X3\nM17\n", [(3, 0), (9, 0)]),
    "words with the return": ("SLOT\nX9\nM30\n", "PROC SLOT SAVE\nG91 X3 M17\n", [(3, 0), (9, 0)]),
    "labels of another program": (
        "GOTOF ENDE\nX5\nENDE: X6\nSLOT\nM30\n",
        "%_N_SLOT_SPF\nGOTOF ENDE\nX7\nENDE: X8\nM17\n",
        [(6, 0), (8, 0)],
    ),
    "REPEATB block number": ("N10 G91 X2\nREPEATB N10 P=2\nM30\n", "", [(2, 0), (4, 0), (6, 0)]),
    "REPEAT block numbers": (
        "G91\nN10 X1\nN20 Y1\nN30 X5\nREPEAT N10 N20 P=1\nM30\n",
        "",
        [(1, 0), (1, 1), (6, 1), (7, 1), (7, 2)],
    ),
    "REPEAT P R1": ("R1=2\nG91\nA1: X1\nREPEAT A1 P=R1\nM30\n", "", [(1, 0), (2, 0), (3, 0)]),
    "ENDLABEL": (
        "G91\nA1: X1\nENDLABEL: Y1\nX5\nREPEAT A1 P=1\nM30\n",
        "",
        [(1, 0), (1, 1), (6, 1), (7, 1), (7, 2)],
    ),
    "a part ahead": (
        "G91\nREPEAT A1 A2 P=2\nGOTOF E1\nA1: X1\nA2: Y1\nE1: X9\nM30\n",
        "",
        [(1, 0), (1, 1), (2, 1), (2, 2), (11, 2)],
    ),
    "a call in a repeated block": (
        "G91\nA1: SLOT\nREPEATB A1 P=2\nM30\n",
        "%_N_SLOT_SPF\nX1\nM17\n",
        [(1, 0), (2, 0), (3, 0)],
    ),
    "CASE": (
        "R1=2\nCASE R1 OF 1 GOTOF A1 2 GOTOF A2 DEFAULT GOTOF A3\nA1: X1\nA2: X2\nA3: X3\nM30\n",
        "",
        [(2, 0), (3, 0)],
    ),
    "GOTOC": ("GOTOC A9\nX1\nM30\n", "", [(1, 0)]),
}


@pytest.mark.parametrize("name", CASES)
def test_points_equal_those_of_the_expanded_program(tmp_path: Path, name: str) -> None:
    main, subprograms, expected = CASES[name]
    assert list_points(read(tmp_path, HEAD + main + subprograms)) == expected


REFUSED = {
    "too many values": ("KONTUR(1,2)\n", "PROC KONTUR(REAL A)\nY=A\nM17\n", 5, "2 values"),
    "a string": ('KONTUR("A")\n', "PROC KONTUR(STRING[9] A)\nY1\nM17\n", 5, "STRING"),
    "VAR of a number": ("KONTUR(1)\n", "PROC KONTUR(VAR REAL A)\nY1\nM17\n", 5, "VAR A"),
    "no value": ("KONTUR(B)\n", "PROC KONTUR(REAL A)\nY1\nM17\n", 5, "B"),
    "no type": ("X1\n", "%_N_KONTUR_SPF\nPROC KONTUR(A)\nY1\nM17\n", 8, "'A'"),
    "P0": ("L1 P0\n", "%_N_L1_SPF\nY1\nM17\n", 5, "P0"),
    "other words": ("X5 L1\n", "%_N_L1_SPF\nY1\nM17\n", 5, "L1"),
    "not in this file": ("X1\nL7 P2\n", "", 6, "L7"),
    "a name that is not in this file": ("X1\nKONTUR(5)\n", "", 6, "KONTUR"),
    "CALL of another file": ('X1\nCALL "KONTUR"\n', "", 6, "CALL"),
    "jump into another program": ("GOTOF A1\n", "%_N_L1_SPF\nA1: Y1\nM17\n", 5, "A1"),
    "jump back to what is ahead": ("GOTOB A1\nA1: X1\n", "", 5, "A1"),
    "block number": ("GOTOF N99\n", "", 5, "N99"),
    "REPEATB of nothing": ("X1\nREPEATB N10 P=2\n", "", 6, "N10"),
    "REPEAT to nothing": ("A1: X1\nREPEAT A1 A2 P=2\n", "", 6, "A2"),
    "REPEAT around itself": ("A1: X1\nREPEAT A1 A2 P=2\nA2: X2\n", "", 6, "A1"),
    "REPEAT of a share": ("A1: X1\nREPEAT A1 P=1.5\n", "", 6, "1.5"),
    "CASE without OF": ("CASE R1 GOTOF A1\nA1: X1\n", "", 5, "CASE"),
    "SAVE with a frame": ("SLOT\nX9\n", "PROC SLOT SAVE\nTRANS X5\nX3\nM17\n", 11, "SAVE"),
    "calls itself": ("L1\n", "%_N_L1_SPF\nL1\nM17\n", 8, "nested"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unsupported_flow_names_line_and_word(tmp_path: Path, name: str) -> None:
    main, subprograms, line, word = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read(tmp_path, HEAD + main + "M30\n" + subprograms)
    text = str(caught.value)
    assert f"line {line}:" in text
    assert word in text


HEAD_LINES = "%_N_MAIN_MPF\nN10 G90 G54 G71\nN20 T1 M6\nN30 S300 M3 F200\nN40 G0 X0 Y0 Z50\n"


def read_cuts(tmp_path: Path, body: str) -> np.ndarray:
    file = tmp_path / "program.mpf"
    file.write_text(HEAD_LINES + body, encoding="utf-8")
    path = read_toolpath(file)
    return 1e3 * path.position[path.move == MoveKind.CUT]


def test_each_pass_of_a_subprogram_restores_the_saved_modes(tmp_path: Path) -> None:
    cuts = read_cuts(tmp_path, "R5=10\nUP P2\nM30\n%_N_UP_SPF\nPROC UP SAVE\nG1 X=R5\nG91 Y10\nM17\n")
    np.testing.assert_allclose(cuts[:, :2], [[10, 0], [10, 10], [10, 10], [10, 20]])


def test_each_pass_uses_the_value_of_a_returned_parameter(tmp_path: Path) -> None:
    cuts = read_cuts(tmp_path, "R1=0\nUP(R1) P3\nG1 X=R1\nM30\n%_N_UP_SPF\nPROC UP(VAR REAL B)\nB=B+1\nM17\n")
    np.testing.assert_allclose(cuts[-1, 0], 3)


@pytest.mark.parametrize("text", ["BOHRUNG A1", "X5 Y7", "Z-3.", "C=90"])
def test_message_calls_no_modal_subprogram(tmp_path: Path, text: str) -> None:
    body = f'MCALL DRILL\nG0 X10 Y10\nMSG("{text}")\nG0 X20\nMCALL\nM30\n%_N_DRILL_SPF\nG1 G91 Z-5\nZ5\nG90\nM17\n'
    assert len(read_cuts(tmp_path, body)) == 4  # two positions, down and up


@pytest.mark.parametrize("name", ["10", "5", "100"])
def test_number_is_not_a_call_of_a_numeric_program_name(tmp_path: Path, name: str) -> None:
    file = tmp_path / "program.mpf"
    file.write_text(f"%_N_{name}_MPF\nG90 G71\nT1 M6\nS300 M3 F200\nR1={name}\nG1 X-{name} Y5\nM30\n", encoding="utf-8")
    np.testing.assert_allclose(1e3 * read_toolpath(file).position[-1, :2], [-float(name), 5])
