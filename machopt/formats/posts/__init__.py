"""Robot programs from a motion: one door for every maker. README.md explains posts to users.

A post is a template file; what a maker needs beyond the common fields (status, turns, confdata) is computed by a
dialect. Nothing here is shared with the readers in :mod:`machopt.formats.programs`, which read programs back.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from anyascii import anyascii

from machopt.domain.program import Controller, RobotProgram
from machopt.errors import InputError, nearest
from machopt.formats.posts import fanuc, jbi, krl, rapid, ros, tables, urscript, val3
from machopt.formats.posts.columns import Columns, Job, common_assumptions, common_notes, move_columns, program_fields
from machopt.formats.posts.dialect import Dialect
from machopt.formats.posts.engine import Engine, event_item, part_length, save
from machopt.formats.posts.external import external_assumptions
from machopt.formats.posts.feedmodel import HeldFeed, held_feed
from machopt.formats.posts.postfile import Post, load_post, post_names, post_text
from machopt.formats.posts.problems import CellLacksError, NoValueError
from machopt.formats.posts.rounding import Rounding
from machopt.formats.posts.wording import marked

__all__ = [
    "HeldFeed",
    "assumptions",
    "expected_text",
    "load_post",
    "model_feed",
    "needs_samples",
    "post_names",
    "post_text",
    "program_name",
    "unstarted",
    "write_program",
]

DIALECTS = {
    "krl": krl.DIALECT,
    "rapid": rapid.DIALECT,
    "fanuc": fanuc.DIALECT,
    "urscript": urscript.DIALECT,
    "val3": val3.DIALECT,
    "jbi": jbi.DIALECT,
    "table": tables.DIALECT,
    "ros": ros.DIALECT,
}


SILENT = {
    "spindle_on": "starts no spindle",
    "spindle_off": "stops no spindle",
    "coolant_on": "switches no coolant on",
    "coolant_off": "switches no coolant off",
    "tool": "changes no tool",
}
MARK = 4  # hexadecimal digits: a chance of 1 in 65,000 that two names that begin alike clash


def write_program(
    folder: Path | None,
    name: str,
    program: RobotProgram,
    post: str | Path | None = None,
    controller: Controller | None = None,
    *,
    reserved: Collection[str] = (),
) -> list[Path]:
    """Write a program.

    Args:
        folder: existing folder; None makes the texts and writes nothing.
        name: the program's name; see :func:`program_name` for one that the controller takes.
        program: the moves.
        post: a post's name (:func:`post_names`) or a template file; the controller's own by default.
        controller: what the cell says of the controller.
        reserved: names in ``folder`` that are taken.

    Returns:
        The files, in the order of the post.

    Raises:
        InputError: the name does not fit, the post is wrong, or needs what program or controller do not give.
    """
    controller = controller or Controller()
    post = post if post is not None else controller.post
    if post is None:
        raise InputError(
            f"no post is given and the cell names none; {', '.join(post_names())} are shipped", where="post"
        )
    loaded = load_post(post)
    keys = loaded.keys
    if not re.fullmatch(keys.name.pattern, name) or len(name) > keys.name.length:
        raise InputError(
            f"{name!r} is no program name for {keys.title}: {keys.name.pattern}, {keys.name.length} characters at most",
            where="name",
        )
    if keys.dialect not in DIALECTS:
        raise InputError(
            f"no dialect is named {keys.dialect!r}; {nearest(keys.dialect, list(DIALECTS))}",
            file=loaded.origin,
            where="dialect",
        )
    try:
        files = _engine(loaded, name, program, controller).files()
    except InputError as problem:
        named = problem.file is not None or isinstance(problem, CellLacksError)
        why = DIALECTS[keys.dialect].absent.get(problem.name) if isinstance(problem, NoValueError) else None
        raise InputError(
            why or problem.reason, file=problem.file if named else loaded.origin, where=problem.where
        ) from None
    taken = [f for f in files if f.lower() in {r.lower() for r in reserved}]
    if taken:
        raise InputError(
            f"writes {taken[0]}, which is a name of the output folder's own", file=loaded.origin, where="file.name"
        )
    return [] if folder is None else save(folder, files, keys.encoding, keys.line_end)


def program_name(text: str, post: str | Path) -> str:
    """The nearest name the post's controller takes: ``"2nd op-A"`` becomes ``p2nd_op_A``.

    Letters of other scripts are written in ASCII. Names that were written so or cut short end in a mark of the whole,
    so that two programs of one controller keep two names; words of the language get a ``p`` in front.
    """
    keys = load_post(post).keys.name
    latin = text if text.isascii() else anyascii(text)
    name = re.sub(r"[^A-Za-z0-9_]+", "_", latin).strip("_")
    name = name if name[:1].isalpha() and name.lower() not in keys.reserved else f"p{name}"
    if len(name) > keys.length or not text.isascii():
        mark = hashlib.sha256(text.encode()).hexdigest()[:MARK]
        name = f"{name[: keys.length - MARK - 1].rstrip('_')}_{mark}"
    return name.upper() if keys.upper else name


def needs_samples(post: str | Path) -> bool:
    """True where the post takes the control samples with their times instead of the way points."""
    return load_post(post).keys.samples


def expected_text(
    name: str,
    program: RobotProgram,
    post: str | Path,
    controller: Controller,
    *,
    said: Mapping[str, Sequence[object]],
    zone: Rounding,
) -> dict[str, str]:
    """Every file of a program with marks for coordinates: see :mod:`machopt.formats.posts.wording`.

    Args:
        name, program, post, controller: as for :func:`write_program`; of the program's poses only the lines between
            them count, of its joints nothing.
        said: columns as the program says them.
        zone: of the moves' ends, as the program says it.

    Raises:
        InputError: the post cannot write it.
    """
    return _engine(load_post(post), name, program, controller, said=said, zone=zone).files()


def model_feed(program: RobotProgram, post: str | Path, controller: Controller) -> HeldFeed | None:
    """The feed that the post's program will hold by the model of :mod:`machopt.formats.posts.feedmodel`.

    None where the post streams samples, or nothing is known of the axes' accelerations.
    """
    loaded = load_post(post)
    if loaded.keys.samples:
        return None
    dialect = DIALECTS[loaded.keys.dialect]
    job = Job.of(program, controller, part_length(loaded, controller))
    passing = dialect.passing(job, loaded.used)
    distance = passing.distance
    rounded = distance > 0.0
    if "run" in loaded.blocks.get("moves", {}):  # a spline leads through its points
        distance, rounded = np.where(job.zone.room > 0.0, job.zone.room, distance), rounded & (job.zone.room <= 0.0)
    return held_feed(program, job.zone, distance, passing.cap, rounded)


def assumptions(program: RobotProgram, post: str | Path, controller: Controller) -> tuple[str, ...]:
    """What the post takes of the controller because the cell does not say it."""
    loaded = load_post(post)
    job = Job.of(program, controller)
    return tuple(_assumptions(job, loaded.used, DIALECTS[loaded.keys.dialect]))


def _assumptions(job: Job, used: frozenset[str], dialect: Dialect) -> list[str]:
    if not dialect.maker:
        return []
    external = external_assumptions(job.program, job.controller, used) if dialect.coupled else []
    return [*common_assumptions(job), *external, *dialect.assumed(job, used)]


def unstarted(post: Post | str | Path, program: RobotProgram, controller: Controller) -> tuple[str, ...]:
    """What stands in the CAM file as spindle, coolant or tool word and in the program as a comment only.

    A sentence for each, with the key of the cell that would make it a line of the program.
    """
    loaded = post if isinstance(post, Post) else load_post(post)
    lines = controller.lines if DIALECTS[loaded.keys.dialect].maker else {}
    own = {*lines, *(item for items in loaded.blocks.values() if "ptp" in items for item in items)}
    out: dict[str, str] = {}
    for event in program.events:
        item = event_item(event)
        if item in SILENT and item not in own:
            why = f"{event.text!r} is a comment in it, because the cell has no controller.lines.{item}"
            out.setdefault(item, f"the program {SILENT[item]}: {why}")
    return tuple(out.values())


def _engine(
    post: Post,
    name: str,
    program: RobotProgram,
    controller: Controller,
    *,
    said: Mapping[str, Sequence[object]] | None = None,
    zone: Rounding | None = None,
) -> Engine:
    dialect = DIALECTS[post.keys.dialect]
    if not dialect.coupled:
        program = replace(program, T_carrier_workpiece=None)
    if not dialect.maker:
        controller = Controller()  # joints and frames stay those of the URDF
    job = Job.of(program, controller, part_length(post, controller))
    job = job if zone is None else replace(job, zone=zone)
    used = post.used
    dialect.check(job, used)
    makers = {**move_columns(job), **dialect.columns(job)}
    columns = Columns(makers) if said is None else marked(makers, said)
    values = {**program_fields(job), **dialect.values(job)}
    notes = [
        *common_notes(job, used, post.keys.samples),
        *_assumptions(job, used, dialect),
        *unstarted(post, program, controller),
        *dialect.notes(job, used),
    ]
    return Engine(post=post, job=job, name=name, columns=columns, values=values, notes=notes, own_lines=dialect.maker)
