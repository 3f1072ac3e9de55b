"""CL data: NX CLSF, CATIA aptsource, CAMWorks APT and CLT, HSM APT: a statement scanner."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np

from second_cam_reader.sampled_path import NotReadError, Path3, Vector

NUM = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][-+]?\d+)?")
WAYS = {"MMPM": 1.0, "MMPR": math.nan, "IPM": 25.4, "IPR": math.nan, "PERMIN": 1.0}


def statements(text: str) -> list[tuple[int, str]]:
    """(line number, statement): `$$` comments off, `$` at the end of a line continues."""
    out: list[tuple[int, str]] = []
    more = False
    for number, raw in enumerate(text.splitlines(), 1):
        s = raw.split("$$")[0].rstrip()
        goes_on = s.endswith("$")
        s = s.rstrip("$").strip().upper()
        if more and out:
            out[-1] = (out[-1][0], out[-1][1] + s)
        elif s:
            out.append((number, s))
        more = goes_on
    return out


def numbers(s: str) -> list[float]:
    return [float(v.replace("D", "E").replace("d", "e")) for v in NUM.findall(s)]


class Reader:
    """State between statements."""

    def __init__(self, dialect: str) -> None:
        self.dialect = dialect
        self.path = Path3(f"apt/{dialect}")
        self.unit = 1.0
        self.axis = (0.0, 0.0, 1.0)
        self.feed, self.rapid = math.nan, False
        self.circle: list[float] | None = None
        self.times = 1
        self.cycle: dict[str, float] | None = None
        self.start_direction: Vector | None = None
        self.incremental = False

    def goto(self, values: list[float], line: int) -> None:
        if len(values) >= 6:
            self.axis = (values[3], values[4], values[5])
        elif self.dialect == "camworks":
            self.axis = (0.0, 0.0, 1.0)  # not modal: its RTRCTO levels come out round this way only
        end = np.array(values[:3]) * self.unit
        if self.incremental and self.path.at is not None:
            end = end + self.path.at
        if self.cycle is not None:
            self.hole(end, line)
        elif self.circle is not None:
            c, sign = self.circle, -1.0 if self.dialect == "nx" else 1.0
            normal = [sign * v for v in c[3:6]]
            centre, n = np.array(c[:3]) * self.unit, np.array(normal)
            assert self.path.at is not None
            centre = centre - ((centre - self.path.at) @ n) * n / (n @ n)
            self.path.arc_to(end, centre, normal, self.times - 1, feed=self.feed, line=line, axis=self.axis)
            self.circle, self.times = None, 1
        else:
            self.path.line_to(end, rapid=self.rapid, feed=self.feed, line=line, axis=self.axis)
        self.rapid = False

    def hole(self, top: Vector, line: int) -> None:
        assert self.cycle is not None
        up = np.array(self.axis) / np.linalg.norm(self.axis)
        clear = top + up * self.cycle["RAPTO"]
        bottom = top - up * self.cycle["DEPTH"]
        back = top + up * max(self.cycle.get("RTRCTO", self.cycle["RAPTO"]), self.cycle["RAPTO"])
        feed = self.cycle.get("FEED", self.feed)
        if self.path.at is not None:
            above = self.path.at + up * float((top - self.path.at) @ up)
            level = float((self.path.at - clear) @ up)
            if level > 1e-9 and float(np.linalg.norm(above - top)) > 1e-9:  # across at the level where it stands
                self.path.line_to(clear + up * level, rapid=True, feed=0.0, line=line, axis=self.axis)
        tap = self.cycle.get("TAP") == 1.0
        self.path.line_to(clear, rapid=True, feed=0.0, line=line, axis=self.axis)
        self.path.line_to(bottom, rapid=False, feed=feed, line=line, axis=self.axis)
        if tap:
            self.path.line_to(clear, rapid=False, feed=feed, line=line, axis=self.axis)
        self.path.line_to(
            back, rapid=not tap or bool(np.linalg.norm(back - clear)), feed=0.0, line=line, axis=self.axis
        )


def read(text: str) -> Path3:
    """The path of CL data."""
    every = statements(text)
    body = "\n".join(s for _, s in every)
    if re.search(r"^\w+\s*=\s*(POINT|LINE|CIRCLE|PLANE|CYLNDR)/?|^(CONTRL|LOOPST|GOLFT|GORGT)", body, re.M):
        raise NotReadError("an APT part program without points")
    telling = {"TOOL PATH/": "nx", "OPFEATSTART": "clt", "TRNTYP": "camworks", "CSI_SET": "camworks", "MOVARC": "hsm"}
    dialect = next((d for words, d in telling.items() if words in body), "catia")
    r = Reader(dialect)
    k = 0
    while k < len(every):
        line, s = every[k]
        k += 1
        word, _, rest = (t.strip() for t in s.partition("/"))
        if word == "GOTO":
            r.goto(numbers(rest), line)
        elif word == "RAPID":
            r.rapid = True
        elif word in ("FROM", "GODLTA"):
            if word == "GODLTA":
                raise NotReadError(f"line {line}: GODLTA")
            r.path.line_to(np.array(numbers(rest)[:3]) * r.unit, rapid=True, feed=0.0, line=line)
        elif word == "GOHOME":
            if len(numbers(rest)) < 3:
                r.path.at = None
                continue
            r.rapid = True
            r.goto(numbers(rest)[:3], line)
        elif word == "FEDRAT":
            v = numbers(rest)
            way = next((f for w, f in WAYS.items() if w in rest), r.unit)
            if v:
                r.feed, r.rapid = v[0] * way, False
        elif word in ("UNITS", "UNIT"):
            r.unit = 25.4 if "IN" in rest else 1.0
            r.path.unit = "inch" if "IN" in rest else "mm"
        elif word == "CIRCLE":
            r.circle = numbers(rest.split("TIMES")[0])
            r.times = int(numbers(rest.split("TIMES")[1])[0]) if "TIMES" in rest else 1
        elif word == "TLAXIS" and dialect != "clt":
            v = numbers(rest)
            r.axis = (v[0], v[1], v[2])
        elif word in ("LOADTL", "LOAD"):
            r.path.tool(f"{(numbers(rest) or [0])[0]:g}")
        elif word == "CYCLE":
            r.cycle = cycle(rest, r)
        elif word == "NURBS":
            k = nurbs(r, every, k, line)
        elif word == "INDIRV":
            r.start_direction = np.array(numbers(rest)[:3])
        elif word.startswith("TLON") or s.startswith("TLON"):
            tlon(r, s, line)
        elif word == "SET" and "MODE" in rest:
            r.incremental = "INCR" in rest
        elif word in ("MOVARC", "CALLSUB", "TRANS", "COPY", "HELICAL", "TRACUT"):
            raise NotReadError(f"line {line}: {word}")
    return r.path


def cycle(rest: str, r: Reader) -> dict[str, float] | None:
    """The arguments of a cycle, or None for OFF."""
    if re.match(r"OFF", rest):
        return None
    if re.match(r"(INIT|ON)\b", rest):
        return r.cycle
    parts = [p for p in re.split(r"[,\s]+", rest) if p]
    r.path.pecks |= "PECK" in rest or ("DEEP" in rest and r.dialect != "nx")
    given: dict[str, float] = {"TAP": 1.0 if parts[0] == "TAP" else 0.0}
    for a, b in itertools.pairwise(parts):
        if a in ("RAPTO", "FEDTO", "RTRCTO", "MMPM", "IPM") and NUM.fullmatch(b):
            given["FEED" if a in WAYS else a] = float(b) * (25.4 if a == "IPM" else r.unit)
    if r.dialect == "nx":
        given["DEPTH"] = -given.get("FEDTO", 0.0)
    elif r.dialect == "camworks":
        given["DEPTH"] = given["FEDTO"]
    else:
        v = [float(p) for p in parts[1:] if NUM.fullmatch(p)]
        if r.dialect == "clt":  # DRILL,G98,depth,PECKING,first,sub,MMPM,f,clearance,return return ...
            given |= {"DEPTH": v[0], "FEED": v[3], "RAPTO": v[4], "RTRCTO": v[5]}
        else:  # CATIA: depth, clearance
            given |= {"DEPTH": v[0], "RAPTO": v[1]}
    given.setdefault("RAPTO", 0.0)
    return given


def tlon(r: Reader, s: str, line: int) -> None:
    """CATIA's arc: the circle's centre and radius, the end on a line from the centre."""
    m = re.search(r"\(CIRCLE/([^)]*)\),ON,(2,INTOF,)?\(LINE/([^)]*)\)", s.replace(" ", ""))
    if not m or r.start_direction is None or r.path.at is None or m[2]:
        raise NotReadError(f"line {line}: {s[:40]}")
    c, end = np.array(numbers(m[1])[:3]) * r.unit, np.array(numbers(m[3])[3:6]) * r.unit
    normal = np.cross(r.path.at - c, r.start_direction)
    r.path.arc_to(end, c, normal.tolist(), feed=r.feed, line=line, rapid=r.rapid, axis=r.axis)


def nurbs(r: Reader, every: list[tuple[int, str]], k: int, line: int) -> int:
    """A cubic spline from where the path stands over all CNTRL points; the next GOTO is a line of its own."""
    assert r.path.at is not None
    inner: list[float] = []
    control = [r.path.at]
    while every[k][1].startswith(("KNOT", "CNTRL", "PAINT")):
        word, _, rest = every[k][1].partition("/")
        if word == "KNOT":
            inner += numbers(rest)
        elif word == "CNTRL":
            control.append(np.array(numbers(rest)[:3]))
        elif len(control) > 1:
            break
        k += 1
    knots = [0.0] * 4 + inner + [inner[-1]] * 3
    if len(knots) != len(control) + 4:
        raise NotReadError(f"line {line}: {len(control)} control points and {len(inner)} knots")
    places = np.array(control)
    t = np.unique(np.concatenate([np.linspace(a, b, 60) for a, b in zip([0.0, *inner], inner, strict=False)]))[1:]
    pts = np.array([de_boor(places, knots, v) for v in t])
    length = float(np.linalg.norm(np.diff(np.vstack([places[:1], pts]), axis=0), axis=1).sum())
    r.path._add(pts, length, False, r.feed, True, line, r.axis)
    return k


def de_boor(control: Vector, knots: list[float], t: float, degree: int = 3) -> Vector:
    """A point of the spline."""
    span = min(max(j for j in range(len(control)) if knots[j] <= t + 1e-15), len(control) - 1)
    d = [control[j + span - degree] for j in range(degree + 1)]
    for step in range(1, degree + 1):
        for j in range(degree, step - 1, -1):
            low, high = knots[j + span - degree], knots[j + 1 + span - step]
            a = 0.0 if high == low else (t - low) / (high - low)
            d[j] = (1 - a) * d[j - 1] + a * d[j]
    out: Vector = d[degree]
    return out
