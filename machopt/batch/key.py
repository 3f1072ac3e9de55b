"""The key of a job: a hash of everything its result depends on. Two jobs with one key have one result."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.batch.find import Job
from machopt.batch.request import BatchRequest
from machopt.domain.cell import Cell
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options, options_as_user
from machopt.formats.posts import load_post
from machopt.formats.programs import read_program, recognised
from machopt.version import __version__

NUMERIC = (
    "numpy",
    "scipy",
    "pin",
    "ruckig",
    "trimesh",
    "python-fcl",
    "coal",
    "numba",
    "llvmlite",
    "ruamel.yaml",
    "pydantic",
    "pyarrow",
)
"""Packages whose version may move a number or the reading of a file."""
_MADE = frozenset({".pyc", ".pyo", ".nbi", ".nbc"})  # what Python and numba store beside the sources
_STORED = "__pycache__"  # where they do, and compiled templates


@functools.cache
def program_version() -> str:
    """Version and a hash of the program: every file it ships, Python, and the packages it computes with.

    A changed source, built-in post or page style is another program, same number or not.
    """
    total = hashlib.sha256(f"{sys.version_info[:2]}".encode())
    for name in NUMERIC:
        total.update(f"{name} {_version(name)}\0".encode())
    total.update(shipped(Path(__file__).parents[1]).encode())
    return f"{__version__}+{total.hexdigest()[:12]}"


def shipped(package: Path) -> str:
    """SHA-256 of all files of a package by name and content, but for what Python and numba store beside them."""
    total = hashlib.sha256()
    for file in sorted(p for p in package.rglob("*") if p.suffix not in _MADE and p.is_file()):
        if _STORED in file.relative_to(package).parts:
            continue
        data = file.read_bytes()
        total.update(f"{file.relative_to(package).as_posix()}\0{len(data)}\0".encode() + data)
    return total.hexdigest()


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


@dataclass(frozen=True)
class Ready:
    """A job that can start."""

    job: Job
    key: str
    cell_name: str
    inputs: dict[str, str]  # file → SHA-256, as read when the key was made


@dataclass(frozen=True)
class Refused:
    """A job that cannot start, and why."""

    job: Job
    reason: str


@dataclass
class Keys:
    """Makes keys; every cell and file is read once."""

    request: BatchRequest
    version: str
    _cells: dict[Path, Cell | InputError] = field(default_factory=dict)
    _sha: dict[Path, str] = field(default_factory=dict)
    _called: dict[Path, tuple[Path, ...]] = field(default_factory=dict)

    def of(self, job: Job) -> Ready | Refused:
        """The key of a job, or the reason that the planner would give for refusing its cell, file or options."""
        request = self.request
        try:
            cell = self._cell(job.cell)
            options = load_options(cell.plan, request.plan_file, list(request.overrides), **job.options)
            for post in job.posts:
                load_post(post)  # a faulty template
            key = self._key(job, cell, options_as_user(options))
            others = (request.plan_file, *request.effects, *request.extra.values(), *job.posts)
            more = [f for f in others if isinstance(f, Path) and f.is_file()]
            inputs = {str(f.resolve()): self.sha(f) for f in (*cell.files, *self._read_with(job.toolpath), *more)}
        except InputError as problem:
            return Refused(job, str(problem))
        return Ready(job, key, cell.name, inputs)

    def _key(self, job: Job, cell: Cell, options: dict[str, object]) -> str:
        parts: dict[str, Any] = {
            "version": self.version,
            "entry": self.request.entry,
            "cell": {_name(cell, f): self.sha(f) for f in cell.files},
            # names stand in the program and the report
            "toolpath": [[file.name, self.sha(file)] for file in self._read_with(job.toolpath)],
            "options": options,
            "reading": job.reading,
            "posts": [self._value(p) for p in job.posts],
            "allow_external": self.request.allow_external,
            "effects": [self._value(f) for f in self.request.effects],
            "extra": {k: self._value(v) for k, v in self.request.extra.items()},
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True, ensure_ascii=True, default=str).encode()).hexdigest()

    def _read_with(self, toolpath: Path) -> tuple[Path, ...]:
        """A toolpath, and where it is a robot program the files beside it that it takes its points from."""
        if toolpath not in self._called:
            try:
                files = read_program(toolpath).files[1:] if recognised(toolpath) else ()
            except InputError:
                files = ()  # the job itself says what is wrong
            self._called[toolpath] = (toolpath, *files)
        return self._called[toolpath]

    def _value(self, value: object) -> object:
        """A file counts by its bytes."""
        return [value.name, self.sha(value)] if isinstance(value, Path) and value.is_file() else value

    def _cell(self, path: Path) -> Cell:
        if path not in self._cells:
            try:
                self._cells[path] = load_cell(path, allow_external=self.request.allow_external)
            except InputError as problem:
                self._cells[path] = problem
        found = self._cells[path]
        if isinstance(found, InputError):
            raise found
        return found

    def sha(self, file: Path) -> str:
        if file not in self._sha:
            try:
                self._sha[file] = sha256(file)
            except OSError as problem:
                raise InputError(f"cannot be read: {problem.strerror}", file=file) from None
        return self._sha[file]


def sha256(file: Path) -> str:
    """SHA-256 of a file's bytes."""
    with file.open("rb") as data:
        return hashlib.file_digest(data, "sha256").hexdigest()


def _name(cell: Cell, file: Path) -> str:
    return file.relative_to(cell.folder).as_posix() if file.is_relative_to(cell.folder) else str(file)
