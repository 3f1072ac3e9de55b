"""Manifest of an output folder: its files, inputs and options, what was checked and what was not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ManifestFile:
    """One file by its bytes."""

    name: str  # POSIX path: outputs relative to the folder, inputs as the user or the cell names them
    role: str  # outputs: points, trajectory, program, result, report, …; inputs: cell, urdf, mesh, toolpath, …
    sha256: str  # lower-case hexadecimal
    size: int  # bytes


@dataclass(frozen=True)
class ManifestProgram:
    """One robot program of the folder."""

    post: str  # name of a shipped post, or of the user's template file
    files: tuple[str, ...]  # names in the folder, the one that is run first
    stint: int = 0  # which tool of the job it drives, from 1; 0: it drives the whole job


@dataclass(frozen=True)
class CheckCoverage:
    """Something that was checked, and how finely."""

    what: str
    how: str


@dataclass(frozen=True)
class TouchingPair:
    """Two bodies that touch by construction, so that contacts between them are not looked for."""

    a: str
    b: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class FolderManifest:
    """manifest.json of one output folder."""

    command: str  # optimize, identify, …
    verdict: str  # the words the command ended with
    exit_code: int
    versions: Mapping[str, str]  # program or library → version
    inputs: tuple[ManifestFile, ...]
    files: tuple[ManifestFile, ...] = ()  # every file of the folder but manifest.json
    options: Mapping[str, object] = field(default_factory=dict)  # planning options in force, by the user's keys
    reading: Mapping[str, object] = field(default_factory=dict)  # how the toolpath was read, by the user's keys
    programs: tuple[ManifestProgram, ...] = ()
    program_tolerance_mm: float | None = None
    checked: tuple[CheckCoverage, ...] = ()
    unchecked: tuple[str, ...] = ()  # what was switched off or left out, in the words of the verdict
    not_recomputed: tuple[str, ...] = ()  # keys of result.json that verify takes as they are
    touching_pairs: tuple[TouchingPair, ...] | None = None  # None: of a version that did not list them
    warnings: tuple[str, ...] = ()  # to be settled before a program runs

    def file(self, name: str) -> ManifestFile | None:
        """Return the entry of one file of the folder; None if it is not listed.

        Args:
            name: Name of the file, relative to the folder.
        """
        return next((f for f in self.files if f.name == name), None)

    def inputs_of(self, role: str) -> tuple[ManifestFile, ...]:
        """Return the inputs of one role.

        Args:
            role: Role of the file in the manifest.
        """
        return tuple(f for f in self.inputs if f.role == role)


def add_scope_to_verdict(verdict: str, unchecked: Iterable[str]) -> str:
    """Return a verdict with what it does not cover: ``done, collisions NOT checked``.

    Args:
        verdict: The verdict.
        unchecked: Names of what was not checked.
    """
    return ", ".join([verdict, *unchecked])
