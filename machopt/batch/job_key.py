"""Key of a job: a hash of everything that its result depends on. Jobs with the same key have the same result."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.batch.job_discovery import BatchJob
from machopt.batch.request import BatchRequest
from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.errors import InputError
from machopt.options.plan_option_reader import format_user_options, load_options
from machopt.programs.program_reader import is_program_file, read_program
from machopt.programs.program_writer import load_post
from machopt.version import __version__

NUMERIC_PACKAGES = (
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
_COMPILED_SUFFIXES = frozenset({".pyc", ".pyo", ".nbi", ".nbc"})  # caches of Python and numba in the source folders
_CACHE_FOLDER = "__pycache__"  # where they do, and compiled templates


@functools.cache
def compute_program_version() -> str:
    """Return version and hash of the program: all its files, Python, and the numerical packages.

    A changed source, built-in post or page style is another program, even with the same version number.
    """
    total = hashlib.sha256(f"{sys.version_info[:2]}".encode())
    for name in NUMERIC_PACKAGES:
        total.update(f"{name} {_get_package_version(name)}\0".encode())
    total.update(compute_package_hash(Path(__file__).parents[1]).encode())
    return f"{__version__}+{total.hexdigest()[:12]}"


def compute_package_hash(package: Path) -> str:
    """Return SHA-256 of all files of a package by name and content, except caches of Python and numba.

    Args:
        package: Folder of the package.
    """
    total = hashlib.sha256()
    for file in sorted(p for p in package.rglob("*") if p.suffix not in _COMPILED_SUFFIXES and p.is_file()):
        if _CACHE_FOLDER in file.relative_to(package).parts:
            continue
        data = file.read_bytes()
        total.update(f"{file.relative_to(package).as_posix()}\0{len(data)}\0".encode() + data)
    return total.hexdigest()


def _get_package_version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


@dataclass(frozen=True)
class ReadyJob:
    """Job that can start."""

    job: BatchJob
    key: str
    cell_name: str
    inputs: dict[str, str]  # file → SHA-256, as read when the key was made


@dataclass(frozen=True)
class RefusedJob:
    """Job that cannot start, with the reason."""

    job: BatchJob
    reason: str


@dataclass
class JobKeyBuilder:
    """Builder of job keys; every cell and file is read once."""

    request: BatchRequest
    version: str
    _cells: dict[Path, Cell | InputError] = field(default_factory=dict)
    _hashes: dict[Path, str] = field(default_factory=dict)
    _cell_names: dict[Path, tuple[Path, ...]] = field(default_factory=dict)

    def build_key(self, job: BatchJob) -> ReadyJob | RefusedJob:
        """Return the key of a job, or the reason to refuse its cell, file or options.

        Args:
            job: The job.
        """
        request = self.request
        try:
            cell = self._read_cell(job.cell)
            options = load_options(cell.plan, request.plan_file, list(request.overrides), **job.options)
            for post in job.posts:
                load_post(post)  # a faulty template
            key = self._build_key(job, cell, format_user_options(options))
            others = (request.plan_file, *request.effects, *request.extra.values(), *job.posts)
            more = [f for f in others if isinstance(f, Path) and f.is_file()]
            inputs = {str(f.resolve()): self.hash_file(f) for f in (*cell.files, *self._read_with(job.toolpath), *more)}
        except InputError as problem:
            return RefusedJob(job, str(problem))
        return ReadyJob(job, key, cell.name, inputs)

    def _build_key(self, job: BatchJob, cell: Cell, options: dict[str, object]) -> str:
        parts: dict[str, Any] = {
            "version": self.version,
            "entry": self.request.entry,
            "cell": {_format_input_name(cell, f): self.hash_file(f) for f in cell.files},
            # names stand in the program and the report
            "toolpath": [[file.name, self.hash_file(file)] for file in self._read_with(job.toolpath)],
            "options": options,
            "reading": job.reading,
            "posts": [self._build_value_key(p) for p in job.posts],
            "allow_external": self.request.allow_external,
            "effects": [self._build_value_key(f) for f in self.request.effects],
            "extra": {k: self._build_value_key(v) for k, v in self.request.extra.items()},
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True, ensure_ascii=True, default=str).encode()).hexdigest()

    def _read_with(self, toolpath: Path) -> tuple[Path, ...]:
        """Return a toolpath and, for a robot program, the files in its folder that hold its points."""
        if toolpath not in self._cell_names:
            try:
                files = read_program(toolpath).files[1:] if is_program_file(toolpath) else ()
            except InputError:
                files = ()  # the job itself says what is wrong
            self._cell_names[toolpath] = (toolpath, *files)
        return self._cell_names[toolpath]

    def _build_value_key(self, value: object) -> object:
        """A file counts by its bytes."""
        return [value.name, self.hash_file(value)] if isinstance(value, Path) and value.is_file() else value

    def _read_cell(self, path: Path) -> Cell:
        if path not in self._cells:
            try:
                self._cells[path] = load_cell(
                    path, allow_external=self.request.allow_external, process=self.request.process
                )
            except InputError as problem:
                self._cells[path] = problem
        found = self._cells[path]
        if isinstance(found, InputError):
            raise found
        return found

    def hash_file(self, file: Path) -> str:
        """Return SHA-256 of a file; each file is read once.

        Args:
            file: Path of the file.

        Raises:
            InputError: the file cannot be read.
        """
        if file not in self._hashes:
            try:
                self._hashes[file] = compute_file_hash(file)
            except OSError as problem:
                raise InputError(f"cannot be read: {problem.strerror}", file=file) from None
        return self._hashes[file]


def compute_file_hash(file: Path) -> str:
    """Return SHA-256 of a file's bytes.

    Args:
        file: Path of the file.
    """
    with file.open("rb") as data:
        return hashlib.file_digest(data, "sha256").hexdigest()


def _format_input_name(cell: Cell, file: Path) -> str:
    return file.relative_to(cell.folder).as_posix() if file.is_relative_to(cell.folder) else str(file)
