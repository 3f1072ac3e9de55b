"""Which file a mesh URI of a URDF means."""

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
    """File behind a mesh URI.

    ``package://name/rest`` is looked up in ``packages``, else as a folder ``name`` beside the URDF or in the
    cell folder; ``file://`` is absolute; anything else is relative to the URDF.
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
            f"folder of that name stands beside the URDF; `packages: {{{name}: its_folder}}` would work"
        )
    return MeshLocation(folder / rest, name, folder)


def find_package_around(name: str, rests: Iterable[str], file: Path, up: int) -> Path | None:
    """Folder of a package that has another name than its folder, by what lies in it: the nearest one above the robot's
    file that its ``package.xml`` calls so, or that holds the file asked for.

    ROS names a package in package.xml, not by its folder, and robots are often passed on without either.

    Args:
        name: of the package.
        rests: files asked for in it, relative to it; one that is there will do.
        file: the robot's.
        up: folders above it that are looked at.
    """
    above = file.resolve().parents[: up + 1]
    wanted = [rest for rest in rests if rest and ".." not in Path(rest).parts]
    for folder in above:
        said = _read_package_name(folder)
        if said == name or (said is None and any((folder / rest).is_file() for rest in wanted)):
            return folder
    return None


def find_package_with_file(name: str, file: Path, rests: Iterable[str], up: int) -> Path | None:
    """Folder of a package by its name that has a file asked for: of the robot's file, above it, or beside one above.

    Packages are often passed on inside a folder that bears the same name.
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
    """Folder that ``$(find name)`` in a xacro file means: of the cell's ``packages``, else one of that name above or
    beside the file, as far up as the cell folder.

    Raises:
        InputError: there is none.
    """
    if name in packages:
        return packages[name]
    above = [p for p in file.resolve().parents if p.is_relative_to(cell_folder)]
    folders = [f for p in above for f in (p, p / name) if f.name == name]
    found = next((f for f in (*folders, cell_folder / name) if isdir(f)), None)
    if found is None:
        raise RobotModelError(
            f"$(find {name}): the package is not in the cell's packages ({', '.join(packages) or 'none'}) and no "
            f"folder of that name stands in the cell; `packages: {{{name}: its_folder}}` would work",
            file=file,
        )
    return found
