"""Chart specifications of a map in displayed units; the page's scripts only draw them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array
from machopt.report.charts.chart_colours import CHOSEN, DEFAULT, FOURTH, JIAO, LIMIT
from machopt.report.charts.point_reduction import pack_codes, round_for_json, select_plot_points
from machopt.report.charts.scene_json import build_posture_view
from machopt.report.charts.scene_json import pack_joint_levels as levels_of_joints
from machopt.report.page_types.display_units import ANGLE, LENGTH, format_fixed
from machopt.report.page_types.workspace_map_page_data import MapField, MapLayer, MapPageData
from machopt.report.scene.scene_types import ScenePostures

Spec = dict[str, Any]

ANGLE_LEVEL = 0.02  # deg, steps in which the page knows joint angles
LOG_SCALE_RATIO = 50.0  # ratio above which levels are spaced by ratio: a peak must not cost the rest its digits
_PEAK = 10.0
_ARMS = 6  # stick figures next to curves
_AROUND = 60  # postures that the 3-D picture must have room for
COLORS = (CHOSEN, JIAO, FOURTH, "#8e44ad", DEFAULT, LIMIT)


def build_map_specs(data: MapPageData) -> Spec:
    """Return ``{"field": … or None, "charts": […], "arms": … or None, "view": … or None}``.

    Args:
        data: The data of the page.
    """
    if len(data.axes) > 1:
        return {"field": build_field_spec(data), "charts": [], "arms": None, "view": build_map_scene(data)}
    return {
        "field": None,
        "charts": build_curve_charts(data),
        "arms": build_arms_spec(data),
        "view": build_map_scene(data),
    }


def build_map_scene(data: MapPageData) -> Spec | None:
    """Return the 3-D view of the arm at the samples of the map, or along a single axis; None without postures.

    Args:
        data: The data of the page.
    """
    layer = next((x for x in reversed(data.layers) if x.best >= 0), None)
    if data.space is None or layer is None:
        return None
    rows = np.flatnonzero(np.isfinite(layer.q).all(axis=1))
    rest = np.broadcast_to(data.space.external, (len(rows), len(data.space.external)))
    q = np.hstack([layer.q[rows], rest])
    if len(data.axes) == 1:
        axis, f = data.axes[0], data.shown_field
        at = axis.values * axis.display_unit.factor
        value = layer.value[f.key]
        return build_posture_view(
            "The arm on the way",
            data.space.scene,
            ScenePostures(
                q=q,
                label="Place",
                names=tuple(f"{axis.name} {format_fixed(float(at[k]), 1)} {axis.display_unit.name}" for k in rows),
                words=tuple(((f.name, f.display_unit.format_value(float(value[k]), unit=True)),) for k in rows),
            ),
        )
    some = np.unique(np.linspace(0, len(q) - 1, _AROUND).round().astype(int))
    return {
        **build_posture_view("The arm at a place of the map", data.space.scene),
        "around": levels_of_joints(q[some]),
        "rest": data.space.external.tolist(),
        "frame": round_for_json(data.space.T_base_frame.ravel(), 9),
    }


def build_arms_spec(data: MapPageData) -> Spec | None:
    """Return the arm at some samples along a single axis; None without postures.

    Args:
        data: The data of the page.
    """
    layer = next((x for x in reversed(data.layers) if x.best >= 0), None)
    if layer is None:
        return None
    rows = np.flatnonzero(np.isfinite(layer.q).all(axis=1))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, _ARMS).round().astype(int))]
    ends = [] if data.end is None else [round_for_json(p * LENGTH.factor, 7) for p in (data.fixed, data.end)]
    return {"arm": build_arm_spec(data), "q": [round_for_json(q * ANGLE.factor) for q in layer.q[rows]], "line": ends}


def build_field_spec(data: MapPageData) -> Spec:
    """Return a colour map over two or three axes with all quantities and layers.

    Args:
        data: The data of the page.
    """
    fields = [f for f in data.fields if any(np.isfinite(layer.value.get(f.key, np.nan)).any() for layer in data.layers)]
    return {
        "id": "field",
        "kind": data.kind,
        "frame": data.frame,
        "axes": [
            {
                "name": a.name,
                "label": a.label,
                "unit": a.display_unit.name,
                "values": round_for_json(a.values * a.display_unit.factor, 9),
            }
            for a in data.axes
        ],
        "fixed": round_for_json(data.fixed * LENGTH.factor, 9),
        "fields": [
            {"key": f.key, "name": f.name, "unit": f.display_unit.name, "better": f.better, "note": f.note}
            for f in fields
        ],
        "first": data.criterion,
        "names": list(data.reasons),
        "angle": ANGLE_LEVEL,
        "layers": [_build_layer_spec(layer, fields) for layer in data.layers],
        "arm": build_arm_spec(data),
    }


def build_arm_spec(data: MapPageData) -> Spec:
    """Return the arm at q = 0 for the stick figure, mm.

    Args:
        data: The data of the page.
    """
    a = data.arm
    mm = LENGTH.factor
    return {
        "joints": list(a.joints),
        "axis": [round_for_json(v, 9) for v in a.axis],
        "point": [round_for_json(v * mm, 7) for v in a.point],
        "base": round_for_json(a.base * mm, 7),
        "up": round_for_json(a.up, 9),
        "flange": round_for_json(a.flange * mm, 7),
        "tcp": round_for_json(a.tcp * mm, 7),
    }


def _build_layer_spec(layer: MapLayer, fields: Sequence[MapField]) -> Spec:
    angles = np.round(layer.q * ANGLE.factor / ANGLE_LEVEL)
    angles = np.where(np.isfinite(angles), angles, -32768).astype("<i2")
    value: Spec = {}
    for field in fields:
        if field.key in layer.value:
            value[field.key] = pack_field_levels(layer.value[field.key] * field.display_unit.factor)
            if field.key in layer.guess:
                value[field.key]["guess"] = pack_codes(layer.guess[field.key].astype(np.uint8))
    return {
        "name": layer.name,
        "title": layer.title,
        "status": pack_codes(layer.reason),
        "present": [int(c) for c in np.unique(layer.reason)],
        "best": layer.best,
        "q": base64.b64encode(angles.tobytes()).decode("ascii"),
        "value": value,
        "gamma": pack_field_levels(layer.gamma * ANGLE.factor),
        "shortfall": pack_field_levels(layer.shortfall * LENGTH.factor),
    }


def pack_field_levels(values: Array) -> Spec:
    """Return values as 16-bit levels between their extremes; 65535 for NaN. Wide ranges use a logarithmic scale.

    ``from`` and ``to`` are the percentiles 2 and 98, so that single samples near a singularity do not dominate the
    colour scale.

    Args:
        values: Values in displayed units, NaN where there is none.
    """
    known = np.isfinite(values)
    if not known.any():
        return {"level": "", "low": 0.0, "high": 1.0, "log": False, "from": 0.0, "to": 1.0, "median": None}
    v = values[known]
    low, high = float(v.min()), float(v.max())
    log = low > 0 and high > LOG_SCALE_RATIO * low
    a, b = (np.log(low), np.log(high)) if log else (low, high)
    out = np.full(values.shape, 65535, dtype="<u2")
    t = (np.log(v) if log else v) - a
    out[known] = np.round(np.clip(t / ((b - a) or 1.0), 0.0, 1.0) * 65534)
    p2, median, p98 = (float(x) for x in np.percentile(v, [2, 50, 98]))
    return {
        "level": base64.b64encode(out.tobytes()).decode("ascii"),
        "low": low,
        "high": high,
        "log": bool(log),
        "from": p2,
        "to": p98,
        "median": median,
    }


def build_curve_charts(data: MapPageData) -> list[Spec]:
    """Return line charts over one axis: a straight path, or one joint.

    Args:
        data: The data of the page.
    """
    axis = data.axes[0]
    x = axis.values * axis.display_unit.factor
    charts: list[Spec | None] = []
    for layer in data.layers:
        tail = f", {layer.title}{_format_rotation(layer)}" if data.kind == "line" else ""
        charts.append(
            _build_curve_chart(
                data,
                x,
                f"tip-{layer.name}",
                f"Stiffness at the tool tip{tail}",
                [(layer, "k_x"), (layer, "k_y"), (layer, "k_z"), (layer, "k_axial"), (layer, "k_min")],
            )
        )
    charts.append(
        _build_curve_chart(data, x, "deflection", "Deflection under the load", _list_layers(data, "deflection"))
    )
    charts.append(_build_curve_chart(data, x, "dexterity", "Dexterity 1/κ_F", _list_layers(data, "dexterity")))
    first = data.layers[0]
    frame_columns = [(first, "held_x"), (first, "held_y"), (first, "held_z")]
    charts.append(
        _limit_peaks(
            _build_curve_chart(
                data, x, "held", "K_m, other directions fixed (tian2025): peaks are singularities", frame_columns
            )
        )
    )
    charts.append(
        _build_curve_chart(
            data, x, "nu_p", "ν_p, share of the translation that K_C changes", _list_layers(data, "nu_p")
        )
    )
    charts.append(_build_curve_chart(data, x, "nu_r", "ν_r, rotation that K_C changes", _list_layers(data, "nu_r")))
    measured = [(first, f.key) for f in data.fields if f.model]
    model = [(first, f.model) for f in data.fields if f.model]
    charts.append(
        _build_curve_chart(data, x, "measured", "Measured, interpolated, compared with the model", [*measured, *model])
    )
    charts.append(
        _build_curve_chart(data, x, "limits", "Distance to the nearest joint limit", _list_layers(data, "limit_margin"))
    )
    charts.append(_build_joint_chart(data, x, first))
    return [c for c in charts if c is not None]


_QUANTITY = {"N/mm": "Stiffness", "mm": "Deflection", "deg": "Joint angle"}  # by unit, for the axis of a curve


def _limit_peaks(chart: Spec | None) -> Spec | None:
    """Peaks of a singularity reach any height: flat above PEAK times the median, and the title says so."""
    if chart is None:
        return None
    known = [v for s in chart["series"] for v in s["y"] if v is not None]
    most = float(f"{_PEAK * float(np.median(known)):.1g}")
    if max(known) <= most:
        return chart
    series = [{**s, "y": [v if v is None else min(v, most) for v in s["y"]]} for s in chart["series"]]
    return {**chart, "series": series, "title": f"{chart['title']}; cut off at {most:,.0f} {chart['unit']}"}


def _list_layers(data: MapPageData, key: str) -> list[tuple[MapLayer, str]]:
    return [(layer, key) for layer in data.layers]


def _format_rotation(layer: MapLayer) -> str:
    known = layer.gamma[np.isfinite(layer.gamma)]
    return f" = {round(float(np.degrees(known[0])), 1):g}°" if layer.name == "free" and known.size else ""


def _build_curve_chart(
    data: MapPageData, x: Array, name: str, title: str, series: Sequence[tuple[MapLayer, str]]
) -> Spec | None:
    fields = {f.key: f for f in data.fields}
    drawn = [(layer, fields[key]) for layer, key in series if key in fields and np.isfinite(layer.value[key]).any()]
    if not drawn:
        return None
    several = len({layer.name for layer, _ in drawn}) > 1
    unit = drawn[0][1].display_unit
    ys = [layer.value[f.key] * unit.factor for layer, f in drawn]
    lines: list[tuple[str, Array, str, str]] = []
    for (layer, f), y in zip(drawn, ys, strict=True):
        word = f"{layer.title}{_format_rotation(layer)}" if several else f.name
        same = next((i for i, line in enumerate(lines) if np.allclose(line[1], y, rtol=1e-6, equal_nan=True)), None)
        if same is not None and not several:  # the tool axis along z: one line, both names
            lines[same] = (f"{lines[same][0]} and {word.removeprefix('Stiffness ')}", *lines[same][1:])
            continue
        dash = "6 3" if f.model else ""
        lines.append((word, y, COLORS[len(lines) % len(COLORS)], dash))
    return _build_chart(data, x, f"c-{name}", title, lines, unit.name, zero=True)


def _build_joint_chart(data: MapPageData, x: Array, layer: MapLayer) -> Spec | None:
    lines = [(name, layer.q[:, j] * ANGLE.factor, COLORS[j], "") for j, name in enumerate(data.arm.joints)]
    title = f"Joints, {layer.title}" if data.kind == "line" else "Joints"
    return (
        _build_chart(data, x, "c-joints", title, lines, ANGLE.name, zero=False) if np.isfinite(layer.q).any() else None
    )


def _build_chart(
    data: MapPageData,
    x: Array,
    name: str,
    title: str,
    lines: Sequence[tuple[str, Array, str, str]],
    unit: str,
    *,
    zero: bool,
) -> Spec:
    k = select_plot_points([y for _, y, _, _ in lines])
    axis = data.axes[0]
    spec: Spec = {
        "id": name,
        "title": title,
        "group": "curve",
        "x": round_for_json(x[k], 7),
        "unit": unit,
        "height": 240,
        "xname": f"{axis.name} ({axis.display_unit.name})",
        "xlabel": f"{axis.label} ({axis.display_unit.name})",
        "ylabel": f"{_QUANTITY[unit]} ({unit})" if unit in _QUANTITY else unit,
        "xdec": 2,
        "series": [{"name": n, "y": round_for_json(y[k]), "color": c, "dash": d} for n, y, c, d in lines],
    }
    return {**spec, "ymin": 0} if zero else spec
