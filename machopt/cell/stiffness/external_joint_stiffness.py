"""Block ``external_joints`` of stiffness.yaml: stiffness and masses of rails, gantries and positioners."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import Field

from machopt.data_types.stiffness import SOFTEST, STIFFEST, ExternalJointSpring
from machopt.errors import CellError
from machopt.file_formats.strict_yaml import KeyPath, StrictSchema, YamlDocument, format_found_value
from machopt.numerics.array_types import Array

_SOFT, _STIFF = 10.0, 1e9  # N/mm of a joint that slides; beyond these it is another unit
_LARGEST = (1e-3 / _SOFT, 1.0 / SOFTEST)  # m/N and rad/(N·m) of a body
_EVEN, _NEGATIVE = 1e-6, 1e-9  # relative: as printed with seven digits; round-off
_UNITS = "m/N for x, y, z and rad/(N·m) about them"


class ExternalJointStiffnessKeys(StrictSchema):
    """One external joint and the body (the URDF's link) that it moves."""

    stiffness_Nm_per_rad: float | None = Field(default=None, gt=0, description="of a joint that turns; none: rigid")
    stiffness_N_mm: float | None = Field(default=None, gt=0, description="N/mm, of a joint that slides; none: rigid")
    std_Nm_per_rad: float | None = Field(default=None, gt=0, description="1 σ of it; none: it counts as exact")
    std_N_mm: float | None = Field(default=None, gt=0, description="N/mm, 1 σ of it; none: it counts as exact")
    compliance_diagonal: list[float] | None = Field(
        default=None, min_length=6, max_length=6, description=f"of the body (carriage, table), at at_mm: {_UNITS}"
    )
    compliance: list[list[float]] | None = Field(
        default=None, min_length=6, max_length=6, description="the same as a symmetric 6×6 matrix, SI units"
    )
    at_mm: list[float] = Field(
        default=[0.0, 0.0, 0.0], min_length=3, max_length=3, description="place of the compliance, in its link's frame"
    )
    mass_kg: float = Field(
        default=0.0, ge=0, description="the body and what is bolted to it (the part too), without the robot"
    )
    com_mm: list[float] = Field(
        default=[0.0, 0.0, 0.0], min_length=3, max_length=3, description="its centre of mass, in its link's frame"
    )


def parse_external_springs(
    document: YamlDocument, given: dict[str, ExternalJointStiffnessKeys]
) -> tuple[ExternalJointSpring, ...]:
    """Convert the block ``external_joints`` to SI, in the order of the file.

    Args:
        document: Parsed YAML file, with the line of each key for errors.
        given: Joint name → validated keys.

    Returns:
        The springs.

    Raises:
        InputError: two stiffness values, a wrong unit, a negative stiffness, a joint without values.
    """
    return tuple(_parse_spring(document, ("external_joints", joint), joint, keys) for joint, keys in given.items())


def _parse_spring(
    document: YamlDocument, loc: KeyPath, joint: str, keys: ExternalJointStiffnessKeys
) -> ExternalJointSpring:
    turns, slides = keys.stiffness_Nm_per_rad, keys.stiffness_N_mm
    if turns is not None and slides is not None:
        raise document.build_error(
            loc, "found stiffness_Nm_per_rad and stiffness_N_mm; one of them, as the joint moves"
        )
    stiffness = np.inf
    if turns is not None:
        _check_range(document, (*loc, "stiffness_Nm_per_rad"), turns, SOFTEST, STIFFEST, "N·m/rad")
        stiffness = turns
    if slides is not None:
        _check_range(document, (*loc, "stiffness_N_mm"), slides, _SOFT, _STIFF, "N/mm")
        stiffness = 1e3 * slides
    std = _parse_std(document, loc, keys)
    if keys.compliance is not None and keys.compliance_diagonal is not None:
        raise document.build_error(loc, "found compliance and compliance_diagonal; one of them is enough")
    if keys.mass_kg == 0.0 and any(keys.com_mm):
        raise document.build_error((*loc, "com_mm"), "has no mass; add mass_kg")
    C = _parse_compliance(document, loc, keys)
    if not np.isfinite(stiffness) and not C.any() and keys.mass_kg == 0.0:
        raise document.build_error(
            loc,
            "is empty; stiffness_Nm_per_rad or stiffness_N_mm, compliance_diagonal or mass_kg would (a joint that "
            "is left out is rigid)",
        )
    com = np.array(keys.com_mm) / 1e3
    kind = None if turns is None and slides is None else slides is not None
    return ExternalJointSpring(
        joint=joint,
        stiffness=float(stiffness),
        slides=kind,
        compliance=C,
        at=np.array(keys.at_mm) / 1e3,
        mass=keys.mass_kg,
        com=com,
        std=std,
    )


def _parse_std(document: YamlDocument, loc: KeyPath, keys: ExternalJointStiffnessKeys) -> float:
    """1 σ of the stiffness in its unit, 0 where none is stated."""
    for name, std, value, unit in (
        ("std_Nm_per_rad", keys.std_Nm_per_rad, keys.stiffness_Nm_per_rad, 1.0),
        ("std_N_mm", keys.std_N_mm, keys.stiffness_N_mm, 1e3),
    ):
        if std is None:
            continue
        if value is None:
            raise document.build_error((*loc, name), f"has no stiffness; add {name.replace('std', 'stiffness')}")
        if std >= value:
            raise document.build_error(
                (*loc, name),
                f"found {format_found_value(std)}; expected less than the stiffness, {format_found_value(value)}",
            )
        return unit * std
    return 0.0


def _check_range(document: YamlDocument, loc: KeyPath, value: float, least: float, most: float, unit: str) -> None:
    if not least <= value <= most:
        raise document.build_error(
            loc, f"found {format_found_value(value)}; expected {unit} between {least:g} and {most:g}"
        )


def _parse_compliance(document: YamlDocument, loc: KeyPath, keys: ExternalJointStiffnessKeys) -> Array:
    if keys.compliance is None:
        key, C = "compliance_diagonal", np.diag(keys.compliance_diagonal or [0.0] * 6)
    else:
        key = "compliance"
        for n, row in enumerate(keys.compliance):
            if len(row) != 6:
                raise document.build_error((*loc, key, n), f"found {len(row)} values; expected 6")
        C = np.array(keys.compliance, float)
    where: KeyPath = (*loc, key)
    if np.abs(C - C.T).max() > _EVEN * np.abs(C).max():
        raise document.build_error(where, "is not symmetric; a compliance is")
    C = 0.5 * (C + C.T)
    diagonal = np.diag(C)
    if (diagonal < 0).any():
        raise document.build_error(
            where, f"found {format_found_value(float(diagonal.min()))}; a compliance is at least zero"
        )
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    if np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -_NEGATIVE:
        raise document.build_error(where, "deflects against the load in some direction (a negative eigenvalue)")
    for rows, most, unit in ((slice(0, 3), _LARGEST[0], "m/N"), (slice(3, 6), _LARGEST[1], "rad/(N·m)")):
        if diagonal[rows].max() > most:
            raise document.build_error(
                where, f"found {format_found_value(float(diagonal[rows].max()))}; expected {unit} of at most {most:g}"
            )
    return np.asarray(C)


def format_external_springs(springs: tuple[ExternalJointSpring, ...]) -> dict[str, dict[str, object]]:
    """Convert springs to the block of the file.

    Args:
        springs: The springs, SI units.

    Returns:
        Joint name → keys and values.
    """
    out: dict[str, dict[str, object]] = {}
    for s in springs:
        own: dict[str, object] = {}
        if np.isfinite(s.stiffness):
            own["stiffness_N_mm" if s.slides else "stiffness_Nm_per_rad"] = float(
                s.stiffness / (1e3 if s.slides else 1)
            )
        if s.std:
            own["std_N_mm" if s.slides else "std_Nm_per_rad"] = float(s.std / (1e3 if s.slides else 1))
        if np.array_equal(s.compliance, np.diag(np.diag(s.compliance))):
            if s.compliance.any():
                own["compliance_diagonal"] = np.diag(s.compliance).tolist()
        else:
            own["compliance"] = s.compliance.tolist()
        if s.at.any():
            own["at_mm"] = [float(v) for v in 1e3 * s.at]
        if s.mass > 0.0:
            own["mass_kg"] = float(s.mass)
            if s.com is not None and s.com.any():
                own["com_mm"] = [float(v) for v in 1e3 * s.com]
        out[s.joint] = own
    return out


def match_springs_to_joints(
    springs: tuple[ExternalJointSpring, ...], joints: tuple[str, ...], slides: tuple[bool, ...], file: Path | None
) -> tuple[ExternalJointSpring, ...]:
    """The springs by the names of the cell's external joints, for which e1, e2 … are aliases.

    Args:
        joints: the cell's external joints, with whether each slides.

    Raises:
        InputError: a joint that the cell has not, that moves otherwise than its stiffness says, or is named twice.
    """
    short, out = {f"e{n + 1}": name for n, name in enumerate(joints)}, dict[str, ExternalJointSpring]()
    for s in springs:
        where = f"external_joints.{s.joint}"
        name = s.joint if s.joint in joints else short.get(s.joint, s.joint)
        if name not in joints:
            known = f"those of the cell are {', '.join(joints)}" if joints else "the cell has none"
            raise CellError(f"{s.joint!r} is no external joint of the cell; {known}", file=file, where=where)
        if name in out:
            raise CellError(f"joint {name!r} is named twice; one entry a joint would work", file=file, where=where)
        own = slides[joints.index(name)]
        if s.slides is not None and s.slides != own:
            moves, key = ("slides", "stiffness_N_mm") if own else ("turns", "stiffness_Nm_per_rad")
            raise CellError(f"joint {name!r} {moves}; {key} would work", file=file, where=where)
        out[name] = replace(s, joint=name)
    return tuple(out.values())
