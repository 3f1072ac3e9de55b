"""Heidenhain conversational programs (``BEGIN PGM``): L, LN, CC, C, CR, LP, CP, PLANE, CYCL DEF, LBL, Q parameters.

The circle centre CC stays until the next one. Under M128 or FUNCTION TCPM the points are the tool tip's; LN gives
the tool axis as TX, TY, TZ.
"""

from __future__ import annotations

import math
import re

from machopt.domain.toolpath import Toolpath
from machopt.formats.cam import reviewed
from machopt.formats.cam.gcode.blocks import Block
from machopt.formats.cam.gcode.fast import HEIDENHAIN, plain_lines
from machopt.formats.cam.gcode.flow import FlowError
from machopt.formats.cam.gcode.motion import TANGENTIAL
from machopt.formats.cam.heidenhain.approach import Approach, Lead, LeadIn
from machopt.formats.cam.heidenhain.control import ControlReader
from machopt.formats.cam.heidenhain.cycles import OLD_WORD, old_word
from machopt.formats.cam.heidenhain.planes import NUMBER, value
from machopt.formats.frames import Transfer
from machopt.formats.source import ReadOptions, Source

_WORD = re.compile(r"\s*(I?[XYZABC]|T[XYZ]|N[XYZ]|I?PR|I?PA|F|R|S)\s*" + NUMBER)
_M_WITH_WORDS = re.compile(r"\s*M(103|118|120)(?!\d)(?:\s*(?:F|LA|[XYZABC])\s*[+-]?[\d.]+)+")
_FLAG = re.compile(
    r"\s*(F\s*MAX|F\s*AUTO|R[0LR]?(?![\d.])|DR[+-]|M\s*\d+|M(?![A-Z])|MB\s*MAX|MB\s*[+-]?[\d.]+|F(?=\s|$))"
)
_LEADS: dict[str, Lead] = {"LT": "LT", "LN": "LN", "CT": "CT", "LCT": "LCT"}
_ROTARY = {"A", "B", "C", "IA", "IB", "IC"}
_Q = re.compile(r"\bQ(\d+)\s*=\s*" + NUMBER)
_NEEDS_FLOW = re.compile(r"\b(?:LBL|FN)\b|\bQ\d+(?!\d*\s*=\s*[-+]?[\d.])", re.IGNORECASE)
_IGNORED = (
    "BLK FORM",
    "TOOL DEF",
    "END PGM",
    "LBL",
    "STOP",
    "CYCL DEF 13",
    "CYCL DEF 32",
    "CYCL DEF 9",
    "FUNCTION MODE",
)
_REFUSED = {
    "CTP": "polar tangential arcs",
    "FN": "formulas",
    "FPOL": "free contours",
    "FLT": "free contours",
    "FL": "free contours",
    "FCT": "free contours",
    "FC": "free contours",
    "SEL": "other programs and tables",
    "CYCL CALL PAT": "point patterns",
}


def read_heidenhain(source: Source, options: ReadOptions) -> Toolpath:
    """Read a conversational program.

    Raises:
        InputError: see :func:`machopt.formats.toolpath.read_toolpath`.
    """
    return _Reader(source, options).run()


class _Reader(ControlReader):
    pattern_text: tuple[int, int] | None = None  # cycle 220 or 221 whose parameters are being read, and its line

    def run(self) -> Toolpath:
        try:
            if self.source.find(_NEEDS_FLOW) is None and self.scale == 1.0:
                self.carry_out_lines()
            else:
                self.carry_out(self.label_flow().run())
        except FlowError as problem:
            raise self.source.error(str(problem), problem.line) from problem
        toolpath_ends = self.ended
        self.ended = True
        if not toolpath_ends:
            self.out.cut_off = "no END PGM" + (
                "" if self.source.complete else " and the last line does not end: its last number may be cut off"
            )
        return self.finish()

    def plain_from(self, at: int) -> int:
        return at if self.left_out or self.approach else plain_lines(self, at, HEIDENHAIN, linear=True)

    def first_unit(self, source: Source, options: ReadOptions) -> tuple[str, str]:
        named = None
        for line in source.lines:
            found = re.search(r"BEGIN\s+PGM\s+\S.*?\b(MM|INCH|IN)\s*$", line, re.IGNORECASE)
            if found:
                named = "mm" if found.group(1).upper() == "MM" else "inch"
                break
        asked = options.unit
        if named is None and asked is None:
            raise source.error("BEGIN PGM names neither MM nor INCH; give --unit mm or --unit inch")
        if named and asked and named != asked:
            raise source.error(f"the program is in {named} but --unit {asked} was given")
        return named or asked or "", "BEGIN PGM" if named else "option"

    def clean(self, line: int, raw: str) -> tuple[str, list[str]] | None:
        found = super().clean(line, raw)
        if found is None:
            return None
        text = re.sub(r"^\s*\d+(?:\s+|$)", "", found[0]).rstrip("~ ").strip()
        return re.sub(r"\s+", " ", text), found[1]

    def code(self, line: int, text: str) -> None:
        if self.pattern_text is not None and not text.startswith("Q"):
            number, at = self.pattern_text
            self.pattern_text = None
            self.drill_pattern(number, at)
        if text.startswith("CYCLE DEF"):
            text = "CYCL DEF" + text[9:]
        if text.startswith("BEGIN PGM"):
            return
        if text.startswith("*"):  # a heading of the program's structure
            self.out.event("comment", text.lstrip("* -"))
            return
        if text.startswith("END PGM"):
            self.ended = True
            return
        parameters = _Q.findall(text)
        if parameters and (text.startswith("Q") or not text.startswith("CYCL DEF")):
            self.take_parameters(parameters)
            if text.startswith("Q"):
                return
        if " COMPUTED" in text:
            if not self.stays:
                raise self.source.error(
                    "Q120, Q121, Q122 hold the axes of PLANE … STAY, and there is none before", line
                )
            self.change_setup(tilted="aligned" if self.setup.tilted else "", stood_up=bool(self.setup.tilted))
            text = " ".join(text.replace("COMPUTED", " ").split())
        if text.startswith("TOOL CALL"):
            found = re.match(r"TOOL CALL\s*(\"[^\"]*\"|\d+)?(?:.*?\bS\s*" + NUMBER + ")?", text)
            rpm = value(found.group(2)) if found and found.group(2) else None
            self.call_tool((found.group(1) or "").strip('"') if found else "", rpm, text, line)
        elif text.startswith("CYCL DEF"):
            if self.cycle_definition(text, line):
                self.take_parameters(parameters)
        elif text.startswith("CYCL CALL POS"):
            self.statement("L " + text[13:] + " M99", line)
        elif text == "CYCL CALL" or re.match(r"CYCL CALL (?:M|F)", text):
            self.drill_here(Block(line=line, words=[]))
        elif found := re.match(r"(RND|CHF)\s+(?:R\s*)?" + NUMBER + r"(?:\s+F\s*" + NUMBER + ")?$", text):
            feed = value(found.group(3)) if found.group(3) else None
            self.wait_for_corner("round" if found.group(1) == "RND" else "setback", value(found.group(2)), feed, line)
        elif text.startswith(("APPR ", "DEP ")):
            self.contour_end(text, line)
        elif text.startswith("TRANS "):
            self.trans(text, line)
        elif text.startswith("PLANE"):
            self.plane_statement(text, line)
        elif text.startswith("FUNCTION TCPM"):
            self.tcpm(text, line)
        elif text.startswith("FUNCTION RESET TCPM"):
            self.use_tcp(None, line)
        elif text.startswith("PRESET"):
            preset = re.fullmatch(r"PRESET SELECT\s*#\s*(\d+)(?: KEEP TRANS)?", text)
            if preset is None:
                raise self.source.error(f"{text[:40]!r}: read is PRESET SELECT #n", line)
            self.use_preset(float(preset.group(1)))
            self.out.ignore("PRESET SELECT", line, understood=True)
        elif text.startswith("CALL PGM"):
            self.left_out = (text[:40], line)
            self.out.ignore("CALL PGM", line, understood=False)
        elif text.startswith(_IGNORED):
            self.out.ignore(" ".join(text.split()[:3])[:14], line, understood=True)
            if text.startswith("STOP"):
                self.out.event("stop", text)
                if re.search(r"\bM(?:2|30)\b", text):
                    self.ended = True
        elif re.match(r"(?:LN?|CC|CR|CT|C|LP|CP|M\s*\d+)(?=\s|$|\d)|I?[XYZABC]\s*[+-]?\.?\d|R0\b|F ?MAX\b|S ?\d", text):
            self.statement(text, line)
        else:
            for word, reason in _REFUSED.items():
                if re.match(re.escape(word) + r"\b", text):
                    raise self.source.error(f"{text[:24]!r}: {reason} are not supported; export APT/CL data", line)
            self.out.ignore(text[:14], line, understood=False)

    def tcpm(self, text: str, line: int) -> None:
        """FUNCTION TCPM: whose axes A, B and C turn about, and which point of the tool is programmed."""
        if "CENTER-CENTER" in text:
            raise self.source.error(
                "REFPNT CENTER-CENTER: the points are the tool's centre, how far from its tip is not in the file; "
                "post it with REFPNT TIP-TIP or TIP-CENTER",
                line,
            )
        self.use_tcp("spatial" if re.search(r"\bAXIS\s+SPAT\b", text) else "angles", line)

    def take_parameters(self, found: list[tuple[str, str]]) -> None:
        for number, text in found:
            self.q[int(number)] = value(text)
            if number == "339":
                self.use_preset(value(text))

    # ---- definitions

    def cycle_definition(self, text: str, line: int) -> bool:
        """CYCL DEF n or n.m; True where Q parameters of the cycle follow on the line."""
        found = re.match(r"CYCL DEF\s+(\d+)(?:\.(\d+))?\s*(.*)", text)
        if not found:
            raise self.source.error(f"{text[:24]!r}: expected CYCL DEF and a number", line)
        number, part, rest = int(found.group(1)), found.group(2), found.group(3)
        if number == 7:
            if "#" in rest:
                raise self.source.error("CYCL DEF 7 takes its shift from a datum table that is not in the file", line)
            if part != "0":
                self.shift_datum({k: value(v) for k, v in re.findall(r"\b(I?[XYZ])\s*" + NUMBER, rest)}, line)
        elif number == 19:
            if part not in (None, "0"):
                self.tilt_angles({k: value(v) for k, v in re.findall(r"\b([ABC])\s*" + NUMBER, rest)}, line)
        elif number == 10:
            angle = re.search(r"\bROT\s*" + NUMBER, rest)
            if part != "0":
                self.turn_plane(value(angle.group(1)) if angle else 0.0, line)
        elif number == 11:
            factor = re.search(r"\bSCL\s*" + NUMBER, rest)
            if factor:
                self.scale_all(value(factor.group(1)), line)
        elif number == 26:
            axes = {k: value(v) for k, v in re.findall(r"\b([XYZ])\s*" + NUMBER, rest)}
            if "CCX" in rest or "CCY" in rest or (axes and not min(axes.values()) > 0.0):
                raise self.source.error("CYCL DEF 26 about a centre of its own is not supported", line)
            if part != "0":
                x, y, z = (axes.get(c, 1.0) for c in "XYZ")
                self.transform("scale", Transfer.factors(x, y, z), "CYCL DEF 26", line)
        elif number == 8:
            if part != "0":
                self.mirror_axes(rest, "CYCL DEF 8", line)
        elif number in (239, 247, 332):
            self.out.ignore(f"CYCL DEF {number}", line, understood=number in reviewed.HEIDENHAIN_CYCLES)
            return True
        elif number in (220, 221):
            self.pattern_text = (number, line)
            return True
        elif number in (9, 13, 32):
            dwell = re.search(NUMBER, rest) if (number, part) == (9, "1") else None
            if dwell:
                self.out.event("dwell", text, value(dwell.group(1)))
            self.out.ignore(f"CYCL DEF {number}", line, understood=True)
        elif number in (1, 2, 17):
            self.old_cycle_line(number, part, rest, line)
        else:
            self.begin_q_cycle(number, line)
            return True
        return False

    def old_cycle_line(self, number: int, part: str | None, rest: str, line: int) -> None:
        if part in (None, "0"):
            self.cycle, self.cycle_words = number, {}
            return
        word = re.match(OLD_WORD + r"(?:\s*" + NUMBER + ")?", rest)
        if word is None:
            raise self.source.error(f"found {rest[:20]!r}; expected SET UP, DEPTH, PECKG, DWELL or F", line)
        if word.group(2):
            self.cycle_words[old_word(word.group(1))] = value(word.group(2))

    def statement(self, text: str, line: int) -> None:
        kind, rest = "L", text
        found = re.match(r"(LN|LP|L|CC|CR|CT|CP|C)(?![A-Z])", text)
        if found:
            kind, rest = found.group(1), text[found.end() :]
        if found := _M_WITH_WORDS.search(rest):  # their words are no coordinates
            rest = rest[: found.start()] + (" M118" if found.group(1) == "118" else "") + rest[found.end() :]
            if found.group(1) == "103":
                self.out.warn_once("M103 (slower plunges) is not carried out: feeds are as programmed", line)
        words, flags = self.split(rest, line)
        b = Block(line=line, words=[])
        if "FMAX" in flags:
            self.motion = 0
        elif kind in ("L", "LN", "LP"):
            self.motion = 1
        if "FAUTO" in flags:
            self.feed = self.tool_feed
        if "F" in words:
            self.feed_word(words.pop("F"), line)
        if "S" in words:
            self.rpm = words.pop("S")
            self.out.event("spindle", f"S{self.rpm:g}", self.rpm)
        if kind == "CC":
            self.set_pole(words)
            return
        m_words = [int(f[1:]) for f in flags if re.fullmatch(r"M\d+", f)]
        vector = [words.pop("T" + c, math.nan) for c in "XYZ"]
        for c in "XYZ":
            words.pop("N" + c, None)
        radius = words.pop("R", None)
        self.m_words(self.own_m_words(m_words, line), {}, line)
        if any(m in (91, 92) for m in m_words):
            self.lose(words, "M91", line)
            return
        if 140 in m_words:
            back = next((f[2:] for f in flags if f.startswith("MB")), "MAX")
            if back == "MAX":
                self.lose({"Z": 0.0} if self.along_z() else {}, "M140", line)
            else:
                self.retract(value(back) * self.scale, line)
            return
        if words or not all(map(math.isnan, vector)):
            self.other_program(line)
        self.absolute(words, line)
        if not all(map(math.isnan, vector)):
            if self.setup.tcp is None:
                raise self.source.error("a tool vector (TX, TY, TZ) outside of M128", line)
            b.named.update({n: (0.0 if math.isnan(v) else v) for n, v in zip(("A3", "B3", "C3"), vector, strict=True)})
        left = next((f == "DR+" for f in flags if f.startswith("DR")), None)
        if kind in ("C", "CR"):
            self.circle(kind, words, left, radius, b)
        elif kind == "CP":
            self.polar_circle(words, left, b)
        elif kind == "CT":
            self.motion = TANGENTIAL
            self.move(words, b)
        elif words or b.named:
            if kind == "LP":
                self.to_cartesian(words, line)
            self.move(words, b)
        if 99 in m_words:
            self.drill_here(b)
        if any(m in (2, 30) for m in m_words):
            self.ended = True

    def contour_end(self, text: str, line: int) -> None:
        """APPR or DEP with LT, LN, CT or LCT, in Cartesian coordinates."""
        found = re.match(r"(APPR|DEP)\s+(LT|LN|CT|LCT)(?![A-Z])(.*)", text)
        kind = None if found is None else _LEADS[found.group(2)]
        if found is None or kind is None:
            raise self.source.error(
                f"{text[:24]!r}: read are APPR and DEP with LT, LN, CT and LCT; post it with those, or as L and C", line
            )
        where, rest = found.group(1), found.group(3)
        own: dict[str, float] = {}
        for name in ("LEN", "CCA"):
            if number := re.search(rf"\b{name}\s*" + NUMBER, rest):
                own[name] = value(number.group(1))
                rest = rest.replace(number.group(0), " ", 1)
        side, feed_before = self.side, math.nan if self.motion == 0 else self.feed_mm_min(1.0, line)
        words, flags = self.split(rest, line)
        if "F" in words:
            self.feed_word(words.pop("F"), line)
        if "FMAX" in flags:
            raise self.source.error(f"{where} {kind} with FMAX: give it a feed", line)
        self.m_words([int(f[1:]) for f in flags if re.fullmatch(r"M\d+", f)], {}, line)
        needed = {"LT": "LEN", "LN": "LEN", "CT": "CCA"}.get(kind)
        radius = words.pop("R", math.nan) * self.scale
        if (needed and not own.get(needed, 0.0) > 0.0) or (kind in ("CT", "LCT") and not abs(radius) > 0.0):
            raise self.source.error(f"{where} {kind}: expected {needed or 'R'} (CT: CCA and R) above zero", line)
        if self.plane[2] != 1.0:
            raise self.source.error(f"{where} in another plane than XY is not supported", line)
        path = LeadIn(
            kind,
            self.side if where == "APPR" else side,
            length=own.get("LEN", 0.0) * self.scale,
            radius=radius,
            sweep=math.radians(own.get("CCA", 0.0)),
        )
        self.absolute(words, line)
        to = [words.get(c, p / self.scale) * self.scale for c, p in zip("XYZ", self.p, strict=True)]
        self.motion = 1
        if where == "DEP":
            outside = complex(to[0], to[1]) if kind == "LCT" else None
            self.lead_out(path, outside, to[2] if "Z" in words else None, line)
            return
        feed = self.feed_mm_min(1.0, line)
        x, y, z = self.p
        start, place = (x, y, z), (to[0], to[1], to[2])
        self.lead_in(
            Approach(
                path=path,
                start=start,
                place=place,
                feed_before=feed if kind == "LCT" else feed_before,
                feed=feed,
                line=line,
            )
        )

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
                words[name] = value(word.group(2))
                at = word.end()
            elif flag:
                flags.append(flag.group(1).replace(" ", ""))
                if flags[-1] in ("R0", "RL", "RR"):
                    self.side = {"RL": 1.0, "RR": -1.0}.get(flags[-1], 0.0)
                if self.side:
                    self.out.warn_once("radius compensation (RL, RR) is not carried out: points as programmed", line)
                at = flag.end()
            else:
                strange = rest[at:].strip()[:20]
                hint = ": post F in mm/min" if re.match(r"F[UZT]", strange) else ""
                raise self.source.error(f"found {strange!r}; expected coordinates, F, R or M{hint}", line)
        return words, flags
