"""Reader of a robot description in URDF or xacro."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.urdf.element_removal import remove_empty_dynamics
from machopt.cell.urdf.mesh_lookup import find_package, find_package_around, find_package_with_file
from machopt.cell.urdf.urdf_model import UrdfModel
from machopt.cell.urdf.urdf_reader import read_urdf
from machopt.cell.urdf.xacro_expansion import PackageFinder, expand_xacro, is_xacro
from machopt.cell.urdf.xacro_limits import FileAccessCheck
from machopt.cell.urdf.xml_tree import add_missing_prefixes
from machopt.errors import InputError, RobotModelError
from machopt.file_formats.file_reading import MARKUP, read_text

_PACKAGE = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)
_UP = 5  # folders above a lone robot's file in which its packages are searched


@dataclass(frozen=True)
class RobotDescription:
    """A robot's file as it was read.

    ``text`` is the URDF where the file itself is xacro, or has prefixes that it does not declare, or elements that the
    parser of the robot model does not accept; ``whole`` is the same with those elements, for a copy; ``files`` are
    those that made it.
    """

    urdf: UrdfModel
    text: str | None = None
    whole: str | None = None
    files: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()


def read_description(
    path: Path, arguments: Mapping[str, str], find: PackageFinder, may: FileAccessCheck
) -> RobotDescription:
    """Read a robot.

    Args:
        path: URDF or xacro file.
        arguments: of a xacro file.
        find: folder of a package that a xacro file asks for.
        may: called with every further file before it is opened; raises InputError where it may not be read.

    Raises:
        InputError: what :func:`read_urdf` and :func:`expand_xacro` refuse, or arguments for a file that takes none.
    """
    if not is_xacro(path):
        if arguments:
            raise RobotModelError(
                "is no xacro file, so it takes no xacro arguments (xacro_args, --xacro-arg)", file=path
            )
        urdf, text = read_urdf(path), read_text(path, expected="a URDF", most=MARKUP)
        return RobotDescription(urdf, _convert_to_accepted_urdf(urdf, text), add_missing_prefixes(text))
    found = expand_xacro(path, arguments, find, may)
    try:
        urdf = read_urdf(path, found.text)
    except InputError as problem:
        where = None if problem.where is None else f"{problem.where} of the URDF it expands to"
        raise RobotModelError(problem.reason, file=problem.file, where=where) from None
    return RobotDescription(
        urdf,
        _convert_to_accepted_urdf(urdf, found.text) or found.text,
        add_missing_prefixes(found.text) or found.text,
        found.files,
        tuple(f"{path.name}: xacro: {line}" for line in found.warnings),
    )


def _convert_to_accepted_urdf(urdf: UrdfModel, text: str) -> str | None:
    """A text that the parser of the robot model accepts; None where the file is one already."""
    changed = add_missing_prefixes(text)
    return remove_empty_dynamics(changed or text) if urdf.empty_dynamics else changed


def read_robot(path: Path, arguments: Mapping[str, str] | None = None) -> UrdfModel:
    """Read a URDF or xacro file without a cell; packages are searched next to it and a few folders above.

    Args:
        path: Path of the file.
        arguments: xacro argument → value, None for none.

    Returns:
        The robot.
    """
    return read_standalone_description(path, arguments=arguments).urdf


def read_standalone_description(
    path: Path,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
    *,
    allow_external: bool = False,
) -> RobotDescription:
    """The same with the text that a xacro file expands to.

    Args:
        path: URDF or xacro file.
        packages: folders by name, searched first.
        arguments: values of the arguments of a xacro file.
        allow_external: let a xacro file read files outside its own package, or its parent folder, and the packages
            that it names.
    """
    given = {name: folder.absolute() for name, folder in (packages or {}).items()}  # of the current folder
    roots = [_find_own_package(path), *(folder.resolve() for folder in given.values())]

    def find(name: str) -> Path:
        found = find_standalone_package(name, path, given, _list_package_files(name, path))
        roots.append(found.resolve())
        return found

    def may(file: Path) -> None:
        if not allow_external and not any(_is_visible_below(file.resolve(), root) for root in roots):
            raise RobotModelError(
                f"names {file}, outside of its package and of those it names; --package NAME=FOLDER with $(find NAME), "
                "or --allow-external, would work",
                file=path,
            )

    return read_description(path, arguments or {}, find, may)


def _is_visible_below(file: Path, root: Path) -> bool:
    """Whether a file lies in a folder and in no hidden one of it."""
    return file.is_relative_to(root) and not any(part.startswith(".") for part in file.relative_to(root).parts)


def _find_own_package(path: Path) -> Path:
    """The package around a robot's file; where none is, the folder above the file's own."""
    above = path.resolve().parents
    return next((f for f in above[:_UP] if (f / "package.xml").is_file()), above[min(1, len(above) - 1)])


def find_standalone_package(name: str, path: Path, packages: Mapping[str, Path], rests: Iterable[str]) -> Path:
    """Folder of a package: as given, or beside a robot's file or a few folders above, or the one around it.

    Args:
        name: of the package.
        path: the robot's file.
        packages: folders that are known, by name.
        rests: requested files of the package, relative to it (:func:`find_package_around`).

    Raises:
        InputError: there is none.
    """
    if not _PACKAGE.fullmatch(name):
        raise RobotModelError(
            f"refers to the ROS package {name!r}; expected a name of letters, digits, _, - and .", file=path
        )
    above = path.resolve().parents
    try:
        if name not in packages and (sure := find_package_with_file(name, path, rests, _UP)) is not None:
            return sure
        return find_package(name, path, dict(packages), above[min(_UP, len(above) - 1)])
    except InputError:
        around = find_package_around(name, rests, path, _UP)
    if around is None:
        raise RobotModelError(
            f"refers to the ROS package {name!r}, and no folder of that name, with that name in its package.xml, or "
            f"with the requested file is next to the robot file or above it; --package {name}=FOLDER would work",
            file=path,
        )
    return around


def _list_package_files(name: str, path: Path) -> list[str]:
    """What the robot's file, and the xacro files next to it, need of a package."""
    wanted = re.compile(rf"\$\(find\s+{re.escape(name)}\s*\)/([^\"'$]+)[\"']")
    files = [path, *sorted(p for p in path.parent.glob("*.xacro") if p != path)]
    return [rest for file in files for rest in wanted.findall(read_text(file, expected="a xacro file", most=MARKUP))]
