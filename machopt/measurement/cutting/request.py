"""Request of ``machopt process`` in the user's units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from machopt.errors import OptionError


@dataclass(frozen=True, kw_only=True)
class ProcessRequest:
    """Options of one run."""

    cell: Path
    recording: Path
    out: Path
    material: str = ""  # name in process.yaml; empty: that of the recording's folder
    level_percent: float = 90.0
    keep_outliers: bool = False
    allow_external: bool = False
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added


def check_process_request(request: ProcessRequest) -> None:
    """Check a request.

    Args:
        request: Validated user request.

    Raises:
        OptionError: Names the option, the value found and what would be accepted.
    """
    if not 50.0 <= request.level_percent < 100.0:
        raise OptionError(f"found {request.level_percent:g}; 50 to below 100 would work", where="--level")
    if request.material and not request.material.isprintable():
        raise OptionError(f"found {request.material!r}; a printable name would work", where="--material")
