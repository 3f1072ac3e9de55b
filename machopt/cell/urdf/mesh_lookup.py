"""Lookup of the file of a mesh URI in a URDF."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from os.path import isdir
from pathlib import Path

from machopt.cell.urdf.urdf_model import UrdfModel
from machopt.errors import InputError, RobotModelError

ErrorFactory = Callable[[str], InputError]
_SCHEMES = ("package", "model", "file")
_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


@dataclass(frozen=True)
class MeshLocation:
    path: Path
    package: str | None  # the package:// name it was found through
    folder: Path | None  # and that package's folder


def find_mesh(
    urdf: UrdfModel, uri: str, packages: dict[str, Path], cell_folder: Path, fail: ErrorFactory
) -> MeshLocation:
    """Find the file of a mesh URI.

    ``package://name/rest`` is searched in ``packages``, else as a folder ``name`` next to the URDF or in the cell
    folder. ``file://`` is absolute. Anything else is relative to the URDF.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        uri: URI of the mesh.
        packages: ROS package → folder.
        cell_folder: Cell folder.
        fail: Function that builds an error from a message.

    Returns:
        Location of the file.

    Raises:
        InputError: built by ``fail``: the package or the file does not exist.
    """
    scheme, mark, _ = uri.partition("://")
    if mark and scheme not in _SCHEMES:
        raise fail(f"{uri}: files are not fetched by {scheme}://; a path relative to the URDF would work")
    if not uri.startswith(("package://", "model://")):
        return MeshLocation(urdf.path.parent / uri.removeprefix("file://"), None, None)
    name, _, rest = uri.split("://", 1)[1].partition("/")
    folders = [packages[name]] if name in packages else [urdf.path.parent / name, cell_folder / name]
    folder = next((f for f in folders if isdir(f)), None)
    if folder is None:
        raise fail(
            f"{uri}: package {name!r} is not in the cell's packages ({', '.join(packages) or 'none'}) and no "
            f"folder of that name is next to the URDF; `packages: {{{name}: its_folder}}` would work"
        )
    return MeshLocation(folder / rest, name, folder)


def find_package_around(name: str, rests: Iterable[str], file: Path, up: int) -> Path | None:
    """Folder of a package that has another name than its folder, by what lies in it: the nearest one above the robot's
    file that its ``package.xml`` calls so, or that holds the requested file.

    ROS names a package in package.xml, not by its folder, and robots are often passed on without either.

    Args:
        name: of the package.
        rests: requested files in it, relative to it; one that is there will do.
        file: the robot's.
        up: folders above it that are searched.
    """
    above = file.resolve().parents[: up + 1]
    wanted = [rest for rest in rests if rest and ".." not in Path(rest).parts]
    for folder in above:
        package_name = _read_package_name(folder)
        if package_name == name or (package_name is None and any((folder / rest).is_file() for rest in wanted)):
            return folder
    return None


def find_package_with_file(name: str, file: Path, rests: Iterable[str], up: int) -> Path | None:
    """Find the folder of a package that contains a requested file: of the robot file, above it, or next to one above.

    Packages are often distributed inside a folder of the same name.

    Args:
        name: Name of the package.
        file: Path of the robot file.
        rests: Paths of the requested files inside the package.
        up: Number of folder levels to search upwards.

    Returns:
        The folder, None where there is none.
    """
    wanted = [rest for rest in rests if rest and ".." not in Path(rest).parts]
    for above in file.resolve().parents[: up + 1]:
        for folder in (above / name, above):
            if folder.name == name and any((folder / rest).is_file() for rest in wanted):
                return folder
    return None


def _read_package_name(folder: Path) -> str | None:
    """What package.xml calls a folder; None: there is none that can be read."""
    try:
        text = (folder / "package.xml").read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return None
    found = _NAME.search(_COMMENT.sub("", text))
    return found[1] if found else None


def find_package(name: str, file: Path, packages: dict[str, Path], cell_folder: Path) -> Path:
    """Find the folder of ``$(find name)`` in a xacro file.

    The ``packages`` of the cell come first, then a folder of that name above or near the file, up to the cell folder.

    Args:
        name: Name of the package.
        file: Path of the robot file.
        packages: ROS package → folder.
        cell_folder: Cell folder.

    Returns:
        The folder.

    Raises:
        RobotModelError: there is none.
    """
    if name in packages:
        return packages[name]
    above = [p for p in file.resolve().parents if p.is_relative_to(cell_folder)]
    folders = [f for p in above for f in (p, p / name) if f.name == name]
    found = next((f for f in (*folders, cell_folder / name) if isdir(f)), None)
    if found is None:
        raise RobotModelError(
            f"$(find {name}): the package is not in the cell's packages ({', '.join(packages) or 'none'}) and no "
            f"folder of that name is in the cell; `packages: {{{name}: its_folder}}` would work",
            file=file,
        )
    return found
