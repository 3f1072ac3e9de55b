"""Unknown words stop a plan with their line; reviewed words never do. One generator for each dialect."""

from __future__ import annotations

import ast
import json
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from toolpath_file_samples import CAMWORKS, CATIA, CREO, DIN_ISO, FANUC, HEIDENHAIN, HSM, NCI, NX, SIEMENS, Sample

import machopt
from machopt.cli import main
from machopt.errors import InputError
from machopt.programs.abb import harmless_words as abb_words
from machopt.programs.fanuc import harmless_words as fanuc_words
from machopt.programs.kuka import harmless_words as kuka_words
from machopt.programs.staubli import harmless_words as staubli_words
from machopt.programs.universal_robots import harmless_words as universal_robots_words
from machopt.programs.yaskawa import harmless_words as yaskawa_words
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words

PACKAGE = Path(machopt.__file__).parent
READERS = "toolpath/"
STEMS = ("FRAME", "COORD", "MCSYS", "WCS", "SHIFT", "TILT", "PLN", "ORIG", "ROTAT", "LOCALC", "DATUM", "MOVT", "RETRC")
WORDS_TRIED = 24  # for each dialect and form


def build_unknown_words(rng: random.Random, count: int) -> list[str]:
    """Return words that resemble those of frames and motions but exist in no dialect."""
    letters = "BDFHJKQVWXZ"
    return [f"{rng.choice(letters)}{rng.choice(STEMS)}{rng.choice(letters)}{rng.choice(letters)}" for _ in range(count)]


GENERIC = Sample(
    "part.apt", "PARTNO/1\nUNITS/MM\nRAPID\nGOTO/0,0,50\nFEDRAT/300,MMPM\nGOTO/0,0,0\nGOTO/10,0,0\nGOTO/10,10,0\nFINI\n"
)
KRL = Sample(
    "part.src",
    "&ACCESS RVP\nDEF part( )\n$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\n$VEL.CP=0.01\n"
    "PTP {X 0,Y 0,Z 50,A 0,B 0,C 180}\nLIN {X 0,Y 0,Z 0,A 0,B 0,C 180}\nLIN {X 50,Y 0,Z 0,A 0,B 0,C 180}\nEND\n",
)
RAPID = Sample(
    "part.mod",
    'MODULE part\nPERS wobjdata wobj1:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
    "CONST robtarget p1:=[[0,0,50],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
    "VAR robtarget p2:=[[0,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\nPROC main()\n"
    "MoveJ p1,v100,fine,tool0\\WObj:=wobj1;\nMoveL p2,v100,fine,tool0\\WObj:=wobj1;\n"
    "MoveL p1,v100,fine,tool0\\WObj:=wobj1;\nENDPROC\nENDMODULE\n",
)
TP = Sample(
    "part.ls",
    "/PROG PART\n/ATTR\n/MN\n1: UFRAME_NUM=1 ;\n2: UTOOL_NUM=1 ;\n3:J P[1] 10% FINE ;\n4:L P[2] 20mm/sec FINE ;\n"
    "5:L P[1] 20mm/sec FINE ;\n/POS\n"
    + "".join(
        f"P[{n}]{{\nGP1:\nUF : 1, UT : 1, CONFIG : 'N U T, 0, 0, 0',\nX = {10 * n} mm, Y = 0 mm, Z = 0 mm,\n"
        "W = 180 deg, P = 0 deg, R = 0 deg\n};\n"
        for n in (1, 2)
    )
    + "/END\n",
)
SCRIPT = Sample(
    "part.script",
    "def part():\nq = p[0.1,0.2,0.3,0,3.14,0]\nset_tcp(p[0,0,0.1,0,0,0])\nmovej([0,-1.5,1.5,0,1.5,0],1,1)\n"
    "movel(p[0.1,0.2,0.3,0,3.14,0],1,0.01)\nmovel(p[0.2,0.2,0.3,0,3.14,0],1,0.01)\nend\npart()\n",
)
JBI = Sample(
    "PART.JBI",
    "/JOB\n//NAME PART\n//POS\n///NPOS 2,0,0,0,0,0\n///TOOL 0\n///POSTYPE ROBOT\n///RECTAN\n"
    "C00000=100.000,0.000,50.000,180.0,0.0,0.0\nC00001=200.000,0.000,0.000,180.0,0.0,0.0\n//INST\n///DATE 2026/01/01\n"
    "NOP\nMOVJ C00000 VJ=10.00\nMOVL C00001 V=10.0 PL=0\nMOVL C00000 V=10.0 PL=0\nEND\n",
)
VAL3_DATA = """<?xml version="1.0" encoding="utf-8"?>
<Database xmlns="http://www.staubli.com/robotics/VAL3/Data/2"><Datas>
<Data name="p" access="private" xsi:type="array" type="pointRx" size="2" xmlns:xsi="x">
<Value key="0" x="0" y="0" z="50" rx="180" /><Value key="1" x="80" y="0" z="0" rx="180" /></Data>
<Data name="t" access="private" type="tool" size="1"><Value key="0" z="100" fatherId="flange[0]" /></Data>
<Data name="m" access="private" type="mdesc" size="1"><Value key="0" tmax="20" /></Data>
<Data name="n" access="private" type="num" size="1"><Value key="0" value="0" /></Data>
</Datas></Database>
"""
VAL3 = Sample(
    "part.pgx",
    '<?xml version="1.0" encoding="utf-8"?>\n<Programs xmlns="http://www.staubli.com/robotics/VAL3/Program/2">\n'
    '<Program name="start" access="public"><Code><![CDATA[\nbegin\nmovej(p[0],t[0],m[0])\nmovel(p[1],t[0],m[0])\n'
    "movel(p[0],t[0],m[0])\nend\n]]></Code></Program></Programs>\n",
)


@dataclass(frozen=True)
class Dialect:
    """A valid file, statements with an unknown word, lines before which they are inserted, and reviewed statements."""

    sample: Sample
    forms: tuple[Callable[[str], str], ...]
    before: tuple[str, ...]  # beginnings of lines
    reviewed: tuple[str, ...] = ()


def apt_words() -> tuple[str, ...]:
    ending = ("FINI", "END", "END-OF-PATH", "UNIT", "UNITS", "TLDATA")  # these end the path or define the kind of file
    return tuple(f"{w}/1" for w in sorted(harmless_words.APT) if w not in ending and not w.startswith("CSI_"))


APT_FORMS = (lambda w: f"{w}/1,2,3", lambda w: f"{w}/ON", lambda w: w, lambda w: f"{w[:6]} / NUM,1,POINT,0,0,0")
DIALECTS = {
    "apt": Dialect(GENERIC, APT_FORMS, ("RAPID", "GOTO"), (*apt_words(), "SET/HOLDER,3", "FEDRAT/LOCK,ON")),
    "nx": Dialect(NX, APT_FORMS, ("RAPID", "FEDRAT", "CYCLE/OFF"), apt_words()),
    "catia": Dialect(CATIA, APT_FORMS, ("LOADTL", "FINI"), apt_words()),
    "creo": Dialect(CREO, APT_FORMS, ("RAPID", "GOTO"), apt_words()),
    "hsm": Dialect(HSM, APT_FORMS, ("RAPID", "SPINDL")),
    "camworks": Dialect(CAMWORKS, APT_FORMS, ("RAPID", "CYCLE/OFF"), apt_words()),
    "gcode": Dialect(
        FANUC,
        (lambda w: w, lambda w: f"M{200 + sum(map(ord, w)) % 90}", lambda w: f"G{201 + sum(map(ord, w)) % 90} X1."),
        ("S8000", "G0 X0", "X50.", "X90."),
        tuple(f"M{m}" for m in sorted(harmless_words.M) if m not in (10, 11)),
    ),
    "sinumerik": Dialect(
        SIEMENS,
        (lambda w: w, lambda w: f"{w}(1,2,3)", lambda w: f"G1 X1 {w}=3"),
        ("N60", "N160", "N170"),
        tuple(
            w if w in ("CYCLE832",) else f"{w}(1)" if w in ("MSG", "PRINTLN") else w
            for w in sorted(harmless_words.SINUMERIK_CALLS)
            if w not in ("WORKPIECE", "MSG")
        ),
    ),
    "heidenhain": Dialect(
        HEIDENHAIN,
        (
            lambda w: w,
            lambda w: f"{w} X+10 Y+5",
            lambda w: f"FUNCTION {w}",
            lambda w: f"M{300 + sum(map(ord, w)) % 90}",
        ),
        ("5 L", "6 CC", "12 L", "26 L"),
        ("TOOL DEF 3", "BLK FORM 0.2 X+1 Y+1 Z+0", "M126", "M118 X1", "CYCL DEF 32.0 TOLERANCE"),
    ),
    "iso": Dialect(DIN_ISO, (lambda w: f"{w} *", lambda w: f"{w} X+3 *"), ("N40", "N100")),
    "nci": Dialect(
        NCI,
        (lambda w: f"{1100 + sum(map(ord, w)) % 800}\n1 2 3",),
        ("1008", "1003"),
        tuple(f"{code}\n1 2 3" for code in sorted(harmless_words.NCI)),
    ),
    "krl": Dialect(
        KRL,
        (
            lambda w: f"{w}( )",
            lambda w: f"${w}={{X 1,Y 2,Z 3,A 0,B 0,C 0}}",
            lambda w: f"{w} #BASE",
            lambda w: f"IF $IN[1] THEN\n{w}(1)\nENDIF",
            lambda w: f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO {w}( ) PRIO=-1",
            lambda w: f"WHILE $IN[1]\n{w} #BASE\nENDWHILE",
        ),
        ("PTP", "LIN"),
        (
            *(f"{name}=1" for name in sorted(kuka_words.KRL_VARIABLES) if name != "$VEL"),
            *(f"{name}(1)" for name in sorted(kuka_words.KRL_CALLS)),
            '$LOOP_MSG[]="Hello"',
            'configFileName[]="C:\\x.cfg"',
            "$OUT[3]=TRUE",
            "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE",
            "HALT",
            "WAIT SEC 0.5",
        ),
    ),
    "rapid": Dialect(
        RAPID,
        (
            lambda w: f"{w};",
            lambda w: f"{w} wobj1,10\\X:=3;",
            lambda w: f"MoveL p1,v100,fine,tool0\\{w}:=5\\WObj:=wobj1;",
            lambda w: f"IF DI1=1 THEN\n{w} 5;\nENDIF",
            lambda w: f"IF DI1=1 AND (reg1>3) {w} 5;",
            lambda w: f"IF DI1=1 {w};",
        ),
        ("MoveJ", "MoveL"),
        tuple(f"{w};" for w in sorted(abb_words.RAPID) if w not in ("VELSET", "SPEEDREFRESH")),
    ),
    "fanuc": Dialect(
        TP,
        (
            lambda w: f"9: CALL {w} ;",
            lambda w: f"9: {w}[1]=PR[2] ;",
            lambda w: f"9:L P[2] 20mm/sec FINE {w},PR[1] ;",
            lambda w: f"9: ${w}[1]=5 ;",
        ),
        ("3:J", "4:L", "5:L"),
        tuple(f"9: {w}1] ;" if w.endswith("[") else f"9: {w} ;" for w in sorted(fanuc_words.FANUC)),
    ),
    "urscript": Dialect(
        SCRIPT,
        (
            lambda w: f"{w.lower()}(p[0,0,0,0,0,0])",
            lambda w: f"{w.lower()} = x = 3",
            lambda w: f"if True:\n{w.lower()}(1)\nend",
        ),
        ("movej", "movel"),
        tuple(f"{w}(1)" for w in sorted(universal_robots_words.URSCRIPT) if w != "return"),
    ),
    "jbi": Dialect(
        JBI,
        (
            lambda w: f"{w} UF#(1) C00000",
            lambda w: f"CALL JOB:{w}",
            lambda w: f"MOVL C00001 V=10.0 {w}",
        ),
        ("MOVJ", "MOVL"),
        tuple(f"{w} B001 1" for w in sorted(yaskawa_words.JBI) if w != "END"),
    ),
    "val3": Dialect(
        VAL3,
        (
            lambda w: f"{w.lower()}(p[0],3)",
            lambda w: f"{w.lower()}.trsf.x=5",
            lambda w: f"call {w.lower()}()",
        ),
        ("movej", "movel"),
        (*(f"{w}()" for w in sorted(staubli_words.VAL3)), "n=3", "n[0]=n+1"),
    ),
}
NOT_UNKNOWN = {"urscript": 1}  # forms that assign


REAL_WORDS: dict[str, tuple[str, ...]] = {  # words of frames and motion that exist in the dialects
    "apt": (
        "MCSYS/NUM,1,POINT,0,0,0",
        "LOCALCS/1",
        "WORKPLANE/1",
        "COORD/2",
        "COPY/1,TRANSL,1,2,3,2",
        "TRACUT/1,0,0,1,0,1,0,1,0,0,1,1",
        "ROTATE/TABLE,ATANGL,30",
        "ROTHED/BAXIS,30",
        "RETRCT",
        "CLEARP/XYPLAN,10",
        "SAFPOS/1,2,3",
        "VTLAXS/1",
        "PREFUN/68",
        "INSERT/G68.2 X0 Y0 Z0 I0 J30 K0",
        "REFSYS/M1",
        "MATRIX/1",
        "TRANSL/1,2,3",
        "COUPLE/1",
        "MODE/POLAR",
        "UNITS/FURLONGS",
        "SET/FRAME,2",
        "LOAD/HEAD,2",
    ),
    "sinumerik": (
        "$P_UIFR[1,X,TR]=100",
        "$P_PFRAME=CTRANS(X,10):CROT(Z,30)",
        "DIAMON",
        "TOROTX",
        "PAROT",
        "OFFN=5",
        "TOFFL=5",
        "TOFF[X]=3",
        "TRANSMIT",
        "TRACYL(40)",
        "MEAFRAME",
        "POSA[X]=100",
        "COUPON(A,B)",
        "TANG(C,X,Y,1)",
        "PRESETON(X,5)",
        'EXTCALL "ABC"',
    ),
    "heidenhain": (
        "FUNCTION MODE TURN",
        "FUNCTION PARAXCOMP DISPLAY Z",
        "FUNCTION CORRDATA TCS #1",
        "TCH PROBE 408 SLOT",
        'SEL TABLE "A"',
        "CYCL DEF 12.0 PGM CALL",
        "CYCL DEF 14.0 CONTOUR",
        "CYCL DEF 28.0 CYLINDER SURFACE",
        "CYCL DEF 800 ADJUST XZ",
        "CYCL DEF 33.0 FRAME",
        "TRANS DATUM TABLE TABLINE3",
        "POLARKIN AXES Z C",
        "M114",
        "M130 X1 Q",
    ),
    "krl": (
        "MYMOVE XP1",
        "SPTP_X #A",
        "PTP_SHIFT {X 1}",
        "$ET1_KIN={X 1}",
        "$MAMES[1]=5",
        "$EX_AX_ASYNC=1",
        "BASE_CHG 5",
    ),
    "urscript": ("run mover()", "start_conveyor(1)", "servoc(p[0,0,0,0,0,0],1,1)", "speedl([0,0,0,0,0,0],1,1)"),
}


@pytest.mark.parametrize("name", REAL_WORDS)
def test_words_of_frames_and_motion_are_refused_with_their_line(tmp_path: Path, name: str) -> None:
    dialect = DIALECTS[name]
    for statement in REAL_WORDS[name]:
        text, line = put_in(dialect.sample, statement, dialect.before[-1], 0)
        text = text.replace("def part():", "thread mover():\nmovel(p[0,0,0,0,0,0],1,1)\nend\ndef part():")
        line += 3 * ("thread mover" in text)
        where = refused_at(write(tmp_path, dialect.sample, text), dialect.sample.options)
        assert where is not None, statement
        assert where.partition(",")[0] == f"line {line}", (statement, where)


def put_in(sample: Sample, statement: str, before: str, nth: int) -> tuple[str, int]:
    """Return the sample with a statement before the nth line with this beginning,
    and the statement's line (1-based)."""
    lines = sample.text.split("\n")
    places = [k for k, t in enumerate(lines) if t.startswith(before)]
    at = places[nth % len(places)]
    return "\n".join([*lines[:at], statement, *lines[at:]]), at + 1


def write(folder: Path, sample: Sample, text: str) -> Path:
    path = folder / sample.name
    path.write_text(text, encoding="utf-8")
    if sample is VAL3:
        (folder / "part.dtx").write_text(VAL3_DATA, encoding="utf-8")
    return path


def refused_at(path: Path, options: dict[str, object]) -> str | None:
    """Return where a plan from the file is refused; None if it is not."""
    try:
        refuse_unknown_words(read_toolpath(path, **options), path)  # type: ignore[arg-type]
    except InputError as problem:
        return problem.where or "no line"
    return None


@pytest.mark.parametrize("name", DIALECTS)
def test_example_files_are_valid(tmp_path: Path, name: str) -> None:
    sample = DIALECTS[name].sample
    assert refused_at(write(tmp_path, sample, sample.text), sample.options) is None


@pytest.mark.parametrize("name", DIALECTS)
def test_words_similar_to_frames_or_motion_are_refused_with_their_line(tmp_path: Path, name: str) -> None:
    dialect, rng, tried = DIALECTS[name], random.Random(name), 0
    for number, form in enumerate(dialect.forms):
        if NOT_UNKNOWN.get(name) == number:
            continue
        for word in build_unknown_words(rng, WORDS_TRIED):
            text, line = put_in(dialect.sample, form(word), rng.choice(dialect.before), rng.randrange(4))
            where = refused_at(write(tmp_path, dialect.sample, text), dialect.sample.options)
            lines = [f"line {n}" for n in range(line, line + form(word).count("\n") + 1)]
            assert where is not None, form(word)
            assert where.partition(",")[0] in lines, (form(word), where)
            tried += 1
    assert tried >= WORDS_TRIED


@pytest.mark.parametrize("name", [n for n, d in DIALECTS.items() if d.reviewed])
def test_reviewed_word_never_stops_a_plan(tmp_path: Path, name: str) -> None:
    dialect, rng = DIALECTS[name], random.Random(name)
    plain = read_toolpath(write(tmp_path, dialect.sample, dialect.sample.text), **dialect.sample.options)  # type: ignore[arg-type]
    for statement in dialect.reviewed:
        text, _ = put_in(dialect.sample, statement, rng.choice(dialect.before), rng.randrange(4))
        path = write(tmp_path, dialect.sample, text)
        assert refused_at(path, dialect.sample.options) is None, statement
        found = read_toolpath(path, **dialect.sample.options)  # type: ignore[arg-type]
        assert (found.position == plain.position).all(), statement


def test_accepted_word_is_counted_and_ignored(tmp_path: Path) -> None:
    rng = random.Random(3)
    for name in ("apt", "gcode", "sinumerik", "krl", "rapid", "fanuc", "urscript", "jbi", "val3", "heidenhain"):
        dialect = DIALECTS[name]
        for form in (dialect.forms[0], dialect.forms[1] if name == "gcode" else dialect.forms[0]):
            text, line = put_in(dialect.sample, form(build_unknown_words(rng, 1)[0]), dialect.before[-1], 0)
            path = write(tmp_path, dialect.sample, text)
            try:
                word = next(w for w in read_toolpath(path, **dialect.sample.options).ignored if w.stops).word  # type: ignore[arg-type]
            except InputError:
                word = form("x")[:0] or text.split("\n")[line - 1]
            found = read_toolpath(path, **dialect.sample.options, accept_unknown=(word.lower(),))  # type: ignore[arg-type]
            refuse_unknown_words(found, path)
            assert [w.stops for w in found.ignored if not w.understood] == [False], (name, word)
            refuse_unknown_words(
                read_toolpath(path, **dialect.sample.options, accept_unknown=(word,), strict=True),  # type: ignore[arg-type]
                path,
            )


def test_word_missing_in_the_file_cannot_be_accepted(tmp_path: Path) -> None:
    path = write(tmp_path, GENERIC, GENERIC.text)
    with pytest.raises(InputError) as refused:
        read_toolpath(path, accept_unknown=("MCSYS",))
    assert refused.value.where == "--accept-unknown"


def test_inspect_shows_the_file_and_optimize_refuses_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, line = put_in(GENERIC, "MCSYS/NUM,1,POINT,0,0,0", "GOTO", 1)
    path = write(tmp_path, GENERIC, text)
    assert main(["inspect", str(path), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [(w["word"], w["first_line"]) for w in shown["ignored"] if w["stops"]] == [("MCSYS", line)]
    cell = Path(__file__).resolve().parents[1] / "cells" / "kr500_milling"
    assert main(["optimize", str(cell), str(path), "-o", str(tmp_path / "out")]) == 2
    output = capsys.readouterr().err
    assert f"line {line}" in output
    assert "--accept-unknown MCSYS" in output
    assert not (tmp_path / "out").exists()


def test_every_planner_of_a_file_checks_unknown_words() -> None:
    """Every module outside the readers that reads a toolpath refuses unknown words.

    ``inspect`` and the reading function of the API show them.
    """
    shows = {"cli/toolpath_commands.py", "api/toolpath.py"}
    for file in PACKAGE.rglob("*.py"):
        name = file.relative_to(PACKAGE).as_posix()
        if name.startswith(READERS) or name in shows:
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        called = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
        assert "read_toolpath" not in called or "refuse_unknown_words" in called, name
