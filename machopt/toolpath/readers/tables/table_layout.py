"""Layout of a point table: its separator, and lines above its header.

Separators are commas. Semicolons and tabs are read too where no line holds a comma, which could be a decimal comma.
Lines above the header (a title) are left out with a note where a later line names the columns x, y and z.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass, replace

from machopt.file_formats.csv_columns import is_number, iterate_data_lines
from machopt.file_formats.source_file import SourceFile

_TITLE_LINES = 5  # data lines above a header that are looked through
_SEPARATORS = (",", ";", "\t")
_NAMES = {";": "semicolons", "\t": "tabs"}
_LETTER = re.compile(r"([xyz])(?:_?(?:mm|inch|in))?", re.IGNORECASE)
ACCEPTED = "expected one header line such as x_mm,y_mm,z_mm, columns separated by commas, and decimal points"


@dataclass(frozen=True)
class TableLayout:
    """Where the table begins and how its cells are separated."""

    line: int  # of the header or, without one, of the first row (1-based)
    separator: str
    titles: tuple[int, ...] = ()  # lines above the header


def find_layout(source: SourceFile) -> TableLayout | None:
    """Find the layout of a table with a header that names x, y and z, or of a table of plain numbers.

    Args:
        source: Lines of the file, with its path and the builders of its errors.

    Returns:
        The layout; None where the file is no table.
    """
    titles: list[int] = []
    for line, text in iterate_data_lines(source):
        for separator in _SEPARATORS:
            cells = [c.strip().strip('"') for c in text.split(separator)]
            if not titles and len(cells) >= 3 and (_is_header(cells, "x") or all(map(is_number, cells))):
                return TableLayout(line, separator)
            if _is_header(cells, "xyz"):
                return TableLayout(line, separator, tuple(titles))
        titles.append(line)
        if len(titles) > _TITLE_LINES:
            break
    return None


def _is_header(cells: list[str], letters: str) -> bool:
    named = {found.group(1).lower() for c in cells if (found := _LETTER.fullmatch(c))}
    return set(letters) <= named


def describe_other_layout(source: SourceFile) -> tuple[str, int] | None:
    """Say why a file that looks like a table of points is none.

    Args:
        source: Lines of the file, with its path and the builders of its errors.

    Returns:
        What was found and what is accepted, and the line; None where it does not look like a table.
    """
    for count, (line, text) in enumerate(iterate_data_lines(source)):
        if _is_header(re.split(r"[\s|]+", text.strip().strip("|").strip()), "xyz"):
            return f"the columns are separated by blanks or bars: {ACCEPTED}", line
        if count >= _TITLE_LINES:
            break
    return None


def convert_layout(source: SourceFile, layout: TableLayout) -> tuple[SourceFile, list[tuple[str, int]]]:
    """Convert a table to commas, without its title lines.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        layout: Its layout.

    Returns:
        The file with as many lines, and notes with their lines.

    Raises:
        InputError: a line holds a comma while another separator is in use.
    """
    if layout.separator == "," and not layout.titles:
        return source, []
    notes = [("text above the header: left out", line) for line in layout.titles]
    lines = ["" if n in layout.titles else text for n, text in enumerate(source.lines, 1)]
    if layout.separator != ",":
        name = _NAMES[layout.separator]
        for line, text in iterate_data_lines(replace(source, lines=lines)):
            if "," in text:
                raise source.build_error(
                    f"columns are separated by {name} and the line holds a comma, which could be a decimal comma: "
                    f"{ACCEPTED}",
                    line,
                )
            lines[line - 1] = _join_with_commas(text, layout.separator)
        notes.append((f"columns are separated by {name}; read like commas", layout.line))
    return replace(source, lines=lines), notes


def _join_with_commas(text: str, separator: str) -> str:
    if '"' not in text:
        return text.replace(separator, ",")
    cells = next(csv.reader([text], delimiter=separator))
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow(cells)
    return out.getvalue()
