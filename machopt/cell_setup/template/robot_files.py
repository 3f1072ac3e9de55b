"""Copies of the robot files in a folder without external references."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from machopt.cell.mesh.collada_reader import build_binary_stl, read_collada
from machopt.cell.urdf import RobotDescription, UrdfMesh, find_mesh, find_standalone_package
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.mesh_unit import detect_unit
from machopt.errors import InputError, OptionError, RobotModelError

URDF = "robot.urdf"
MESHES = "meshes"
COLLADA = ".dae"


def copy_robot(
    description: RobotDescription, folder: Path, packages: Mapping[str, Path], span: float = 0.0
) -> tuple[str, ...]:
    """Write ``robot.urdf`` and its collision meshes into a folder.

    Meshes of a package go to ``PACKAGE/…`` beside the URDF, where ``package://`` finds them; those beside the URDF keep
    their place; those elsewhere go to ``meshes/``, and the URDF says so. COLLADA becomes STL,
    ``NAME.dae.stl``, and stays beside it, where the verifier reads it. Pictures (visual meshes) are left out.

    Args:
        description: of the robot.
        folder: of the new cell.
        packages: folders of ROS packages, by name; others are looked for around the robot's file.
        span: m, of the arm's links end to end; a mesh that would be larger than any link is scaled from mm.

    Returns:
        What was changed, one sentence each.

    Raises:
        InputError: a mesh is missing, or something cannot be copied.
    """
    urdf = description.urdf
    text = urdf.path.read_text(encoding="utf-8-sig") if description.whole is None else description.whole
    source, taken = urdf.path.parent.resolve(), dict[str, str]()
    notes: list[str] = []
    scales = {mesh.uri: mesh.scale for mesh in urdf.meshes}
    found: dict[str, Path] = {mesh.uri: _resolve_mesh_path(description, mesh, packages) for mesh in urdf.meshes}
    for uri, path in found.items():
        scheme = ""
        if uri.startswith(("package://", "model://")):
            scheme, place = uri[: uri.index("://") + 3], uri.split("://", 1)[1]
        elif path.resolve().is_relative_to(source) and not uri.startswith(("file://", "/")) and ".." not in uri:
            place = uri
        else:
            place = _find_free_name(f"{MESHES}/{path.name}", taken)
        if path.suffix.lower() == COLLADA:
            place += ".stl"
        if scheme + place != uri:
            text = text.replace(f'"{uri}"', f'"{scheme}{place}"').replace(f"'{uri}'", f"'{scheme}{place}'")
        taken[place] = uri
        target = folder / place
        if ".." in Path(place).parts:
            raise RobotModelError(f"the mesh {uri} leads out of its package", file=urdf.path)
        notes += _copy_mesh(path, target)
        unit = detect_unit(target, "link", span, scale=scales[uri])
        if unit.note is not None:
            text = _replace_mesh_scale(text, f"{scheme}{place}", unit.scale)
            notes.append(unit.note)
    (folder / URDF).write_text(text, encoding="utf-8", newline="\n")
    return tuple(notes)


def _replace_mesh_scale(text: str, uri: str, scale: float) -> str:
    """A URDF in which every <mesh> of a file has another scale."""

    def changed(found: re.Match[str]) -> str:
        element = re.sub(r"\s+scale\s*=\s*(\"[^\"]*\"|'[^']*')", "", found[0])
        return element.replace("<mesh", f'<mesh scale="{scale:g} {scale:g} {scale:g}"', 1)

    return re.sub(rf"<mesh\b[^>]*filename\s*=\s*[\"']{re.escape(uri)}[\"'][^>]*>", changed, text)


def _copy_mesh(source: Path, target: Path) -> list[str]:
    """COLLADA as STL for the planner, with the original beside it for the verifier; any other mesh as it is.

    Returns:
        A note where the file states an axis that is not used.
    """
    if source.suffix.lower() != COLLADA:
        copy_file(source, target)
        return []
    copy_file(source, target.with_suffix(""))
    mesh = read_collada(source)
    target.write_bytes(build_binary_stl(mesh.corners))
    up = mesh.counts.up_axis
    if up == "Z_UP":
        return []
    return [f"{source.name} states {up}; as in RViz and MoveIt its coordinates are those of the link all the same"]


def copy_meshes(request: InitRequest, folder: Path) -> None:
    """Copy the meshes of tool and workpiece that the user names into a folder.

    Args:
        request: Validated options of the command.
        folder: Folder of the new cell.
    """
    for file, name in ((request.tool_mesh, "tool"), (request.workpiece_mesh, "workpiece")):
        if file is not None:
            copy_file(file, folder / f"{name}{file.suffix.lower()}")


def copy_file(source: Path, target: Path) -> None:
    """Copy the content of a file.

    Args:
        source: Path of the file.
        target: Path of the copy.

    Raises:
        InputError: it cannot be read or written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    except OSError as problem:
        raise RobotModelError(f"cannot be copied: {problem.strerror}", file=source) from None


def _resolve_mesh_path(description: RobotDescription, mesh: UrdfMesh, given: Mapping[str, Path]) -> Path:
    urdf = description.urdf

    def fail(message: str) -> InputError:
        return RobotModelError(message, file=urdf.path, where=f"line {mesh.line}: collision mesh of link {mesh.link!r}")

    packages = dict(given)
    if mesh.uri.startswith(("package://", "model://")):
        name, _, rest = mesh.uri.split("://", 1)[1].partition("/")
        if name not in packages and not (urdf.path.parent / name).is_dir():
            try:
                packages[name] = find_standalone_package(name, urdf.path, given, [rest])
            except InputError as problem:
                raise fail(problem.reason) from None
    path = find_mesh(urdf, mesh.uri, packages, urdf.path.parent, fail).path
    if not path.is_file():
        raise fail(f"no such file: {mesh.uri} (searched for {path})")
    return path


def _find_free_name(place: str, taken: dict[str, str]) -> str:
    """The same name, numbered where another file has it."""
    path, n = Path(place), 1
    while place in taken:
        n += 1
        place = f"{path.parent.as_posix()}/{path.stem}_{n}{path.suffix}"
    return place


@contextlib.contextmanager
def create_cell_folder(out: Path) -> Iterator[Path]:
    """Create a temporary sibling folder that replaces ``out`` at the end; ``out`` is new or empty.

    Args:
        out: Folder of the new cell.

    Returns:
        Context with the temporary folder.

    Raises:
        RobotModelError: the folder cannot be created, or is not empty.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RobotModelError("is not empty; name a new folder for the cell", file=out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as problem:
        raise RobotModelError(f"cannot be written: {problem.strerror}", file=out) from None
    try:
        yield partial
        partial.chmod(0o755)  # a temporary folder is its owner's alone
        os.replace(partial, out)  # an empty folder is replaced
    finally:
        shutil.rmtree(partial, ignore_errors=True)


_OPTIONS = {  # keys of the new cell.yaml → options that give them, the first one that was given counts
    "tool.tcp.xyz_mm": ("tcp_mm", "tool_length_mm", "cutter_length_mm"),
    "tool.tcp.rpy_deg": ("tcp_rpy_deg", "tool_angle_deg"),
    "tool.mass_kg": ("tool_mass_kg",),
    "tool.cutter.diameter_mm": ("cutter_diameter_mm",),
    "tool.cutter.length_mm": ("cutter_length_mm",),
    "tool.geometry": ("tool_mesh",),
    "workpiece.pose.xyz_mm": ("workpiece_mm",),
    "workpiece.pose.rpy_deg": ("workpiece_rpy_deg",),
    "workpiece.geometry": ("workpiece_mesh",),
    "robot.limits.velocity_deg_s": ("velocity_deg_s",),
    "controller.post": ("post",),
}


def find_option_of_key(key: str, request: InitRequest) -> str:
    """Find the option of ``machopt init`` that gave the value of a key; empty where the user gave none.

    Args:
        key: Key of the new cell.yaml.
        request: Validated options of the command.
    """
    usual = InitRequest(robot=request.robot, out=request.out)
    for prefix, names in _OPTIONS.items():
        if key == prefix or key.startswith((prefix + ".", prefix + "[")):
            given = [n for n in names if getattr(request, n) != getattr(usual, n)]
            return f"--{given[0].replace('_', '-')}" if given else ""
    return ""


@contextlib.contextmanager
def restore_user_paths_in_errors(folder: Path, request: InitRequest) -> Iterator[None]:
    """Replace paths of the temporary folder in errors by the user's own paths.

    Args:
        folder: Folder of the new cell.
        request: Validated options of the command.

    Returns:
        Context without a value.

    Raises:
        OptionError: the value of an option is wrong.
        RobotModelError: the error, with the user's paths.
    """
    try:
        yield
    except InputError as wrong:
        if not isinstance(wrong.file, Path) or not wrong.file.resolve().is_relative_to(folder.resolve()):
            raise
        place = wrong.file.resolve().relative_to(folder.resolve())
        option = find_option_of_key(wrong.key, request) if place.name == "cell.yaml" else ""
        if option:
            raise OptionError(wrong.reason, where=option) from None
        own = {URDF: request.robot, "stiffness.yaml": request.stiffness}.get(place.as_posix()) or request.out / place
        where = wrong.where
        if place.name == "cell.yaml" and wrong.key == "robot.urdf":
            own, where = request.robot, None  # a line of a temporary file
        raise RobotModelError(wrong.reason, file=own, where=where) from None
