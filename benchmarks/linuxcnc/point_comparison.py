"""Element by element: machopt's points against the moves of LinuxCNC's interpreter."""

from __future__ import annotations

import math
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linuxcnc.canonical_commands import Array, Canon, Element, interpret
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

PRINTED_MM, PRINTED_INCH = 3e-4, 5e-3  # mm: rs274 prints four decimals of the program's unit
PECK_MM = 0.76  # how far peck clearances differ: 1 mm here, a hundredth of an inch there; a parameter of the control
CONVENTIONS = (  # warnings that say a point depends on the control, and which rule was read
    r"LinuxCNC",
    r"less than a control resolves",
)
_NOT_CARRIED_OUT = r"cutter compensation \(G41, G42\) is not carried out"
_CYCLE = r"G\s*(?:73|8[1-9])(?![\d.])"
_FILLED = "stands only later in the file"


@dataclass(frozen=True)
class Outcome:
    """Of one program: agree | both refuse | only machopt refuses | only rs274 refuses | noted | differ."""

    kind: str
    why: str = ""


def compare(text: str) -> Outcome:
    """Read a program twice."""
    canon = interpret(text)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "program.ngc")
        file.write_text(text, encoding="latin-1")
        try:
            toolpath = read_toolpath(file, unit=_unit(text), default_feed=500 / 60e3, max_extent=1e3)
        except InputError as problem:
            nothing = any(t in problem.reason for t in ("no toolpath points", "no cutting move", "and calls none"))
            if canon.refused or (nothing and all(e.rapid for e in canon.elements)):
                return Outcome("both refuse", problem.reason)
            return Outcome("only machopt refuses", f"{problem.where}: {problem.reason}")
    if canon.refused:
        return Outcome("only rs274 refuses", canon.refused)
    if any(re.search(_NOT_CARRIED_OUT, w) for w in toolpath.warnings):
        return Outcome("noted", "cutter compensation")
    inch = re.search(r"G\s*20(?!\d)", text, re.IGNORECASE) is not None
    why = difference(toolpath, canon, PRINTED_INCH if inch else PRINTED_MM)
    if not why:
        return Outcome("agree")
    tolerance = PRINTED_INCH if inch else PRINTED_MM
    if re.search(_CYCLE, text, re.IGNORECASE) and not difference(toolpath, canon, tolerance, ends_only=True):
        return Outcome("agree but for rapids between holes", why)
    notes = [w for w in toolpath.warnings if any(re.search(c, w) for c in CONVENTIONS)]
    return Outcome("noted", f"{why} [{notes[0]}]") if notes else Outcome("differ", why)


def _unit(text: str) -> str | None:
    return None if re.search(r"G\s*2[01](?!\d)", text, re.IGNORECASE) else "mm"


def difference(toolpath: Toolpath, canon: Canon, tolerance: float, *, ends_only: bool = False) -> str:
    """The first difference of the two, empty where there is none.

    Args:
        toolpath: what machopt read.
        canon: what the interpreter did.
        tolerance: mm.
        ends_only: of rapid moves that follow each other only the last one counts.
    """
    points, moves, elements = toolpath.position * 1e3, toolpath.move.tolist(), list(canon.elements)
    feeds = toolpath.feed
    if ends_only:
        fed = (toolpath.move == MoveKind.CUT) | np.isfinite(feeds)
        kept = np.flatnonzero(fed | np.append(fed[1:], True) | (np.arange(len(fed)) == 0))
        points, moves, feeds = points[kept], [moves[k] for k in kept], feeds[kept]
        pairs = list(zip(elements, [*elements[1:], None], strict=True))
        elements = [e for n, (e, after) in enumerate(pairs) if not (n and e.rapid and after and after.rapid)]
    at, place = 0, None
    if any(_FILLED in w for w in toolpath.warnings):  # rs274 begins at its zero, machopt where the program says so
        while elements and elements[0].rapid and np.linalg.norm(points[0] - elements[0].end) > tolerance:
            elements.pop(0)
    for n, element in enumerate(elements):
        if place is None:
            place = element.end
            if np.linalg.norm(points[0] - place) > tolerance:
                return f"starts at {points[0].round(4)}, rs274 at {place.round(4)}"
            at = 1
            continue
        if element.centre is None and np.linalg.norm(element.end - place) <= tolerance:
            continue  # no way
        while element.centre is None and at < len(points) and np.linalg.norm(points[at] - place) <= tolerance:
            at += 1
        if at >= len(points):
            return f"ends before move {n} of rs274, to {element.end.round(4)}"
        if element.centre is not None:
            at, why = _along_arc(points, at, place, element, tolerance)
            if why:
                return f"move {n}: {why}"
        else:
            off = points[at] - element.end
            peck = (
                moves[at] in (MoveKind.APPROACH, MoveKind.RETRACT)
                and element.rapid
                and np.count_nonzero(abs(off) > tolerance) == 1
            )
            if np.linalg.norm(off) > (PECK_MM if peck else tolerance):
                return f"move {n}: {points[at].round(4)}, rs274 {element.end.round(4)}"
            fed = moves[at] == MoveKind.CUT or math.isfinite(feeds[at])
            if fed == element.rapid:
                return f"move {n}: {'cut' if fed else 'rapid'}, rs274 {'rapid' if element.rapid else 'cut'}"
            at += 1
        place = element.end
    left = [p for p in points[at:] if place is not None and np.linalg.norm(p - place) > tolerance]
    return f"{len(left)} points behind the end of rs274, the first at {left[0].round(4)}" if left else ""


def _along_arc(points: Array, at: int, start: Array, arc: Element, tolerance: float) -> tuple[int, str]:
    """Consume the chords of one arc."""
    assert arc.centre is not None
    u, v = {2: (0, 1), 1: (2, 0), 0: (1, 2)}[arc.normal]
    sense = 1.0 if arc.turns > 0 else -1.0

    def angle(p: Array) -> float:
        return math.atan2(p[v] - arc.centre[v], p[u] - arc.centre[u])  # type: ignore[index]

    def radius(p: Array) -> float:
        return math.hypot(p[u] - arc.centre[u], p[v] - arc.centre[v])  # type: ignore[index]

    r0, r1 = radius(start), radius(arc.end)
    flat = math.hypot(arc.end[u] - start[u], arc.end[v] - start[v])
    sweep = (sense * (angle(arc.end) - angle(start))) % math.tau
    if flat < tolerance or sweep < 1e-9:
        sweep = math.tau
    sweep += (abs(arc.turns) - 1) * math.tau
    done, before = 0.0, angle(start)
    slack = 4.0 * tolerance + abs(r1 - r0)
    while at < len(points):
        p = points[at]
        step = (sense * (angle(p) - before) + math.pi) % math.tau - math.pi
        done, before = done + step, angle(p)
        at += 1
        if not min(r0, r1) - slack <= radius(p) <= max(r0, r1) + slack:
            return at, f"an arc leaves its circle at {p.round(4)} by {radius(p) - r0:.4f}"
        height = start[arc.normal] + (arc.end[arc.normal] - start[arc.normal]) * done / sweep
        if abs(p[arc.normal] - height) > slack + 0.02 * abs(arc.end[arc.normal] - start[arc.normal]):
            return at, f"a helix is at {p.round(4)}, rs274 at height {height:.4f}"
        if np.linalg.norm(p - arc.end) <= 2.0 * tolerance and abs(done - sweep) < 0.02 + 4.0 * tolerance / max(
            r0, 1e-6
        ):
            return at, ""
        if done > sweep + 0.1:
            return at, f"an arc sweeps {math.degrees(done):.1f}°, rs274 {math.degrees(sweep):.1f}°"
    return at, f"an arc does not come to {arc.end.round(4)}"
