"""Notes of a reader while it processes its source: words without effect, warnings, options that had an effect."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import IgnoredWord, MoveKind, format_incomplete_warning
from machopt.file_formats.source_file import ReadOptions, SourceFile, normalise_word
from machopt.numerics.array_types import Array
from machopt.path_building.path_checks import SLOW_MM_MIN

FAST_MM_MIN = 100e3  # no robot cuts faster: a slip of units, or a placeholder


@dataclass(kw_only=True)
class ReadingNotes:
    """What a reader states about its source besides points."""

    source: SourceFile
    options: ReadOptions
    _ignored: dict[str, IgnoredWord] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    meta: dict[str, str] = field(default_factory=dict)
    used_options: set[str] = field(default_factory=set)  # options that had an effect
    incomplete_reason: str | None = None  # why the file looks as if a part of it were missing

    def ignore(self, word: str, line: int, *, understood: bool, stops: bool | None = None) -> None:
        """Count a word without effect here.

        A word that is not understood may move points or frames, so it stops a plan
        (:func:`machopt.toolpath.unknown_words.refuse_unknown_words`) unless the user accepts it.

        Args:
            word: as the file has it, and as ``--accept-unknown`` takes it.
            line: where it is.
            understood: it is on the dialect's reviewed list, or the reader uses it.
            stops: False where a word that is not understood cannot move anything; by default it may.

        Raises:
            InputError: it is not understood, not accepted, and reading is strict.
        """
        entry = self._ignored.get(word)
        if entry is None or (entry.understood and not understood):
            accepted = not understood and normalise_word(word) in self.options.accept_unknown
            if self.options.strict and not understood and not accepted:
                raise self.source.build_error(f"word {word!r} is not understood and strict reading was requested", line)
            may_move = not understood if stops is None else stops
            entry = IgnoredWord(word, 0, line, understood, may_move and not accepted)
        self._ignored[word] = replace(entry, count=entry.count + 1)

    def warn(self, message: str, line: int | None = None) -> None:
        """Add a warning.

        Args:
            message: Text of the warning.
            line: Line number (1-based), None where no line is meant.
        """
        self.warnings.append(message if line is None else f"line {line}: {message}")

    def warn_once(self, message: str, line: int | None = None) -> None:
        """Add a warning, the first time it occurs.

        Args:
            message: Text of the warning.
            line: Line number (1-based), None where no line is meant.
        """
        if not any(w.endswith(message) for w in self.warnings):
            self.warn(message, line)

    def feed_fallback(self, feed: float, line: int) -> float:
        """Return the default feed of a cut that has no feed of its own.

        Args:
            feed: Feed, mm/min; NaN for rapid moves.
            line: Line number in the file (1-based).

        Returns:
            Feed, mm/min.

        Raises:
            InputError: the feed is not positive, or no default feed was given.
        """
        if feed <= 0.0:
            raise self.source.build_error(f"feed {feed:g} on a cutting move; expected a feed above zero", line)
        if self.options.default_feed is None:
            raise self.source.build_option_question(
                "feed",
                "cutting move without a feed; expected a feed word before it, or give one with --feed MM_MIN",
                line,
            )
        self.used_options.add("--feed")
        self.warn_once("cutting moves without a feed of their own take the given default feed")
        return self.options.default_feed * 60e3

    def warn_of_feeds_and_words(self, table: Array, move: NDArray[np.int8], line: NDArray[np.int32]) -> None:
        """Warn of unusual feeds and of unknown words.

        Args:
            table: (N, 7) x y z i j k feed (mm, mm/min).
            move: (N,) Move codes.
            line: (N,) Line numbers in the file (1-based).
        """
        fast = np.flatnonzero((move == MoveKind.CUT) & (table[:, 6] > FAST_MM_MIN))
        if len(fast):
            self.warn(f"{len(fast)} cuts at up to {table[fast, 6].max():.3g} mm/min", int(line[fast[0]]))
        slow = np.flatnonzero((move == MoveKind.CUT) & (table[:, 6] < SLOW_MM_MIN))
        if len(slow):
            self.warn(f"{len(slow)} cuts at {table[slow, 6].min():.3g} mm/min and more", int(line[slow[0]]))
        strange = [w for w in self._ignored.values() if not w.understood]
        if strange:
            self.warn(
                f"{sum(w.count for w in strange)} words were not understood: {format_words([w.word for w in strange])}"
            )
        stopping = [f"{w.word} (line {w.first_line})" for w in strange if w.stops]
        if stopping:
            self.warn(
                f"no plan is made from this file, because these words may move points or frames: "
                f"{format_words(stopping)}. "
                "--accept-unknown WORD accepts one that moves nothing"
            )

    def state_incompleteness(self) -> None:
        """State why the file seems incomplete.

        Raises:
            InputError: it seems so, and strict reading was requested.
        """
        if self.incomplete_reason is None:
            return
        if self.options.strict:
            raise self.source.build_error(
                f"the file seems incomplete, and strict reading was requested: {self.incomplete_reason}"
            )
        self.meta["incomplete"] = self.incomplete_reason
        self.warnings.insert(0, format_incomplete_warning(self.incomplete_reason))


def format_words(words: list[str], most: int = 8) -> str:
    """Return words as text, the first ones by name and the number of the others.

    Args:
        words: The words.
        most: Largest number that is named.
    """
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")
