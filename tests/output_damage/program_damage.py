"""Damages of robot programs in every language: statements that a controller would execute differently or not at all."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from output_damage.damage_case import CELLS, JOBS, Damage, Job, find_single_file

# a pass over the cylinder head with a corner, feeds, and all types of events
APT = """UNITS/MM
LOADTL/4
SPINDL/1500,RPM,CLW
RAPID
GOTO/-100,0,60
FEDRAT/1000,MMPM
GOTO/-100,0,5
COOLNT/ON
FEDRAT/1500,MMPM
GOTO/-100,0,-0.5
GOTO/-96,0,-0.5
DELAY/1.5
GOTO/-92,0,-0.5
GOTO/-88,0,-0.5
GOTO/-84,1,-0.5
FEDRAT/900,MMPM
GOTO/-80,3,-0.5
GOTO/-80,3,5
RAPID
GOTO/-80,3,60
SPINDL/OFF
FINI
"""
LINES = {"krl": 'spindle_on: "$OUT[5]=TRUE", spindle_off: "$OUT[5]=FALSE"'}
LANGUAGES = (
    "krl",
    "krl_pos",
    "krl_spline",
    "rapid",
    "fanuc",
    "fanuc_joint",
    "urscript",
    "urscript_servoj",
    "val3",
    "jbi",
    "jbi_rectan",
    "csv",
    "json",
    "ros_yaml",
    "ros_json",
    "compas_fab",
)


def plan_in(language: str, folder: Path) -> Job:
    """Plan the pass in the milling cell with a program of one maker."""
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    file = folder / "cell" / "cell.yaml"
    more = f"controller:\n  nonflip_j5: negative\n  lines: {{{LINES.get(language, '')}}}\n"
    file.write_text(file.read_text(encoding="utf-8").replace("controller:\n", more, 1), encoding="utf-8")
    toolpath = folder / "part.apt"
    toolpath.write_text(APT, encoding="utf-8")
    job = Job(folder / "cell", toolpath, folder / "out", (language,))
    outcome = run_optimize(
        OptimizeRequest(
            cell=job.cell, toolpath=toolpath, out=job.out, posts=(language,), overrides=("rotation_step_deg=15",)
        )
    )
    assert outcome.exit_code == 0, outcome.result.to_json_types()["verification"]
    return job


TWO_OPERATIONS = """x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation
-100,0,60,0,0,1,rapid,,left
-100,0,5,0,0,1,approach,1000,left
-100,0,-0.5,0,0,1,cut,1500,left
-96,0,-0.5,0,0,1,cut,1500,left
-92,0,-0.5,0,0,1,cut,1500,right
-88,0,-0.5,0,0,1,cut,1500,right
-88,0,5,0,0,1,retract,1000,right
-88,0,60,0,0,1,rapid,,right
"""


def plan_operations(folder: Path) -> Job:
    """Plan a cut that changes its operation, with comments and joint values in the program."""
    toolpath = folder / "cut.csv"
    toolpath.write_text(TWO_OPERATIONS, encoding="utf-8")
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    posts = ("krl", "csv", "ros_json")
    request = OptimizeRequest(
        cell=folder / "cell",
        toolpath=toolpath,
        out=folder / "out",
        posts=posts,
        overrides=("rotation_step_deg=15",),
    )
    assert run_optimize(request).exit_code == 0
    return Job(folder / "cell", toolpath, folder / "out", posts)


JOBS["operations"] = plan_operations
JOBS |= {f"in {language}": partial(plan_in, language) for language in LANGUAGES}


def swap(pattern: str, found: str, by: str | Callable[[re.Match[str]], str], nth: int = 0) -> Callable[[Job], None]:
    """Return a damage that replaces the n-th match in the only file that matches the pattern."""

    def apply(job: Job) -> None:
        file = find_single_file(job.out, pattern)
        text = file.read_bytes().decode("utf-8")
        places = list(re.finditer(found, text, re.MULTILINE))
        assert len(places) > nth, f"{file.name} holds {found!r} {len(places)} times"
        place = places[nth]
        new = by(place) if callable(by) else place.expand(by)
        assert new != place.group(0)
        file.write_bytes((text[: place.start()] + new + text[place.end() :]).encode("utf-8"))

    return apply


def add_to_group(number: int, by: float) -> Callable[[re.Match[str]], str]:
    """Return a function that adds a value to the number in a group of the match."""

    def change(found: re.Match[str]) -> str:
        whole, start = found.group(0), found.start()
        a, b = found.start(number) - start, found.end(number) - start
        digits = len(found.group(number).partition(".")[2])
        return f"{whole[:a]}{float(found.group(number)) + by:.{digits}f}{whole[b:]}"

    return change


def scale_group(number: int, by: float) -> Callable[[re.Match[str]], str]:
    """Return a function that multiplies the number in a group of the match."""

    def change(found: re.Match[str]) -> str:
        return add_to_group(number, float(found.group(number)) * (by - 1.0))(found)

    return change


def cut(pattern: str, share: float) -> Callable[[Job], None]:
    """Truncate the file, as if the disk were full."""

    def apply(job: Job) -> None:
        file = find_single_file(job.out, pattern)
        data = file.read_bytes()
        file.write_bytes(data[: int(share * len(data))])

    return apply


def full_width(found: re.Match[str]) -> str:
    """Replace the last digit by a full-width Unicode digit, which Python's float() accepts."""
    return found[1] + chr(ord(found[2]) - ord("0") + 0xFF10)


def longer_quaternion(found: re.Match[str]) -> str:
    """Scale the quaternion by 1.01: the same orientation after normalization."""
    whole, start = found[0], found.start()
    numbers = ",".join(f"{float(found[k]) * 1.01:.8f}" for k in range(1, 5))
    return whole[: found.start(1) - start] + numbers + whole[found.end(4) - start :]


def line_ends(pattern: str) -> Callable[[Job], None]:
    """Change the line ends, as a transfer in text mode does."""

    def apply(job: Job) -> None:
        file = find_single_file(job.out, pattern)
        file.write_bytes(file.read_bytes().replace(b"\r\n", b"\n"))

    return apply


def copy_program(pattern: str, name: str) -> Callable[[Job], None]:
    """Copy the program under another name."""
    return lambda job: shutil.copy(find_single_file(job.out, pattern), job.out / name) and None


def row(language: str, name: str, how_much: str, apply: Callable[[Job], None], caught_by: str) -> Damage:
    return Damage(f"{language}: {name}", how_much, apply, caught_by, job=f"in {language}")


KRL, MOD, LS, UR, JBI = "part_apt.src", "part_apt.mod", "PART_APT.ls", "part_apt.script", "PART_APT.JBI"
LIN = r"^LIN \{X (-?[\d.]+),Y (-?[\d.]+),Z (-?[\d.]+),A (-?[\d.]+),B (-?[\d.]+),C (-?[\d.]+),S (\d+),T (\d+)\}.*\r\n"
MOVEL = r"^ +MoveL \[\[(-?[\d.]+),(-?[\d.]+),(-?[\d.]+)\],\[(-?[\d.]+),.*\r\n"
QUATERNION = r"\],\[(-?[\d.]+),(-?[\d.]+),(-?[\d.]+),(-?[\d.]+)\],\[-?\d,"
S, M, L, U, J = (f"{name}: " for name in (KRL, MOD, LS, UR, JBI))
DAMAGES = [
    row("krl", "a coordinate of a cut", "0.1 mm", swap(KRL, LIN, add_to_group(3, 0.1), 4), S),
    row("krl", "a coordinate off the line", "0.03 mm", swap(KRL, LIN, add_to_group(3, 0.03), 4), S + "CAM points"),
    row("krl", "an angle", "0.2 deg", swap(KRL, LIN, add_to_group(6, 0.2), 4), S + "tool axis at targets"),
    row("krl", "a joint of a rapid move", "0.5 deg", swap(KRL, r"^PTP \{A1 (-?[\d.]+)", add_to_group(1, 0.5), 1), S),
    row("krl", "the status", "1 bit", swap(KRL, r",S 6|,S 2", ",S 3", 2), S + "configuration"),
    row(
        "krl", "the turn", "1 bit", swap(KRL, r",T (\d+)\}", lambda m: f",T {int(m[1]) ^ 1}}}", 2), S + "configuration"
    ),
    row(
        "krl",
        "two moves swapped",
        "2 lines",
        swap(KRL, f"({LIN.replace('(', '(?:')})({LIN.replace('(', '(?:')})", r"\2\1"),
        S,
    ),
    row("krl", "a move dropped", "1 line", swap(KRL, LIN, "", 5), S + "wording"),
    row("krl", "a move doubled", "1 line", swap(KRL, LIN, r"\g<0>\g<0>", 5), S + "wording"),
    row("krl", "a LIN made PTP", "1 word", swap(KRL, r"^LIN ", "PTP ", 4), S + "kinds of moves"),
    row(
        "krl",
        "a feed in mm/s instead of m/s",
        "x 1000",
        swap(KRL, r"CP=([\d.]+)", scale_group(1, 1000), 1),
        S + "CAM feed",
    ),
    row("krl", "a feed in m/min", "x 60", swap(KRL, r"CP=([\d.]+)", scale_group(1, 60), 1), S + "CAM feed"),
    row(
        "krl", "a feed of another operation", "x 0.9", swap(KRL, r"CP=([\d.]+)", scale_group(1, 0.9), 1), S + "CAM feed"
    ),
    row("krl", "a zone", "x 50", swap(KRL, r"CDIS=([\d.]+)", scale_group(1, 50)), S + "zones"),
    row("krl", "the tool by number", "1 line", swap(KRL, r"\$TOOL=MO_TOOL", "$TOOL=TOOL_DATA[7]"), S + "wording"),
    row("krl", "the base left out", "1 line", swap(KRL, r"\$BASE=MO_BASE\r\n", ""), S + "wording"),
    row("krl", "the load", "40 kg", swap("part_apt.dat", r"LOAD=\{M ([\d.]+)", add_to_group(1, -40)), S + "wording"),
    row(
        "krl",
        "the tool's length",
        "1 mm",
        swap("part_apt.dat", r"TOOL=\{X (-?[\d.]+)", add_to_group(1, 1)),
        S + "tool and base",
    ),
    row(
        "krl",
        "the workpiece's place",
        "0.1 mm",
        swap("part_apt.dat", r"BASE=\{X (-?[\d.]+)", add_to_group(1, 0.1)),
        S + "tool and base",
    ),
    row("krl", "another .dat", "1 name", swap("part_apt.dat", r"DEFDAT part_apt", "DEFDAT other"), S + "wording"),
    row("krl", "END removed", "1 line", swap(KRL, r"^END\r\n", ""), S),
    row("krl", "cut off", "60 %", cut(KRL, 0.6), S),
    row("krl", "the spindle's line", "1 line", swap(KRL, r"^\$OUT\[5\]=TRUE\r\n", ""), S + "wording"),
    row("krl", "the spindle's line a comment", "1 character", swap(KRL, r"^\$OUT\[5\]=TRUE", ";$OUT[5]=TRUE"), S),
    row("krl", "a full-width digit", "1 character", swap(KRL, r"^(LIN \{X -?\d*)(\d)", full_width, 4), S + "readable"),
    row("krl", "a no-break space", "1 character", swap(KRL, r"^(LIN \{X -?[\d.]+,Y) ", "\\1\N{NO-BREAK SPACE}", 4), S),
    row("krl", "a comment in another script", "1 character", swap(KRL, r"^; move: cut", "; move: \u0441ut"), S),
    row("krl", "a lone carriage return", "1 character", swap(KRL, r"^(; .*)\r\n", r"\1\r"), S + "wording"),
    row("krl", "line ends", "all", line_ends(KRL), S + "wording"),
    row("krl", "a move a comment", "1 character", swap(KRL, r"^LIN ", ";LIN ", 5), S + "wording"),
    row("krl", "a move behind END", "1 line", swap(KRL, r"^END\r\n", "END\r\nLIN {X 0,Y 0,Z 0}\r\n"), S),
    row("krl", "the speed of joint moves", "80 to 100 %", swap(KRL, r"VEL_PTP,\d+", "VEL_PTP,100"), S + "wording"),
    row("krl", "a dwell", "1.5 to 0.5 s", swap(KRL, r"WAIT SEC 1\.5", "WAIT SEC 0.5"), S + "wording"),
    row(
        "krl",
        "a second program in the file",
        "3 lines",
        swap(KRL, r"\Z", "DEF second( )\r\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\nEND\r\n"),
        S + "wording",
    ),
    row(
        "krl",
        "a second program beside it",
        "1 file",
        copy_program(KRL, "second.src"),
        "second.src: a program of this job",
    ),
    row("krl_pos", "a joint move's turn", "1 bit", swap(KRL, r",T (\d+)\}", lambda m: f",T {int(m[1]) ^ 8}}}", 1), S),
    row(
        "krl_spline",
        "a point of the spline",
        "1 mm",
        swap(KRL, r"^SPL \{X (-?[\d.]+),Y (-?[\d.]+)", add_to_group(2, 1), 2),
        S,
    ),
    row("krl_spline", "the spline not closed", "1 line", swap(KRL, r"^ENDSPLINE\r\n", ""), S + "wording"),
    row("rapid", "a coordinate", "1 mm", swap(MOD, MOVEL, add_to_group(3, 1), 4), M),
    row(
        "rapid",
        "confdata",
        "1 quarter",
        swap(MOD, r"\],\[(-?\d),(-?\d),(-?\d),(\d)\]", add_to_group(3, 1), 3),
        M + "configuration",
    ),
    row("rapid", "a quaternion's length", "1 %", swap(MOD, QUATERNION, longer_quaternion, 4), M + "every word"),
    row("rapid", "a MoveL made MoveJ", "1 word", swap(MOD, r"MoveL", "MoveJ", 4), M),
    row("rapid", "speeddata", "/ 1000", swap(MOD, r"v2_part_apt:=\[([\d.]+)", scale_group(1, 0.001)), M + "CAM feed"),
    row(
        "rapid",
        "a zone",
        "20 mm",
        swap(MOD, r"zonedata z1_part_apt:=\[FALSE,([\d.]+)", add_to_group(1, 20)),
        M + "zones",
    ),
    row(
        "rapid",
        "tooldata",
        "1 mm",
        swap(MOD, r"tooldata t_part_apt:=\[TRUE,\[\[(-?[\d.]+)", add_to_group(1, 1)),
        M + "tool and base",
    ),
    row("rapid", "the tool's mass", "90 kg", swap(MOD, r"\]\],\[([\d.]+),\[", add_to_group(1, -90)), M + "wording"),
    row("rapid", "another tool", "1 word", swap(MOD, r"t_part_apt\\", r"tool0\\", 3), M),
    row("rapid", "the end of the module", "1 line", swap(MOD, r"^ENDMODULE\r\n", ""), M),
    row("rapid", "a comment for a move", "1 character", swap(MOD, r"^ +MoveL", "    !MoveL", 4), M + "wording"),
    row("fanuc", "a coordinate", "1 mm", swap(LS, r"Z = (-?[\d.]+) mm", add_to_group(1, 1), 3), L),
    row(
        "fanuc",
        "CONFIG",
        "1 letter",
        swap(LS, r"CONFIG : '([NF])", lambda m: m[0][:-1] + "FN"[m[1] == "F"], 3),
        L + "configuration",
    ),
    row("fanuc", "a turn number", "1 turn", swap(LS, r"(\d)',\r", add_to_group(1, 1), 3), L + "configuration"),
    row("fanuc", "the speed in cm/min", "1 unit", swap(LS, r"mm/sec", "cm/min", 3), L + "CAM feed"),
    row("fanuc", "the termination of an end", "CNT100", swap(LS, r"(L P.*)FINE", r"\1CNT100"), L + "zones"),
    row("fanuc", "the user frame", "1 number", swap(LS, r"UFRAME_NUM=1", "UFRAME_NUM=2"), L),
    row("fanuc", "LINE_COUNT", "1 line", swap(LS, r"LINE_COUNT\t= (\d+)", add_to_group(1, 1)), L + "wording"),
    row("fanuc", "/END removed", "1 line", swap(LS, r"^/END\r\n", ""), L),
    row("fanuc_joint", "a joint on the path", "1 deg", swap(LS, r"J1= (-?[\d.]+) deg", add_to_group(1, 1), 4), L),
    row("fanuc_joint", "the speed of joint moves", "80 to 100 %", swap(LS, r"80%", "100%"), L + "wording"),
    row("urscript", "mm for m", "x 1000", swap(UR, r"workpiece, p\[(-?[\d.]+)", scale_group(1, 1000), 4), U),
    row("urscript", "a blend over half a line", "30 mm", swap(UR, r"r=(0\.\d+)", add_to_group(1, 0.03), 3), U),
    row(
        "urscript",
        "the tool centre point",
        "1 mm",
        swap(UR, r"set_tcp\(p\[(-?[\d.]+)", add_to_group(1, 0.001)),
        U + "tool and base",
    ),
    row("urscript", "halt", "1 line", swap(UR, r"^  sleep", "  halt\n  sleep"), U),
    row("urscript_servoj", "a sample", "0.01 rad", swap(UR, r"servoj\(\[(-?[\d.]+)", add_to_group(1, 0.01), 300), U),
    row("urscript_servoj", "the cycle", "x 2", swap(UR, r"0, 0, ([\d.]+),", scale_group(1, 2), 300), U + "times"),
    row(
        "val3",
        "a coordinate",
        "1 mm",
        swap("part_apt.dtx", r'<Value key="3" x="(-?[\d.]+)"', add_to_group(1, 1)),
        "part_apt/part_apt.pjx: ",
    ),
    row(
        "val3",
        "the speed of a corner",
        "x 60",
        swap("part_apt.dtx", r'tmax="([\d.]+)"', scale_group(1, 60), 2),
        "part_apt/part_apt.pjx: ",
    ),
    row(
        "val3",
        "the end of a program",
        "1 line",
        swap("start.pgx", r"^  waitEndMove\(\)\r\nend", "end"),
        "part_apt/part_apt.pjx: wording",
    ),
    row("jbi", "a joint", "0.5 deg", swap(JBI, r"^C00005=(-?[\d.]+)", add_to_group(1, 0.5)), J),
    row("jbi", "the positioning level", "PL=8", swap(JBI, r"(V=25.0) PL=\d", r"\1 PL=8", 1), J + "zones"),
    row("jbi", "no positioning level of a joint move", "PL removed", swap(JBI, r"^(MOVJ .*) PL=0", r"\1"), J + "zones"),
    row("jbi", "the positioning level of a joint move", "PL=3", swap(JBI, r"^(MOVJ .*) PL=0", r"\1 PL=3"), J + "zones"),
    row("jbi", "END removed", "1 line", swap(JBI, r"^END\r\n", ""), J),
    row("jbi_rectan", "RCONF", "1 bit", swap(JBI, r"RCONF (\d)", lambda m: f"RCONF {1 - int(m[1])}"), J),
    row("jbi_rectan", "the user frame", "1 number", swap(JBI, r"///USER \d+", "///USER 9"), J),
    row(
        "csv",
        "a place that the joints do not have",
        "1 mm",
        swap("part_apt.csv", r"^lin(?:,[^,]*){15},(-?[\d.]+)", add_to_group(1, 1), 4),
        "part_apt.csv: ",
    ),
    row(
        "csv",
        "a tool axis",
        "x 1.1",
        swap("part_apt.csv", r"^lin(?:,[^,]*){24},([\d.]+)", scale_group(1, 1.1), 4),
        "part_apt.csv: readable",
    ),
    row(
        "csv",
        "a feed",
        "x 60",
        swap("part_apt.csv", r"^lin(?:,[^,]*){25},([\d.]+)", scale_group(1, 60), 4),
        "part_apt.csv: ",
    ),
    row(
        "json",
        "a joint",
        "1 deg",
        swap("part_apt.json", r'"q_deg": \[(-?[\d.]+)', add_to_group(1, 1), 4),
        "part_apt.json: ",
    ),
    row(
        "ros_yaml",
        "a sample",
        "0.01 rad",
        swap("part_apt.yaml", r"positions: \[(-?[\d.]+)", add_to_group(1, 0.01), 300),
        "part_apt.yaml: ",
    ),
    row(
        "ros_yaml",
        "a joint's name",
        "1 name",
        swap("part_apt.yaml", r'"a1", "a2"', '"a2", "a1"'),
        "part_apt.yaml: wording",
    ),
    row(
        "compas_fab",
        "a sample",
        "0.01 rad",
        swap("part_apt.json", r'"joint_values": \[(-?[\d.]+)', add_to_group(1, 0.01), 300),
        "part_apt.json: ",
    ),
    row(
        "compas_fab",
        "what a joint is",
        "1 digit",
        swap("part_apt.json", r'"joint_types": \[0', '"joint_types": [2', 4),
        "part_apt.json: ",
    ),
    row("ros_json", "cut off", "60 %", cut("part_apt.json", 0.6), "part_apt.json: "),
    row(
        "ros_json",
        "an event",
        "1 entry",
        swap("part_apt.events.json", r'\{"before": \d+, "event": "SPINDL/1500[^}]*\},?\n', ""),
        "part_apt.json: ",
    ),
]

DAMAGES += [
    Damage(f"operations: {name}", how_much, apply, caught_by, "operations")
    for name, how_much, apply, caught_by in (
        (
            "krl, the second one's label",
            "1 word",
            swap("krl/*.src", "operation: right", "operation: left"),
            "krl/cut_csv.src: operations",
        ),
        (
            "csv, the label of one cut",
            "1 word",
            swap("csv/*.csv", '"right",cut', '"left",cut'),
            "csv/cut_csv.csv: operations",
        ),
        (
            "ros_json, the second one's label",
            "1 word",
            swap("ros_json/*.events.json", '"operation": "right"', '"operation": "left"'),
            "ros_json/cut_csv.json: operations",
        ),
        (
            "csv, a joint on a line, the pose kept",
            "2.5 deg",
            swap("csv/*.csv", r'^lin,"left",cut,,(-?[\d.]+)', add_to_group(1, 2.5)),
            "csv/cut_csv.csv: joints on lines",
        ),
    )
]
