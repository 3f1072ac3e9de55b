"""``machopt.batch``: many cells × toolpaths × options on Dask."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Unpack

from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import BatchOptions
from machopt.api.request_options import build_request, convert_to_path, convert_to_paths
from machopt.api.result_saving import Named
from machopt.batch.request import BatchProgress, BatchRequest
from machopt.batch.run import run_batch
from machopt.data_types.documents.batch_document import BatchDocument


@use_argument_names(jobs="workers")
def batch(
    jobs: Named | Iterable[Named],
    out: Named,
    *,
    cell: Named | None = None,
    process: Named | None = None,
    effects: Iterable[Named] = (),
    allow_external: bool = False,
    progress: Callable[[BatchProgress], None] | None = None,
    **options: Unpack[BatchOptions],
) -> BatchDocument:
    """Many jobs, each in a process of its own; called again, it goes on where it stopped: ``machopt batch``.

    Args:
        jobs: folders of toolpaths, patterns like ``parts/*.nc``, toolpath files, or lists of jobs (YAML, CSV).
        out: output folder: ``summary.csv``, ``summary.html``, ``batch.json`` and a folder a job.
        cell: of toolpaths with no folder named cell beside or above them.
        process: a process.yaml in place of that of every cell (``--process``).
        effects: Python files with effects of your own that stiffness files hold; **runs the code in them**.
        allow_external: let cells use files outside their folders.
        progress: called after every job with the state of the batch.
        options: as :class:`machopt.batch.request.BatchRequest` has them, e.g. ``workers=2``,
            ``scheduler="tcp://10.0.0.5:8786"``, ``overrides=["rotation_step_deg=10"]``.

    Returns:
        batch.json, typed: the state of every job, and how many have which.

    Raises:
        InputError: a job, an option or the output folder is wrong.
    """
    request = build_request(
        BatchRequest,
        options,
        jobs=tuple(str(p) for p in convert_to_paths(jobs, "jobs")),
        out=convert_to_path(out, "out"),
        cell=None if cell is None else convert_to_path(cell, "cell"),
        process=None if process is None else convert_to_path(process, "process"),
        effects=convert_to_paths(effects, "effects"),
        allow_external=allow_external,
    )
    return run_batch(request, progress or _ignore_progress).result


def _ignore_progress(_: BatchProgress) -> None:
    """Ignore progress."""
