"""Whether another version of machopt wrote a folder: what then fails in it may be the form and not the plan."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from machopt.domain.manifest import Manifest
from machopt.domain.results.optimize import OptimizeResult
from machopt.errors import InputError
from machopt.output.jsonfile import read_json
from machopt.version import __version__

REMEDY = "optimize again, or verify with the machopt that wrote it"


def made_otherwise(folder: Path, manifest: Manifest | None) -> tuple[str, ...]:
    """A sentence for a folder whose verification failed, none where this machopt writes such folders.

    Args:
        manifest: of the folder; None where it has none that can be read.
    """
    told = None if manifest is None else manifest.versions.get("machopt")
    if told is not None and told != __version__:
        return (f"the folder was written by machopt {told}, this is {__version__}: {REMEDY}",)
    try:
        OptimizeResult.model_validate(read_json(folder / "result.json"))
    except InputError:
        return ()
    except ValidationError as problem:
        errors = problem.errors()
        if errors and all(e["type"] == "missing" for e in errors):
            names = ", ".join(dict.fromkeys(".".join(map(str, e["loc"])) for e in errors[:3]))
            return (
                f"the folder was written before result.json had {names}, by another state of machopt {__version__}: "
                f"{REMEDY}",
            )
    return ()
