"""Request of ``machopt identify`` with a recording of kind ``frf``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from machopt.errors import OptionError
from machopt.measurement.identification.request import IdentifyRequest

_OPTION_NAMES = {
    "terms": "--fit",
    "robust": "--keep-outliers",
    "studies": "--no-studies",
    "grid_cell_mm": "--grid-cell-mm",
    "grid_origin_mm": "--grid-origin-mm",
    "grid_shape": "--grid-shape",
}
_SHARED = {"cell", "recordings", "out", "level_percent", "seed", "allow_external", "tables", "overwrite"}


@dataclass(frozen=True, kw_only=True)
class FrequencyResponseRequest:
    """Options of one run."""

    cell: Path
    recording: Path
    out: Path
    level_percent: float = 90.0
    seed: int = 0
    allow_external: bool = False
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added


def convert_identify_request(request: IdentifyRequest) -> FrequencyResponseRequest:
    """Return the request for frequency responses.

    Args:
        request: Options as ``machopt identify`` has them.

    Raises:
        OptionError: An option without effect on frequency responses, or more than one recording.
    """
    for field in fields(request):
        if field.name not in _SHARED and getattr(request, field.name) != field.default:
            name = _OPTION_NAMES.get(field.name, "--" + field.name.replace("_", "-"))
            raise OptionError("has no effect on frequency responses; leave it out", where=name)
    if len(request.recordings) > 1:
        raise OptionError(
            f"found {len(request.recordings)} recordings; expected one of kind frf with all files in its list data",
            where="RECORDING",
        )
    converted = FrequencyResponseRequest(
        cell=request.cell,
        recording=request.recordings[0],
        out=request.out,
        level_percent=request.level_percent,
        seed=request.seed,
        allow_external=request.allow_external,
        tables=request.tables,
        overwrite=request.overwrite,
    )
    check_frequency_response_request(converted)
    return converted


def check_frequency_response_request(request: FrequencyResponseRequest) -> None:
    """Check a request.

    Args:
        request: The request.

    Raises:
        OptionError: Names the option, the value found and what would be accepted.
    """
    if not 50.0 <= request.level_percent < 100.0:
        raise OptionError(f"found {request.level_percent:g}; 50 to below 100 would work", where="--level")
