"""Reader of Yaskawa INFORM jobs (.JBI): positions of //POS with the instructions of //INST."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass, field

from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.called_files import find_called_file
from machopt.programs.reading.harmless_word_reasons import compile_beginning_pattern
from machopt.programs.reading.move_attributes import MoveAttributes, ProgramEnd, parse_number
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import compute_fixed_xyz_rotation
from machopt.programs.yaskawa.harmless_words import JBI

_POSITION = re.compile(r"((?:E|B)?(?:C|P|EX|BP)[0-9]+)\s*=\s*(.*)")
_REFERENCE = re.compile(r"\b((?:C|P)[0-9]+)\b")
_BASE = re.compile(r"\b(BC[0-9]+|BP[0-9]+)\b")
_LED = re.compile(r"\+MOV[JLC]\s+((?:EC|EX)[0-9]+)(?:\s+V[JRE]?\s*=\s*[0-9.]+)?")  # what the station does meanwhile
_OPTION = re.compile(r"\b(VJ|VR|VE|V|PL|CR|ACC|DEC|NWAIT|FPT)\s*=?\s*([0-9]+\.?[0-9]*|\.[0-9]+)?")
_QUIET = compile_beginning_pattern(JBI)
_CHANGES = re.compile(r"(?:SETE|SET|ADD|SUB|MUL|DIV|GETS|CNVRT|INC|DEC|CLEAR)\s+P(?:X|\[)?([0-9]+)\b")
_EVENT = re.compile(r"(?:DOUT|AOUT|PULSE|WAIT|ARCON|ARCOF|TOOLON|TOOLOF|SPINDLE|AND|OR|NOT)\b")
_JUMP = re.compile(r"(?:JUMP|IFTHEN|ELSE|ENDIF|WHILE|ENDWHILE|FOR|NEXT|CASE|SWITCH|RET)\b")
_DEEPEST = 20
_DEFAULT_V = "V is taken in mm/s, the default of the controller's unit setting"


@dataclass(frozen=True, kw_only=True)
class YaskawaPosition:
    line: int
    kind: str  # PULSE, ANGLE, RECTAN
    values: tuple[float, ...]
    base: str
    tool: str
    configuration: dict[str, object]


@dataclass
class YaskawaJob:
    source: SourceFile
    name: str = ""
    lines: list[tuple[int, str]] = field(default_factory=list)
    positions: dict[str, YaskawaPosition] = field(default_factory=dict)
    has_end: bool = False


def read_jbi(
    source: SourceFile, arc_tolerance: float, strict: bool = False, pulses_per_deg: tuple[float, ...] | None = None
) -> ParsedProgram:
    """Read a job.

    Args:
        source: the .JBI.
        arc_tolerance: m, of chords.
        strict: refuse the first word that is not understood.
        pulses_per_deg: six numbers that turn pulses into degrees; without them pulse positions have no axes.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    return _YaskawaReader(
        ProgramBuilder(source=source, dialect="jbi", arc_tolerance=arc_tolerance, strict=strict), pulses_per_deg
    ).run()


class _YaskawaReader:
    def __init__(self, out: ProgramBuilder, pulses_per_deg: tuple[float, ...] | None) -> None:
        self.out, self.scale = out, pulses_per_deg
        self.jump: tuple[int, str, SourceFile] | None = None
        self.speed: float | None = None  # mm/s of SPEED, for moves that name none

    def run(self) -> ParsedProgram:
        job = _split_job(self.out)
        self.out.name = job.name or self.out.source.path.stem
        if not job.has_end:
            self.out.warn_once("no END: the file may be cut off", len(self.out.source.lines))
        with suppress(ProgramEnd):
            self.follow(job, 0)
        if self.jump is not None and len(self.out):
            line, text, source = self.jump
            raise self.out.error(
                f"{text[:30]!r} decides while the robot runs: the order of moves is not known here; "
                "expand the job first",
                line,
                source,
            )
        return self.out.build()

    def follow(self, job: YaskawaJob, depth: int) -> None:
        if depth > _DEEPEST:
            raise self.out.error(f"calls are nested more than {_DEEPEST} deep, or {job.name} calls itself")
        for line, text in job.lines:
            self.out.step(line)
            word = text.split(" ")[0]
            if text.startswith("'"):
                self.out.comment(text[1:].strip())
            elif word in ("MOVJ", "MOVL", "IMOV", "MOVC", "MOVS", "EIMOVL", "SMOVJ", "SMOVL"):
                self.motion(job, word, text[len(word) :], line)
            elif word == "SFTON":
                raise self.out.error(
                    "SFTON shifts every point behind it by a variable that the controller holds: not followed; post "
                    "the points where they lie",
                    line,
                    job.source,
                )
            elif word == "SPEED":
                self.speed = {k: parse_number(v) for k, v in _OPTION.findall(text[5:])}.get("V")
                if self.speed is None:
                    self.out.ignore("SPEED without V", line, understood=True)
            elif (changed := _CHANGES.match(text)) and (name := _find_position_name(changed.group(1), job)):
                raise self.out.error(
                    f"{text[:30]!r} changes the position {name} while the job runs: not followed; post the "
                    "points where they lie",
                    line,
                    job.source,
                )
            elif word == "CALL" and re.search(r"\bIF\b", text):
                self.jump = self.jump or (line, text, job.source)
            elif word == "CALL":
                self.call(job, text, line, depth)
            elif word == "TIMER":
                seconds = parse_number(text.split("=")[-1].strip())
                self.out.event(text, "dwell", math.nan if seconds is None else seconds)
            elif text == "ABORT":
                self.out.end_program(text)
            elif word in ("PAUSE", "ABORT"):
                self.out.event(text, "stop")
            elif _EVENT.match(text):
                self.out.event(text, "comment")
            elif _JUMP.match(text):
                self.jump = self.jump or (line, text, job.source)
                self.out.ignore(word, line, understood=True)
            else:
                known = bool(_QUIET.match(text)) or text.startswith(("*", "///"))
                self.out.ignore("label" if text.startswith("*") else word, line, understood=known)

    def motion(self, job: YaskawaJob, word: str, rest: str, line: int) -> None:
        station = _LED.search(rest)
        if station is not None:
            rest = rest[: station.start()] + " " + rest[station.end() :]
        if word not in ("MOVJ", "MOVL") and not (word == "SMOVL" and station is not None):
            raise self.out.error(f"{word} is not read; MOVJ and MOVL would work", line, job.source)
        names = [*_BASE.findall(rest), *([] if station is None else [station.group(1)])]
        rest = _BASE.sub(" ", rest)
        reference = _REFERENCE.search(rest)
        if reference is None:
            raise self.out.error(f"{word} without a position", line, job.source)
        found = job.positions.get(reference.group(1))
        if found is None:
            raise self.out.error(
                f"{reference.group(1)} is not in //POS: the controller holds it, the job does not", line, job.source
            )
        options = {k: parse_number(v) for k, v in _OPTION.findall(rest)}
        for strange in _OPTION.sub(" ", _REFERENCE.sub(" ", rest)).split():
            self.out.ignore(strange, line, understood=False)
        kind = JOINT if word == "MOVJ" else LINEAR
        feed = math.nan
        speed = self.speed if options.get("V") is None else options["V"]
        if kind == LINEAR and speed is not None:
            feed = speed * 1e-3
            self.out.warn_once(_DEFAULT_V)
        blend = 0.0 if options.get("PL") == 0.0 else math.nan  # without PL the controller rounds as it is set up
        if options.get("CR") is not None:
            blend = float(options["CR"] or 0.0) * 1e-3
        self.out.set_base(ProgramFrame(found.base, None))
        self.out.set_tool(ProgramFrame(found.tool, None))
        level = options.get("PL")
        configuration = {**found.configuration, **({} if level is None else {"pl": int(level)})}
        external, counted = self.read_external_positions(job, names, line)
        external += found.values[6:]
        configuration["external"] = counted
        if found.kind == "RECTAN":
            x, y, z, w, p, r = found.values[:6]
            given = MoveAttributes(feed=feed, blend=blend, external=external, configuration=configuration)
            self.out.pose(kind, compute_fixed_xyz_rotation(w, p, r), (x * 1e-3, y * 1e-3, z * 1e-3), line, given)
            return
        axes = list(found.values[:6])
        if found.kind == "PULSE":
            configuration["pulses"] = tuple(int(v) for v in axes)
            axes = [math.nan] * 6 if self.scale is None else [v / s for v, s in zip(axes, self.scale, strict=True)]
        given = MoveAttributes(feed=feed, blend=blend, external=external, configuration=configuration)
        self.out.joint(axes, line, given, kind=kind)

    def read_external_positions(
        self, job: YaskawaJob, names: list[str], line: int
    ) -> tuple[tuple[float, ...], tuple[str, ...]]:
        """Values of base and station axes, and what each is counted in: pulse, or angle for mm and degrees."""
        values: tuple[float, ...] = ()
        counted: tuple[str, ...] = ()
        for name in names:
            found = job.positions.get(name)
            if found is None:
                raise self.out.error(
                    f"{name} is not in //POS: the controller holds it, the job does not", line, job.source
                )
            values += found.values
            counted += (found.kind.lower(),) * len(found.values)
        return values, counted

    def call(self, job: YaskawaJob, text: str, line: int, depth: int) -> None:
        found = re.match(r"CALL\s+JOB\s*:\s*(\S+)", text)
        name = found.group(1) if found else ""
        other = find_called_file(job.source.path, name, (".jbi",)) if re.fullmatch(r"[\w.-]+", name) else None
        if other is None:
            self.out.event(text)
            self.out.ignore(text[:40], line, understood=False)
            return
        self.out.files.append(other.path)
        self.follow(_split_job(self.out, other), depth + 1)


def _find_position_name(number: str, job: YaskawaJob) -> str:
    """The name of a position variable of //POS by its number, however many digits it is written with; else empty."""
    return next((name for name in job.positions if re.fullmatch(rf"P0*{int(number)}", name)), "")


def _split_job(out: ProgramBuilder, source: SourceFile | None = None) -> YaskawaJob:
    """Positions and instructions of a job."""
    job = YaskawaJob(source or out.source)
    section, kind, base, tool = "", "PULSE", "robot", "TOOL 0"
    rconf: dict[str, object] = {}
    for n, raw in enumerate(job.source.lines, 1):
        text = raw.strip()
        if not text:
            continue
        if text.startswith("//") and not text.startswith("///"):
            section = text.split()[0].upper()
            if section == "//NAME":
                job.name = text[6:].strip()
            continue
        if section == "//INST":
            if text == "END":
                job.has_end = True
                break
            if not text.startswith("///"):
                job.lines.append((n, text))
            continue
        if section != "//POS":
            continue
        words = text.split()
        head = words[0].upper()
        if head == "///TOOL":
            tool = f"TOOL {words[1]}" if len(words) > 1 else tool
        elif head == "///USER":
            base = f"USER {words[1]}" if len(words) > 1 else base
        elif head == "///POSTYPE":
            what = words[1].upper() if len(words) > 1 else ""
            base = base if what == "USER" else what.lower() or base
        elif head in ("///PULSE", "///ANGLE", "///RECTAN", "///CYLNDR", "///POLAR"):
            kind = head[3:]
        elif head == "///RCONF":
            bits = [parse_number(w) for w in text[8:].split(",")]
            rconf = {"rconf": tuple(int(b) for b in bits[:6] if b is not None)}
        elif not text.startswith("///"):
            _parse_position(out, job, text, n, kind, base, tool, rconf)
    return job


def _parse_position(
    out: ProgramBuilder,
    job: YaskawaJob,
    text: str,
    line: int,
    kind: str,
    base: str,
    tool: str,
    rconf: dict[str, object],
) -> None:
    found = _POSITION.fullmatch(text)
    if found is None:
        out.ignore(text[:24], line, understood=False, stops=False)  # a move to what it may state is refused
        return
    name = found.group(1)
    values = [parse_number(v) for v in found.group(2).split(",")]
    known = tuple(v for v in values if v is not None)
    if len(known) != len(values) or (len(known) < 6 and name[0] in "CP"):
        raise out.error(f"{name} has {len(known)} numbers; expected at least 6", line, job.source)
    if kind == "RECTAN" and name[0] in "CP" and len(known) > 6:
        raise out.error(f"{name} has {len(known)} numbers; expected X, Y, Z, Rx, Ry, Rz", line, job.source)
    if kind not in ("PULSE", "ANGLE", "RECTAN"):
        raise out.error(f"positions as {kind} are not read; PULSE, ANGLE or RECTAN would work", line, job.source)
    job.positions[name] = YaskawaPosition(
        line=line, kind=kind, values=known, base=base, tool=tool, configuration=dict(rconf) if kind == "RECTAN" else {}
    )
