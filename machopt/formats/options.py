"""Planning options as the user writes them, with units in the keys, and the layers they come in.

Layers, the later one wins: the cell's ``plan:``, the ``--plan`` file, ``--set key=value``, direct arguments.
Mappings (``force_N``, ``weights``) merge key by key; lists are replaced.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from machopt.domain.options import (
    ExternalAxis,
    ExternalMode,
    FixedRotation,
    Index,
    Method,
    PlanOptions,
    ProcessForce,
    Weights,
)
from machopt.errors import InputError
from machopt.formats.steering import SteerKeys, steer_as_user, steer_of, tidy
from machopt.formats.yamlstrict import Document, Loc, Strict, parse_yaml, read_yaml, validate

_MM, _MM_PER_MIN, _MS = 1e-3, 1e-3 / 60.0, 1e-3


class ForceKeys(Strict):
    travel: float | None = Field(default=None, description="N along the direction of travel")
    normal: float | None = Field(default=None, description="N along tool axis × travel")
    axial: float | None = Field(default=None, description="N along the tool axis towards the shank")


class WeightKeys(Strict):
    mean: float | None = Field(
        default=None, ge=0, description="of the index over the length cut, as a share of a typical one"
    )
    worst: float | None = Field(default=None, ge=0, description="of its worst value, the same")
    travel: float | None = Field(
        default=None, ge=0, description="of joint travel, per 180 degrees summed over the axes"
    )
    rotation: float | None = Field(default=None, ge=0, description="of rotation about the tool axis, per 180 degrees")
    feed: float | None = Field(default=None, ge=0, description="of the share of the cutting time lost to slow axes")
    clearance: float | None = Field(
        default=None,
        ge=0,
        description="of nearness to anything over the length cut: 1 at contact, 0 at clearance_full_mm",
    )


class ExternalKeys(Strict):
    """One external joint, by its name or as e1, e2 … in the order of the cell."""

    mode: ExternalMode | None = Field(
        default=None, description="locked (at home, or at_mm, at_deg); operation: one value for each; moving (default)"
    )
    operations: dict[str, ExternalMode] | None = Field(default=None, description="the mode of operations by label")
    weight: float | None = Field(default=None, ge=0, description="of its travel: 1 counts like a joint of the arm")
    at_mm: float | None = Field(default=None, description="where it is locked, mm")
    at_deg: float | None = Field(default=None, description="the same of a joint that turns, degrees")
    at_operations_mm: dict[str, float] | None = Field(
        default=None, description="where it stands in operations by label, mm; the others as the mode says"
    )
    at_operations_deg: dict[str, float] | None = Field(
        default=None, description="the same of a joint that turns, degrees"
    )
    preferred_mm: float | None = Field(default=None, description="value whose neighbourhood is preferred, mm")
    preferred_deg: float | None = Field(default=None, description="the same of a joint that turns, degrees")
    range_mm: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[lowest, highest] to use of its range, mm"
    )
    range_deg: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="the same of a joint that turns, degrees"
    )

    @model_validator(mode="after")
    def _one_unit(self) -> ExternalKeys:
        given = [k for k, v in self.model_dump(exclude_none=True).items() if k.endswith(("_mm", "_deg"))]
        if len({k.rsplit("_", 1)[1] for k in given}) > 1:
            raise ValueError(f"found {', '.join(given)}; a joint slides (mm) or turns (deg), not both")
        for key in ("range_mm", "range_deg"):
            value = getattr(self, key)
            if value is not None and not value[0] <= value[1]:
                raise ValueError(f"{key}: found {value}; expected [lowest, highest]")
        return self


class FixedKeys(Strict):
    point: int = Field(ge=0, description="0-based index of a toolpath point")
    gamma_deg: float = Field(ge=-180, le=180, description="rotation about the tool axis")


class OptionKeys(Strict):
    """Every planning option under the user's name; None means not given."""

    machopt_plan: Literal[1] | None = Field(default=None, description="the format of a --plan file")
    method: Method | None = Field(
        default=None, description="choice over the whole path, the method of jiao2022, or the CAM file's own rotation"
    )
    index: Index | None = Field(
        default=None, description="what is made small; auto: deflection where force_N is given, else compliance"
    )
    force_N: ForceKeys | None = Field(default=None, description="process force on the tool")
    weights: WeightKeys | None = Field(default=None, description="of the terms of the objective")
    rotation_step_deg: float | None = Field(default=None, ge=0.5, le=90, description="degrees, 0.5 to 90")
    rotation_range_deg: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[lowest, highest]"
    )
    preferred_rotation_deg: float | None = Field(
        default=None, ge=-180, le=180, description="gamma whose neighbourhood is preferred"
    )
    preferred_weight: float | None = Field(
        default=None, ge=0, description="price of a deviation of 180 degrees from it"
    )
    fixed: list[FixedKeys] | None = Field(default=None, description="rotations that are given at toolpath points")
    steer: list[SteerKeys] | None = Field(
        default=None, description="pins, forbidden zones, preferences and branches by operation or points"
    )
    singularity_wrist_deg: float | None = Field(
        default=None, ge=0, le=45, description="least angle between axes 4 and 6, degrees"
    )
    singularity_elbow_deg: float | None = Field(
        default=None, ge=0, le=45, description="least angle from the stretched or folded arm, degrees"
    )
    singularity_shoulder_mm: float | None = Field(
        default=None, ge=0, le=1000, description="least distance of the wrist from axis 1, mm"
    )
    limit_margin_deg: float | None = Field(default=None, ge=0, le=45, description="kept from the joint limits, degrees")
    clearance_full_mm: float | None = Field(
        default=None, gt=0, le=500, description="distance from which more gains nothing, for weights.clearance"
    )
    clearance_mm: float | None = Field(default=None, ge=0, le=500, description="kept between everything checked, mm")
    collision_step_deg: float | None = Field(
        default=None, ge=0.05, le=10, description="joint step between collision checks, degrees"
    )
    collision: bool | None = Field(default=None, description="false: contacts are not looked for, and that is told")
    gouge_tolerance_mm: float | None = Field(
        default=None,
        gt=0,
        le=50,
        description="workpiece.geometry is the finished part, and a cutter deeper in it than this at a feed gouges; "
        "left out: not looked for",
    )
    sample_ms: float | None = Field(default=None, ge=0.5, le=100, description="step of trajectory.csv, ms")
    path_tolerance_mm: float | None = Field(
        default=None, gt=0, le=10, description="by which the motion may round corners, mm"
    )
    axis_tolerance_deg: float | None = Field(
        default=None, gt=0, le=10, description="the same of the tool axis, degrees"
    )
    approach_feed_mm_min: float | None = Field(
        default=None, gt=0, le=120_000, description="of approach, retract and link moves that carry no feed, mm/min"
    )
    rapid_scale: float | None = Field(
        default=None, gt=0, le=1, description="share of the joint velocity limits used in rapid moves"
    )
    limit_scale: float | None = Field(
        default=None, gt=0, le=1, description="share of the joint limits used while cutting"
    )
    allow_gaps: bool | None = Field(default=None, description="true: cuts to points out of reach are left out and said")
    compensate: bool | None = Field(
        default=None, description="true: drive a path shifted against the deflection under force_N"
    )
    compensation_max_mm: float | None = Field(default=None, gt=0, le=50, description="a larger shift is refused, mm")
    seed: int | None = Field(default=None, ge=0, description="of the tree search for rapid moves")
    external: dict[str, ExternalKeys] | None = Field(
        default=None, description="how the external joints are used, by name or e1, e2 … in the order of the cell"
    )

    @field_validator("rotation_range_deg")
    @classmethod
    def _range(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and not -180 <= value[0] < value[1] <= 180:
            raise ValueError(f"found {value}; expected [lowest, highest] with -180 ≤ lowest < highest ≤ 180")
        return value

    @field_validator("fixed")
    @classmethod
    def _fixed(cls, value: list[FixedKeys] | None) -> list[FixedKeys] | None:
        points = [f.point for f in value or ()]
        twice = sorted({p for p in points if points.count(p) > 1})
        if twice:
            raise ValueError(f"point {twice[0]} stands twice; give each point one rotation")
        return value

    def given(self) -> dict[str, object]:
        """Only what the user wrote."""
        return self.model_dump(exclude_none=True, exclude={"machopt_plan"})


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
    layers = [_checked(Document(dict(cell_plan or {}), {}, "cell.yaml"), ("plan",))]
    if plan_file is not None:
        layers.append(_checked(read_yaml(Path(plan_file))))
    layers += [_checked(_override(word)) for word in overrides]
    layers.append(_checked(Document({k: v for k, v in direct.items() if v is not None}, {}, "options")))
    merged: dict[str, object] = {}
    for layer in layers:
        merged = _merge(merged, layer)
    # which layer a clash between two keys comes from cannot be told, so the message names only the keys
    return _to_si(validate(OptionKeys, Document(merged, {}, "options")))


def without_effect(options: PlanOptions) -> tuple[str, ...]:
    """Options that were changed and that something else among the options keeps from having an effect."""
    plain = PlanOptions()
    out = []

    def idle(names: tuple[tuple[str, str], ...], why: str) -> None:
        changed = [user for user, name in names if getattr(options, name) != getattr(plain, name)]
        if changed:
            out.append(f"{', '.join(changed)} {'has' if len(changed) == 1 else 'have'} no effect: {why}")

    if options.preferred_rotation is None:
        idle((("preferred_weight", "preferred_weight"),), "no preferred_rotation_deg is given")
    elif not options.preferred_weight:
        out.append("preferred_rotation_deg has no effect: preferred_weight is 0")
    if not options.collision:
        idle((("clearance_mm", "clearance"), ("collision_step_deg", "collision_step")), "collision is false")
    if not options.compensate:
        idle((("compensation_max_mm", "compensation_max"),), "compensate is false")
    if options.method != "global":
        why = f"method {options.method} chooses without"
        idle((("weights", "weights"), ("preferred_rotation_deg", "preferred_rotation")), why)
    if options.method == "default":
        idle((("rotation_range_deg", "rotation_range"),), "method default takes the file's own rotation")
    return (*out, *(said for axis in options.external for said in _idle_external(axis)))


def _idle_external(axis: ExternalAxis) -> Iterator[str]:
    """Not refused: a cell's values stay where one run locks or frees the joint."""
    at = f"external.{axis.joint}"
    if axis.at is not None and axis.mode and not axis.locks:
        yield f"{at}.at_{axis.unit} has no effect: the joint is locked nowhere"
    for key in ("preferred", "range"):
        if getattr(axis, key) is not None and not axis.moves:
            yield f"{at}.{key}_{axis.unit} has no effect: the joint is locked everywhere"


def options_as_user(options: PlanOptions) -> dict[str, object]:
    """The options under the user's keys and units, as result.json shows them and ``--plan`` takes them."""
    f, w = options.force, options.weights
    user: dict[str, object] = {
        "method": options.method,
        "index": options.index,
        "force_N": {"travel": f.travel, "normal": f.normal, "axial": f.axial},
        "weights": {
            "mean": w.mean,
            "worst": w.worst,
            "travel": w.travel,
            "rotation": w.rotation,
            "feed": w.feed,
            "clearance": w.clearance,
        },
        "rotation_step_deg": tidy(degrees(options.rotation_step)),
        "rotation_range_deg": [tidy(degrees(v)) for v in options.rotation_range],
        "preferred_weight": options.preferred_weight,
        "fixed": [{"point": p.point, "gamma_deg": tidy(degrees(p.gamma))} for p in options.fixed],
        "singularity_wrist_deg": tidy(degrees(options.singularity_wrist)),
        "singularity_elbow_deg": tidy(degrees(options.singularity_elbow)),
        "singularity_shoulder_mm": tidy(options.singularity_shoulder / _MM),
        "limit_margin_deg": tidy(degrees(options.limit_margin)),
        "clearance_mm": tidy(options.clearance / _MM),
        "clearance_full_mm": tidy(options.clearance_full / _MM),
        "collision_step_deg": tidy(degrees(options.collision_step)),
        "collision": options.collision,
        "sample_ms": tidy(options.sample / _MS),
        "path_tolerance_mm": tidy(options.path_tolerance / _MM),
        "axis_tolerance_deg": tidy(degrees(options.axis_tolerance)),
        "approach_feed_mm_min": tidy(options.approach_feed / _MM_PER_MIN),
        "rapid_scale": options.rapid_scale,
        "limit_scale": options.limit_scale,
        "allow_gaps": options.allow_gaps,
        "compensate": options.compensate,
        "compensation_max_mm": tidy(options.compensation_max / _MM),
        "seed": options.seed,
    }
    if options.steer:
        user["steer"] = [steer_as_user(wish) for wish in options.steer]
    if options.external:
        user["external"] = {axis.joint: _external_as_user(axis) for axis in options.external}
    if options.gouge is not None:
        user["gouge_tolerance_mm"] = tidy(options.gouge / _MM)
    if options.preferred_rotation is not None:
        user["preferred_rotation_deg"] = tidy(degrees(options.preferred_rotation))
    return user


def _external_as_user(axis: ExternalAxis) -> dict[str, object]:
    factor = _MM if axis.unit == "mm" else radians(1.0)
    out: dict[str, object] = {"weight": axis.weight}
    if axis.mode is not None:
        out["mode"] = axis.mode
    if axis.operations:
        out["operations"] = dict(axis.operations)
    for name in ("at", "preferred", "range"):
        value = getattr(axis, name)
        if value is not None:
            told = [tidy(v / factor) for v in value] if name == "range" else tidy(value / factor)
            out[f"{name}_{axis.unit}"] = told
    if axis.at_operations:
        out[f"at_operations_{axis.unit}"] = {label: tidy(v / factor) for label, v in axis.at_operations}
    return out


def _external_axis(joint: str, keys: ExternalKeys) -> ExternalAxis:
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
    return ExternalAxis(
        joint=joint,
        mode=keys.mode,
        operations=tuple((keys.operations or {}).items()),
        weight=1.0 if keys.weight is None else keys.weight,
        unit=unit,
        **si,  # type: ignore[arg-type]
    )


def _checked(document: Document, prefix: Loc = ()) -> dict[str, object]:
    return validate(OptionKeys, document, prefix).given()


def _override(word: str) -> Document:
    key, equals, text = word.partition("=")
    path = tuple(key.strip().split("."))
    if not equals or not all(path):
        raise InputError(f"found {word!r}; expected key=value, e.g. rotation_step_deg=2.5", file="--set")
    value = parse_yaml(text, f"--set {key}").value
    for part in reversed(path):
        value = {part: value}
    return Document(value, {}, "--set")


def _merge(below: dict[str, object], above: dict[str, object]) -> dict[str, object]:
    out = dict(below)
    for key, value in above.items():
        old = out.get(key)
        out[key] = _merge(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return out


def _to_si(keys: OptionKeys) -> PlanOptions:
    si: dict[str, object] = {}
    for user, name, factor in (
        ("singularity_shoulder_mm", "singularity_shoulder", _MM),
        ("clearance_mm", "clearance", _MM),
        ("clearance_full_mm", "clearance_full", _MM),
        ("gouge_tolerance_mm", "gouge", _MM),
        ("path_tolerance_mm", "path_tolerance", _MM),
        ("compensation_max_mm", "compensation_max", _MM),
        ("sample_ms", "sample", _MS),
        ("approach_feed_mm_min", "approach_feed", _MM_PER_MIN),
        ("rotation_step_deg", "rotation_step", radians(1.0)),
        ("preferred_rotation_deg", "preferred_rotation", radians(1.0)),
        ("singularity_wrist_deg", "singularity_wrist", radians(1.0)),
        ("singularity_elbow_deg", "singularity_elbow", radians(1.0)),
        ("limit_margin_deg", "limit_margin", radians(1.0)),
        ("collision_step_deg", "collision_step", radians(1.0)),
        ("axis_tolerance_deg", "axis_tolerance", radians(1.0)),
    ):
        value = getattr(keys, user)
        if value is not None:
            si[name] = value * factor
    for name in (
        "method",
        "index",
        "preferred_weight",
        "collision",
        "rapid_scale",
        "limit_scale",
        "allow_gaps",
        "compensate",
        "seed",
    ):
        if getattr(keys, name) is not None:
            si[name] = getattr(keys, name)
    if keys.rotation_range_deg is not None:
        lo, hi = keys.rotation_range_deg
        si["rotation_range"] = (radians(lo), radians(hi))
    if keys.force_N is not None:
        si["force"] = ProcessForce(**keys.force_N.model_dump(exclude_none=True))
    if keys.weights is not None:
        si["weights"] = Weights(**keys.weights.model_dump(exclude_none=True))
    if keys.fixed is not None:
        si["fixed"] = tuple(FixedRotation(f.point, radians(f.gamma_deg)) for f in keys.fixed)
    if keys.steer is not None:
        si["steer"] = tuple(steer_of(wish) for wish in keys.steer)
    if keys.external is not None:
        si["external"] = tuple(_external_axis(joint, given) for joint, given in keys.external.items())
    options = PlanOptions(**si)  # type: ignore[arg-type]
    _consistent(options)
    return options


def _consistent(options: PlanOptions) -> None:
    """What only the merged options can show."""
    lo, hi = options.rotation_range
    if options.rotation_step > hi - lo:
        raise InputError(
            f"a step of {tidy(degrees(options.rotation_step))}° does not fit into the range "
            f"{tidy(degrees(lo))}°…{tidy(degrees(hi))}°; a smaller step would work",
            file="options",
            where="rotation_step_deg",
        )
    for p in options.fixed:
        if not lo - 1e-9 <= p.gamma <= hi + 1e-9:  # rad; round-off of the degrees only
            raise InputError(
                f"point {p.point} is fixed at {tidy(degrees(p.gamma))}°, outside the range "
                f"{tidy(degrees(lo))}°…{tidy(degrees(hi))}°",
                file="options",
                where="fixed",
            )
    if options.compensate and not options.force.given:
        raise InputError(
            "there is no force to compensate for; the process force as force_N, e.g. force_N={normal: 200}, would work",
            file="options",
            where="compensate",
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
