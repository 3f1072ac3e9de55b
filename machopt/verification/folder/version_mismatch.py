"""Detection of a folder that another version of machopt wrote, whose form may differ."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.manifest import FolderManifest
from machopt.errors import InputError
from machopt.output.json_files import read_json
from machopt.version import __version__

VERSION_REMEDY = "optimize again, or verify with the machopt that wrote it"
KEYS_ADDED_SINCE = {  # of result.json, by version: a document that has one of them is not of that version
    "0.1.0": ("production_blockers", "process", "feed_stops", "tilt", "joint", "reentry"),
}
FILES_ADDED_SINCE = {"0.1.0": ("rapid_corners.csv", "tilt.csv", "engagement.csv")}  # of the folder, likewise


def find_older_version(folder: Path, document: object, manifest: FolderManifest | None) -> str | None:
    """Return the earlier version of machopt that wrote a folder; None where this one did, or none that is known.

    Args:
        folder: The output folder.
        document: Content of its result.json.
        manifest: Manifest of the folder; None where it has none that can be read.
    """
    if manifest is None or not isinstance(document, Mapping):
        return None
    stated = manifest.versions.get("machopt", "")
    if stated not in KEYS_ADDED_SINCE or document.get("version") != stated:
        return None
    has_newer = any(key in document for key in KEYS_ADDED_SINCE[stated])
    has_newer = has_newer or any((folder / name).exists() for name in FILES_ADDED_SINCE[stated])
    return None if has_newer else stated


def describe_older_result(folder: Path, manifest: FolderManifest | None) -> tuple[str, ...]:
    """Return a sentence for a folder of an earlier version, whose tables and programs are verified; empty for others.

    Args:
        folder: The output folder.
        manifest: Manifest of the folder; None where it has none that can be read.
    """
    try:
        document: Any = read_json(folder / "result.json")
    except InputError:
        return ()
    version = find_older_version(folder, document, manifest)
    if version is None:
        return ()
    return (
        f"the folder was written by machopt {version}: tables and programs were recomputed; of result.json only "
        "verdict, exit code, inputs and outputs were compared, its figures and the report were not",
    )


def describe_version_mismatch(folder: Path, manifest: FolderManifest | None) -> tuple[str, ...]:
    """Return a sentence for a folder whose verification failed; empty where this version writes such folders.

    Args:
        folder: The output folder.
        manifest: Manifest of the folder; None where it has none that can be read.
    """
    stated = None if manifest is None else manifest.versions.get("machopt")
    if stated is not None and stated != __version__:
        return (f"the folder was written by machopt {stated}, this is {__version__}: {VERSION_REMEDY}",)
    try:
        OptimizeDocument.model_validate(read_json(folder / "result.json"))
    except InputError:
        return ()
    except ValidationError as problem:
        errors = problem.errors()
        if errors and all(e["type"] == "missing" for e in errors):
            names = ", ".join(dict.fromkeys(".".join(map(str, e["loc"])) for e in errors[:3]))
            return (
                f"the folder was written before result.json had {names}, by another state of machopt {__version__}: "
                f"{VERSION_REMEDY}",
            )
    return ()
