"""Detection of a folder that another version of machopt wrote, whose form may differ."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.manifest import FolderManifest
from machopt.errors import InputError
from machopt.output.json_files import read_json
from machopt.version import __version__

VERSION_REMEDY = "optimize again, or verify with the machopt that wrote it"


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
