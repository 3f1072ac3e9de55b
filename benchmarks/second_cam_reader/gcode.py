"""G-code of the ISO kind, with the Siemens words `CR=`, `I=AC()`, `TURN=`, `MCALL CYCLE8x`: a line scanner."""

from __future__ import annotations

import math
import re

import numpy as np

from second_cam_reader.sampled_path import NotReadError, Path3, Vector

NUMBER = r"[-+]?\s*(?:\d+\.?\d*|\.\d+)"
WORD = re.compile(rf"([A-Z])\s*({NUMBER})")
KEYED = re.compile(rf"\b([A-Z]+\d*)\s*=\s*(?:(AC|IC)\s*\(\s*({NUMBER})\s*\)|({NUMBER}))")
EXPONENT = re.compile(r"\d\.?\d*E[-+]?\d")
SIEMENS_CYCLE = re.compile(r"(MCALL\s+)?CYCLE(8\d|840)\s*\(([^)]*)\)")
AXES = {"X": 0, "Y": 1, "Z": 2, "U": 0, "V": 1, "W": 2}
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
INCH = 25.4
MODAL_MOTION = {0, 1, 2, 3, 33}
CYCLES = {73, 74, 76, 77, 81, 82, 83, 84, 85, 86, 87, 88, 89}
FEED_OUT = {74, 84, 85, 89}  # these leave the hole at feed
FRAME_WORDS = ("G68", "G16", "G51", "G5 ", "ROT", "CYCLE800", "G52 ", "G92 ", "TRANS ", "AROT", "MIRROR", "SCALE")
PROGRAM_WORDS = re.compile(r"#|\bO\s*<|\b(WHILE|GOTO[BF]?|FOR|IF|REPEAT|PROC|DEF)\b|\bR\d+\s*=[^,]*$|CALL\s|=\s*R\d|\[")


def strip(line: str, siemens: bool) -> str:
    """The line in capitals without comments, block number and tape marks."""
    if not siemens:
        out, depth = [], 0
        for c in line:
            depth += c == "("
            if depth == 0:
                out.append(c)
            depth = max(0, depth - (c == ")"))
        line = "".join(out)
    line = re.sub(r'MSG\s*\(.*\)|"[^"]*"', "", line.split(";")[0])
    line = line.strip().upper().lstrip("/")
    return re.sub(r"^\s*[N:]\s*\d+\s*", "", line)


class Control:
    """The modal state and the path that comes of it."""

    def __init__(self, dialect: str, unit: float) -> None:
        self.path = Path3(dialect)
        self.scale = unit
        self.place: list[float] = [math.nan] * 3  # mm, programmed
        self.motion, self.plane, self.absolute, self.centre_absolute = 0, 17, True, False
        self.feed, self.per_rev, self.inverse, self.speed = math.nan, False, False, math.nan
        self.cycle: dict[str, float] = {}
        self.initial, self.to_initial = math.nan, True
        self.siemens_cycle: list[float] | None = None
        self.siemens_number = 0
        self.rotary = dict.fromkeys("ABC", 0.0)
        self.tip = False  # tool-centre-point control
        self.offsets: list[str] = []

    # -- places ---------------------------------------------------------------------------------------------
    def target(self, words: dict[str, tuple[float, str]]) -> list[float]:
        place = list(self.place)
        for name, (value, way) in words.items():
            if name in AXES:
                k, v = AXES[name], value * self.scale
                incremental = way == "IC" or (not self.absolute and way != "AC") or name in "UVW"
                place[k] = place[k] + v if incremental else v
        return place

    def go(self, place: list[float], rapid: bool, line: int, feed: float | None = None) -> None:
        self.place = list(place)
        if not any(math.isnan(v) for v in place):
            if any(abs(v % 360) > 1e-9 for v in self.rotary.values()) and not self.tip:
                raise NotReadError(f"line {line}: cuts with turned rotary axes and without tool-centre-point control")
            self.path.line_to(np.array(place), rapid=rapid, feed=self.feed if feed is None else feed, line=line)

    def arc(self, words: dict[str, tuple[float, str]], line: int) -> None:
        i, j, k = PLANES[self.plane]
        end = self.target(words)
        start = list(self.place)
        for axis in (i, j, k):  # an axis not known before: it is where the end says it is
            if math.isnan(start[axis]):
                start[axis] = end[axis]
        if any(math.isnan(v) for v in end + start):
            raise NotReadError(f"line {line}: an arc from a place that is not known")
        if self.path.at is None:
            self.path.at = np.array(start)
        normal = np.zeros(3)
        normal[k] = 1.0 if self.motion == 3 else -1.0
        radius = next((words[w][0] * self.scale for w in ("CR", "R") if w in words), None)
        turns = int(words["TURN"][0]) if "TURN" in words else 0
        if "P" in words and "TURN" not in words and radius is None and words["P"][0] == int(words["P"][0]) > 0:
            turns = int(words["P"][0]) - 1  # LinuxCNC: number of turns
        centre = np.array(start)
        if radius is not None:
            centre = self.by_radius(np.array(start), np.array(end), radius, normal, (i, j), line)
        elif not any(w in words for w in "IJK"):
            raise NotReadError(f"line {line}: an arc without centre or radius")
        else:
            for axis, word in ((0, "I"), (1, "J"), (2, "K")):
                if word in words and axis != k:
                    value, way = words[word]
                    absolute = way == "AC" or (self.centre_absolute and way != "IC")
                    centre[axis] = value * self.scale if absolute else start[axis] + value * self.scale
            absolute = centre - start
            if self.disagrees(start, end, centre, (i, j)) and not self.disagrees(start, end, absolute, (i, j)):
                centre = absolute
                self.path.note("I, J, K are absolute centres")
        self.path.arc_to(np.array(end), centre, normal, turns, feed=self.move_feed(line), line=line)
        self.place = end

    @staticmethod
    def disagrees(start: list[float], end: list[float], centre: Vector, ij: tuple[int, int]) -> bool:
        a, b = (math.hypot(*(p[m] - centre[m] for m in ij)) for p in (start, end))
        return abs(a - b) > max(0.05, 0.02 * a)

    def by_radius(self, s: Vector, e: Vector, r: float, n: Vector, ij: tuple[int, int], line: int) -> Vector:
        d = np.zeros(3)
        for m in ij:
            d[m] = e[m] - s[m]
        chord = float(np.linalg.norm(d))
        if chord < 1e-9:
            raise NotReadError(f"line {line}: a full circle by its radius")
        if chord > 2 * abs(r) * 1.01:
            raise NotReadError(f"line {line}: a radius of {abs(r):.4f} mm for a chord of {chord:.4f} mm")
        height = math.sqrt(max(0.0, r * r - chord * chord / 4))
        left = np.cross(n, d / chord)  # counter-clockwise about n: the centre of a minor arc is on the left
        out: Vector = s + d / 2 + left * (height if r > 0 else -height)
        return out

    def move_feed(self, line: int) -> float:
        return self.feed

    # -- holes ----------------------------------------------------------------------------------------------
    def hole(self, words: dict[str, tuple[float, str]], line: int) -> None:
        k = PLANES[self.plane][2]
        name = "XYZ"[k]
        self.path.pecks |= self.motion in (73, 83)
        for w, (value, _) in words.items():
            if w in (name, "R"):
                self.cycle[w] = value * self.scale
        if math.isnan(self.initial):
            self.initial = self.place[k]
        initial = self.initial
        place = self.target({w: v for w, v in words.items() if w in AXES and AXES[w] != k})
        place[k] = self.place[k]
        clear = self.cycle.get("R", initial if self.absolute else 0.0)
        if not self.absolute:
            clear = initial + clear
        depth = self.cycle.get(name, math.nan)
        depth = clear + depth if not self.absolute else depth
        if math.isnan(depth):
            raise NotReadError(f"line {line}: a hole without a depth")
        repeat = int(next((words[w][0] for w in ("L", "K") if w in words), 1))
        step = [b - a for a, b in zip(self.place, place, strict=True)]
        for n in range(repeat if not self.absolute else min(repeat, 1)):
            if n:
                place = [p + s for p, s in zip(place, step, strict=True)]
            self.drill(
                place, clear, depth, max(initial, clear) if self.to_initial else clear, int(self.motion), line, k
            )

    def drill(
        self, place: list[float], clear: float, depth: float, back: float, cycle: int, line: int, k: int = 2
    ) -> None:
        place = list(place)
        feed_out = cycle in FEED_OUT
        for level, rapid in (
            (place[k], True),
            (clear, True),
            (depth, False),
            (clear if feed_out else back, not feed_out),
        ):
            place[k] = level
            self.go(place, rapid, line)
        if feed_out and back > clear:  # at feed to the clearance, rapid from there
            place[k] = back
            self.go(place, True, line)

    def siemens_hole(self, words: dict[str, tuple[float, str]], line: int) -> None:
        assert self.siemens_cycle is not None
        rtp, rfp, sdis, dp, dpr = (*self.siemens_cycle, *[math.nan] * 5)[:5]
        depth = dp if not math.isnan(dp) else rfp - dpr
        place = self.target(words)
        k = PLANES[self.plane][2]
        s = self.scale
        number = 84 if self.siemens_number in (84, 840, 85, 89) else 81
        place[k] = self.place[k]
        self.path.pecks |= self.siemens_number == 83
        self.drill(place, (rfp + abs(sdis)) * s, depth * s, rtp * s, number, line, k)


def read(text: str, dialect: str = "gcode", unit: float = 1.0) -> Path3:
    """The path of a G-code program; ``unit`` mm per programmed unit where no G20/G21 stands."""
    siemens = dialect == "siemens"
    c = Control(dialect, unit)
    lines = [strip(raw, siemens) for raw in text.splitlines()]
    if any(re.search(r"\bG7\s+[A-C]5=|\bG141\b", s) for s in lines):
        raise NotReadError("a MillPlus program")
    for number, code in enumerate(lines, 1):
        if not code or code.startswith(("%", "O", "=")) or re.match(r"(INFORMATION|DATE|CURRENT|NODE)\b", code):
            if code.startswith("O<"):
                raise NotReadError(f"line {number}: subroutines and expressions")
            continue
        block(c, code, number, siemens)
    c.path.unit = "inch" if c.scale == INCH else "mm"
    if len(c.offsets) > 1:
        c.path.note("work offsets " + ", ".join(c.offsets))
    return c.path


def block(c: Control, code: str, number: int, siemens: bool) -> None:
    """One block."""
    if PROGRAM_WORDS.search(code) and not re.match(r"(MCALL\s+)?CYCLE", code):
        raise NotReadError(f"line {number}: an expression or program flow: {code[:40]}")
    if EXPONENT.search(code):
        raise NotReadError(f"line {number}: a number with an exponent")
    if code.startswith(FRAME_WORDS):
        raise NotReadError(f"line {number}: a frame: {code[:40]}")
    if (siemens and "MCALL" in code) or re.match(r"CYCLE8", code):
        found = SIEMENS_CYCLE.search(code)
        c.siemens_cycle, c.siemens_number = None, 0
        if found and found[2] != "80":
            args = [a.strip() for a in found[3].split(",")]
            c.siemens_cycle, c.siemens_number = [float(a) if a else math.nan for a in args], int(found[2])
            if not found[1]:
                c.siemens_hole({}, number)
                c.siemens_cycle = None
        return
    if re.match(r"TRAORI", code):
        c.tip = True
        return
    if re.match(r"TRAFOOF", code):
        c.tip, c.rotary = False, dict.fromkeys("ABC", 0.0)
        return
    words: dict[str, tuple[float, str]] = {}
    gs: list[float] = []
    ms: list[int] = []
    for name, way, in_way, plain in KEYED.findall(code):
        words[name] = (float(re.sub(r"\s", "", in_way or plain)), way)
    rest = KEYED.sub(" ", code)
    for letter, value in WORD.findall(rest):
        v = float(re.sub(r"\s", "", value))
        if letter == "G":
            gs.append(v)
        elif letter == "M":
            ms.append(int(v))
        else:
            words[letter] = (v, "")
    modal(c, gs, ms, words, number, siemens)
    for letter in "ABC":
        if letter in words:
            c.rotary[letter] = words[letter][0]
    moves = any(w in AXES for w in words) and not {4.0, 10.0} & set(gs)
    if ({28.0, 30.0, 53.0, 74.0, 75.0} & set(gs) and not (74.0 in gs and c.motion == 74)) or "SUPA" in code or 91 in ms:
        for w in words:
            if w in AXES:
                c.place[AXES[w]] = math.nan
        return
    if c.motion in CYCLES and (moves or {g for g in gs if g in CYCLES}):
        c.hole(words, number)
    elif c.siemens_cycle is not None and moves:
        c.siemens_hole(words, number)
    elif c.motion in (2, 3) and (moves or any(w in words for w in "IJK") or "CR" in words):
        c.arc(words, number)
    elif moves and c.motion in MODAL_MOTION:
        c.go(c.target(words), c.motion == 0, number)
    if 2 in ms or 30 in ms:
        c.path.note("ended by M2 or M30")


def modal(
    c: Control, gs: list[float], ms: list[int], words: dict[str, tuple[float, str]], number: int, siemens: bool
) -> None:
    """Take over what holds from this block on."""
    for g in gs:
        if g in MODAL_MOTION:
            c.motion = int(g)
        elif g in CYCLES and not (g == 74 and siemens):
            if c.motion not in CYCLES:
                c.initial, c.cycle = c.place[PLANES[c.plane][2]], {}
            c.motion = int(g)
        elif g == 80:
            c.motion = 0
        elif g in PLANES:
            c.plane = int(g)
        elif g in (20, 70, 700):
            c.scale = INCH
        elif g in (21, 71, 710):
            c.scale = 1.0
        elif g in (90, 91):
            c.absolute = g == 90
        elif g == 90.1:
            c.centre_absolute = True
        elif g in (98, 99):
            c.to_initial = g == 98
        elif g in (93, 94, 95):
            c.inverse, c.per_rev = g == 93, g == 95
        elif g in (43.4, 43.5, 234):
            c.tip = True
        elif g == 49:
            c.tip = False
        elif 54 <= g < 60 and f"G{g:g}" not in c.offsets:
            c.offsets.append(f"G{g:g}")
        elif g in (68.2, 52, 92, 16, 51) and any(v[0] for v in words.values()):
            raise NotReadError(f"line {number}: a frame G{g:g}")
    for m in ms:
        if m in (428, 429):
            c.tip = m == 428
        if m == 6:
            c.path.tool(f"{words['T'][0]:g}" if "T" in words else "?")
    if "S" in words:
        c.speed = words["S"][0]
    if "F" in words:
        c.feed = words["F"][0] * c.scale if not c.inverse else math.nan
        if c.per_rev:
            c.feed *= c.speed
