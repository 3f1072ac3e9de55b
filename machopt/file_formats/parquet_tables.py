"""Parquet copies of the CSV tables of an output folder: same columns and rows, made from the CSV text.

Word columns (WORDS, and any with a field that is no number) hold text, "" where the CSV is empty. All others are
float64, null where the CSV is empty. The type of these columns does not depend on the content of a folder, so tables
of many jobs can be concatenated.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from machopt.errors import FileFormatError, InputError

if TYPE_CHECKING:
    import pyarrow

Tables = Literal["csv", "parquet"]
KINDS: tuple[Tables, ...] = ("csv", "parquet")
_OF_A_MOTION = ("operation", "move", "status", "reason", "nearest_pair", "tool", "stiffness_from")
_OF_A_BATCH = ("job", "toolpath", "cell", "variant", "verdict", "unit", "programs", "warnings", "report", "worker")
WORDS = frozenset((*_OF_A_MOTION, *_OF_A_BATCH, "plan", "changed", "load"))  # the last of front.csv and poses.csv


def refuse_without_pyarrow(tables: str) -> None:
    """Check, before any computation, that Parquet can be written.

    Args:
        tables: Value of the option: ``csv`` or ``parquet``.

    Raises:
        InputError: another value, or pyarrow is not installed.
    """
    if tables not in KINDS:
        raise InputError(f"found {tables!r}; valid: {', '.join(KINDS)} (parquet: beside the CSV)", where="tables")
    if tables == "parquet":
        try:
            import pyarrow.parquet  # noqa: F401  only whether it is there
        except ImportError:
            raise InputError(
                "Parquet needs pyarrow: pip install '.[parquet]' in machopt's source folder, or --tables csv",
                where="tables",
            ) from None


@contextmanager
def open_parquet(file: Path) -> Iterator[Any]:
    """Provide pyarrow for reading a user's file: ``with open_parquet(file) as pyarrow:``.

    Args:
        file: Path of the file.

    Returns:
        Context with the module ``pyarrow``.

    Raises:
        FileFormatError: pyarrow is not installed, or it cannot read the file.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise FileFormatError(
            "is Parquet, which needs pyarrow: pip install '.[parquet]' in machopt's folder, or save the table as CSV",
            file=file,
        ) from None
    try:
        yield pyarrow
    except (pyarrow.ArrowException, OSError) as problem:
        raise FileFormatError(f"is not readable as Parquet: {problem}", file=file) from problem


def write_parquet_copies(tables: Iterable[Path], into: Path | None = None) -> list[str]:
    """Write each CSV table as Parquet under its own name.

    Args:
        tables: Paths of the CSV tables.
        into: Target folder, None for the folder of each table.

    Returns:
        Names of the written files.
    """
    import pyarrow.parquet

    out = []
    for table in sorted(tables):
        target = (into or table.parent) / table.with_suffix(".parquet").name
        pyarrow.parquet.write_table(_build_arrow_table(table), target)
        out.append(target.name)
    return out


def find_parquet_difference(table: Path, copy: Path) -> str:
    """Compare a Parquet table with the CSV table of which it is a copy.

    Args:
        table: Path of the CSV table.
        copy: Path of the Parquet table.

    Returns:
        Description of the first difference; empty where there is none.

    Raises:
        FileFormatError: pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise FileFormatError(
            "reading Parquet needs pyarrow: pip install '.[parquet]' in machopt's source folder", file=copy
        ) from None
    try:
        there = pyarrow.parquet.read_table(pyarrow.BufferReader(copy.read_bytes()))
        here = _build_arrow_table(table)
    except OSError as problem:
        return f"cannot be read: {problem.strerror or problem}"
    except (pyarrow.ArrowException, UnicodeDecodeError, csv.Error, StopIteration, ValueError) as problem:
        return f"is not readable: {problem}"
    if there.column_names != here.column_names:
        return f"has the columns {', '.join(there.column_names)}; {table.name} has {', '.join(here.column_names)}"
    if there.num_rows != here.num_rows:
        return f"has {there.num_rows} rows; {table.name} has {here.num_rows}"
    for name in here.column_names:
        if not there[name].equals(here[name]):
            mine, own = there[name].to_pylist(), here[name].to_pylist()
            n = next((k for k, (a, b) in enumerate(zip(mine, own, strict=True)) if a != b), 0)
            return f"{name}, row {n + 1}: {mine[n]!r}, where {table.name} has {own[n]!r}"
    return ""


def _build_arrow_table(table: Path) -> pyarrow.Table:
    """A CSV table that machopt wrote."""
    import pyarrow

    with table.open(encoding="utf-8", newline="") as text:
        rows = csv.reader(line for line in text if not line.startswith("#"))
        head = next(rows)
        columns: list[tuple[str, ...]] = list(zip(*rows, strict=True)) or [()] * len(head)
    return pyarrow.table({name: _build_column(name, values) for name, values in zip(head, columns, strict=True)})


def _build_column(name: str, values: tuple[str, ...]) -> Any:
    import pyarrow

    if name not in WORDS:
        try:
            numbers = [float(v) if v else None for v in values]
        except ValueError:
            numbers = [math.inf]  # words
        if all(v is None or math.isfinite(v) for v in numbers):
            return pyarrow.array(numbers, pyarrow.float64())
    return pyarrow.array(values, pyarrow.string())
