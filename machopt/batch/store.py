"""The output folder of a batch: jobs that are there wholly or not at all, and the summary of them.

``jobs/LABEL/`` holds a job's result, its record ``job.json`` and ``timing.json``; ``log.txt`` is there when it went
wrong. What depends on the clock or the machine stands only in ``timing.json``, ``timings.csv``, ``timings.js`` and the
logs (and in the ``timings_s`` of each job's own result.json and report): all other files are the same bytes whether a
batch ran through or was killed and resumed.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from machopt.batch.nursery import LOG
from machopt.batch.supervise import Ended, attempts
from machopt.errors import InputError
from machopt.output import write_json

JOBS, WORK, LOCK = "jobs", ".work", ".lock"
RECORD, TIMING = "job.json", "timing.json"
MAIN = "batch.json"
SUMMARY = ("summary.csv", "summary.html", "compare.csv")
TIMINGS = ("timings.csv", "timings.js")


class Store:
    """One batch's output folder, while this process holds its lock."""

    def __init__(self, folder: Path, batch: str) -> None:
        self.folder, self.jobs, self.work = folder, folder / JOBS, folder / WORK / batch
        self._records: dict[str, dict[str, Any]] = {}

    def finished(self, label: str, key: str) -> dict[str, Any] | None:
        """The record of a job that is finished with this very key, None where it is to be done.

        A job that was finished under another name (its list or folder was renamed) is taken over.
        """
        record = self._records.get(label)
        if record is not None and record["key"] == key:
            return record
        return None

    def take_over(self, labels: set[str], wanted: dict[str, str]) -> None:
        """Rename folders of jobs that nobody names any more to wanted labels with the same key (label → key)."""
        free = {r["key"]: label for label, r in self._records.items() if label not in labels}
        for label, key in wanted.items():
            old = free.get(key)
            record = self._records.get(label)
            if old is None or (record is not None and record["key"] == key):
                continue
            self._replace(self.jobs / old, label)
            self._records[label] = self._records.pop(old)
            del free[key]

    def others(self, labels: set[str]) -> list[str]:
        """Folders of finished jobs that are not among these."""
        return sorted(set(self._records) - labels)

    def load(self) -> None:
        """Read the records of all finished jobs whose files are still there."""
        for folder in sorted(self.jobs.iterdir()):
            try:
                record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
                if all((folder / name).exists() for name in record["files"]) and isinstance(record["key"], str):
                    self._records[folder.name] = record
            except (OSError, ValueError, KeyError, TypeError):
                continue  # no record of ours: the job is done again and its folder replaced

    def commit(self, label: str, made: Path | None, record: dict[str, Any], timing: dict[str, Any]) -> None:
        """Put a finished job into the folder by one rename: its result, if it made one, with record and timing.

        Args:
            label: name of the job's folder.
            made: what the worker wrote, ``out/`` and ``log.txt``; None where it got to write nothing.
            record: of the result; the same for the same job.
            timing: what differs from run to run.
        """
        ready = self.work / f"{label}.ready"
        ready.mkdir() if made is None or not (made / "out").is_dir() else (made / "out").rename(ready)
        record["files"] = sorted(f.name for f in ready.iterdir())
        if made is not None and record["state"] in ("crashed", "over time", "over memory"):
            with contextlib.suppress(OSError):
                (made / LOG).rename(ready / LOG)
        write_json(ready / TIMING, timing)
        write_json(ready / RECORD, record)
        self._replace(ready, label)
        self._records[label] = json.loads((self.jobs / label / RECORD).read_text(encoding="utf-8"))
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)

    def left_behind(self) -> list[tuple[str, str, Ended]]:
        """Label, key and end of jobs that ended in an earlier run and were not put away before it was killed."""
        return [found for work in sorted(self.work.parent.iterdir()) for found in attempts(work)]

    def timing(self, label: str) -> dict[str, Any]:
        """What a finished job took."""
        try:
            found = json.loads((self.jobs / label / TIMING).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def write(self, name: str, text: str) -> None:
        """Replace a file of the summary in one step."""
        new = self.work / name
        new.write_text(text, encoding="utf-8", newline="\n")
        new.replace(self.folder / name)

    def begin(self, value: dict[str, object]) -> None:
        """Say in batch.json that the batch is not complete, and take away the summary of an earlier run."""
        self.write_main(value)
        for name in (*SUMMARY, *TIMINGS):
            (self.folder / name).unlink(missing_ok=True)

    def write_main(self, value: dict[str, object]) -> None:
        """Replace batch.json in one step."""
        write_json(self.work / MAIN, value)
        (self.work / MAIN).replace(self.folder / MAIN)

    def _replace(self, ready: Path, label: str) -> None:
        target = self.jobs / label
        if target.exists():
            target.rename(self.work / f"{label}.old")
        ready.rename(target)
        shutil.rmtree(self.work / f"{label}.old", ignore_errors=True)


@contextlib.contextmanager
def open_store(folder: Path, batch: str) -> Iterator[Store]:
    """Lock the output folder and load what is finished; in the end clear away what this and killed runs left.

    Raises:
        InputError: the folder is not a batch's, cannot be written, or another batch is at work in it.
    """
    _refuse_foreign(folder)
    store = Store(folder.resolve(), batch)
    with contextlib.ExitStack() as held:
        try:
            store.jobs.mkdir(parents=True, exist_ok=True)
            held.enter_context(_locked(folder))
            store.work.mkdir(parents=True)
            store.load()
        except OSError as problem:
            raise InputError(f"cannot be written: {problem.strerror}", file=problem.filename or folder) from None
        held.callback(shutil.rmtree, folder / WORK, ignore_errors=True)
        yield store


def _refuse_foreign(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; a folder that is new, empty or an earlier batch's would work", file=folder)
    if folder.is_dir() and any(folder.iterdir()) and not is_batch(folder):
        raise InputError(
            f"exists and is no batch's output (no {MAIN} of ours in it); name a new folder, or empty this one",
            file=folder,
        )


def is_batch(folder: Path) -> bool:
    """True if a folder is a batch's output, begun or finished."""
    if {f.name for f in folder.iterdir()} <= {JOBS, WORK, LOCK}:
        return True  # killed in its first moments
    return read_main(folder) is not None


def read_main(folder: Path) -> dict[str, Any] | None:
    """batch.json of a folder, None where there is none."""
    try:
        found = json.loads((folder / MAIN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("machopt_batch") == 1 else None


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock; the system drops it when this process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # Windows: two batches in one folder are the user's to avoid
        yield
        return
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                "another batch is at work in this folder; wait for it, or name another", file=folder
            ) from None
        yield
    finally:
        os.close(handle)
