"""Reader and writer of stiffness.yaml: joint stiffness, covariance, workspace grid, terms found by diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.cell.stiffness.external_joint_stiffness import (
    ExternalJointStiffnessKeys,
    format_external_springs,
    parse_external_springs,
)
from machopt.data_types.effect_locations import MOST_JOINTS
from machopt.data_types.stiffness import (
    SOFTEST,
    STIFFEST,
    ArmStiffness,
    ModelDiscrepancy,
    PositionError,
    StiffnessGrid,
    StiffnessTerm,
)
from machopt.file_formats.strict_yaml import (
    KeyPath,
    StrictSchema,
    YamlDocument,
    format_found_value,
    read_yaml,
    validate_document,
)
from machopt.file_formats.yaml_rows import format_yaml
from machopt.numerics.array_types import Array

_ROW = "one stiffness per joint of the arm in N·m/rad, joint 1 first"
_ASYMMETRY = 1e-6  # relative; a covariance written with seven digits is symmetric to this
_NEGATIVE = 1e-9  # relative to the largest eigenvalue; round-off of a rank-deficient covariance


class _TermKeys(StrictSchema):
    effect: str = Field(min_length=1, description="e.g. link_compliance, joint_backlash; diagnose writes them")
    location: str = Field(min_length=1, description="e.g. joint:2, link:3, base, tool")
    parameters: dict[str, Any] = Field(default={}, description="numbers with their unit in the name")
    covariance: list[list[float]] | None = Field(
        default=None, description="of its numbers in the order of parameters, in their units"
    )


class _GridKeys(StrictSchema):
    origin_mm: list[float] = Field(min_length=3, max_length=3, description="x, y, z of the lowest corner in base_link")
    cell_mm: float = Field(gt=0, description="edge length of a cell")
    shape: list[int] = Field(min_length=3, max_length=3, description="cells along x, y, z")
    joints_Nm_per_rad: list[list[float]] = Field(min_length=1, description=f"one row a cell, x fastest, each {_ROW}")
    std_Nm_per_rad: list[list[float]] | None = Field(
        default=None, min_length=1, description="1 sigma of the rows above"
    )


class _DiscrepancyKeys(StrictSchema):
    left_mm: float = Field(ge=0, description="what the model left of the readings, a coordinate")
    noise_mm: float = Field(ge=0, description="what replicates make of it")
    misfit: bool = Field(description="true: the readings show that something is missing")
    local_m_per_N: float = Field(default=0.0, ge=0, description="1 sigma of a compliance that is one pose's own")
    counted: bool = Field(
        default=True, description="predictions count shift in; false: they are of the file's own numbers, which are off"
    )
    torques_Nm: list[float] = Field(
        min_length=6, max_length=MOST_JOINTS, description="the joints' typical torque in the tests"
    )
    parts: list[str] = Field(min_length=1, description="what may be otherwise, or be missing: joint 1, base rz, …")
    shift: list[float] = Field(min_length=1, description="by how much, in the mean; SI, one number a part")
    modes: list[list[float]] = Field(min_length=1, description="rows whose Σ mᵀm is the covariance about that; SI")


class _PositionErrorKeys(StrictSchema):
    std_mm: float = Field(ge=0, description="1 sigma of a coordinate on poses that no fit saw, kinematics.yaml in use")
    plain_mm: float = Field(ge=0, description="the same without the corrections that were found with it")
    noise_mm: float = Field(ge=0, description="of it, what the instrument and the arm's return make")
    poses: int = Field(ge=1, description="that were measured")
    joints_deg: list[list[float]] = Field(
        min_length=6,
        max_length=MOST_JOINTS,
        description="one row a joint: the lowest and the highest encoder angle measured",
    )


class _StiffnessFileKeys(StrictSchema):
    machopt_stiffness: Literal[1] = Field(description="the format, 1")
    joints_Nm_per_rad: list[float] = Field(min_length=6, max_length=MOST_JOINTS, description=_ROW)
    covariance: list[list[float]] | None = Field(
        default=None,
        min_length=6,
        max_length=MOST_JOINTS,
        description="of the joint compliances, a square of one row a joint, (rad/(N·m))²",
    )
    grid: _GridKeys | None = Field(default=None, description="stiffness that differs over the workspace")
    terms: list[_TermKeys] = Field(default=[], description="further physics, the terms that diagnose finds")
    discrepancy: _DiscrepancyKeys | None = Field(
        default=None, description="how far the arm may be from this file; identify and diagnose write it"
    )
    position_error: _PositionErrorKeys | None = Field(
        default=None, description="how far the TCP is from the model by measured poses; diagnose of poses writes it"
    )
    external_joints: dict[str, ExternalJointStiffnessKeys] = Field(
        default={}, description="of rails and positioners, by the joint's name; one that is left out is rigid"
    )
    spread_percent: float | None = Field(
        default=None, gt=0, description="1 sigma of every spring, where no covariance is known; with source"
    )
    source: str | None = Field(default=None, min_length=1, description="where the numbers come from")
    estimated: bool = Field(
        default=False, description="true: by a rule (machopt init writes such), from no measurement of this arm"
    )


def load_stiffness(path: Path | str) -> ArmStiffness:
    """Read stiffness.yaml.

    Args:
        path: Path of the file.

    Returns:
        The stiffness, SI units.

    Raises:
        InputError: names file, key, what was found and what was expected.
    """
    document = read_yaml(Path(path))
    data = validate_document(_StiffnessFileKeys, document)
    joints = _parse_positive(document, ("joints_Nm_per_rad",), data.joints_Nm_per_rad)
    covariance = None if data.covariance is None else _parse_covariance(document, data.covariance, len(joints))
    grid = None if data.grid is None else _parse_grid(document, data.grid, len(joints))
    terms = tuple(
        StiffnessTerm(
            t.effect,
            t.location,
            t.parameters,
            None if t.covariance is None else _parse_term_covariance(document, n, t.covariance),
        )
        for n, t in enumerate(data.terms)
    )
    if data.spread_percent is not None and data.source is None:
        raise document.build_error(("spread_percent",), "needs a source: where the spread comes from, or `assumed`")
    doubt = None if data.discrepancy is None else _parse_discrepancy(document, data.discrepancy, len(joints))
    external = parse_external_springs(document, data.external_joints)
    known = covariance is not None or doubt is not None or (grid is not None and grid.std is not None)
    for s in external:
        if s.std and not known:
            raise document.build_error(
                ("external_joints", s.joint),
                "gives an uncertainty for its stiffness, but the file gives none for the arm, and no interval follows "
                "from "
                "one alone; covariance (or discrepancy, or the grid's std_Nm_per_rad) beside it would work",
            )
    position = (
        None if data.position_error is None else _parse_position_error(document, data.position_error, len(joints))
    )
    return ArmStiffness(
        joints=joints,
        covariance=covariance,
        grid=grid,
        terms=terms,
        file=Path(path),
        estimated=data.estimated,
        discrepancy=doubt,
        external=external,
        position=position,
        spread=None if data.spread_percent is None else float(np.log1p(data.spread_percent / 100.0)),
        source=data.source or "",
    )


def write_stiffness(path: Path | str, stiffness: ArmStiffness) -> None:
    """Write stiffness.yaml so that :func:`load_stiffness` returns the same numbers (mm ↔ m to the last bit but one).

    Args:
        path: Path of the file.
        stiffness: The stiffness, SI units.
    """
    data: dict[str, object] = {"machopt_stiffness": 1, "joints_Nm_per_rad": _convert_to_rows(stiffness.joints)}
    if stiffness.covariance is not None:
        data["covariance"] = _convert_to_rows(stiffness.covariance)
    if stiffness.estimated:
        data["estimated"] = True
    if stiffness.spread is not None:
        data["spread_percent"] = float(f"{100.0 * np.expm1(stiffness.spread):.6g}")
    if stiffness.source:
        data["source"] = stiffness.source
    if stiffness.grid is not None:
        grid = stiffness.grid
        data["grid"] = {
            "origin_mm": [float(v) for v in grid.origin * 1e3],
            "cell_mm": float(grid.cell * 1e3),
            "shape": [int(n) for n in grid.shape],
            "joints_Nm_per_rad": _convert_to_rows(grid.joints),
        }
        if grid.std is not None:
            data["grid"]["std_Nm_per_rad"] = _convert_to_rows(grid.std)  # type: ignore[index]
    if stiffness.terms:
        data["terms"] = [
            {"effect": t.effect, "location": t.location, "parameters": _convert_to_plain_yaml(t.parameters)}
            | ({} if t.covariance is None else {"covariance": [list(row) for row in t.covariance]})
            for t in stiffness.terms
        ]
    if stiffness.external:
        data["external_joints"] = format_external_springs(stiffness.external)
    if stiffness.discrepancy is not None:
        data["discrepancy"] = _format_discrepancy(stiffness.discrepancy)
    if stiffness.position is not None:
        data["position_error"] = _format_position_error(stiffness.position)
    with Path(path).open("w", encoding="utf-8", newline="\n") as out:
        out.write(format_yaml(data))


def _format_discrepancy(d: ModelDiscrepancy) -> dict[str, object]:
    """The block ``discrepancy``; five digits are more than an uncertainty has."""

    def short(values: Array) -> list[float]:
        return [float(f"{v:.5g}") for v in values]

    return {
        "left_mm": float(f"{1e3 * d.left:.5g}"),
        "noise_mm": float(f"{1e3 * d.noise:.5g}"),
        "misfit": d.misfit,
        "local_m_per_N": float(f"{d.local:.5g}"),
        "counted": d.counted,
        "torques_Nm": short(d.torque),
        "parts": list(d.parts),
        "shift": short(d.shift),
        "modes": [short(row) for row in d.modes],
    }


def _format_position_error(p: PositionError) -> dict[str, object]:
    """The block ``position_error``."""
    mm = {"std_mm": p.std, "plain_mm": p.plain, "noise_mm": p.noise}
    return {
        **{key: float(f"{1e3 * v:.5g}") for key, v in mm.items()},
        "poses": p.poses,
        "joints_deg": [[round(float(v), 4) for v in row] for row in np.degrees(p.joints)],
    }


def _parse_position_error(
    document: YamlDocument, position_error_keys: _PositionErrorKeys, joints: int
) -> PositionError:
    _check_row_count(document, ("position_error", "joints_deg"), len(position_error_keys.joints_deg), joints)
    for n, row in enumerate(position_error_keys.joints_deg):
        if len(row) != 2 or not row[0] <= row[1] or not np.isfinite(row).all():
            raise document.build_error(
                ("position_error", "joints_deg", n),
                f"found {row}; expected two angles in degrees, the lower first, e.g. [-90, 75]",
            )
    return PositionError(
        position_error_keys.std_mm / 1e3,
        position_error_keys.plain_mm / 1e3,
        position_error_keys.noise_mm / 1e3,
        position_error_keys.poses,
        np.radians(_copy_read_only(position_error_keys.joints_deg)),
    )


def _parse_discrepancy(document: YamlDocument, discrepancy_keys: _DiscrepancyKeys, joints: int) -> ModelDiscrepancy:
    _check_row_count(document, ("discrepancy", "torques_Nm"), len(discrepancy_keys.torques_Nm), joints)
    rows = {"shift": discrepancy_keys.shift} | {f"modes[{n}]": row for n, row in enumerate(discrepancy_keys.modes)}
    for name, row in rows.items():
        if len(row) != len(discrepancy_keys.parts):
            raise document.build_error(
                ("discrepancy", name),
                f"found {len(row)} numbers; expected {len(discrepancy_keys.parts)}, one for each of parts",
            )
        if not np.isfinite(row).all():
            raise document.build_error(("discrepancy", name), "holds a number that is not finite")
    if not min(discrepancy_keys.torques_Nm) > 0:
        raise document.build_error(
            ("discrepancy", "torques_Nm"), f"found {min(discrepancy_keys.torques_Nm):g}; expected more than zero"
        )
    return ModelDiscrepancy(
        parts=tuple(discrepancy_keys.parts),
        torque=_copy_read_only(discrepancy_keys.torques_Nm),
        shift=_copy_read_only(discrepancy_keys.shift),
        modes=_copy_read_only(discrepancy_keys.modes),
        left=discrepancy_keys.left_mm / 1e3,
        noise=discrepancy_keys.noise_mm / 1e3,
        misfit=discrepancy_keys.misfit,
        local=discrepancy_keys.local_m_per_N,
        counted=discrepancy_keys.counted,
    )


def _check_row_count(document: YamlDocument, loc: KeyPath, found: int, joints: int) -> None:
    """Raise InputError where something has not as many numbers or rows as joints_Nm_per_rad."""
    if found != joints:
        raise document.build_error(loc, f"found {found} values; expected {joints}, as joints_Nm_per_rad has")


def _parse_positive(document: YamlDocument, loc: KeyPath, values: list[float]) -> Array:
    for n, value in enumerate(values):
        if not SOFTEST <= value <= STIFFEST:
            raise document.build_error(
                (*loc, n), f"found {format_found_value(value)}; expected N·m/rad between {SOFTEST:g} and {STIFFEST:g}"
            )
    return _copy_read_only(values)


def _parse_covariance(document: YamlDocument, rows: list[list[float]], joints: int) -> Array:
    _check_row_count(document, ("covariance",), len(rows), joints)
    for n, row in enumerate(rows):
        _check_row_count(document, ("covariance", n), len(row), joints)
    matrix = np.asarray(rows, float)
    scale = float(np.abs(matrix).max())
    uneven = np.abs(matrix - matrix.T)
    if uneven.max() > _ASYMMETRY * scale:
        r, c = np.unravel_index(int(uneven.argmax()), uneven.shape)
        raise document.build_error(
            ("covariance", int(r)),
            f"is not symmetric: row {r + 1} column {c + 1} is {matrix[r, c]:g}, its mirror {matrix[c, r]:g}",
        )
    least = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())
    if least < -_NEGATIVE * scale:
        raise document.build_error(("covariance",), f"has the negative eigenvalue {least:g}; a covariance has none")
    return _copy_read_only(rows)


def _parse_term_covariance(document: YamlDocument, term: int, rows: list[list[float]]) -> tuple[tuple[float, ...], ...]:
    matrix = [[float(v) for v in row] for row in rows]
    if not matrix or any(len(row) != len(matrix) for row in matrix):
        raise document.build_error(("terms", term, "covariance"), "is not square; expected one row a number")
    array = np.array(matrix)
    if np.abs(array - array.T).max() > _ASYMMETRY * np.abs(array).max():
        raise document.build_error(("terms", term, "covariance"), "is not symmetric")
    if float(np.linalg.eigvalsh(array).min()) < -_NEGATIVE * np.abs(array).max():
        raise document.build_error(("terms", term, "covariance"), "has a negative eigenvalue; a covariance has none")
    return tuple(tuple(row) for row in matrix)


def _parse_grid(document: YamlDocument, grid: _GridKeys, joints: int) -> StiffnessGrid:
    for n, count in enumerate(grid.shape):
        if count < 1:
            raise document.build_error(("grid", "shape", n), f"found {count}; expected at least 1 cell")
    nx, ny, nz = grid.shape
    rows = _parse_grid_rows(document, "joints_Nm_per_rad", grid.joints_Nm_per_rad, grid.shape, joints)
    std = None
    if grid.std_Nm_per_rad is not None:
        std = _parse_grid_rows(document, "std_Nm_per_rad", grid.std_Nm_per_rad, grid.shape, joints)
    origin = _copy_read_only([v / 1e3 for v in grid.origin_mm])
    return StiffnessGrid(origin, grid.cell_mm / 1e3, (nx, ny, nz), rows, std)


def _parse_grid_rows(document: YamlDocument, key: str, rows: list[list[float]], shape: list[int], joints: int) -> Array:
    loc: KeyPath = ("grid", key)
    needed = shape[0] * shape[1] * shape[2]
    if len(rows) != needed:
        raise document.build_error(loc, f"found {len(rows)} rows; shape {shape} needs {needed}")
    for n, row in enumerate(rows):
        _check_row_count(document, (*loc, n), len(row), joints)
        if key.startswith("joints"):
            _parse_positive(document, (*loc, n), row)
        elif min(row) < 0:
            raise document.build_error(
                (*loc, n), f"found {format_found_value(min(row))}; a standard uncertainty is at least zero"
            )
    return _copy_read_only(rows)


def _copy_read_only(values: object) -> Array:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def _convert_to_rows(array: Array) -> list[Any]:
    return np.asarray(array, float).tolist()  # type: ignore[no-any-return]


def _convert_to_plain_yaml(value: object) -> object:
    """NumPy scalars and arrays inside a term as plain YAML values."""
    if isinstance(value, dict):
        return {str(k): _convert_to_plain_yaml(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_convert_to_plain_yaml(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value
