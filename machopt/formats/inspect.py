"""What a toolpath holds, for a table, a page or JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machopt.arrays import Array
from machopt.domain.toolpath import Move, Toolpath

if TYPE_CHECKING:
    from machopt.domain.results.inspected import ToolpathInspected


def summarise(toolpath: Toolpath) -> ToolpathInspected:
    """Points, operations, feeds, extent and unknown words of a toolpath (mm, mm/min, degrees)."""
    from machopt.domain.results.inspected import ToolpathInspected

    return ToolpathInspected.model_validate(summary_values(toolpath))


def summary_values(toolpath: Toolpath) -> dict[str, object]:
    """The values of :func:`summarise` by their keys: pydantic, slow to import, is not needed to print them as text."""
    t = toolpath
    p = t.position * 1e3
    step = np.linalg.norm(np.diff(p, axis=0, prepend=p[:1]), axis=1)
    tilt = np.degrees(np.arccos(np.clip(t.axis[:, 2], -1.0, 1.0)))
    cut = t.cutting
    operations = []
    order = np.argsort(t.operation, kind="stable")
    bounds = np.searchsorted(t.operation[order], np.arange(len(t.operations) + 1))
    for index, o in enumerate(t.operations):
        mine = order[bounds[index] : bounds[index + 1]]
        feeds = t.feed[mine][cut[mine]] * 60e3
        operations.append(
            {
                "label": o.label,
                "kind": o.kind,
                "tool": o.tool,
                "points": len(mine),
                "cutting_points": int(cut[mine].sum()),
                "feed_mm_min": _range(feeds),
                "first_line": int(t.line[mine[0]]) if len(mine) else None,
            }
        )
    return {
        "source": t.source,
        "format": t.format,
        "sha256": t.sha256,
        "unit": t.meta.get("unit", "mm"),
        "meta": dict(t.meta),
        "points": len(t),
        "moves": {m.word: int((t.move == m).sum()) for m in Move},
        "length_mm": {m.word: round(float(step[t.move == m].sum()), 3) for m in Move},
        "operations": tuple(operations),
        "extent_mm": _box(p),
        "cutting_extent_mm": _box(p[cut]),
        "feed_mm_min": _range(t.feed[cut] * 60e3),
        "tilt_deg": _range(tilt),
        "events": {k: sum(e.kind == k for e in t.events) for k in sorted({e.kind for e in t.events})},
        "ignored": [vars(w) for w in t.ignored],
        "incomplete": t.meta.get("incomplete"),
        "warnings": t.warnings,
    }


def _range(values: Array) -> tuple[float, float] | None:
    known = values[np.isfinite(values)]
    return (round(float(known.min()), 4), round(float(known.max()), 4)) if len(known) else None


def _box(positions: Array) -> dict[str, tuple[float, ...]]:
    return {"min": _rounded(positions.min(axis=0)), "max": _rounded(positions.max(axis=0))}


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(round(float(v), 4) + 0.0 for v in values)
