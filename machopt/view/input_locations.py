"""Location of the cell and the toolpath of an output folder, by the hashes of its manifest, which names no paths."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from machopt.data_types.manifest import FolderManifest, ManifestFile
from machopt.output.file_hashes import compute_sha256

MAX_LEVELS_UP = 2  # folders above the output folder that are looked into
MAX_LEVELS_DOWN = 4  # how deep below them
MAX_ENTRIES = 20_000  # entries that are read at most, so that a home folder is not searched completely
_SKIPPED_FOLDERS = {"node_modules", "__pycache__", "site-packages"}


@dataclass(frozen=True)
class InputLocations:
    """Located inputs of an output folder; ``missing`` lists what was not found."""

    cell: Path | None
    toolpath: Path | None
    missing: tuple[str, ...]


def locate_inputs(out: Path, manifest: FolderManifest, around: Iterable[Path] = ()) -> InputLocations:
    """Look for the very files around an output folder and around other places, nearest first.

    Args:
        out: the output folder.
        manifest: of it.
        around: further folders, such as the one the user is in.
    """
    wanted = {f.role: f for f in manifest.inputs if f.role == "toolpath" or f.name == _get_cell_name(manifest)}
    found: dict[str, Path] = {}
    here = out.resolve()
    starts = list(dict.fromkeys([*(p.resolve() for p in around), *here.parents[: MAX_LEVELS_UP + 1]]))
    for file in _find_files(starts, {f.name: f for f in wanted.values()}):
        for role, f in wanted.items():
            if role not in found and file.name == f.name and _matches_hash(file, f):
                found[role] = file
        if len(found) == len(wanted):
            break
    missing = [f"{role} {f.name}" for role, f in wanted.items() if role not in found]
    missing += [role for role in ("cell", "toolpath") if role not in wanted]
    return InputLocations(found.get("cell"), found.get("toolpath"), tuple(missing))


def list_changed_inputs(then: Iterable[ManifestFile], now: Iterable[ManifestFile]) -> tuple[str, ...]:
    """Return the names of inputs that have changed or are missing.

    Args:
        then: Inputs that the manifest records.
        now: Inputs of today.
    """
    today = {f.name: f.sha256 for f in now}
    return tuple(f.name for f in then if f.role != "plan" and today.get(f.name) != f.sha256)


def _get_cell_name(manifest: FolderManifest) -> str:
    """The first of role cell: a cell's own file is read before the files it names."""
    return next((f.name for f in manifest.inputs_of("cell")), "")


def _matches_hash(file: Path, manifest_file: ManifestFile) -> bool:
    try:
        return file.stat().st_size == manifest_file.size and compute_sha256(file) == manifest_file.sha256
    except OSError:
        return False  # gone, or not ours to read: not the one


def _find_files(starts: Iterable[Path], names: dict[str, ManifestFile]) -> Iterator[Path]:
    """Files of these names below folders, near ones first, no folder twice and no more than MOST entries."""
    seen: set[Path] = set()
    count = 0
    for start in starts:
        level = [start]
        for _ in range(MAX_LEVELS_DOWN):
            below: list[Path] = []
            for folder in level:
                if folder in seen:
                    continue
                seen.add(folder)
                try:
                    entries = sorted(os.scandir(folder), key=lambda e: e.name)
                except OSError:
                    continue
                for entry in entries:
                    count += 1
                    if count > MAX_ENTRIES:
                        return
                    if entry.name in names and entry.is_file():
                        yield Path(entry.path)
                    elif _is_searched(entry):
                        below.append(Path(entry.path))
            level = below


def _is_searched(entry: os.DirEntry[str]) -> bool:
    return not entry.name.startswith(".") and entry.name not in _SKIPPED_FOLDERS and entry.is_dir(follow_symlinks=False)
