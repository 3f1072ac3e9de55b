"""``manifest.json``: written last, read strictly, and compared with the files in the folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from machopt.data_types.documents.manifest_document import (
    CheckCoverageEntry,
    ManifestDocument,
    ManifestFileEntry,
    ManifestProgramEntry,
    TouchingPairEntry,
)
from machopt.data_types.manifest import CheckCoverage, FolderManifest, ManifestFile, ManifestProgram, TouchingPair
from machopt.errors import InputError, OutputFolderError
from machopt.output.file_hashes import build_manifest_file, compute_digest, compute_sha256
from machopt.output.json_files import convert_to_json_types, read_json, write_json

MANIFEST = "manifest.json"
FORMAT: Literal[1] = 1
FILE_MANAGER_FILES = frozenset(
    {".DS_Store", "Thumbs.db", "desktop.ini"}
)  # file managers leave these wherever one looks
ADDED, MISSING = "is not in the manifest", "is missing"
MOST_FILE_BYTES = 2 << 30  # no file that machopt writes comes near; a larger one is neither hashed nor read
_SHA = re.compile(r"[0-9a-f]{64}")
_KEYS: dict[str, Any] = {
    "machopt_manifest": int,
    "command": str,
    "verdict": str,
    "exit_code": int,
    "versions": dict,
    "inputs": dict,
    "reading": dict,
    "options": dict,
    "programs": list,
    "program_tolerance_mm": (int, float, type(None)),
    "checked": list,
    "unchecked": list,
    "not_recomputed": list,
    "touching_pairs": list,
    "warnings": list,
    "files": dict,
    "seal": str,
}

_LATER = ("not_recomputed", "touching_pairs")  # keys that manifests of earlier versions lack


@dataclass(frozen=True)
class FileDifference:
    """File of the folder that differs from its entry in the manifest."""

    name: str
    description: str


def write_manifest(
    folder: Path,
    manifest: FolderManifest,
    roles: Mapping[str, str],
    names: Iterable[str] | None = None,
    *,
    into: Path | None = None,
) -> FolderManifest:
    """Hash every file of the folder and write manifest.json.

    Args:
        folder: holds everything but the manifest.
        manifest: all but its ``files``.
        roles: role by file name; what is not named has the role ``other``.
        names: the files to list, where not all of them.
        into: where to write manifest.json, where not into the folder at once.

    Returns:
        the manifest with its files.
    """
    programs = {name: "program" for program in manifest.programs for name in program.files}
    known = {**programs, **roles}
    files = tuple(
        build_manifest_file(folder / name, name, known.get(name, "other"))
        for name in sorted(list_folder_files(folder) if names is None else names)
        if name != MANIFEST
    )
    whole = replace(manifest, files=files)
    value = _convert_to_json(whole)
    write_json((into or folder) / MANIFEST, {**value, "seal": compute_seal(value)})
    return whole


def compute_seal(value: Mapping[str, object]) -> str:
    """Return SHA-256 of a manifest's own content; it shows that the file was edited, not by whom.

    Args:
        value: Content of the manifest.
    """
    text = json.dumps(
        convert_to_json_types({k: v for k, v in value.items() if k != "seal"}),
        sort_keys=True,
        ensure_ascii=True,
        separators=(",", ":"),
    )
    return compute_digest(text.encode())


def read_manifest(folder: Path) -> tuple[FolderManifest, bool]:
    """Read manifest.json; the flag is whether its seal is valid.

    Args:
        folder: The output folder.

    Raises:
        InputError: it is missing, is no JSON, or does not have the expected form; the message says where.
    """
    file = folder / MANIFEST
    value = read_json(file)
    unknown = sorted(set(value) - set(_KEYS))
    if unknown:
        raise OutputFolderError(f"found the key {unknown[0]!r}; known are {', '.join(_KEYS)}", file=file)
    for key, kind in _KEYS.items():
        if key not in value and key in _LATER:
            continue
        if key not in value:
            raise OutputFolderError(f"the key {key!r} is missing", file=file)
        if not isinstance(value[key], kind) or (isinstance(value[key], bool)):
            raise OutputFolderError(f"found {_shorten_value(value[key])}", file=file, where=key)
    if value["machopt_manifest"] != FORMAT:
        raise OutputFolderError(f"found format {value['machopt_manifest']}; this version reads {FORMAT}", file=file)
    return _parse_manifest(value, file), value["seal"] == compute_seal(value)


def list_folder_files(folder: Path) -> set[str]:
    """Return the names of all files in a folder and below it; links are listed and not followed.

    Args:
        folder: The folder.
    """
    out: set[str] = set()
    for place, folders, files in os.walk(folder):
        here = Path(place)
        links = [name for name in folders if (here / name).is_symlink()]
        empty = [name for name in folders if name not in links and not any((here / name).iterdir())]
        names = [*files, *links, *(f"{name}/" for name in empty)]
        out |= {(here / name).relative_to(folder).as_posix() + ("/" if name.endswith("/") else "") for name in names}
    return {name for name in out if PurePosixPath(name).name not in FILE_MANAGER_FILES}


def find_differences(folder: Path, manifest: FolderManifest) -> tuple[FileDifference, ...]:
    """Return files that are missing, changed, or present without an entry.

    Args:
        folder: The output folder.
        manifest: Its manifest.
    """
    there = list_folder_files(folder) - {MANIFEST}
    out = [FileDifference(name, ADDED) for name in sorted(there - {f.name for f in manifest.files})]
    for f in manifest.files:
        path = folder / f.name
        if f.name not in there:
            out.append(FileDifference(f.name, MISSING))
        elif path.is_symlink() or not path.is_file():
            out.append(FileDifference(f.name, "is not a plain file"))
        else:
            out += _find_file_changes(path, f)
    return tuple(out)


def _find_file_changes(path: Path, f: ManifestFile) -> Iterable[FileDifference]:
    """The size first: a file of another size is not hashed, however large it is."""
    try:
        size = path.lstat().st_size
        if size != f.size:
            return (FileDifference(f.name, f"is changed: {size} bytes, {f.size} were written"),)
        if size > MOST_FILE_BYTES:
            return (FileDifference(f.name, f"has {size} bytes; files of machopt have {MOST_FILE_BYTES} at most"),)
        found = compute_sha256(path)
    except (OSError, InputError) as problem:
        return (FileDifference(f.name, f"cannot be read: {problem}"),)
    if found != f.sha256:
        return (FileDifference(f.name, f"is changed: sha256 {found[:12]}…, {f.sha256[:12]}… was written"),)
    return ()


def _convert_to_json(m: FolderManifest) -> dict[str, Any]:
    def files(some: Iterable[ManifestFile]) -> dict[str, ManifestFileEntry]:
        return {f.name: ManifestFileEntry(role=f.role, sha256=f.sha256, size=f.size) for f in some}

    return ManifestDocument(
        machopt_manifest=FORMAT,
        command=m.command,
        verdict=m.verdict,
        exit_code=m.exit_code,
        versions=dict(m.versions),
        inputs=files(m.inputs),
        reading=dict(convert_to_json_types(m.reading)),
        options=dict(convert_to_json_types(m.options)),
        programs=tuple(
            ManifestProgramEntry(post=p.post, files=p.files, **({"stint": p.stint} if p.stint else {}))
            for p in m.programs
        ),
        program_tolerance_mm=m.program_tolerance_mm,
        checked=tuple(CheckCoverageEntry(what=c.what, how=c.how) for c in m.checked),
        unchecked=tuple(m.unchecked),
        not_recomputed=tuple(m.not_recomputed),
        touching_pairs=tuple(TouchingPairEntry(a=p.a, b=p.b, reason=p.reason) for p in (m.touching_pairs or ())),
        warnings=tuple(m.warnings),
        files=files(m.files),
    ).to_json_types()


@dataclass(frozen=True)
class _ManifestParser:
    """Parts of a manifest, each checked; errors name file and key."""

    value: Mapping[str, Any]
    file: Path

    def build_error(self, where: str, found: object, expected: str) -> InputError:
        return OutputFolderError(f"found {_shorten_value(found)}; expected {expected}", file=self.file, where=where)

    def parse_files(self, key: str) -> tuple[ManifestFile, ...]:
        return tuple(self._parse_file(key, name, item) for name, item in self.value[key].items())

    def _parse_file(self, key: str, name: str, item: object) -> ManifestFile:
        where = f"{key}.{name}"
        if not isinstance(item, dict) or set(item) != {"role", "sha256", "size"}:
            raise self.build_error(where, item, "role, sha256 and size")
        role, sha256, size = item["role"], item["sha256"], item["size"]
        if not isinstance(role, str) or not isinstance(size, int) or isinstance(size, bool) or size < 0:
            raise self.build_error(where, item, "a word as role and a count of bytes as size")
        if not isinstance(sha256, str) or not _SHA.fullmatch(sha256):
            raise self.build_error(f"{where}.sha256", sha256, "64 hexadecimal digits")
        if key == "files" and not _is_inside_folder(name):
            raise self.build_error(where, name, "a name inside the folder")
        return ManifestFile(name, role, sha256, size)

    def parse_words(self, key: str, items: object) -> tuple[str, ...]:
        if not isinstance(items, list) or not all(isinstance(i, str) for i in items):
            raise self.build_error(key, items, "a list of words")
        return tuple(items)

    def parse_pairs(
        self, key: str, names: tuple[str, str], more: frozenset[str] = frozenset()
    ) -> list[tuple[Any, Any]]:
        for n, item in enumerate(self.value[key]):
            if not isinstance(item, dict) or set(item) - more != set(names) or not isinstance(item[names[0]], str):
                raise self.build_error(f"{key}.{n}", item, " and ".join(names))
        return [(item[names[0]], item[names[1]]) for item in self.value[key]]

    def parse_programs(self) -> tuple[ManifestProgram, ...]:
        out = []
        named = self.parse_pairs("programs", ("post", "files"), frozenset({"stint"}))
        for n, ((post, own), item) in enumerate(zip(named, self.value["programs"], strict=True)):
            segment = item.get("stint", 0)
            if not isinstance(segment, int) or segment < 0:
                raise self.build_error(f"programs.{n}.stint", segment, "a number from 1")
            out.append(ManifestProgram(post, self.parse_words("programs", own), segment))
        return tuple(out)

    def parse_touching_pairs(self) -> tuple[TouchingPair, ...] | None:
        if "touching_pairs" not in self.value:
            return None
        for n, item in enumerate(self.value["touching_pairs"]):
            if not isinstance(item, dict) or set(item) != {"a", "b", "reason"}:
                raise self.build_error(f"touching_pairs.{n}", item, "a, b and reason")
            self.parse_words(f"touching_pairs.{n}", list(item.values()))
        return tuple(TouchingPair(**item) for item in self.value["touching_pairs"])


def _parse_manifest(value: Mapping[str, Any], file: Path) -> FolderManifest:
    parser = _ManifestParser(value, file)
    versions = value["versions"]
    if not all(isinstance(v, str) for v in versions.values()):
        raise parser.build_error("versions", versions, "a word for each name")
    tolerance = value["program_tolerance_mm"]
    return FolderManifest(
        command=value["command"],
        verdict=value["verdict"],
        exit_code=value["exit_code"],
        versions=versions,
        inputs=parser.parse_files("inputs"),
        files=parser.parse_files("files"),
        options=value["options"],
        reading=value["reading"],
        programs=parser.parse_programs(),
        program_tolerance_mm=None if tolerance is None else float(tolerance),
        checked=tuple(CheckCoverage(what, str(how)) for what, how in parser.parse_pairs("checked", ("what", "how"))),
        unchecked=parser.parse_words("unchecked", value["unchecked"]),
        not_recomputed=parser.parse_words("not_recomputed", value.get("not_recomputed", [])),
        touching_pairs=parser.parse_touching_pairs(),
        warnings=parser.parse_words("warnings", value["warnings"]),
    )


def _is_inside_folder(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(name) and not path.is_absolute() and ".." not in path.parts and "\\" not in name and "\0" not in name


def _shorten_value(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"
