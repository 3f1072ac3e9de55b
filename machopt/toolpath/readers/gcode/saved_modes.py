"""Modes that a program saves and restores: M70 to M73 of LinuxCNC, PROC … SAVE of Sinumerik."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.toolpath.readers.gcode.siemens_calls import SiemensCallReader


@dataclass(frozen=True, kw_only=True)
class SavedModes:
    """What M70 and M73 save: units, plane, counting, feeds, work offset, the height cycles go back to; no motion."""

    call: object  # the call they were saved in, None in the main program
    scale: float
    feed_unit: float
    plane: Array
    incremental: bool
    absolute_centres: bool
    feed_mode: str
    feed: float
    feed_scale: float
    rpm: float
    work_offset: int | None
    back_to_initial: bool


class ModeReader(SiemensCallReader):
    """Carries out M70 (save), M71 (forget), M72 (restore) and M73 (save, restore when the subroutine returns)."""

    def __init__(self, source: SourceFile, options: ReadOptions, unit: str) -> None:
        super().__init__(source, options, unit)
        self.saved: list[SavedModes] = []
        self.at_calls: list[tuple[SavedModes, int | None, object, object]] = []

    def present_call(self) -> object:
        """The call that is carried out, None in the main program."""
        return None

    def save_for_call(self) -> None:
        """Save the modes in front of a call of ``PROC … SAVE``."""
        self.at_calls.append((self._get_modes(None), self.motion, self.setup.local, self.tilted_plane))

    def restore_after_call(self, line: int) -> None:
        """Restore the modes and the kind of motion that held before a call of ``PROC … SAVE``.

        Args:
            line: Line number in the file (1-based).

        Raises:
            InputError: the subprogram left another coordinate system.
        """
        modes, motion, local, tilted = self.at_calls.pop()
        if self.setup.local is not local or self.tilted_plane is not tilted:
            raise self.source.build_error(
                "a subprogram with SAVE changes the coordinate system (TRANS, ROT …), which its return restores: not "
                "followed; end the frame in the subprogram or expand the call",
                line,
            )
        feed, feed_scale, rpm = self.feed, self.feed_scale, self.rpm  # no G functions: they stay
        self.restore(modes, line)
        self.feed, self.feed_scale, self.rpm, self.motion = feed, feed_scale, rpm, motion

    def _get_modes(self, call: object) -> SavedModes:
        return SavedModes(
            call=call,
            scale=self.scale,
            feed_unit=self.feed_unit,
            plane=self.plane,
            incremental=self.incremental,
            absolute_centres=self.centres.absolute,
            feed_mode=self.feed_mode,
            feed=self.feed,
            feed_scale=self.feed_scale,
            rpm=self.rpm,
            work_offset=self.work_offset,
            back_to_initial=self.back_to_initial,
        )

    def saved_modes(self, m: int, line: int) -> None:
        """Carry out M70 to M73.

        Args:
            m: Number of the M word.
            line: Line number in the file (1-based).

        Raises:
            InputError: M72 without saved modes.
        """
        call = self.present_call()
        self.out.warn_once(
            "M70 to M73 save and restore modes (LinuxCNC); some machines mirror axes by these words", line
        )
        self.out.ignore(f"M{m}", line, understood=True)
        if m != 72:
            self.saved = [s for s in self.saved if s.call is not call]
        if m in (70, 73):
            self.saved.append(self._get_modes(call))
        if m == 72:
            found = next((s for s in self.saved if s.call is call), None)
            if found is None:
                raise self.source.build_error("M72 without modes that M70 or M73 saved here", line)
            self.restore(found, line)

    def restore(self, s: SavedModes, line: int) -> None:
        """Restore saved modes.

        Args:
            s: The saved modes.
            line: Line number in the file (1-based).

        Raises:
            InputError: the program did not name the saved work offset.
        """
        if s.work_offset != self.work_offset:
            if s.work_offset is None:
                raise self.source.build_error("M72 restores a work offset that the program did not name before", line)
            self.use_offset_number(s.work_offset, line)
        self.scale, self.feed_unit, self.plane, self.incremental = s.scale, s.feed_unit, s.plane, s.incremental
        self.centres.absolute, self.back_to_initial = s.absolute_centres, s.back_to_initial
        self.feed_mode, self.feed, self.feed_scale, self.rpm = s.feed_mode, s.feed, s.feed_scale, s.rpm
