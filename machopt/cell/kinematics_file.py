"""Reader and writer of kinematics.yaml: unloaded TCP errors, compensated in the exported joints.

::

    machopt_kinematics: 1
    corrections:
      - {effect: joint_zero_offset, location: "joint:3", parameters: {offset_deg: 0.02}}
      - {effect: transmission_error, location: "joint:1",
         parameters: {per_turn: 3, cos_arcsec: 8.1, sin_arcsec: -2.5, range_deg: [-90, 75]}}
      - {effect: kinematic_correction, location: "joint:3",
         parameters: {orders: [1, 2], cos_arcsec: [40.1, 3.2], sin_arcsec: [8, -7.5], range_deg: [-90, 75]}}
      - {effect: joint_coupling, location: "joint:4-5", parameters: {ratio: 2.5e-5}}
      - {effect: geometry, location: "joint:2", parameters: {xyz_mm: [0.2, 0, -0.1], turn_mrad: [0, 0.3, 0]}}

The true angle of a joint is q + Δ(q), q what its encoder says. The joints of trajectory.csv, points.csv and of robot
programs are encoder angles: with this file those that bring the arm to the programmed path. A kinematic correction has
the form of a transmission error; its cause is not known. Both are applied at encoder angles of their ``range_deg``,
where they were measured, and fade out within 5 degrees beyond; without one everywhere. A geometry moves the joint's
frame in the link before it (``base``: the whole arm in base_link; ``tool``: what the flange carries): shifted, and
turned about its own origin, in axes of base_link with all joints at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.data_types.effect_locations import MOST_JOINTS, parse_joint_location
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.effects import measured_angle_range, parameter_conversion, registry
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import JointAngleLaw, LawParameter
from machopt.effects.structure import as_built_joint_frames
from machopt.errors import suggest_nearest_word
from machopt.file_formats.strict_yaml import (
    KeyPath,
    StrictSchema,
    YamlDocument,
    format_found_value,
    read_yaml,
    validate_document,
)
from machopt.numerics.array_types import Array

_MOST_DEG = 3600.0
_STEEPEST = 0.5  # |Δ'|: beyond it encoder and true angle are hardly one to one, and the file is in another unit


def list_required_parameters() -> Mapping[str, tuple[str, ...]]:
    """The keys that every effect in use needs, by its word; of a geometry those it may have."""
    angles = {
        word: tuple(p.key for p in (*law.shape, *law.coefficients))
        for word, (_, law) in registry.list_angle_effects_by_word().items()
    }
    return angles | {as_built_joint_frames.EFFECT.name: (as_built_joint_frames.SHIFT, as_built_joint_frames.TURN)}


def list_optional_parameters(effect: str) -> tuple[str, ...]:
    """List the optional keys of an effect.

    Args:
        effect: Name of the effect.

    Returns:
        The keys.
    """
    _, law = registry.list_angle_effects_by_word().get(effect, (None, None))
    return (measured_angle_range.RANGE_KEY,) if law is not None and law.has_angle_range else ()


class _CorrectionKeys(StrictSchema):
    effect: str = Field(min_length=1, description=", ".join(list_required_parameters()))
    location: str = Field(
        min_length=1, description="joint:1 to the last joint, joint:4-5 of a coupling, base or tool of a geometry"
    )
    parameters: dict[str, Any] = Field(description="numbers (of a geometry vectors) with their unit in the name")


class _KinematicsFileKeys(StrictSchema):
    machopt_kinematics: Literal[1] = Field(description="the format, 1")
    corrections: list[_CorrectionKeys] = Field(description="what the true joint angles differ by from the encoders")


def load_kinematics(path: Path | str) -> KinematicCorrections:
    """Read kinematics.yaml.

    Args:
        path: Path of the file.

    Returns:
        The corrections, SI units.

    Raises:
        InputError: names file, line and key, what was found and what was expected.
    """
    document = read_yaml(Path(path))
    data = validate_document(_KinematicsFileKeys, document)
    seen: set[tuple[str, str, str]] = set()
    out = []
    for n, c in enumerate(data.corrections):
        loc: KeyPath = ("corrections", n)
        _check_place(document, loc, c.effect, c.location)
        key = c.effect, c.location, str(c.parameters.get(measured_angle_range.RANGE_KEY, ""))
        if key in seen:
            raise document.build_error(
                loc,
                f"{c.effect} at {c.location} is given twice; keep one (waves of a transmission error stand in lists)",
            )
        seen.add(key)
        stated = _parse_parameters(document, (*loc, "parameters"), c)
        out.append(KinematicCorrection(c.effect, c.location, stated, _find_user_correction(c.effect, stated)))
    found = KinematicCorrections(tuple(out), Path(path))
    for joint, slope in enumerate(_compute_largest_slopes(found), start=1):
        if slope >= _STEEPEST:
            raise document.build_error(
                ("corrections",),
                f"the corrections of joint {joint} change by up to {slope:.2g} rad per rad, less than {_STEEPEST:g} "
                "would work (per_turn × amplitude, and ratios, add up)",
            )
    return found


def write_kinematics(path: Path | str, kinematics: KinematicCorrections) -> None:
    """Write kinematics.yaml so that :func:`load_kinematics` returns the same numbers.

    Args:
        path: Path of the file.
        kinematics: The corrections, SI units.
    """
    lines = ["machopt_kinematics: 1", "corrections:" if kinematics else "corrections: []"]
    for c in kinematics.corrections:
        inner = ", ".join(f"{key}: {_format_number(value)}" for key, value in c.parameters.items())
        lines.append(f'  - {{effect: {c.effect}, location: "{c.location}", parameters: {{{inner}}}}}')
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _check_place(document: YamlDocument, loc: KeyPath, effect: str, location: str) -> None:
    known = list(list_required_parameters())
    if effect not in known:
        raise document.build_error(
            (*loc, "effect"),
            f"found {effect!r}; {suggest_nearest_word(effect, known)} (what is elastic belongs into "
            f"stiffness.yaml; an effect of "
            "your own is known where its file is given)",
        )
    places = (
        registry.EFFECTS[effect].places if effect == as_built_joint_frames.EFFECT.name else _list_allowed_places(effect)
    )
    if location not in places:
        wanted = "joint:i-j, i < j, e.g. joint:4-5" if "-" in places[0] else f"{places[0]} … {places[-1]}"
        raise document.build_error((*loc, "location"), f"found {location!r}; expected {wanted}")


def _find_user_correction(effect: str, stated: Mapping[str, Any]) -> Callable[[Array], Array] | None:
    """Δ of an effect of the user's own by the angle of its joint; None of those that the verifier has laws of."""
    of, law = registry.list_angle_effects_by_word().get(effect, (None, None))
    if law is None or of in registry.ALL_EFFECTS:
        return None
    values, shape, _ = parameter_conversion.read_law_parameters(law, ParameterReader(stated, effect))
    return lambda angle: np.asarray(law.columns(shape, angle) @ values)


def _list_allowed_places(effect: str) -> tuple[str, ...]:
    return registry.list_angle_effects_by_word()[effect][0].places


def _parse_frame_vectors(document: YamlDocument, loc: KeyPath, c: _CorrectionKeys) -> Mapping[str, Any]:
    """Shift and turn of a frame: three numbers each, at least one of the two."""
    if not c.parameters:
        raise document.build_error(
            loc, f"{c.effect} needs {as_built_joint_frames.SHIFT} or {as_built_joint_frames.TURN}, three numbers each"
        )
    for key, value in c.parameters.items():
        most, unit = (
            (as_built_joint_frames.MOST_MM, "mm")
            if key == as_built_joint_frames.SHIFT
            else (as_built_joint_frames.MOST_MRAD, "mrad")
        )
        wanted = list_required_parameters()[c.effect]
        if key not in wanted:
            raise document.build_error((*loc, key), f"unknown key {key!r}; {suggest_nearest_word(key, list(wanted))}")
        if not isinstance(value, list) or len(value) != 3:
            raise document.build_error(
                (*loc, key), f"found {format_found_value(value)}; expected three numbers in {unit}"
            )
        for n, v in enumerate(value):
            if isinstance(v, bool) or not isinstance(v, int | float) or not abs(v) <= most:
                raise document.build_error(
                    (*loc, key, n),
                    f"found {format_found_value(v)}; expected a number, at most {most:g} {unit} to either side",
                )
    return dict(c.parameters)


def _parse_parameters(document: YamlDocument, loc: KeyPath, c: _CorrectionKeys) -> Mapping[str, Any]:
    if c.effect == as_built_joint_frames.EFFECT.name:
        return _parse_frame_vectors(document, loc, c)
    law = registry.list_angle_effects_by_word()[c.effect][1]
    wanted, more = list_required_parameters()[c.effect], list_optional_parameters(c.effect)
    for key in c.parameters:
        if key not in (*wanted, *more):
            raise document.build_error(
                (*loc, key), f"unknown key {key!r}; {suggest_nearest_word(key, [*wanted, *more])}"
            )
    if measured_angle_range.RANGE_KEY in c.parameters:
        _check_range(document, (*loc, measured_angle_range.RANGE_KEY), c.parameters[measured_angle_range.RANGE_KEY])
    for key in wanted:
        if key not in c.parameters:
            raise document.build_error(loc, f"{key} is missing; {c.effect} needs {', '.join(wanted)}")
    lengths = set()
    for p in (*law.shape, *law.coefficients):
        value = c.parameters[p.key]
        if isinstance(value, list) and p.is_list:
            lengths.add(len(value))
            if not value:
                raise document.build_error((*loc, p.key), "found an empty list; expected at least one number")
            for n, v in enumerate(value):
                _check_number(document, (*loc, p.key, n), p, v)
        else:
            lengths.add(-1)
            _check_number(document, (*loc, p.key), p, value)
    if len(lengths) > 1:
        raise document.build_error(
            loc, f"{', '.join(wanted)} differ in length; expected three numbers, or three lists of the same length"
        )
    for p in law.shape:  # the only number of a form: which branch it is
        values = c.parameters[p.key]
        if isinstance(values, list) and len(set(values)) < len(values):
            raise document.build_error((*loc, p.key), f"found {format_found_value(values)}; each order once")
    return dict(c.parameters)


def _check_range(document: YamlDocument, loc: KeyPath, value: object) -> None:
    numbers = value if isinstance(value, list) else []
    right = [v for v in numbers if isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= _MOST_DEG]
    if len(numbers) != 2 or len(right) != 2 or not right[0] < right[1]:
        raise document.build_error(
            loc,
            f"found {format_found_value(value)}; expected two encoder angles in degrees, the lower first, e.g. "
            f"[-90, 75]",
        )


def _check_number(document: YamlDocument, loc: KeyPath, p: LawParameter, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise document.build_error(loc, f"found {format_found_value(value)}; expected a number ({p.unit_in_words})")
    if p.positive and not 0.0 < value <= p.magnitude_limit:
        raise document.build_error(
            loc, f"found {value:g}; expected more than 0 and at most {p.magnitude_limit:g} {p.unit_in_words}"
        )
    if abs(value) > p.magnitude_limit:
        raise document.build_error(
            loc, f"found {value:g}; expected at most {p.magnitude_limit:g} {p.unit_in_words} to either side"
        )


def _compute_largest_slopes(kinematics: KinematicCorrections) -> list[float]:
    """(n,) most that Δ of each joint can change per rad of any joints."""
    slope = [0.0] * MOST_JOINTS
    for c in kinematics.corrections:
        if c.effect == as_built_joint_frames.EFFECT.name:
            continue
        law: JointAngleLaw = registry.list_angle_effects_by_word()[c.effect][1]
        values, shape, _ = parameter_conversion.read_law_parameters(law, ParameterReader(c.parameters, c.effect))
        at = parse_joint_location(c.location)[1]
        slope[at] += law.compute_max_slope(values, shape)
        if measured_angle_range.read_angle_range(c.parameters) is not None:  # all of it fades out
            slope[at] += (
                measured_angle_range.STEEPEST * law.compute_max_error(values, shape) / measured_angle_range.FADE
            )
    return slope


def _format_number(value: Any) -> str:
    """Shortest exact decimal; ``1.0e-07`` and not ``1e-07``, which YAML 1.1 readers take for text."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(_format_number(v) for v in value)}]"
    text = repr(float(value)) if not isinstance(value, int) else repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
