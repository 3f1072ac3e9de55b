"""Columns of map.csv."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.output.tables.map_table import MapColumn
from machopt.workspace_map.document import (
    COLUMN_SUFFIXES,
    DEG,
    MM,
    MapLayerResult,
    build_column_name,
    compute_sample_positions,
    convert_to_map_frame,
)
from machopt.workspace_map.measured_stiffness import MeasuredComparison
from machopt.workspace_map.request import MapOptions
from machopt.workspace_map.sample_grid import MapSamples


def build_map_columns(
    samples: MapSamples,
    layer: MapLayerResult,
    options: MapOptions,
    map_layer_result: MapLayerResult,
    comparison: MeasuredComparison | None,
) -> list[MapColumn]:
    """Return the columns of one layer's table, one row for each sample, the last axis fastest.

    Args:
        samples: Sample positions of the map.
        layer: Results of the layer.
        options: Options of the map.
        map_layer_result: Results of the layer with given rotation about the tool axis.
        comparison: Comparison with measured stiffness; None without measurements.
    """
    p, v = layer.postures, layer.values
    axis = -convert_to_map_frame(v.T_base_tcp, options)[:, :3, 2]
    columns = [MapColumn("sample", [str(i) for i in range(len(samples))])]
    if samples.kind == "line":
        columns.append(MapColumn("s_mm", samples.axes[0].values * MM, decimals=4))
    place = compute_sample_positions(samples, layer, options)
    columns += [MapColumn(f"{c}_mm", place[:, i] * MM, decimals=4) for i, c in enumerate("xyz")]
    columns += [MapColumn(c, axis[:, i]) for i, c in enumerate("ijk")]
    columns.append(MapColumn("gamma_deg", p.gamma * DEG))
    columns.append(MapColumn("branch", ["" if b < 0 else str(b) for b in p.branch.tolist()]))
    joints = p.q if samples.q is None else samples.q
    columns += [MapColumn(f"q{i + 1}_deg", joints[:, i] * DEG) for i in range(6)]
    columns += [
        MapColumn(build_column_name(f), v.value[f.key] * COLUMN_SUFFIXES[f.unit][1], digits=7) for f in v.fields
    ]
    if v.softest is not None:
        columns += [MapColumn(f"soft_{c}", v.softest[:, i]) for i, c in enumerate("ijk")]
    if v.is_in_grid is not None:
        known = p.ok.tolist()
        words = [
            ("grid" if g else "constant") if ok else "" for g, ok in zip(v.is_in_grid.tolist(), known, strict=True)
        ]
        columns.append(MapColumn("stiffness_from", words))
    if samples.q is None:
        columns.append(MapColumn("postures", [str(n) for n in p.count.tolist()]))
        columns.append(MapColumn("rotations_percent", p.rotations * 100, decimals=1))
        columns.append(MapColumn("shortfall_mm", np.where(p.shortfall > 0, p.shortfall * MM, np.nan), decimals=1))
    if comparison is not None:
        for f, c in enumerate(comparison.axes):
            columns.append(MapColumn(f"measured_k{c}_N_mm", comparison.spread.value[:, f] * 1e-3, digits=7))
        columns.append(MapColumn("measured_nearest_mm", comparison.spread.nearest * MM, decimals=1))
        inside = zip(comparison.spread.inside.tolist(), np.isfinite(comparison.spread.nearest).tolist(), strict=True)
        columns.append(MapColumn("measured_hull", [("inside" if i else "outside") if k else "" for i, k in inside]))
    columns.append(MapColumn("reason", [InfeasibilityReason(r).word for r in p.reason.tolist()]))
    return columns
