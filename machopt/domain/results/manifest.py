"""manifest.json of an output folder."""

from __future__ import annotations

from machopt.domain.results.base import Count, First, Known, Part, Settings, Text


class FileTold(Part):
    """A file by its bytes."""

    role: Text
    sha256: Text  # lower-case hexadecimal
    size: Count  # bytes


class ProgramTold(Part):
    """A robot program of the folder."""

    post: Text  # name of a shipped post, or of the user's template file
    files: tuple[Text, ...]  # the one that is run first, first
    stint: Count = 0  # which tool of the job it drives, from 1; not there: it drives the whole job


class CoveredTold(Part):
    """Something that was checked."""

    what: Text
    how: Text


class TouchingPairDocument(Part):
    """Two bodies that touch by construction: contacts between them are not looked for."""

    a: Text
    b: Text
    reason: Text  # share of random poses in which they touch


class ManifestResult(Part):
    """What a folder says of itself."""

    machopt_manifest: First
    command: Text
    verdict: Text
    exit_code: Count
    versions: dict[Text, Text]
    inputs: dict[Text, FileTold]  # by the name that the user or the cell gives it
    reading: Settings  # how the toolpath was read
    options: Settings  # in force
    programs: tuple[ProgramTold, ...]
    program_tolerance_mm: Known
    checked: tuple[CoveredTold, ...]
    unchecked: tuple[Text, ...]
    not_recomputed: tuple[Text, ...] = ()  # keys of result.json that verify takes as they are
    touching_pairs: tuple[TouchingPairDocument, ...] = ()
    warnings: tuple[Text, ...]
    files: dict[Text, FileTold]  # every file of the folder but this one
    seal: Text = ""  # SHA-256 of all the rest: shows that it was edited, not by whom
