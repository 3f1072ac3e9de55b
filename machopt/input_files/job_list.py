"""Job lists in YAML, CSV or Parquet → :class:`ListedJob`: cell × toolpath × options, checked before the first job.

YAML: ``cells``, ``toolpaths`` and ``options`` (named variants) are combined, each with each; ``jobs`` are single jobs.
CSV, Parquet: one job per row. The columns are the keys of a job, of its reading options, and planning options by name
(``method``, ``force_N.normal``). Paths are relative to the folder of the list; toolpaths may be patterns (``*.nc``).
``post: krl`` or ``posts: [rapid, mine.toml]`` name the robot programs of a job, or of all jobs that name none.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Any

from machopt.errors import FileFormatError, InputError, suggest_nearest_word
from machopt.file_formats import parquet_tables
from machopt.file_formats.file_reading import YAML, read_file, read_text
from machopt.file_formats.strict_yaml import (
    KeyPath,
    StrictSchema,
    YamlDocument,
    parse_yaml,
    read_yaml,
    validate_document,
)
from machopt.input_files.job_list_keys import (
    BatchJobKeys,
    CommonJobKeys,
    JobListKeys,
    ReadingOptionKeys,
    convert_reading_to_si,
)
from machopt.options.option_schema import ForceKeys, OptionKeys, WeightKeys
from machopt.programs.program_writer import list_post_names
from machopt.programs.writing.post_file import ALIASES

_MIB = 2**20
_PATTERN = set("*?[")


@dataclass(frozen=True, kw_only=True)
class ListedJob:
    """One job as the list names it."""

    cell: Path | None  # None: the cell given with the list
    toolpath: Path
    name: str  # of the job or of the variant of options; empty where it has none
    options: dict[str, object]  # planning options under the user's keys
    reading: dict[str, object]  # keywords of toolpath.toolpath_reader.read_toolpath
    time_limit: float | None  # s
    memory_limit: int | None  # bytes
    file: Path
    where: str  # place in the list, for messages
    posts: tuple[str | Path, ...] = ()  # names, or template files


def read_joblist(path: Path) -> tuple[ListedJob, ...]:
    """Read a list of jobs.

    Args:
        path: a ``.csv`` or ``.parquet`` file, or YAML.

    Raises:
        InputError: the list is damaged, a key or column is unknown, a value is wrong, a file it names is missing or
            it names no job; says file, line, key (or column), what was found and what was expected.
    """
    kinds = {".csv": _read_csv_jobs, ".parquet": _read_parquet_jobs}
    jobs = tuple(kinds.get(path.suffix.lower(), _read_yaml_jobs)(path))
    if not jobs:
        raise FileFormatError("names no job; cells and toolpaths, or jobs, would work", file=path)
    return jobs


def is_job_table(path: Path) -> bool:
    """Return whether a table has a column ``toolpath``: it is then a list of jobs and no table of points.

    Args:
        path: Path of the file.
    """
    if not isfile(path):  # a pipe would wait
        return False
    if path.suffix.lower() == ".parquet":
        try:
            return "toolpath" in _read_parquet_table(path).column_names
        except InputError:
            return False  # the point reader gives the reason
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as lines:
            header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    except OSError:
        return False
    return "toolpath" in [name.strip() for name in header.split(",")]


def resolve_post(text: str, folder: Path) -> str | Path:
    """A post's name as it is, a template file by its full path.

    Args:
        text: what the user wrote.
        folder: what a file's path is relative to.

    Raises:
        InputError: there is neither.
    """
    known = (*list_post_names(), *ALIASES)
    file = folder / Path(text).expanduser()
    if text in known:
        return text
    if not file.is_file():
        raise InputError(
            f"no such post or template file: {text} (searched for {file}); {suggest_nearest_word(text, list(known))}"
        )
    return file.resolve()


def _read_yaml_jobs(path: Path) -> Iterator[ListedJob]:
    document = read_yaml(path)
    keys = validate_document(JobListKeys, document)
    if keys.cells and not keys.toolpaths:
        raise document.build_error(("cells",), "cells are combined with toolpaths, and there is no key toolpaths")
    cells: list[Path | None] = [_resolve_cell(document, ("cells", n), name) for n, name in enumerate(keys.cells)]
    files = [f for n, name in enumerate(keys.toolpaths) for f in _find_toolpaths(document, ("toolpaths", n), name)]
    variants = {name: o.given() for name, o in keys.options.items()} or {"": {}}
    posts = _resolve_posts(document, (), keys)
    for c, cell in enumerate(cells or [None]):
        for file in files:
            for name, options in variants.items():
                where = document.locate_key(("cells", c) if cell is not None else ("toolpaths",))
                entry = _ListEntry(cell=cell, toolpath=file, name=name, options=options, posts=posts, where=where)
                yield _build_job(path, keys, BatchJobKeys(toolpath=str(file)), entry)
    for n, job in enumerate(keys.jobs):
        yield from _list_explicit_jobs(document, ("jobs", n), keys, job, posts, path)


def _read_csv_jobs(path: Path) -> Iterator[ListedJob]:
    text = read_text(path, expected="a list of jobs", most=YAML)
    reader = csv.reader(io.StringIO(text), skipinitialspace=True)
    header: list[str] | None = None
    try:
        for row in reader:
            if not any(cell.strip() for cell in row) or row[0].startswith("#"):
                continue
            if header is None:
                header = _parse_header(path, reader.line_num, [name.strip() for name in row])
            else:
                document = _parse_row(path, reader.line_num, header, row)
                job = validate_document(BatchJobKeys, document)
                yield from _list_explicit_jobs(document, (), JobListKeys(machopt_batch=1), job, (), path)
    except csv.Error as problem:
        raise FileFormatError(f"is not CSV: {problem}", file=path, where=f"line {reader.line_num}") from None


def _read_parquet_jobs(path: Path) -> Iterator[ListedJob]:
    table = _read_parquet_table(path)
    header = _parse_header(path, 0, list(table.column_names))
    for n, row in enumerate(zip(*(table.column(name).to_pylist() for name in header), strict=True), 1):
        job = validate_document(
            BatchJobKeys, document := _parse_row(path, n, header, [_format_cell_word(v) for v in row])
        )
        yield from _list_explicit_jobs(document, (), JobListKeys(machopt_batch=1), job, (), path)


def _read_parquet_table(path: Path) -> Any:
    """An Arrow table.

    Raises:
        InputError: pyarrow is not installed, or the file is damaged.
    """
    data = read_file(path, expected="a list of jobs", most=YAML)
    with parquet_tables.open_parquet(path) as pyarrow:
        return pyarrow.parquet.read_table(pyarrow.BufferReader(data))


def _format_cell_word(value: object) -> str:
    """A value as a CSV file has it; JSON is YAML too."""
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)


def _list_columns() -> dict[str, KeyPath]:
    """Column → key path inside a job."""
    out: dict[str, KeyPath] = {
        name: (name,) for name in BatchJobKeys.model_fields if name not in ("options", "reading")
    }
    out |= {name: ("reading", name) for name in ReadingOptionKeys.model_fields}
    inner: dict[str, type[StrictSchema]] = {"force_N": ForceKeys, "weights": WeightKeys}
    for name in OptionKeys.model_fields:
        if name in inner:
            out |= {f"{name}.{part}": ("options", name, part) for part in inner[name].model_fields}
        elif name != "machopt_plan":
            out[name] = ("options", name)
    return out


def _parse_header(path: Path, line: int, header: list[str]) -> list[str]:
    columns = _list_columns()
    for name in header:
        if name not in columns:
            where = f"line {line}, column {name!r}"
            raise FileFormatError(
                f"unknown column; {suggest_nearest_word(name, list(columns))}", file=path, where=where
            )
        if header.count(name) > 1:
            raise FileFormatError("column is given twice; keep one", file=path, where=f"line {line}, column {name!r}")
    if "toolpath" not in header:
        raise FileFormatError("column toolpath is missing; a list of jobs needs it", file=path, where=f"line {line}")
    return header


def _parse_row(path: Path, line: int, header: list[str], row: list[str]) -> YamlDocument:
    if len(row) != len(header):
        raise FileFormatError(
            f"found {len(row)} fields; expected {len(header)} as in the header", file=path, where=f"line {line}"
        )
    columns, value, lines = _list_columns(), dict[str, object](), dict[KeyPath, int]({(): line})
    for name, cell in zip(header, row, strict=True):
        text, loc = cell.strip(), columns[name]
        if not text:
            continue
        plain = loc in (("cell",), ("toolpath",), ("name",), ("post",), ("reading", "machine"))
        inside = value
        for part in loc[:-1]:
            inside = inside.setdefault(str(part), {})  # type: ignore[assignment]
        inside[str(loc[-1])] = text if plain else parse_yaml(text, f"{path}: line {line}, column {name}").value
        lines |= {loc[:n]: line for n in range(1, len(loc) + 1)}
    return YamlDocument(value, lines, path)


def _list_explicit_jobs(
    document: YamlDocument,
    loc: KeyPath,
    keys: JobListKeys,
    job: BatchJobKeys,
    posts: tuple[str | Path, ...],
    path: Path,
) -> Iterator[ListedJob]:
    cell = None if job.cell is None else _resolve_cell(document, (*loc, "cell"), job.cell)
    options = {} if job.options is None else job.options.given()
    posts = _resolve_posts(document, loc, job) or posts
    for file in _find_toolpaths(document, (*loc, "toolpath"), job.toolpath):
        entry = _ListEntry(
            cell=cell,
            toolpath=file,
            name=job.name or "",
            options=options,
            posts=posts,
            where=document.locate_key(loc) or _describe_line(document),
        )
        yield _build_job(path, keys, job, entry)


@dataclass(frozen=True, kw_only=True)
class _ListEntry:
    """One combination of cell, toolpath and options, as in :class:`ListedJob`."""

    cell: Path | None
    toolpath: Path
    name: str
    options: dict[str, object]
    posts: tuple[str | Path, ...]
    where: str


def _build_job(path: Path, keys: JobListKeys, job: BatchJobKeys, entry: _ListEntry) -> ListedJob:
    """A job with the list's own reading and limits under it."""
    time = job.time_limit_s or keys.time_limit_s
    memory = job.memory_limit_MiB or keys.memory_limit_MiB
    return ListedJob(
        cell=entry.cell,
        toolpath=entry.toolpath,
        name=entry.name,
        options=entry.options,
        reading={**convert_reading_to_si(keys.reading), **convert_reading_to_si(job.reading)},
        time_limit=time,
        memory_limit=None if memory is None else int(memory * _MIB),
        file=path,
        where=entry.where,
        posts=entry.posts,
    )


def _resolve_cell(document: YamlDocument, loc: KeyPath, name: str) -> Path:
    path = Path(document.file).parent / Path(name).expanduser()
    if path.is_dir() and not (path / "cell.yaml").is_file():
        raise document.build_error(loc, f"no cell.yaml in the folder {name}")
    if not path.exists():
        raise document.build_error(loc, f"no such cell: {name} (searched for {path})")
    return path


def _resolve_posts(document: YamlDocument, loc: KeyPath, keys: CommonJobKeys) -> tuple[str | Path, ...]:
    """Resolve the posts of one key; files are searched next to the list."""
    if keys.post is not None and keys.posts is not None:
        raise document.build_error((*loc, "posts"), "post and posts are both given; keep one")
    out: list[str | Path] = []
    for n, text in enumerate(keys.posts or ([] if keys.post is None else [keys.post])):
        at: KeyPath = (*loc, "post") if keys.post is not None else (*loc, "posts", n)
        try:
            post = resolve_post(text, Path(document.file).parent)
        except InputError as problem:
            raise document.build_error(at, problem.reason) from None
        if post in out:
            raise document.build_error(at, f"{text} is given twice; keep one")
        out.append(post)
    return tuple(out)


def _find_toolpaths(document: YamlDocument, loc: KeyPath, name: str) -> list[Path]:
    folder, given = Path(document.file).parent, Path(name).expanduser()
    if _PATTERN & set(name) and not (folder / given).exists():
        found = find_matching_files(folder, name)
        if not found:
            raise document.build_error(loc, f"no file matches {name} (searched in {folder})")
        return found
    if not (folder / given).is_file():
        raise document.build_error(loc, f"no such toolpath: {name} (searched for {folder / given})")
    return [folder / given]


def find_matching_files(folder: Path, pattern: str) -> list[Path]:
    """Find the files below a folder that match a pattern.

    Args:
        folder: The folder.
        pattern: Glob pattern, ``**`` for any depth.

    Returns:
        Paths, sorted by name.
    """
    from glob import glob

    found = (folder / name for name in glob(str(Path(pattern).expanduser()), root_dir=folder, recursive=True))
    return sorted(f for f in found if f.is_file())


def _describe_line(document: YamlDocument) -> str:
    return f"line {document.lines[()]}" if () in document.lines else ""
