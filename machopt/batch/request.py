"""Request, progress and result of ``machopt batch``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.data_types.documents.batch_document import BatchDocument

DEFAULT_TIME_LIMIT_S = 3600.0  # s


@dataclass(frozen=True, kw_only=True)
class BatchRequest:
    """The options of ``machopt batch``."""

    jobs: tuple[str, ...]  # folders, patterns, lists (YAML, CSV) or toolpath files
    out: Path
    overwrite: bool = False  # replace finished jobs whose files were edited
    cell: Path | None = None  # for toolpaths that have no cell of their own
    plan_file: Path | None = None
    process: Path | None = None  # a process.yaml in place of that of every cell
    overrides: tuple[str, ...] = ()  # key=value; a job's own options in a list win over these
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of toolpath.toolpath_reader.read_toolpath
    allow_external: bool = False
    workers: int | None = None  # of the local cluster; None: one a core
    scheduler: str | None = None  # address of a running Dask scheduler; None: a local cluster
    time_limit: float = DEFAULT_TIME_LIMIT_S  # s a job may take
    memory_limit: int | None = None  # bytes a job may use; None: an even share of 90 % of a local machine's
    keep_failed: bool = False  # do not try crashed, hung and oversized jobs again
    compare: Path | None = None  # another batch's output folder
    posts: tuple[str, ...] = ()  # robot programs to write, for jobs that name none themselves; none: the cell's own
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which stiffness.yaml may hold
    extra: dict[str, Any] = field(default_factory=dict)  # further fields of OptimizeRequest, the same for all jobs
    entry: str = (
        "machopt.batch.job_process"  # module whose run(job, out) does a job and whose warm(folder) prepares for it
    )
    version: str | None = None  # what of the program goes into the hash of a job; None: its version and sources


@dataclass(frozen=True, kw_only=True)
class BatchProgress:
    """Progress of a batch; reported at the start and after every job."""

    total: int
    reused: int  # finished in an earlier run
    done: int  # finished in this run
    trouble: int  # of all finished: without an answer, or failing verification
    elapsed: float  # s since the first job was started
    last: str  # label and verdict of the job that just finished, empty at the start

    @property
    def rate(self) -> float | None:
        """Jobs a second in this run, None before the first one is finished."""
        return self.done / self.elapsed if self.done and self.elapsed > 0 else None

    @property
    def remaining_time(self) -> float | None:
        """Seconds until all jobs are finished at this rate."""
        todo = self.total - self.reused - self.done
        return 0.0 if todo == 0 else None if self.rate is None else todo / self.rate

    @property
    def status_line(self) -> str:
        """``12/60 jobs, 2 in trouble, 8.4 a minute, 5:43 left; last part7: done``."""
        words = [f"{self.reused + self.done}/{self.total} jobs"]
        words += [f"{self.trouble} in trouble"] if self.trouble else []
        words += [f"{60 * self.rate:.3g} a minute"] if self.rate is not None else []
        words += [f"{format_duration(self.remaining_time)} left"] if self.remaining_time else []
        return ", ".join(words) + (f"; last {self.last}" if self.last else "")


@dataclass(frozen=True)
class BatchResult:
    """What came out; the summary on disk says the same.

    ``exit_code``: 0 all jobs done; 4 the verification of some job failed; 1 some job crashed or hit a bug; 3 some job
    has no answer (infeasible, refused, over its limits), the worst of them in this order; 130 stopped by the user.
    """

    exit_code: int
    result: BatchDocument
    report: Path  # summary.html
    done: int  # jobs run now
    reused: int  # jobs reused from earlier runs


def format_duration(seconds: float) -> str:
    """Return a duration as ``1:02:03`` or ``5:43``.

    Args:
        seconds: Duration, s.
    """
    minutes, s = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{s:02d}" if hours else f"{minutes}:{s:02d}"
