"""Content of result.json with the data that it is compared with, and the basic comparisons."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.cell.tool_selection import split_into_tool_segments
from machopt.data_types.cell import Cell
from machopt.data_types.documents.document_base import DocumentModel
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.manifest import FolderManifest, ManifestFile
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.output.manifest_file import list_folder_files
from machopt.verification import Verification
from machopt.verification.check_results import CheckName
from machopt.verification.motion.motion_verification import read_tables
from machopt.verification.motion.process.recomputed_segment_forces import attach_recomputed_forces
from machopt.verification.motion.stiffness.spring_terms import UnknownTermError
from machopt.verification.motion.tool_changes import split_tables
from machopt.verification.motion.worst_index_along_cuts import find_worst_index
from machopt.verification.tables.csv_columns import ColumnTable, read_table
from machopt.verification.tables.exported_tables import find_lifted_samples, parse_moves

CHECK_VALUE_TOLERANCE = (
    1e-2  # of a check's limit: between two runs, and machines, a measured value moves by rounding only
)
LAST_DIGIT_MM, LAST_DIGIT_N_MM = 1e-7, 1e-4  # of deflection and stiffness in points.csv
RELATIVE_TOLERANCE = 1e-9  # relative: sums and ratios of figures that stand in the same file


@dataclass(frozen=True, kw_only=True)
class ResultComparison:
    """Content of result.json, and the data that it is compared with."""

    result: OptimizeDocument
    folder: Path
    cell: Cell
    toolpath: Toolpath
    options: PlanOptions
    inputs: tuple[ManifestFile, ...]  # as recorded, where there is a manifest
    manifest: FolderManifest | None
    contents: Verification | None  # None where there is no motion

    @cached_property
    def motion(self) -> ColumnTable:
        """trajectory.csv, read on first use, because a table that cannot be read fails that part only."""
        return read_table(self.folder / "trajectory.csv")

    @cached_property
    def lift_starts(self) -> tuple[int, ...]:
        """First row of each link of a re-entry in trajectory.csv."""
        lifted = find_lifted_samples(self.motion.read_numbers("point", empty=True), parse_moves(self.motion))
        return tuple(np.flatnonzero(lifted & ~np.r_[False, lifted[:-1]]).tolist())

    @cached_property
    def points(self) -> ColumnTable:
        """points.csv."""
        return read_table(self.folder / "points.csv")

    @cached_property
    def segments(self) -> tuple[tuple[ToolSegment, ...], PlanOptions]:
        """Segments of the job with the recomputed force of each point, and options that know of it."""
        found = split_into_tool_segments(self.cell, self.toolpath)
        return attach_recomputed_forces(found, self.toolpath, self.options, self.folder)

    @cached_property
    def worst_along_cuts(self) -> tuple[float, ...]:
        """Worst index along the cuts of each tool, between points too, by the verifier's laws, SI.

        NaN where it is not known: no motion, points left out of it, or a law without second implementation.
        """
        segments, options = self.segments
        unknown = (math.nan,) * len(segments)
        lacks = self.contents is None or any(c.check_name == CheckName.CHANGES for c in self.contents.failed)
        if lacks or not CheckedPoints.from_file(self).is_ok.all():
            return unknown
        tables = read_tables(segments[0].cell, self.folder)
        if isinstance(tables, Verification):
            return unknown
        parts = [tables] if len(segments) == 1 else split_tables(tables, segments)
        try:
            return tuple(
                find_worst_index(s.cell, s.toolpath, part.motion, self.result.index, s.restrict_options(options))
                for s, part in zip(segments, parts, strict=True)
            )
        except UnknownTermError:
            return unknown


@dataclass(frozen=True)
class CheckedPoints:
    """points.csv, of as many rows as the toolpath has."""

    table: ColumnTable

    @classmethod
    def from_file(cls, t: ResultComparison) -> CheckedPoints:
        """Return points.csv of a comparison.

        Args:
            t: Result.json and everything that it is compared with.

        Raises:
            ValueError: the table has another number of rows than the toolpath.
        """
        rows = len(t.points.read_words("status"))
        if rows != len(t.toolpath):
            raise ValueError(f"points.csv has {rows} rows, the toolpath {len(t.toolpath)} points")
        return cls(t.points)

    @property
    def is_ok(self) -> NDArray[np.bool_]:
        """(N,) the point has a configuration."""
        return np.array([status == "ok" for status in self.table.read_words("status")])

    def get_column(self, name: str) -> Array:
        """Return the (N,) values of a column, NaN in empty fields.

        Args:
            name: Name of the column.

        Raises:
            ValueError: there is no such column.
        """
        if name not in self.table:
            raise ValueError(f"points.csv lacks the column {name}")
        return self.table.read_numbers(name, empty=True)

    def compute_cost(self, t: ResultComparison) -> Array:
        """Return the (N,) cost at the points that are cut to, SI, less is better; NaN elsewhere.

        Args:
            t: Result.json and everything that it is compared with.
        """
        counts = t.toolpath.cutting & self.is_ok
        index = t.result.index
        if index == "deflection":
            out = 1e-3 * self.get_column("deflection_mm")
        elif index == "jiao2022":
            out = 1e-3 / self.get_column("k_jiao_x_N_mm")
        else:
            axial, normal = 1e-3 / self.get_column("k_axial_N_mm"), 1e-3 / self.get_column("k_normal_N_mm")
            drilling = np.array([o.kind == "point" for o in t.toolpath.operations])[t.toolpath.operation]
            out = np.where(drilling, axial, 0.5 * (axial + normal))
        return np.where(counts, out, np.nan)

    def cost_rounding(self, t: ResultComparison) -> Array:
        """Return the (N,) largest rounding error of :meth:`compute_cost` in SI, from half of the last digit in
        points.csv.

        Args:
            t: Result.json and everything that it is compared with.
        """
        if t.result.index == "deflection":
            return np.full(len(t.toolpath), 0.5e-3 * LAST_DIGIT_MM)
        names = ("k_jiao_x_N_mm",) if t.result.index == "jiao2022" else ("k_axial_N_mm", "k_normal_N_mm")
        softest = np.min([self.get_column(name) for name in names], axis=0)
        return np.asarray(1e-3 * 0.5 * LAST_DIGIT_N_MM / softest**2)


def is_output_file(t: ResultComparison, name: str) -> bool:
    """Return whether a file of that name lies in the output folder.

    Args:
        t: Result.json and everything that it is compared with.
        name: Name of the file, relative to the folder.
    """
    return name in list_folder_files(t.folder) and (t.folder / name).is_file()


def check_equal(name: str, found: object, expected: object) -> Iterable[str]:
    """Yield a message if two values differ.

    Args:
        name: Key in result.json.
        found: The value found.
        expected: The recomputed value.
    """
    found, expected = _convert_tuples(found), _convert_tuples(expected)
    if found != expected or isinstance(found, bool) != isinstance(expected, bool):
        yield f"{name} is {format_json_value(found)}, {format_json_value(expected)} follows"


def _convert_tuples(value: object) -> object:
    """A result's tuples as JSON has them."""
    return list(value) if isinstance(value, tuple) else value


def check_same_items(name: str, found: Mapping[str, object], expected: Mapping[str, object]) -> Iterable[str]:
    """Yield a message for each key whose values differ.

    Args:
        name: Key in result.json.
        found: Mapping in result.json.
        expected: The recomputed mapping.
    """
    for key in sorted(found.keys() | expected.keys()):
        if key not in expected:
            yield f"{name}.{key} is {format_json_value(found[key])}, which is not expected here"
        elif key not in found:
            yield f"{name}.{key} is missing"
        else:
            yield from check_equal(f"{name}.{key}", found[key], expected[key])


def check_close(
    name: str, found: float | None, expected: float | None, relative: float, absolute: float
) -> Iterable[str]:
    """Yield a message if two numbers differ by more than the tolerance. None means a number that is not finite.

    Args:
        name: Key in result.json.
        found: Number in result.json.
        expected: The recomputed number.
        relative: Tolerance as a share of the expected number.
        absolute: Tolerance in the unit of the number.
    """
    if expected is None or not math.isfinite(expected):
        yield from check_equal(name, found, None)
    elif found is None or not abs(found - expected) <= relative * abs(expected) + absolute:
        yield f"{name} is {format_json_value(found)}, {format_json_value(expected)} follows"


def require_number(name: str, value: float | None) -> float:
    """Return a number that must not be null.

    Args:
        name: Key in result.json.
        value: The number.

    Raises:
        ValueError: it is null.
    """
    if value is None:
        raise ValueError(f"{name} is null")
    return value


def format_json_value(value: object) -> str:
    """Return a value as JSON text: null, true, "done".

    Args:
        value: The value.
    """
    if isinstance(value, DocumentModel):
        value = value.to_json_types()
    if isinstance(value, float | np.floating):
        return f"{value:.12g}" if math.isfinite(value) else "null"
    text = json.dumps(value, ensure_ascii=False, default=_convert_to_json)
    return text if len(text) <= 80 else text[:77] + "…"


def _convert_to_json(value: Any) -> object:
    """What json does not know: rows of the manifest, numbers and arrays of numpy, paths, sets."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return sorted(map(str, value)) if isinstance(value, set | frozenset) else str(value)
