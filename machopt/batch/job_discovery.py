"""Jobs of a batch from the user's folders, patterns, lists and single toolpaths."""

from __future__ import annotations

import hashlib
import json
import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from machopt.batch.request import BatchRequest
from machopt.errors import InputError, OptionError
from machopt.input_files.job_list import ListedJob, find_matching_files, is_job_table, read_joblist, resolve_post
from machopt.output import is_machopt_output

LIST_SUFFIXES = (".yaml", ".yml")
IGNORED_SUFFIXES = frozenset(
    {  # files next to toolpaths; files with other names are tried, and refused with a reason
        ".7z",
        ".bak",
        ".bat",
        ".bmp",
        ".catpart",
        ".dae",
        ".doc",
        ".docx",
        ".gif",
        ".gz",
        ".htm",
        ".html",
        ".iges",
        ".igs",
        ".ipynb",
        ".jpeg",
        ".jpg",
        ".json",
        ".log",
        ".md",
        ".obj",
        ".pdf",
        ".ply",
        ".png",
        ".prt",
        ".py",
        ".rar",
        ".rst",
        ".sh",
        ".sldprt",
        ".step",
        ".stl",
        ".stp",
        ".svg",
        ".tgz",
        ".toml",
        ".urdf",
        ".webp",
        ".x_t",
        ".xacro",
        ".xls",
        ".xlsx",
        ".xml",
        ".yaml",
        ".yml",
        ".zip",
    }
)
_SLUG = 40  # letters of each part of a label


@dataclass(frozen=True, kw_only=True)
class BatchJob:
    """One job: its inputs, options and name."""

    label: str  # name of its folder: readable, and unique by its last eight digits
    cell: Path
    toolpath: Path
    toolpath_name: str  # toolpath as the user finds it: below the folder or list that named it
    variant: str  # name of the job or of its options, empty where it has none
    options: dict[str, object]
    reading: dict[str, object]
    time_limit: float | None  # s, of this job alone
    memory_limit: int | None  # bytes
    where: str  # list and place of the job, for messages
    posts: tuple[str | Path, ...] = ()  # robot programs to write: names, or template files


@dataclass(frozen=True)
class DiscoveredJobs:
    """Jobs in the user's order, and the ignored files."""

    jobs: tuple[BatchJob, ...]
    ignored_files: tuple[str, ...] = field(default=())


def find_jobs(request: BatchRequest) -> DiscoveredJobs:
    """Return all jobs of a request.

    Args:
        request: The request of ``machopt batch``.

    Raises:
        InputError: a list is wrong, a file or cell is missing, a job is given twice, or there is none.
    """
    jobs: dict[str, BatchJob] = {}
    left_out: list[str] = []
    for word in request.jobs:
        base, listed = _expand_argument(word, left_out)
        for item in listed:
            job = _build_job(item, base, request)
            if job.label in jobs:
                raise InputError(
                    f"{job.toolpath_name} with the same cell and options is given twice, first in "
                    f"{jobs[job.label].where}; "
                    "keep one, or name them differently (name: …)",
                    file=item.file,
                    where=item.where,
                )
            jobs[job.label] = job
    if not jobs:
        raise InputError(
            "no toolpath found; a folder of CAM files, a pattern in quotes ('parts/*.nc') or a list (YAML, CSV) would "
            f"work{_format_ignored_files(left_out)}",
            file=", ".join(request.jobs),
        )
    return DiscoveredJobs(tuple(jobs.values()), tuple(left_out))


def _expand_argument(word: str, left_out: list[str]) -> tuple[Path, Iterable[ListedJob]]:
    """The folder that names are relative to, and the jobs of one argument."""
    path = Path(word).expanduser()
    if path.is_dir():
        return path, list(_find_in_folder(path, path, None, left_out))
    if path.suffix.lower() in LIST_SUFFIXES or is_job_table(path):
        return path.parent, read_joblist(path)
    if path.is_file():
        return path.parent, [_build_plain_job(path, _find_cell_in_folder(path.parent))]
    if set(word) & set("*?["):
        fixed = Path(*_split_before_pattern(path))
        found = [f for f in find_matching_files(Path(), word) if f.suffix.lower() not in IGNORED_SUFFIXES]
        if not found:
            raise InputError("no toolpath matches this pattern", file=word)
        return fixed, [_build_plain_job(f, _find_cell_in_folder(f.parent)) for f in found]
    raise InputError("no such file or folder; a folder, a pattern in quotes or a list would work", file=word)


def _split_before_pattern(path: Path) -> Iterator[str]:
    for part in path.parts:
        if set(part) & set("*?["):
            return
        yield part


def _find_in_folder(folder: Path, base: Path, cell: Path | None, left_out: list[str]) -> Iterator[ListedJob]:
    """Yield the files of a folder with the cell in it, else the one above; then its subfolders."""
    beside = folder / "cell"
    if (beside / "cell.yaml").is_file():
        cell = beside
    inside = sorted(folder.iterdir())
    for item in inside:
        if item.is_file() and not item.name.startswith("."):
            if item.suffix.lower() in IGNORED_SUFFIXES:
                left_out.append(str(item.relative_to(base)))
            else:
                yield _build_plain_job(item, cell)
    for item in inside:
        ours = item.name.startswith(".") or item == beside or (item / "cell.yaml").is_file() or is_machopt_output(item)
        if item.is_dir() and not item.is_symlink() and not ours:
            yield from _find_in_folder(item, base, cell, left_out)


def _find_cell_in_folder(folder: Path) -> Path | None:
    return folder / "cell" if (folder / "cell" / "cell.yaml").is_file() else None


def _build_plain_job(toolpath: Path, cell: Path | None) -> ListedJob:
    return ListedJob(
        cell=cell,
        toolpath=toolpath,
        name="",
        options={},
        reading={},
        time_limit=None,
        memory_limit=None,
        file=toolpath,
        where="",
    )


def _build_job(item: ListedJob, base: Path, request: BatchRequest) -> BatchJob:
    cell = item.cell or request.cell
    if cell is None:
        raise InputError(
            "has no cell; --cell FOLDER, a folder named cell next to it, or the key cell in a job list, is needed",
            file=item.toolpath if not item.where else item.file,
            where=item.where or None,
        )
    toolpath, cell = item.toolpath.resolve(), cell.expanduser().resolve()
    base = base.resolve()
    place = _format_relative_path(toolpath, base)
    shown = place if not place.startswith("..") else "/".join(toolpath.parts[-2:])
    variant = item.name
    named: list[object] = [base.name, place, _format_relative_path(cell, base), variant, item.options, item.reading]
    if item.posts:
        named.append([_format_relative_path(p, base) if isinstance(p, Path) else p for p in item.posts])
    what = json.dumps(named, sort_keys=True, ensure_ascii=True)
    digits = hashlib.sha256(what.encode()).hexdigest()[:8]
    stem = shown.rpartition(".")[0] or shown
    cell_name = cell.parent.name if cell.suffix.lower() in LIST_SUFFIXES and cell.stem == "cell" else cell.stem
    words = [
        build_slug(stem),
        build_slug(cell_name),
        build_slug(variant or _format_options(item.options), from_start=True),
    ]
    label = "-".join([*(s for s in words if s), digits])
    reading = {**{k: v for k, v in request.reading.items() if v is not None}, **item.reading}
    where = f"{item.file}: {item.where}" if item.where else str(item.file)
    return BatchJob(
        label=label,
        cell=cell,
        toolpath=toolpath,
        toolpath_name=shown,
        variant=variant or _format_options(item.options),
        options=item.options,
        reading=reading,
        time_limit=item.time_limit,
        memory_limit=item.memory_limit,
        where=where,
        posts=item.posts or _list_default_posts(request),
    )


def _list_default_posts(request: BatchRequest) -> tuple[str | Path, ...]:
    """The posts for jobs that name none."""
    try:
        return tuple(resolve_post(text, Path.cwd()) for text in request.posts)
    except InputError as problem:
        raise OptionError(problem.reason, where="--post") from None


def build_slug(text: str, *, from_start: bool = False) -> str:
    """Return letters, digits, dots and underscores of a text, the rest as hyphens; at most forty characters.

    Args:
        text: The text.
        from_start: Keep the first characters instead of the last ones.
    """
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    whole = re.sub(r"[^A-Za-z0-9_.]+", "-", plain).strip("-.")
    return (whole[:_SLUG] if from_start else whole[-_SLUG:]).strip("-.")


def _format_options(options: dict[str, object]) -> str:
    """``method=jiao2022 rotation_step_deg=2``."""
    return " ".join(f"{k}={v if not isinstance(v, dict) else json.dumps(v)}" for k, v in sorted(options.items()))


def _format_relative_path(path: Path, base: Path) -> str:
    import os.path

    try:
        return Path(os.path.relpath(path, base)).as_posix()
    except ValueError:  # another drive
        return path.as_posix()


def _format_ignored_files(left_out: list[str]) -> str:
    if not left_out:
        return ""
    names = ", ".join(left_out[:4]) + (" …" if len(left_out) > 4 else "")
    return f" (left out by their names: {names})"
