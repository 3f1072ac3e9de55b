"""Known paths and writers that express them in each dialect, for the property tests of the readers."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
INCH = 25.4


@dataclass(frozen=True)
class Leg:
    """One move. ``arc``: plane, centre (mm) and sweep (degrees, counter-clockwise positive), or None for a line."""

    start: Array
    end: Array
    feed: float  # mm/min; NaN for rapid moves
    arc: tuple[int, Array, float] | None = None

    @property
    def rapid(self) -> bool:
        return math.isnan(self.feed)

    def points(self, share: Array) -> Array:
        """Return the points (N, 3) at these shares of the move."""
        share = share[:, None]
        if self.arc is None:
            return np.asarray(self.start + share * (self.end - self.start))
        plane, centre, sweep = self.arc
        i, j, k = PLANES[plane]
        spoke = self.start - centre
        out = np.tile(centre, (len(share), 1))
        a = np.radians(sweep) * share[:, 0]
        out[:, i] += np.cos(a) * spoke[i] - np.sin(a) * spoke[j]
        out[:, j] += np.sin(a) * spoke[i] + np.cos(a) * spoke[j]
        out[:, k] = self.start[k] + share[:, 0] * (self.end[k] - self.start[k])
        return out

    @property
    def length(self) -> float:
        if self.arc is None:
            return float(np.linalg.norm(self.end - self.start))
        plane, centre, sweep = self.arc
        i, j, k = PLANES[plane]
        radius = math.hypot(self.start[i] - centre[i], self.start[j] - centre[j])
        return math.hypot(radius * math.radians(abs(sweep)), self.end[k] - self.start[k])

    @property
    def full(self) -> bool:
        return self.arc is not None and abs(abs(self.arc[2]) % 360.0) < 1e-9


@dataclass
class Text:
    """Program lines and the leg of each line."""

    lines: list[str] = field(default_factory=list)
    leg_of_line: dict[int, int] = field(default_factory=dict)  # 1-based line → leg

    def add(self, line: str, leg: int | None = None) -> None:
        self.lines.append(line)
        if leg is not None:
            self.leg_of_line[len(self.lines)] = leg


def number(v: float, rng: random.Random, *, dot: bool = True, plus: bool = True) -> str:
    """Return ``v`` with a resolution of 1e-10 in one of the forms that CAM systems write: 5., .5, 0.500, +5."""
    text = f"{abs(v):.14f}".rstrip("0") if 0.0 < abs(v) < 1.0 else f"{abs(v):.10f}".rstrip("0")
    if text.startswith("0.") and len(text) > 2 and rng.random() < 0.5:
        text = text[1:]
    if text.endswith("."):
        text += rng.choice(["", "0", "000"]) if dot else "0"
    sign = "-" if v < 0 and float(text) != 0.0 else rng.choice(["", "+"]) if plus and rng.random() < 0.2 else ""
    return sign + text


def noise(rng: random.Random, dialect: str) -> str:
    """Return a comment line of the dialect."""
    marks = {
        "gcode": "(X9 Y9 G1)",
        "siemens": ";X9 Y9 G1",
        "heidenhain": "; L X+9",
        "apt": "$$ GOTO/9,9,9",
        "krl": "; LIN {X 9}",
        "rapid": "! MoveL p9;",
        "ur": "# movel(p[9])",
    }
    return marks[dialect]


def gcode(legs: list[Leg], rng: random.Random, *, siemens: bool = False) -> Text:
    """Write ISO G-code: omitted modal words, G90 and G91 mixed, inch or mm, centres or radii, line numbers, blanks."""
    t = Text()
    inch, absolute, motion, plane, feed = rng.random() < 0.3, True, -1, 17, math.nan
    scale = INCH if inch else 1.0
    unit = {(False, False): "G21", (False, True): "G20", (True, False): "G71", (True, True): "G700"}[siemens, inch]
    t.add(f"{unit} G90 G94 G17")
    sep = rng.choice([" ", " ", "  ", ""]) if not siemens else " "
    number_lines, lower = rng.random() < 0.5, rng.random() < 0.3
    comment = "siemens" if siemens else "gcode"
    for n, leg in enumerate(legs):
        if rng.random() < 0.15:
            t.add(noise(rng, comment))
        words: list[str] = []
        if n and rng.random() < 0.2:
            absolute = not absolute
            words.append("G90" if absolute else "G91")
        if leg.arc is not None and leg.arc[0] != plane:
            plane = leg.arc[0]
            words.append(f"G{plane}")
        m = (0 if leg.rapid else 1) if leg.arc is None else (3 if leg.arc[2] > 0 else 2)
        if m != motion or rng.random() < 0.3:
            words.append(f"G{m:02d}" if rng.random() < 0.5 else f"G{m}")
        motion = m
        given = 0
        for k, letter in enumerate("XYZ"):
            same = leg.end[k] == leg.start[k]
            if n and same and (leg.arc is None or leg.full) and rng.random() < 0.7 and (given or k < 2):
                continue
            given += 1
            v = (leg.end[k] if absolute else leg.end[k] - leg.start[k]) / scale
            if siemens and n and rng.random() < 0.2:
                way = "IC" if absolute else "AC"
                v = (leg.end[k] - leg.start[k] if absolute else leg.end[k]) / scale
                words.append(f"{letter}={way}({number(v, rng)})")
            else:
                words.append(letter + (" " if rng.random() < 0.1 and sep else "") + number(v, rng))
        if leg.arc is not None:
            words += centre_words(leg, rng, scale, siemens)
        if not leg.rapid and (leg.feed != feed or rng.random() < 0.2):
            feed = leg.feed
            words.append(f"F{number(feed / scale, rng, plus=False)}")
        text = sep.join(words)
        if number_lines:
            text = f"N{10 * (n + 1)} {text}"
        if rng.random() < 0.1:
            text += f" {noise(rng, comment)}"
        t.add(text.lower() if lower else text, n)
    t.add("M30")
    return t


def centre_words(leg: Leg, rng: random.Random, scale: float, siemens: bool) -> list[str]:
    assert leg.arc is not None
    plane, centre, sweep = leg.arc
    i, j, _ = PLANES[plane]
    turns = int((abs(sweep) - 1e-9) // 360.0)
    simple = turns == 0 and not leg.full
    if simple and 5 < abs(sweep) % 180 < 175 and rng.random() < 0.3:
        radius = math.hypot(leg.start[i] - centre[i], leg.start[j] - centre[j]) * (1 if abs(sweep) < 180 else -1)
        return [("CR=" if siemens else "R") + number(radius / scale, rng)]
    words = []
    for k in (i, j):
        if siemens and rng.random() < 0.4:
            words.append(f"{'IJK'[k]}=AC({number(centre[k] / scale, rng)})")
        else:
            words.append(f"{'IJK'[k]}{number((centre[k] - leg.start[k]) / scale, rng)}")
    if turns:
        words.append(f"TURN={turns}" if siemens else f"P{turns + 1}")
    return words


def sinumerik(legs: list[Leg], rng: random.Random) -> Text:
    return gcode(legs, rng, siemens=True)


def heidenhain(legs: list[Leg], rng: random.Random) -> Text:
    """Write Heidenhain Klartext in mm: L, CC and C, CR, CP; I words, F and FMAX."""
    t = Text()
    t.add("0 BEGIN PGM A MM")
    feed = math.nan

    def signed(v: float) -> str:
        return ("+" if v >= 0 else "-") + number(abs(v), rng, dot=False, plus=False)

    def coordinates(leg: Leg, n: int) -> str:
        out = []
        for k, c in enumerate("XYZ"):
            if n and leg.arc is None and leg.end[k] == leg.start[k] and rng.random() < 0.6 and (out or k < 2):
                continue
            inc = n > 0 and rng.random() < 0.2
            out.append(("I" if inc else "") + c + signed(leg.end[k] - leg.start[k] if inc else leg.end[k]))
        return " ".join(out)

    for n, leg in enumerate(legs):
        if rng.random() < 0.15:
            t.add(noise(rng, "heidenhain"))
        speed = " FMAX" if leg.rapid else ""
        if not leg.rapid and (leg.feed != feed or rng.random() < 0.2):
            feed, speed = leg.feed, f" F{number(leg.feed, rng, dot=False, plus=False)}"
        if leg.arc is None:
            t.add(f"{n + 1} L {coordinates(leg, n)}{rng.choice(['', ' R0'])}{speed}", n)
            continue
        _, centre, sweep = leg.arc
        way = " DR+" if sweep > 0 else " DR-"
        flat = leg.end[2] == leg.start[2]
        if flat and not leg.full and 5 < abs(sweep) % 180 < 175 and abs(sweep) < 360 and rng.random() < 0.4:
            radius = math.hypot(*(leg.start - centre)[:2]) * (1 if abs(sweep) < 180 else -1)
            t.add(f"{n + 1} CR X{signed(leg.end[0])} Y{signed(leg.end[1])} R{signed(radius)}{way}{speed}", n)
            continue
        t.add(f"CC X{signed(centre[0])} Y{signed(centre[1])}")
        if flat and abs(sweep) < 360.0 + 1e-9:
            t.add(f"{n + 1} C X{signed(leg.end[0])} Y{signed(leg.end[1])}{way}{speed}", n)
        else:
            t.add(f"{n + 1} CP IPA{signed(sweep)} IZ{signed(leg.end[2] - leg.start[2])}{way}{speed}", n)
    t.add("END PGM A MM")
    return t


def _apt_points(leg: Leg, rng: random.Random) -> str:
    blank = rng.choice(["", " "])
    return f"GOTO{rng.choice(['', '  '])}/" + f",{blank}".join(number(v, rng) for v in leg.end)


def clsf(legs: list[Leg], rng: random.Random) -> Text:
    """Write NX CLSF: the circle axis is that of clockwise travel, TIMES is the number of turns."""
    t = Text()
    t.add("TOOL PATH/A,TOOL,B")
    t.add("MSYS/0.0,0.0,0.0,1.0,0.0,0.0,0.0,1.0,0.0")
    feed = math.nan
    for n, leg in enumerate(legs):
        if rng.random() < 0.15:
            t.add(noise(rng, "apt"))
        if leg.rapid:
            t.add("RAPID")
        elif leg.feed != feed or rng.random() < 0.2:
            feed = leg.feed
            t.add(f"FEDRAT/MMPM,{number(feed, rng, plus=False)}")
        if leg.arc is not None:
            plane, centre, sweep = leg.arc
            i, j, k = PLANES[plane]
            axis, c = [0.0, 0.0, 0.0], centre.copy()
            axis[k] = -1.0 if sweep > 0 else 1.0
            c[k] = leg.end[k]
            radius = math.hypot(leg.start[i] - centre[i], leg.start[j] - centre[j])
            turns = int((abs(sweep) - 1e-9) // 360.0) + 1
            numbers = ",".join(number(v, rng) for v in (*c, *axis, radius, 0.06, 0.5, 10.0, 1.0))
            t.add(f"CIRCLE/{numbers}" + (f",TIMES,{turns}" if turns > 1 else ""))
        t.add(_apt_points(leg, rng) + (",0.0,0.0,1.0" if n == 0 else ""), n)
    t.add("END-OF-PATH")
    return t


def camworks(legs: list[Leg], rng: random.Random) -> Text:
    """Write CAMWorks APT: right-handed circle axis; equal start and end mean a full circle."""
    t = Text()
    for s in ("PARTNO/1", "UNIT/MM", "TRNTYP/WORLD,0,0,0", "CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0"):
        t.add(s)
    feed = math.nan
    for n, leg in enumerate(legs):
        if leg.rapid:
            t.add("RAPID/")
        elif leg.feed != feed or rng.random() < 0.2:
            feed = leg.feed
            t.add(f"FEDRAT/{number(feed, rng, plus=False)},MMPM")
        if leg.arc is not None:
            plane, centre, sweep = leg.arc
            k = PLANES[plane][2]
            axis, c = [0.0, 0.0, 0.0], centre.copy()
            axis[k], c[k] = (1.0 if sweep > 0 else -1.0), leg.end[k]
            t.add("CIRCLE/" + ",".join(number(v, rng) for v in (*c, *axis)))
        t.add(_apt_points(leg, rng), n)
    t.add("FINI")
    return t


def catia(legs: list[Leg], rng: random.Random) -> Text:
    """Write CATIA aptsource: the start tangent, the circle, and the end on a line from the centre."""
    t = Text()
    t.add("UNITS/MM")
    t.add("TLAXIS/ 0.000000, 0.000000, 1.000000")
    for n, leg in enumerate(legs):
        if leg.rapid:
            t.add("RAPID")
        elif leg.arc is None or leg.feed != legs[n - 1].feed or legs[n - 1].rapid:
            t.add(rng.choice(["FEDRAT/ {0},MMPM", "FEDRAT/MMPM, {0}"]).format(number(leg.feed, rng, plus=False)))
        if leg.arc is None:
            t.add(_apt_points(leg, rng), n)
            continue
        _, centre, sweep = leg.arc
        c = np.array([*centre[:2], leg.end[2]])
        spoke = leg.start - c
        tangent = np.cross([0.0, 0.0, math.copysign(1.0, sweep)], spoke) / np.linalg.norm(spoke)
        t.add("INDIRV/ " + ",".join(number(v, rng) for v in tangent))
        numbers = [",".join(number(v, rng) for v in p) for p in (c, leg.end)]
        t.add(f"TLON,GOFWD/ (CIRCLE/ {numbers[0]},$")
        t.leg_of_line[len(t.lines)] = n
        t.add(f"  {number(float(np.linalg.norm(spoke)), rng, plus=False)}),ON,(LINE/ {numbers[0]},$")
        t.add(f"  {numbers[1]})")
    t.add("FINI")
    return t


def movarc(legs: list[Leg], rng: random.Random) -> Text:
    """Write HSM APT: MOVARC/ centre, normal, radius, ANGLE, degrees; then the end point."""
    t = Text()
    t.add("UNITS/MM")
    for n, leg in enumerate(legs):
        if leg.rapid:
            t.add("RAPID")
        else:
            t.add(f"FEDRAT/{number(leg.feed, rng, plus=False)},MMPM")
        if leg.arc is not None:
            plane, centre, sweep = leg.arc
            i, j, k = PLANES[plane]
            normal, c = [0.0, 0.0, 0.0], centre.copy()
            normal[k], c[k] = (1.0 if sweep > 0 else -1.0), leg.start[k]
            radius = math.hypot(leg.start[i] - centre[i], leg.start[j] - centre[j])
            numbers = ", ".join(number(v, rng) for v in (*c, *normal, radius))
            t.add(f"MOVARC/{numbers}, ANGLE, {number(abs(sweep), rng, plus=False)}")
        t.add(_apt_points(leg, rng), n)
    t.add("FINI")
    return t


# ---- robot programs: the tool points down, arcs with an intermediate point


def _via(leg: Leg) -> Array:
    return leg.points(np.array([0.5]))[0]


def krl(legs: list[Leg], rng: random.Random) -> Text:
    t = Text()
    for s in ("&ACCESS RVP", "DEF a( )", "$BASE={X 10,Y 0,Z 5,A 0,B 0,C 0}"):
        t.add(s)
    feed = math.nan

    def aggregate(p: Array, leg: Leg | None) -> str:
        parts = [f"{c} {number(v, rng, plus=False)}" for c, v in zip("XYZ", p, strict=True)]
        if leg is not None and rng.random() < 0.5:
            parts = [w for k, w in enumerate(parts) if p[k] != leg.start[k]] or parts[:1]
            return "{" + ",".join(parts) + "}"
        return "{" + rng.choice([",", ", "]).join([*parts, "A 0", "B 0", "C 180.0"]) + "}"

    for n, leg in enumerate(legs):
        if rng.random() < 0.15:
            t.add(noise(rng, "krl"))
        if not leg.rapid and leg.feed != feed:
            feed = leg.feed
            t.add(f"$VEL.CP={number(feed / 60e3, rng, plus=False)}")
        word = rng.choice(["", "S"])
        if leg.arc is not None:
            t.add(f"{word}CIRC {aggregate(_via(leg), None)},{aggregate(leg.end, None)} C_DIS", n)
        else:
            end = aggregate(leg.end, leg if n else None)
            t.add(f"{word}{'PTP' if leg.rapid else 'LIN'} {end}{rng.choice(['', ' C_DIS'])}", n)
    t.add("END")
    return t


def rapid(legs: list[Leg], rng: random.Random) -> Text:
    t = Text()
    t.add("MODULE m")
    t.add("CONST robtarget p0:=[[0,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];")
    t.add("PROC main()")

    def target(p: Array) -> str:
        xyz = ",".join(number(v, rng, plus=False, dot=False) for v in p)
        form = rng.random()
        if form < 0.3:
            return f"Offs(p0,{xyz})"
        if form < 0.5:  # y and z of the tool point in the opposite direction
            return "RelTool(p0," + ",".join(number(v, rng, plus=False, dot=False) for v in (p[0], -p[1], -p[2])) + ")"
        return f"[[{xyz}],[0,1,0,0],[0,0,0,0],[9E9,9E+09,9E9,9E9,9E9,9E9]]"

    for n, leg in enumerate(legs):
        if rng.random() < 0.15:
            t.add(noise(rng, "rapid"))
        speed = "v1000" if leg.rapid else f"[{number(leg.feed / 60, rng, plus=False, dot=False)},500,5000,1000]"
        tail = f"{speed},{rng.choice(['fine', 'z1'])},tool0" + rng.choice(["", "\\WObj:=wobj0"]) + ";"
        if leg.arc is not None:
            t.add(f"MoveC {target(_via(leg))},{target(leg.end)},{tail}", n)
        else:
            t.add(f"  {'MoveJ' if leg.rapid else 'MoveL'} {target(leg.end)}, {tail}", n)
    t.add("ENDPROC")
    t.add("ENDMODULE")
    return t


def fanuc(legs: list[Leg], rng: random.Random) -> Text:
    t = Text()
    for s in ("/PROG A", "/ATTR", "LINE_COUNT = 1;", "/MN", " 1:  UFRAME_NUM=1 ;"):
        t.add(s)
    places: list[Array] = []
    for n, leg in enumerate(legs):
        end = rng.choice(["FINE", "CNT100"])
        mm_s = number(leg.feed / 60, rng, plus=False, dot=False) if not leg.rapid else ""
        if leg.arc is not None:
            places += [_via(leg), leg.end]
            t.add(f" {n + 2}:C P[{len(places) - 1}]", n)
            t.add(f"  :  P[{len(places)}] {mm_s}mm/sec {end} ;", n)
        else:
            places.append(leg.end)
            speed = "100%" if leg.rapid else f"{mm_s}mm/sec"
            t.add(f" {n + 2}:{'J' if leg.rapid else 'L'} P[{len(places)}] {speed} {end} ;", n)
    t.add("/POS")
    for k, p in enumerate(places):
        x, y, z = (number(v, rng, plus=False, dot=False) for v in p)
        t.add(
            f"P[{k + 1}]{{\n   GP1:\n\tUF : 1, UT : 1,\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {x} mm,\tY = {y} mm,\t"
            f"Z = {z} mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg\n}};"
        )
    t.add("/END")
    return t


def urscript(legs: list[Leg], rng: random.Random) -> Text:
    t = Text()
    t.add("def a():")

    def pose(p: Array) -> str:
        return "p[" + ",".join(f"{v * 1e-3:.13f}" for v in p) + f",{math.pi!r},0,0]"

    for n, leg in enumerate(legs):
        if rng.random() < 0.15:
            t.add("  " + noise(rng, "ur"))
        v = f"{leg.feed / 60e3:.12f}" if not leg.rapid else "1.0"
        if leg.arc is not None:
            t.add(f"  movec({pose(_via(leg))},{pose(leg.end)},1.2,{v},r=0)", n)
        elif leg.rapid:
            t.add(f"  movej({pose(leg.end)},a=1.4,v=1.05)", n)
        else:
            t.add(f"  movel({pose(leg.end)}," + rng.choice([f"1.2,{v})", f"a=1.2,v={v},r=0.001)"]), n)
    t.add("end")
    t.add("a()")
    return t


def jbi(legs: list[Leg], rng: random.Random) -> Text:
    t = Text()
    points = [leg.end for leg in legs]
    for s in (
        "/JOB",
        "//NAME A",
        "//POS",
        f"///NPOS {len(points)},0,0,0,0,0",
        "///TOOL 1",
        "///POSTYPE BASE",
        "///RECTAN",
        "///RCONF 0,0,0,0,0,0,0,0",
    ):
        t.add(s)
    for k, p in enumerate(points):
        t.add(f"C{k:05d}=" + ",".join(f"{v:.9f}" for v in p) + ",180.00,0.00,0.00")
    for s in ("//INST", "///DATE 2019/03/27 16:51", "///ATTR SC,RW,RJ", "///GROUP1 RB1", "NOP"):
        t.add(s)
    for n, leg in enumerate(legs):
        t.add(f"MOVJ C{n:05d} VJ=50.00" if leg.rapid else f"MOVL C{n:05d} V={leg.feed / 60:.10f}", n)
    t.add("END")
    return t


@dataclass(frozen=True)
class Dialect:
    """A writer and the features of its dialect."""

    write: Callable[[list[Leg], random.Random], Text]
    suffix: str
    planes: tuple[int, ...] = (17, 18, 19)
    arcs: bool = True
    helices: bool = True
    turns: int = 0  # maximum number of full turns before the last part of an arc
    full: bool = True


DIALECTS = {
    "gcode": Dialect(gcode, ".nc", turns=2),
    "siemens": Dialect(sinumerik, ".mpf", turns=2),
    "heidenhain": Dialect(heidenhain, ".h", planes=(17,), turns=2),
    "nx": Dialect(clsf, ".cls", turns=2, full=False),
    "camworks": Dialect(camworks, ".apt"),
    "catia": Dialect(catia, ".aptsource", planes=(17,), helices=False, full=False),
    "hsm": Dialect(movarc, ".apt"),
    "krl": Dialect(krl, ".src", helices=False, full=False),
    "rapid": Dialect(rapid, ".mod", helices=False, full=False),
    "fanuc": Dialect(fanuc, ".ls", helices=False, full=False),
    "urscript": Dialect(urscript, ".script", helices=False, full=False),
    "jbi": Dialect(jbi, ".jbi", arcs=False),
}
