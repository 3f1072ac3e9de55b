"""``machopt batch``: find the jobs, do those that are not done, write the summary."""

from __future__ import annotations

import contextlib
import os
import time
import uuid
from collections.abc import Callable, Collection, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from machopt.batch.compare import Comparison, compare
from machopt.batch.engine import Engine, check_installed, machine_memory
from machopt.batch.find import Job, find_jobs
from machopt.batch.key import Keys, Ready, Refused, program_version, sha256
from machopt.batch.line import Line
from machopt.batch.messages import JobAsked
from machopt.batch.request import BatchOutcome, BatchRequest, Progress
from machopt.batch.store import LOCK, MAIN, SUMMARY, TIMINGS, Store, is_batch, open_store
from machopt.batch.summary import exit_code_of, result_of, write_summary
from machopt.batch.supervise import Ended, Spec, log_tail, signal_name
from machopt.domain.manifest import Manifest, ManifestFile
from machopt.domain.results.batch import BatchRecord, BatchResult, BatchRow, JobFailure, JobTiming
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.formats.reading import reading_as_user
from machopt.output import read_result
from machopt.services.manifest import versions

STOPPED = 130
FAILED = ("crashed", "over time", "over memory")
"""States that are worth another try; the rest are answers."""
_MIB = 2**20


def run_batch(request: BatchRequest, progress: Callable[[Progress], None] = lambda _: None) -> BatchOutcome:
    """Do all jobs that are not finished yet and write the summary of all of them.

    Ctrl-C ends the jobs at work, keeps the finished ones, writes the summary of those and returns exit code 130.

    Args:
        request: what to do.
        progress: called at the start and after every job.

    Raises:
        InputError: the list, a file it names, the output folder, the scheduler or the folder to compare with is wrong,
            or no job at all could start; nothing was started then.
    """
    _check(request)
    refuse_without_pyarrow(str(request.extra.get("tables", "csv")))
    found = find_jobs(request)
    keys = Keys(request, request.version or program_version())
    plans = [keys.of(job) for job in found.jobs]
    if all(isinstance(plan, Refused) for plan in plans):
        raise InputError(f"none of {len(plans)} jobs can start; the first: {_first_reason(plans)}")
    other = None if request.compare is None else _other(request.compare)
    batch = f"machopt-{uuid.uuid4().hex[:12]}"
    with _taken_back(request.out), open_store(request.out, batch, force=request.overwrite) as store:
        _put_away(store, plans, request)
        todo, clock = _todo(store, plans, request), _Clock(len(plans), plans)
        lines = _lines(store, plans, again={plan.job.label for plan in todo})
        store.begin(result_of(found, lines, keys.version, complete=False))
        clock.kept = len(plans) - len(todo)
        clock.trouble = sum(line.exit_code not in (0, None) for line in lines)
        progress(clock.now())
        stopped = False
        try:
            with contextlib.closing(_ends(request, store, todo, clock)) as ends:
                for label, ended, ready in ends:
                    record = _record(ready, ended, request)
                    store.commit(label, Path(ended.folder) if ended.folder else None, record, _timing(ended))
                    clock.finished(label, record)
                    progress(clock.now())
        except KeyboardInterrupt:
            stopped = True
        lines = _lines(store, plans)
        compared = None if other is None else _compared(store, lines, other)
        result = result_of(
            found, lines, keys.version, complete=not stopped, others=store.others(_labels(plans)), compared=compared
        )
        write_summary(store, lines, result, compared)
        if request.extra.get("tables") == "parquet":
            store.copy(
                name for name in (*SUMMARY, *TIMINGS) if name.endswith(".csv") and (store.folder / name).is_file()
            )
        code = STOPPED if stopped else exit_code_of(lines)
        store.write_manifest(_manifest(request, plans, "stopped" if stopped else "complete", code))
    return BatchOutcome(code, result, request.out / "summary.html", clock.done, clock.kept)


@contextlib.contextmanager
def _taken_back(out: Path) -> Generator[None]:
    """Leave no new folder behind where nothing could be started in it; one with a job in it stays."""
    new = not out.exists()
    try:
        yield
    except InputError:
        jobs = out / "jobs"
        if new and not (jobs.is_dir() and any(jobs.iterdir())):
            with contextlib.suppress(OSError):  # somebody else's file there stays, and the folder with it
                for name in (MAIN, LOCK):
                    (out / name).unlink(missing_ok=True)
                jobs.rmdir()
                out.rmdir()
        raise


def _check(request: BatchRequest) -> None:
    check_installed()
    for value, name in (
        (request.time_limit, "--time-limit-s"),
        (request.memory_limit, "--memory-limit-mib"),
        (request.workers, "--jobs"),
    ):
        if value is not None and not value > 0:
            raise InputError(f"found {value:g}; more than zero would work", where=name)
    if request.plan_file is not None and not request.plan_file.is_file():
        raise InputError("no such file", file=request.plan_file, where="--plan")
    with in_use(with_effects(request.effects)):  # what no job could use is said once, before the first
        pass


def _manifest(request: BatchRequest, plans: Sequence[Ready | Refused], verdict: str, code: int) -> Manifest:
    """What the batch was made from: every file of every job, by the hash that its key was made of."""
    read = {name: sha for plan in plans if isinstance(plan, Ready) for name, sha in plan.inputs.items()}
    inputs = tuple(ManifestFile(name, "input", sha, _size(Path(name))) for name, sha in sorted(read.items()))
    return Manifest(
        command="batch",
        verdict=verdict,
        exit_code=code,
        versions=versions(),
        inputs=inputs,
        options={"overrides": list(request.overrides), "posts": list(map(str, request.posts))},
        reading=reading_as_user(request.reading),
    )


def _size(file: Path) -> int:
    """Bytes of a file as it is now; 0 where it has gone since its hash was taken."""
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _first_reason(plans: Sequence[Ready | Refused]) -> str:
    return next(plan.reason for plan in plans if isinstance(plan, Refused))


def _labels(plans: Sequence[Ready | Refused]) -> set[str]:
    return {plan.job.label for plan in plans}


def _todo(store: Store, plans: Sequence[Ready | Refused], request: BatchRequest) -> list[Ready]:
    """The jobs that are not finished, in order."""
    ready = [plan for plan in plans if isinstance(plan, Ready)]
    store.take_over(_labels(plans), {plan.job.label: plan.key for plan in ready})
    out = []
    for plan in ready:
        record = store.finished(plan.job.label, plan.key)
        if record is None or (record.state in FAILED and not request.keep_failed):
            out.append(plan)
    return out


def _put_away(store: Store, plans: Sequence[Ready | Refused], request: BatchRequest) -> None:
    """Keep the jobs that had ended when an earlier run was killed."""
    by_label = {plan.job.label: plan for plan in plans if isinstance(plan, Ready)}
    for label, key, ended in store.left_behind():
        plan = by_label.get(label)
        if plan is not None and plan.key == key and store.finished(label, key) is None:
            store.commit(label, Path(ended.folder), _record(plan, ended, request), _timing(ended))


def _ends(
    request: BatchRequest, store: Store, todo: Sequence[Ready], clock: _Clock
) -> Generator[tuple[str, Ended, Ready], None, None]:
    """Every job with its end, as they finish; workers are there only for as long as there is something to do."""
    if not todo:
        return
    workers = min(request.workers or len(_cores()), len(todo))
    memory = request.memory_limit
    if memory is None and request.scheduler is None:
        memory = _share(workers)
    specs = [(plan.job.label, _spec(plan, request, store, memory)) for plan in todo]
    by_label = {plan.job.label: plan for plan in todo}
    with Engine(store.work.name, scheduler=request.scheduler, workers=workers, version=request.version) as engine:
        engine.check_workers(store.work)
        clock.start()
        with contextlib.closing(engine.run(specs)) as ends:
            for label, ended in ends:
                yield label, ended, by_label[label]


def _spec(plan: Ready, request: BatchRequest, store: Store, memory: int | None) -> Spec:
    job = plan.job
    asked = JobAsked(
        cell=str(job.cell),
        toolpath=str(job.toolpath),
        plan_file=None if request.plan_file is None else str(request.plan_file.resolve()),
        overrides=request.overrides,
        direct=job.options,
        reading=job.reading,
        allow_external=request.allow_external,
        posts=tuple(map(str, job.posts)),
        effects=tuple(str(f.resolve()) for f in request.effects),
        **request.extra,
    )
    return Spec(
        label=job.label,
        key=plan.key,
        batch=store.work.name,
        work=str(store.work),
        entry=request.entry,
        job={"request": asked.plain()},
        time_limit=job.time_limit or request.time_limit,
        memory_limit=job.memory_limit or memory,
    )


def _record(ready: Ready, ended: Ended, request: BatchRequest) -> BatchRecord:
    """What is kept of a job: nothing in it differs between two runs of the same job."""
    state, row = _state(ready, ended, request)
    return BatchRecord(machopt_batch_job=1, job=ready.job.label, key=ready.key, state=state, row=row)


def _state(ready: Ready, ended: Ended, request: BatchRequest) -> tuple[str, BatchRow]:
    """The word for how it ended, and its row of the summary."""
    if ended.how == "ended" and isinstance(ended.outcome, BatchRow):
        changed = [f for f, sha in ready.inputs.items() if not _still(Path(f), sha)]
        if changed:
            return "crashed", _trouble(1, "inputs changed", f"{changed[0]} was changed while the job ran")
        states = {0: "done", 2: "refused", 3: "infeasible", 4: "verification failed"}
        return states.get(ended.outcome.exit_code, "crashed"), ended.outcome
    if ended.how == "time":
        limit = ready.job.time_limit or request.time_limit
        return "over time", _trouble(3, "over time", f"was not finished after its time limit of {limit:g} s")
    if ended.how == "memory":
        limit_bytes = ready.job.memory_limit or request.memory_limit
        size = "its share of the machine's memory" if limit_bytes is None else f"{limit_bytes / _MIB:.0f} MiB"
        return "over memory", _trouble(3, "over memory", f"needed more memory than {size}")
    return "crashed", _trouble(1, "crashed", _crash(ended))


def _crash(ended: Ended) -> str:
    """Why a process died, in words."""
    if ended.how == "server":
        return f"its process could not be started or was killed from outside{f': {ended.text}' if ended.text else ''}"
    if isinstance(ended.outcome, JobFailure):
        return f"internal error: {ended.outcome.error}: {ended.outcome.text} (log.txt shows where)"
    if ended.code is not None and ended.code < 0:
        name = signal_name(-ended.code)
        more = ", from outside or because the machine had no memory left" if name == "SIGKILL" else ""
        return f"killed by {name}{more} (log.txt has its last words)"
    return f"ended by itself with code {ended.code} and no result: {log_tail(Path(ended.folder))}".removesuffix(": ")


def _trouble(exit_code: int, verdict: str, reason: str) -> BatchRow:
    return BatchRow(exit_code=exit_code, verdict=verdict, reason=reason)


def _still(file: Path, sha: str) -> bool:
    try:
        return sha256(file) == sha
    except OSError:
        return False


def _timing(ended: Ended) -> JobTiming:
    return JobTiming(
        wall_s=round(ended.wall, 3),
        cpu_s=round(ended.cpu, 3),
        peak_MiB=round(ended.peak / _MIB),
        worker=ended.worker,
    )


def _lines(store: Store, plans: Sequence[Ready | Refused], again: Collection[str] = ()) -> list[Line]:
    """All jobs in order, with what is known of them; nothing of those that are done again."""
    out = []
    for plan in plans:
        job = plan.job
        if isinstance(plan, Refused):
            row = _trouble(2, "refused", plan.reason).plain()
            out.append(Line(job=job, key="", cell_name="", state="refused", row=row))
            continue
        record = None if job.label in again else store.finished(job.label, plan.key)
        if record is None:
            out.append(Line(job=job, key=plan.key, cell_name=plan.cell_name, state="waiting", row={}))
        else:
            out.append(
                Line(
                    job=job,
                    key=plan.key,
                    cell_name=plan.cell_name,
                    state=record.state,
                    row=record.row.plain(),
                    files=record.files,
                )
            )
    return out


@dataclass(frozen=True)
class _Other:
    folder: Path
    result: BatchResult


def _other(folder: Path) -> _Other:
    if not (folder.is_dir() and is_batch(folder) and (folder / MAIN).is_file()):
        raise InputError("is no batch's output (no batch.json of ours in it)", file=folder, where="--compare")
    return _Other(folder, read_result(folder / MAIN, BatchResult))


def _compared(store: Store, lines: Sequence[Line], other: _Other) -> Comparison:
    return compare(store.jobs, lines, other.folder, other.result)


class _Clock:
    """Counts jobs and time."""

    def __init__(self, total: int, plans: Sequence[Ready | Refused]) -> None:
        self.total, self.kept, self.done, self.trouble, self.last = total, 0, 0, 0, ""
        self._names = {plan.job.label: _name(plan.job) for plan in plans}
        self._begin = time.monotonic()

    def start(self) -> None:
        self._begin = time.monotonic()

    def finished(self, label: str, record: BatchRecord) -> None:
        self.done += 1
        self.trouble += record.row.exit_code != 0
        self.last = f"{self._names[label]}: {record.row.verdict}"

    def now(self) -> Progress:
        elapsed = time.monotonic() - self._begin if self.done else 0.0
        return Progress(
            total=self.total, kept=self.kept, done=self.done, trouble=self.trouble, elapsed=elapsed, last=self.last
        )


def _name(job: Job) -> str:
    return f"{job.shown} ({job.variant})" if job.variant else job.shown


def _cores() -> Sequence[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)


def _share(workers: int) -> int:
    """Bytes of memory for each of some workers on this machine, a tenth left for the rest."""
    return int(0.9 * machine_memory() / workers)
