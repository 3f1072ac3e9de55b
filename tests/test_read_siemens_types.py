"""Variables of Sinumerik programs take the type of their definition.

The expected numbers follow the rules of the Programming Manual Job Planning ("Implicit data type conversions"): a
fraction of 0.5 is rounded up, any other to the nearest whole number; BOOL is 0 or 1; a value out of range is an alarm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "%_N_X_MPF\n{definitions}G71 G90 G17 G94 G54\nG0 X0 Y0 Z10\nG1 Z-1 F200\n"

# definitions, statements, subprograms, x of every point after the head
VALUES = {
    "start value": ("DEF INT N=2.5\n", "X=N\n", "", [3]),
    "start value below a half": ("DEF INT N=2.49\n", "X=N\n", "", [2]),
    "negative half": ("DEF INT N=-2.5\n", "X=N\n", "", [-2]),
    "negative": ("DEF INT N=-2.6\n", "X=N\n", "", [-3]),
    "assignment": ("DEF INT N\n", "N=7/2\nX=N\n", "", [4]),
    "assignment of a formula": ("DEF INT N\nDEF REAL W=1.4\n", "N=W*W\nX=N\n", "", [2]),
    "assignment to itself": ("DEF INT N=1\n", "N=N*1.5\nX=N\nN=N*1.5\nX=N\n", "", [2, 3]),
    "several in one DEF": ("DEF INT N=1.6, M=2.4, L\n", "X=N\nX=M\nX=L\n", "", [2, 2, 0]),
    "REAL keeps fractions": ("DEF REAL W\n", "W=7/2\nX=W\n", "", [3.5]),
    "R keeps fractions": ("DEF INT N=2\n", "R1=N/4\nX=R1\n", "", [0.5]),
    "BOOL of a number": ("DEF BOOL B\n", "B=7.5\nX=B\n", "", [1]),
    "BOOL of a small fraction": ("DEF BOOL B=0.2\n", "X=B\n", "", [1]),
    "BOOL in IF": ("DEF BOOL B=0.4\n", "IF B\nX5\nENDIF\nX6\n", "", [5, 6]),
    "BOOL of a comparison": ("DEF BOOL B\n", "B=3>2\nX=B*4\n", "", [4]),
    "CHAR": ("DEF CHAR C=65.5\n", "X=C\n", "", [66]),
    "single letter": ("DEF INT H=1.5\n", "X=H\n", "", [2]),
    "array": ("DEF INT A[3]\n", "A[1]=2.5\nX=A[1]\nX=A[2]\n", "", [3, 0]),
    "array with SET": ("DEF INT A[3]=SET(1.5,2.4,9)\n", "X=A[0]\nX=A[1]\nX=A[2]\n", "", [2, 2, 9]),
    "array with fewer values": ("DEF REAL A[3]=SET(1.5)\n", "X=A[0]\nX=A[2]\n", "", [1.5, 0]),
    "array with REP": ("DEF REAL A[2]=REP(4.5)\n", "X=A[0]\nX=A[1]\n", "", [4.5, 4.5]),
    "index in a variable": ("DEF REAL A[3]=SET(1,2,3)\nDEF INT I\n", "FOR I=0 TO 2\nX=A[I]\nENDFOR\n", "", [1, 2, 3]),
    "index of a formula": (
        "DEF REAL A[3]=SET(1,2,3)\nDEF INT I=1\n",
        "X=A[I+1]\nX=A[2*I-1]\nX=A[ I ]\n",
        "",
        [3, 2, 2],
    ),
    "index of another array": (
        "DEF REAL A[3]=SET(1,2,3)\nDEF INT B[2]=SET(2,0)\n",
        "X=A[B[0]]\nX=A[B[1]]\n",
        "",
        [3, 1],
    ),
    "index of R": ("", "R1=5 R5=7 R6=8\nX=R[R1]\nX=R[R1+1]\n", "", [7, 8]),
    "element by an index assigned": (
        "DEF INT A[3]\nDEF INT I=1\n",
        "A[I]=2.5\nA[I+1]=A[I]*2\nX=A[1]\nX=A[2]\n",
        "",
        [3, 6],
    ),
    "R by an index assigned": ("", "R1=4\nR[R1]=9\nR[R1+1]=R[R1]+1\nX=R4\nX=R5\n", "", [9, 10]),
    "a letter read in an index alone": ("DEF REAL A[3]\nDEF INT H\n", "H=2\nA[H]=6\nX=A[2]\n", "", [6]),
    "loop over an element": ("DEF INT A[2]\nDEF INT I=1\n", "FOR A[I]=1 TO 3\nX=A[1]\nENDFOR\n", "", [1, 2, 3]),
    "blanks in an index": ("DEF REAL A[4]\nDEF INT I=2\n", "A [ I ] = 9\nX=A[2]\n", "", [9]),
    "element in a condition": ("DEF INT A[2]=SET(0,1)\nDEF INT I=1\n", "IF A[I]==1\nX5\nENDIF\n", "", [5]),
    "element under IC": ("DEF REAL A[2]=SET(1,2)\nDEF INT I=1\n", "X=IC(A[I])\n", "", [2]),
    "element as an argument": ("DEF INT A[2]=SET(4,6)\nDEF INT I=1\n", "UP(A[I])\n", "PROC UP(INT B)\nX=B\nM17\n", [6]),
    "element returned": (
        "DEF INT A[2]\nDEF INT I=1\n",
        "UP(A[I])\nX=A[1]\nX=A[0]\n",
        "PROC UP(VAR REAL B)\nB=4.7\nM17\n",
        [5, 0],
    ),
    "loop over INT": ("DEF INT I\n", "FOR I=0.6 TO 3\nX=I\nENDFOR\n", "", [1, 2, 3]),
    "parameter assigned": ("", "UP(1)\n", "PROC UP(INT A)\nA=A*2.5\nX=A\nM17\n", [3]),
    "returned to INT": ("DEF INT N=1\n", "UP(N)\nX=N\n", "PROC UP(VAR REAL A)\nA=4.7\nM17\n", [5]),
    "type of the caller again": (
        "DEF REAL W=0.5\n",
        "UP\nW=W*0.5\nX=W\n",
        "%_N_UP_SPF\nPROC UP\nDEF INT W=3\nX=W\nM17\n",
        [3, 0.25],
    ),
    "ROUND of a half": ("", "X=ROUND(2.5)\nX=ROUND(0.5)\nX=ROUND(3.5)\n", "", [3, 1, 4]),
    "ROUND of a negative half": ("", "X=ROUND(-2.5)\n", "", [-2]),
    "MOD": ("", "R1=7 MOD 3 R2=-7 MOD 3\nX=R1\nX=R2\n", "", [1, -1]),
    "DIV": ("", "R1=7 DIV 2\nX=R1\n", "", [3]),
    "TRUNC": ("", "X=TRUNC(-2.7)\nX=TRUNC(2.7)\n", "", [-2, 2]),
    "ROUNDUP": ("", "X=ROUNDUP(3.1)\nX=ROUNDUP(3)\nX=ROUNDUP(-3)\n", "", [4, 3, -3]),
}


@pytest.mark.parametrize("name", VALUES)
def test_variable_has_the_value_of_its_type(tmp_path: Path, name: str) -> None:
    definitions, body, subprograms, expected = VALUES[name]
    file = tmp_path / "part.mpf"
    file.write_text(HEAD.format(definitions=definitions) + body + "M30\n" + subprograms, encoding="utf-8")
    position = read_toolpath(file).position
    np.testing.assert_allclose(position[2:, 0] * 1e3, expected, atol=1e-9)


REFUSED = {
    "INT out of range": ("DEF INT N=3000000000\n", "X1\n", "N is of type INT"),
    "INT out of range later": ("DEF INT N=2000000000\n", "N=N*2\n", "N is of type INT"),
    "CHAR out of range": ("DEF CHAR C=256\n", "X1\n", "CHAR"),
    "two dimensions": ("DEF INT A[2,3]\n", "X1\n", "A[2,3]"),
    "no size": ("DEF INT A[N]\n", "X1\n", "A[N]"),
    "no such element": ("DEF INT A[2]\n", "A[2]=1\n", "A[2]"),
    "no such element read": ("DEF INT A[2]\n", "X=A[2]\n", "A[2]"),
    "no such element by an index": ("DEF INT A[2]\nDEF INT I=2\n", "X=A[I]\n", "A[2]"),
    "no such element by an index assigned": ("DEF INT A[2]\nDEF INT I=2\n", "A[I]=1\n", "A[2]"),
    "a negative index": ("DEF INT A[2]\nDEF INT I=-1\n", "X=A[I]\n", "A[-1]"),
    "a fraction as index": ("DEF INT A[2]\n", "R1=0.5\nX=A[R1]\n", "A[0.5]"),
    "an index that is not set": ("DEF INT A[2]\n", "X=A[R1]\n", "R1"),
    "two indices": ("DEF INT A[2]\nDEF INT I\n", "X=A[I,1]\n", "dimensions"),
    "an index that is not closed": ("DEF INT A[2]\nDEF INT I\n", "X=A[I\n", "A"),
    "a variable of the control": ("", "X=$AA_IM[X]\n", "$AA_IM"),
    "a variable of the control in a formula": ("", "R1=2*($P_UIFR[1,Y,TR]+1)\nX=R1\n", "$P_UIFR"),
    "SET behind the definition": ("DEF INT A[2]\n", "A[0]=SET(1,2)\nX=A[1]\n", "SET"),
    "too many values": ("DEF INT A[2]=SET(1,2,3)\n", "X1\n", "3 values"),
    "SET for one variable": ("DEF INT A=SET(1)\n", "X1\n", "SET"),
    "one value for an array": ("DEF INT A[2]=1\n", "X1\n", "SET"),
    "further words": ("DEF INT A PHU 3\n", "X1\n", "PHU"),
    "no value": ("DEF INT A=\n", "X1\n", "A="),
    "STRING": ("DEF STRING[20] T\n", "X1\n", "DEF"),
    "AXIS": ("DEF AXIS A\n", "X1\n", "DEF"),
    "loop from a fraction": ("", "FOR R1=0.5 TO 3\nX=R1\nENDFOR\n", "0.5"),
    "loop to a fraction": ("", "FOR R1=1 TO 2.5\nX=R1\nENDFOR\n", "2.5"),
    "CASE of a fraction": ("", "R1=1.5\nCASE R1 OF 1 GOTOF A1\nA1: X1\n", "CASE 1.5"),
    "MOD of a fraction": ("", "R1=7.5 MOD 2\nX=R1\n", "MOD"),
    "ROUNDUP below zero": ("", "X=ROUNDUP(-3.1)\n", "ROUNDUP"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_invalid_definition_is_refused(tmp_path: Path, name: str) -> None:
    definitions, body, word = REFUSED[name]
    file = tmp_path / "part.mpf"
    file.write_text(HEAD.format(definitions=definitions) + body + "X9\nM30\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_toolpath(file)
    assert word in str(caught.value)
