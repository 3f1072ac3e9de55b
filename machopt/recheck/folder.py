"""Everything in an output folder of optimize held against its inputs.

``machopt verify`` and the last step of ``machopt optimize`` both go through :func:`content_checks` and
:func:`verify_folder`, so they cannot disagree.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest, ManifestFile
from machopt.domain.options import PlanOptions
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.formats.parquet import difference
from machopt.formats.toolchoice import stints_of
from machopt.model.threads import both
from machopt.output.manifest import MANIFEST, differences, read_manifest
from machopt.recheck.compared import Posted
from machopt.recheck.folder_files import COPIES, find_unreadable_files, find_wrong_roles
from machopt.recheck.inforce import failed
from machopt.recheck.posts import post_of, tolerance_of
from machopt.recheck.readback import check_programs
from machopt.recheck.resultcheck import result_checks
from machopt.recheck.rewritten import failed_check
from machopt.recheck.strays import strays
from machopt.verify import Check, Verification
from machopt.verify.changes import slices, verify_stints
from machopt.verify.check import Promise, Row, not_run
from machopt.verify.output import Tables, read_tables
from machopt.verify.readonce import read_once
from machopt.verify.table import Motion, read_motion

NAN = float("nan")
BESIDE = 200_000  # samples of a motion up to which programs are checked beside the tables: longer, memory counts more


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
        contents: what :func:`content_checks` found, where that has been done already.

    Returns:
        one list of checks: manifest and inputs first, then tables and programs, then what result.json tells of these.
        Files that are missing or unreadable are failed checks, never exceptions.
    """
    manifest, checks = manifest_checks(folder, inputs)
    unreadable = find_unreadable_files(folder, manifest)
    if unreadable:  # nothing is opened, so that nothing can block or fill the memory
        stopped = failed(Promise.READABLE, "; ".join(f"{name} {why}" for name, why in unreadable[:3]))
        return Verification((*checks, replace(stopped, file=unreadable[0][0], what=Promise.READABLE)), 0, NAN)
    with read_once():
        if manifest is not None and manifest.exit_code == 3 and not (folder / "trajectory.csv").exists():
            contents, found = None, Verification((), 0, 0.0)
        else:
            contents = found = contents or content_checks(cell, toolpath, folder, options=options, manifest=manifest)
        checks += check_copies(folder)
        told = result_checks(folder, cell, toolpath, options, inputs, manifest, contents)
    return replace(found, checks=(*checks, *found.checks, *told))


def check_copies(folder: Path) -> list[Check]:
    """Parquet tables beside the CSV ones, which say the same."""
    there = [folder / name for name in COPIES if (folder / name).exists()]
    try:
        odd = [(copy, difference(copy.with_suffix(".csv"), copy)) for copy in there]
    except InputError as problem:
        return [not_run(Promise.PARQUET, problem.reason)]
    return [_check(Promise.PARQUET, [f"{copy.name} {text}" for copy, text in odd if text])] if there else []


def content_checks(
    cell: Cell, toolpath: Toolpath, folder: Path, *, options: PlanOptions, manifest: Manifest | None
) -> Verification:
    """What the tables and programs of a folder say, recomputed from cell and toolpath; hashes play no part.

    Args:
        manifest: names the programs and their tolerance; in optimize it is not written yet and lists no files.
    """
    try:
        motion: Motion | None = read_motion(folder / "trajectory.csv", cell)
    except InputError:
        motion = None  # those who need it try again and say what is wrong
    try:
        stints = stints_of(cell, toolpath)

        listed = None if manifest is None else manifest.touching_pairs
        touching = None if listed is None else tuple((p.a, p.b) for p in listed)

        def of_tables() -> Verification:
            return verify_stints(stints, folder, options=options, motion=motion, touching=touching)

        def of_programs(found: Verification | None = None) -> list[Row]:
            return _programs(stints, folder, options, manifest, motion, found)

        if len(stints) == 1 and motion is not None and len(motion.time) <= BESIDE:
            found, programs = both(of_tables, of_programs)
        else:
            found = of_tables()
            programs = of_programs(found)
    except InputError as problem:
        return Verification((failed(Promise.TABLES, str(problem), because=problem),), 0, NAN)
    of_all = Verification.of_rows(programs, 0, NAN)
    return replace(
        found,
        checks=(*found.checks, *of_all.checks),
        information=(*found.information, *of_all.information),
    )


def _programs(
    stints: tuple[Stint, ...],
    folder: Path,
    options: PlanOptions,
    manifest: Manifest | None,
    motion: Motion | None,
    found: Verification | None,
) -> list[Row]:
    """The robot programs that the manifest lists, and files that look like one and belong to none.

    Args:
        found: what the tables came to, which a job that changes tools is cut by; not asked of others.
    """
    cell = stints[0].cell
    listed = () if manifest is None else manifest.programs
    paths = () if manifest is None else manifest.inputs_of("toolpath")
    name = (
        paths[0].name if len(paths) == 1 else None
    )  # a renamed CAM file is the same input; the head has the first name
    every = [(p.stint, Posted(p.post, post_of(p.post, folder, cell, manifest), p.files)) for p in listed if p.files]
    try:
        tolerance = tolerance_of(None if manifest is None else manifest.program_tolerance_mm, options)
        compared = list(strays(folder, [one for _, one in every]))
        for stint, tables in _tables(stints, folder, motion, found):
            compared += check_programs(
                stint.cell,
                stint.toolpath,
                folder,
                [one for number, one in every if number == stint.number],
                options=stint.of(options),
                tolerance=tolerance,
                motion=motion,
                tables=tables,
                source=None if name is None else f"{cell.name}; {name}",
            )
    except InputError as problem:
        return [failed(Promise.PROGRAMS, str(problem), because=problem)]
    odd = [one.files[0] for number, one in every if number not in {s.number for s in stints}]
    checks = [failed_check(file, "of this job", "no tool of the job is its") for file in odd]
    rows: list[Row] = [*checks]
    for one in compared:
        rows += [*one.information, *one.checks]
    return rows


def _tables(
    stints: tuple[Stint, ...], folder: Path, motion: Motion | None, found: Verification | None
) -> list[tuple[Stint, Tables | None]]:
    """Each tool with its part of the tables; none where these do not hold the changes, which has been told."""
    if len(stints) == 1:
        return [(stints[0], None)]
    whole = None if motion is None else read_tables(stints[0].cell, folder, motion)
    if whole is None or found is None or isinstance(whole, Verification):
        return []
    if any(c.promise == Promise.CHANGES for c in found.failed):
        return []
    return list(zip(stints, slices(whole, stints), strict=True))


def manifest_checks(folder: Path, inputs: tuple[ManifestFile, ...]) -> tuple[Manifest | None, list[Check]]:
    """The manifest itself, the folder's files against it, and the inputs it names against those given."""
    try:
        manifest, sealed = read_manifest(folder)
    except InputError as problem:
        return None, [failed(Promise.MANIFEST, _no_manifest(folder, problem))]
    if manifest.command != "optimize":
        said = f"is of machopt {manifest.command}; only what optimize wrote is verified"
        return manifest, [failed(Promise.MANIFEST, said)]
    checks = [_check(Promise.MANIFEST, [] if sealed else ["was edited after it was written: its seal does not fit"])]
    checks.append(_files(folder, manifest))
    checks.append(_check(Promise.INPUTS, input_differences(manifest.inputs, inputs)))
    return manifest, checks


def _files(folder: Path, manifest: Manifest) -> Check:
    """What the folder holds, by name and hash, against what the manifest lists."""
    changed = differences(folder, manifest)
    check = _check(Promise.FILES, [*(f"{d.name} {d.what}" for d in changed), *find_wrong_roles(folder, manifest)])
    return replace(check, file=changed[0].name, what=Promise.FILES) if changed else check


def input_differences(recorded: tuple[ManifestFile, ...], given: tuple[ManifestFile, ...]) -> list[str]:
    """Inputs of the cell and the toolpath that are not those recorded, by name and hash."""
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


def _check(name: str, wrong: list[str]) -> Check:
    return Check(
        name=name, passed=not wrong, value=float(len(wrong)), limit=0.0, unit="differences", where="; ".join(wrong)
    )


def _no_manifest(folder: Path, problem: InputError) -> str:
    if not (folder / MANIFEST).exists():
        return (
            f"{folder} holds no {MANIFEST}: it was written by a version before manifests, or the file was removed. "
            "What the files say is checked, that they are the ones written is not; optimize again for a folder that is"
        )
    return str(problem)
