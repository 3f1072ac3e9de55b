"""Heidenhain conversational programs (``BEGIN PGM``): L, LN, CC, C, CR, drilling cycles 1 and 200 with M99.

The circle centre CC stays until the next one. Under M128 or FUNCTION TCPM the points are the tool tip's; LN gives
the tool axis as TX, TY, TZ. Subprograms, tilted planes and polar coordinates are refused.
"""

from __future__ import annotations

import math
import re

import numpy as np

from machopt.domain.toolpath import Toolpath
from machopt.formats.arcs import ArcError
from machopt.formats.gcode import ProgramReader
from machopt.formats.gcode_blocks import Block
from machopt.formats.holecycle import CycleError, HoleCycle
from machopt.formats.source import MM_PER_INCH, ReadOptions, Source

_NUMBER = r"([+-]?\s*(?:\d+\.?\d*|\.\d+))"
_WORD = re.compile(r"\s*(I?[XYZABC]|T[XYZ]|N[XYZ]|F|R|S)\s*" + _NUMBER)
_FLAG = re.compile(r"\s*(F\s*MAX|F\s*AUTO|R[0LR]?|DR[+-]|M\s*\d+|M(?![A-Z])|MB\s*MAX|Q\d+\s*=\s*[+-]?[\d.]+)")
_Q = re.compile(r"\bQ(\d+)\s*=\s*" + _NUMBER)
_IGNORED = (
    "BLK FORM",
    "TOOL DEF",
    "END PGM",
    "LBL 0",
    "STOP",
    "CYCLE DEF 9",
    "CYCL DEF 247",
    "CYCL DEF 32",
    "CYCL DEF 9",
)
_REFUSED = {
    "CALL LBL": "subprograms are not expanded", "CALL PGM": "other programs are not read", "PLANE": "tilted planes",
    "CYCL DEF 19": "a tilted working plane", "CYCL DEF 8": "mirroring", "CYCL DEF 10": "rotation",
    "CYCL DEF 11": "scaling", "LP": "polar coordinates", "CP": "polar coordinates (helix)", "CTP": "polar coordinates",
    "CT": "tangential arcs", "FN": "formulas", "RND": "corner rounding", "CHF": "chamfers", "APPR": "approach blocks",
    "DEP": "departure blocks", "FPOL": "free contours", "FL": "free contours", "FC": "free contours",
}  # fmt: skip
_ZERO_PLANE = re.compile(r"PLANE RESET|CYCL DEF 19(?:\.0.*|\.1(?:\s*[ABC]\s*[+-]?0*\.?0*)*)$")
_Z = (0.0, 0.0, 1.0)


def read_heidenhain(source: Source, options: ReadOptions) -> Toolpath:
    """Read a conversational program.

    Raises:
        InputError: see :func:`machopt.formats.toolpath.read_toolpath`.
    """
    return _Reader(source, options).run()


class _Reader(ProgramReader):
    format = "heidenhain"

    def __init__(self, source: Source, options: ReadOptions) -> None:
        super().__init__(source, options)
        self.blocks.parentheses_are_comments = False
        self.pole = [math.nan, math.nan, math.nan]
        self.q: dict[int, float] = {}
        self.cycle: dict[str, float] | None = None
        self.datum: dict[str, float] = {}
        self.first_datum: dict[str, float] | None = None
        self.absolute_centre = True

    def first_unit(self, source: Source, options: ReadOptions) -> tuple[str, str]:
        head = "\n".join(source.lines).upper()
        found = re.search(r"BEGIN\s+PGM\s+\S.*?\b(MM|INCH|IN)\s*$", head, re.MULTILINE)
        named = None if not found else "mm" if found.group(1) == "MM" else "inch"
        asked = options.unit
        if named is None and asked is None:
            raise source.error("BEGIN PGM names neither MM nor INCH; give --unit mm or --unit inch")
        if named and asked and named != asked:
            raise source.error(f"the program is in {named} but --unit {asked} was given")
        return named or asked or "", "BEGIN PGM" if named else "option"

    def code(self, line: int, text: str) -> None:
        text = re.sub(r"^\s*\d+\s+", "", text).rstrip("~ ").strip()
        text = re.sub(r"\s+", " ", text)
        found = _Q.match(text)
        if found:
            self.q[int(found.group(1))] = float(found.group(2).replace(" ", ""))
            return
        for number, value in _Q.findall(text):
            self.q[int(number)] = float(value.replace(" ", ""))
        if not text or text.startswith("BEGIN PGM"):
            return
        if text.startswith("END PGM"):
            self.ended = True
            return
        if text.startswith("TOOL CALL"):
            self.tool_call(text)
        elif text.startswith("CYCL DEF 7"):
            self.datum_shift(text, line)
        elif re.match(r"CYCL DEF\s+(?:1\.|20[0-9]\b|1[ $])", text):
            self.define_cycle(text, line)
        elif text.startswith("CYCL CALL"):
            self.drill_here(Block(line, []))
        elif text.startswith("FUNCTION TCPM"):
            self.tcp = "angles"
        elif text.startswith("FUNCTION RESET TCPM"):
            self.tcp = None
        elif _ZERO_PLANE.match(text):
            self.out.ignore(text[:14], line, understood=True)
        elif text.startswith(_IGNORED) or re.fullmatch(r"LBL \d+", text):
            if re.fullmatch(r"LBL [1-9]\d*", text):
                raise self.source.error(f"{text}: subprograms are not expanded; expand the program first", line)
            self.out.ignore(" ".join(text.split()[:3])[:14], line, understood=True)
        elif re.match(r"(?:LN?|CC|C|CR|M\s*\d+)(?=[\s]|$|\d)", text):
            self.statement(text, line)
        else:
            for word, reason in _REFUSED.items():
                if re.match(re.escape(word) + r"\b", text):
                    raise self.source.error(f"{text[:24]!r}: {reason} are not supported; export APT/CL data", line)
            if text.startswith("CYCL DEF"):
                raise self.source.error(f"{text[:24]!r}: only drilling cycles 1 and 200 are supported", line)
            self.out.ignore(text[:14], line, understood=False)

    # ---- motion

    def statement(self, text: str, line: int) -> None:
        kind, rest = "M", text
        found = re.match(r"(LN|L|CC|CR|C)\b", text)
        if found:
            kind, rest = found.group(1), text[found.end() :]
        words, flags = self.split(rest, line)
        b = Block(line, [])
        if "FMAX" in flags:
            self.motion = 0
        elif kind in ("L", "LN"):
            self.motion = 1
        if "F" in words:
            if self.scale != 1.0:
                self.out.warn_once("F of an inch program is read in tenths of an inch a minute", line)
            self.feed = words.pop("F") * (MM_PER_INCH * 0.1 if self.scale != 1.0 else 1.0) / self.scale
        if "S" in words:
            self.rpm = words.pop("S")
            self.out.event("spindle", f"S{self.rpm:g}", self.rpm)
        if kind == "CC":
            for k, letter in enumerate("XYZ"):
                if letter in words:
                    self.pole[k] = words[letter] * self.scale + self.shift_of(letter)
                elif "I" + letter in words:
                    self.pole[k] = self.p[k] + words["I" + letter] * self.scale
            return
        m_words = [int(f[1:]) for f in flags if re.fullmatch(r"M\d+", f)]
        for letter in "XYZ":  # incremental coordinates and the datum shift become absolute ones
            k = "XYZ".index(letter)
            if letter in words:
                words[letter] += self.shift_of(letter) / self.scale
            if "I" + letter in words:
                if math.isnan(self.p[k]):
                    raise self.source.error(f"incremental {letter} from a place that is not known", line)
                words[letter] = self.p[k] / self.scale + words.pop("I" + letter)
        vector = [words.pop("T" + c, math.nan) for c in "XYZ"]
        for c in "XYZ":
            words.pop("N" + c, None)
        radius = words.pop("R", None)
        self.m_words([m for m in m_words if m not in (91, 92, 99, 140)], {}, line)
        if any(m in (91, 92, 140) for m in m_words):
            self.lose(words, "M91" if 140 not in m_words else "M140", line)
            return
        if not all(map(math.isnan, vector)):
            if self.tcp is None:
                raise self.source.error("a tool vector (TX, TY, TZ) outside of M128", line)
            b.named.update({n: (0.0 if math.isnan(v) else v) for n, v in zip(("A3", "B3", "C3"), vector, strict=True)})
        if kind in ("C", "CR"):
            self.circle(kind, words, flags, radius, b)
        elif words or b.named:
            self.move(words, b)
        if 99 in m_words:
            self.drill_here(b)
        if any(m in (2, 30) for m in m_words):
            self.ended = True

    def split(self, rest: str, line: int) -> tuple[dict[str, float], list[str]]:
        words: dict[str, float] = {}
        flags: list[str] = []
        at = 0
        rest = rest.rstrip()
        while at < len(rest):
            flag = _FLAG.match(rest, at)
            word = _WORD.match(rest, at)
            if word and not (flag and flag.end() >= word.end()):
                name = word.group(1)
                if name in words:
                    raise self.source.error(f"{name} stands twice in one block", line)
                words[name] = float(word.group(2).replace(" ", ""))
                at = word.end()
            elif flag:
                flags.append(flag.group(1).replace(" ", ""))
                if flags[-1] in ("RL", "RR"):
                    self.out.warn_once("radius compensation (RL, RR) is not carried out: points as programmed", line)
                at = flag.end()
            else:
                raise self.source.error(f"found {rest[at:].strip()[:20]!r}; expected coordinates, F, R or M", line)
        return words, flags

    def circle(self, kind: str, words: dict[str, float], flags: list[str], radius: float | None, b: Block) -> None:
        turn = next((f for f in flags if f.startswith("DR")), None)
        if turn is None:
            raise ArcError(f"{kind} without DR+ or DR-")
        self.motion = 3 if turn == "DR+" else 2
        if kind == "CR":
            if radius is None:
                raise ArcError("CR without R")
            b.named["CR"] = radius
        else:
            centre = [p if math.isnan(c) else c for c, p in zip(self.pole, self.p, strict=True)]
            for k, letter in enumerate("IJK"):
                if not math.isnan(centre[k]):
                    words[letter] = centre[k] / self.scale
        if not words.keys() & set("XYZ"):
            for k, letter in enumerate("XYZ"):
                if not math.isnan(self.p[k]):
                    words[letter] = self.p[k] / self.scale
        self.move(words, b)

    def shift_of(self, letter: str) -> float:
        if self.first_datum is None:
            self.first_datum = dict(self.datum)
        return (self.datum.get(letter, 0.0) - self.first_datum.get(letter, 0.0)) * self.scale

    def datum_shift(self, text: str, line: int) -> None:
        for letter, value in re.findall(r"\b([XYZ])\s*" + _NUMBER, text):
            self.datum[letter] = float(value.replace(" ", ""))
            if len(self.out) and self.shift_of(letter) != 0.0:
                self.out.warn_once("the datum shifts: points from here on are brought into the first system", line)
        self.out.ignore("CYCL DEF 7", line, understood=True)

    # ---- tools and cycles

    def tool_call(self, text: str) -> None:
        found = re.match(r"TOOL CALL\s*(\"[^\"]*\"|\d+)?(?:.*?\bS\s*" + _NUMBER + ")?", text)
        tool = (found.group(1) or "").strip('"') if found else ""
        if found and found.group(2):
            self.rpm = float(found.group(2).replace(" ", ""))
            self.out.event("spindle", text, self.rpm)
        if tool:
            self.out.event("tool", text, float(tool) if tool.isdigit() else math.nan)
            self.out.change_tool(tool)

    def define_cycle(self, text: str, line: int) -> None:
        found = re.match(r"CYCL DEF\s+(\d+)(?:\.(\d+))?\s*(.*)", text)
        assert found is not None
        number, part, rest = int(found.group(1)), found.group(2), found.group(3)
        if number not in (1, 200):
            raise self.source.error(f"{text[:24]!r}: only drilling cycles 1 and 200 are supported", line)
        if number == 200:
            self.cycle = {"number": 200.0}
        elif part == "0" or part is None:
            self.cycle = {"number": 1.0}
        elif self.cycle is not None:
            word = re.match(r"(DIST|SET ?UP|DEPTH|PLNGNG|PECKG|PECKING|DWELL|F)\s*" + _NUMBER, rest)
            if word is None:
                raise self.source.error(f"found {rest[:20]!r}; expected DIST, DEPTH, PLNGNG, DWELL or F", line)
            self.cycle[word.group(1).replace(" ", "")] = float(word.group(2).replace(" ", ""))

    def drill_here(self, b: Block) -> None:
        """M99 or CYCL CALL: one hole at the present place."""
        if self.cycle is None:
            raise CycleError("a cycle call (M99, CYCL CALL) before any drilling cycle was defined")
        if self.axis != _Z:
            raise CycleError("a drilling cycle with a tilted tool axis is not supported")
        if np.isnan(self.p).any():
            raise CycleError("a drilling cycle where the tool's place is not known")
        s = self.scale
        if self.cycle["number"] == 200.0:
            q = self.q
            if 201 not in q or 200 not in q:
                raise CycleError("cycle 200 without Q200 (clearance) or Q201 (depth)")
            top = q.get(203, 0.0) * s + self.shift_of("Z")
            plan = HoleCycle(
                name="CYCL 200",
                bottom=top - abs(q[201]) * s,
                clear=top + q[200] * s,
                retract=max(top + q.get(204, q[200]) * s, top + q[200] * s),
                feed=q.get(206, math.nan) * s,
                first_peck=q.get(202, 0.0) * s,
                dwell=q.get(211, 0.0),
                peck_from=top,
            )
        else:
            c = self.cycle
            if ("DIST" not in c and "SETUP" not in c) or "DEPTH" not in c:
                raise CycleError("cycle 1 without set-up clearance (DIST) or depth (DEPTH)")
            # the tool stands at the clearance height when cycle 1 is called; DIST is measured down from there
            top = self.p[2] - abs(c.get("DIST", c.get("SETUP", 0.0))) * s
            plan = HoleCycle(
                name="CYCL 1",
                bottom=top - abs(c["DEPTH"]) * s,
                clear=self.p[2],
                retract=self.p[2],
                feed=c.get("F", math.nan) * s,
                first_peck=abs(c.get("PLNGNG", c.get("PECKG", c.get("PECKING", 0.0)))) * s,
                dwell=c.get("DWELL", 0.0),
                peck_from=top,
            )
        self.holes(plan, {}, None, b)
