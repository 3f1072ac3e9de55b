"""Damaged programs are read or refused with a reason; a large run is benchmarks/fuzz.py."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from program_mutations import FORMATS, run, seeds

from machopt.errors import InputError
from machopt.programs.program_reader import read_program


@pytest.mark.parametrize("form", FORMATS)
def test_damaged_programs_never_crash_the_reader(tmp_path: Path, form: str) -> None:
    found = sum((run(place, 60, random.Random(k)) for k, place in enumerate(seeds(tmp_path, form))), Counter())
    assert found["read"] > 0  # some faults are in comments
    assert found["refused"] > 10


POSE = "{X 1,Y 1,Z 1,A 0,B 0,C 0}"


def module(*lines: str) -> str:
    return "\n".join(["MODULE m", "PROC a()", *lines, "ENDPROC", "ENDMODULE", ""])


def ls(line: str, position: str = "", more: str = "") -> str:
    return f"/PROG a\n/MN\n1:{line} ;\n{more}/POS\n{position}\n/END\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.src", "DEF a()\nFOR i=1 TO 99999999\nLIN " + POSE + "\nENDFOR\nEND\n", "line 2: FOR runs 99999999 times"),
        ("a.src", "DEF a()\na()\nEND\n", "calls itself"),
        ("a.src", "DEF a()\nIF $IN[1] THEN\nLIN " + POSE + "\nENDIF\nEND\n", "line 2: IF decides about moves"),
        ("a.src", "DEF a()\nLIN_REL {X 1}\nEND\n", "line 2: LIN_REL starts"),
        ("a.src", "DEF a()\nLIN XP1\nEND\n", "line 2: XP1 is declared in none of the files read"),
        ("a.src", "DEF a()\nLIN {X 1,Y 1}\nEND\n", "line 2: Z is not given here or earlier"),
        ("a.src", "DEF a()\nPTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 1e9}\nEND\n", "axis at 1e[+]09 degrees"),
        ("a.src", "DEF a()\nLIN " + POSE + ":{X 1}\nEND\n", "chained by a colon"),
        ("a.mod", module("MoveL p1,v100,fine,tool0;"), "line 3: p1 is declared in none"),
        ("a.mod", module("MoveL [[0,0,0],[1,1,1,1],[0,0,0,0],[9E9]],v1,fine,tool0;"), "not of unit length"),
        ("a.mod", module("MoveL Offs(p1,1+2,0,0),v1,fine,tool0;"), "formulas are not evaluated"),
        ("a.mod", module("GOTO x;"), "jumps are not followed"),
        ("a.mod", "MODULE m\nPROC a()\nENDPROC\nPROC b()\nENDPROC\nENDMODULE\n", "2 procedures that nothing calls"),
        ("a.ls", ls("L P[1] 10mm/sec FINE"), r"line 3: P\[1\] is not in /POS"),
        ("a.ls", ls("L PR[1] 10mm/sec FINE"), "position register"),
        ("a.ls", ls("L P[1] 10mm/sec FINE", "P[1]{ X=1, Y=1, Z=1, W=0, P=0, R=0 };", "2:JMP LBL[1] ;\n"), "order"),
        ("a.ls", ls("L P[1] 10mm/sec FINE", "P[1]{ GP1: X = ****** mm, Y = 1 mm };"), "X is not taught"),
        ("a.JBI", "/JOB\n//POS\n///PULSE\nC00000=1,2,3\n//INST\nNOP\nEND\n", "C00000 has 3 numbers"),
        ("a.JBI", "/JOB\n//POS\n//INST\nMOVC C00000 V=1\nEND\n", "MOVC is not read"),
        ("a.script", "def a():\n  while True:\n    movel(p[0,0,0,0,0,0])\n  end\nend\n", "decides about moves"),
        ("a.script", "def a():\n  movel(get_actual_tcp_pose())\nend\n", "holds no moves that can be read"),
        ("a.script", "def a():\n  movel(p[0,0,0,0,0])\nend\n", "a pose of 5 numbers"),
        ("a.yaml", "joint_names: [a]\npoints: [1]\n", "moves 1 joints"),
        ("a.json", '{"machopt_program": 1, "moves": [{"item": "lin"}]}', "q_deg: expected a list of 6 numbers"),
        ("a.csv", "# machopt_program 1\nitem,q1_deg\n", "missing"),
        ("a.txt", "hello\n", "not recognised as a robot program; readable are"),
    ],
)
def test_refusals_state_place_and_accepted_values(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_program(tmp_path / name)
    assert name in str(caught.value)


def test_arcs_become_chords(tmp_path: Path) -> None:
    """A quarter circle of radius 100 mm, in three languages, on the circle and within the arc tolerance."""
    texts = {
        "a.src": "DEF a()\n$VEL.CP=0.1\nLIN {X 100,Y 0,Z 5,A 0,B 0,C 180}\n"
        "CIRC {X 70.710678,Y 70.710678,Z 5,A 0,B 0,C 180},{X 0,Y 100,Z 5,A 90,B 0,C 180} C_DIS\nEND\n",
        "a.mod": module(
            "MoveL [[100,0,5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;",
            "MoveC [[70.710678,70.710678,5],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],"
            "[[0,100,5],[0,0.70710678,0.70710678,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z1,tool0;",
        ),
        "a.script": "movel(p[0.1,0,0.005,3.14159265,0,0],v=0.1)\nmovec(p[0.070710678,0.070710678,0.005,3.14159265,0,0],"
        "p[0,0.1,0.005,2.22144147,2.22144147,0],a=1,v=0.1,r=0.001)\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        parsed = read_program(tmp_path / name)
        p = parsed.T_base_tcp[:, :3, 3]
        assert len(parsed) > 50, name
        np.testing.assert_allclose(np.hypot(p[:, 0], p[:, 1]), 0.1, atol=2e-8)
        middle = (p[1:] + p[:-1]) / 2
        assert (0.1 - np.hypot(middle[:, 0], middle[:, 1])).max() < 5e-6  # the default arc tolerance
        np.testing.assert_allclose(p[-1], [0, 0.1, 0.005], atol=1e-9)
        end = parsed.T_base_tcp[-1, :3, :3]
        np.testing.assert_allclose(end, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-7)
        np.testing.assert_allclose(parsed.feed, 0.1)
        turn = np.arctan2(parsed.T_base_tcp[:, 1, 0], parsed.T_base_tcp[:, 0, 0])
        assert (np.diff(turn) > 0).all()  # uniform rotation along the arc


def test_program_follows_its_calls_and_data(tmp_path: Path) -> None:
    """Arrays in a data list, a loop over them, an assignment to a component,
    a call into another file, a numbered frame."""
    (tmp_path / "job.src").write_text(
        "&ACCESS RVP\nDEF job( )\nINT n\nBAS(#BASE,3)\nBAS(#VEL_CP,0.2)\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}\n"
        "FOR n = 1 TO 3\n  P[n].Z = 40\n  LIN P[n] C_DIS\nENDFOR\nother( )\nPTP HOME\nEND\n"
    )
    (tmp_path / "job.dat").write_text(
        "DEFDAT job PUBLIC\nDECL FRAME P[3]\nP[1]={X 1,Y 0,Z 0,A 0,B 0,C 0}\nP[2]={X 2,Y 0,Z 0,A 0,B 0,C 0}\n"
        "P[3]={X 3,Y 0,Z 0,A 0,B 0,C 0}\nDECL AXIS HOME={A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}\nENDDAT\n"
    )
    (tmp_path / "OTHER.SRC").write_text(
        "DEF other( )\n$OUT[3]=TRUE\nWAIT SEC 0.5\nLIN {X 9,Y 8,Z 7,A 0,B 90,C 0}\nEND\n"
    )
    parsed = read_program(tmp_path / "job.src")
    assert parsed.kind.tolist() == [0, 1, 1, 1, 1, 0]
    np.testing.assert_allclose(parsed.T_base_tcp[1:5, :3, 3] * 1e3, [[1, 0, 40], [2, 0, 40], [3, 0, 40], [9, 8, 7]])
    np.testing.assert_allclose(parsed.feed[1:5], 0.2)
    assert [(e.index, e.kind, e.text) for e in parsed.events] == [
        (4, "comment", "$OUT[3]=TRUE"),
        (4, "dwell", "WAIT SEC 0.5"),
    ]
    assert parsed.bases[parsed.base[1]].name == "BASE_DATA[3]"
    assert parsed.axes_deg[5, 4] == 45
    assert [f.name for f in parsed.files] == ["job.src", "job.dat", "OTHER.SRC"]


POINT = "{positions: [0.1, -0.2, 0.3, 0, 0.5, 0], velocities: [], time_from_start: {sec: %d, nanosec: 5}}"
ROS = "joint_names: [a, b, c, d, e, f]\npoints:\n  # move: cut\n" + "".join(f"  - {POINT % k}\n" for k in range(3))


@pytest.mark.parametrize(
    "text",
    [
        ROS,  # read line by line
        ROS.replace("points:\n", "points: \n"),  # read by the strict YAML reader
        ROS.replace("{positions: [0.1,", "{positions: [.1,"),  # a number in YAML but not in JSON
        ROS.replace("0.1, -0.2", "\n      0.1, -0.2"),
    ],
)
def test_trajectory_does_not_depend_on_yaml_layout(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    parsed = read_program(tmp_path / "a.yaml")
    np.testing.assert_allclose(np.radians(parsed.axes_deg), [[0.1, -0.2, 0.3, 0, 0.5, 0]] * 3, atol=1e-15)
    np.testing.assert_allclose(parsed.time, [5e-9, 1 + 5e-9, 2 + 5e-9])
    assert parsed.kind.tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sec: 2,", "sec: 2, sec: 3,", "twice|duplicate"),
        ("sec: 2,", "sec: 0,", "does not rise"),
        ("sec: 2,", "sec: .nan,", "finite|nan"),
        ("velocities: []", "velocities: [1]", "none or 6"),
        ("  # move: cut\n", "  # move: cut\n  - 3\n", "expected positions"),
        ("0.1, ", "0.1, &a 1, ", "found 7 numbers|alias"),
        ("0.1, ", "'0.1', ", "finite numbers"),
    ],
)
def test_faults_of_a_trajectory_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "a.yaml").write_text(ROS.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_program(tmp_path / "a.yaml")


@pytest.mark.parametrize("before", ["1e999", "NaN", "true", "1.5", '"1"'])
def test_event_index_must_be_a_finite_whole_number(tmp_path: Path, before: str) -> None:
    """A long fuzz run found the failure for 1e999."""
    joints = '"joint_names": ["a","b","c","d","e","f"]'
    point = '{"positions": [0,0,0,0,0,0], "time_from_start": {"sec": 1, "nanosec": 0}}'
    (tmp_path / "a.json").write_text(f'{{{joints}, "points": [{point}]}}\n')
    events = tmp_path / "a.events.json"
    events.write_text('{"events": [{"before": 1, "move": "cut"}]}')
    assert len(read_program(tmp_path / "a.json")) == 1
    events.write_text(f'{{"events": [{{"before": {before}, "move": "cut"}}]}}')
    with pytest.raises(InputError, match="is no events file; expected events with before"):
        read_program(tmp_path / "a.json")


def test_trajectory_of_minutes_is_read_in_seconds(tmp_path: Path) -> None:
    """15 minutes with a sample every 12 ms: more numbers than the strict YAML reader accepts."""
    (tmp_path / "a.yaml").write_text(ROS + "".join(f"  - {POINT % k}\n" for k in range(3, 75_000)))
    assert len(read_program(tmp_path / "a.yaml")) == 75_000


def test_long_program_is_not_treated_as_endless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of a million lines was refused; the limits apply to loops only."""
    monkeypatch.setattr("machopt.programs.reading.program_builder.MOST_MOVES", 10)
    monkeypatch.setattr("machopt.programs.reading.program_builder.MOST_STEPS", 10)
    program, cut = tmp_path / "a.src", f"LIN {POSE}\n"
    program.write_text("DEF a()\n" + 50 * cut + "END\n")
    assert len(read_program(program)) == 50
    program.write_text(f"DEF a()\nFOR i=1 TO 50\n{cut}ENDFOR\nEND\n")
    with pytest.raises(InputError, match=r"line 2: more than 10 statements"):
        read_program(program)
