"""Planning options from several layers, converted to SI and back.

Layers, later ones take precedence: the cell's ``plan:``, the ``--plan`` file, ``--set key=value``, direct arguments.
Mappings (``force_N``, ``weights``) merge key by key; lists are replaced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from math import degrees, radians
from pathlib import Path
from typing import Any, Literal

from machopt.data_types.plan_options import (
    ExternalJointOptions,
    FixedRotation,
    ObjectiveWeights,
    PlanOptions,
    ProcessForce,
    TiltRange,
)
from machopt.errors import InputError
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument, parse_yaml, read_yaml, validate_document
from machopt.options.option_schema import ExternalJointOptionKeys, OptionKeys, TiltKeys
from machopt.options.steering_schema import format_steering, parse_steering, round_to_user_digits

_MM, _MM_PER_MIN, _MS = 1e-3, 1e-3 / 60.0, 1e-3
DEFAULT_CLEARANCE = ObjectiveWeights().clearance


@dataclass(frozen=True)
class PlanOptionField:
    """Conversion of one planning option to SI and back; the key has unit, bounds, meaning; PlanOptions the default."""

    key: str  # the user's
    name: str  # of the field of PlanOptions
    to_si: Callable[[Any], Any]
    as_user: Callable[[Any], object]
    always: bool = True  # shown where nothing of it is given, too


def _define_unscaled_option(key: str) -> PlanOptionField:
    return PlanOptionField(key, key, lambda v: v, lambda v: v)


def _define_scaled_option(key: str, name: str, factor: float, *, always: bool = True) -> PlanOptionField:
    return PlanOptionField(key, name, lambda v: v * factor, lambda v: round_to_user_digits(v / factor), always)


def _define_angle_option(key: str, name: str, *, always: bool = True) -> PlanOptionField:
    return PlanOptionField(key, name, radians, lambda v: round_to_user_digits(degrees(v)), always)


def _parse_tilt_range(keys: TiltKeys) -> TiltRange:
    lead, side = (tuple(radians(v) for v in ends or (0.0, 0.0)) for ends in (keys.lead, keys.side))
    return TiltRange((lead[0], lead[1]), (side[0], side[1]))


def _format_tilt_range(tilt: TiltRange) -> dict[str, list[float]]:
    return {
        name: [round_to_user_digits(degrees(v)) for v in ends]
        for name, ends in (("lead", tilt.lead), ("side", tilt.side))
    }


OPTIONS = (
    _define_unscaled_option("method"),
    _define_unscaled_option("index"),
    _define_unscaled_option("objective"),
    PlanOptionField(
        "force_N",
        "force",
        lambda keys: ProcessForce(**keys.model_dump(exclude_none=True)),
        lambda force: {"travel": force.travel, "normal": force.normal, "axial": force.axial},
    ),
    PlanOptionField("weights", "weights", lambda keys: ObjectiveWeights(**keys.model_dump(exclude_none=True)), asdict),
    _define_angle_option("rotation_step_deg", "rotation_step"),
    PlanOptionField(
        "rotation_range_deg",
        "rotation_range",
        lambda ends: tuple(radians(v) for v in ends),
        lambda ends: [round_to_user_digits(degrees(v)) for v in ends],
    ),
    _define_unscaled_option("preferred_weight"),
    PlanOptionField(
        "fixed",
        "fixed",
        lambda given: tuple(FixedRotation(f.point, radians(f.gamma_deg)) for f in given),
        lambda fixed: [{"point": p.point, "gamma_deg": round_to_user_digits(degrees(p.gamma))} for p in fixed],
    ),
    _define_angle_option("singularity_wrist_deg", "singularity_wrist"),
    _define_angle_option("singularity_elbow_deg", "singularity_elbow"),
    _define_scaled_option("singularity_shoulder_mm", "singularity_shoulder", _MM),
    _define_angle_option("limit_margin_deg", "limit_margin"),
    _define_scaled_option("clearance_mm", "clearance", _MM),
    _define_scaled_option("clearance_full_mm", "clearance_full", _MM),
    _define_angle_option("collision_step_deg", "collision_step"),
    _define_unscaled_option("collision"),
    _define_scaled_option("sample_ms", "sample", _MS),
    _define_scaled_option("path_tolerance_mm", "path_tolerance", _MM),
    _define_angle_option("axis_tolerance_deg", "axis_tolerance"),
    _define_scaled_option("approach_feed_mm_min", "approach_feed", _MM_PER_MIN),
    _define_unscaled_option("rapid_scale"),
    _define_scaled_option("rapid_blend_mm", "rapid_blend", _MM),
    _define_unscaled_option("limit_scale"),
    _define_unscaled_option("allow_gaps"),
    _define_unscaled_option("max_reentries"),
    _define_unscaled_option("compensate"),
    _define_scaled_option("compensation_max_mm", "compensation_max", _MM),
    _define_unscaled_option("seed"),
    PlanOptionField(
        "steer",
        "steer",
        lambda given: tuple(parse_steering(wish) for wish in given),
        lambda steer: [format_steering(wish) for wish in steer],
        always=False,
    ),
    PlanOptionField(
        "external",
        "external",
        lambda given: tuple(_parse_external_options(joint, keys) for joint, keys in given.items()),
        lambda axes: {axis.joint: _format_external_options(axis) for axis in axes},
        always=False,
    ),
    PlanOptionField("advised_feed_share", "advised_feed_share", lambda v: v, lambda v: v, always=False),
    PlanOptionField("min_stability_ratio", "min_stability_ratio", lambda v: v, lambda v: v, always=False),
    _define_scaled_option("gouge_tolerance_mm", "gouge", _MM, always=False),
    _define_angle_option("preferred_rotation_deg", "preferred_rotation", always=False),
    PlanOptionField(
        "tilt_deg",
        "tilt",
        _parse_tilt_range,
        _format_tilt_range,
        always=False,
    ),
    PlanOptionField(
        "operations",
        "tilt_operations",
        lambda given: tuple(
            (label, _parse_tilt_range(keys.tilt_deg)) for label, keys in given.items() if keys.tilt_deg is not None
        ),
        lambda given: {label: {"tilt_deg": _format_tilt_range(tilt)} for label, tilt in given},
        always=False,
    ),
)
"""In the order in which they are shown."""
FIELDS = {option.key: option.name for option in OPTIONS}


def load_options(
    cell_plan: dict[str, object] | None = None,
    plan_file: Path | str | None = None,
    overrides: list[str] | tuple[str, ...] = (),
    **direct: object,
) -> PlanOptions:
    """Merge the layers of planning options and convert them to SI.

    Args:
        cell_plan: ``Cell.plan``, the cell's own defaults.
        plan_file: a YAML file of options (``--plan``).
        overrides: ``key=value`` words (``--set``); dotted keys reach into mappings, values are YAML 1.2.
        direct: options by their user key, e.g. ``method="jiao2022"``; None is ignored.

    Raises:
        InputError: names the layer, the key, what was found and what was expected.
    """
    layers = [_validate_options(YamlDocument(dict(cell_plan or {}), {}, "cell.yaml"), ("plan",))]
    if plan_file is not None:
        layers.append(_validate_options(read_yaml(Path(plan_file))))
    layers += [_validate_options(_parse_override(word)) for word in overrides]
    layers.append(_validate_options(YamlDocument({k: v for k, v in direct.items() if v is not None}, {}, "options")))
    merged: dict[str, object] = {}
    for layer in layers:
        merged = _merge_layers(merged, layer)
    weights = merged.get("weights")
    stated = dict(weights) if isinstance(weights, dict) else {}
    if merged.get("collision") is False and stated.get("clearance", DEFAULT_CLEARANCE) == DEFAULT_CLEARANCE:
        merged["weights"] = {**stated, "clearance": 0.0}  # the default weight has no effect without bodies
    # the layer of a clash between two keys is unknown, so the message names only the keys
    return _to_si(validate_document(OptionKeys, YamlDocument(merged, {}, "options")))


def find_options_without_effect(options: PlanOptions) -> tuple[str, ...]:
    """Find changed options that another option makes ineffective.

    Args:
        options: The planning options, SI units.

    Returns:
        One sentence per option.
    """
    plain = PlanOptions()
    out = []

    def idle(keys: tuple[str, ...], why: str) -> None:
        changed = [key for key in keys if getattr(options, FIELDS[key]) != getattr(plain, FIELDS[key])]
        if changed:
            out.append(f"{', '.join(changed)} {'has' if len(changed) == 1 else 'have'} no effect: {why}")

    if options.preferred_rotation is None:
        idle(("preferred_weight",), "no preferred_rotation_deg is given")
    elif not options.preferred_weight:
        out.append("preferred_rotation_deg has no effect: preferred_weight is 0")
    if not options.collision:
        idle(("clearance_mm", "collision_step_deg"), "collision is false")
    if not options.compensate:
        idle(("compensation_max_mm",), "compensate is false")
    if options.method == "joint":
        idle(("advised_feed_share",), "method joint drives every advised feed")
    if not options.is_searched:
        why = f"method {options.method} chooses without"
        idle(("weights", "preferred_rotation_deg"), why)
    if options.method == "default":
        idle(("rotation_range_deg",), "method default uses the rotation of the CAM file")
    return (*out, *(message for axis in options.external for message in _find_unused_external_keys(axis)))


def _find_unused_external_keys(axis: ExternalJointOptions) -> Iterator[str]:
    """Not refused: a cell's values stay where one run locks or frees the joint."""
    at = f"external.{axis.joint}"
    if axis.at is not None and axis.mode and not axis.locks:
        yield f"{at}.at_{axis.unit} has no effect: the joint is locked nowhere"
    for key in ("preferred", "range"):
        if getattr(axis, key) is not None and not axis.moves:
            yield f"{at}.{key}_{axis.unit} has no effect: the joint is locked everywhere"


def format_user_options(options: PlanOptions) -> dict[str, object]:
    """Format the options under the user's keys and units, as in result.json and for ``--plan``.

    Args:
        options: The planning options, SI units.

    Returns:
        Key → value.
    """
    user: dict[str, object] = {}
    for option in OPTIONS:
        value = getattr(options, option.name)
        if option.always or (value is not None and value != ()):
            user[option.key] = option.as_user(value)
    return user


def _format_external_options(axis: ExternalJointOptions) -> dict[str, object]:
    factor = _MM if axis.unit == "mm" else radians(1.0)
    out: dict[str, object] = {"weight": axis.weight}
    if axis.mode is not None:
        out["mode"] = axis.mode
    if axis.operations:
        out["operations"] = dict(axis.operations)
    for name in ("at", "preferred", "range"):
        value = getattr(axis, name)
        if value is not None:
            entries = (
                [round_to_user_digits(v / factor) for v in value]
                if name == "range"
                else round_to_user_digits(value / factor)
            )
            out[f"{name}_{axis.unit}"] = entries
    if axis.at_operations:
        out[f"at_operations_{axis.unit}"] = {label: round_to_user_digits(v / factor) for label, v in axis.at_operations}
    return out


def _parse_external_options(joint: str, keys: ExternalJointOptionKeys) -> ExternalJointOptions:
    unit: Literal["mm", "deg", ""] = ""
    si: dict[str, object] = {}
    for name in ("at", "preferred", "range"):
        for u, factor in (("mm", _MM), ("deg", radians(1.0))):
            value = getattr(keys, f"{name}_{u}")
            if value is not None:
                unit = "mm" if u == "mm" else "deg"
                si[name] = (value[0] * factor, value[1] * factor) if name == "range" else value * factor
    for u, factor in (("mm", _MM), ("deg", radians(1.0))):
        by_label: dict[str, float] | None = getattr(keys, f"at_operations_{u}")
        if by_label:
            unit = "mm" if u == "mm" else "deg"
            si["at_operations"] = tuple((label, value * factor) for label, value in by_label.items())
    return ExternalJointOptions(
        joint=joint,
        mode=keys.mode,
        operations=tuple((keys.operations or {}).items()),
        weight=1.0 if keys.weight is None else keys.weight,
        unit=unit,
        **si,  # type: ignore[arg-type]
    )


def _validate_options(document: YamlDocument, prefix: KeyPath = ()) -> dict[str, object]:
    return validate_document(OptionKeys, document, prefix).given()


def _parse_override(word: str) -> YamlDocument:
    key, equals, text = word.partition("=")
    path = tuple(key.strip().split("."))
    if not equals or not all(path):
        raise InputError(f"found {word!r}; expected key=value, e.g. rotation_step_deg=2.5", file="--set")
    value = parse_yaml(text, f"--set {key}").value
    for part in reversed(path):
        value = {part: value}
    return YamlDocument(value, {}, "--set")


def _merge_layers(below: dict[str, object], above: dict[str, object]) -> dict[str, object]:
    out = dict(below)
    for key, value in above.items():
        old = out.get(key)
        out[key] = _merge_layers(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return out


def _to_si(keys: OptionKeys) -> PlanOptions:
    given = {option: getattr(keys, option.key) for option in OPTIONS}
    si = {option.name: option.to_si(value) for option, value in given.items() if value is not None}
    options = PlanOptions(**si)
    _check_consistency(options)
    return options


def _check_consistency(options: PlanOptions) -> None:
    """What only the merged options can show."""
    lo, hi = options.rotation_range
    if options.rotation_step > hi - lo:
        raise InputError(
            f"a step of {round_to_user_digits(degrees(options.rotation_step))}° does not fit into the range "
            f"{round_to_user_digits(degrees(lo))}°…{round_to_user_digits(degrees(hi))}°; a smaller step would work",
            file="options",
            where="rotation_step_deg",
        )
    for p in options.fixed:
        if not lo - 1e-9 <= p.gamma <= hi + 1e-9:  # rad; round-off of the degrees only
            raise InputError(
                f"point {p.point} is fixed at {round_to_user_digits(degrees(p.gamma))}°, outside the range "
                f"{round_to_user_digits(degrees(lo))}°…{round_to_user_digits(degrees(hi))}°",
                file="options",
                where="fixed",
            )
    if options.weights.clearance > 0 and not options.collision:
        raise InputError(
            "the objective is to count clearance, and collisions are switched off; collision=true would work",
            file="options",
            where="weights.clearance",
        )
    w = options.weights
    if w.mean == 0 and w.worst == 0:
        raise InputError(
            "mean and worst are both 0, so stiffness would not count; one of them above 0 would work",
            file="options",
            where="weights",
        )
