"""``CYCLE/…`` statements of the CL dialects.

Keyword forms (NX, CAMWorks, ICAM) name their numbers; positional forms (CATIA's default table, HSM/Fusion) are
depth, then clearance. FEDTO is signed along the tool axis in NX and positive downwards elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from machopt.path_building.drilling_cycles import DrillingCycle, DrillingCycleError
from machopt.path_building.point_collector import Vector
from machopt.toolpath.readers.apt.feed_units import FEED_UNITS
from machopt.toolpath.readers.apt.statement_parser import parse_number

NO_SPEED = frozenset(("INVERS", "INVERSE", "INVTIM", "DPM", "DEGPM"))  # inverse time, degrees a minute of a rotary axis
_DEPTH = ("FEDTO", "DEPTH")
_CLEAR = ("RAPTO", "CLEAR", "RPOINT")
_RETRACT = ("RTRCTO", "RETURN")
_FIRST = ("1STPECK", "STEP1", "PECK", "STEP", "INCR")
_NEXT = ("SUBPECK", "STEP2")
_FLAGS = {"DEEP", "PECKING", "G98", "G99", "ON", "ORIENT", "CAM", "IN", "OUT"}
FEED_OUT = ("BORE", "REAM", "TAP")
NO_HOLES = {  # cycles whose motion is no stroke along the tool
    **dict.fromkeys(("CIRCUL", "POCKET", "CYLNDR", "SLOT"), "mills around"),
    "MILL": "stays at its depth between its points",
    "THREAD": "mills a thread",
    "PROBE": "touches",
    "TURN": "turns",
}
POSITIONAL = ("depth", "clear", "retract")  # CATIA's default table; HSM/Fusion the same


@dataclass(frozen=True, kw_only=True)
class CycleWords:
    """The numbers of one CYCLE statement in the file's unit, None where not given."""

    name: str
    depth: float | None = None  # positive downwards, except NX: height of the bottom
    clear: float | None = None
    retract: float | None = None
    feed: float | None = None
    feed_word: str | None = None
    first_peck: float = 0.0
    next_peck: float = 0.0
    dwell: float = 0.0
    deep: bool = False
    retract_to_start: bool = False  # NX RTRCTO,AUTO: to the height that the tool had before the cycle
    loose: bool = False  # numbers without a word of their own
    unknown: tuple[str, ...] = ()


@dataclass(kw_only=True)
class _CycleFields:
    """Fields of a CYCLE statement, sorted by what they are."""

    values: dict[str, float] = field(default_factory=dict)  # word → number behind it
    feed_word: str | None = None
    loose: list[float] = field(default_factory=list)  # numbers without a word
    unknown: list[str] = field(default_factory=list)
    to_start: bool = False
    is_deep: bool = False


def _sort_fields(parts: list[str]) -> _CycleFields:
    """Sort words and numbers behind the name of a cycle."""
    words = ("DEEP", "BRKCHP")
    found = _CycleFields(is_deep=parts[0].startswith(words) or any(word in parts for word in words))
    values, loose = found.values, found.loose
    k = 1
    while k < len(parts):
        word = parts[k]
        value = parse_number(parts[k + 1]) if k + 1 < len(parts) else None
        k += 1
        plain = parse_number(word)
        if plain is not None:
            loose.append(plain)
        elif word in FEED_UNITS:
            found.feed_word = word
            if value is not None:
                values["FEED"] = value
                k += 1
            elif loose:
                values["FEED"] = loose.pop()
        elif word in (*_DEPTH, *_CLEAR, *_RETRACT, *_FIRST, *_NEXT, "DWELL") and value is not None:
            values[word] = value
            k += 1
        elif word == "RTRCTO" and parts[k : k + 1] == ["AUTO"]:
            found.to_start = True
            k += 1
        elif word == "ORIENT" and value is not None:
            k += 1  # angle of the spindle
        elif word == "PECKING" and k + 1 < len(parts):  # CLT: PECKING, first, following
            first, following = parse_number(parts[k]), parse_number(parts[k + 1])
            if first is not None and following is not None:
                values["1STPECK"], values["SUBPECK"] = first, following
                found.is_deep = True
                k += 2
        elif word and word not in _FLAGS:
            found.unknown.append(word)
    return found


def parse_cycle(parts: list[str], order: tuple[str, ...] = POSITIONAL) -> CycleWords:
    """Read the fields after ``CYCLE/``.

    Args:
        parts: name, then words and numbers.
        order: meaning of numbers without a word, in sequence; words that are given by name are skipped.
    Raises:
        DrillingCycleError: no cycle name.
    """
    if not parts or parse_number(parts[0]) is not None:
        raise DrillingCycleError("a CYCLE statement begins with its name, e.g. DRILL")
    name = parts[0]
    if name in NO_HOLES:
        raise DrillingCycleError(f"CYCLE/{name} {NO_HOLES[name]}: not read; export it as GOTO points")
    fields = _sort_fields(parts)
    values, loose = fields.values, fields.loose
    has_loose = bool(loose)

    def pick(names: tuple[str, ...]) -> float | None:
        return next((values[n] for n in names if n in values), None)

    found = {
        "depth": pick(_DEPTH),
        "clear": pick(_CLEAR),
        "retract": pick(_RETRACT),
        "feed": values.get("FEED"),
        "peck": pick(_FIRST),
        "dwell": values.get("DWELL"),
    }
    for what in order:
        if found[what] is None and loose:
            found[what] = loose.pop(0)
    extra = [f"{v:g}" for v in loose if v not in (found["clear"], found["retract"])]
    return CycleWords(
        name=name,
        depth=found["depth"],
        clear=found["clear"],
        retract=found["retract"],
        feed=found["feed"],
        feed_word=fields.feed_word,
        first_peck=found["peck"] or 0.0,
        next_peck=pick(_NEXT) or 0.0,
        dwell=found["dwell"] or 0.0,
        deep=fields.is_deep,
        retract_to_start=fields.to_start,
        loose=has_loose,
        unknown=(*fields.unknown, *extra),
    )


def build_drilling_cycle(words: CycleWords, *, signed_depth: bool, scale: float, feed: float) -> DrillingCycle:
    """The stroke plan in mm.

    Args:
        words: numbers as read.
        signed_depth: NX: FEDTO is the bottom's height along the tool axis.
        scale: mm per file unit.
        feed: mm/min, NaN where the file gives none.
    Raises:
        DrillingCycleError: depth or clearance is missing.
    """
    if words.depth is None:
        raise DrillingCycleError(f"CYCLE/{words.name} without a depth; expected FEDTO, DEPTH or a first number")
    if words.clear is None:
        raise DrillingCycleError(f"CYCLE/{words.name} without a clearance; expected RAPTO, CLEAR or a second number")
    bottom = words.depth if signed_depth else -words.depth
    return DrillingCycle(
        name=words.name,
        bottom=bottom * scale,
        surface=0.0,
        clear=words.clear * scale,
        retract=None
        if words.retract_to_start
        else max(words.clear if words.retract is None else words.retract, words.clear) * scale,
        feed=feed,
        first_peck=(words.first_peck or words.next_peck) * scale if words.deep else 0.0,
        next_peck=words.next_peck * scale if words.deep else 0.0,
        chip_break="BRKCHP" in words.name,
        feed_out=words.name.startswith(FEED_OUT),
        dwell=words.dwell,
    )


@dataclass(frozen=True)
class HsmDrillingCycle:
    """A cycle of HSM/Fusion's APT post: GOTO names the hole's bottom, the clearance is a height of the section.

    Its post writes ``CYCLE/DRILL, depth, MMPM, feed, clearance[, RAPTO, clearance − retract]``. The heights count
    from the section's zero along the tool axis, so their distance from the hole is known only at the hole.
    """

    words: CycleWords
    scale: float  # mm per file unit
    feed: float  # mm/min

    def build_cycle_at(self, bottom: Vector, axis: Vector) -> DrillingCycle:
        """Build the drilling cycle of one hole.

        Args:
            bottom: Bottom of the hole, mm.
            axis: Tool axis, unit vector.

        Returns:
            The cycle with heights over the bottom of the hole, mm.

        Raises:
            DrillingCycleError: the numbers do not fit this form of the statement.
        """
        w, s = self.words, self.scale
        if w.depth is None or w.clear is None:
            raise DrillingCycleError(f"CYCLE/{w.name} without a depth or a clearance")
        high, drop = (w.clear, 0.0) if w.retract is None else (w.retract, w.clear)
        n = np.array(axis) / max(float(np.linalg.norm(axis)), 1e-12)
        height = float(np.array(bottom) @ n)
        clear, top = (high - drop) * s - height, w.depth * s
        if clear < top - 1e-6:
            raise DrillingCycleError(
                f"CYCLE/{w.name}: with GOTO as the hole's bottom, its top lies {top - clear:g} mm over the height the "
                "rapid goes to; export the holes as moves (cycles expanded)"
            )
        return DrillingCycle(
            name=w.name,
            bottom=0.0,
            surface=top,
            clear=clear,
            retract=max(high * s - height, clear),
            feed=self.feed,
            first_peck=w.first_peck * s if w.deep else 0.0,
            chip_break="BRKCHP" in w.name,
            feed_out=w.name.startswith(FEED_OUT),
            dwell=w.dwell,
            peck_from=top,
        )
