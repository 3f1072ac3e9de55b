"""Summary of a toolpath for tables, pages and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array

if TYPE_CHECKING:
    from machopt.data_types.documents.inspect_documents import InspectedToolpathDocument


def summarise_toolpath(toolpath: Toolpath) -> InspectedToolpathDocument:
    """Summarise a toolpath: points, operations, feeds, extent and unknown words.

    Args:
        toolpath: The toolpath, SI units.

    Returns:
        The document (mm, mm/min, degrees).
    """
    from machopt.data_types.documents.inspect_documents import InspectedToolpathDocument

    return InspectedToolpathDocument.model_validate(compute_summary_values(toolpath))


def compute_summary_values(toolpath: Toolpath) -> dict[str, object]:
    """Compute the values of :func:`summarise_toolpath`.

    To print them as text, pydantic is not needed, which is slow to import.

    Args:
        toolpath: The toolpath, SI units.

    Returns:
        Key → value (mm, mm/min, degrees).
    """
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
                "feed_mm_min": _compute_range(feeds),
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
        "moves": {m.word: int((t.move == m).sum()) for m in MoveKind},
        "length_mm": {m.word: round(float(step[t.move == m].sum()), 3) for m in MoveKind},
        "operations": tuple(operations),
        "extent_mm": _compute_box(p),
        "cutting_extent_mm": _compute_box(p[cut]),
        "feed_mm_min": _compute_range(t.feed[cut] * 60e3),
        "tilt_deg": _compute_range(tilt),
        "events": {k: sum(e.kind == k for e in t.events) for k in sorted({e.kind for e in t.events})},
        "ignored": [vars(w) for w in t.ignored],
        "incomplete": t.meta.get("incomplete"),
        "warnings": t.warnings,
    }


def _compute_range(values: Array) -> tuple[float, float] | None:
    known = values[np.isfinite(values)]
    return (round(float(known.min()), 4), round(float(known.max()), 4)) if len(known) else None


def _compute_box(positions: Array) -> dict[str, tuple[float, ...]]:
    return {"min": _round_values(positions.min(axis=0)), "max": _round_values(positions.max(axis=0))}


def _round_values(values: Array) -> tuple[float, ...]:
    return tuple(round(float(v), 4) + 0.0 for v in values)
