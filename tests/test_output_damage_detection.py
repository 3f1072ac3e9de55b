"""Damages of a finished plan make the verification fail, with and without the hashes of the manifest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from output_damage.damage_case import (
    CELLS,
    INVENTORY,
    JOBS,
    MANIFEST_CHECK,
    PASS,
    Damage,
    Job,
    copy_job,
    edit_json,
    plan_table,
    update_manifest_hashes,
)

from machopt.commands import verify as service
from machopt.commands.input_hashes import build_manifest_file, list_cell_inputs, rename_duplicate_names
from machopt.commands.verify import run_verify
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.output.file_hashes import compute_digest, compute_sha256
from machopt.verification import Verification, VerificationCheck
from machopt.verification.folder import folder_checks as contents
from machopt.verification.folder.options_in_force import VerifyRequest
from machopt.verification.folder.version_mismatch import FILES_ADDED_SINCE, KEYS_ADDED_SINCE
from machopt.verification.tables.exported_tables import ExportedMotion

PARTS = sorted(
    p.stem for p in (Path(__file__).parent / "output_damage").glob("*.py") if p.stem not in ("__init__", "damage_case")
)
TABLES = ("points.csv", "trajectory.csv", "compensation.csv", "tilt.csv", "rapid_corners.csv", "engagement.csv")
DAMAGES: list[Damage] = [d for part in PARTS for d in import_module(f"output_damage.{part}").DAMAGES]


@pytest.fixture(autouse=True)
def _remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read and check cells and tables with the same bytes only once:
    most damages change neither, and a check takes 1 s."""
    monkeypatch.setattr(service, "load_cell", _load_cell)
    monkeypatch.setattr(contents, "verify_tool_segments", _verify_segments)


_CELLS: dict[str, Cell] = {}
_FOUND: dict[str, Verification] = {}
_READ, _CHECKED = service.load_cell, contents.verify_tool_segments


def _bytes_of(folder: Path, pattern: str = "*") -> str:
    return repr(
        sorted((f.relative_to(folder).as_posix(), compute_sha256(f)) for f in folder.rglob(pattern) if f.is_file())
    )


def _load_cell(path: Path, **how: bool) -> Cell:
    key = f"{_bytes_of(path)} {how}"
    if key not in _CELLS:
        _CELLS[key] = _READ(path, **how)
    return _CELLS[key]


def _verify_segments(
    segments: Sequence[ToolSegment],
    out: Path,
    *,
    options: PlanOptions,
    motion: ExportedMotion | None,
    touching: Sequence[tuple[str, str]] | None,
) -> Verification:
    cell, toolpath = segments[0].cell, segments[0].whole
    read = compute_digest(toolpath.position.tobytes() + toolpath.axis.tobytes() + toolpath.feed.tobytes())
    tables = [(name, (out / name).is_file() and compute_sha256(out / name)) for name in TABLES]
    key = repr((_bytes_of(cell.folder), read, tables, options, touching))
    if key not in _FOUND:
        _FOUND[key] = _CHECKED(segments, out, options=options, motion=motion, touching=touching)
    return _FOUND[key]


def found_in(job: Job) -> Verification:
    return run_verify(VerifyRequest(cell=job.cell, toolpath=job.toolpath, out=job.out)).verification


@pytest.mark.parametrize("name", sorted(JOBS))
def test_intact_plan_passes(name: str, damage_job: Callable[[str], Job], tmp_path: Path) -> None:
    """The plan also passes after an update of the hashes in the manifest."""
    job = copy_job(damage_job(name), tmp_path)
    _INTACT[name] = found_in(job)
    assert _INTACT[name].failed == ()
    update_manifest_hashes(job.out)
    assert found_in(job).failed == ()


@pytest.fixture(scope="module")
def stopping(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """The pass with a stop at each rapid corner, as version 0.1.0 executed it."""
    folder = tmp_path_factory.mktemp("stopping")
    return plan_table(folder, CELLS / "kr500_milling", PASS, overrides=("rapid_blend_mm=0",))


def _write_as_first_version(job: Job) -> None:
    """Convert a folder to the form of version 0.1.0, which wrote fewer keys into result.json."""
    with edit_json(job.out / "result.json") as result:
        for key in KEYS_ADDED_SINCE["0.1.0"]:
            del result[key]
        for key in ("deflection_ci90_mm", "deflection_along_mm"):
            result["worst_point"].pop(key, None)
        result["version"] = "0.1.0"
    assert not any((job.out / name).exists() for name in FILES_ADDED_SINCE["0.1.0"])
    with edit_json(job.out / "manifest.json") as manifest:
        manifest["versions"]["machopt"] = "0.1.0"
        manifest["not_recomputed"], manifest["checked"] = ["front"], []
    update_manifest_hashes(job.out)


def test_folder_of_an_earlier_version_passes(stopping: Job, tmp_path: Path) -> None:
    """Tables and programs are recomputed; result.json contains the keys of that version."""
    job = copy_job(stopping, tmp_path)
    _write_as_first_version(job)
    found = found_in(job)
    assert found.failed == ()
    assert "result.json older version" in {c.name for c in found.checks}


@pytest.mark.parametrize(
    ("change", "caught_by"),
    [
        (lambda r: r.update(verdict="infeasible"), "result.json"),
        (lambda r: r.update(exit_code=3), "result.json"),
        (lambda r: r["inputs"].update({"cell.yaml": "0" * 64}), "result.json"),
        (lambda r: r.update(inputs=None), "result.json"),
        (lambda r: r.update(process=None), "result.json"),  # not written by that version, so the whole file is compared
        (lambda r: r.update(version="0.2.0"), "result.json"),
    ],
)
def test_damaged_folder_of_an_earlier_version_fails(
    change: Callable[[dict[str, Any]], None], caught_by: str, stopping: Job, tmp_path: Path
) -> None:
    job = copy_job(stopping, tmp_path)
    _write_as_first_version(job)
    with edit_json(job.out / "result.json") as result:
        change(result)
    update_manifest_hashes(job.out)
    failed = [c.name for c in found_in(job).failed]
    assert any(name.startswith(caught_by) for name in failed), failed


def test_folder_with_newer_files_has_no_earlier_version(stopping: Job, tmp_path: Path) -> None:
    job = copy_job(stopping, tmp_path)
    _write_as_first_version(job)
    (job.out / "tilt.csv").write_text("point,lead_deg,side_deg\n0,0,0\n")
    assert any(c.name.startswith("result.json") for c in found_in(job).failed)


def _says(damage: Damage) -> bool:
    """Return whether the content also reveals the damage."""
    return damage.reseal and not damage.by_hash_alone


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.name)
def test_damage_is_detected(damage: Damage, damage_job: Callable[[str], Job], tmp_path: Path) -> None:
    """The hashes detect the damage; after an update of the hashes, the content detects it where it can.

    If only hashes can detect it, the whole command is run; otherwise only the checks of the manifest, which the command
    reports unchanged.
    """
    failed = _FAILED[damage.name] = set[str]()
    job = copy_job(damage_job(damage.job), tmp_path)
    damage.apply(job)
    checks = _of_manifest(job) if _says(damage) else found_in(job).checks
    failed |= {c.name for c in checks if c.passed is False}
    assert damage.as_is in failed
    if _says(damage):
        update_manifest_hashes(job.out)
        found = found_in(job).failed
        failed |= {str(c.check_name) for c in found}
        assert any(c.name.startswith(damage.caught_by) for c in found), [c.name for c in found]


_INTACT: dict[str, Verification] = {}  # by job
_FAILED: dict[str, set[str]] = {}  # names of the checks by damage


def _of_manifest(job: Job) -> list[VerificationCheck]:
    inputs = rename_duplicate_names(
        (*list_cell_inputs(_load_cell(job.cell)), build_manifest_file(job.toolpath, "toolpath"))
    )
    return contents.check_manifest(job.out, inputs)[1]


def test_command_reports_the_checks_of_the_manifest(damage_job: Callable[[str], Job], tmp_path: Path) -> None:
    job = copy_job(damage_job("pass"), tmp_path)
    with (job.out / "report.html").open("a") as page:
        page.write(" ")
    given, checks = found_in(job).checks, _of_manifest(job)
    assert [c.passed for c in checks].count(False) == 1
    assert set(checks) <= set(given)


def test_every_check_of_the_jobs_can_fail(
    damage_job: Callable[[str], Job], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The tests above verify all jobs and damages; if a selection of tests omitted some, they are verified here."""
    for name in JOBS.keys() - _INTACT.keys():
        test_intact_plan_passes(name, damage_job, tmp_path_factory.mktemp("intact"))
    names = {str(c.check_name) for found in _INTACT.values() for c in found.checks}
    information = {i.check_name for found in _INTACT.values() for i in found.information}
    assert information
    assert not names & information
    lacking = (names - INVENTORY - MANIFEST_CHECK).difference(*_FAILED.values())
    for damage in DAMAGES:
        if _says(damage) and damage.name not in _FAILED and lacking:
            test_damage_is_detected(damage, damage_job, tmp_path_factory.mktemp("damaged"))
            lacking -= _FAILED[damage.name]
    assert lacking <= set(), lacking


def test_names_are_unique() -> None:
    names = [d.name for d in DAMAGES]
    assert len(names) == len(set(names))
