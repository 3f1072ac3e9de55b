"""Heidenhain plain language: a line scanner."""

from __future__ import annotations

import math
import re

import numpy as np

from second_cam_reader.sampled_path import NotReadError, Path3, Vector, rot

NUM = r"[-+]?\s*(?:\d+\.?\d*|\.\d+)"
COORD = re.compile(rf"(?<![A-Z])(I?[XYZABC])\s*({NUM})")
KEYED = re.compile(rf"\bQ(\d+)\s*=\s*({NUM})")
HOLES = {1, 17, 200, 201, 202, 203, 204, 205, 207, 240}
FEED_OUT = {17, 201, 207}


def read(text: str) -> Path3:
    """The path of one plain-language program."""
    t = Tnc()
    lines = joined(text)
    labels = {m[1]: n for n, (_, s) in enumerate(lines) if (m := re.match(r'LBL\s+("?\w+"?)', s)) and m[1] != "0"}
    n, back = 0, []
    while n < len(lines):
        number, s = lines[n]
        n += 1
        if m := re.match(r'CALL LBL\s+("?\w+"?)(\s+REP\s*(\d+))?', s):
            if m[2]:
                raise NotReadError(f"line {number}: a repeated program part")
            back.append(n)
            n = labels[m[1]] + 1
        elif re.match(r"LBL\s+0", s) and back:
            n = back.pop()
        else:
            t.block(s, number)
    return t.path


def joined(text: str) -> list[tuple[int, str]]:
    """(line number, block) without block numbers and comments; a `~` and lines of Q words continue a block."""
    out: list[tuple[int, str]] = []
    more = False
    for number, raw in enumerate(text.splitlines(), 1):
        s = re.sub(r";[^~]*", "", raw).strip().upper()
        goes_on = s.endswith("~")
        s = s.rstrip("~ ").strip()
        if (more or re.match(r"Q\d+\s*=", s)) and out:
            out[-1] = (out[-1][0], out[-1][1] + " " + s)
        else:
            s = re.sub(r"^\d+\s+", "", s)
            if s:
                out.append((number, s))
        more = goes_on or (more and not s)
    return out


class Tnc:
    """Modal state of the control."""

    def __init__(self) -> None:
        self.path = Path3("heidenhain")
        self.scale = 1.0
        self.place = [math.nan] * 3
        self.pole = [0.0, 0.0]
        self.feed = math.nan
        self.shift = np.zeros(3)
        self.tilt: Vector = np.eye(3)
        self.rotary = dict.fromkeys("ABC", 0.0)
        self.tilted = self.tip = False
        self.cycle: dict[int, float] | None = None
        self.number = 0
        self.old: dict[str, float] = {}

    def block(self, s: str, line: int) -> None:
        if re.match(r"BEGIN PGM", s):
            self.scale = 25.4 if s.endswith(("INCH", " IN")) else 1.0
            self.path.unit = "inch" if self.scale > 1 else "mm"
        elif m := re.match(r"TOOL CALL\s+(\S+)", s):
            self.path.tool(m[1])
        elif re.match(r"PLANE", s):
            self.plane(s, line)
        elif re.match(r"CYC", s):
            self.define(s, line)
        elif re.match(r"(RND|CHF|CT|APPR|DEP|LN|FN|Q\d|CALL PGM|FUNCTION|CYCL CALL PAT)", s):
            if s.startswith("CALL PGM"):
                self.path.note(f"line {line}: {s} is another file")
                return
            raise NotReadError(f"line {line}: {s[:30]}")
        elif re.match(r"CC\b", s):
            for name, v in self.words(s[2:]):
                if name[-1] not in "XY":
                    raise NotReadError(f"line {line}: an arc in another plane than XY")
                k = "XY".index(name[-1])
                self.pole[k] = v + (self.place[k] if name[0] == "I" else 0.0)
        elif re.match(r"L\b|C\b|CR\b|CP\b", s):
            self.move(s, line)
        elif re.match(r"CYCL CALL", s):
            self.drill(line)

    def words(self, s: str) -> list[tuple[str, float]]:
        return [(a, float(re.sub(r"\s", "", b)) * (1.0 if a[-1] in "ABC" else self.scale)) for a, b in COORD.findall(s)]

    def plane(self, s: str, line: int) -> None:
        if "RESET" in s:
            self.tilt, self.tilted = np.eye(3), False
        elif m := re.match(rf"PLANE SPATIAL\s+SPA\s*({NUM})\s+SPB\s*({NUM})\s+SPC\s*({NUM})", s):
            a, b, c = (float(v) for v in m.groups())
            self.tilt, self.tilted = rot("Z", c) @ rot("Y", b) @ rot("X", a), True
        else:
            raise NotReadError(f"line {line}: {s[:30]}")
        self.place = [math.nan] * 3  # the same place has other coordinates now

    def define(self, s: str, line: int) -> None:
        m = re.match(r"CYCLE? DEF\s+(\d+)(?:\.(\d+))?", s)
        number, part = (int(m[1]), m[2]) if m else (0, None)
        if number == 7 and part != "0":
            if "#" in s:
                raise NotReadError(f"line {line}: a datum of the control's table")
            for name, v in self.words(s.split(maxsplit=3)[-1]):
                k = "XYZ".index(name[-1])
                self.place[k] += self.shift[k] - (v + (self.shift[k] if name[0] == "I" else 0.0))
                self.shift[k] = v + (self.shift[k] if name[0] == "I" else 0.0)
        elif number == 19 and part != "0":
            angles = dict(self.words(s.split(maxsplit=3)[-1])) if len(s.split()) > 3 else {}
            self.tilt = rot("Z", angles.get("C", 0)) @ rot("Y", angles.get("B", 0)) @ rot("X", angles.get("A", 0))
            self.tilted, self.place = bool(angles), [math.nan] * 3
        elif number in (8, 10, 11, 26):
            raise NotReadError(f"line {line}: {s[:30]}")
        elif number == 1 and part != "0":
            if w := re.search(rf"\b(DIST|DEPTH|PLNGNG|F)\s*({NUM})", s):
                self.old[w[1]] = float(w[2]) * self.scale
            self.number, self.cycle = 1, {}
        elif number in HOLES and part is None:
            self.number = number
            self.cycle = {int(a): float(re.sub(r"\s", "", b)) for a, b in KEYED.findall(s)}
        elif number > 199 and number != 247:
            raise NotReadError(f"line {line}: cycle {number}")

    def world(self, place: list[float]) -> Vector:
        return self.tilt @ np.array(place) + self.shift

    def move(self, s: str, line: int) -> None:
        kind = s.split(maxsplit=1)[0]
        if re.search(r"\bM128\b", s):
            self.tip = True
        if re.search(r"\bM129\b", s):
            self.tip = False
        rapid = "FMAX" in s or re.search(r"\bF\s*MAX", s) is not None
        if f := re.search(rf"\bF\s*({NUM})", s):
            self.feed = float(f[1]) * (2.54 if self.scale > 1 else 1.0)  # inch programs: tenths of inch/min
        words = self.words(
            re.sub(r"\b(F|R|DR|M|S|IPA|PA|PR)\s*[-+]?[\d.]*|\bFMAX|\bR[LR0]\b", " ", s[len(kind) :])
            if kind != "CP"
            else re.sub(r"\b(IPA|PA)\s*[-+]?[\d.]+|DR[-+]", " ", s[2:])
        )
        if re.search(r"\bM91\b|\bM92\b", s):
            for name, _ in words:
                if name[-1] in "XYZ":
                    self.place["XYZ".index(name[-1])] = math.nan
            self.turn(words)
            return
        end = list(self.place)
        for name, v in words:
            if name[-1] in "XYZ":
                k = "XYZ".index(name[-1])
                end[k] = v + (end[k] if name[0] == "I" else 0.0)
        self.turn(words)
        straight = kind == "L"
        if straight and not any(n[-1] in "XYZ" for n, _ in words):
            pass
        elif straight:
            self.place = end
            self.go(end, rapid, line)
        else:
            self.arc(kind, s, end, line)
        if re.search(r"\bM99\b", s):
            self.drill(line)

    def turn(self, words: list[tuple[str, float]]) -> None:
        for name, v in words:
            if name[-1] in "ABC":
                self.rotary[name[-1]] = v + (self.rotary[name[-1]] if name[0] == "I" else 0.0)

    def go(self, place: list[float], rapid: bool, line: int, feed: float | None = None) -> None:
        if any(math.isnan(v) for v in place):
            return
        if any(abs(v % 360) > 1e-9 for v in self.rotary.values()) and not self.tip and not self.tilted:
            raise NotReadError(f"line {line}: turned rotary axes without M128 or PLANE")
        axis = self.tilt @ np.array([0.0, 0.0, 1.0])
        self.path.line_to(
            self.world(place), rapid=rapid, feed=self.feed if feed is None else feed, line=line, axis=axis.tolist()
        )

    def arc(self, kind: str, s: str, end: list[float], line: int) -> None:
        way = re.search(r"DR\s*([-+])", s)
        if not way:
            raise NotReadError(f"line {line}: an arc without DR")
        normal = [0.0, 0.0, 1.0 if way[1] == "+" else -1.0]
        centre = np.array([*self.pole, self.place[2]])
        turns = 0
        if kind == "CR":
            r = re.search(rf"\bR\s*({NUM})", s)
            assert r is not None
            radius = float(r[1]) * self.scale
            a, b = np.array(self.place), np.array(end)
            d = b - a
            d[2] = 0.0
            chord = float(np.linalg.norm(d))
            h = math.sqrt(max(0.0, radius * radius - chord * chord / 4))
            centre = a + d / 2 + np.cross(normal, d / chord) * (h if radius > 0 else -h)
        elif kind == "CP":
            w = re.search(rf"\b(I?)PA\s*({NUM})", s)
            assert w is not None
            x, y = (self.place[k] - self.pole[k] for k in (0, 1))
            radius, before = math.hypot(x, y), math.degrees(math.atan2(y, x))
            angle = float(w[2]) + (before if w[1] else 0.0)
            turns = int((abs(float(w[2])) - 1e-9) // 360) if w[1] else 0
            end[0] = self.pole[0] + radius * math.cos(math.radians(angle))
            end[1] = self.pole[1] + radius * math.sin(math.radians(angle))
        if any(math.isnan(v) for v in end + self.place):
            raise NotReadError(f"line {line}: an arc from a place that is not known")
        axis = self.tilt @ np.array([0.0, 0.0, 1.0])
        self.path.at = self.world(self.place)
        self.path.arc_to(
            self.world(end),
            self.world(centre.tolist()),
            (self.tilt @ np.array(normal)).tolist(),
            turns,
            feed=self.feed,
            line=line,
            axis=axis.tolist(),
        )
        self.place = end

    def drill(self, line: int) -> None:
        if self.cycle is None:
            raise NotReadError(f"line {line}: a cycle call without a cycle")
        c, k = self.cycle, self.scale
        self.path.pecks |= self.number in (1, 203, 205) or 0.0 < c.get(202, 0.0) < abs(c.get(201, 0.0))
        if self.number == 1:
            clear = self.place[2]
            surface = clear - abs(self.old["DIST"])
            depth, back, feed = surface + self.old["DEPTH"], clear, self.old.get("F", self.feed)
        else:
            surface = c.get(203, 0.0) * k
            clear = surface + c.get(200, 0.0) * k
            depth = surface + c.get(201, 0.0) * k
            back = max(clear, surface + c.get(204, 0.0) * k)
            feed = c.get(206, math.nan) * (2.54 if k > 1 else 1.0)
        place = list(self.place)
        for level, rapid in ((clear, True), (depth, False), (clear, self.number not in FEED_OUT), (back, True)):
            place[2] = level
            self.go(place, rapid, line, feed)
        self.place = place
