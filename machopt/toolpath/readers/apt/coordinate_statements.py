"""CL statements that set the coordinate system of points, or shift or scale the points that follow."""

from __future__ import annotations

import numpy as np

from machopt.path_building.coordinate_systems import CoordinateSystem, SystemTransform
from machopt.toolpath.readers.apt.cam_dialect import CamDialect
from machopt.toolpath.readers.apt.motion_statements import AptMotionReader
from machopt.toolpath.readers.apt.refused_words import REFUSED
from machopt.toolpath.readers.apt.statement_parser import parse_number, parse_numbers, split_fields


class CoordinateSystemReader(AptMotionReader):
    """Carries them out."""

    def msys(self, word: str, rest: str, line: int) -> None:
        """Carry out MSYS: coordinate system of the points that follow (NX).

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the numbers describe no coordinate system.
        """
        v = parse_numbers(rest)
        if len(v) != 9:
            raise ValueError(f"{len(v)} numbers; expected origin, x axis and y axis (9)")
        x, y = np.array(v[3:6]), np.array(v[6:9])
        self.use_frame(CoordinateSystem(np.column_stack([x, y, np.cross(x, y)]), np.array(v[:3]) * self.scale), line)

    def csys(self, word: str, rest: str, line: int) -> None:
        """Carry out CSYS: three rows of four numbers.

        CAMWorks prints points in the world system (TRNTYP/WORLD). The statement then gives only the tool orientation:
        the third column is the tool axis (confirmed on 127 plunges and drilled holes, no counterexample).

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the numbers describe no coordinate system.
        """
        v = parse_numbers(rest)
        if len(v) != 12:
            raise ValueError(f"{len(v)} numbers; expected three rows of four (12)")
        m = np.array(v).reshape(3, 4)
        frame = CoordinateSystem(m[:, :3], m[:, 3] * self.scale)
        if self.dialect is CamDialect.CREO:
            if self.first_frame is not None and not frame.same_as(self.first_frame):
                self.out.warn_once(
                    "CSYS changes: Creo writes points in the machine's system, which is taken to be one for the whole "
                    "file",
                    line,
                )
            self.first_frame = self.first_frame or frame
            return
        if self.dialect is CamDialect.CAMWORKS:
            self.count += 1
            if self.cycle is not None:
                raise ValueError(
                    "a new operation begins and the drilling cycle before it was not ended: whether its points are "
                    "holes too is not said; put CYCLE/OFF where it ends, or repeat the CYCLE in the new operation"
                )
            self.out.begin_operation(f"{self.count} {self.tool_text}".strip(), tool=self.tool)
        if self.world:
            i, j, k = frame.R[:, 2].tolist()
            self.axis = (i, j, k)
        else:
            self.use_frame(frame, line)

    def transfer_type(self, word: str, rest: str, line: int) -> None:
        """Carry out TRNTYP: whether points are in the world system.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        name = (split_fields(rest) or [""])[0]
        self.world = name == "WORLD"
        self.out.ignore("TRNTYP" if self.world else f"TRNTYP/{name}", line, understood=self.world)

    def shift(self, word: str, rest: str, line: int) -> None:
        """Carry out TRANS: a shift that is added to every point that follows.

        ``TRANS/0,0,0`` or ``TRANS`` without numbers ends it.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).
        """
        values = _parse_numbers(rest, (0, 3))
        x, y, z = (v * self.scale for v in values or [0.0] * 3)
        self.change_placement(SystemTransform.shift(x, y, z), "TRANS")
        self.out.warn_once("TRANS shifts the points that follow it, as a post would put them out", line)
        self.out.ignore(word, line, understood=True)

    def enlarge(self, word: str, rest: str, line: int) -> None:
        """Carry out SCALE: a factor about the zero for every point that follows.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the factor is not one positive number.
        """
        factor = _parse_numbers(rest, (1,))[0]
        if not factor > 0.0:
            raise ValueError(f"a factor of {factor:g}; expected one above zero")
        self.change_placement(SystemTransform.factors(factor, factor, factor), "SCALE")
        if factor != 1.0:
            self.out.warn_once("SCALE enlarges the points that follow it, as a post would put them out", line)

    def origin(self, word: str, rest: str, line: int) -> None:
        """Carry out ORIGIN: the zero of the machine, which moves no point.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            InputError: ORIGIN changes in the middle of the path.
        """
        values = _parse_numbers(rest, (0, 3, 6))
        if len(self.out) and values != self.shifts.get(word, [0.0] * len(values)):
            raise self.source.build_error(
                f"{word} changes in the middle of the path: the part would stand somewhere else; split the file", line
            )
        self.shifts[word] = values
        if any(values):
            self.out.warn_once("ORIGIN says where the machine's zero lies; points stay in the part's system", line)
        self.out.ignore(word, line, understood=True)

    def coordinate_word(self, word: str, rest: str, line: int) -> None:
        """Carry out a word that copies or transforms what follows.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            InputError: the word changes something; only its end or an identity is supported.
        """
        parts = split_fields(rest)
        if parts in (["NOMORE"], ["OFF"]):
            return
        angles = [v for p in parts if (v := parse_number(p)) is not None]
        if word in ("ROTATE", "ROTHED") and angles and not any(angles):
            self.out.ignore(f"{word} by 0", line, understood=True)
            return
        raise self.source.build_error(f"{word}/ is not supported: {REFUSED[word]}", line)

    def rotate_table(self, word: str, rest: str, line: int) -> None:
        """Carry out a rotation of the machine table.

        Args:
            word: Major word of the statement.
            rest: Text behind the slash of the statement.
            line: Line number in the file (1-based).

        Raises:
            ValueError: the arguments are not an angle and an axis.
        """
        parts = split_fields(rest)
        angle = parse_number(parts[0]) if parts else None
        name = next((p for p in parts if p.endswith("AXIS")), None)
        if angle is None or name is None:
            raise ValueError("expected angle, axis")
        self.rotations[name] = round(self.rotations.get(name, 0.0) + angle, 6)
        self.out.ignore("ROTABL", line, understood=True)


def _parse_numbers(rest: str, counts: tuple[int, ...]) -> list[float]:
    """As many numbers as a statement may have.

    Raises:
        ValueError: another number of them, or a word.
    """
    values = parse_numbers(rest)
    if len(values) not in counts:
        raise ValueError(f"{len(values)} numbers; expected {' or '.join(map(str, counts))}")
    return values
