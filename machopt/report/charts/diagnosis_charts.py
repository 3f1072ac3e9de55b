"""Chart specifications of the diagnosis page: errors per group, residuals over an axis, laws with their readings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.effects.effect_wording import format_place
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding
from machopt.numerics.array_types import Array
from machopt.report.charts.point_reduction import round_for_json
from machopt.report.page_types.diagnosis_page_data import DiagnosisPageData, JobEffect
from machopt.report.wording.diagnosis_terms import (
    describe_axis,
    describe_error_before,
    format_axis_value,
    format_error,
    get_axis_unit,
    has_machine_finding,
)

IndexArray = NDArray[np.intp]
Spec = dict[str, Any]  # JSON for assets/xy.js

BEFORE, AFTER, LAW, GREY = "#d9730d", "#1552b8", "#b3261e", "#7a8490"
BRANCH_STYLES = ((1, "loading", "#1552b8"), (-1, "unloading", "#2c8a57"), (0, "readings", "#1552b8"))
MAX_POINTS = 3000  # readings drawn; residuals.csv holds all
MAX_GROUPS = 400
MIN_READINGS = 12  # different values of an axis: drawn one by one, else in bins of equal count
BIN_COUNT = 16
MIN_IN_BIN = 3
Z_90_PERCENT = 1.645


def build_group_chart(data: DiagnosisPageData) -> Spec | None:
    """Return the chart of the held-out error of each group before and after, worst first; None without groups.

    Args:
        data: The data of the page.
    """
    d = data.diagnosis
    error = d.errors.by_group
    known = np.flatnonzero(np.isfinite(error).all(axis=1)) if len(error) else np.zeros(0, int)
    if not len(known):
        return None
    order = known[np.argsort(-error[known, 0], kind="stable")]
    order = order[_select_points(len(order), MAX_GROUPS)]
    x, factor, unit = np.arange(len(order), dtype=float), *_choose_error_unit(d.unit, error[order])
    before, after = factor * error[order].T
    names = [data.group_names[g] for g in order]
    found = has_machine_finding(d)
    labels = [
        [
            [data.group_word, n],
            ["before" if found else "error", format_error(b / factor, d.unit)],
            *([["after", format_error(a / factor, d.unit)]] if found else []),
        ]
        for n, b, a in zip(names, before, after, strict=True)
    ]
    layers: list[Spec] = []
    if math.isfinite(d.noise_floor):
        ends, level = [-0.5, len(order) - 0.5], [factor * d.noise_floor] * 2
        layers.append(
            {"type": "line", "color": LAW, "dash": "6 4", "name": "noise floor", "x": ends, "y": level, "width": 1.2}
        )
    marks: Spec = {"type": "points", "size": 3.2, "x": round_for_json(x), "labels": labels}
    first: Spec = {**marks, "name": describe_error_before(d), "color": BEFORE, "hollow": True}
    layers.append({**first, "y": round_for_json(before)})
    if found:
        low, high = np.minimum(before, after), np.maximum(before, after)
        layers[-1] |= {"lo": round_for_json(low), "hi": round_for_json(high)}
        layers.append({**marks, "name": "with the findings", "color": AFTER, "y": round_for_json(after)})
    return {
        "id": "d-groups",
        "title": f"Held-out error of each {data.group_word}, worst first",
        "ymin": 0,
        "height": 270,
        "xlabel": data.group_word.capitalize(),
        "ylabel": f"rms error ({unit})",
        "xcats": names,
        "layers": layers,
    }


@dataclass(frozen=True)
class _ErrorSeries:
    """Size of the residual of N readings, before or after the findings."""

    name: str
    size: Array  # (N,)
    color: str
    hollow: bool
    offset: float  # of the points along the axis, where it has few values


def _list_error_series(d: DiagnosisResult, before: Array, after: Array) -> list[_ErrorSeries]:
    """Return the residuals before and, where a finding of the machine exists, after."""
    if not has_machine_finding(d):
        return [_ErrorSeries(describe_error_before(d), before, BEFORE, True, 0.0)]
    return [
        _ErrorSeries(describe_error_before(d), before, BEFORE, True, -0.12),
        _ErrorSeries("with the findings", after, AFTER, False, 0.12),
    ]


def _build_rms_layer(
    series: _ErrorSeries, at: Array, good: NDArray[np.intp], *, few: bool, has_two: bool
) -> list[Spec]:
    """Return the layer of the rms per value or bin; empty where there are too few readings for one."""
    x, mean = compute_binned_rms(at[good], series.size[good], few=few)
    if len(x) < (1 if few else 2):
        return []  # a legend would name a line that is not drawn
    return [
        {
            "type": "points" if few else "line",
            "name": f"rms, {'before' if series.color == BEFORE else 'after'}" if has_two else "rms",
            "color": series.color,
            "width": 2.4,
            "size": 5,
            "mark": "diamond",
            "x": round_for_json(x + (series.offset if few else 0.0)),
            "y": round_for_json(mean),
        }
    ]


def build_axis_chart(data: DiagnosisPageData, axis: str, spec_id: str) -> Spec | None:
    """Return the chart of the held-out residual over one axis: readings, and their rms per value or bin.

    Args:
        data: The data of the page.
        axis: Name of the axis of the data.
        spec_id: Id of the chart in the page.
    """
    d = data.diagnosis
    factor, unit_x = get_axis_unit(axis)
    name = f"{describe_axis(axis)} ({unit_x})" if unit_x else describe_axis(axis)
    values = factor * np.asarray(d.axes[axis], float)
    before, after, unit, whose = compute_reading_errors(data)
    good = np.flatnonzero(d.used & np.isfinite(values) & np.isfinite(before) & np.isfinite(after))
    if len(good) < 2 * MIN_IN_BIN:
        return None
    good = good[np.argsort(values[good], kind="stable")]
    different = np.unique(values[good])
    if len(different) < 2:
        return None
    few = len(different) <= MIN_READINGS
    at = np.searchsorted(different, values).astype(float) if few else values
    series = _list_error_series(d, before, after)
    drawn = good[_select_points(len(good), MAX_POINTS)]
    layers: list[Spec] = []
    for one in series:
        drawn_x = round_for_json(at[drawn] + (one.offset if few else 0.0))
        marks: Spec = {"type": "points", "name": one.name, "color": one.color, "hollow": one.hollow, "size": 1.6}
        layers.append(
            {**marks, "x": drawn_x, "y": round_for_json(one.size[drawn]), "labels": _list_reading_labels(data, drawn)}
        )
    for one in series:
        layers += _build_rms_layer(one, at, good, few=few, has_two=len(series) > 1)
    spec: Spec = {
        "id": spec_id,
        "title": f"Size of the residual{whose} over {describe_axis(axis)}",
        "ymin": 0,
        "height": 270,
        "xlabel": name[:1].upper() + name[1:],
        "ylabel": f"Held-out residual, rms ({unit})",
        "layers": layers,
    }
    if few:
        spec["xcats"] = [format_axis_value(axis, v, "") for v in different.tolist()]
    return spec


def compute_reading_errors(data: DiagnosisPageData) -> tuple[Array, Array, str, str]:
    """Return the rms error of each reading before and after, the displayed unit, and whose coordinates these are.

    For joints of a motion only one joint counts: the one with a finding, else the one with the largest residuals. The
    other joints would hide it.

    Args:
        data: The data of the page.

    Returns:
        (N,) before, (N,) after, unit, name of the coordinates.
    """
    d = data.diagnosis
    main = [n for n, c in enumerate(data.coordinates) if c.main]
    whose = ""
    ranked = [f.location for f in d.findings]
    ranked += [s.axis for s in sorted(d.mismatch, key=lambda s: -s.share) if s.kind == "machine"]
    for location in ranked:
        own = [n for n in main if data.coordinates[n].name == format_place(location)]
        if own:
            main, whose = own, f" of {format_place(location)}"
            break
    scale = np.array([data.coordinates[n].factor for n in main]) / math.sqrt(len(main))
    before, after = (np.linalg.norm(r[:, main] * scale, axis=1) for r in (d.errors.residual, d.errors.final))
    factor, unit = _choose_error_unit(d.unit, before)
    return factor * before, factor * after, unit, whose


def _list_reading_labels(data: DiagnosisPageData, rows: IndexArray) -> list[list[list[str]]]:
    """The line and the group of each reading, shown at its point."""
    return [[["line", str(data.line[n])], [data.group_word, str(data.pose[n])]] for n in rows]


def build_law_chart(data: DiagnosisPageData, n: int, f: Finding) -> Spec | None:
    """Return the chart of a missing law: the readings and the fitted law.

    Args:
        data: The data of the page.
        n: Number of the finding.
        f: The finding.
    """
    c = f.curve
    if c is None or f.curve_residual is None:
        return None
    value = c.per_reading + f.curve_residual
    good = data.diagnosis.used & np.isfinite(value) & np.isfinite(c.data_x)
    if not good.any():
        return None
    low, high = compute_value_range(value[good], c.law)
    inside = good & (value >= low) & (value <= high)
    layers: list[Spec] = []
    branch = data.branch if data.branch is not None else np.zeros(len(value), np.int8)
    parts = [(name, color, inside & (branch == code), good & (branch == code)) for code, name, color in BRANCH_STYLES]
    parts = [p for p in parts if p[3].any()]
    for name, color, here, _ in parts:
        rows = np.flatnonzero(here)
        rows = rows[_select_points(len(rows), MAX_POINTS // len(parts))]
        marks: Spec = {"type": "points", "name": name, "color": color, "hollow": True, "size": 1.8}
        x, y = round_for_json(c.data_x[rows]), round_for_json(value[rows])
        layers.append({**marks, "x": x, "y": y, "labels": _list_reading_labels(data, rows)})
    for name, color, _, here in parts:
        at, mean, half = compute_binned_median(c.data_x[here], value[here])
        if len(at) > 1:
            mark: Spec = {"type": "points", "name": f"{name}, averaged", "color": color, "mark": "diamond"}
            ends = {"lo": round_for_json(mean - half), "hi": round_for_json(mean + half)}
            layers.append({**mark, "size": 4, "bar": 2, "x": round_for_json(at), "y": round_for_json(mean), **ends})
    order = _select_points(len(c.x), MAX_POINTS)
    layers.append(
        {
            "type": "line",
            "name": f"fitted law: {f.law}",
            "color": LAW,
            "width": 2.4,
            "x": round_for_json(c.x[order]),
            "y": round_for_json(c.law[order]),
        }
    )
    left = int(good.sum() - inside.sum())
    more = f"; {left} reading{'s lie' if left > 1 else ' lies'} outside the picture" if left else ""
    return {
        "id": f"d-law{n}",
        "title": f"What the readings show, and the fitted law{more}",
        "height": 340,
        "xlabel": c.x_label[:1].upper() + c.x_label[1:],
        "ylabel": c.y_label[:1].upper() + c.y_label[1:],
        "hlines": [{"y": 0, "class": "axis", "fit": True}],
        "layers": layers,
    }


def compute_value_range(value: Array, line: Array) -> tuple[float, float]:
    """Return the value range of a chart: the law and all but the farthest readings.

    Args:
        value: (N,) readings.
        line: (L,) values of the fitted law.
    """
    q1, q3 = np.percentile(value, [25, 75])
    low, high = np.percentile(value, [1, 99])
    reach = 3.0 * (q3 - q1)
    line = line[np.isfinite(line)]
    ends = (float(line.min()), float(line.max())) if len(line) else (math.inf, -math.inf)
    room = 0.15 * (high - low)
    return min(max(float(low), float(q1 - reach)) - room, ends[0]), max(
        min(float(high), float(q3 + reach)) + room, ends[1]
    )


def compute_binned_rms(x: Array, size: Array, *, few: bool) -> tuple[Array, Array]:
    """Return mean x and root mean square of ``size`` per value of x, or per bin of equal count.

    Args:
        x: (N,) sorted positions on the axis.
        size: (N,) residuals.
        few: X has few distinct values: one bin for each.
    """
    parts = _split_bins(x, few)
    return np.array([x[p].mean() for p in parts]), np.array([math.sqrt(np.mean(size[p] ** 2)) for p in parts])


def compute_binned_median(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return x, median of ``y`` and half width of its 90 % interval per bin; asymptotic, from the quartiles.

    Args:
        x: (N,) positions on the axis.
        y: (N,) values.
    """
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    parts = [p for p in _split_bins(x, len(np.unique(x)) <= MIN_READINGS) if len(p) >= MIN_IN_BIN]
    middle = np.array([np.median(y[p]) for p in parts])
    spread = np.array([np.subtract(*np.percentile(y[p], [75, 25])) / 1.349 for p in parts])
    count = np.array([len(p) for p in parts])
    # the median of a normal sample of n has the variance π/2 · σ²/n
    half = Z_90_PERCENT * spread * np.sqrt(0.5 * np.pi / np.maximum(count, 1)) if parts else np.zeros(0)
    return np.array([np.median(x[p]) for p in parts]), middle, half


def build_job_charts(job: JobEffect) -> list[Spec]:
    """Return the charts of rotation and predicted deflection along the toolpath.

    Args:
        job: Effect of the diagnosis on a toolpath.
    """
    sets: list[tuple[str, str, str, list[tuple[str, Array, str, str]]]] = [
        (
            "d-gamma",
            "Chosen rotation of the tool",
            "γ (deg)",
            [("before", job.gamma_before, BEFORE, "5 4"), ("with what was found", job.gamma_after, AFTER, "")],
        ),
        (
            "d-deflection",
            "Predicted deflection",
            "Deflection (mm)",
            [
                ("old choice, old model", job.deflection_before, GREY, "2 3"),
                ("old choice, new model", job.deflection_unchanged, BEFORE, "5 4"),
                ("new choice, new model", job.deflection_after, AFTER, ""),
            ],
        ),
    ]
    out = []
    for name, title, label, curves in sets:
        layers = []
        for what, values, color, dash in curves:
            if len(values) and len(values) == len(job.point):
                pick = _select_points(len(values), MAX_POINTS)
                layers.append(
                    {
                        "type": "line",
                        "name": what,
                        "color": color,
                        "dash": dash,
                        "width": 1.8,
                        "x": round_for_json(job.point[pick]),
                        "y": round_for_json(values[pick]),
                    }
                )
        if layers:
            out.append(
                {
                    "id": name,
                    "title": title,
                    "xlabel": "Point of the toolpath",
                    "ylabel": label,
                    "height": 240,
                    "layers": layers,
                }
            )
    return out


def _split_bins(x: Array, few: bool) -> list[IndexArray]:
    """Indices of sorted ``x`` by value, or in bins of equal count that never part equal values."""
    if few:
        return np.split(np.arange(len(x)), np.flatnonzero(np.diff(x)) + 1)
    bins = min(
        BIN_COUNT, max(len(x) // (MIN_IN_BIN + 1), 1)
    )  # equal values stay together, so some hold less than others
    cuts = np.unique(np.searchsorted(x, x[np.linspace(0, len(x) - 1, bins + 1)[1:-1].astype(int)]))
    return [p for p in np.split(np.arange(len(x)), cuts) if len(p) >= MIN_IN_BIN]


def _select_points(n: int, most: int) -> IndexArray:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int)) if n else np.zeros(0, int)


def _choose_error_unit(unit: str, values: Array) -> tuple[float, str]:
    """Factor and unit to draw errors in: µm where they are small."""
    finite = values[np.isfinite(values)]
    small = unit == "mm" and (not len(finite) or float(np.percentile(np.abs(finite), 90)) < 0.5)
    return (1e3, "µm") if small else (1.0, unit)
