"""Definitions of a conversational program: cycles, Q parameters, tool-centre-point control, presets, other programs."""

from __future__ import annotations

import re

from machopt.path_building.coordinate_systems import SystemTransform
from machopt.toolpath.readers import harmless_words
from machopt.toolpath.readers.heidenhain.datums_and_planes import NUMBER, parse_value
from machopt.toolpath.readers.heidenhain.drilling_cycles import OLD_WORD, normalise_old_cycle_word
from machopt.toolpath.readers.heidenhain.sentence_parser import SentenceReader

MACHINE_CYCLES = frozenset((238, 239, 332, 392))
BUILDER_CYCLES = range(300, 400)  # numbers that Heidenhain leaves to machine builders
_Q = re.compile(r"\bQ([0-9]+)\s*=\s*" + NUMBER)


class DefinitionReader(SentenceReader):
    """Carries out what moves nothing by itself."""

    pattern_text: tuple[int, int] | None = None  # cycle 220 or 221 whose parameters are being read, and its line

    def parameters(self, text: str) -> list[tuple[str, str]]:
        """Find the Q parameters that a line sets.

        Args:
            text: Text of the line.

        Returns:
            Number and value text of each.
        """
        return _Q.findall(text)

    def take_parameters(self, found: list[tuple[str, str]]) -> None:
        """Set Q parameters.

        Args:
            found: Number and value text of each.
        """
        for number, text in found:
            self.q[int(number)] = parse_value(text)
            if number == "339":
                self.use_preset(parse_value(text))

    def close_pattern(self, text: str) -> None:
        """Drill the pattern whose parameters were read, where this line holds no further parameter.

        Args:
            text: Text of the line.
        """
        if self.pattern_text is not None and not text.startswith("Q"):
            number, at = self.pattern_text
            self.pattern_text = None
            self.drill_pattern(number, at)

    def tool_call(self, text: str, line: int) -> None:
        """Carry out TOOL CALL.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).
        """
        found = re.match(r"TOOL CALL\s*(\"[^\"]*\"|[0-9]+)?(?:.*?\bS\s*" + NUMBER + ")?", text)
        rpm = parse_value(found.group(2)) if found and found.group(2) else None
        self.call_tool((found.group(1) or "").strip('"') if found else "", rpm, text, line)

    def select_preset(self, text: str, line: int) -> None:
        """Carry out PRESET SELECT.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).

        Raises:
            InputError: the statement has another form than ``PRESET SELECT #n``.
        """
        preset = re.fullmatch(r"PRESET SELECT\s*#\s*([0-9]+)(?: KEEP TRANS)?", text)
        if preset is None:
            raise self.source.build_error(f"{text[:40]!r}: read is PRESET SELECT #n", line)
        self.use_preset(float(preset.group(1)))
        self.out.ignore("PRESET SELECT", line, understood=True)

    def call_program(self, text: str, line: int) -> None:
        """Record CALL PGM as a call of another program.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).
        """
        self.left_out = (text[:40], line)
        self.out.ignore("CALL PGM", line, understood=False)

    def tcpm(self, text: str, line: int) -> None:
        """Carry out FUNCTION TCPM: meaning of A, B, C and the programmed point of the tool.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).

        Raises:
            InputError: the variant is not supported.
        """
        if "CENTER-CENTER" in text:
            raise self.source.build_error(
                "REFPNT CENTER-CENTER: the points are the tool's centre, how far from its tip is not in the file; "
                "post it with REFPNT TIP-TIP or TIP-CENTER",
                line,
            )
        self.turns_in_plane = re.search(r"\bPATHCTRL\s+VECTOR\b", text) is not None
        self.use_tcp("spatial" if re.search(r"\bAXIS\s+SPAT\b", text) else "angles", line)

    def end_tcpm(self, _: str, line: int) -> None:
        """End FUNCTION TCPM.

        Args:
            _: Text of the line, not used.
            line: Line number in the file (1-based).
        """
        self.use_tcp(None, line)

    def define(self, text: str, line: int) -> None:
        """Carry out a cycle definition with the parameters on its line.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).
        """
        if self.cycle_definition(text, line):
            self.take_parameters(self.parameters(text))

    def cycle_definition(self, text: str, line: int) -> bool:
        """Carry out CYCL DEF n or n.m.

        Args:
            text: Text of the line.
            line: Line number in the file (1-based).

        Returns:
            Whether Q parameters of the cycle follow on the line.

        Raises:
            InputError: the cycle is not supported or malformed.
        """
        found = re.match(r"CYCL DEF\s+([0-9]+)(?:\.([0-9]+))?\s*(.*)", text)
        if not found:
            raise self.source.build_error(f"{text[:24]!r}: expected CYCL DEF and a number", line)
        number, part, rest = int(found.group(1)), found.group(2), found.group(3)
        if self._transform_system(number, part, rest, line):
            return False
        if number == 247:
            self.out.ignore(f"CYCL DEF {number}", line, understood=number in harmless_words.HEIDENHAIN_CYCLES)
            return True
        if number == 12:
            raise self.source.build_error(
                "CYCL DEF 12 makes another program the cycle of M99: it is not in this file; expand it", line
            )
        if number in MACHINE_CYCLES or number in BUILDER_CYCLES:
            self.machine_cycle(number, line)
            return True
        if number in (220, 221):
            self.pattern_text = (number, line)
            return True
        if number in (9, 13, 32):
            dwell = re.search(NUMBER, rest) if (number, part) == (9, "1") else None
            if dwell:
                self.out.event("dwell", text, parse_value(dwell.group(1)))
            self.out.ignore(f"CYCL DEF {number}", line, understood=True)
        elif number in (1, 2, 17):
            self.old_cycle_line(number, part, rest, line)
        else:
            self.begin_q_cycle(number, line)
            return True
        return False

    def _transform_system(self, number: int, part: str | None, rest: str, line: int) -> bool:
        """Carry out a cycle that moves, turns, tilts, scales or mirrors the system; return whether it is one."""
        if number == 7:
            if "#" in rest:
                raise self.source.build_error(
                    "CYCL DEF 7 takes its shift from a datum table that is not in the file", line
                )
            if part != "0":
                self.shift_datum({k: parse_value(v) for k, v in re.findall(r"\b(I?[XYZ])\s*" + NUMBER, rest)}, line)
        elif number == 19:
            if part not in (None, "0"):
                self.tilt_angles({k: parse_value(v) for k, v in re.findall(r"\b([ABC])\s*" + NUMBER, rest)}, line)
        elif number == 10:
            angle = re.search(r"\b(I?)ROT\s*" + NUMBER, rest)
            if part != "0" and angle is None and rest.strip():
                raise self.source.build_error(
                    f"CYCL DEF 10: found {rest[:20]!r}; expected ROT or IROT and an angle", line
                )
            if part != "0":
                more = self.turned_by if angle and angle.group(1) else 0.0  # IROT: on top of the rotation in force
                self.turn_plane((parse_value(angle.group(2)) if angle else 0.0) + more, line)
        elif number == 11:
            factor = re.search(r"\bSCL\s*" + NUMBER, rest)
            if factor:
                self.scale_all(parse_value(factor.group(1)), line)
        elif number == 26:
            axes = {k: parse_value(v) for k, v in re.findall(r"\b([XYZ])\s*" + NUMBER, rest)}
            if "CCX" in rest or "CCY" in rest or (axes and not min(axes.values()) > 0.0):
                raise self.source.build_error("CYCL DEF 26 about a centre of its own is not supported", line)
            if part != "0":
                x, y, z = (axes.get(c, 1.0) for c in "XYZ")
                self.transform("scale", SystemTransform.factors(x, y, z), "CYCL DEF 26", line)
        elif number == 8:
            if part != "0":
                self.mirror_axes(rest, "CYCL DEF 8", line)
        else:
            return False
        return True

    def machine_cycle(self, number: int, line: int) -> None:
        """Handle a cycle of the machine: tuning cycles are left out, cycles of the machine builder are reported.

        Args:
            number: Number of the cycle.
            line: Line number in the file (1-based).
        """
        known = number in harmless_words.HEIDENHAIN_CYCLES
        if known:
            self.out.warn_once(f"cycle {number} (tunes or checks the machine) is left out: it moves no point", line)
        else:
            self.cycle = None
        self.out.ignore(f"CYCL DEF {number}", line, understood=known)

    def old_cycle_line(self, number: int, part: str | None, rest: str, line: int) -> None:
        """Carry out one line of a cycle in the old form n.m.

        Args:
            number: Number of the cycle.
            part: Number behind the point, None where there is none.
            rest: Text behind the number.
            line: Line number in the file (1-based).

        Raises:
            InputError: the line is not supported.
        """
        if part in (None, "0"):
            self.cycle, self.cycle_words = number, {}
            return
        word = re.match(OLD_WORD + r"(?:\s*" + NUMBER + ")?", rest)
        if word is None:
            raise self.source.build_error(f"found {rest[:20]!r}; expected SET UP, DEPTH, PECKG, DWELL or F", line)
        if word.group(2):
            self.cycle_words[normalise_old_cycle_word(word.group(1))] = parse_value(word.group(2))
