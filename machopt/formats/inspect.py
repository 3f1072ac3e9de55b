"""What a toolpath holds, as plain values for a table or JSON."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.domain.toolpath import Move, Toolpath


def summarise(toolpath: Toolpath) -> dict[str, object]:
    """Points, operations, feeds, extent and unknown words of a toolpath (JSON-able; mm, mm/min, degrees)."""
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
        "operations": operations,
        "extent_mm": {"min": _rounded(p.min(axis=0)), "max": _rounded(p.max(axis=0))},
        "cutting_extent_mm": {"min": _rounded(p[cut].min(axis=0)), "max": _rounded(p[cut].max(axis=0))},
        "feed_mm_min": _range(t.feed[cut] * 60e3),
        "tilt_deg": _range(tilt),
        "events": {k: sum(e.kind == k for e in t.events) for k in sorted({e.kind for e in t.events})},
        "ignored": [
            {"word": w.word, "count": w.count, "first_line": w.first_line, "understood": w.understood}
            for w in t.ignored
        ],
        "incomplete": t.meta.get("incomplete"),
        "warnings": list(t.warnings),
    }


def _range(values: Array) -> list[float] | None:
    known = values[np.isfinite(values)]
    return [round(float(known.min()), 4), round(float(known.max()), 4)] if len(known) else None


def _rounded(values: Array) -> list[float]:
    return [round(float(v), 4) + 0.0 for v in values]
