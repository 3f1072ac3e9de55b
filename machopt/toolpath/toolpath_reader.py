"""Reader of any toolpath file: detects the format from the content and calls the matching reader.

The readers keep every programmed point in source order. A CSV row, a GOTO or a G1 block is one point. Arcs become
chords within the arc tolerance; drilling cycles become their strokes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.data_types.toolpath import Toolpath
from machopt.errors import FileFormatError, OptionError
from machopt.file_formats.source_file import (
    MAX_EXTENT,
    OptionNeededError,
    ReadOptions,
    SourceFile,
    decode_source,
    normalise_word,
    read_bytes,
)
from machopt.file_formats.source_file import parse_offsets as work_offsets
from machopt.toolpath.readers import dialect_detection
from machopt.toolpath.readers.option_error_order import find_fault_behind
from machopt.toolpath.readers.tables.point_table import is_point_table, read_csv, read_parquet
from machopt.toolpath.readers.tables.table_layout import describe_other_layout
from machopt.toolpath.unused_reading_options import check_reading_options

if TYPE_CHECKING:
    from machopt.programs.program_reader import ProgramRobot

_READABLE = (
    "readable are APT/CL data (NX CLSF, CATIA aptsource, Creo ncl, CAMWorks, HSM/Fusion), G-code (Fanuc, Haas, "
    "Siemens, LinuxCNC), Heidenhain programs, Mastercam NCI, robot programs (KRL, RAPID, FANUC LS, URScript, VAL3, "
    "JBI, ROS trajectories) and point tables (CSV, Parquet)"
)
_REFUSED = (  # (pattern in the first lines, what it is and what would work)
    (r"^\s*ISO-10303-21", f"is a STEP file: STEP-NC holds features and no tool points; {_READABLE}"),
    (r"^\s*(?:solid\s|<\?xml|<html|\{\s*\")", f"is not a toolpath; {_READABLE}"),
)
_HEAD_LINES = 3000
_NCI_LINES = 200


def read_toolpath(
    path: Path | str,
    *,
    unit: str | None = None,
    strict: bool = False,
    arc_tolerance: float = 5e-6,
    machine: str | None = None,
    default_feed: float | None = None,
    offsets: Sequence[str] = (),
    cycle_order: Sequence[str] = ("depth", "clear", "retract"),
    tool_axis: str = "-z",
    decimals: int | None = None,
    max_extent: float = MAX_EXTENT,
    accept_unknown: Sequence[str] = (),
    kind: str | None = None,
    robot: ProgramRobot | None = None,
    cell_offsets: Sequence[str] = (),
) -> Toolpath:
    """Read a CAM export or a point table.

    Args:
        path: the file.
        unit: ``mm`` or ``inch``, where the file does not say; another one than the file's is an error.
        strict: refuse the first word that is not understood.
        arc_tolerance: m, largest distance of a chord from its arc.
        machine: rotary kinematics of a five-axis program, see :mod:`machopt.path_building.rotary_axes`; with the
            places of its axes (``table-ac@0,0,-50``) programs without tool-centre-point control are read too.
        default_feed: m/s for cutting moves without a feed.
        cycle_order: what the numbers of ``CYCLE/`` without a word of their own stand for (the post's table decides).
        tool_axis: the direction of the tool frame that points from the tip to the shank, in robot programs and pose
            tables: ``-z`` where the frame's z points out of the tool.
        robot: places of joint targets in robot programs.
        offsets: where further work offsets lie in the first one, such as ``("G55=100,0,0",)`` (mm).
        decimals: G-code numbers without a decimal point count this decimal (3: ``X1500`` is 1.5); 0: as they stand;
            None: a file in which that matters is refused.
        kind: ``path`` or ``holes``: meaning of the rows of a point table that does not state it.
        accept_unknown: words of the file that are not understood and, as the user says, move nothing.
        cell_offsets: names of the cell's work offsets; :func:`machopt.cell.work_offsets.place_toolpath` places them.
        max_extent: m, the longest path along one axis that is believed.
    Returns:
        The toolpath in SI units, in the coordinate system the file is written in (``workpiece``).
    Raises:
        InputError: the file or an option is wrong; names file and line, what was found and what would work.
    """
    options = ReadOptions(
        unit=unit,
        strict=strict,
        arc_tolerance=arc_tolerance,
        machine=machine,
        default_feed=default_feed,
        offsets=work_offsets(offsets),
        cycle_order=tuple(cycle_order),
        tool_axis=tool_axis,
        decimals=decimals,
        max_extent=max_extent,
        kind=kind,
        accept_unknown=tuple(normalise_word(w) for w in accept_unknown),
        cell_offsets=tuple(cell_offsets),
    )
    return _read_with_options(Path(path), options, robot)


def _read_with_options(path: Path, options: ReadOptions, robot: ProgramRobot | None) -> Toolpath:
    """Read a file; where it lacks an option and also has an error that no option cures, the error comes first."""
    if options.cell_offsets and options.offsets:
        raise OptionError("the cell defines the work offsets; remove --offset", where="--offset")
    try:
        found = _read_file(path, options, robot)
    except OptionNeededError as question:
        fault = find_fault_behind(question, options, lambda assumed: check_readable(path, assumed, robot))
        raise (fault or question) from None
    return check_reading_options(path, found, options)


def check_readable(path: Path, options: ReadOptions, robot: ProgramRobot | None) -> None:
    """Read a file only to find its errors.

    Args:
        path: Path of the file.
        options: Reading options of the user (unit, feed, tolerances, accepted words).
        robot: Robot that gives the kinematics of a robot program; None where none is known.

    Raises:
        InputError: the file cannot be read.
    """
    _read_file(path, options, robot)


def _read_file(path: Path, options: ReadOptions, robot: ProgramRobot | None) -> Toolpath:
    """Read the file with the reader that matches its content."""
    data = read_bytes(path)
    if data[:4] == b"PAR1":
        return read_parquet(path, data, options)
    if data[:2] == b"\x1f\x8b" or data[:2] == b"PK":
        packed = "gzip" if data[0] == 0x1F else "zip"
        what = "a packed PolyScope program; save it as a script" if path.suffix.lower() == ".urp" else "compressed"
        raise FileFormatError(f"is {what} ({packed}); {_READABLE}", file=path)
    from machopt.programs.program_reader import is_program, read_program_as_toolpath  # every reader of its own: late

    source = decode_source(path, data)
    if is_program(source):
        return read_program_as_toolpath(path, options, robot=robot)
    reader = _select_reader(source)
    if options.decimals is not None and reader.__name__ != "read_gcode":
        raise source.build_error(
            "--decimals is for numbers of G-code without a decimal point; leave it out for this file"
        )
    return reader(source, options)


def _select_reader(source: SourceFile) -> Callable[[SourceFile, ReadOptions], Toolpath]:
    """The reader of a file, which alone is loaded."""
    head = "\n".join(source.lines[:_HEAD_LINES])
    if is_point_table(source):
        return read_csv
    if dialect_detection.NCI.match("\n".join(source.lines[:_NCI_LINES]) + "\n"):
        from machopt.toolpath.readers.mastercam_nci import read_nci

        return read_nci
    for pattern, reason in _REFUSED:
        if re.search(pattern, head, re.MULTILINE):
            raise source.build_error(reason)
    if dialect_detection.HEIDENHAIN.search(head):
        from machopt.toolpath.readers.heidenhain.conversational_reader import read_heidenhain

        return read_heidenhain
    if dialect_detection.HEIDENHAIN_ISO.search(head):
        from machopt.toolpath.readers.heidenhain.din_iso_reader import read_heidenhain_iso

        return read_heidenhain_iso
    if dialect_detection.CL_DATA.search(head):
        if dialect_detection.PART_PROGRAM.search(head) and not re.search(r"TOOL PATH/|\*CATIA", head):
            line = head[: dialect_detection.PART_PROGRAM.search(head).start()].count("\n") + 1  # type: ignore[union-attr]
            raise source.build_error(
                "is an APT part program: geometry and motion commands for the APT processor, no tool points yet. Run "
                "the processor and give its cutter location file",
                line,
            )
        from machopt.toolpath.readers.apt.apt_reader import read_apt

        return read_apt
    if dialect_detection.PART_PROGRAM.search(head) and re.search(r"^\s*partno", head, re.IGNORECASE | re.MULTILINE):
        raise source.build_error("is an APT part program without tool points; give the cutter location file it makes")
    if len(dialect_detection.G_CODE.findall(head)) >= 2 or re.search(r"^\s*O\s*<", head, re.IGNORECASE | re.MULTILINE):
        from machopt.toolpath.readers.gcode.gcode_reader import read_gcode

        return read_gcode
    if other := describe_other_layout(source):
        raise source.build_error(*other)
    raise source.build_error(f"is not recognised as a toolpath; {_READABLE}")
