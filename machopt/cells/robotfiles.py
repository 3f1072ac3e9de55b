"""A robot's files, copied into a folder that needs nothing outside it."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from machopt.cells.asked import InitRequest
from machopt.errors import InputError
from machopt.formats.urdf import Description, UrdfMesh, find_mesh, package_alone

URDF = "robot.urdf"
MESHES = "meshes"


def copy_robot(description: Description, folder: Path) -> tuple[Path, ...]:
    """Write ``robot.urdf`` and its collision meshes into a folder.

    Meshes of a package go to ``PACKAGE/…`` beside the URDF, where ``package://`` finds them; those beside the URDF keep
    their place; those elsewhere go to ``meshes/``, and the URDF says so. Pictures (visual meshes) are left out.

    Returns:
        The meshes that were copied, where they lay.

    Raises:
        InputError: a mesh is missing, or something cannot be copied.
    """
    urdf = description.urdf
    text = urdf.path.read_text(encoding="utf-8-sig") if description.text is None else description.text
    source, taken = urdf.path.parent.resolve(), dict[str, str]()
    found: dict[str, Path] = {mesh.uri: _path(description, mesh) for mesh in urdf.meshes}
    for uri, path in found.items():
        if uri.startswith(("package://", "model://")):
            place = uri.split("://", 1)[1]
        elif path.resolve().is_relative_to(source) and not uri.startswith(("file://", "/")) and ".." not in uri:
            place = uri
        else:
            place = _free(f"{MESHES}/{path.name}", taken)
            text = text.replace(f'"{uri}"', f'"{place}"').replace(f"'{uri}'", f"'{place}'")
        taken[place] = uri
        target = folder / place
        if ".." in Path(place).parts:
            raise InputError(f"the mesh {uri} leads out of its package", file=urdf.path)
        copy_file(path, target)
    (folder / URDF).write_text(text, encoding="utf-8", newline="\n")
    return tuple(found.values())


def copy_file(source: Path, target: Path) -> None:
    """Copy the content of a file.

    Raises:
        InputError: it cannot be read or written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    except OSError as problem:
        raise InputError(f"cannot be copied: {problem.strerror}", file=source) from None


def _path(description: Description, mesh: UrdfMesh) -> Path:
    urdf = description.urdf

    def fail(message: str) -> InputError:
        return InputError(message, file=urdf.path, where=f"line {mesh.line}: collision mesh of link {mesh.link!r}")

    packages: dict[str, Path] = {}
    if mesh.uri.startswith(("package://", "model://")):
        name = mesh.uri.split("://", 1)[1].partition("/")[0]
        if not (urdf.path.parent / name).is_dir():
            try:
                packages[name] = package_alone(name, urdf.path)
            except InputError:
                raise fail(
                    f"{mesh.uri}: no folder {name!r} stands beside the robot's file or above it; put it beside"
                ) from None
    path = find_mesh(urdf, mesh.uri, packages, urdf.path.parent, fail).path
    if not path.is_file():
        raise fail(f"no such file: {mesh.uri} (looked for {path})")
    return path


def _free(place: str, taken: dict[str, str]) -> str:
    """The same name, numbered where another file has it."""
    path, n = Path(place), 1
    while place in taken:
        n += 1
        place = f"{path.parent.as_posix()}/{path.stem}_{n}{path.suffix}"
    return place


@contextlib.contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A temporary sibling that takes the place of ``out`` at the end; ``out`` is new or empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError("is not empty; name a new folder for the cell", file=out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as problem:
        raise InputError(f"cannot be written: {problem.strerror}", file=out) from None
    try:
        yield partial
        partial.chmod(0o755)  # a temporary folder is its owner's alone
        os.replace(partial, out)  # an empty folder gives way
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextlib.contextmanager
def named_as_given(folder: Path, request: InitRequest) -> Iterator[None]:
    """Name the user's own files in what is refused: those of the new folder are gone by the time it is read."""
    try:
        yield
    except InputError as wrong:
        if not isinstance(wrong.file, Path) or not wrong.file.is_relative_to(folder):
            raise
        place = wrong.file.relative_to(folder)
        own = {URDF: request.robot, "stiffness.yaml": request.stiffness}.get(place.as_posix()) or request.out / place
        where = wrong.where
        if place.name == "cell.yaml" and where is not None and where.endswith(": robot.urdf"):
            own, where = request.robot, None  # a line of a file that was never kept
        raise InputError(wrong.reason, file=own, where=where) from None
