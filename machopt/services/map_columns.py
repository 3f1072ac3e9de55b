"""The columns of map.csv."""

from __future__ import annotations

import numpy as np

from machopt.domain.reason import Reason
from machopt.formats.fields import Column
from machopt.workspace.asked import MapOptions
from machopt.workspace.measured import Comparison
from machopt.workspace.samples import Samples
from machopt.workspace.told import DEG, MM, SUFFIX, Layer, column_of, in_frame, places


def map_columns(
    samples: Samples, layer: Layer, options: MapOptions, given: Layer, comparison: Comparison | None
) -> list[Column]:
    """The table of one layer, one row a sample, the last axis fastest."""
    p, v = layer.postures, layer.values
    axis = -in_frame(v.T_base_tcp, options)[:, :3, 2]
    columns = [Column("sample", [str(i) for i in range(len(samples))])]
    if samples.kind == "line":
        columns.append(Column("s_mm", samples.axes[0].values * MM, decimals=4))
    place = places(samples, layer, options)
    columns += [Column(f"{c}_mm", place[:, i] * MM, decimals=4) for i, c in enumerate("xyz")]
    columns += [Column(c, axis[:, i]) for i, c in enumerate("ijk")]
    columns.append(Column("gamma_deg", p.gamma * DEG))
    columns.append(Column("branch", ["" if b < 0 else str(b) for b in p.branch.tolist()]))
    joints = p.q if samples.q is None else samples.q
    columns += [Column(f"q{i + 1}_deg", joints[:, i] * DEG) for i in range(6)]
    columns += [Column(column_of(f), v.value[f.key] * SUFFIX[f.unit][1], digits=7) for f in v.fields]
    if v.softest is not None:
        columns += [Column(f"soft_{c}", v.softest[:, i]) for i, c in enumerate("ijk")]
    if v.in_grid is not None:
        known = p.ok.tolist()
        words = [("grid" if g else "constant") if ok else "" for g, ok in zip(v.in_grid.tolist(), known, strict=True)]
        columns.append(Column("stiffness_from", words))
    if samples.q is None:
        columns.append(Column("postures", [str(n) for n in p.count.tolist()]))
        columns.append(Column("rotations_percent", p.rotations * 100, decimals=1))
        columns.append(Column("shortfall_mm", np.where(p.shortfall > 0, p.shortfall * MM, np.nan), decimals=1))
    if comparison is not None:
        for f, c in enumerate(comparison.axes):
            columns.append(Column(f"measured_k{c}_N_mm", comparison.spread.value[:, f] * 1e-3, digits=7))
        columns.append(Column("measured_nearest_mm", comparison.spread.nearest * MM, decimals=1))
        inside = zip(comparison.spread.inside.tolist(), np.isfinite(comparison.spread.nearest).tolist(), strict=True)
        columns.append(Column("measured_hull", [("inside" if i else "outside") if k else "" for i, k in inside]))
    columns.append(Column("reason", [Reason(r).word for r in p.reason.tolist()]))
    return columns
