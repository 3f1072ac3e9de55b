"""The command ``batch``: many cells × toolpaths × options, resumable."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.progress_display import print_result
from machopt.cli.reading_options import build_reading_parser, convert_reading_options
from machopt.cli.shared_options import add_shared_option

if TYPE_CHECKING:
    from machopt.batch.request import BatchProgress

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    job = commands.add_parser(
        "batch",
        parents=[common, build_reading_parser()],
        help="run many optimize jobs, each in a separate process; can be resumed",
    )
    job.add_argument(
        "toolpaths",
        nargs="+",
        metavar="JOBS",
        help="folders of toolpaths, patterns in quotes ('parts/*.nc'), toolpath files, or job lists (YAML, CSV)",
    )
    add_shared_option(job, "--out", help="output folder; the same command continues an interrupted batch")
    add_shared_option(job, "--force")
    job.add_argument(
        "--cell", type=Path, help="cell for toolpaths without a folder named cell next to them or above them"
    )
    job.add_argument("--jobs", type=int, metavar="N", help="number of worker processes (default: one for each core)")
    job.add_argument(
        "--scheduler", metavar="ADDRESS", help="address of a running Dask scheduler, e.g. tcp://10.0.0.5:8786"
    )
    job.add_argument(
        "--time-limit-s", type=float, default=3600.0, metavar="S", help="time limit of a job, s (default: 3600)"
    )
    job.add_argument(
        "--memory-limit-mib",
        type=float,
        metavar="MIB",
        help="memory limit of a job (default: an equal share of the memory)",
    )
    job.add_argument("--keep-failed", action="store_true", help="do not repeat jobs that crashed or exceeded a limit")
    job.add_argument("--compare", type=Path, metavar="OTHER_OUT", help="also list the differences from another batch")
    add_shared_option(
        job,
        "--post",
        help="robot program of every job: krl, rapid, fanuc, urscript, … or a template file (default: the post of the "
        "job list, else controller.post of the cell, else none); may be repeated",
    )
    add_shared_option(job, "--program-tolerance-mm")
    add_shared_option(job, "--tables")
    add_shared_option(job, "--plan", help="YAML file with planning options for all jobs")
    add_shared_option(job, "--set", help="set a planning option for all jobs; may be repeated")
    add_shared_option(
        job, "--process", help="process.yaml with cutting conditions and tolerances, in place of that of every cell"
    )
    add_shared_option(
        job, "--seed", type=int, default=None, help="seed of the random search around obstacles (default: 0)"
    )
    add_shared_option(job, "--allow-external", help="allow cells to use files outside their folders")
    add_shared_option(job, "--effects")
    job.set_defaults(run=_run_batch)


def _run_batch(args: argparse.Namespace) -> int:
    from machopt.batch.request import BatchRequest
    from machopt.batch.run import run_batch

    warn_of_effect_code(args)
    overrides = [*args.set, *([] if args.seed is None else [f"seed={args.seed}"])]
    request = BatchRequest(
        jobs=tuple(args.toolpaths),
        out=args.out,
        overwrite=args.overwrite,
        cell=args.cell,
        plan_file=args.plan,
        process=args.process,
        overrides=tuple(overrides),
        reading=convert_reading_options(args),
        allow_external=args.allow_external,
        workers=args.jobs,
        scheduler=args.scheduler,
        time_limit=args.time_limit_s,
        keep_failed=args.keep_failed,
        compare=args.compare,
        posts=tuple(args.post),
        effects=tuple(args.effects),
        extra=_list_job_inputs(args),
        memory_limit=None if args.memory_limit_mib is None else int(args.memory_limit_mib * 2**20),
    )
    with _BatchProgress(show=not (args.quiet or args.json)) as bar:
        outcome = run_batch(request, bar.report_progress)
    counts = outcome.result.counts
    if args.json:
        print_result(outcome.result)
    elif not args.quiet:
        words = ", ".join(f"{n} {state}" for state, n in counts.items())
        print(f"{words} ({outcome.done} done now, {outcome.reused} kept)")
        print(f"summary: {outcome.report}")
    if outcome.exit_code == 130:
        print("machopt: stopped; finished jobs are kept, the same command goes on", file=sys.stderr)
    elif outcome.exit_code:
        bad = ", ".join(f"{n} {state}" for state, n in counts.items() if state != "done")
        print(f"machopt: {bad}; {outcome.report} says why", file=sys.stderr)
    return outcome.exit_code


def _list_job_inputs(args: argparse.Namespace) -> dict[str, Any]:
    """Return what every job gets besides its options; it is part of the key of a finished job."""
    given = {"program_tolerance_mm": args.program_tolerance_mm, "tables": args.tables}
    return {k: v for k, v in given.items() if v not in (None, "csv")}


class _BatchProgress:
    """How far the batch is: on a terminal a bar, elsewhere a line after every job."""

    def __init__(self, *, show: bool) -> None:
        self._show = show
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> _BatchProgress:
        if self._show and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._bar = Progress(BarColumn(30), TextColumn("{task.description}"), console=Console(stderr=True))
            self._task = self._bar.add_task("starting workers", total=None)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def report_progress(self, progress: BatchProgress) -> None:
        """Show the progress of the batch.

        Args:
            progress: The progress.
        """
        if self._bar is not None:
            self._bar.update(
                self._task,
                total=progress.total,
                completed=progress.reused + progress.done,
                description=progress.status_line,
            )
        elif self._show:
            print(progress.status_line, file=sys.stderr, flush=True)
