"""Verified output files of a plan: tables, programs, verdict, result and report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from machopt.commands.optimize.computation import OptimizeComputation
from machopt.commands.optimize.report_files import write_plan_tables, write_report_files
from machopt.commands.optimize.trade_off_front import FRONT_FILE as FRONT
from machopt.commands.optimize.trade_off_front import compute_trade_off_front, write_trade_off_front
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.file_formats.parquet_tables import write_parquet_copies
from machopt.numerics.heap_release import release_free_memory
from machopt.planning.job.pareto_front import measure_front_plan
from machopt.program_export.exported_programs import write_programs
from machopt.verification import Verification
from machopt.verification.folder.folder_checks import check_contents, verify_folder
from machopt.verification.tables.table_cache import cache_tables


@dataclass(frozen=True)
class VerifiedFiles:
    """Files of the output folder with their verification."""

    result: OptimizeDocument
    verification: Verification | None  # of every file; None where there is no motion


def write_verified_files(the_plan: OptimizeComputation, folder: Path) -> VerifiedFiles:
    """Write a plan's files and verify them.

    Args:
        the_plan: The plan with its inputs.
        folder: An empty folder.
    """
    with cache_tables():  # by the verdict on the tables, and by that on all of it
        return _write_and_verify(the_plan, folder)


def _write_and_verify(the_plan: OptimizeComputation, folder: Path) -> VerifiedFiles:
    given, made, timings = the_plan.inputs, the_plan.job_result.with_touching_pairs(), the_plan.timings
    timeline = made.timeline
    release_free_memory()
    with timings.stage("export"):
        write_plan_tables(
            folder,
            made.plan,
            made.points,
            timeline,
            given.toolpath.engagement,
        )
    if timeline is not None and timeline.trajectory is not None:
        with timings.stage("programs"):
            jobs = [(s.segment, s.plan, s.timeline) for s in made.segments]
            made = made.with_programs(write_programs(folder, given.posts, jobs, given.tolerance))
        release_free_memory()
        with timings.stage("verify"):
            found = check_contents(given.cell, given.toolpath, folder, options=given.options, manifest=made.manifest)
            made = made.with_verification(found)
    if given.front and timeline is not None and made.exit_code == 0:
        with timings.stage("front"):
            own = measure_front_plan("requested", "", made.plan, timeline, made.points, made.plan)
            made = replace(made, front=tuple(compute_trade_off_front(given, made.plan, own)))
            write_trade_off_front(folder / FRONT, list(made.front))
    if given.tables == "parquet":
        with timings.stage("export"):
            write_parquet_copies(folder.glob("*.csv"))
    release_free_memory()
    result = write_report_files(made, folder, timings)
    whole = made.verification
    if made.verification is not None:
        whole = verify_folder(
            given.cell,
            given.toolpath,
            folder,
            options=given.options,
            inputs=given.manifest.inputs,
            contents=made.verification,
        )
        if made.verification.ok and not whole.ok:  # what was written is not what was meant: a bug, or a bad disk
            result = write_report_files(replace(made, verification=whole), folder, timings)
    return VerifiedFiles(result, whole)
