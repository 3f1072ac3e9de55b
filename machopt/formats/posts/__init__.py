"""Robot programs from a motion: one door for every maker. README.md explains posts to users.

A post is a template file; what a maker needs beyond the common fields (status, turns, confdata) is computed by a
dialect. Nothing here is shared with the readers in :mod:`machopt.formats.programs`, which read programs back.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from machopt.domain.program import Controller, RobotProgram
from machopt.errors import InputError
from machopt.formats.posts import fanuc, jbi, krl, rapid, ros, tables, urscript, val3
from machopt.formats.posts.columns import Columns, Job, common_notes, move_columns, program_fields
from machopt.formats.posts.engine import Engine, part_length, save
from machopt.formats.posts.postfile import Post, load_post, post_names, post_text
from machopt.formats.yamlstrict import nearest

__all__ = ["load_post", "needs_samples", "post_names", "post_text", "program_name", "write_program"]

DIALECTS = {
    "krl": krl.DIALECT, "rapid": rapid.DIALECT, "fanuc": fanuc.DIALECT, "urscript": urscript.DIALECT,
    "val3": val3.DIALECT, "jbi": jbi.DIALECT, "table": tables.DIALECT, "ros": ros.DIALECT,
}  # fmt: skip


def write_program(
    folder: Path | None, name: str, program: RobotProgram, post: str | Path | None = None,
    controller: Controller | None = None, *, reserved: Collection[str] = (),
) -> list[Path]:  # fmt: skip
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
    loaded = load_post(post if post is not None else controller.post)
    keys = loaded.keys
    if not re.fullmatch(keys.name.pattern, name) or len(name) > keys.name.length:
        raise InputError(
            f"{name!r} is no program name for {keys.title}: {keys.name.pattern}, {keys.name.length} characters at most",
            where="name",
        )
    if keys.dialect not in DIALECTS:
        raise InputError(f"no dialect is named {keys.dialect!r}; {nearest(keys.dialect, list(DIALECTS))}",
                         file=loaded.origin, where="dialect")  # fmt: skip
    try:
        files = _engine(loaded, name, program, controller).files()
    except InputError as problem:
        file = (
            problem.file
            if problem.file is not None or (problem.where or "").startswith("controller")
            else loaded.origin
        )
        known = DIALECTS[keys.dialect].absent
        why = next((text for name, text in known.items() if f"no value for @{{{name}}}" in problem.reason), "")
        raise InputError(why or problem.reason, file=file, where=problem.where) from None
    taken = [f for f in files if f.lower() in {r.lower() for r in reserved}]
    if taken:
        raise InputError(f"writes {taken[0]}, which is a name of the output folder's own",
                         file=loaded.origin, where="file.name")  # fmt: skip
    return [] if folder is None else save(folder, files, keys.encoding, keys.line_end)


def program_name(text: str, post: str | Path) -> str:
    """The nearest name the post's controller takes: ``"2nd op-A"`` becomes ``p2nd_op_A``."""
    keys = load_post(post).keys.name
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
    name = (name if name[:1].isalpha() else f"p{name}")[: keys.length]
    return name.upper() if keys.upper else name


def needs_samples(post: str | Path) -> bool:
    """True where the post takes the control samples with their times instead of the way points."""
    return load_post(post).keys.samples


def _engine(post: Post, name: str, program: RobotProgram, controller: Controller) -> Engine:
    dialect = DIALECTS[post.keys.dialect]
    if not dialect.maker:
        controller = Controller()  # joints and frames stay those of the URDF
    job = Job.of(program, controller, part_length(post, controller))
    used = post.used
    dialect.check(job, used)
    columns = Columns({**move_columns(job), **dialect.columns(job)})
    values = {**program_fields(job), **dialect.values(job)}
    notes = [*common_notes(job, used, dialect.maker, post.keys.samples), *dialect.notes(job, used)]
    return Engine(post, job, name, columns, values, notes, dialect.maker)
