"""Writer of robot programs for every maker. README.md explains posts to users.

A post is a template file. Maker-specific fields (status, turns, confdata) are computed by a dialect. The readers in
:mod:`machopt.programs.program_reader` share no code with this module.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from anyascii import anyascii

from machopt.data_types.robot_program import RobotController, RobotProgram
from machopt.errors import InputError, PostError, suggest_nearest_word
from machopt.programs.maker_registry import list_template_languages
from machopt.programs.writing.blend_zones import BlendZones
from machopt.programs.writing.external_axes import list_external_assumptions
from machopt.programs.writing.feed_model import FeedModelResult, compute_program_feed
from machopt.programs.writing.maker_rules import MakerRules
from machopt.programs.writing.post_errors import MissingControllerKeyError, MissingFieldValueError
from machopt.programs.writing.post_file import PostTemplate, list_post_names, load_post, read_post_text
from machopt.programs.writing.program_files import write_program_files
from machopt.programs.writing.template_engine import TemplateEngine, compute_part_length, find_event_item
from machopt.programs.writing.template_fields import (
    LazyColumns,
    PostJob,
    build_move_columns,
    build_program_fields,
    list_common_assumptions,
    list_common_notes,
)
from machopt.programs.writing.text_comparison import mark_coordinates

__all__ = [
    "FeedModelResult",
    "estimate_program_feed",
    "format_program_name",
    "has_sampled_output",
    "list_assumptions",
    "list_post_names",
    "list_unstarted_events",
    "load_post",
    "read_post_text",
    "render_expected_text",
    "write_program",
]

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
    controller: RobotController | None = None,
    *,
    reserved: Collection[str] = (),
) -> list[Path]:
    """Write a program.

    Args:
        folder: existing folder; None makes the texts and writes nothing.
        name: the program's name; see :func:`format_program_name` for one that the controller takes.
        program: the moves.
        post: a post's name (:func:`list_post_names`) or a template file; the controller's own by default.
        controller: what the cell says of the controller.
        reserved: names in ``folder`` that are taken.

    Returns:
        The files, in the order of the post.

    Raises:
        InputError: the name does not fit, the post is wrong, or needs what program or controller do not give.
    """
    controller = controller or RobotController()
    post = post if post is not None else controller.post
    if post is None:
        raise PostError(
            f"no post is given and the cell names none; {', '.join(list_post_names())} are shipped", where="post"
        )
    loaded = load_post(post)
    keys = loaded.keys
    _check_name_and_dialect(loaded, name)
    try:
        files = _build_engine(loaded, name, program, controller).files()
    except InputError as problem:
        named = problem.file is not None or isinstance(problem, MissingControllerKeyError)
        why = (
            _load_rules(keys.dialect).absent.get(problem.name) if isinstance(problem, MissingFieldValueError) else None
        )
        raise PostError(
            why or problem.reason, file=problem.file if named else loaded.origin, where=problem.where
        ) from None
    taken = [f for f in files if f.lower() in {r.lower() for r in reserved}]
    if taken:
        raise PostError(
            f"writes {taken[0]}, which is a name of the output folder's own", file=loaded.origin, where="file.name"
        )
    return [] if folder is None else write_program_files(folder, files, keys.encoding, keys.line_end)


def _check_name_and_dialect(loaded: PostTemplate, name: str) -> None:
    keys = loaded.keys
    if not re.fullmatch(keys.name.pattern, name) or len(name) > keys.name.length:
        raise PostError(
            f"{name!r} is no program name for {keys.title}: {keys.name.pattern}, {keys.name.length} characters at most",
            where="name",
        )
    if keys.dialect not in list_template_languages():
        raise PostError(
            f"no dialect is named {keys.dialect!r}; "
            f"{suggest_nearest_word(keys.dialect, list(list_template_languages()))}",
            file=loaded.origin,
            where="dialect",
        )


def format_program_name(text: str, post: str | Path) -> str:
    """Convert a text to the nearest name that the controller accepts: ``"2nd op-A"`` becomes ``p2nd_op_A``.

    Letters of other scripts are transliterated to ASCII. A transliterated or shortened name ends in a hash of the whole
    text, so that two programs of one controller keep different names. Words of the language get the prefix ``p``.

    Args:
        text: The wanted name.
        post: Name of a shipped post, or path of a template file.

    Returns:
        The name.
    """
    keys = load_post(post).keys.name
    latin = text if text.isascii() else anyascii(text)
    name = re.sub(r"[^A-Za-z0-9_]+", "_", latin).strip("_")
    name = name if name[:1].isalpha() and name.lower() not in keys.reserved else f"p{name}"
    if len(name) > keys.length or not text.isascii():
        mark = hashlib.sha256(text.encode()).hexdigest()[:MARK]
        name = f"{name[: keys.length - MARK - 1].rstrip('_')}_{mark}"
    return name.upper() if keys.upper else name


def has_sampled_output(post: str | Path) -> bool:
    """Return whether the post writes control samples with their times instead of way points.

    Args:
        post: Name of a shipped post, or path of a template file.
    """
    return load_post(post).keys.samples


def render_expected_text(
    name: str,
    program: RobotProgram,
    post: str | Path,
    controller: RobotController,
    *,
    numbers_by_axis: Mapping[str, Sequence[object]],
    zone: BlendZones,
) -> dict[str, str]:
    """Every file of a program with marks for coordinates: see :mod:`machopt.programs.writing.text_comparison`.

    Args:
        name, program, post, controller: as for :func:`write_program`; of the program's poses only the lines between
            them count, of its joints nothing.
        numbers_by_axis: columns as the program says them.
        zone: of the moves' ends, as the program says it.

    Raises:
        InputError: the post cannot write it.
    """
    return _build_engine(load_post(post), name, program, controller, numbers_by_axis=numbers_by_axis, zone=zone).files()


def estimate_program_feed(
    program: RobotProgram, post: str | Path, controller: RobotController
) -> FeedModelResult | None:
    """Estimate the feed of the post's program by the model of :mod:`machopt.programs.writing.feed_model`.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        post: Name of a shipped post, or path of a template file.
        controller: Controller settings of the cell.

    Returns:
        The result; None where the post writes samples or the axis accelerations are unknown.
    """
    loaded = load_post(post)
    if loaded.keys.samples:
        return None
    dialect = _load_rules(loaded.keys.dialect)
    job = PostJob.build(program, controller, compute_part_length(loaded, controller))
    passing = dialect.passing(job, loaded.list_used_fields)
    distance = passing.distance
    rounded = distance > 0.0
    if "run" in loaded.blocks.get("moves", {}):  # a spline leads through its points
        distance, rounded = np.where(job.zone.room > 0.0, job.zone.room, distance), rounded & (job.zone.room <= 0.0)
    return compute_program_feed(program, job.zone, distance, passing.cap, rounded)


def list_assumptions(program: RobotProgram, post: str | Path, controller: RobotController) -> tuple[str, ...]:
    """List what the post assumes about the controller because the cell does not give it.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        post: Name of a shipped post, or path of a template file.
        controller: Controller settings of the cell.

    Returns:
        One sentence per assumption.
    """
    loaded = load_post(post)
    job = PostJob.build(program, controller)
    return tuple(_list_assumptions(job, loaded.list_used_fields, _load_rules(loaded.keys.dialect)))


def _list_assumptions(job: PostJob, used: frozenset[str], dialect: MakerRules) -> list[str]:
    if not dialect.maker:
        return []
    external = list_external_assumptions(job.program, job.controller, used) if dialect.coupled else []
    return [*list_common_assumptions(job), *external, *dialect.assumptions(job, used)]


def _list_rapid_notes(job: PostJob, dialect: MakerRules, samples: bool) -> list[str]:
    if samples or job.zone.rapid is None or not (job.zone.rapid > 0.0).any():
        return []
    reason = dialect.rapid_stops(job)
    if reason:
        return [f"rapid moves stop at every point: {reason}"]
    return ["rapid moves run on where the plan rounds their corners, inside of what it has checked"]


def list_unstarted_events(
    post: PostTemplate | str | Path, program: RobotProgram, controller: RobotController
) -> tuple[str, ...]:
    """List spindle, coolant and tool words of the CAM file that the program holds as comments only.

    Args:
        post: Name of a shipped post, or path of a template file.
        program: Robot program: targets, poses and moves in SI units.
        controller: Controller settings of the cell.

    Returns:
        One sentence each, with the key of the cell that would make it a line of the program.
    """
    loaded = post if isinstance(post, PostTemplate) else load_post(post)
    lines = controller.lines if _load_rules(loaded.keys.dialect).maker else {}
    own = {*lines, *(item for items in loaded.blocks.values() if "ptp" in items for item in items)}
    out: dict[str, str] = {}
    for event in program.events:
        item = find_event_item(event)
        if item in SILENT and item not in own:
            why = f"{event.text!r} is a comment in it, because the cell has no controller.lines.{item}"
            out.setdefault(item, f"the program {SILENT[item]}: {why}")
    return tuple(out.values())


def _build_engine(
    post: PostTemplate,
    name: str,
    program: RobotProgram,
    controller: RobotController,
    *,
    numbers_by_axis: Mapping[str, Sequence[object]] | None = None,
    zone: BlendZones | None = None,
) -> TemplateEngine:
    dialect = _load_rules(post.keys.dialect)
    if not dialect.coupled:
        program = replace(program, T_carrier_workpiece=None)
    if not dialect.maker:
        controller = RobotController()  # joints and frames stay those of the URDF
    job = PostJob.build(program, controller, compute_part_length(post, controller))
    job = job if zone is None else replace(job, zone=zone)
    used = post.list_used_fields
    dialect.check(job, used)
    makers = {**build_move_columns(job), **dialect.columns(job)}
    columns = LazyColumns(makers) if numbers_by_axis is None else mark_coordinates(makers, numbers_by_axis)
    values = {**build_program_fields(job), **dialect.values(job)}
    notes = [
        *list_common_notes(job, used, post.keys.samples),
        *_list_rapid_notes(job, dialect, post.keys.samples),
        *_list_assumptions(job, used, dialect),
        *list_unstarted_events(post, program, controller),
        *dialect.notes(job, used),
    ]
    return TemplateEngine(
        post=post, job=job, name=name, columns=columns, values=values, notes=notes, own_lines=dialect.maker
    )


def _load_rules(dialect: str) -> MakerRules:
    language = list_template_languages()[dialect]
    rules: MakerRules = language.load(language.rules)
    return rules
