"""FANUC TP files split into lines and positions, before execution."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.move_attributes import parse_number

_LINE = re.compile(r"\s*([0-9]*)\s*:\s*(.*)")
_P = re.compile(r"P\s*\[\s*([0-9]+)\s*(?::[^\]]*)?\]\s*\{(.*?)\}\s*;", re.DOTALL)
_GROUP = re.compile(r"GP([0-9])\s*:?")
_ITEM = re.compile(r"\b([XYZWPRJE][0-9]?)\s*=\s*([-+.0-9]+(?:[eE][-+]?[0-9]+)?|\*+)\s*(mm|deg|in)?")
_FRAME = re.compile(r"\b(UF|UT)\s*:\s*([0-9]+|F)")
_CONFIG = re.compile(r"CONFIG\s*:?\s*'([^']*)'")
_TURN_COUNTS = re.compile(r"[-+]?[0-9]+")
_BETWEEN = re.compile(r"[\s,:]*")  # what may stand between the values of a position


@dataclass(frozen=True, kw_only=True)
class FanucPosition:
    """One P[n]: a pose or axes of group 1, and the other groups' axes."""

    line: int
    values: dict[str, float]
    user_frame: int | None
    tool: int | None
    configuration: dict[str, object]
    other_groups: tuple[float, ...]
    fault: str = ""


@dataclass
class FanucFile:
    """One .ls file."""

    source: SourceFile
    name: str = ""
    lines: list[tuple[int, str]] = field(default_factory=list)
    positions: dict[int, FanucPosition] = field(default_factory=dict)
    has_end: bool = False


def split_sections(source: SourceFile) -> FanucFile:
    """Split a TP file into its sections.

    Args:
        source: Lines of the file, with its path and the builder of its errors.

    Returns:
        Header, lines and positions.
    """
    part = FanucFile(source)
    section = ""
    open_line, text = 0, ""
    pos_from = len(source.lines)
    for n, raw in enumerate(source.lines, 1):
        word = raw.strip()
        if word.startswith("/"):
            section = word.split()[0].upper()
            if section == "/PROG":
                part.name = [*word.split(), ""][1]
            elif section == "/POS":
                pos_from = n
            elif section.startswith("/END"):
                part.has_end = True
                break
            continue
        if section != "/MN" or not word:
            continue
        found = _LINE.fullmatch(raw)
        body = found.group(2) if found is not None else word
        open_line, text = (n, body) if not text else (open_line, f"{text} {body}")
        if ";" in text:
            part.lines.append((open_line, text.split(";")[0].strip()))
            text = ""
    if text:
        part.lines.append((open_line, text.strip()))
    _parse_positions(part, pos_from)
    return part


def _parse_positions(part: FanucFile, start: int) -> None:
    text = "\n".join(part.source.lines[start:])
    line, at = start + 1, 0
    for found in _P.finditer(text):
        line += text.count("\n", at, found.start())
        at = found.start()
        index, body = int(found.group(1)), found.group(2)
        groups = _GROUP.split(body)
        sections = {groups[k]: groups[k + 1] for k in range(1, len(groups) - 1, 2)} or {"1": body}
        first = sections.get("1", "")
        values, fault = _parse_values(first)
        frames = {k: (None if v == "F" else int(v)) for k, v in _FRAME.findall(first)}
        bits: dict[str, object] = {}
        config = _CONFIG.search(first)
        if config is not None:
            words = [w.strip() for w in config.group(1).split(",")]
            bits["config"] = "".join(words[0].split())
            turns = [parse_number(w) for w in words[1:]]
            bits["turns"] = tuple(int(t) for t in turns if t is not None)
            strange = next((w for w in words[1:] if w and not _TURN_COUNTS.fullmatch(w)), None)
            fault = fault or ("" if strange is None else f"the turn {strange!r} is no whole number")
        others = [values[k] for k in sorted(values) if k.startswith("E")]
        for group in sorted(sections):
            if group != "1":
                more, trouble = _parse_values(sections[group])
                fault = fault or trouble
                others += [more[k] for k in sorted(more) if k[0] in "JE"]
        if not fault and "J1" not in values and not {"X", "Y", "Z", "W", "P", "R"} <= set(values):
            fault = "found neither J1 … J6 nor X, Y, Z, W, P, R"
        part.positions[index] = FanucPosition(
            line=line,
            values=values,
            user_frame=frames.get("UF"),
            tool=frames.get("UT"),
            configuration=bits,
            other_groups=tuple(others),
            fault=fault,
        )


def _parse_values(text: str) -> tuple[dict[str, float], str]:
    """The values of one motion group, and what is wrong with them.

    Text that belongs to no value is a fault: it is the rest of a damaged number or a value that has no place here.
    """
    out: dict[str, float] = {}
    for name, value, unit in _ITEM.findall(text):
        known = parse_number(value)
        if known is None:
            return out, f"{name} is not taught ({value[:12]})"
        if name in out:
            return out, f"{name} occurs twice"
        out[name] = known * (25.4 if unit == "in" else 1.0)
    rest = text
    for part in (_CONFIG, _FRAME, _ITEM):
        rest = part.sub("\n", rest)
    strange = next((line for line in map(str.strip, rest.splitlines()) if not _BETWEEN.fullmatch(line)), None)
    return out, "" if strange is None else f"cannot read {strange[:24]!r}"
