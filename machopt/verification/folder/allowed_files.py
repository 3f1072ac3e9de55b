"""File kinds, sizes and roles that are allowed in an output folder.

A named pipe, a device or a socket blocks a reader for ever. A file of gigabytes fills the memory. So nothing is
opened before every file is known to be a plain file of a size that machopt may have written.

A role follows from the file name that optimize uses, or from the post that the manifest names.
"""

from __future__ import annotations

import re
import stat
from pathlib import Path, PurePosixPath

from machopt.data_types.manifest import FolderManifest, ManifestProgram
from machopt.errors import InputError
from machopt.output.file_roles import BATCH_ROLES, ROLES
from machopt.output.manifest_file import FILE_MANAGER_FILES, MOST_FILE_BYTES
from machopt.programs.program_writer import load_post
from machopt.programs.writing.post_file import ALIASES, list_post_names

MOST_UNLISTED_BYTES = 256 << 20  # of a file whose size no manifest states: as much as result.json may have
SPARE_BYTES = 64 << 20  # that a changed file may have beyond the size listed and still be read, to say what changed
PARQUET_COPIES = (
    "points.parquet",
    "trajectory.parquet",
    "compensation.parquet",
    "tilt.parquet",
    "rapid_corners.parquet",
    "front.parquet",
)
_RESULT_FILES = (
    *PARQUET_COPIES,
    "points.csv",
    "trajectory.csv",
    "compensation.csv",
    "tilt.csv",
    "rapid_corners.csv",
    "engagement.csv",
    "front.csv",
    "result.json",
    "report.html",
)
OPTIMIZE_ROLES = {name: ROLES[name] for name in _RESULT_FILES} | BATCH_ROLES


def find_unreadable_files(folder: Path, manifest: FolderManifest | None) -> list[tuple[str, str]]:
    """Return the files that must not be opened, each with the reason.

    Args:
        folder: The output folder.
        manifest: The manifest of the folder; None where it cannot be read.

    Returns:
        (file name, reason) pairs; empty where the whole folder can be read.
    """
    sizes = {} if manifest is None else {f.name: f.size for f in manifest.files}
    out = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        try:
            found = path.stat()
        except OSError:
            continue  # a link to nothing: reading it fails at once
        if stat.S_ISDIR(found.st_mode):
            continue
        if not stat.S_ISREG(found.st_mode):
            out.append((name, "is not a plain file and is not opened"))
            continue
        most = min(sizes[name] + SPARE_BYTES, MOST_FILE_BYTES) if name in sizes else MOST_UNLISTED_BYTES
        if found.st_size > most:
            out.append((name, f"has {found.st_size} bytes and is not read; {most} at most are"))
    return out


def find_wrong_roles(folder: Path, manifest: FolderManifest) -> list[str]:
    """Return the files of the manifest whose role does not follow from their name or post, each with the reason.

    Args:
        folder: The output folder.
        manifest: The manifest of the folder.
    """
    programs = {name: p for p in manifest.programs for name in p.files}
    templates = {p.post for p in manifest.programs}  # a user's template is in the folder of its program
    out = [
        f"the program {name} of {p.post} has a name that no post gives"
        for name, p in programs.items()
        if not _is_post_file_name(folder, manifest, p, name)
    ]
    for f in manifest.files:
        role = "program" if f.name in programs else OPTIMIZE_ROLES.get(f.name)
        if role is None and f.name not in templates:
            out.append(f"{f.name} is listed as {f.role}, but it is no program of the manifest and no file of optimize")
        elif role is None and f.role != "other":
            out.append(f"{f.name} is listed as {f.role}; a template is listed as other")
        elif role is not None and f.role != role:
            out.append(f"{f.name} is listed as {f.role}; it is the {role}")
    return out


def _is_post_file_name(folder: Path, manifest: FolderManifest, program: ManifestProgram, name: str) -> bool:
    """Whether the post of a program, a shipped one or a template among the inputs, writes files of that name."""
    path = PurePosixPath(name)
    if path.name in FILE_MANAGER_FILES or name in OPTIMIZE_ROLES:
        return False
    if program.post in list_post_names() or program.post in ALIASES:
        post: str | Path = program.post
    elif any(PurePosixPath(f.name).name == program.post for f in manifest.inputs):
        post = folder / program.post  # the folder's copy; the cell's own template has none
        if not post.is_file():
            return bool(path.suffix)
    else:
        return False
    try:
        keys = load_post(post).keys
    except InputError:
        return False
    own = re.escape(Path(program.post).stem if isinstance(post, Path) else program.post)
    for file in keys.file:
        pattern = re.escape(file.name).replace(re.escape("@{name}"), "X").replace(re.escape("@{part}"), "X")
        if re.fullmatch(f"(?:{own}/)?" + pattern.replace("X", f"(?:{keys.name.pattern})"), name):
            return True
    return False
