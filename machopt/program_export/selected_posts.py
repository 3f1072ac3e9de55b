"""Selection of the posts of a job; each is tested with a short program before planning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.data_types.cell import Cell
from machopt.errors import OptionError
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.programs.program_writer import format_program_name, load_post, write_program
from machopt.programs.writing.post_file import list_post_names
from machopt.verification.folder.programs.post_lookup import build_short_program, select_controller


@dataclass(frozen=True)
class SelectedPost:
    """One post of a job."""

    post: str | Path
    label: str  # as the user gave it; a file by its name
    folder: str  # inside the output folder, empty for the output folder itself


def select_posts(cell: Cell, names: Sequence[str]) -> tuple[SelectedPost, ...]:
    """Return the requested posts, or the cell's own, or none; each is tested with a short program.

    One post writes into the output folder itself, several into their own folders.

    Args:
        cell: The robot cell.
        names: Names or template files of the requested posts.

    Raises:
        InputError: unknown post, faulty template, the same post twice, or the cell lacks what the post needs.
    """
    out: list[SelectedPost] = []
    for text in names or ([] if cell.controller.post is None else [cell.controller.post]):
        file = is_post_file(text)
        post: str | Path = Path(text) if file else text
        label = Path(text).name if file else text
        folder = Path(text).stem if file else text
        if any(w.folder.lower() == folder.lower() for w in out):
            raise OptionError(f"{text!r} is requested twice, or two files have one name", where="--post")
        out.append(SelectedPost(post, label, folder if len(names) > 1 else ""))
    robot = load_robot(cell)
    for one in out:
        _test_post(cell, robot, one)
    return tuple(out)


def is_post_file(text: str) -> bool:
    """Return whether a text is a template file and not the name of a shipped post.

    Args:
        text: Name or path.
    """
    return text.endswith(".toml") or (text not in list_post_names() and Path(text).is_file())


def _test_post(cell: Cell, robot: Robot, one: SelectedPost) -> None:
    """Fill the post once, into nothing: what would fail after the plan should fail before it."""
    keys = load_post(one.post).keys
    controller = select_controller(cell, one.post)
    program = build_short_program(cell, robot, controller)
    name = format_program_name("part", one.post)
    write_program(None, name, program, one.post, controller)
    if keys.moves_per_part is not None:  # the same in two parts, whose calls are templates of their own
        write_program(None, name, program, one.post, replace(controller, moves_per_part=1))
