"""Subprograms, loops and formulas of a file: points equal those of the expanded program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.readers.program_flow.macro_expressions import MacroExpressionError, MacroParameters
from machopt.toolpath.readers.siemens.siemens_expressions import SiemensVariables
from machopt.toolpath.toolpath_reader import read_toolpath


def read(tmp_path: Path, text: str, name: str = "part.nc", **options: object) -> Toolpath:
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, **options)  # type: ignore[arg-type]


def xs(toolpath: Toolpath) -> list[float]:
    return np.round(toolpath.position[:, 0] * 1e3, 6).tolist()


# ---- Fanuc and Haas


def test_m98_with_repeats_returns_to_its_call(tmp_path: Path) -> None:
    text = (
        "%\nO1\nG21 G90\nG0 X0 Y0 Z0\nG1 F100\nM98 P20 L3\nG90 G1 X99\nM30\nO20\nG91 G1 X1\nM98 P30\nM99\n"
        "O30\nY1\nM99\n%\n"
    )
    t = read(tmp_path, text)
    assert xs(t) == [0, 1, 1, 2, 2, 3, 3, 99]
    assert np.round(t.position[-1, 1] * 1e3, 6) == 3.0
    assert t.line.tolist() == [4, 10, 14, 10, 14, 10, 14, 7]
    old = read(tmp_path, text.replace("P20 L3", "P30020"))  # program 20, three times
    assert xs(old) == xs(t)


def test_haas_local_subprogram(tmp_path: Path) -> None:
    t = read(tmp_path, "O1\nG21 G90\nG0 X0 Y0 Z0\nG1 F100\nM97 P50 L2\nM30\nN50 G91 X5\nM99\n")
    assert xs(t) == [0, 5, 10]


def test_macro_with_arguments_conditions_and_loops(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "O1\nG21 G90\n#100=2\nG0 X0 Y0 Z0\nG1 F100\nG65 P9 A10 B[#100+1]\nIF[#100 EQ 2]GOTO 70\nX500\nN70 X7\n"
        "IF[#100 LT 5]THEN #100=1\nWHILE[#100 LE 2]DO1\nX[#100*100]\n#100=#100+1\nEND1\nM30\nO9\nX[#1+#2]\nM99\n",
    )
    assert xs(t) == [0, 13, 7, 100, 200]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\nM98 P100\nM30\n", "line 4: M98 P100 calls a subprogram that is not in this file"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\nG65 P100 A1\nM30\n", "line 4: G65 P100 calls a macro that is not in this file"),
        ("G21\nG0 X0 Y0 Z0\nN5 G1 X1 F5\nGOTO 5\nM30\n", "it never ends"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\nGOTO 6\nM30\n", "line 4: GOTO 6: no block N6"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\n#1=0\nWHILE[1 EQ 1]DO1\n#1=#1+1\nEND1\nM30\n", "without ever moving"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\nEND1\nM30\n#1=1\nWHILE[1]DO2\nEND2\n", "line 4: END1 without WHILE"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\n#1=1/0\nM30\n", "line 4: division by zero"),
        ("G21\nO1\nM98 P2\nM30\nO2\nM98 P2\nM99\n", "nested calls"),
        ("G21\no1 sub\nG1 X1 F1\no1 endsub\nM2\n", "defines subroutines and calls none"),
        ("G21\nG0 X0 Y0 Z0\nG1 X1 F5\no7 call\nM2\n", "line 4: O7 CALL: that subroutine is not in this file"),
    ],
)
def test_unsupported_flow_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(tmp_path, text)


# ---- LinuxCNC


def test_o_words(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "G21 G90\nG0 X0 Y0 Z0\nG1 F100\no<row> sub\n#<n> = 0\no1 repeat [#2]\n  X[#1 + #<n>]\n  #<n> = [#<n> + 1]\n"
        "o1 endrepeat\no<row> endsub\no<row> call [10] [2]\no<row> call [20] [3]\n#5 = 3\no2 while [#5 GT 0]\n"
        "o3 if [#5 EQ 2]\no2 continue\no3 elseif [#5 EQ 1]\nX1000\no3 else\nX[#5]\no3 endif\n#5 = [#5 - 1]\n"
        "o2 endwhile\nM2\n".replace("o2 continue", "X2000"),
    )
    assert xs(t) == [0, 10, 11, 20, 21, 22, 3, 2000, 1000]


def test_names_of_a_subroutine_are_local() -> None:
    p = MacroParameters()
    p.evaluate("#<_shared>=1 #<own>=2 #5=3 #100=4")
    p.enter({"1": 9.0})
    assert p.number("#<_shared> + #1") == 10.0
    with pytest.raises(MacroExpressionError, match="before it is set"):
        p.number("#<own>")
    p.evaluate("#100=7 #5=8")
    p.leave()
    assert (p.number("#<own>"), p.number("#5"), p.number("#100")) == (2.0, 3.0, 7.0)


# ---- Siemens


def test_siemens_parameters_jumps_and_blocks(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "G71 G90\nDEF REAL W=2, H\nR1=10 R2=R1/4\nG0 X0 Y0 Z0\nG1 F100\nX=R1+R2\nH=SQRT(16)\nIF H>3 GOTOF AHEAD\nX999\n"
        "AHEAD: X=H\nWHILE W<4\nX=W*100\nW=W+1\nENDWHILE\nREPEAT\nW=W-1\nUNTIL W<=2\nFOR R5=1 TO 2\nX=R5\nENDFOR\n"
        "IF (R1==10) AND (R2<>1)\nX=50\nELSE\nX=60\nENDIF\nR[7]=IC(3)\nM30\n".replace("R[7]=IC(3)\n", "X=IC(-R[1])\n"),
        "part.mpf",
    )
    assert xs(t) == [0, 12.5, 4, 200, 300, 1, 2, 50, 40]


def test_siemens_subprogram_in_the_same_file(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "%_N_MAIN_MPF\nG71 G90\nG0 X0 Y0 Z0\nG1 F100\nSLOT\nX9\nM30\n%_N_SLOT_SPF\nG91 X1\nG90\nM17\n",
        "part.mpf",
    )
    assert xs(t) == [0, 1, 9]
    with pytest.raises(InputError, match="L77 calls a subprogram that is not in this file"):
        read(tmp_path, "G71 G90\nG0 X0 Y0 Z0\nG1 X1 F100\nR1=1\nL77\nM30\n", "part.mpf")


def test_older_control_cycle_uses_r_parameters(tmp_path: Path) -> None:
    t = read(tmp_path, "G71 G90 G17\nG0 X0 Y0 Z20\nG81 X8 Y0 R2=3 R3=-5 R10=10 F250\nX-5\nG80\nM30\n", "part.mpf")
    assert np.round(t.position[t.cutting] * 1e3, 6).tolist() == [[8, 0, -5], [-5, 0, -5]]
    assert np.round(t.position[-1, 2] * 1e3, 6) == 10.0


@settings(max_examples=scale_example_count(80), deadline=None)
@given(a=st.integers(-50, 50), b=st.integers(1, 9), c=st.floats(-80.0, 80.0))
def test_expressions_agree_with_python(a: int, b: int, c: float) -> None:
    v = SiemensVariables()
    v.values.update(R1=float(a), R2=float(b), R3=c)
    text = "R1*R2-(R1+2)/R2+SIN(R3)*COS(R3)-ABS(R1) MOD R2+POT(R2)*(R1>R2)"
    r = np.radians(c)
    expected = a * b - (a + 2) / b + np.sin(r) * np.cos(r) - np.fmod(abs(a), b) + b * b * (a > b)
    assert v.value(text) == pytest.approx(expected, abs=1e-9)
    p = MacroParameters()
    p.evaluate(f"#1={a} #2={b}")
    assert p.number("[#1*#2 - [#1+2]/#2 + #2**2]") == pytest.approx(a * b - (a + 2) / b + b**2)


@pytest.mark.parametrize("text", ["R1", "1/0", "SQRT(-1)", "(1", "SIN(1,2)", "1 2", "$AA_IM[X]", "((" * 60 + "1", ""])
def test_siemens_expressions_without_a_value(text: str) -> None:
    with pytest.raises(MacroExpressionError):
        SiemensVariables().value(text)


# ---- Heidenhain


def test_labels_repeats_and_q_parameters(tmp_path: Path) -> None:
    t = read(
        tmp_path,
        "BEGIN PGM A MM\nQ1 = +5\nFN 1: Q2 = +Q1 + +2\nL X+0 Y+0 Z+0 FMAX\nCALL LBL 5\nL X+Q2 F100\nLBL 1\nL IX+1\n"
        "CALL LBL 1 REP 2\nFN 9: IF +Q2 EQU +7 GOTO LBL 9\nL X+999\nLBL 9\nL X-Q1\nM30\nLBL 5\nL X+50 F100\nLBL 0\n"
        "END PGM A MM\n",
        "a.h",
    )
    assert xs(t) == [0, 50, 7, 8, 9, 10, -5]
    with pytest.raises(InputError, match="Q9 is read before it is set"):
        read(tmp_path, "BEGIN PGM A MM\nL X+0 Y+0 Z+0 FMAX\nL X+Q9 F1\nEND PGM A MM\n", "a.h")


def test_other_program_is_reported_and_refused_where_the_path_continues(tmp_path: Path) -> None:
    head = "BEGIN PGM A MM\nL X+0 Y+0 Z+0 FMAX\nL X+5 F100\nCALL PGM TNC:\\FIN\n"
    t = read(tmp_path, head + "END PGM A MM\n", "a.h")
    assert [(w.word, w.understood) for w in t.ignored] == [("CALL PGM", False)]
    with pytest.raises(InputError, match=r"line 5: CALL PGM TNC:.FIN is called in line 4"):
        read(tmp_path, head + "L X+9\nEND PGM A MM\n", "a.h")
