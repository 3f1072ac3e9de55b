"""``machopt verify``: verification of an output folder of optimize against cell and toolpath."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from machopt.cell.absolute_accuracy import apply_absolute_accuracy
from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import select_job_tools
from machopt.commands.input_hashes import (
    PROCESS_ROLE,
    build_manifest_file,
    list_cell_inputs,
    rename_duplicate_names,
)
from machopt.commands.toolpath_reading_options import build_known_robot
from machopt.data_types.documents.verification_entries import InformationEntry
from machopt.data_types.documents.verify_document import VerifyCheckEntry, VerifyDocument
from machopt.data_types.manifest import FolderManifest, add_scope_to_verdict
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.errors import InputError
from machopt.output.manifest_file import read_manifest
from machopt.verification import Verification
from machopt.verification.folder.folder_checks import verify_folder
from machopt.verification.folder.options_in_force import VerifyRequest, resolve_options_in_force
from machopt.verification.folder.verification_scope import NOT_RECOMPUTED, list_checks_not_run, list_unchecked
from machopt.verification.folder.version_mismatch import describe_older_result, describe_version_mismatch


@dataclass(frozen=True)
class VerifyResult:
    """Result of ``machopt verify``."""

    verification: Verification
    exit_code: int  # 0, 3 (intact, but no feasible answer in it) or 4
    line: str  # the verdict with what it does not cover
    notes: tuple[str, ...]  # options that the user gave and the folder was not made with

    @property
    def result(self) -> VerifyDocument:
        """As ``--json`` prints it."""
        found = self.verification
        return VerifyDocument(
            passed=found.ok,
            verdict=self.line,
            samples=found.samples,
            duration_s=found.duration,
            notes=self.notes,
            checks=tuple(VerifyCheckEntry.from_fields(c) for c in found.checks),
            information=tuple(InformationEntry.from_fields(i) for i in found.information),
            not_recomputed=NOT_RECOMPUTED,
        )


def run_verify(request: VerifyRequest) -> VerifyResult:
    """Verify an output folder of optimize against cell and toolpath.

    Args:
        request: The validated request.

    Raises:
        InputError: cell, toolpath, an option or a file with effects is wrong, or ``out`` is no folder.
    """
    with activate_user_effects(load_effect_files(request.effects)):
        return _verify_folder(request)


def _verify_folder(request: VerifyRequest) -> VerifyResult:
    if not request.out.is_dir():
        raise InputError("is not a folder; give the output folder of optimize", file=request.out)
    cell = load_cell(request.cell, allow_external=request.allow_external, process=request.process)
    try:
        manifest: FolderManifest | None = read_manifest(request.out)[0]
    except InputError:
        manifest = None  # a failed check of its own, below
    inputs = list_cell_inputs(cell)
    if cell.process is None:
        _require_process_file(request.out, manifest)
    used = resolve_options_in_force(request, cell, build_known_robot(cell), manifest)
    cell = select_job_tools(apply_absolute_accuracy(cell, used.options), used.toolpath)
    found = verify_folder(
        cell,
        used.toolpath,
        request.out,
        options=used.options,
        inputs=rename_duplicate_names((*inputs, build_manifest_file(request.toolpath, "toolpath"))),
    )
    found = replace(found, checks=(*used.checks, *found.checks))
    missing = (*list_unchecked(cell, used.options, used.toolpath), *list_checks_not_run(found.checks))
    if not found.ok:
        older = describe_version_mismatch(request.out, manifest)
        return VerifyResult(found, 4, add_scope_to_verdict("verification failed", missing), (*used.notes, *older))
    if not found.samples:
        words = "intact, but without a motion: there was no feasible answer"
        return VerifyResult(found, 3, add_scope_to_verdict(words, missing), used.notes)
    notes = (*used.notes, *describe_older_result(request.out, manifest))
    return VerifyResult(found, 0, add_scope_to_verdict("verification passed", missing), notes)


def _require_process_file(out: Path, manifest: FolderManifest | None) -> None:
    """Raise InputError where the folder was made with a process file, and neither the cell nor an option names one."""
    names = [] if manifest is None else [f.name for f in manifest.inputs if f.role == PROCESS_ROLE]
    if names:
        raise InputError(
            f"was made with the process file {names[0]}, which the cell does not name; expected --process FILE with "
            "that file",
            file=out,
        )
