"""Comments, operations, events and unknown words of a program while it is read."""

from __future__ import annotations

import math
import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path

from machopt.data_types.toolpath import MoveKind, ToolpathEvent
from machopt.errors import InputError
from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.move_attributes import parse_number
from machopt.programs.reading.parsed_program import JOINT, LINEAR

_MOVES = {m.word: m for m in MoveKind}
_CAM_KINDS = (
    (re.compile(r"\s*(?:SPINDL|S[0-9]|M0?[345]\b)", re.IGNORECASE), "spindle"),
    (re.compile(r"\s*(?:COOLNT|M0?[789]\b)", re.IGNORECASE), "coolant"),
    (re.compile(r"\s*(?:LOADTL|TURRET|TOOLNO|T[0-9])", re.IGNORECASE), "tool"),
    (re.compile(r"\s*(?:DELAY|DWELL|G0?4\b)", re.IGNORECASE), "dwell"),
    (re.compile(r"\s*(?:STOP|OPSTOP|M0?[01]\b)", re.IGNORECASE), "stop"),
)
_LABEL = re.compile(r"\s*(operation|move|CAM|external)\s*:\s?(.*)", re.IGNORECASE)


@dataclass(kw_only=True)
class ProgramAnnotations:
    """What a program states beside its moves; comments of our own programs name operations and kinds of move."""

    source: SourceFile
    dialect: str
    arc_tolerance: float
    strict: bool = False
    name: str = ""
    files: list[Path] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    has_external_values_in_comments: bool = (
        False  # the language has no external axes: a comment gives their required positions
    )
    commented_external_values: tuple[float, ...] = ()  # mm or deg, the value of that comment
    _codes: array[int] = field(default_factory=lambda: array("i"))  # kind base tool move operation line
    _events: list[ToolpathEvent] = field(default_factory=list)
    _is_last_event_comment: bool = (
        False  # the last event is a comment from the CAM file that a statement may still explain
    )
    _operations: list[str] = field(default_factory=list)
    _operation: int = -1
    _word: MoveKind = MoveKind.CUT
    _has_move_comment: bool = False  # a comment gave the kind of the next moves
    _ignored: dict[tuple[str, bool, bool], list[int]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self._codes) // 6

    def error(self, message: str, line: int | None = None, source: SourceFile | None = None) -> InputError:
        """Build an error of the program file.

        Args:
            message: Description of the error.
            line: Line number (1-based), None where no line is meant.
            source: File of the line; None for the main file.

        Returns:
            The error, not raised.
        """
        return (source or self.source).build_error(message, line)

    def comment(self, text: str) -> None:
        """Read a comment: those of our own programs name operations, kinds of move and events of the CAM file.

        Args:
            text: Text in the program.
        """
        found = _LABEL.fullmatch(text)
        if found is None:
            return
        word, rest = found.group(1).lower(), found.group(2).strip()
        if word == "operation":
            self.begin(rest)
        elif word == "move":
            self.word(rest.lower())
            self._has_move_comment = True
        elif word == "external":
            values = [parse_number(v) for v in rest.split()]
            if self.has_external_values_in_comments and all(v is not None for v in values):
                self.commented_external_values = tuple(v for v in values if v is not None)
        else:
            self.event(rest, fresh=True)

    def begin(self, label: str) -> None:
        """Begin an operation for the moves that follow.

        Args:
            label: Name of the operation.
        """
        if not label or (self._operation >= 0 and self._operations[self._operation] == label):
            return
        if label not in self._operations:
            self._operations.append(label)
        self._operation = self._operations.index(label)

    def begin_or_none(self, label: str) -> None:
        """Begin an operation, for formats that give it with every move; without a label a move belongs to none.

        Args:
            label: Name of the operation.
        """
        self.begin(label)
        if not label:
            self._operation = -1

    def word(self, word: str) -> None:
        """Set the kind of the moves that follow.

        Args:
            word: Word of the kind.
        """
        self._word = _MOVES.get(word, self._word)

    @property
    def find_streamed_kind(self) -> int:
        """Kind of a streamed joint target: linear where a comment marks the move as a path move."""
        return LINEAR if self._has_move_comment and self._word != MoveKind.RAPID else JOINT

    def event(self, text: str, kind: str | None = None, value: float = math.nan, *, fresh: bool = False) -> None:
        """Add an event before the next move; a statement directly after a CAM comment explains that comment.

        Args:
            text: Text in the program.
            kind: Kind of the event; None to derive it from the text.
            value: Number of the event; NaN where it has none.
            fresh: Whether the event stays separate from the previous comment.
        """
        if self._is_last_event_comment and not fresh:
            last = self._events[-1]
            known = kind if kind is not None and kind != "comment" else last.kind
            kept_value = value if math.isfinite(value) else last.value
            self._events[-1] = ToolpathEvent(last.index, known, last.text, kept_value)  # type: ignore[arg-type]
            self._is_last_event_comment = False
            return
        if kind is None:
            kind = next((k for pattern, k in _CAM_KINDS if pattern.match(text)), "comment")
        self._events.append(ToolpathEvent(len(self), kind, text[:200], value))  # type: ignore[arg-type]
        self._is_last_event_comment = fresh

    def ignore(self, word: str, line: int, *, understood: bool, stops: bool | None = None) -> None:
        """Count a statement without effect here.

        One that is not understood may move points or frames, so it stops a plan, unless ``stops`` is False.

        Args:
            word: The statement.
            line: Line number in the file (1-based).
            understood: Whether the statement is known.
            stops: Whether the statement stops a plan; None to derive it.

        Raises:
            InputError: with ``strict``, the statement is not understood.
        """
        key = (word[:40], understood, not understood if stops is None else stops)
        entry = self._ignored.setdefault(key, [0, line])
        entry[0] += 1
        if self.strict and not understood and entry[0] == 1:
            raise self.error(f"{word[:40]!r} is not understood and strict reading was requested", line)

    def warn_once(self, message: str, line: int | None = None) -> None:
        """Add a warning, the first time it occurs.

        Args:
            message: Description of the error.
            line: Line number (1-based), None where no line is meant.
        """
        if not any(w.endswith(message) for w in self.warnings):
            self.warnings.append(message if line is None else f"line {line}: {message}")
