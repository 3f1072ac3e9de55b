"""Damaged robot programs as they result from editors, transfers and truncated downloads, and conditions that the
readers must fulfil."""

from __future__ import annotations

import contextlib
import random
import signal
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from sample_robot_programs import ARM, MAPPED, TOOL, WORKPIECE, Recipe, program

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.file_formats.source_file import ReadOptions, decode_source, read_bytes
from machopt.programs.program_reader import ProgramRobot, read_program
from machopt.programs.program_to_toolpath import convert_to_toolpath
from machopt.programs.program_writer import format_program_name, write_program
from machopt.programs.reading.parsed_program import ParsedProgram

FORMATS = {
    "krl": ("krl", "krl_pos", "krl_spline"),
    "rapid": ("rapid",),
    "fanuc": ("fanuc", "fanuc_joint"),
    "urscript": ("urscript", "urscript_movep", "urscript_servoj"),
    "val3": ("val3",),
    "jbi": ("jbi", "jbi_rectan"),
    "csv": ("csv",),
    "json": ("json",),
    "ros": ("ros_yaml", "ros_json", "compas_fab"),
}
ROBOT = ProgramRobot(ARM.compute_fk, MAPPED, TOOL, WORKPIECE)
HANG = 20.0  # s, limit of the processor time for one small file
MOST_POINTS = 1_000_000  # limit for a file of a hundred lines
MAIN_SUFFIXES = (".src", ".mod", ".ls", ".script", ".pjx", ".jbi", ".csv", ".json", ".yaml")
_WORDS = (
    "PTP",
    "LIN",
    "CIRC",
    "SPL",
    "FOR i = 1 TO 99999999",
    "ENDFOR",
    "END",
    "IF",
    "MoveL",
    "MoveC",
    "PROC x()",
    "ENDPROC",
    "{",
    "}",
    "[",
    "]",
    "[[",
    "(",
    ")",
    "p[",
    "movel(",
    "def f():",
    "end",
    "P[1]",
    "C P[2]",
    "J",
    "L",
    "/POS",
    "/END",
    "//INST",
    "///PULSE",
    "C00001",
    "MOVC",
    "CALL X",
    "9E9",
    "1e308",
    "-1e999",
    "nan",
    "inf",
    "--",
    "$VEL.CP=0",
    "$BASE=",
    "\\WObj:=",
    ":=",
    ";",
    ",",
    '"',
    "'",
    '<Value key="x"',
    "]]>",
    "&amp;",
    "<!DOCTYPE a>",
    "positions",
    "true",
    "null",
    "#",
    "!",
    "0x10",
    "1_0",
    "\x00",
    "\xff",
    "ä",
)


def seeds(folder: Path, form: str) -> list[Path]:
    """Write folders with a small valid program each; the first file is the one to read."""
    out = []
    for post in FORMATS[form]:
        for n, split in ((0, None), (1, 5)):
            place = folder / f"{post}_{n}"
            place.mkdir(parents=True)
            controller = replace(MAPPED, moves_per_part=split)
            recipe = Recipe(n, moves=9, blend=1e-4 * n)
            write_program(place, format_program_name("part", post), program(recipe, controller), post, controller)
            out.append(place)
    return out


def main_file(place: Path) -> Path:
    files = [f for f in sorted(place.rglob("*")) if f.suffix.lower() in MAIN_SUFFIXES and "events" not in f.name]
    return min(files, key=lambda f: len(f.name))  # part files have longer names


def damage_program(data: bytes, rng: random.Random) -> bytes:
    """Insert one to six faults: truncation, changed bytes, lost, duplicated or exchanged lines, replaced numbers and
    words."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        if not out:
            break
        choice, at = rng.random(), rng.randrange(len(out))
        if choice < 0.08:
            del out[at:]
        elif choice < 0.3:
            out[at] = rng.randrange(256)
        elif choice < 0.4:
            del out[at : at + rng.randint(1, 30)]
        elif choice < 0.6:
            word = rng.choice(_WORDS).encode("latin-1")
            out[at : at + rng.randint(0, len(word))] = word
        elif choice < 0.8:
            lines = bytes(out).split(b"\n")
            k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
            what = rng.random()
            if what < 0.3:
                lines.insert(j, lines[k])
            elif what < 0.6:
                del lines[k]
            else:
                lines[k], lines[j] = lines[j], lines[k]
            out = bytearray(b"\n".join(lines))
        else:
            digits = [k for k in range(max(at - 60, 0), min(at + 60, len(out))) if 48 <= out[k] <= 57]
            if digits:
                k = rng.choice(digits)
                out[k : k + rng.randint(1, 3)] = rng.choice(
                    (b"9", b"", b"-", b".", b"e", b"99999999", b"1.2.3", b"\xc2\xb2")
                )
    return bytes(out)


def run(place: Path, count: int, rng: random.Random) -> Counter[str]:
    """Read ``count`` damaged versions of a program, convert them to toolpaths, and return how many were read and
    refused.

    Raises:
        Exception: any exception other than a refusal; the damaged files are not deleted.
    """
    target = main_file(place)
    files = [f for f in sorted(place.rglob("*")) if f.is_file()]
    sound = {f: f.read_bytes() for f in files}
    options = ReadOptions(default_feed=0.01)
    out: Counter[str] = Counter()
    for _ in range(count):
        victim = rng.choice(files) if rng.random() < 0.5 else target
        victim.write_bytes(damage_program(sound[victim], rng))
        start = time.process_time()
        with limit_time(HANG):
            try:
                parsed = read_program(target)
                check_program(parsed)
                check(convert_to_toolpath(parsed, decode_source(target, read_bytes(target)), options, ROBOT), None)
                out["read"] += 1
            except InputError as error:
                if not error.reason.strip():
                    raise
                out["refused"] += 1
        out["slowest_ms"] = max(out["slowest_ms"], round(1e3 * (time.process_time() - start)))
        victim.write_bytes(sound[victim])
    return out


def check(toolpath: Toolpath, lines: int | None) -> None:
    """Check the conditions for every toolpath; ``lines`` is the number of lines, None if the program calls other
    files."""
    n = len(toolpath)
    assert 0 < n <= MOST_POINTS
    assert toolpath.cutting.any()
    assert np.isfinite(toolpath.position).all()
    assert np.abs(toolpath.position).max() <= 1e3  # m: limit of the readers
    assert np.allclose(np.linalg.norm(toolpath.axis, axis=1), 1.0, atol=1e-9)
    assert (toolpath.feed[toolpath.cutting] > 0.0).all()
    assert np.isfinite(toolpath.feed[toolpath.cutting]).all()
    assert set(np.unique(toolpath.move).tolist()) <= {int(m) for m in MoveKind}
    assert ((toolpath.operation >= 0) & (toolpath.operation < len(toolpath.operations))).all()
    assert (np.diff(toolpath.operation) >= 0).all()
    assert (toolpath.line >= 1).all()
    assert lines is None or (toolpath.line <= max(lines, n)).all()
    assert all(0 <= e.index <= n for e in toolpath.events)
    assert all(w.count >= 1 for w in toolpath.ignored)
    if any(not w.understood for w in toolpath.ignored):
        assert any("not understood" in w for w in toolpath.warnings)


class HangError(AssertionError):
    """A reader took too long."""


@contextlib.contextmanager
def limit_time(seconds: float) -> Iterator[None]:
    """Raise :class:`HangError` if the block takes longer, in processor time of this process."""

    def late(*_: object) -> None:
        raise HangError(f"took longer than {seconds:g} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def check_program(p: ParsedProgram) -> None:
    """Check that every target is finite where it is given, and that every index is in range."""
    assert len(p) > 0
    joint = ~p.has_pose
    pulses = np.array(["pulses" in c for c in p.configuration])
    assert np.isfinite(p.axes_deg[joint & ~pulses]).all()
    assert np.isfinite(p.T_base_tcp[p.has_pose]).all()
    R = p.T_base_tcp[p.has_pose][:, :3, :3]
    assert np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(initial=0.0) < 1e-6
    assert ((p.feed > 0) | np.isnan(p.feed)).all()
    assert all(0 <= e.index <= len(p) for e in p.events)
    assert (p.base < len(p.bases)).all()
    assert (p.operation < len(p.operations)).all()
