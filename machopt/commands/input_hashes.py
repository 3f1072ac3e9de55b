"""SHA-256 of a command's input files, so that a result names the files it belongs to."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path

from machopt.data_types.cell import Cell
from machopt.data_types.manifest import ManifestFile
from machopt.output.file_hashes import build_manifest_file as output_build_manifest_file
from machopt.output.file_hashes import compute_sha256

PROCESS_ROLE = "process"
_ROLE_BY_MARK = {
    b"machopt_stiffness": "stiffness",
    b"machopt_kinematics": "kinematics",
    b"machopt_cell": "cell",
    b"machopt_process": PROCESS_ROLE,
}
_HEAD_BYTES = 4096  # bytes in which a YAML file of ours says what it is
_ROLE_BY_SUFFIX = {".urdf": "urdf", ".xacro": "urdf", ".srdf": "srdf"}


def list_cell_inputs(cell: Cell) -> tuple[ManifestFile, ...]:
    """Return every file of a cell with its role, named relative to the cell.

    Args:
        cell: The robot cell.

    Raises:
        InputError: a file cannot be read any more.
    """
    return tuple(output_build_manifest_file(f, format_name_in_cell(cell, f), _get_role(f)) for f in cell.files)


def list_recording_inputs(recordings: Sequence[Path], role: str = "recording") -> tuple[ManifestFile, ...]:
    """Return all files in the recordings' folders.

    Args:
        recordings: Folders or files of the recordings.
        role: Role of the file in the manifest.
    """
    out = []
    for path in recordings:
        folder = path if path.is_dir() else path.parent
        files = sorted(p for p in folder.iterdir() if p.is_file())
        out += [output_build_manifest_file(f, f"{folder.name}/{f.name}", role) for f in files]
    return tuple(out)


def list_request_paths(request: object) -> tuple[Path, ...]:
    """Return every file and folder that a command's request names, except its output folder.

    Args:
        request: The validated request.
    """
    out: list[Path] = []
    for f in fields(request):  # type: ignore[arg-type]
        value = getattr(request, f.name)
        if f.name != "out":
            out += [v for v in (value if isinstance(value, tuple) else (value,)) if isinstance(v, Path)]
    return tuple(out)


def build_manifest_file(file: Path, role: str) -> ManifestFile:
    """Return the manifest entry of a file that the user named, under its own name.

    Args:
        file: Path of the file.
        role: Role of the file in the manifest.
    """
    return output_build_manifest_file(file, file.name, role)


def rename_duplicate_names(files: Iterable[ManifestFile]) -> tuple[ManifestFile, ...]:
    """Return the files, with the role added to names that occur twice.

    Args:
        files: The files with their hashes.
    """
    out: dict[str, ManifestFile] = {}
    for f in files:
        name, n = f.name, 1
        while name in out:
            n += 1
            name = f"{f.role}:{f.name}" if n == 2 else f"{f.role}:{n}:{f.name}"
        out[name] = ManifestFile(name, f.role, f.sha256, f.size)
    return tuple(out.values())


def map_hashes_by_name(files: Iterable[ManifestFile]) -> dict[str, str]:
    """Return SHA-256 by name, as the result files list it.

    Args:
        files: The files with their hashes.
    """
    return {f.name: f.sha256 for f in files}


def compute_input_hashes(cell: Cell, recordings: Sequence[Path] = ()) -> dict[str, str]:
    """Return SHA-256 of a cell's files and of all files in the recordings' folders, by name.

    Args:
        cell: The robot cell.
        recordings: Folders or files of the recordings.
    """
    own = {format_name_in_cell(cell, f): compute_sha256(f) for f in cell.files}
    return {**own, **map_hashes_by_name(list_recording_inputs(recordings))}


def format_name_in_cell(cell: Cell, file: Path) -> str:
    """Return a file's name relative to its cell, or its path where it lies elsewhere.

    Args:
        cell: The robot cell.
        file: Path of the file.
    """
    return file.relative_to(cell.folder).as_posix() if file.is_relative_to(cell.folder) else file.as_posix()


def _get_role(file: Path) -> str:
    if file.suffix.lower() in (".yaml", ".yml"):
        with file.open("rb") as data:
            head = data.read(_HEAD_BYTES)
        return next((role for mark, role in _ROLE_BY_MARK.items() if mark in head), "cell")
    return _ROLE_BY_SUFFIX.get(file.suffix.lower(), "mesh")
