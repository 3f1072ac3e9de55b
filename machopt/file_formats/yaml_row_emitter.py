"""Emitter of ruamel.yaml that writes rows of numbers at once, with the line breaks of the library."""

from __future__ import annotations

from typing import Any

from ruamel.yaml.emitter import Emitter

ROW_MARK = "\ue000"  # private use: no text of ours holds it


class RowEmitter(Emitter):
    """Emitter that writes a double-quoted mark as the row of its number in ``dumper.number_rows``."""

    def write_double_quoted(self, text: Any, split: Any = True) -> None:
        """Write a text in double quotes, or the row of numbers that it marks.

        Args:
            text: Text, or mark of a row.
            split: Whether the text may be broken into lines.
        """
        if text[:1] == ROW_MARK and text[-1:] == ROW_MARK and text[1:-1].isdecimal():
            self._write_row(self.dumper.number_rows[int(text[1:-1])])
        else:
            super().write_double_quoted(text, split)

    def _write_row(self, words: list[str]) -> None:
        """Write a flow sequence; the library breaks one that does not fit on the line."""
        self.write_indicator("[", True, whitespace=True)
        text = ", ".join(words)
        if self.column + len(text) < self.best_width:
            self.write_indicator(text, False)
        else:
            for n, word in enumerate(words):
                if n:
                    self.write_indicator(",", False)
                if self.column > self.best_width:
                    self.write_indent()
                self.increase_indent(flow=True)  # a word is indented below its row
                self.write_plain(word)
                self.indent = self.indents.pop()
        self.write_indicator("]", False)
