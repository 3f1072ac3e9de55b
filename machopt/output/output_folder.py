"""Output folders that are complete or absent: written into a temporary folder, flushed, and swapped at the end.

The folder of ``OUT`` may hold these hidden entries, each with a hash of its name:

- ``.OUT.<hash>.lock``: lock of the running process; the system drops it when the process ends;
- ``.OUT.<hash>.partial-<random>``: output in progress, or the rest of a killed run; the next run removes it;
- ``.OUT.<hash>.old-<random>``: the former OUT during the swap, only where the file system cannot exchange two folders
  in one step; if a run is killed in that moment, the next one restores it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from machopt.errors import InputError, OutputFolderError
from machopt.output.file_lock import hold_file_lock
from machopt.output.file_roles import BATCH_ROLES, ROLES
from machopt.output.folder_swap import exchange_folders, sync_folder, sync_tree
from machopt.output.interrupt_signals import InterruptSignals
from machopt.output.json_files import read_json
from machopt.output.manifest_file import ADDED, MANIFEST, MISSING, find_differences, list_folder_files, read_manifest

RESULT_FILES = (
    "result.json",
    "identification.json",
    "diagnosis.json",
    "plan.json",
    "map.json",
    "place.json",
    "batch.json",
)
"""A folder is ours, and may be replaced, if one of these is a JSON object with a key machopt…"""
_SHOWN = 40  # letters of the name in those of its siblings, which may be no longer than 255 bytes


@contextlib.contextmanager
def write_output_folder(path: Path | str, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """Yield a temporary sibling of ``path``; put it in the place of ``path`` on success, remove it on any failure.

    An existing ``path`` is replaced only if it is an empty folder or an earlier machopt output in which nobody else
    has put or changed anything and which holds no input. ``force`` replaces every earlier machopt output; a folder
    that is none is never replaced. Only one run at a time writes one ``path``. Ctrl-C and SIGTERM inside the block
    remove the temporary folder; while the swap runs they wait until it is done. SIGKILL may leave hidden siblings,
    which the next run recovers or removes, never a half-written ``path``.

    Args:
        path: the output folder.
        force: replace files of an earlier output that were edited or added.
        inputs: files and folders that this run reads.

    Raises:
        InputError: ``path`` is a file, a folder that is not ours, the working directory or in use by another run; or
            the disk does not take what is written.
    """
    named, read = Path(path), () if force else tuple(inputs)
    target = _resolve_path(named)
    place = _OutputPlace(target)
    with contextlib.ExitStack() as lock_stack:
        try:
            _refuse_foreign_folder(target, named, force=force, inputs=read)
            lock_stack.callback(_remove_empty, _make_parents(target.parent))
            lock_stack.enter_context(
                hold_file_lock(
                    place.lock, "another run is writing this folder; wait for it, or give another folder", named
                )
            )
            place.recover()
            _refuse_foreign_folder(target, named, force=force, inputs=read)
            partial = place.new("partial")
        except OSError as problem:
            raise _build_write_error(problem, named) from None
        signals = lock_stack.enter_context(InterruptSignals())
        try:
            try:
                yield partial
            except OSError as problem:
                if _is_write_error(problem, partial):
                    raise _build_write_error(problem, named) from problem
                raise
            except Exception:
                signals.raise_pending_signal()  # compiled code turns the exception of a signal into one of its own
                raise
            try:
                sync_tree(partial)
                signals.defer_signals()
                _refuse_foreign_folder(target, named, force=force, inputs=read)  # it may have appeared meanwhile
                place.swap(partial)
            except OSError as problem:
                raise _build_write_error(problem, named) from problem
        finally:
            signals.defer_signals()
            shutil.rmtree(partial, ignore_errors=True)


def is_machopt_output(folder: Path) -> bool:
    """Return whether a folder has a result file of machopt.

    Args:
        folder: The folder.
    """
    return any(_has_result_key(folder / name) for name in (*RESULT_FILES, MANIFEST))


class _OutputPlace:
    """Location of an output folder, and its hidden siblings."""

    def __init__(self, target: Path) -> None:
        digits = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
        shown = target.name.encode()[:_SHOWN].decode(errors="ignore")
        self.target = target
        self._stem = f".{shown}.{digits}"
        self.lock = target.parent / f"{self._stem}.lock"

    def new(self, kind: str) -> Path:
        """Create a sibling folder of the target with an unpredictable name.

        Args:
            kind: Word in the name: partial or old.
        """
        sibling = self._free(kind)
        sibling.mkdir()
        return sibling

    def recover(self) -> None:
        """Put back a folder that was caught in the swap, and remove what killed runs left. Only under the lock."""
        former = self._list_left_folders("old")
        if former and not self.target.exists():
            latest = max(former, key=lambda p: p.stat().st_mtime_ns)
            latest.rename(self.target)
        for left in (*self._list_left_folders("old"), *self._list_left_folders("partial")):
            shutil.rmtree(left, ignore_errors=True)

    def swap(self, partial: Path) -> None:
        """Put a finished folder in the target's place; an existing target is removed, or stays if the swap fails.

        Args:
            partial: The finished folder.
        """
        if not self.target.exists():
            partial.rename(self.target)
        elif not exchange_folders(partial, self.target):
            former = self._free("old")
            self.target.rename(former)
            try:
                partial.rename(self.target)
            except OSError:
                former.rename(self.target)
                raise
            sync_folder(self.target.parent)
            shutil.rmtree(former, ignore_errors=True)
            return
        sync_folder(self.target.parent)

    def _free(self, kind: str) -> Path:
        return self.target.parent / f"{self._stem}.{kind}-{secrets.token_hex(8)}"

    def _list_left_folders(self, kind: str) -> list[Path]:
        """Folders of the user's own that such a run may have left."""
        found = [p for p in self.target.parent.iterdir() if p.name.startswith(f"{self._stem}.{kind}-")]
        return [p for p in found if not p.is_symlink() and p.is_dir() and _is_own_file(p)]


def _is_own_file(path: Path) -> bool:
    """Check the owner: in a shared folder, another user may have created an entry with our name."""
    return not hasattr(os, "getuid") or path.stat().st_uid == os.getuid()


def _resolve_path(named: Path) -> Path:
    try:
        target = named.expanduser().resolve()
    except (OSError, RuntimeError) as problem:
        why = getattr(problem, "strerror", None) or "the links go round in a circle"
        raise OutputFolderError(f"cannot be used as output folder: {why}", file=named) from None
    if not target.name:
        raise OutputFolderError("is the root of the file system; name a folder inside it", file=named)
    return target


def _has_result_key(file: Path) -> bool:
    try:
        value = read_json(file)
    except InputError:
        return False
    return any(str(key).startswith("machopt") for key in value)


def _refuse_foreign_folder(target: Path, named: Path, *, force: bool, inputs: tuple[Path, ...]) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise OutputFolderError("is a file; a folder that is new, empty or an earlier output would work", file=named)
    here = Path.cwd()
    if target == here or target in here.parents:
        raise OutputFolderError("is the working directory or above it; name a folder inside it", file=named)
    if _is_mount(target):
        raise OutputFolderError(
            "is a mount point, which cannot be replaced as a whole; name a folder inside it", file=named
        )
    if not any(target.iterdir()):
        return
    if not is_machopt_output(target):
        raise OutputFolderError(
            f"exists and is not an earlier machopt output (none of {', '.join(RESULT_FILES)} of ours in it); "
            "name a new folder, or empty this one",
            file=named,
        )
    inside = next((p for p in inputs if p.resolve().is_relative_to(target)), None)
    if inside is not None:
        raise OutputFolderError(
            f"holds {inside}, an input of this command; name a new folder, or give --force", file=named
        )
    lost = () if force else find_edited_files(target)
    if lost:
        more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        raise OutputFolderError(
            f"holds {lost[0]}{more} and would be replaced as a whole; name a new folder, copy the file elsewhere, or "
            "give --force (force=True in Python)",
            file=named,
        )


def find_edited_files(folder: Path) -> tuple[str, ...]:
    """Return the files of an earlier output that would be lost with it, each with what happened to it.

    These are files that were changed since machopt wrote them, and files that machopt did not write. Without a
    readable manifest, every file counts whose name machopt does not use.

    Args:
        folder: The output folder.
    """
    try:
        manifest, _ = read_manifest(folder)
    except InputError:
        return tuple(
            f"{name}, which is in no manifest"
            for name in sorted(list_folder_files(folder) - {*ROLES, *BATCH_ROLES, MANIFEST})
        )
    lost = [d for d in find_differences(folder, manifest) if d.description != MISSING]
    words = {ADDED: "which machopt did not write"}
    return tuple(f"{d.name}, {words.get(d.description, 'which was changed since machopt wrote it')}" for d in lost)


def _is_mount(target: Path) -> bool:
    if os.path.ismount(target):
        return True
    try:  # a folder of the same file system bound here has the same device number
        lines = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return False
    escaped = str(target).replace("\\", "\\134").replace(" ", "\\040").replace("\t", "\\011").replace("\n", "\\012")
    return any(line.split()[4] == escaped for line in lines)


def _make_parents(folder: Path) -> list[Path]:
    """Make a folder and those above it; returns what was made, the deepest first."""
    missing = [folder, *folder.parents]
    missing = missing[: next(n for n, p in enumerate(missing) if p.exists())]
    if not missing and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def _is_write_error(problem: OSError, partial: Path) -> bool:
    """An error of writing the output, not of reading something else."""
    if problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO):
        return True
    return problem.filename is not None and partial in Path(str(problem.filename)).parents


def _build_write_error(problem: OSError, named: Path) -> InputError:
    why = problem.strerror or str(problem)
    hint = {
        errno.ENOSPC: "; free some space, or name a folder on another disk",
        errno.EDQUOT: "; free some space, or name a folder on another disk",
        errno.EFBIG: "; the process may not write files of that size (ulimit -f)",
        errno.ENAMETOOLONG: "; a shorter name would work",
        errno.EACCES: "; name a folder in a place you may write to",
        errno.EPERM: "; name a folder in a place you may write to",
        errno.EROFS: "; name a folder in a place you may write to",
        errno.ENOTDIR: "; something above it is a file, no folder",
        errno.EBUSY: "; it is in use by the system, perhaps a mount point: name a folder inside it",
    }.get(problem.errno or 0, "")
    return OutputFolderError(
        f"the output folder cannot be written: {why}{hint}. What was there is unchanged", file=named
    )
