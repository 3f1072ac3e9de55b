"""Collector of moves, frames, events and unknown words while a reader executes a program."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NoReturn

import numpy as np

from machopt.data_types.toolpath import IgnoredWord, MoveKind
from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError
from machopt.programs.reading.circular_moves import compute_circle_poses
from machopt.programs.reading.move_attributes import NOTHING_GIVEN, MoveAttributes, ProgramEnd
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_annotations import ProgramAnnotations
from machopt.programs.reading.rotation_conventions import Rows

STANDING_TOOL = "the robot carries the workpiece past a fixed tool: not supported; post the job for a tool on the robot"
MOST_MOVES = 1_000_000  # beyond one for each line: what a loop may repeat
MOST_STEPS = 2_000_000  # statements carried out, beyond one for each line: loops that end are shorter
FARTHEST = 1e3  # m; no robot cell is larger, so the number is a fault
MOST_DEGREES = 1e5  # of an axis


@dataclass(kw_only=True)
class ProgramBuilder(ProgramAnnotations):
    """One program in the making. Positions in m, angles in deg, feeds in m/s."""

    feed: float = math.nan
    speed_override: float = 1.0  # the program's own override: what every feed is multiplied by
    last: Array | None = None  # (4, 4) present pose in the active base, None where unknown
    _numbers: array[float] = field(default_factory=lambda: array("d"))  # 6 axes, 12 pose, feed, blend, time
    _external: list[tuple[float, ...]] = field(default_factory=list)
    _configuration: list[Mapping[str, object]] = field(default_factory=list)
    _bases: list[ProgramFrame] = field(default_factory=list)
    _tools: list[ProgramFrame] = field(default_factory=list)
    _base: int = 0
    _tool: int = 0
    _steps: int = 0

    def step(self, line: int) -> None:
        """Count a statement that is carried out.

        Args:
            line: Line number in the file (1-based).

        Raises:
            InputError: the program does not end.
        """
        self._steps += 1
        if self._steps > MOST_STEPS + line:
            raise self.error(f"more than {MOST_STEPS} statements are carried out: a loop does not end here", line)

    def override(self, percent: float | None, line: int) -> None:
        """Set the speed override: feeds that follow are this share of their programmed values.

        Args:
            percent: Override in %, None where it is known only at run time.
            line: Line number in the file (1-based).

        Raises:
            InputError: the override is not known here.
        """
        if percent is None or not 0.0 < percent <= 100.0:
            raise self.error("the override is set to a value that is not known here; expected 1 to 100 %", line)
        self.speed_override = percent / 100.0
        if percent != 100.0:
            self.warn_once(
                f"the program sets its override to {percent:g} %: feeds behind it are multiplied by that", line
            )

    def end_program(self, text: str) -> NoReturn:
        """Record a statement that ends the program; what follows it is not carried out.

        Args:
            text: The statement.

        Raises:
            ProgramEnd: always; the reader stops there.
        """
        self.event(text, "stop")
        raise ProgramEnd

    def may_end(self, line: int) -> None:
        """Warn of a branch that may end the routine; most often it checks arguments, so it is read as not taken.

        Args:
            line: Line number in the file (1-based).
        """
        self.warn_once("a branch may end the routine early (RETURN) or the program; read as if it does not", line)

    # ---- moves

    def joint(
        self,
        axes_deg: Sequence[float],
        line: int,
        move_attributes: MoveAttributes = NOTHING_GIVEN,
        *,
        kind: int = JOINT,
        pose: Array | None = None,
    ) -> None:
        """Add a target in axes.

        Args:
            axes_deg: Six axes in degrees; NaN where only pulses are known.
            line: Line number in the file (1-based).
            move_attributes: What the program states beside the target.
            kind: Kind of move: joint, linear or circular.
            pose: Pose (4, 4) of the target in m, where the file gives it too.

        Raises:
            InputError: the target is malformed.
        """
        for value in axes_deg:
            if abs(value) > MOST_DEGREES or math.isinf(value):
                raise self.error(f"axis at {value:g} degrees; expected a position of a robot's axis", line)
        self._add(kind, tuple(axes_deg), pose, line, move_attributes)
        self.last = pose

    def pose(
        self,
        kind: int,
        rows: Rows,
        position: tuple[float, float, float],
        line: int,
        move_attributes: MoveAttributes = NOTHING_GIVEN,
    ) -> None:
        """Add a target as a rotation and a position.

        Args:
            kind: Kind of move: joint, linear or circular.
            rows: Rotation, nine numbers row by row.
            position: Position along x, y and z, m.
            line: Line number in the file (1-based).
            move_attributes: What the program states beside the target.
        """
        a, b, c, d, e, f, g, h, i = rows
        x, y, z = position
        T = np.array([[a, b, c, x], [d, e, f, y], [g, h, i, z], [0.0, 0.0, 0.0, 1.0]])
        self.add_pose_move(kind, T, line, move_attributes)

    def add_pose_move(self, kind: int, T: Array, line: int, move_attributes: MoveAttributes = NOTHING_GIVEN) -> None:
        """Add a target as a pose.

        Args:
            kind: Kind of move: joint, linear or circular.
            T: Pose (4, 4), m.
            line: Line number in the file (1-based).
            move_attributes: What the program states beside the target.

        Raises:
            InputError: the target is malformed.
        """
        x, y, z = T[:3, 3].tolist()
        if not all(math.isfinite(v) and abs(v) <= FARTHEST for v in (x, y, z)):
            raise self.error(f"target at {x:g}, {y:g}, {z:g} m; expected a place in a robot cell", line)
        self._add(kind, None, T, line, move_attributes)
        self.last = T

    def circle(
        self, via: Array, end: Array, line: int, move_attributes: MoveAttributes, *, sweep_deg: float | None = None
    ) -> None:
        """Add an arc from the present pose through ``via`` to ``end`` as chords.

        With ``sweep_deg`` the arc ends after that angle instead, in reverse where negative (KUKA's CA).

        Args:
            via: Pose (4, 4) on the arc, m.
            end: Pose (4, 4) at its end, m.
            line: Line number in the file (1-based).
            move_attributes: What the program states beside the target.
            sweep_deg: Angle of the arc in degrees, None where ``end`` ends it.

        Raises:
            InputError: the start is not known, the three points lie on a line, or the tool rotates on an arc with an
                angle.
        """
        if self.last is None:
            raise self.error("an arc begins at a joint target, whose place is not known without the robot", line)
        try:
            poses = compute_circle_poses(self.last, via, end, self.arc_tolerance, sweep_deg)
        except ArcError as problem:
            raise self.error(str(problem), line) from None
        between = replace(move_attributes, blend=math.nan)
        for T in poses[:-1]:
            self.add_pose_move(LINEAR, T, line, between)
        for T in poses[-1:]:
            self.add_pose_move(LINEAR, T, line, move_attributes)

    def _add(
        self, kind: int, axes: tuple[float, ...] | None, T: Array | None, line: int, move_attributes: MoveAttributes
    ) -> None:
        if len(self) >= MOST_MOVES + line:
            raise self.error(f"more than {MOST_MOVES} moves beyond one a line", line)
        nan = math.nan
        self._numbers.extend(axes if axes is not None else (nan,) * 6)
        self._numbers.extend(T[:3].ravel().tolist() if T is not None else (nan,) * 12)
        feed = move_attributes.feed * self.speed_override
        self._numbers.extend(
            (feed if feed > 0.0 and math.isfinite(feed) else nan, move_attributes.blend, move_attributes.time)
        )
        move = MoveKind.RAPID if kind == JOINT else self._word
        if not self._bases:
            self.set_base(ProgramFrame("base", None))
        if not self._tools:
            self.set_tool(ProgramFrame("tool", None))
        self._codes.extend((kind, self._base, self._tool, move, self._operation, line))
        self._external.append(tuple(move_attributes.external) or self.commented_external_values)
        self._configuration.append(move_attributes.configuration or {})
        self._is_last_event_comment = False

    # ---- frames

    def set_base(self, frame: ProgramFrame) -> None:
        """Set the frame of the poses that follow.

        Args:
            frame: Name and transform of the frame.
        """
        self._base = _find_or_add_frame(self._bases, frame)

    def set_tool(self, frame: ProgramFrame) -> None:
        """Set the tool frame of the moves that follow.

        Args:
            frame: Name and transform of the frame.
        """
        self._tool = _find_or_add_frame(self._tools, frame)

    def build(self) -> ParsedProgram:
        """The finished program.

        Raises:
            InputError: it moves nothing.
        """
        n = len(self)
        if n == 0:
            raise self.error("holds no moves that can be read; expected a program with joint or linear moves")
        numbers = np.frombuffer(self._numbers, dtype=np.float64).reshape(n, 21)
        codes = np.frombuffer(self._codes, dtype=np.int32).reshape(n, 6)
        T = np.full((n, 4, 4), np.nan)
        T[:, :3] = numbers[:, 6:18].reshape(n, 3, 4)
        T[:, 3] = 0.0, 0.0, 0.0, 1.0
        most = max(len(e) for e in self._external)
        external = np.full((n, most), np.nan)
        for k, row in enumerate(self._external):
            external[k, : len(row)] = row
        strange = [w for w, understood, _ in self._ignored if not understood]
        if strange:
            some = ", ".join(strange[:8]) + (f" and {len(strange) - 8} more" if len(strange) > 8 else "")
            self.warnings.append(f"not understood: {some}")
        return ParsedProgram(
            dialect=self.dialect,
            name=self.name or self.source.path.stem,
            files=tuple(dict.fromkeys([self.source.path, *self.files])),
            kind=codes[:, 0].astype(np.int8),
            axes_deg=numbers[:, :6].copy(),
            T_base_tcp=T,
            feed=numbers[:, 18].copy(),
            blend=numbers[:, 19].copy(),
            time=numbers[:, 20].copy(),
            external=external,
            configuration=tuple(self._configuration),
            base=codes[:, 1].copy(),
            tool=codes[:, 2].copy(),
            bases=tuple(self._bases),
            tools=tuple(self._tools),
            move=codes[:, 3].astype(np.int8),
            operation=codes[:, 4].copy(),
            operations=tuple(self._operations),
            events=tuple(self._events),
            line=codes[:, 5].copy(),
            warnings=tuple(self.warnings),
            ignored=tuple(IgnoredWord(w, c, at, u, stops) for (w, u, stops), (c, at) in self._ignored.items()),
        )


def _find_or_add_frame(frames: list[ProgramFrame], frame: ProgramFrame) -> int:
    for k, other in enumerate(frames):
        same = (frame.T is None and other.T is None) or (
            frame.T is not None and other.T is not None and np.array_equal(frame.T, other.T)
        )
        if other.name == frame.name and other.rides_on == frame.rides_on and same:
            return k
    frames.append(frame)
    return len(frames) - 1
