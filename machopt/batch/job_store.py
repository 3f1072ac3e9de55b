"""Output folder of a batch: jobs that are complete or absent, and their summary.

``jobs/LABEL/`` holds a job's result, its record ``job.json`` and ``timing.json``, and ``log.txt`` if the job failed.
Values that depend on the clock or the machine are only in ``timing.json``, ``timings.csv``, ``timings.js``, the logs,
and ``timings_s`` of each job's result.json and report. All other files have the same bytes whether a batch ran
through or was killed and resumed.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from machopt.batch.job_process import DISK_ERROR_CODES
from machopt.batch.job_supervisor import JobEnd, list_ended_jobs
from machopt.batch.process_server import LOG_FILE
from machopt.data_types.documents.batch_document import (
    BatchDocument,
    BatchJobDocument,
    BatchRowSection,
    JobTimingDocument,
)
from machopt.data_types.manifest import FolderManifest
from machopt.errors import InputError
from machopt.file_formats.parquet_tables import write_parquet_copies
from machopt.output import MANIFEST, read_manifest, read_result, write_manifest, write_result
from machopt.output.file_lock import hold_file_lock
from machopt.output.file_roles import BATCH_ROLES
from machopt.output.folder_swap import exchange_folders, sync_folder, sync_tree
from machopt.output.json_files import read_json
from machopt.output.manifest_file import find_differences
from machopt.output.output_folder import find_edited_files

JOBS, WORK, LOCK = "jobs", ".work", ".lock"
RECORD, TIMING = "job.json", "timing.json"  # both and the log are in BATCH_ROLES
MAIN_FILE = "batch.json"
SUMMARY_FILES = ("summary.csv", "summary.html", "compare.csv", "summary.parquet", "compare.parquet")
TIMING_FILES = ("timings.csv", "timings.js", "timings.parquet")


class JobStore:
    """Output folder of one batch, while this process holds its lock."""

    def __init__(self, folder: Path, batch: str) -> None:
        self.folder, self.jobs, self.work = folder, folder / JOBS, folder / WORK / batch
        self._records: dict[str, BatchJobDocument] = {}

    def find_finished(self, label: str, key: str) -> BatchJobDocument | None:
        """Return the record of a job that is finished with this key, None where it has to be run.

        Args:
            label: Label of the job.
            key: Key of the job.
        """
        record = self._records.get(label)
        if record is not None and record.key == key:
            return record
        return None

    def take_over(self, labels: set[str], wanted: dict[str, str]) -> None:
        """Rename folders of jobs that are no longer in the batch to wanted labels with the same key.

        Args:
            labels: Labels of the jobs of this batch.
            wanted: Label → key of the jobs of this batch.
        """
        free = {r.key: label for label, r in self._records.items() if label not in labels}
        for label, key in wanted.items():
            old = free.get(key)
            record = self._records.get(label)
            if old is None or (record is not None and record.key == key):
                continue
            self._replace_folder(self.jobs / old, label)
            self._records[label] = self._records.pop(old)
            del free[key]

    def list_other_folders(self, labels: set[str]) -> list[str]:
        """Return the folders of finished jobs that are not in this batch.

        Args:
            labels: Labels of the jobs of this batch.
        """
        return sorted(set(self._records) - labels)

    def load_records(self) -> None:
        """Read the records of all finished jobs whose files are still complete and unchanged."""
        for folder in sorted(self.jobs.iterdir()):
            try:
                record = read_result(folder / RECORD, BatchJobDocument)
                if _is_intact(folder, record):
                    self._records[folder.name] = record
            except (OSError, InputError):
                continue  # no record of ours: the job is done again and its folder replaced

    def commit_job(self, label: str, made: Path | None, record: BatchJobDocument, timing: JobTimingDocument) -> None:
        """Put a finished job into the folder by one rename: its result, if it made one, with record and timing.

        Args:
            label: name of the job's folder.
            made: what the worker wrote, ``out/`` and ``log.txt``; None where it got to write nothing.
            record: of the result; the same for the same job.
            timing: what differs from run to run.
        """
        ready = self.work / f"{label}.none" if made is None else made / "out"
        ready.mkdir(exist_ok=True)
        files = tuple(sorted(f.name for f in ready.iterdir() if f.name not in BATCH_ROLES))
        record = record.model_copy(update={"files": files})
        if made is not None and record.state in ("crashed", "over time", "over memory"):
            with contextlib.suppress(FileNotFoundError):
                shutil.copyfile(made / LOG_FILE, ready / LOG_FILE)
        write_result(ready / TIMING, timing)
        write_result(ready / RECORD, record)
        _list_in_manifest(ready)
        sync_tree(ready)
        self._replace_folder(ready, label)
        self._records[label] = record
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)

    def list_interrupted_jobs(self) -> list[tuple[str, str, JobEnd]]:
        """Return label, key and end of jobs that ended in an earlier run but were not stored."""
        ended = [found for work in sorted(self.work.parent.iterdir()) for found in list_ended_jobs(work)]
        return [found for found in ended if not _is_result_moved(found[2])]

    def read_timing(self, label: str) -> JobTimingDocument | None:
        """Return the timing of a finished job; None where there is none.

        Args:
            label: Label of the job.
        """
        try:
            return read_result(self.jobs / label / TIMING, JobTimingDocument)
        except (OSError, InputError):
            return None

    def write_summary_file(self, name: str, text: str) -> None:
        """Replace a file of the summary in one step.

        Args:
            name: Name of the file.
            text: Its content.
        """
        new = self.work / name
        new.write_text(text, encoding="utf-8", newline="\n")
        self._replace_file(new)

    def copy_to_parquet(self, names: Iterable[str]) -> None:
        """Write Parquet copies of tables of the summary, each in one step.

        Args:
            names: Names of the CSV files.
        """
        for name in write_parquet_copies([self.folder / name for name in names], self.work):
            self._replace_file(self.work / name)

    def begin_batch(self, value: BatchDocument) -> None:
        """Write batch.json of an incomplete batch, and remove the summary of an earlier run.

        Args:
            value: The content of batch.json.
        """
        self.write_main(value)
        for name in (*SUMMARY_FILES, *TIMING_FILES, MANIFEST):
            (self.folder / name).unlink(missing_ok=True)

    def write_main(self, value: BatchDocument) -> None:
        """Replace batch.json in one step.

        Args:
            value: The content of batch.json.
        """
        write_result(self.work / MAIN_FILE, value)
        self._replace_file(self.work / MAIN_FILE)

    def write_manifest(self, manifest: FolderManifest) -> None:
        """Replace manifest.json in one step; a job's files are listed in the manifest of the job.

        Args:
            manifest: Manifest of the batch.
        """
        jobs = [f"{JOBS}/{label}/{name}" for label in sorted(self._records) for name in (MANIFEST, RECORD)]
        names = [name for name in (MAIN_FILE, *SUMMARY_FILES, *TIMING_FILES, *jobs) if (self.folder / name).is_file()]
        write_manifest(self.folder, manifest, dict.fromkeys(jobs, "job"), names, into=self.work)
        self._replace_file(self.work / MANIFEST)

    def _replace_file(self, new: Path) -> None:
        """A file of the work folder in the place of the one of its name."""
        sync_tree(self.work)
        new.replace(self.folder / new.name)

    def _replace_folder(self, ready: Path, label: str) -> None:
        """Put a folder in the place of a job's; that is the old one or the new one at any moment."""
        target = self.jobs / label
        if not target.exists():
            ready.rename(target)
        elif exchange_folders(ready, target):
            shutil.rmtree(ready, ignore_errors=True)
        else:  # a file system without such a step: a kill in between means that the job is done again
            former = Path(tempfile.mkdtemp(dir=self.work))
            target.rename(former / label)
            ready.rename(target)
            shutil.rmtree(former, ignore_errors=True)
        sync_folder(self.jobs)


def _is_result_moved(ended: JobEnd) -> bool:
    """The result of a job that is done is not where it was made: it has been put away, whatever became of it then."""
    done = isinstance(ended.outcome, BatchRowSection) and ended.outcome.exit_code == 0
    return done and not (Path(ended.folder) / "out").is_dir()


def _list_in_manifest(folder: Path) -> None:
    """Add the batch's files of a job to the manifest of its result, if there is one."""
    if (folder / MANIFEST).exists():
        manifest, _ = read_manifest(folder)
        write_manifest(folder, manifest, {f.name: f.role for f in manifest.files} | BATCH_ROLES)


def _is_intact(folder: Path, record: BatchJobDocument) -> bool:
    """All files of a finished job are there, and where it has a manifest they are as they were written."""
    if not all((folder / name).exists() for name in record.files):
        return False
    return not (folder / MANIFEST).exists() or not find_differences(folder, read_manifest(folder)[0])


@contextlib.contextmanager
def report_disk_errors(folder: Path) -> Iterator[None]:
    """Convert errors of writing into an input error with a clear message.

    Args:
        folder: The output folder.

    Raises:
        InputError: the disk refuses a file.
    """
    try:
        yield
    except OSError as problem:
        if problem.errno not in DISK_ERROR_CODES:
            raise
        raise InputError(
            f"cannot be written: {problem.strerror}; what is finished is kept, the same command goes on when there is "
            "space and the right to write",
            file=folder,
        ) from problem


@contextlib.contextmanager
def open_store(folder: Path, batch: str, *, force: bool = False) -> Iterator[JobStore]:
    """Lock the output folder and load what is finished; in the end clear away what this and killed runs left.

    Args:
        folder: of the batch.
        batch: name of this run.
        force: replace finished jobs and summaries whose files were edited.

    Raises:
        InputError: the folder is not a batch's, holds files that were edited or added, cannot be written, or another
            batch is at work in it.
    """
    _refuse_foreign(folder)
    store = JobStore(folder.resolve(), batch)
    with contextlib.ExitStack() as lock_stack:
        try:
            store.jobs.mkdir(parents=True, exist_ok=True)
            busy = "another batch is at work in this folder; wait for it, or name another"
            lock_stack.enter_context(hold_file_lock(folder / LOCK, busy, folder, keep=True))
            if not force:
                _refuse_edited(folder)
            store.work.mkdir(parents=True)
            store.load_records()
        except OSError as problem:
            raise InputError(f"cannot be written: {problem.strerror}", file=problem.filename or folder) from None
        lock_stack.callback(shutil.rmtree, folder / WORK, ignore_errors=True)
        lock_stack.enter_context(report_disk_errors(folder))
        yield store


def _refuse_foreign(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; a folder that is new, empty or an earlier batch's would work", file=folder)
    if folder.is_dir() and any(folder.iterdir()) and not is_batch(folder):
        raise InputError(
            f"exists and is no batch's output (no {MAIN_FILE} of ours in it); name a new folder, or empty this one",
            file=folder,
        )


def _refuse_edited(folder: Path) -> None:
    """Refuse to do a job again where its folder, and what somebody changed or added in it, would be lost.

    A job whose files are missing is done again without a question: nothing is lost by that.
    """
    for place in (folder, *sorted(p for p in (folder / JOBS).iterdir() if p.is_dir() and not p.is_symlink())):
        if not (place / MANIFEST).is_file():
            continue
        lost = [name for name in find_edited_files(place) if place != folder or _is_edited_summary(name)]
        if lost:
            raise InputError(
                f"holds {lost[0]}; the job would be done again and the file lost: copy it elsewhere, name another "
                "folder, or give --force",
                file=place,
            )


def _is_edited_summary(text: str) -> bool:
    """A file of the batch itself that was changed; jobs are compared with their own manifests."""
    return text.partition(",")[0] in (*SUMMARY_FILES, *TIMING_FILES)


def is_batch(folder: Path) -> bool:
    """Return whether a folder is a batch's output, begun or finished.

    Args:
        folder: The folder.
    """
    if {f.name for f in folder.iterdir()} <= {JOBS, WORK, LOCK}:
        return True  # killed in its first moments
    try:  # by its head alone: what an earlier version wrote is a batch's folder, too
        return bool(read_json(folder / MAIN_FILE).get("machopt_batch") == 1)
    except InputError:
        return False
