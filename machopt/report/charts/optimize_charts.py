"""Chart specifications of the optimize report in displayed units; the page's script only draws them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.report.charts.chart_colours import CHOSEN, DEFAULT, FOURTH, JIAO, LIMIT, Spec
from machopt.report.charts.motion_charts import MAX_MARKS, build_motion_charts
from machopt.report.charts.point_reduction import pack_codes, pack_levels, round_for_json, select_plot_points
from machopt.report.charts.scene_json import (
    build_motion_spec,
    build_path_spec,
    build_scene_spec,
    build_stations_spec,
    pack_floats,
)
from machopt.report.page_types.display_units import (
    ANGLE,
    FINE_LENGTH,
    FORCE,
    LENGTH,
    QUANTITY_LABELS,
    QUANTITY_UNITS,
    STIFFNESS,
    DisplayUnit,
)
from machopt.report.page_types.map_sample_states import PlaceCode
from machopt.report.page_types.optimize_page_data import STATUS_NAMES, OperationRow, PathSeries, ReportData, RotationMap
from machopt.report.scene.scene_types import OptimizeScene

_MAP_STATIONS = 2000  # more than the pixels of the map
_BANDS = 60  # most operations that are shaded


def build_figure_specs(data: ReportData) -> Spec:
    """Return every chart that the data allow: ``{"charts": […], "map": … or None}``.

    Args:
        data: The data of the page.
    """
    charts: list[Spec] = []
    if data.path is not None and len(data.path.s):
        charts += _build_path_charts(data, data.path)
    if data.motion is not None and len(data.motion.time):
        charts += build_motion_charts(data.motion, data.dips)
    out: Spec = {"charts": charts, "map": None}
    if data.map is not None:
        out["map"] = _build_map_spec(data, data.map)
    if data.path is not None and data.path.phi is not None and data.path.gamma is not None:
        out["rotation"] = {
            "phi": pack_floats(data.path.phi * ANGLE.factor),
            "gamma": pack_floats(data.path.gamma * ANGLE.factor),
        }
    if data.view is not None:
        out["view"] = _build_view_spec(data.view, data.map) | {
            "start": _choose_start_point(data),
            "reasons": _list_point_reasons(data),
        }
    return out


def format_reason_with_distance(reason: str, shortfall: str) -> str:
    """Return a reason with its distance, without repetition: "38 mm out of reach at every rotation".

    Args:
        reason: Reason why the point is infeasible.
        shortfall: Missing distance as text; empty where there is none.
    """
    if not shortfall or shortfall.split(" mm", maxsplit=1)[0] in reason.split():
        return reason
    return reason.replace("out of reach", shortfall, 1) if "out of reach" in reason else f"{reason}, {shortfall}"


def _list_point_reasons(data: ReportData) -> list[Spec]:
    """Why points have no answer, for the picture's words."""
    return [
        {
            "point": p.point,
            "reason": format_reason_with_distance(p.reason or p.status, p.shortfall),
            "help": p.help or "–",
            "at": round_for_json(p.position * LENGTH.factor),
        }
        for p in data.infeasible[:MAX_MARKS]
    ]


def _choose_start_point(data: ReportData) -> int | None:
    """The point the picture opens at: where the result is decided."""
    points = [*(p.point for p in data.infeasible[:1]), *(w.point for w in data.worst[:1])]
    return points[0] if points else None


def _build_view_spec(view: OptimizeScene, m: RotationMap | None) -> Spec:
    stations = None if view.stations is None or m is None else build_stations_spec(view.stations, _select_stations(m))
    return {
        "scene": build_scene_spec(view.scene),
        "path": build_path_spec(view.path),
        "stations": stations,
        "motion": None if view.motion is None else build_motion_spec(view.motion),
        "corrected": view.corrected,
    }


def _select_stations(m: RotationMap) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, len(m.s) - 1, min(len(m.s), _MAP_STATIONS)).round().astype(np.intp))


def _build_map_spec(data: ReportData, m: RotationMap) -> Spec:
    unit, words = QUANTITY_UNITS[data.summary.quantity], QUANTITY_LABELS[data.summary.quantity]
    pick = _select_stations(m)
    status = m.status[pick]
    index = np.where(np.isin(status, (PlaceCode.OK, PlaceCode.NOT_CHECKED)), m.index[pick] * unit.factor, np.nan)
    known = index[np.isfinite(index)]
    lowest, highest = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    # single places near a singularity must not dominate the colour scale
    low, high = (float(v) for v in np.percentile(known, [2, 98])) if known.size else (0.0, 1.0)
    lines = [
        ("CAM default", m.cam_default, "#ff4d4d", "#ffffff", 1.8, "7 4"),
        ("Jiao 2022", m.jiao2022, "#ff9f1c", "#20242a", 2.2, "9 3"),
        ("chosen", m.chosen, "#ffffff", "#000000", 2.6, ""),
    ]
    if m.before is not None:
        lines.insert(2, ("before", m.before, "#ff7ad9", "#20242a", 2.2, "2 3"))
    return {
        "id": "map",
        "title": "map",
        "group": "path",
        "xlabel": "Path length (mm)",
        "stations": len(pick),
        "rotations": len(m.rotation),
        "s": round_for_json(m.s[pick] * LENGTH.factor, 7),
        "rank": list(range(len(pick))),
        "point": round_for_json(m.point[pick], 9),
        "rotation": round_for_json(m.rotation * ANGLE.factor),
        "offset": None if m.offset is None else round_for_json(m.offset[pick] * ANGLE.factor),
        "index": pack_levels(index, lowest, highest),
        "lowest": lowest,
        "highest": highest,
        "known": bool(known.size),
        "from": low,
        "to": high,
        "large_is_good": words.large_is_good,
        "status": pack_codes(status),
        "present": [int(c) for c in np.unique(status)],
        "names": list(STATUS_NAMES),
        "label": words.axis.lower(),
        "unit": unit.name,
        "by_point": _is_sparse(m.s),
        "lines": [
            {
                "name": name,
                "y": round_for_json(_wrap_rotation(line[pick], m.rotation) * ANGLE.factor),
                "color": color,
                "casing": casing,
                "width": width,
                "dash": dash,
            }
            for name, line, color, casing, width, dash in lines
            if np.isfinite(line).any()
        ],
    }


def _is_sparse(s: Array) -> bool:
    """True where a few long steps (drilling) would squeeze the stations into slivers."""
    step = np.diff(s)
    return len(step) > 2 and float(np.median(step)) < 0.2 * float(step.mean())


def _wrap_rotation(gamma: Array, rotation: Array) -> Array:
    """Gamma turned by whole turns into the map's range."""
    middle = (rotation[0] + rotation[-1]) / 2 if len(rotation) else 0.0
    turned: Array = gamma - 2 * np.pi * np.round((gamma - middle) / (2 * np.pi))
    return turned


ChartLine = tuple[str, Array, str, str]  # name, values in displayed units, colour, dashes


def _build_path_charts(data: ReportData, p: PathSeries) -> list[Spec]:
    along = _PathChartBuilder(p, _build_operation_bands(p, data.operations))
    own = data.summary.quantity == "deflection"  # then the tolerance belongs into the first picture
    tolerance: ChartLine = ("tolerance", p.tolerance * FINE_LENGTH.factor, LIMIT, "8 4")
    charts = [_build_index_chart(data, along, [tolerance] if own else [])]
    if not own:
        lines = [tolerance, _build_line(FINE_LENGTH, "predicted deflection", p.deflection)]
        charts.append(along.build_chart("c-deflection", "Predicted deflection", "Deflection (mm)", FINE_LENGTH, lines))
    charts.append(_build_stiffness_chart(along))
    if p.shift is not None:
        charts.append(_build_shift_chart(along, p.shift))
    lines = [_build_line(LENGTH, "clearance", p.clearance)]
    charts.append(along.build_chart("c-clearance", "Clearance to the nearest body", "Clearance (mm)", LENGTH, lines))
    charts.append(_build_margin_chart(along))
    charts += _build_tolerance_charts(data, along)
    return [c for c in charts if c is not None]


def _build_line(unit: DisplayUnit, name: str, values: Array, color: str = CHOSEN, dash: str = "") -> ChartLine:
    return name, values * unit.factor, color, dash


def _build_index_chart(data: ReportData, along: _PathChartBuilder, first: Sequence[ChartLine]) -> Spec | None:
    unit, words, p = QUANTITY_UNITS[data.summary.quantity], QUANTITY_LABELS[data.summary.quantity], along.p
    lines = [
        *first,
        _build_line(unit, "CAM default", p.index_default, DEFAULT, "6 3"),
        _build_line(unit, "Jiao 2022", p.index_jiao2022, JIAO, "4 2"),
        _build_line(unit, "chosen", p.index_chosen),
    ]
    axis = f"{words.axis} ({unit.name})" if unit.name else words.axis
    return along.build_chart("c-index", f"{words.axis} along the toolpath: {words.better}", axis, unit, lines)


def _build_stiffness_chart(along: _PathChartBuilder) -> Spec | None:
    p = along.p
    lines = [
        _build_line(STIFFNESS, "K_fd, Jiao 2022 (fixed orientation)", p.k_jiao2022, JIAO, "4 2"),
        _build_line(STIFFNESS, "axial, at the tip", p.k_axial),
        _build_line(STIFFNESS, "normal, at the tip", p.k_normal, FOURTH),
    ]
    return along.build_chart("c-stiffness", "Stiffness of the chosen posture", "Stiffness (N/µm)", STIFFNESS, lines)


def _build_shift_chart(along: _PathChartBuilder, shift: Array) -> Spec | None:
    lines = [
        _build_line(FINE_LENGTH, axis, shift[:, n], color, dash)
        for n, (axis, color, dash) in enumerate((("x", CHOSEN, ""), ("y", JIAO, "4 2"), ("z", FOURTH, "")))
    ]
    title = "Commanded path less programmed path, in workpiece axes"
    return along.build_chart("c-shift", title, "Shift (mm)", FINE_LENGTH, lines, from_zero=False)


def _build_margin_chart(along: _PathChartBuilder) -> Spec | None:
    lines = [
        _build_line(ANGLE, "to the nearest joint limit", along.p.limit_margin),
        _build_line(ANGLE, "to the nearest singularity", along.p.singularity, JIAO),
    ]
    return along.build_chart("c-margins", "Margins in angle", "Margin (deg)", ANGLE, lines)


def _build_tolerance_charts(data: ReportData, along: _PathChartBuilder) -> list[Spec | None]:
    """Return the error against the tolerance band, and the force along the path."""
    if data.tolerances is None or data.tolerances.series is None:
        return []
    t = data.tolerances.series
    error_lines = [
        _build_line(FINE_LENGTH, "tolerance +", t.limit, LIMIT, "8 4"),
        _build_line(FINE_LENGTH, "tolerance −", -t.limit, LIMIT, "8 4"),
        _build_line(FINE_LENGTH, "5 %", t.lower, DEFAULT, "4 2"),
        _build_line(FINE_LENGTH, "95 %", t.upper, DEFAULT, "4 2"),
        _build_line(FINE_LENGTH, "nominal", t.error),
    ]
    force_lines = [
        (name, t.force[:, n], color, dash)
        for n, (name, color, dash) in enumerate(
            (("along travel", CHOSEN, ""), ("normal to it", JIAO, "4 2"), ("along the tool axis", FOURTH, ""))
        )
    ]
    error_title = "Predicted error against the tolerance: across holes, normal to surfaces"
    force_title = "Mean cutting force on the tool at the feed that is reached"
    return [
        along.build_chart("c-error", error_title, "Error (mm)", FINE_LENGTH, error_lines, from_zero=False),
        along.build_chart("c-force", force_title, "Force (N)", FORCE, force_lines, from_zero=False),
    ]


@dataclass(frozen=True)
class _PathChartBuilder:
    """Pictures over path length, with point, operation and nearest pair in their tooltips."""

    p: PathSeries
    bands: list[Spec]

    def build_chart(
        self,
        name: str,
        title: str,
        ylabel: str,
        unit: DisplayUnit,
        lines: Sequence[ChartLine],
        *,
        from_zero: bool = True,
    ) -> Spec | None:
        """One of them; None without numbers."""
        p, bands = self.p, self.bands
        lines = [line for line in lines if np.isfinite(line[1]).any()]
        if not lines:
            return None
        k = select_plot_points([y for _, y, _, _ in lines])
        pairs = list(dict.fromkeys(p.nearest_pair)) if name == "c-clearance" else []
        number = {pair: i for i, pair in enumerate(pairs)}
        extra: list[Spec] = [{"name": "point", "names": [int(i) for i in k], "at": list(range(len(k)))}]
        if bands:
            extra.append(
                {"name": "operation", "names": _build_band_labels(bands), "at": [int(o) for o in p.operation[k]]}
            )
        if pairs:
            extra.append({"name": "nearest", "names": pairs, "at": [number[p.nearest_pair[i]] for i in k]})
        return {
            "id": name,
            "title": title,
            "group": "path",
            "x": round_for_json(p.s[k] * LENGTH.factor, 7),
            "xname": "path length (mm)",
            "xlabel": "Path length (mm)",
            "ylabel": ylabel,
            "unit": unit.name,
            "bands": bands,
            **({"ymin": 0} if from_zero else {}),
            "labels": bool(bands),
            "extra": extra,
            "series": [{"name": n, "y": round_for_json(y[k]), "color": c, "dash": d} for n, y, c, d in lines],
        }


def _build_band_labels(bands: list[Spec]) -> dict[int, str]:
    return {band["number"]: band["label"] for band in bands}


def _build_operation_bands(p: PathSeries, operations: tuple[OperationRow, ...]) -> list[Spec]:
    """Return the path length range of each operation; none where there are too many to distinguish."""
    cuts = np.flatnonzero(np.diff(p.operation)) + 1
    if not operations or len(cuts) + 1 > _BANDS:
        return []
    starts, stops = [0, *cuts.tolist()], [*cuts.tolist(), len(p.s)]
    s = p.s * LENGTH.factor
    return [
        {
            "from": float(s[max(a - 1, 0)]),
            "to": float(s[b - 1]),
            "number": int(p.operation[a]),
            "label": operations[p.operation[a]].label if 0 <= p.operation[a] < len(operations) else "",
        }
        for a, b in zip(starts, stops, strict=True)
    ]
