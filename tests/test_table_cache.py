"""Cache of tables: each is read once while its bytes are the same, within a size limit."""

from __future__ import annotations

from pathlib import Path

import pytest

from machopt.errors import InputError
from machopt.verification.tables import table_cache
from machopt.verification.tables.csv_columns import read_table
from machopt.verification.tables.table_cache import cache_tables


def test_table_is_read_once_until_a_byte_changes(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("a,b\n1,2\n")
    with cache_tables():
        first = read_table(file)
        with cache_tables():  # nested use by code that does not know about the outer cache
            assert read_table(file) is first
        assert read_table(file) is first
        file.write_text("a,b\n1,3\n")  # same length, and possibly the same time stamp
        assert read_table(file).read_numbers("b").tolist() == [3.0]
        file.unlink()
        with pytest.raises(InputError, match="cannot be read"):
            read_table(file)
    file.write_text("a,b\n1,2\n")
    assert read_table(file) is not read_table(file)  # without a cache nothing is stored


def test_table_too_long_to_cache_is_read_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_cache, "MAX_CACHED_BYTES", 7)
    file = tmp_path / "points.csv"
    file.write_text("a,b\n1,2\n")
    with cache_tables():
        assert read_table(file) is not read_table(file)
