"""Words that move the program zero: work offsets (G54 …), G10 L2, G52 and G92.

The workpiece is the first work offset in use. ``--offset`` or G10 L2 give the position of another one. G10 L2 gives
machine positions, so two of them are needed. G52 and G92 shift the zero inside the work offset. Where controls differ
in the combination of these words, the program is refused.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.errors import suggest_nearest_word
from machopt.file_formats.source_file import ReadOptions, SourceFile, normalise_offset_name
from machopt.path_building.coordinate_systems import SystemTransform
from machopt.toolpath.readers.gcode.block_motion import BlockMotionReader
from machopt.toolpath.readers.gcode.syntax.word_meanings import MANY_OFFSETS

XYZ = "XYZ"
_FIRST = 540_000  # G54
_BY_NUMBER = {**{n: f"G{53 + n}" for n in range(1, 7)}, 7: "G59.1", 8: "G59.2", 9: "G59.3"}  # P of G10 L2
_PRESENT = 1e-9  # mm: smaller shifts are none


class WorkOffsetReader(BlockMotionReader):
    """Carries out the words that change where the program's zero lies."""

    def __init__(self, source: SourceFile, options: ReadOptions, unit: str) -> None:
        super().__init__(source, options, unit)
        self.work_offset: int | None = None
        self.first_offset: int | None = None
        self.named_offsets: set[str] = set()  # keys
        self.effective_offsets: set[str] = set()  # keys of options that a place was computed from
        self.cell_offset = ""  # of the cell's, that points count from
        self.shifts: dict[str, list[float]] = {}  # G52, G92, CYCL DEF 7 in mm
        self.preset_unknown = [False] * 3  # G92 named the place of an axis where its place was not known
        self.zero_lost = ""  # why no coordinates have a place any more
        self.preset_kept: list[float] | None = None  # by G92.2, for G92.3
        self.g53_is_an_offset = "G53" in dict(options.offsets)  # as some posts use it; only by user option
        self.table: dict[str, tuple[list[float], float]] = {}  # G10 L2: machine position (NaN: not given), angle
        self.first_place: tuple[list[float], float] | None = None  # of the first work offset when the path began

    # ---- work offsets

    def use_offset(self, g: int, words: dict[str, float], line: int) -> None:
        """Carry out G54 … G59.3, G54.1 P, G505 …; the position of every offset except the first must be given.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; words that are used are removed in place.
            line: Line number in the file (1-based).
        """
        number = g * 1000 + (round(words.pop("P", 0.0)) if g in MANY_OFFSETS or g == 540 else 0)
        number += round(words.pop("H", 0.0)) if g == 150 else 0  # Okuma's G15 H
        self.use_offset_number(number, line)

    def use_offset_number(self, number: int, line: int) -> None:
        """Use a work offset by its number.

        Args:
            number: Ten thousand times the G number plus P, as in :func:`format_offset_name`.
            line: Line number in the file (1-based).
        """
        self.named_offsets.add(normalise_offset_name(format_offset_name(number)))
        if self.options.cell_offsets:
            if number != self.work_offset:
                self.of_cell(format_offset_name(number), line)
            self.work_offset = number
            return
        key = normalise_offset_name(format_offset_name(number))
        is_position_known = key in dict(self.options.offsets) or key in self.table
        if self.first_offset is None and len(self.out) and is_position_known:
            self.first_offset = _FIRST  # what controls start with
        elif self.first_offset is None and len(self.out):
            self.out.warn(
                f"points before {format_offset_name(number)} name no work offset; they are taken in the same", line
            )
        if self.first_offset is None or not len(self.out):
            self.first_offset = number
        self.keep_first_place()
        if number != self.work_offset:
            self.take_offset(format_offset_name(number), format_offset_name(self.first_offset))
        self.work_offset = number
        self.out.meta["work_offset"] = format_offset_name(self.first_offset)

    def keep_first_place(self) -> None:
        """From the first point on the workpiece lies where the first work offset is."""
        if self.first_place is None and len(self.out):
            first = normalise_offset_name(format_offset_name(self.first_offset or _FIRST))
            place, angle = self.table.get(first, ([math.nan] * 3, 0.0))
            self.first_place = list(place), angle

    def of_cell(self, name: str, line: int | None = None) -> None:
        """Use a work offset of the cell, which is reported now and placed later.

        The tool position in it is unknown until all axes are given.

        Args:
            name: Name of the work offset.
            line: Line number in the file (1-based).

        Raises:
            InputError: the cell has no such offset, or points before it have none.
        """
        known, key = self.options.cell_offsets, normalise_offset_name(name)
        if key not in known:
            raise self.source.build_error(
                f"work offset {name} is not in the cell's offsets; {suggest_nearest_word(key, list(known))}", line
            )
        if len(self.out) and not self.cell_offset:
            raise self.source.build_error(f"points before {name} name no work offset; one before them would work", line)
        if self.cell_offset:
            self.p, self.lost = [math.nan] * 3, ["in the other work offset"] * 3
            self.end_contour("the work offset changes")
        self.cell_offset = key
        self.out.count_from(key)

    def take_offset(self, name: str, first: str) -> None:
        """Use a work offset for the coordinates that follow; moves are refused where its position is not given.

        Args:
            name: Name of the work offset.
            first: Name of the first work offset, which is ``workpiece``.
        """
        if self.options.cell_offsets:
            self.of_cell(name)
            return
        self.named_offsets |= {normalise_offset_name(name), normalise_offset_name(first)}
        offset, nowhere = self.place_of(name, first)
        nowhere = nowhere or self.zero_lost
        if (self.setup.offset, self.setup.missing_place_reason) != (None, "") or offset is not None or nowhere:
            lost = bool(nowhere or self.setup.missing_place_reason)
            self.change_setup(offset=offset, missing_place_reason=nowhere)
            if lost:
                self.p, self.lost = [math.nan] * 3, ["in the other work offset"] * 3

    def place_of(self, name: str, first: str) -> tuple[SystemTransform | None, str]:
        """Find the transform of a work offset into the first one.

        Args:
            name: Name of the work offset.
            first: Name of the first work offset, which is ``workpiece``.

        Returns:
            The transform, None for the first offset itself; and why it is not known, else empty.
        """
        key, given_origins = normalise_offset_name(name), dict(self.options.offsets)
        if key in given_origins:
            if name != first:
                self.effective_offsets |= {key, normalise_offset_name(first)}
            origin = np.array(given_origins[key]) - np.array(
                given_origins.get(normalise_offset_name(first), (0.0, 0.0, 0.0))
            )
            return (None if name == first else SystemTransform.shift(*origin.tolist())), ""
        unknown = ([math.nan] * 3, 0.0)
        origin_place = self.first_place or self.table.get(normalise_offset_name(first), unknown)
        place = self.table.get(key, unknown)
        if name == first and str(place) == str(origin_place):
            return None, ""
        between = _turn_work_offset(*origin_place).inverse()
        found = _turn_work_offset(*place).then(between)
        if not np.isnan(found.t).any():
            return (None if found.nothing else found), ""
        where = "" if name == first or key not in self.table else f" (G10 L2 gives it in the machine, and {first} not)"
        return None, (
            f"the work offset changes from {first} to {name}: their relative position is not in the file{where}; "
            f"give it with --offset {name.replace(' ', '')}=X,Y,Z (its origin in {first}, mm), or by the "
            "cell's offsets, or split the file, one offset in each"
        )

    def check_offsets_given(self) -> None:
        """Refuse an ``--offset`` of a name that the program never uses, or of its first one without another.

        Raises:
            InputError: it has no effect.
        """
        unused = [name for name, _ in self.options.offsets if name not in self.named_offsets and name != "G53"]
        if unused:
            named = ", ".join(sorted(self.named_offsets)) or "none"
            raise self.source.build_error(
                f"--offset {unused[0]}: the program does not use that work offset; it uses {named}"
            )
        idle = [name for name, _ in self.options.offsets if name not in self.effective_offsets and name != "G53"]
        if idle:
            raise self.source.build_error(
                f"--offset {idle[0]} has no effect: the points of the program count from {idle[0]}, its first work "
                "offset, and that is the workpiece. Expected a call without it, or --offset of another work offset too"
            )

    # ---- G10

    def set_offset(self, words: dict[str, float], line: int) -> None:
        """Carry out G10: L2 sets a work offset; L20 sets one of G54.1 (Fanuc) or one by the tool position (LinuxCNC).

        Args:
            words: Words of the block: letter or name → number.
            line: Line number in the file (1-based).

        Raises:
            InputError: it changes the present coordinates in a way that the file does not give.
        """
        kind = words.get("L")
        given = {c: words[c] for c in XYZ if c in words}
        turned = kind == 2.0 and "R" in words
        moves = bool(given or turned or words.keys() & set("ABC"))
        if not moves or kind not in (2.0, 20.0, None):
            if moves and len(self.out):
                raise self.source.build_error("G10 changes offsets in the middle of the path: not supported", line)
            return
        number = round(words.get("P", 0.0))
        name = f"G54.1P{number}" if kind == 20.0 else _BY_NUMBER.get(number, "")
        active = normalise_offset_name(format_offset_name(self.work_offset or self.first_offset or _FIRST))
        if len(self.out) and (kind != 2.0 or not name or self.incremental or words.keys() & set("ABC")):
            raise self.source.build_error("G10 changes offsets in the middle of the path: not supported", line)
        if not name or self.incremental:
            self.table.pop(name or active, None)
            return
        self.keep_first_place()
        place, angle = self.table.get(name, ([math.nan] * 3, 0.0))
        place = list(place)
        for c, v in given.items():
            place[XYZ.index(c)] = v * self.scale
        self.table[name] = place, words["R"] if turned else angle
        if turned and self.setup.machine is not None:
            raise self.source.build_error(
                "G10 L2 R turns the system on a machine with rotary axes: not supported", line
            )
        if len(self.out) and name == active:
            known = {**self.table, **dict(self.options.offsets)}
            if self.first_place is None or np.isnan([*self.first_place[0], *place]).any() or not known:
                raise self.source.build_error(
                    f"G10 L2 changes {name} in the middle of the path, and where it was before is not in the file: not "
                    "supported; a G10 L2 with X, Y and Z before the path would say it",
                    line,
                )
            self.take_offset(name, normalise_offset_name(format_offset_name(self.first_offset or _FIRST)))

    # ---- G52 and G92

    def shift_origin(self, g: int, words: dict[str, float], line: int) -> None:
        """Carry out G10, G52 and G92.

        Args:
            g: Ten times the number of the G word.
            words: Words of the block: letter or name → number; changed in place.
            line: Line number in the file (1-based).

        Raises:
            InputError: the shift moves a rotary axis in the middle of the path.
        """
        axes = [k for k in range(3) if XYZ[k] in words]
        name = f"G{g / 10:g}"
        if g == 100:
            self.set_offset(words, line)
            self.out.ignore(name, line, understood=True)
        elif words.keys() & set("ABC") and len(self.out):
            raise self.source.build_error(f"{name} shifts a rotary axis in the middle of the path: not supported", line)
        elif g == 520 and axes:
            self.shift_locally({k: words[XYZ[k]] * self.scale for k in axes}, line)
        elif g == 920 and axes:
            self.name_place({k: words[XYZ[k]] * self.scale for k in axes}, line)
        elif g in (921, 922, 923):
            self.end_preset(g, line)
        else:
            self.out.ignore(name, line, understood=True)
        words.clear()

    def shift_locally(self, to: dict[int, float], line: int) -> None:
        """Carry out G52: shift the zero inside the work offset.

        Args:
            to: Axis index → coordinate, mm.
            line: Line number in the file (1-based).

        Raises:
            InputError: a G92 is active for the axis: LinuxCNC replaces it, Fanuc adds both.
        """
        preset = self.shifts.get("G92", [0.0] * 3)
        both = [k for k in to if abs(preset[k]) > _PRESENT or self.preset_unknown[k]]
        if both:
            raise self.source.build_error(
                f"G52 {XYZ[both[0]]} while G92 holds for that axis: LinuxCNC replaces the shift, Fanuc adds both; end "
                "G92 (G92.1) before G52",
                line,
            )
        now = self.shifts.setdefault("G52", [0.0] * 3)
        for k, v in to.items():
            now[k] = v
        self.use_shifts()

    def name_place(self, to: dict[int, float], line: int) -> None:
        """Carry out G92: give the present position new coordinates; an earlier G52 of the axis has no effect.

        Where the position of an axis was never given, G92 gives it, and the workpiece is its system.

        Args:
            to: Axis index → coordinate, mm.
            line: Line number in the file (1-based).

        Raises:
            InputError: the present position is not known, or the coordinate system is rotated.
        """
        if len(self.out) and (self.setup.local is not None or self.setup.by_machine):
            raise self.source.build_error("G92 in a turned coordinate system is not supported", line)
        now = self.shifts.setdefault("G92", [0.0] * 3)
        local = self.shifts.setdefault("G52", [0.0] * 3)
        place = list(self.p)
        for k, v in to.items():
            if not math.isnan(self.p[k]):
                now[k] += local[k] + self.p[k] - v
                local[k] = 0.0
            elif self.lost[k]:
                raise self.source.build_error(
                    f"G92 {XYZ[k]} where {XYZ[k]} is not known{self.describe_unknown_position(k)}", line
                )
            else:
                place[k], self.preset_unknown[k] = v, True
                if len(self.out) and not self.setup.is_rotated:  # unchanged since the program began
                    self.out.fill_coordinate(k, v + self.setup.points(np.zeros((1, 3)))[0, k])
        if any(abs(v) > _PRESENT for v in now):
            self.out.warn_once("G92 shifts the origin: points from here on are brought into the first system", line)
        self.p = place
        self.use_shifts()

    def end_preset(self, g: int, line: int) -> None:
        """Carry out G92.1, G92.2 and G92.3.

        G92.1 and G92.2 end G92, and G52 with it (LinuxCNC has one register); G92.3 restores it.

        Args:
            g: Ten times the number of the G word.
            line: Line number in the file (1-based).

        Raises:
            InputError: G92.3 without G92.2 before it.
        """
        if g == 923:
            if self.preset_kept is None:
                raise self.source.build_error("G92.3 restores a shift that the program did not set before", line)
            self.shifts["G92"], self.shifts["G52"] = list(self.preset_kept), [0.0] * 3
            self.use_shifts()
            return
        local, preset = (self.shifts.pop(name, [0.0] * 3) for name in ("G52", "G92"))
        if g == 922:
            self.preset_kept = [a + b for a, b in zip(local, preset, strict=True)]
        self.use_shifts()
        if any(self.preset_unknown):
            self.zero_lost = (
                "cuts after G92.1 ended a G92 that named the tool's place at the start of the program: where the zero "
                "lies then is not in the file"
            )
            self.change_setup(missing_place_reason=self.zero_lost)
            self.p = [math.nan] * 3

    def use_shifts(self) -> None:
        x, y, z = (sum(s[k] for s in self.shifts.values()) for k in range(3))
        if any(self.shifts.get("G52", ())):
            self.out.warn_once("G52 shifts the zero: points count from the work offset before the shift")
        self.change_setup(datum=(x, y, z))


def _turn_work_offset(place: list[float], angle: float) -> SystemTransform:
    """A work offset in the machine: turned about its Z, then shifted."""
    rotation = SystemTransform.rotation("Z", angle)
    return SystemTransform(rotation.R, np.array(place))


def format_offset_name(number: int) -> str:
    """Format the name of a work offset: G54, G59.3, G54.1 P2 ….

    Args:
        number: Ten thousand times the G number plus P.

    Returns:
        The name.
    """
    g, p = divmod(number, 1000)
    return f"G{g / 10:g}" + (f" {'H' if g == 150 else 'P'}{p}" if p else "")
