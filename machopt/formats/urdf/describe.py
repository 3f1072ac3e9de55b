"""A robot's description, whether written as URDF or as xacro."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from machopt.errors import InputError
from machopt.formats.urdf.expand import Find, expand, is_xacro
from machopt.formats.urdf.meshes import find_package
from machopt.formats.urdf.read import read_urdf
from machopt.formats.urdf.tree import Urdf

_UP = 3  # folders above a lone xacro file in which its packages are looked for


@dataclass(frozen=True)
class Description:
    """``text`` is the URDF where the file itself is xacro; ``files`` are those that made it."""

    urdf: Urdf
    text: str | None = None
    files: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()


def describe(path: Path, arguments: Mapping[str, str], find: Find) -> Description:
    """Read a robot.

    Args:
        path: URDF or xacro file.
        arguments: of a xacro file.
        find: folder of a package that a xacro file asks for.

    Raises:
        InputError: what :func:`read_urdf` and :func:`expand` refuse, or arguments for a file that takes none.
    """
    if not is_xacro(path):
        if arguments:
            raise InputError("is no xacro file, so it takes no xacro_args; leave them out", file=path)
        return Description(read_urdf(path))
    found = expand(path, arguments, find)
    try:
        urdf = read_urdf(path, found.text)
    except InputError as problem:
        where = None if problem.where is None else f"{problem.where} of the URDF it expands to"
        raise InputError(problem.reason, file=problem.file, where=where) from None
    return Description(urdf, found.text, found.files, tuple(f"{path.name}: xacro: {line}" for line in found.warnings))


def read_robot(path: Path) -> Urdf:
    """A URDF or xacro file by itself, its packages beside it or a few folders above."""
    return describe_alone(path).urdf


def describe_alone(path: Path) -> Description:
    """The same with the text that a xacro file expands to."""
    return describe(path, {}, lambda name: package_alone(name, path))


def package_alone(name: str, path: Path) -> Path:
    """Folder of a package beside a robot's file or a few folders above.

    Raises:
        InputError: there is none.
    """
    above = path.resolve().parents
    return find_package(name, path, {}, above[min(_UP, len(above) - 1)])
