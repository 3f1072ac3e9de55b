"""Words and flags of a conversational sentence, and the sentences that begin or end a contour."""

from __future__ import annotations

import math
import re

from machopt.toolpath.readers.heidenhain.approach_departure_geometry import ContourApproach, Lead, LeadIn
from machopt.toolpath.readers.heidenhain.control_reader import HeidenhainControlReader
from machopt.toolpath.readers.heidenhain.datums_and_planes import NUMBER, parse_value

_WORD = re.compile(r"\s*(I?[XYZABC]|T[XYZ]|N[XYZ]|I?PR|I?PA|F|R|S)\s*" + NUMBER)
_FLAG = re.compile(
    r"\s*(F\s*MAX|F\s*AUTO|R[0LR]?(?![0-9.])|DR[+-]|M\s*[0-9]+|M(?![A-Z])|MB\s*MAX|MB\s*[+-]?[0-9.]+|F(?=\s|$))"
)
_LEADS: dict[str, Lead] = {"LT": "LT", "LN": "LN", "CT": "CT", "LCT": "LCT"}


class SentenceReader(HeidenhainControlReader):
    """Takes sentences apart; carries out APPR and DEP."""

    def split(self, rest: str, line: int) -> tuple[dict[str, float], list[str]]:
        """Split a sentence into words and flags.

        Args:
            rest: Text behind the name of the sentence.
            line: Line number in the file (1-based).

        Returns:
            Letter → number, and the flags.

        Raises:
            InputError: a part of the sentence is neither.
        """
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
                    raise self.source.build_error(f"{name} is given twice in one block", line)
                words[name] = parse_value(word.group(2))
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
                raise self.source.build_error(f"found {strange!r}; expected coordinates, F, R or M{hint}", line)
        return words, flags

    def _split_contour_end(self, text: str, line: int) -> tuple[str, Lead, dict[str, float], str]:
        """Return APPR or DEP, the kind of lead, its length LEN and angle CCA where given, and the rest of the text."""
        found = re.match(r"(APPR|DEP)\s+(LT|LN|CT|LCT)(?![A-Z])(.*)", text)
        kind = None if found is None else _LEADS[found.group(2)]
        if found is None or kind is None:
            raise self.source.build_error(
                f"{text[:24]!r}: read are APPR and DEP with LT, LN, CT and LCT; post it with those, or as L and C", line
            )
        rest = found.group(3)
        own: dict[str, float] = {}
        for name in ("LEN", "CCA"):
            if number := re.search(rf"\b{name}\s*" + NUMBER, rest):
                own[name] = parse_value(number.group(1))
                rest = rest.replace(number.group(0), " ", 1)
        return found.group(1), kind, own, rest

    def contour_end(self, text: str, line: int) -> None:
        """Carry out APPR or DEP with LT, LN, CT or LCT, in Cartesian coordinates.

        Args:
            text: Text of the sentence.
            line: Line number in the file (1-based).

        Raises:
            InputError: this kind of approach or departure is not supported.
        """
        where, kind, own, rest = self._split_contour_end(text, line)
        side, feed_before = self.side, math.nan if self.motion == 0 else self.feed_mm_min(1.0, line)
        words, flags = self.split(rest, line)
        if "F" in words:
            self.feed_word(words.pop("F"), line)
        if "FMAX" in flags:
            raise self.source.build_error(f"{where} {kind} with FMAX: give it a feed", line)
        self.m_words([int(f[1:]) for f in flags if re.fullmatch(r"M[0-9]+", f)], {}, line)
        needed = {"LT": "LEN", "LN": "LEN", "CT": "CCA"}.get(kind)
        radius = words.pop("R", math.nan) * self.scale
        if (needed and not own.get(needed, 0.0) > 0.0) or (kind in ("CT", "LCT") and not abs(radius) > 0.0):
            raise self.source.build_error(f"{where} {kind}: expected {needed or 'R'} (CT: CCA and R) above zero", line)
        if self.plane[2] != 1.0:
            raise self.source.build_error(f"{where} in another plane than XY is not supported", line)
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
            ContourApproach(
                path=path,
                start=start,
                place=place,
                feed_before=feed if kind == "LCT" else feed_before,
                feed=feed,
                line=line,
            )
        )
