"""``machopt batch``: find the jobs, do those that are not done, write the summary."""

from __future__ import annotations

import contextlib
import os
import time
import uuid
from collections.abc import Callable, Collection, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from machopt.batch.batch_comparison import BatchComparison, compare_batches
from machopt.batch.dask_executor import DaskExecutor, check_installed, get_machine_memory
from machopt.batch.job_discovery import BatchJob, find_jobs
from machopt.batch.job_key import JobKeyBuilder, ReadyJob, RefusedJob, compute_file_hash, compute_program_version
from machopt.batch.job_status import JobStatus
from machopt.batch.job_store import LOCK, MAIN_FILE, SUMMARY_FILES, TIMING_FILES, JobStore, is_batch, open_store
from machopt.batch.job_supervisor import JobEnd, JobSpec, read_log_tail
from machopt.batch.process_messages import JobMessage
from machopt.batch.process_tree import format_signal_name
from machopt.batch.request import BatchProgress, BatchRequest, BatchResult
from machopt.batch.summary import build_batch_document, compute_exit_code, write_summary
from machopt.commands.manifest import read_library_versions
from machopt.data_types.documents.batch_document import (
    BatchDocument,
    BatchJobDocument,
    BatchRowSection,
    JobFailureDocument,
    JobTimingDocument,
)
from machopt.data_types.manifest import FolderManifest, ManifestFile
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.errors import InputError, OptionError
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.output import read_result
from machopt.toolpath.reading_options import format_reading_options

STOPPED_EXIT_CODE = 130
FAILED_STATES = ("crashed", "over time", "over memory")
"""States that are worth another try; the rest are answers."""
_MIB = 2**20


def run_batch(request: BatchRequest, progress: Callable[[BatchProgress], None] = lambda _: None) -> BatchResult:
    """Do all jobs that are not finished yet and write the summary of all of them.

    Ctrl-C ends the jobs at work, keeps the finished ones, writes the summary of those and returns exit code 130.

    Args:
        request: what to do.
        progress: called at the start and after every job.

    Raises:
        InputError: the list, a file it names, the output folder, the scheduler or the folder to compare with is wrong,
            or no job at all could start; nothing was started then.
    """
    _check_request(request)
    refuse_without_pyarrow(str(request.extra.get("tables", "csv")))
    found = find_jobs(request)
    keys = JobKeyBuilder(request, request.version or compute_program_version())
    plans = [keys.build_key(job) for job in found.jobs]
    if all(isinstance(plan, RefusedJob) for plan in plans):
        raise InputError(f"none of {len(plans)} jobs can start; the first: {_get_first_reason(plans)}")
    other = None if request.compare is None else _read_other_batch(request.compare)
    batch = f"machopt-{uuid.uuid4().hex[:12]}"
    with _remove_unused_folder(request.out), open_store(request.out, batch, force=request.overwrite) as store:
        _commit_interrupted_jobs(store, plans, request)
        todo, clock = _list_open_jobs(store, plans, request), _ProgressClock(len(plans), plans)
        lines = _build_job_statuses(store, plans, again={plan.job.label for plan in todo})
        store.begin_batch(build_batch_document(found, lines, keys.version, complete=False))
        clock.reused = len(plans) - len(todo)
        clock.trouble = sum(line.exit_code not in (0, None) for line in lines)
        progress(clock.build_progress())
        stopped = False
        try:
            with contextlib.closing(_run_jobs(request, store, todo, clock)) as ends:
                for label, ended, ready in ends:
                    record = _build_record(ready, ended, request)
                    store.commit_job(label, Path(ended.folder) if ended.folder else None, record, _build_timing(ended))
                    clock.count_finished(label, record)
                    progress(clock.build_progress())
        except KeyboardInterrupt:
            stopped = True
        lines = _build_job_statuses(store, plans)
        compared = None if other is None else _compare_with_other(store, lines, other)
        result = build_batch_document(
            found,
            lines,
            keys.version,
            complete=not stopped,
            others=store.list_other_folders(_list_labels(plans)),
            compared=compared,
        )
        write_summary(store, lines, result, compared)
        if request.extra.get("tables") == "parquet":
            store.copy_to_parquet(
                name
                for name in (*SUMMARY_FILES, *TIMING_FILES)
                if name.endswith(".csv") and (store.folder / name).is_file()
            )
        code = STOPPED_EXIT_CODE if stopped else compute_exit_code(lines)
        store.write_manifest(_build_manifest(request, plans, "stopped" if stopped else "complete", code))
    return BatchResult(code, result, request.out / "summary.html", clock.done, clock.reused)


@contextlib.contextmanager
def _remove_unused_folder(out: Path) -> Generator[None]:
    """Leave no new folder behind where nothing could be started in it; one with a job in it stays."""
    new = not out.exists()
    try:
        yield
    except InputError:
        jobs = out / "jobs"
        if new and not (jobs.is_dir() and any(jobs.iterdir())):
            with contextlib.suppress(OSError):  # files of others stay, and the folder with them
                for name in (MAIN_FILE, LOCK):
                    (out / name).unlink(missing_ok=True)
                jobs.rmdir()
                out.rmdir()
        raise


def _check_request(request: BatchRequest) -> None:
    check_installed()
    for value, name in (
        (request.time_limit, "--time-limit-s"),
        (request.memory_limit, "--memory-limit-mib"),
        (request.workers, "--jobs"),
    ):
        if value is not None and not value > 0:
            raise InputError(f"found {value:g}; more than zero would work", where=name)
    for file, name in ((request.plan_file, "--plan"), (request.process, "--process")):
        if file is not None and not file.is_file():
            raise OptionError("no such file", file=file, where=name)
    with activate_user_effects(
        load_effect_files(request.effects)
    ):  # reported once, before the first job: what no job could use
        pass


def _build_manifest(
    request: BatchRequest, plans: Sequence[ReadyJob | RefusedJob], verdict: str, code: int
) -> FolderManifest:
    """What the batch was made from: every file of every job, by the hash that its key was made of."""
    read = {name: sha for plan in plans if isinstance(plan, ReadyJob) for name, sha in plan.inputs.items()}
    inputs = tuple(ManifestFile(name, "input", sha, _get_file_size(Path(name))) for name, sha in sorted(read.items()))
    return FolderManifest(
        command="batch",
        verdict=verdict,
        exit_code=code,
        versions=read_library_versions(),
        inputs=inputs,
        options={"overrides": list(request.overrides), "posts": list(map(str, request.posts))},
        reading=format_reading_options(request.reading),
    )


def _get_file_size(file: Path) -> int:
    """Bytes of a file as it is now; 0 where it has gone since its hash was taken."""
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _get_first_reason(plans: Sequence[ReadyJob | RefusedJob]) -> str:
    return next(plan.reason for plan in plans if isinstance(plan, RefusedJob))


def _list_labels(plans: Sequence[ReadyJob | RefusedJob]) -> set[str]:
    return {plan.job.label for plan in plans}


def _list_open_jobs(store: JobStore, plans: Sequence[ReadyJob | RefusedJob], request: BatchRequest) -> list[ReadyJob]:
    """The jobs that are not finished, in order."""
    ready = [plan for plan in plans if isinstance(plan, ReadyJob)]
    store.take_over(_list_labels(plans), {plan.job.label: plan.key for plan in ready})
    out = []
    for plan in ready:
        record = store.find_finished(plan.job.label, plan.key)
        if record is None or (record.state in FAILED_STATES and not request.keep_failed):
            out.append(plan)
    return out


def _commit_interrupted_jobs(store: JobStore, plans: Sequence[ReadyJob | RefusedJob], request: BatchRequest) -> None:
    """Keep the jobs that had ended when an earlier run was killed."""
    by_label = {plan.job.label: plan for plan in plans if isinstance(plan, ReadyJob)}
    for label, key, ended in store.list_interrupted_jobs():
        plan = by_label.get(label)
        if plan is not None and plan.key == key and store.find_finished(label, key) is None:
            store.commit_job(label, Path(ended.folder), _build_record(plan, ended, request), _build_timing(ended))


def _run_jobs(
    request: BatchRequest, store: JobStore, todo: Sequence[ReadyJob], clock: _ProgressClock
) -> Generator[tuple[str, JobEnd, ReadyJob], None, None]:
    """Every job with its end, as they finish; workers are there only for as long as there is something to do."""
    if not todo:
        return
    workers = min(request.workers or len(_list_cores()), len(todo))
    memory = request.memory_limit
    if memory is None and request.scheduler is None:
        memory = _compute_memory_share(workers)
    specs = [(plan.job.label, _build_job_spec(plan, request, store, memory)) for plan in todo]
    by_label = {plan.job.label: plan for plan in todo}
    with DaskExecutor(store.work.name, scheduler=request.scheduler, workers=workers, version=request.version) as engine:
        engine.check_workers(store.work)
        clock.start()
        with contextlib.closing(engine.run_jobs(specs)) as ends:
            for label, ended in ends:
                yield label, ended, by_label[label]


def _build_job_spec(plan: ReadyJob, request: BatchRequest, store: JobStore, memory: int | None) -> JobSpec:
    job = plan.job
    message = JobMessage(
        cell=str(job.cell),
        toolpath=str(job.toolpath),
        plan_file=None if request.plan_file is None else str(request.plan_file.resolve()),
        process=None if request.process is None else str(request.process.resolve()),
        overrides=request.overrides,
        direct=job.options,
        reading=job.reading,
        allow_external=request.allow_external,
        posts=tuple(map(str, job.posts)),
        effects=tuple(str(f.resolve()) for f in request.effects),
        **request.extra,
    )
    return JobSpec(
        label=job.label,
        key=plan.key,
        batch=store.work.name,
        work=str(store.work),
        entry=request.entry,
        job={"request": message.to_json_types()},
        time_limit=job.time_limit or request.time_limit,
        memory_limit=job.memory_limit or memory,
    )


def _build_record(ready: ReadyJob, ended: JobEnd, request: BatchRequest) -> BatchJobDocument:
    """Return the record of a job: it is the same in two runs of the same job."""
    state, row = _describe_state(ready, ended, request)
    return BatchJobDocument(machopt_batch_job=1, job=ready.job.label, key=ready.key, state=state, row=row)


def _describe_state(ready: ReadyJob, ended: JobEnd, request: BatchRequest) -> tuple[str, BatchRowSection]:
    """The word for how it ended, and its row of the summary."""
    if ended.how == "ended" and isinstance(ended.outcome, BatchRowSection):
        changed = [f for f, sha in ready.inputs.items() if not _is_unchanged(Path(f), sha)]
        if changed:
            return "crashed", _build_failure_row(1, "inputs changed", f"{changed[0]} was changed while the job ran")
        states = {0: "done", 2: "refused", 3: "infeasible", 4: "verification failed"}
        return states.get(ended.outcome.exit_code, "crashed"), ended.outcome
    if ended.how == "time":
        limit = ready.job.time_limit or request.time_limit
        return "over time", _build_failure_row(3, "over time", f"was not finished after its time limit of {limit:g} s")
    if ended.how == "memory":
        limit_bytes = ready.job.memory_limit or request.memory_limit
        size = "its share of the machine's memory" if limit_bytes is None else f"{limit_bytes / _MIB:.0f} MiB"
        return "over memory", _build_failure_row(3, "over memory", f"needed more memory than {size}")
    return "crashed", _build_failure_row(1, "crashed", _describe_crash(ended))


def _describe_crash(ended: JobEnd) -> str:
    """Why a process died, in words."""
    if ended.how == "server":
        return f"its process could not be started or was killed from outside{f': {ended.text}' if ended.text else ''}"
    if isinstance(ended.outcome, JobFailureDocument):
        return f"internal error: {ended.outcome.error}: {ended.outcome.text} (log.txt shows where)"
    if ended.code is not None and ended.code < 0:
        name = format_signal_name(-ended.code)
        more = ", from outside or because the machine had no memory left" if name == "SIGKILL" else ""
        return f"killed by {name}{more} (log.txt has its last words)"
    return f"ended by itself with code {ended.code} and no result: {read_log_tail(Path(ended.folder))}".removesuffix(
        ": "
    )


def _build_failure_row(exit_code: int, verdict: str, reason: str) -> BatchRowSection:
    return BatchRowSection(exit_code=exit_code, verdict=verdict, reason=reason)


def _is_unchanged(file: Path, sha: str) -> bool:
    try:
        return compute_file_hash(file) == sha
    except OSError:
        return False


def _build_timing(ended: JobEnd) -> JobTimingDocument:
    return JobTimingDocument(
        wall_s=round(ended.wall, 3),
        cpu_s=round(ended.cpu, 3),
        peak_MiB=round(ended.peak / _MIB),
        worker=ended.worker,
    )


def _build_job_statuses(
    store: JobStore, plans: Sequence[ReadyJob | RefusedJob], again: Collection[str] = ()
) -> list[JobStatus]:
    """All jobs in order, with what is known of them; nothing of those that are done again."""
    out = []
    for plan in plans:
        job = plan.job
        if isinstance(plan, RefusedJob):
            row = _build_failure_row(2, "refused", plan.reason).to_json_types()
            out.append(JobStatus(job=job, key="", cell_name="", state="refused", row=row))
            continue
        record = None if job.label in again else store.find_finished(job.label, plan.key)
        if record is None:
            out.append(JobStatus(job=job, key=plan.key, cell_name=plan.cell_name, state="waiting", row={}))
        else:
            out.append(
                JobStatus(
                    job=job,
                    key=plan.key,
                    cell_name=plan.cell_name,
                    state=record.state,
                    row=record.row.to_json_types(),
                    files=record.files,
                )
            )
    return out


@dataclass(frozen=True)
class _OtherBatch:
    folder: Path
    result: BatchDocument


def _read_other_batch(folder: Path) -> _OtherBatch:
    if not (folder.is_dir() and is_batch(folder) and (folder / MAIN_FILE).is_file()):
        raise OptionError("is no batch's output (no batch.json of ours in it)", file=folder, where="--compare")
    return _OtherBatch(folder, read_result(folder / MAIN_FILE, BatchDocument))


def _compare_with_other(store: JobStore, lines: Sequence[JobStatus], other: _OtherBatch) -> BatchComparison:
    return compare_batches(store.jobs, lines, other.folder, other.result)


class _ProgressClock:
    """Counts jobs and time."""

    def __init__(self, total: int, plans: Sequence[ReadyJob | RefusedJob]) -> None:
        self.total, self.reused, self.done, self.trouble, self.last = total, 0, 0, 0, ""
        self._names = {plan.job.label: _format_job_name(plan.job) for plan in plans}
        self._begin = time.monotonic()

    def start(self) -> None:
        self._begin = time.monotonic()

    def count_finished(self, label: str, record: BatchJobDocument) -> None:
        """Count a finished job, and whether it had trouble.

        Args:
            label: Label of the job.
            record: The record of the job.
        """
        self.done += 1
        self.trouble += record.row.exit_code != 0
        self.last = f"{self._names[label]}: {record.row.verdict}"

    def build_progress(self) -> BatchProgress:
        elapsed = time.monotonic() - self._begin if self.done else 0.0
        return BatchProgress(
            total=self.total, reused=self.reused, done=self.done, trouble=self.trouble, elapsed=elapsed, last=self.last
        )


def _format_job_name(job: BatchJob) -> str:
    return f"{job.toolpath_name} ({job.variant})" if job.variant else job.toolpath_name


def _list_cores() -> Sequence[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)


def _compute_memory_share(workers: int) -> int:
    """Bytes of memory for each of some workers on this machine, a tenth left for the rest."""
    return int(0.9 * get_machine_memory() / workers)
