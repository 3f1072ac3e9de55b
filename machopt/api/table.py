"""Table of named columns, as a table file has them."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from machopt.api.error_message_translation import use_argument_names
from machopt.errors import InputError, suggest_nearest_word
from machopt.output.single_file import write_bytes_file

if TYPE_CHECKING:
    import pandas
    import pyarrow

SHOWN_ROWS, SHOWN_COLUMNS = 8, 12  # of a table in a notebook


class Table(Mapping[str, NDArray[Any]]):
    """A table: column name → (rows,) read-only array.

    Names and units are those of the file that ``save`` writes (``x_mm``, ``q1_deg``, ``deflection_mm`` …), and so are
    the numbers, to the last written decimal. An empty field is NaN; words are strings.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = dict(columns)
        for values in self._columns.values():
            values.setflags(write=False)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The column of this name.

        Raises:
            KeyError: there is none; the message names the nearest.
        """
        try:
            return self._columns[name]
        except KeyError:
            raise KeyError(f"no column {name!r}; {suggest_nearest_word(name, list(self._columns))}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __len__(self) -> int:
        """Number of columns; :attr:`rows` has the other one."""
        return len(self._columns)

    def __repr__(self) -> str:
        return f"<Table of {self.rows} rows: {', '.join(self._columns)}>"

    def _repr_html_(self) -> str:
        """Small, for notebooks: the first rows of the first columns, and how many there are."""
        from machopt.report.template_rendering import render_macro

        names = list(self._columns)[:SHOWN_COLUMNS]
        texts = [_format_column(self._columns[name][:SHOWN_ROWS]) for name in names]
        summary = f"{self.rows} rows, {len(self)} columns"
        more = ": the first of them; .frame() has all" if self.rows > SHOWN_ROWS or len(self) > len(names) else ""
        return str(render_macro("notebook.html", "table", names, list(zip(*texts, strict=True)), summary + more))

    @property
    def rows(self) -> int:
        return len(next(iter(self._columns.values()), ()))

    def array(self, *names: str) -> NDArray[np.float64]:
        """Return (rows, columns) of some numeric columns, read-only.

        Args:
            names: Names of the columns.
        """
        out = np.column_stack([np.asarray(self[name], float) for name in names])
        out.setflags(write=False)
        return out

    def frame(self) -> pandas.DataFrame:
        """Return the table as a pandas data frame with its own memory.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise InputError(
                "a data frame needs pandas; pip install '.[frames]' in machopt's source folder, or Table.arrow()"
            ) from None
        return pandas.DataFrame({name: values.copy() for name, values in self._columns.items()})

    def arrow(self) -> pyarrow.Table:
        """Return the table as an Arrow table, which polars, DuckDB and Parquet accept.

        Raises:
            InputError: pyarrow is not installed.
        """
        try:
            import pyarrow
        except ImportError:
            raise InputError(
                "an Arrow table needs pyarrow; pip install '.[parquet]' in machopt's source folder"
            ) from None
        return pyarrow.table({name: values.tolist() for name, values in self._columns.items()})

    @use_argument_names()
    def write(self, file: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the table, as CSV or Parquet by the file's ending.

        Args:
            file: ends in .csv or .parquet.
            force: replace a file that is there and holds something else.

        Raises:
            InputError: another ending, a file with other content, a folder that is not there, or pyarrow is not
                installed.
        """
        path = Path(file)
        if path.suffix.lower() == ".parquet":
            table = self.arrow()
            import pyarrow.parquet

            packed = io.BytesIO()
            pyarrow.parquet.write_table(table, packed)
            write_bytes_file(path, packed.getvalue(), force=force)
        elif path.suffix.lower() == ".csv":
            text = io.StringIO(newline="")
            rows = csv.writer(text, lineterminator="\n")
            rows.writerow(self._columns)
            rows.writerows(zip(*(_format_column(values) for values in self._columns.values()), strict=True))
            write_bytes_file(path, text.getvalue().encode(), force=force)
        else:
            raise InputError(f"tables are CSV or Parquet; {path.stem}.csv or {path.stem}.parquet would work", file=path)


def _format_column(values: NDArray[Any]) -> list[str]:
    """Shortest words that give the same numbers back; nothing for NaN."""
    if values.dtype.kind == "f":
        return ["" if v != v else repr(v) for v in values.tolist()]  # noqa: PLR0124  NaN is not itself
    return [str(v) for v in values.tolist()]
