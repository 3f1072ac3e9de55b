"""A robot's description, whether written as URDF or as xacro."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from machopt.errors import InputError
from machopt.formats.opener import MARKUP, read_text
from machopt.formats.urdf.expand import Find, expand, is_xacro
from machopt.formats.urdf.markup import with_prefixes
from machopt.formats.urdf.meshes import find_package, holding, package_around
from machopt.formats.urdf.read import read_urdf
from machopt.formats.urdf.tree import Urdf

_UP = 5  # folders above a lone robot's file in which its packages are looked for


@dataclass(frozen=True)
class Description:
    """``text`` is the URDF where the file itself is xacro, or has prefixes that it does not declare; ``files`` are
    those that made it."""

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
        return Description(read_urdf(path), with_prefixes(read_text(path, expected="a URDF", most=MARKUP)))
    found = expand(path, arguments, find)
    try:
        urdf = read_urdf(path, found.text)
    except InputError as problem:
        where = None if problem.where is None else f"{problem.where} of the URDF it expands to"
        raise InputError(problem.reason, file=problem.file, where=where) from None
    return Description(
        urdf,
        with_prefixes(found.text) or found.text,
        found.files,
        tuple(f"{path.name}: xacro: {line}" for line in found.warnings),
    )


def read_robot(path: Path) -> Urdf:
    """A URDF or xacro file by itself, its packages beside it or a few folders above."""
    return describe_alone(path).urdf


def describe_alone(path: Path, packages: Mapping[str, Path] | None = None) -> Description:
    """The same with the text that a xacro file expands to; ``packages``: folders by name, looked at first."""
    return describe(path, {}, lambda name: package_alone(name, path, packages or {}, _included(name, path)))


def package_alone(name: str, path: Path, packages: Mapping[str, Path], rests: Iterable[str]) -> Path:
    """Folder of a package: as given, or beside a robot's file or a few folders above, or the one around it.

    Args:
        name: of the package.
        path: the robot's file.
        packages: folders that are known, by name.
        rests: files that are asked for in the package, relative to it (:func:`package_around`).

    Raises:
        InputError: there is none.
    """
    above = path.resolve().parents
    try:
        if name not in packages and (sure := holding(name, path, rests, _UP)) is not None:
            return sure
        return find_package(name, path, dict(packages), above[min(_UP, len(above) - 1)])
    except InputError:
        around = package_around(name, rests, path, _UP)
    if around is None:
        raise InputError(
            f"asks for the ROS package {name!r}, and no folder of that name, with that name in its package.xml, or "
            f"with the file asked for stands beside the robot's file or above it; --package {name}=FOLDER would work",
            file=path,
        )
    return around


def _included(name: str, path: Path) -> list[str]:
    """What the robot's file, and the xacro files beside it, want of a package."""
    wanted = re.compile(rf"\$\(find\s+{re.escape(name)}\s*\)/([^\"'$]+)[\"']")
    files = [path, *sorted(p for p in path.parent.glob("*.xacro") if p != path)]
    return [rest for file in files for rest in wanted.findall(read_text(file, expected="a xacro file", most=MARKUP))]
