"""Request of ``machopt identify`` in the user's units, and its conversion to SI."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from machopt.data_types.stiffness import StiffnessTerm
from machopt.errors import InputError, OptionError
from machopt.measurement.identification.data_quality.load_test_checks import CODES
from machopt.measurement.identification.options import IdentifyOptions


@dataclass(frozen=True, kw_only=True)
class IdentifyRequest:
    """Options of one run; lengths in mm, as entered."""

    cell: Path
    recordings: tuple[Path, ...]
    out: Path
    model: str = "auto"
    terms: tuple[str, ...] = ()  # EFFECT@LOCATION, or EFFECT@LOCATION{key: value, …}
    geometric: bool = False
    plain: bool = False  # dumas2011 eq. 26: no weights, no bounds, outliers kept
    robust: bool = True
    grid_cell_mm: float = 300.0
    grid_origin_mm: tuple[float, ...] | None = None
    grid_shape: tuple[int, ...] | None = None
    level_percent: float = 90.0
    studies: bool = True
    accept: tuple[str, ...] = ()
    seed: int = 0
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with user-defined effects, which --fit may name
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added


def check_identify_request(request: IdentifyRequest) -> None:
    """Check a request.

    Args:
        request: Validated user request.

    Raises:
        InputError: Names the option, the value found and what would be accepted.
    """
    if request.model not in ("auto", "constant", "grid"):
        raise OptionError(f"found {request.model!r}; valid: auto, constant, grid", where="--model")
    if not (isfinite(request.grid_cell_mm) and request.grid_cell_mm > 0):
        raise OptionError(f"found {request.grid_cell_mm:g}; more than zero would work", where="--grid-cell-mm")
    for name, value in (("--grid-origin-mm", request.grid_origin_mm), ("--grid-shape", request.grid_shape)):
        if value is not None and len(value) != 3:
            raise InputError(f"found {len(value)} numbers; expected three, x,y,z", where=name)
    if request.grid_shape is not None and min(request.grid_shape) < 1:
        raise OptionError(f"found {min(request.grid_shape)}; at least one cell along each axis", where="--grid-shape")
    if not 50.0 <= request.level_percent < 100.0:
        raise OptionError(f"found {request.level_percent:g}; 50 to below 100 would work", where="--level")
    if request.plain and request.model == "grid":
        raise OptionError(
            "the plain least squares of dumas2011 has no grid; --model constant would work", where="--plain"
        )
    for code in request.accept:
        if code not in CODES:
            raise OptionError(f"found {code!r}; valid: {', '.join(CODES)}", where="--accept")


def convert_to_options(request: IdentifyRequest, terms: tuple[StiffnessTerm, ...]) -> IdentifyOptions:
    """Convert a request to SI.

    Args:
        request: Validated user request.
        terms: Terms to fit.

    Returns:
        The options.
    """
    origin, shape = request.grid_origin_mm, request.grid_shape
    return IdentifyOptions(
        model="constant" if request.plain else request.model,  # type: ignore[arg-type]
        terms=terms,
        geometric=request.geometric,
        load_effect=not request.plain,
        weighted=not request.plain,
        robust=request.robust and not request.plain,
        bounded=not request.plain,
        grid_cell=request.grid_cell_mm / 1e3,
        grid_origin=None if origin is None else (origin[0] / 1e3, origin[1] / 1e3, origin[2] / 1e3),
        grid_shape=None if shape is None else (shape[0], shape[1], shape[2]),
        level=request.level_percent / 100.0,
        studies=request.studies,
        accept=frozenset(request.accept),
        seed=request.seed,
    )
