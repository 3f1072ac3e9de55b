"""Template engine: iterates over the moves of a program, in output order, and fills the templates of a post."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.robot_program import EVENT_LINES, LIN, RobotController
from machopt.data_types.toolpath import ToolpathEvent
from machopt.errors import PostError
from machopt.file_formats.csv_text_escaping import escape_formula_text
from machopt.programs.writing.post_file import PostTemplate
from machopt.programs.writing.template_field_names import ITEM_FIELDS, MOVE_FIELDS, OF_MOVES, PART_FIELDS, TABLES
from machopt.programs.writing.template_fields import LazyColumns, PostJob
from machopt.programs.writing.template_language import TemplateValue, TextTemplate, check_names, compile_template

FEED_DIGITS = 7  # of m/s: feeds that print alike are one speed


@dataclass(frozen=True)
class ProgramPart:
    """Moves ``start`` … ``stop`` − 1 of the program."""

    name: str
    number: int
    start: int
    stop: int

    def fields(self) -> dict[str, TemplateValue]:
        return {
            "part": self.name,
            "part_number": self.number,
            "first_move": self.start + 1,
            "last_move": self.stop,
            "count": self.stop - self.start,
        }


@dataclass(kw_only=True)
class TemplateEngine:
    """One program being written. ``columns`` are per move, ``values`` of the whole program."""

    post: PostTemplate
    job: PostJob
    name: str
    columns: LazyColumns
    values: dict[str, TemplateValue]
    notes: Sequence[str]
    own_lines: bool = True  # the cell's ``controller.lines`` belong into this program
    _lines: dict[str, Mapping[str, TextTemplate]] = field(default_factory=dict)
    _own: dict[str, TextTemplate] = field(default_factory=dict)  # the cell's lines for events, by item

    def __post_init__(self) -> None:
        n = len(self.job.program)
        speeds = [f"{round(v, FEED_DIGITS):.9g}" if math.isfinite(v) else "" for v in self.job.program.feed.tolist()]
        zones = [f"{d:.6g}" if d > 0.0 else "" for d in self.job.blend.tolist()]
        corners = [(s, z) if s and z else ("", "") for s, z in zip(speeds, zones, strict=True)]
        self.distinct = {s: k for k, s in enumerate(dict.fromkeys(s for s in speeds if s))}
        self.zones = {z: k for k, z in enumerate(dict.fromkeys(z for z in zones if z))}
        self.corners = {c: k for k, c in enumerate(dict.fromkeys(c for c in corners if c[0]))}
        joint = (self.job.program.kind != LIN).tolist()
        vias = [z if via else "" for z, via in zip(zones, joint, strict=True)]  # zones of joint moves
        self.vias = {z: k for k, z in enumerate(dict.fromkeys(z for z in vias if z))}
        self.via_of = [self.vias.get(z, -1) for z in vias]
        self.speed_of = [self.distinct.get(s, -1) for s in speeds]
        self.zone_of = [self.zones.get(z, -1) for z in zones]
        self.corner_of = [self.corners.get(c, -1) for c in corners]
        self._check_fields()
        self._lines = dict(self.post.blocks)
        for key, line in self.job.controller.lines.items() if self.own_lines else ():
            own = compile_template(line, f"controller.lines.{key}")
            check_names(own, ("value", "text"))
            self._own[key] = own
        most = compute_part_length(self.post, self.job.controller) or n
        starts = range(0, n, most)
        stem = self.name[: self.post.keys.name.length - 4]
        self.parts = [
            ProgramPart(self.name if len(starts) == 1 else f"{stem}_{k + 1:03d}", k + 1, s, min(s + most, n))
            for k, s in enumerate(starts)
        ]
        self.values |= {
            "parts": len(self.parts),
            "single": len(self.parts) == 1,
            "positions": n if len(self.parts) == 1 else 0,
            "name": self.name,
            "speeds_count": max(len(self.distinct), 1),
            "zones_count": max(len(self.zones), 1),
            "corners_count": max(len(self.corners), 1),
            "vias_count": len(self.vias) if self.vias else float("nan"),
            "line_count": "@{line_count}",
        }

    def _check_fields(self) -> None:
        """Check that every field of the post exists at its place."""
        general = [*self.values, *PART_FIELDS]
        for template in self.post.list_texts():
            check_names(template, general)
        for items in self.post.blocks.values():
            for item, template in items.items():
                more: Sequence[str] = TABLES.get(item, ITEM_FIELDS)
                check_names(template, [*general, *(([*self.columns, *MOVE_FIELDS]) if item in OF_MOVES else more)])

    def files(self) -> dict[str, str]:
        """Name and text of every file."""
        out: dict[str, str] = {}
        whole = replace(self.parts[0], name=self.name, stop=len(self.job.program)) if len(self.parts) == 1 else None
        program = ProgramPart(self.name, 0, 0, len(self.job.program))
        for file in self.post.files:
            parts: list[ProgramPart] = [program]
            if file.each == "part":
                parts = self.parts if whole is None else []
            for part in parts:
                values = {**self.values, **part.fields()}
                moves = part if file.each == "part" else whole
                out[file.name.one(values)] = self._number_lines(self._write_text(file.text, values, moves))
        return out

    def _write_text(
        self, pieces: Sequence[TextTemplate | str], values: Mapping[str, TemplateValue], moves: ProgramPart | None
    ) -> list[str]:
        """Lines of a text; blocks of moves are those of ``moves``, empty where the parts are elsewhere."""
        lines: list[str] = []
        for piece in pieces:
            if isinstance(piece, TextTemplate):
                line = piece.one(values)
                lines += [line] if line or not piece.sections else []  # a line of sections may be no line at all
            elif piece == "body":
                lines += self._write_block("moves", moves) if moves is not None else self._list_calls()
            elif piece == "parts":
                if moves is None:
                    for part in self.parts:
                        lines += self._write_text(self.post.part_text, {**values, **part.fields()}, part)
            else:
                lines += self._write_block(piece, moves)
        return lines

    def _list_calls(self) -> list[str]:
        template = self._lines["moves"].get("call")
        if template is None:
            raise PostError(
                f"the program has {len(self.parts)} parts, but block.moves.call does not define how to run one",
                file=self.post.origin,
            )
        return [line for p in self.parts for line in template.one({**self.values, **p.fields()}).split("\n")]

    def _write_block(self, block: str, part: ProgramPart | None) -> list[str]:
        items = self._lines[block]
        if block in self.post.whole:
            part = ProgramPart(self.name, 0, 0, len(self.job.program))
        if "note" in items:
            width = self.post.keys.comment_length
            texts = [self._escape_comment(t) for note in self.notes for t in textwrap.wrap(note, width)]
            lines = [items["note"].one({**self.values, "text": t}) for t in texts]
        elif table := next((name for name in TABLES if name in items), ""):
            rows = {
                "speed": [(s, "") for s in self.distinct],
                "zone": [("", z) for z in self.zones],
                "via": [("", z) for z in self.vias],
            }
            lines = [
                items[table].one(
                    {**self.values, "number": k + 1, table: k, **_parse_feed_fields(s), **_parse_zone_fields(z)}
                )
                for k, (s, z) in enumerate(rows.get(table, self.corners))
            ]
        elif "part" in items:
            parts = self.parts if len(self.parts) > 1 else []
            lines = [items["part"].one({**self.values, **p.fields()}) for p in parts]
        elif part is None:
            return []
        else:
            lines = self._write_moves(items, part)
        separator = self.post.separators[block]
        lines = [line for line in lines if line]
        lines = [line + separator for line in lines[:-1]] + lines[-1:]
        return [one for line in lines for one in line.split("\n")]

    def _write_moves(self, items: Mapping[str, TextTemplate], part: ProgramPart) -> list[str]:
        """Every item of a part's moves in order, one text each."""
        p = self.job.program
        start, stop = part.start, part.stop
        columns = self._build_columns(part)
        runs = (
            _mark_cutting_runs(self.job, self.speed_of, start, stop)
            if "run" in items
            else np.zeros(stop - start, np.int8)
        )
        texts: dict[int, str] = {}
        for name in ("ptp", "lin", "run"):
            kinds = ["run" if runs[k - start] else ("lin" if p.kind[k] == LIN else "ptp") for k in range(start, stop)]
            rows = [k for k, kind in zip(range(start, stop), kinds, strict=True) if kind == name]
            if name in items and rows:
                texts |= dict(zip(rows, items[name].rows(columns, rows), strict=True))
        changes: dict[int, str] = {}
        for name, wanted in (("ptp_change", False), ("lin_change", True)):
            rows = [k for k in range(start, stop) if (p.kind[k] == LIN) == wanted]
            if name in items and rows:
                changes |= dict(zip(rows, items[name].rows(columns, rows), strict=True))
        events: dict[int, list[ToolpathEvent]] = {}
        for event in p.events:
            events.setdefault(event.index, []).append(event)
        operation, words = p.operation.tolist(), columns["move"]
        out: list[str] = []
        label: int | None = None
        word: object = ""
        change = ""
        here: dict[str, TemplateValue] = dict(self.values)
        for k in range(start, stop):
            here["number"] = k - start + 1
            if k > start and runs[k - start - 1] and runs[k - start] != 1 and "run_end" in items:
                out.append(items["run_end"].one(here))
            if operation[k] != label:
                label = operation[k]
                if label >= 0 and "operation" in items:
                    text = self._escape_comment(p.operations[label], "operation: ")
                    out.append(items["operation"].one({**here, "text": text}))
            out += [line for event in events.get(k, ()) if (line := self._write_event(items, event, here))]
            if (p.kind[k] == LIN or self.post.keys.samples) and words[k] != word:
                word = words[k]
                if "move" in items:
                    out.append(items["move"].one({**here, "text": word}))
            if k in changes and changes[k] != change:
                change = changes[k]
                out.append(change)
            if runs[k - start] == 2 and "run_begin" in items:
                out.append(items["run_begin"].one(here))
            if k in texts:
                out.append(texts[k])
        here["number"] = stop - start + 1
        if runs[-1] and "run_end" in items:
            out.append(items["run_end"].one(here))
        if stop == len(p):  # what happens after the last move
            out += [line for event in events.get(stop, ()) if (line := self._write_event(items, event, here))]
        return out

    def _build_columns(self, part: ProgramPart) -> LazyColumns:
        n = len(self.job.program)
        at = np.arange(n)
        labels = [*(self._escape_comment(label) for label in self.job.program.operations), ""]
        makers = {name: (lambda name=name: self.columns[name]) for name in self.columns}
        fixed = {name: (lambda v=v: [v] * n) for name, v in {**self.values, **part.fields()}.items()}
        more = {
            "number": lambda: at - part.start + 1,
            "first": (at == part.start).tolist,
            "speed": lambda: np.asarray(self.speed_of),
            "speed_number": lambda: np.asarray(self.speed_of) + 1,
            "zone_number": lambda: np.asarray(self.zone_of) + 1,
            "corner": lambda: np.asarray(self.corner_of),
            "corner_number": lambda: np.asarray(self.corner_of) + 1,
            "via": lambda: np.asarray(self.via_of),
            "operation": lambda: [labels[o] for o in self.job.program.operation.tolist()],
        }
        return LazyColumns({**fixed, **makers, **more})

    def _write_event(
        self, items: Mapping[str, TextTemplate], event: ToolpathEvent, here: Mapping[str, TemplateValue]
    ) -> str | None:
        """The line for an event: its own kind's, else a comment; then the line the cell has for it."""
        kind = find_event_item(event)
        whole = math.isfinite(event.value) and event.value == round(event.value)  # a tool is 2, not 2.0
        value = round(event.value) if whole else event.value
        fields = {**here, "text": self._escape_comment(event.text, "CAM: "), "value": value}

        def usable(template: TextTemplate | None) -> bool:  # a line that needs the number cannot do without
            return template is not None and ("value" not in template.names or math.isfinite(event.value))

        own = self._own.get(kind)
        template = items.get(kind)
        if kind == "dwell" and self.post.keys.samples:  # the samples stand there; a line that waits would do so twice
            own, template = None, None
        if own is not None or not usable(template):
            template = items.get("comment")
        if template is None:
            return None
        if own is None or "ptp" not in items or "comment" not in items:
            return template.one(fields)
        if not usable(own):
            raise PostError(
                f"needs @{{value}}, but {event.text!r} gives none", file="cell", where=f"controller.lines.{kind}"
            )
        return template.one(fields) + "\n" + own.one(fields)

    def _escape_comment(self, text: str, before: str = "") -> str:
        """Free text as a comment may hold it; ``before`` counts towards its length."""
        keys = self.post.keys
        text = "".join(c if c.isprintable() else " " for c in text)
        if keys.encoding == "ascii" and keys.escape != "json":
            text = text.encode("ascii", "replace").decode("ascii")
        for character in keys.forbid + ("<>&" if keys.escape == "xml" else ""):
            text = text.replace(character, " ")
        text = " ".join(text.split())[: max(keys.comment_length - len(before), 4)].strip()
        if keys.escape == "json":
            return json.dumps(text, ensure_ascii=keys.encoding == "ascii")[1:-1]
        return escape_formula_text(text).replace('"', '""') if keys.escape == "csv" else text

    def _number_lines(self, lines: list[str]) -> str:
        number = self.post.keys.number
        if number is not None and number.after in lines and number.before in lines:
            first, last = lines.index(number.after) + 1, lines.index(number.before)
            for k in range(first, last):
                lines[k] = number.format % (k - first + 1) + lines[k]
            lines[:first] = [line.replace("@{line_count}", str(last - first)) for line in lines[:first]]
            if number.most is not None and last - first > number.most:
                raise PostError(
                    f"{last - first} lines, but the controller counts to {number.most}; "
                    "fewer moves in a part would work",
                    where="moves_per_part",
                )
        return "".join(line + "\n" for line in lines)


def _parse_feed_fields(text: str) -> dict[str, TemplateValue]:
    v = float(text or "nan")
    return {"feed_m_s": v, "feed_mm_s": v * 1e3, "feed_mm_min": v * 6e4}


def _parse_zone_fields(text: str) -> dict[str, TemplateValue]:
    d = float(text or "nan")
    return {"blend_m": d, "blend_mm": d * 1e3}


def find_event_item(event: ToolpathEvent) -> str:
    """Find the template item of an event.

    Args:
        event: The event of the toolpath.

    Returns:
        One of EVENT_LINES.
    """
    words = event.text.upper()
    off = "OFF" in words or event.value == 0.0 or any(w in words.split() for w in ("M5", "M9", "M05", "M09"))
    if event.kind in ("spindle", "coolant"):
        return f"{event.kind}_{'off' if off else 'on'}"
    return event.kind if event.kind in EVENT_LINES else "comment"


def _mark_cutting_runs(job: PostJob, speed_of: Sequence[int], start: int, stop: int) -> NDArray[np.int8]:
    """0 outside, 2 at the first and 1 at further moves of a run: three or more cutting lines in one go.

    A run ends at an event, a change of operation or of feed.
    """
    p = job.program
    cut = (p.cutting & (p.kind == LIN))[start:stop]
    stops = {e.index for e in p.events}
    out = np.zeros(stop - start, np.int8)
    k = 0
    while k < stop - start:
        j = k
        while (
            j < stop - start
            and cut[j]
            and (
                j == k
                or (
                    start + j not in stops
                    and p.operation[start + j] == p.operation[start + k]
                    and speed_of[start + j] == speed_of[start + k]
                )
            )
        ):
            j += 1
        if j - k >= 3:
            out[k], out[k + 1 : j] = 2, 1
        k = max(j, k + 1)
    return out


def compute_part_length(post: PostTemplate, controller: RobotController) -> int | None:
    """Compute the largest number of moves per part; the cell's number takes precedence over the template's.

    Args:
        post: The template.
        controller: Controller settings of the cell.

    Returns:
        Number of moves, None where the post cannot be split.
    """
    return None if post.keys.moves_per_part is None else controller.moves_per_part or post.keys.moves_per_part
