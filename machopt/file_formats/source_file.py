"""Text file as input of the toolpath readers: lines, hash, origin and reading options."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from machopt.errors import FileFormatError, InputError, OptionError
from machopt.file_formats.file_reading import TOOLPATH, read_file
from machopt.file_formats.plain_decimals import parse_plain_decimal

MM_PER_INCH = 25.4
_CHUNK = 20_000  # lines searched at once
CYCLE_QUANTITIES = ("depth", "clear", "retract", "feed", "peck", "dwell")
UNIT_NAMES = {"mm": 1.0, "inch": MM_PER_INCH}
TOOL_AXES = {"-z": (2, -1.0), "+z": (2, 1.0), "-x": (0, -1.0), "+x": (0, 1.0), "-y": (1, -1.0), "+y": (1, 1.0)}
"""Column of the tool frame and its sign: the direction from the tip to the shank, in robot programs and pose tables."""


Offset = tuple[float, float, float]
_OFFSET = re.compile(r"\s*(G[0-9]+(?:\.[0-9])?(?:\s*[PH]\s*[0-9]+)?|PRESET\s*[0-9]+)\s*=(.*)", re.IGNORECASE)
MAX_EXTENT = 50.0  # m: longer than any machining cell; a path beyond it is a slip of units or decimals
MOST_DECIMALS = 6


def parse_offsets(texts: Sequence[str]) -> tuple[tuple[str, Offset], ...]:
    """Options such as ``G55=100,0,0``: where a work offset's origin lies in the first offset of the program, in mm.

    Args:
        texts: names as the messages print them (``G55``, ``G54.1P2``, ``G505``, ``preset2``), with three numbers.
    Raises:
        InputError: a text is not of that form, or an offset is named twice.
    """
    found: list[tuple[str, Offset]] = []
    for text in texts:
        parts = _OFFSET.fullmatch(text)
        try:
            values = [parse_plain_decimal(v) for v in parts.group(2).split(",")] if parts else []
        except ValueError:
            values = []
        if parts is None or len(values) != 3 or not all(map(math.isfinite, values)):
            raise OptionError(f"{text!r}: expected e.g. G55=100,0,0, G54.1P2=… or preset2=… (mm)", where="--offset")
        name = normalise_offset_name(parts.group(1))
        if any(name == one for one, _ in found):
            raise OptionError(f"{text!r}: {name} is given twice; keep one", where="--offset")
        found.append((name, (values[0], values[1], values[2])))
    return tuple(found)


def normalise_offset_name(name: str) -> str:
    """Return the standard spelling of a work offset: upper case without blanks.

    Args:
        name: Name of the offset.
    """
    return "".join(name.upper().split())


def normalise_word(word: str) -> str:
    """Return the standard spelling of an unknown word: upper case with single blanks.

    Args:
        word: The word.
    """
    return " ".join(word.upper().split())


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Reading options: values that the file may lack."""

    unit: str | None = None  # "mm" or "inch"
    strict: bool = False  # refuse the first word that is not understood
    arc_tolerance: float = 5e-6  # m, largest distance of a chord from its arc
    machine: str | None = None  # rotary kinematics, see formats.rotary
    default_feed: float | None = None  # m/s, where the file gives none
    offsets: tuple[tuple[str, Offset], ...] = ()  # (work offset, its origin in the first one used, mm)
    cycle_order: tuple[str, ...] = ("depth", "clear", "retract")  # meaning of numbers without a word in CYCLE/
    tool_axis: str = "-z"  # one of TOOL_AXES
    decimals: int | None = None  # places of G-code numbers without a point; 0: as written; None: not given
    max_extent: float = MAX_EXTENT  # m, along one axis
    accept_unknown: tuple[
        str, ...
    ] = ()  # words that move nothing by the user's option, as :func:`normalise_word` spells them
    kind: str | None = None  # "path" or "holes": rows of a point table without a row kind
    cell_offsets: tuple[str, ...] = ()  # names of the cell's work offsets: points in them are placed once they are read

    def __post_init__(self) -> None:
        if self.unit is not None and self.unit not in UNIT_NAMES:
            raise OptionError(f"unknown unit {self.unit!r}: known are {', '.join(UNIT_NAMES)}", where="--unit")
        if not (math.isfinite(self.arc_tolerance) and self.arc_tolerance > 0.0):
            raise InputError(f"the arc tolerance must be positive, found {self.arc_tolerance}", where="arc_tolerance")
        if self.default_feed is not None and not (math.isfinite(self.default_feed) and self.default_feed > 0.0):
            raise InputError(f"the feed must be positive, found {self.default_feed}", where="default_feed")
        if self.tool_axis not in TOOL_AXES:
            raise OptionError(
                f"unknown tool axis {self.tool_axis!r}: known are {', '.join(TOOL_AXES)}", where="--tool-axis"
            )
        if self.kind not in (None, "path", "holes"):
            raise OptionError(f"unknown kind {self.kind!r}: known are path, holes", where="--kind")
        strange = [w for w in self.cycle_order if w not in CYCLE_QUANTITIES]
        if strange or len(set(self.cycle_order)) != len(self.cycle_order):
            raise OptionError(
                f"found {','.join(self.cycle_order)!r}; expected some of {', '.join(CYCLE_QUANTITIES)} in their order",
                where="--cycle-order",
            )
        if self.decimals is not None and not 0 <= self.decimals <= MOST_DECIMALS:
            raise OptionError(f"found {self.decimals}; expected 0 to {MOST_DECIMALS} decimals", where="--decimals")
        if not (math.isfinite(self.max_extent) and self.max_extent > 0.0):
            raise OptionError(f"the extent must be positive, found {self.max_extent} m", where="--max-extent")


class OptionNeededError(InputError):
    """Error of a file that needs an option for a value it lacks."""

    def __init__(self, message: str, *, file: Path, where: str | None, option: str) -> None:
        super().__init__(message, file=file, where=where)
        self.option = option  # unit | machine | decimals | offset | feed


@dataclass(frozen=True)
class SourceFile:
    """The lines of one file, decoded once."""

    path: Path
    lines: list[str]  # without line ends; line k of messages is lines[k - 1]
    sha256: str
    complete: bool  # the last line ends with a line feed

    @property
    def name(self) -> str:
        return self.path.name

    def find_line(self, pattern: re.Pattern[str]) -> int | None:
        """Find the first line that matches a MULTILINE pattern, many lines at a time.

        Args:
            pattern: The compiled pattern.

        Returns:
            Line number (1-based), None where none matches.
        """
        for first in range(0, len(self.lines), _CHUNK):
            text = "\n".join(self.lines[first : first + _CHUNK])
            found = pattern.search(text)
            if found:
                return first + 1 + text.count("\n", 0, found.start())
        return None

    def build_error(self, message: str, line: int | None = None, column: int | str | None = None) -> FileFormatError:
        """Build an error that names this file and, where known, line and column.

        Args:
            message: Description of the error.
            line: Line number (1-based), None where no line is meant.
            column: Number or name of the column, None where no column is meant.

        Returns:
            The error, not raised.
        """
        where = None if line is None else f"line {line}" + ("" if column is None else f", column {column}")
        return FileFormatError(message, file=self.path, where=where)

    def build_option_question(self, option: str, message: str, line: int | None = None) -> OptionNeededError:
        """Build an error that the user can answer by an option.

        Args:
            option: Name of the option without dashes.
            message: Description of the error.
            line: Line number (1-based), None where no line is meant.

        Returns:
            The error, not raised.
        """
        return OptionNeededError(message, file=self.path, where=None if line is None else f"line {line}", option=option)


def read_bytes(path: Path) -> bytes:
    """Read the content of a file.

    Args:
        path: Path of the file.

    Returns:
        The bytes.

    Raises:
        FileFormatError: it is absent, no regular file, not readable, too large or empty.
    """
    data = read_file(path, expected="a toolpath file", most=TOOLPATH)
    if not data.strip():
        raise FileFormatError("is empty; expected toolpath points", file=path)
    return data


def decode_source(path: Path, data: bytes) -> SourceFile:
    """Decode the text lines of a file: UTF-8 (BOM accepted), else Latin-1; LF, CRLF or CR line ends.

    Args:
        path: Path of the file.
        data: Content of the file.

    Returns:
        The lines with the path.

    Raises:
        FileFormatError: the content is binary.
    """
    for bom, codec in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig")):
        if data.startswith(bom):
            try:
                text = data.decode(codec)
            except UnicodeDecodeError as problem:
                raise FileFormatError(f"starts as {codec} text but is not: {problem.reason}", file=path) from problem
            break
    else:
        _refuse_binary(path, data)
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            text = data.decode("latin-1")  # CAM headers in national code pages; motion words are ASCII
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    complete = text.endswith("\n")
    lines = text.split("\n")
    if complete:
        lines.pop()
    return SourceFile(path, lines, hashlib.sha256(data).hexdigest(), complete)


_CONTROL = bytes(b for b in range(32) if b not in b"\t\n\r\f\x1a")


def _refuse_binary(path: Path, data: bytes) -> None:
    head = data[:65536]
    control = len(head) - len(head.translate(None, _CONTROL))
    if control > 0.01 * len(head):
        raise FileFormatError(
            f"is binary ({control} control bytes in the first {len(head)}); expected text: "
            "APT/CL, G-code, Heidenhain, NCI or CSV (or Parquet)",
            file=path,
        )
