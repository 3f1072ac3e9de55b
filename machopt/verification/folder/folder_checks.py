"""All checks of an output folder of optimize against its inputs.

``machopt verify`` and the last step of ``machopt optimize`` both use :func:`check_contents` and
:func:`verify_folder`, so their results are the same.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from machopt.cell.tool_selection import split_into_tool_segments
from machopt.data_types.cell import Cell
from machopt.data_types.manifest import FolderManifest, ManifestFile
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.file_formats.parquet_tables import find_parquet_difference
from machopt.numerics.parallel_map import run_two_in_threads
from machopt.output.manifest_file import MANIFEST, find_differences, read_manifest
from machopt.verification import Verification, VerificationCheck
from machopt.verification.check_results import CheckName, VerificationRow, build_skipped_check
from machopt.verification.folder.allowed_files import PARQUET_COPIES, find_unreadable_files, find_wrong_roles
from machopt.verification.folder.options_in_force import build_failed_check
from machopt.verification.folder.programs.post_lookup import build_tolerance, find_post
from machopt.verification.folder.programs.program_comparison_result import ListedProgram
from machopt.verification.folder.programs.read_back import check_programs
from machopt.verification.folder.programs.rewritten_program import build_failed_program_check
from machopt.verification.folder.programs.stray_programs import find_stray_programs
from machopt.verification.folder.result_json.result_checks import check_result_document
from machopt.verification.motion.motion_verification import ExportedTables, read_tables
from machopt.verification.motion.process.recomputed_segment_forces import attach_recomputed_forces
from machopt.verification.motion.process.stock_contact import check_stock_contact
from machopt.verification.motion.tool_changes import split_tables, verify_tool_segments
from machopt.verification.tables.exported_tables import ExportedMotion, read_motion
from machopt.verification.tables.table_cache import cache_tables

MISSING_VALUE = float("nan")
MAX_PARALLEL_SAMPLES = (
    200_000  # samples of a motion up to which programs and tables are checked in parallel; above, memory limits it
)


def verify_folder(
    cell: Cell,
    toolpath: Toolpath,
    folder: Path,
    *,
    options: PlanOptions,
    inputs: tuple[ManifestFile, ...],
    contents: Verification | None = None,
) -> Verification:
    """Check every file of an output folder of optimize.

    Args:
        cell: the robot cell as it is now.
        toolpath: what was to be followed, read with the manifest's reading options.
        folder: the output folder.
        options: the planning options in force.
        inputs: the files of cell and toolpath as they are now.
        contents: what :func:`check_contents` found, where that has been done already.

    Returns:
        one list of checks: manifest and inputs first, then tables and programs, then what result.json states of these.
        Files that are missing or unreadable are failed checks, never exceptions.
    """
    manifest, checks = check_manifest(folder, inputs)
    unreadable = find_unreadable_files(folder, manifest)
    if unreadable:  # nothing is opened, so that nothing can block or fill the memory
        stopped = build_failed_check(CheckName.READABLE, "; ".join(f"{name} {why}" for name, why in unreadable[:3]))
        return Verification(
            (*checks, replace(stopped, file=unreadable[0][0], what=CheckName.READABLE)), 0, MISSING_VALUE
        )
    with cache_tables():
        if manifest is not None and manifest.exit_code == 3 and not (folder / "trajectory.csv").exists():
            contents, found = None, Verification((), 0, 0.0)
        else:
            contents = found = contents or check_contents(cell, toolpath, folder, options=options, manifest=manifest)
        checks += check_parquet_copies(folder)
        stated = check_result_document(folder, cell, toolpath, options, inputs, manifest, contents)
    return replace(found, checks=(*checks, *found.checks, *stated))


def check_parquet_copies(folder: Path) -> list[VerificationCheck]:
    """Check that each Parquet table equals the CSV table of the same name.

    Args:
        folder: The output folder.
    """
    there = [folder / name for name in PARQUET_COPIES if (folder / name).exists()]
    try:
        odd = [(copy, find_parquet_difference(copy.with_suffix(".csv"), copy)) for copy in there]
    except InputError as problem:
        return [build_skipped_check(CheckName.PARQUET, problem.reason)]
    return [_build_check(CheckName.PARQUET, [f"{copy.name} {text}" for copy, text in odd if text])] if there else []


def check_contents(
    cell: Cell, toolpath: Toolpath, folder: Path, *, options: PlanOptions, manifest: FolderManifest | None
) -> Verification:
    """Recompute the tables and programs of a folder from cell and toolpath; hashes are not used.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        folder: The output folder.
        options: The planning options in force.
        manifest: Names the programs and their tolerance; during optimize it is not written yet and lists no files.
    """
    try:
        motion: ExportedMotion | None = read_motion(folder / "trajectory.csv", cell)
    except InputError:
        motion = None  # those who need it try again and say what is wrong
    try:
        segments, options = attach_recomputed_forces(
            split_into_tool_segments(cell, toolpath), toolpath, options, folder
        )
        listed = None if manifest is None else manifest.touching_pairs
        touching = None if listed is None else tuple((p.a, p.b) for p in listed)

        def of_tables() -> Verification:
            return verify_tool_segments(segments, folder, options=options, motion=motion, touching=touching)

        def of_programs(verification: Verification | None = None) -> list[VerificationRow]:
            return _check_programs(segments, folder, options, manifest, motion, verification)

        if len(segments) == 1 and motion is not None and len(motion.time) <= MAX_PARALLEL_SAMPLES:
            found, programs = run_two_in_threads(of_tables, of_programs)
        else:
            found = of_tables()
            programs = of_programs(found)
    except InputError as problem:
        return Verification((build_failed_check(CheckName.TABLES, str(problem), because=problem),), 0, MISSING_VALUE)
    of_all = Verification.from_rows([*check_stock_contact(segments), *programs], 0, MISSING_VALUE)
    return replace(
        found,
        checks=(*found.checks, *of_all.checks),
        information=(*found.information, *of_all.information),
    )


def _check_programs(
    segments: tuple[ToolSegment, ...],
    folder: Path,
    options: PlanOptions,
    manifest: FolderManifest | None,
    motion: ExportedMotion | None,
    verification: Verification | None,
) -> list[VerificationRow]:
    """The robot programs that the manifest lists, and files that look like one and belong to none.

    Args:
        verification: what the tables came to, which a job that changes tools is cut by; None for other jobs.
    """
    cell = segments[0].cell
    listed = () if manifest is None else manifest.programs
    paths = () if manifest is None else manifest.inputs_of("toolpath")
    name = (
        paths[0].name if len(paths) == 1 else None
    )  # a renamed CAM file is the same input; the head has the first name
    every = [
        (p.stint, ListedProgram(p.post, find_post(p.post, folder, cell, manifest), p.files)) for p in listed if p.files
    ]
    try:
        tolerance = build_tolerance(None if manifest is None else manifest.program_tolerance_mm, options)
        compared = list(find_stray_programs(folder, [one for _, one in every]))
        for segment, tables in _split_tables(segments, folder, motion, verification):
            compared += check_programs(
                segment.cell,
                segment.toolpath,
                folder,
                [one for number, one in every if number == segment.number],
                options=segment.restrict_options(options),
                tolerance=tolerance,
                tables=motion if tables is None else tables,
                source=None if name is None else f"{cell.name}; {name}",
            )
    except InputError as problem:
        return [build_failed_check(CheckName.PROGRAMS, str(problem), because=problem)]
    odd = [one.files[0] for number, one in every if number not in {s.number for s in segments}]
    checks = [build_failed_program_check(file, "of this job", "no tool of the job is its") for file in odd]
    rows: list[VerificationRow] = [*checks]
    for one in compared:
        rows += [*one.information, *one.checks]
    return rows


def _split_tables(
    segments: tuple[ToolSegment, ...], folder: Path, motion: ExportedMotion | None, verification: Verification | None
) -> list[tuple[ToolSegment, ExportedTables | None]]:
    """Return each tool with its part of the tables; none where the changes are wrong, which is reported already."""
    if len(segments) == 1:
        return [(segments[0], None)]
    whole = None if motion is None else read_tables(segments[0].cell, folder, motion)
    if whole is None or verification is None or isinstance(whole, Verification):
        return []
    if any(c.check_name == CheckName.CHANGES for c in verification.failed):
        return []
    return list(zip(segments, split_tables(whole, segments), strict=True))


def check_manifest(
    folder: Path, inputs: tuple[ManifestFile, ...]
) -> tuple[FolderManifest | None, list[VerificationCheck]]:
    """Check the manifest, the folder's files against it, and its recorded inputs against those given.

    Args:
        folder: The output folder.
        inputs: The given input files with their hashes.

    Returns:
        The manifest, None where it cannot be read, and the checks.
    """
    try:
        manifest, sealed = read_manifest(folder)
    except InputError as problem:
        return None, [build_failed_check(CheckName.MANIFEST, _describe_missing_manifest(folder, problem))]
    if manifest.command != "optimize":
        message = f"is of machopt {manifest.command}; only what optimize wrote is verified"
        return manifest, [build_failed_check(CheckName.MANIFEST, message)]
    checks = [
        _build_check(CheckName.MANIFEST, [] if sealed else ["was edited after it was written: its seal does not fit"])
    ]
    checks.append(_check_files(folder, manifest))
    checks.append(_build_check(CheckName.INPUTS, list_input_differences(manifest.inputs, inputs)))
    return manifest, checks


def _check_files(folder: Path, manifest: FolderManifest) -> VerificationCheck:
    """What the folder holds, by name and hash, against what the manifest lists."""
    changed = find_differences(folder, manifest)
    check = _build_check(
        CheckName.FILES, [*(f"{d.name} {d.description}" for d in changed), *find_wrong_roles(folder, manifest)]
    )
    return replace(check, file=changed[0].name, what=CheckName.FILES) if changed else check


def list_input_differences(recorded: tuple[ManifestFile, ...], given: tuple[ManifestFile, ...]) -> list[str]:
    """Return the inputs whose name or hash differs from the recorded one.

    Args:
        recorded: Inputs that the manifest records.
        given: Inputs that the user gave.
    """
    out = []
    roles = {f.role for f in given} | {f.role for f in recorded if f.role not in ("plan", "post", "effects")}
    for role in sorted(roles):
        then = {f.name: f.sha256 for f in recorded if f.role == role}
        now = {f.name: f.sha256 for f in given if f.role == role}
        if sorted(then.values()) == sorted(now.values()):
            continue  # the same bytes; a moved cell or a renamed file is the same input
        for name in sorted(then.keys() | now.keys()):
            old, new = then.get(name), now.get(name)
            if old != new:
                made = f"sha256 {old[:12]}…" if old else "nothing of that name"
                here = f"sha256 {new[:12]}…" if new else "not there"
                out.append(f"another {role}: {name} is {here}, OUT was made from {made}")
    return out


def _build_check(name: str, wrong: list[str]) -> VerificationCheck:
    return VerificationCheck(
        name=name, passed=not wrong, value=float(len(wrong)), limit=0.0, unit="differences", where="; ".join(wrong)
    )


def _describe_missing_manifest(folder: Path, problem: InputError) -> str:
    if not (folder / MANIFEST).exists():
        return (
            f"{folder} holds no {MANIFEST}: it was written by a version before manifests, or the file was removed. "
            "Their content is checked, but not that they are the files that were written; optimize again for a folder "
            "that is"
        )
    return str(problem)
