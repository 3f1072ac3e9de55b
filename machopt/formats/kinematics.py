"""kinematics.yaml: what moves the TCP without load, compensated in the exported joints.

::

    machopt_kinematics: 1
    corrections:
      - {effect: joint_zero_offset, location: "joint:3", parameters: {offset_deg: 0.02}}
      - {effect: transmission_error, location: "joint:1",
         parameters: {per_turn: 3, cos_arcsec: 8.1, sin_arcsec: -2.5, range_deg: [-90, 75]}}
      - {effect: joint_coupling, location: "joint:4-5", parameters: {ratio: 2.5e-5}}
      - {effect: geometry, location: "joint:2", parameters: {xyz_mm: [0.2, 0, -0.1], turn_mrad: [0, 0.3, 0]}}

The true angle of a joint is q + Δ(q), q what its encoder says. The joints of trajectory.csv, points.csv and of robot
programs are encoder angles: with this file those that bring the arm to the programmed path. A transmission error is
applied at encoder angles of its ``range_deg``, where it was measured, and fades out within 5 degrees beyond; without
one everywhere. A geometry moves the joint's frame in the link before it (``base``: the whole arm in base_link;
``tool``: what the flange carries): shifted, and turned about its own origin, in axes of base_link with all joints at
zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.arrays import Array
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.domain.location import joints_of
from machopt.effects import files, geometry, registry, within
from machopt.effects.given import Parameters
from machopt.effects.protocol import Parameter, Unloaded
from machopt.errors import nearest
from machopt.formats.yamlstrict import Document, Loc, Strict, read_yaml, show, validate

_MOST_DEG = 3600.0
_STEEPEST = 0.5  # |Δ'|: beyond it encoder and true angle are hardly one to one, and the file is in another unit


def parameters() -> Mapping[str, tuple[str, ...]]:
    """The keys that every effect in use needs, by its word; of a geometry those it may have."""
    angles = {
        word: tuple(p.key for p in (*law.shape, *law.coefficients))
        for word, (_, law) in registry.without_load().items()
    }
    return angles | {geometry.EFFECT.name: (geometry.SHIFT, geometry.TURN)}


def optional(effect: str) -> tuple[str, ...]:
    """Keys that it may have beside those."""
    _, law = registry.without_load().get(effect, (None, None))
    return (within.KEY,) if law is not None and law.ranged else ()


class _Correction(Strict):
    effect: str = Field(min_length=1, description=", ".join(parameters()))
    location: str = Field(
        min_length=1, description="joint:1 … joint:6, joint:4-5 of a coupling, base or tool of a geometry"
    )
    parameters: dict[str, Any] = Field(description="numbers (of a geometry vectors) with their unit in the name")


class _KinematicsFile(Strict):
    machopt_kinematics: Literal[1] = Field(description="the format, 1")
    corrections: list[_Correction] = Field(description="what the true joint angles differ by from the encoders")


def load_kinematics(path: Path | str) -> Kinematics:
    """Read kinematics.yaml.

    Raises:
        InputError: names file, line and key, what was found and what was expected.
    """
    document = read_yaml(Path(path))
    data = validate(_KinematicsFile, document)
    seen: set[tuple[str, str, str]] = set()
    out = []
    for n, c in enumerate(data.corrections):
        loc: Loc = ("corrections", n)
        _check_place(document, loc, c.effect, c.location)
        key = c.effect, c.location, str(c.parameters.get(within.KEY, ""))
        if key in seen:
            raise document.error(
                loc, f"{c.effect} at {c.location} stands twice; keep one (waves of a transmission error stand in lists)"
            )
        seen.add(key)
        stated = _parameters(document, (*loc, "parameters"), c)
        out.append(KinematicCorrection(c.effect, c.location, stated, _own(c.effect, stated)))
    found = Kinematics(tuple(out), Path(path))
    for joint, slope in enumerate(_slopes(found), start=1):
        if slope >= _STEEPEST:
            raise document.error(
                ("corrections",),
                f"the corrections of joint {joint} change by up to {slope:.2g} rad per rad, less than {_STEEPEST:g} "
                "would work (per_turn × amplitude, and ratios, add up)",
            )
    return found


def write_kinematics(path: Path | str, kinematics: Kinematics) -> None:
    """Write kinematics.yaml so that :func:`load_kinematics` returns the same numbers."""
    lines = ["machopt_kinematics: 1", "corrections:" if kinematics else "corrections: []"]
    for c in kinematics.corrections:
        inner = ", ".join(f"{key}: {_number(value)}" for key, value in c.parameters.items())
        lines.append(f'  - {{effect: {c.effect}, location: "{c.location}", parameters: {{{inner}}}}}')
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _check_place(document: Document, loc: Loc, effect: str, location: str) -> None:
    known = list(parameters())
    if effect not in known:
        raise document.error(
            (*loc, "effect"),
            f"found {effect!r}; {nearest(effect, known)} (what is elastic belongs into stiffness.yaml; an effect of "
            "your own is known where its file is given)",
        )
    places = registry.EFFECTS[effect].places if effect == geometry.EFFECT.name else _places(effect)
    if location not in places:
        wanted = "joint:i-j, i < j, e.g. joint:4-5" if "-" in places[0] else f"{places[0]} … {places[-1]}"
        raise document.error((*loc, "location"), f"found {location!r}; expected {wanted}")


def _own(effect: str, stated: Mapping[str, Any]) -> Callable[[Array], Array] | None:
    """Δ of an effect of the user's own by the angle of its joint; None of those that the verifier has laws of."""
    of, law = registry.without_load().get(effect, (None, None))
    if law is None or of in registry.LISTED:
        return None
    values, shape, _ = files.read(law, Parameters(stated, effect))
    return lambda angle: np.asarray(law.columns(shape, angle) @ values)


def _places(effect: str) -> tuple[str, ...]:
    return registry.without_load()[effect][0].places


def _vectors(document: Document, loc: Loc, c: _Correction) -> Mapping[str, Any]:
    """Shift and turn of a frame: three numbers each, at least one of the two."""
    if not c.parameters:
        raise document.error(loc, f"{c.effect} needs {geometry.SHIFT} or {geometry.TURN}, three numbers each")
    for key, value in c.parameters.items():
        most, unit = (geometry.MOST_MM, "mm") if key == geometry.SHIFT else (geometry.MOST_MRAD, "mrad")
        wanted = parameters()[c.effect]
        if key not in wanted:
            raise document.error((*loc, key), f"unknown key {key!r}; {nearest(key, list(wanted))}")
        if not isinstance(value, list) or len(value) != 3:
            raise document.error((*loc, key), f"found {show(value)}; expected three numbers in {unit}")
        for n, v in enumerate(value):
            if isinstance(v, bool) or not isinstance(v, int | float) or not abs(v) <= most:
                raise document.error(
                    (*loc, key, n), f"found {show(v)}; expected a number, at most {most:g} {unit} to either side"
                )
    return dict(c.parameters)


def _parameters(document: Document, loc: Loc, c: _Correction) -> Mapping[str, Any]:
    if c.effect == geometry.EFFECT.name:
        return _vectors(document, loc, c)
    law = registry.without_load()[c.effect][1]
    wanted, more = parameters()[c.effect], optional(c.effect)
    for key in c.parameters:
        if key not in (*wanted, *more):
            raise document.error((*loc, key), f"unknown key {key!r}; {nearest(key, [*wanted, *more])}")
    if within.KEY in c.parameters:
        _check_range(document, (*loc, within.KEY), c.parameters[within.KEY])
    for key in wanted:
        if key not in c.parameters:
            raise document.error(loc, f"{key} is missing; {c.effect} needs {', '.join(wanted)}")
    lengths = set()
    for p in (*law.shape, *law.coefficients):
        value = c.parameters[p.key]
        if isinstance(value, list) and p.many:
            lengths.add(len(value))
            if not value:
                raise document.error((*loc, p.key), "found an empty list; expected at least one number")
            for n, v in enumerate(value):
                _check_number(document, (*loc, p.key, n), p, v)
        else:
            lengths.add(-1)
            _check_number(document, (*loc, p.key), p, value)
    if len(lengths) > 1:
        raise document.error(
            loc, f"{', '.join(wanted)} differ in length; expected three numbers, or three lists of the same length"
        )
    for p in law.shape:  # the only number of a form: which branch it is
        values = c.parameters[p.key]
        if isinstance(values, list) and len(set(values)) < len(values):
            raise document.error((*loc, p.key), f"found {show(values)}; each order once")
    return dict(c.parameters)


def _check_range(document: Document, loc: Loc, value: object) -> None:
    numbers = value if isinstance(value, list) else []
    right = [v for v in numbers if isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= _MOST_DEG]
    if len(numbers) != 2 or len(right) != 2 or not right[0] < right[1]:
        raise document.error(
            loc, f"found {show(value)}; expected two encoder angles in degrees, the lower first, e.g. [-90, 75]"
        )


def _check_number(document: Document, loc: Loc, p: Parameter, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise document.error(loc, f"found {show(value)}; expected a number ({p.said})")
    if p.positive and not 0.0 < value <= p.most:
        raise document.error(loc, f"found {value:g}; expected more than 0 and at most {p.most:g} {p.said}")
    if abs(value) > p.most:
        raise document.error(loc, f"found {value:g}; expected at most {p.most:g} {p.said} to either side")


def _slopes(kinematics: Kinematics) -> list[float]:
    """(6,) most that Δ of each joint can change per rad of any joints."""
    slope = [0.0] * 6
    for c in kinematics.corrections:
        if c.effect == geometry.EFFECT.name:
            continue
        law: Unloaded = registry.without_load()[c.effect][1]
        values, shape, _ = files.read(law, Parameters(c.parameters, c.effect))
        at = joints_of(c.location)[1]
        slope[at] += law.steepest(values, shape)
        if within.stated(c.parameters) is not None:  # all of it fades out
            slope[at] += within.STEEPEST * law.largest(values, shape) / within.FADE
    return slope


def _number(value: Any) -> str:
    """Shortest exact decimal; ``1.0e-07`` and not ``1e-07``, which YAML 1.1 readers take for text."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(_number(v) for v in value)}]"
    text = repr(float(value)) if not isinstance(value, int) else repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
