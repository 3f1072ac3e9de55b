"""Data of the map page from its results."""

from __future__ import annotations

import json

import numpy as np

from machopt.data_types.documents.map_document import MapDocument
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.report.page_types.map_sample_states import PlaceCode, convert_to_place_codes
from machopt.report.page_types.workspace_map_page_data import (
    ArmLines,
    MapAxis,
    MapField,
    MapLayer,
    MapPageData,
    MapScene,
    MeasuredView,
)
from machopt.report.scene.scene_types import CellScene
from machopt.version import __version__
from machopt.workspace_map.document import DEG, MM, REASON_TEXTS, EvaluatedMap, MapLayerResult
from machopt.workspace_map.measured_stiffness import MeasuredComparison
from machopt.workspace_map.postures import ReachingArm
from machopt.workspace_map.quantities import MapQuantity, MapSettings
from machopt.workspace_map.request import MapOptions
from machopt.workspace_map.sample_grid import XYZ, MapSamples

_GAIN = MapField(
    key="gain",
    name="Gain by turning the tool",
    unit="share",
    better="more",
    note="What the best rotation wins over the given one, by the quantity postures are chosen by.",
)
_ROTATION = MapField(
    key="rotation",
    name="Best rotation γ",
    unit="rad",
    better="none",
    note="Rotation about the tool axis at which this place is best; ±180° is the same.",
)
_FREEDOM = MapField(
    key="freedom",
    name="Rotations that can be reached",
    unit="share",
    better="more",
    note="Share of the rotations about the tool axis that have a posture.",
)


def build_map_page_data(evaluated: EvaluatedMap, result: MapDocument, scene: CellScene) -> MapPageData:
    """Return everything that page and picture show.

    Args:
        evaluated: The map with its inputs.
        result: Content of map.json.
        scene: The cell's bodies for the 3-D view.
    """
    cell, options, comparison = evaluated.cell, evaluated.options, evaluated.comparison
    samples, layers, criterion = evaluated.samples, evaluated.layers, evaluated.criterion
    fields = [
        MapField(key=f.key, name=f.name, unit=f.unit, better=f.better, note=f.note) for f in layers[0].values.fields
    ]
    shown = [_build_layer(layer, options, criterion) for layer in layers]
    if len(layers) > 1:
        gain = _compute_gain(layers[0].values.value[criterion.key], layers[1].values.value[criterion.key], criterion)
        free = layers[1].postures
        freedom = np.where(free.ok, free.rotations, np.nan)
        shown[1].value.update(gain=gain, rotation=_wrap_half_turn(free.gamma), freedom=freedom)
        fields += [_GAIN, _ROTATION, _FREEDOM]
    if comparison is not None:
        fields += _build_measured_fields(shown, comparison)
    fixed = np.zeros(3)
    if samples.position is not None:
        fixed = samples.position[0]
    return MapPageData(
        title=f"Map of {cell.name}",
        cell=cell.name,
        version=__version__,
        kind=samples.kind,
        frame=options.frame,
        place=_describe_location(samples, options),
        axes=_build_axes(samples, options),
        fixed=fixed,
        end=samples.position[-1] if samples.kind == "line" and samples.position is not None else None,
        fields=tuple(fields),
        layers=tuple(shown),
        criterion=criterion.key,
        reasons=tuple(_describe_code(code) for code in PlaceCode),
        arm=_build_arm_lines(evaluated.arm, invert_transform(options.T_base_frame)),
        verdict=result.verdict,
        warnings=result.warnings,
        measured=None if comparison is None else _build_measured_view(comparison),
        options=_list_options(result, evaluated.setting),
        hashes=tuple(result.inputs.items()),
        space=MapScene(scene, options.T_base_frame, cell.external_home),
    )


def _build_measured_fields(shown: list[MapLayer], comparison: MeasuredComparison) -> list[MapField]:
    """What was measured, interpolated, as fields of their own; the layers take their values."""
    fields = []
    for f, axis in enumerate(comparison.axes):
        fields.append(
            MapField(
                key=f"measured_{axis}",
                name=f"Measured k_{axis}, interpolated",
                unit="N/m",
                better="more",
                note="Inverse distance weighting of the readings; dotted where outside their hull.",
                model=f"k_{axis}",
            )
        )
        for layer in shown:
            layer.value[f"measured_{axis}"] = np.where(layer.reason == 0, comparison.spread.value[:, f], np.nan)
            layer.guess[f"measured_{axis}"] = ~comparison.spread.inside
    return fields


def _build_arm_lines(arm: ReachingArm, T_frame_base: Array) -> ArmLines:
    """The arm at its zero, in the map's frame."""
    robot, R = arm.robot, T_frame_base[:3, :3]

    def moved(p: Array) -> Array:
        return np.asarray(p @ R.T + T_frame_base[:3, 3])

    return ArmLines(
        joints=robot.joints,
        axis=robot.axis @ R.T,
        point=moved(robot.point),
        base=moved(np.zeros(3)),
        up=R[:, 2],
        flange=moved(robot.T_base_flange_zero[:3, 3]),
        tcp=moved((robot.T_base_flange_zero @ arm.T_flange_tcp)[:3, 3]),
    )


def _build_measured_view(comparison: MeasuredComparison) -> MeasuredView:
    return MeasuredView(
        file=comparison.file,
        axes=comparison.axes,
        position=comparison.position,
        measured=comparison.measured,
        left_out=comparison.left_out,
        model=comparison.model,
        held_stiffness=comparison.held_stiffness,
        errors=comparison.compute_errors(),
        from_joints=comparison.from_joints,
        power=comparison.power,
    )


def _describe_code(code: PlaceCode) -> str:
    """What a place of this code is called: as the map's sentences call its reason, where they speak of it."""
    return (REASON_TEXTS.get(code.reason) if code.reason is not None else None) or code.name.lower().replace("_", " ")


def _build_layer(layer: MapLayerResult, options: MapOptions, criterion: MapQuantity) -> MapLayer:
    value = layer.values.value[criterion.key]
    best = -1
    if np.isfinite(value).any():
        best = int(np.nanargmax(value) if criterion.better == "more" else np.nanargmin(value))
    if options.kind == "joints":
        title = "postures"
    else:
        title = f"rotation γ = {options.gamma[0] * DEG:g}°" if layer.name == "given" else "best rotation γ"
    p = layer.postures
    return MapLayer(
        name=layer.name,
        title=title,
        value=dict(layer.values.value),
        reason=convert_to_place_codes(p.reason),
        q=p.q,
        gamma=p.gamma,
        shortfall=p.shortfall,
        best=best,
    )


def _compute_gain(given: Array, free: Array, criterion: MapQuantity) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = free / given - 1.0 if criterion.better == "more" else 1.0 - free / given
    return np.where(np.isfinite(gain), gain, np.nan)


def _wrap_half_turn(gamma: Array) -> Array:
    with np.errstate(invalid="ignore"):
        turned = gamma - 2 * np.pi * np.ceil((gamma - np.pi) / (2 * np.pi) - 1e-12)
    return np.asarray(turned)


def _build_axes(samples: MapSamples, options: MapOptions) -> tuple[MapAxis, ...]:
    labels = {"s": "way along the line", **{c: f"{c} of {options.frame}" for c in XYZ}}
    return tuple(MapAxis(a.name, labels.get(a.name, f"joint {a.name}"), a.unit, a.values) for a in samples.axes)


def _describe_location(samples: MapSamples, options: MapOptions) -> str:
    axes = samples.axes
    scale, unit = (DEG, "deg") if samples.kind == "joints" else (MM, "mm")
    spans = ", ".join(f"{a.name} {a.values[0] * scale:g} to {a.values[-1] * scale:g}" for a in axes).replace("-", "−")
    if samples.kind == "line":
        return f"Straight line of {axes[0].values[-1] * MM:g} mm, tool not turning"
    if samples.kind == "slice":
        normal = next(c for c in XYZ if c not in options.axes)
        return f"Slice at {normal} = {options.at * MM:g} mm of {options.frame}: {spans} {unit}"
    return f"{'Volume' if samples.kind == 'volume' else 'Joint space'}: {spans} {unit}"


def _list_options(result: MapDocument, setting: MapSettings) -> tuple[tuple[str, str], ...]:
    rows = [
        (name.replace("_", " "), json.dumps(value))
        for name, value in result.options.to_json_types().items()
        if value is not None
    ]
    terms: list[str] = []
    if setting.elasticity is not None:
        terms = [f"{t.effect} at {t.location}" for t in setting.elasticity.terms]
        terms += [
            f"external joint {s.joint} (at home)" for s in setting.elasticity.stiffness.external if s.is_compliant
        ]
    rows.append(("characteristic length", f"{setting.length * MM:.1f} mm"))
    rows.append(("terms in addition to the joint springs", ", ".join(terms) or "none"))
    return tuple(rows)
