"""manifest.json of an output folder."""

from __future__ import annotations

from machopt.data_types.documents.document_base import Count, DocumentModel, First, Known, Settings, Text


class ManifestFileEntry(DocumentModel):
    """A file by its bytes."""

    role: Text
    sha256: Text  # lower-case hexadecimal
    size: Count  # bytes


class ManifestProgramEntry(DocumentModel):
    """A robot program of the folder."""

    post: Text  # name of a shipped post, or of the user's template file
    files: tuple[Text, ...]  # the one that is run first, first
    stint: Count = 0  # which tool of the job it drives, from 1; not there: it drives the whole job


class CheckCoverageEntry(DocumentModel):
    """Something that was checked."""

    what: Text
    how: Text


class TouchingPairEntry(DocumentModel):
    """Two bodies that touch by construction: contacts between them are not looked for."""

    a: Text
    b: Text
    reason: Text  # share of random poses in which they touch


class ManifestDocument(DocumentModel):
    """What a folder says of itself."""

    machopt_manifest: First
    command: Text
    verdict: Text
    exit_code: Count
    versions: dict[Text, Text]
    inputs: dict[Text, ManifestFileEntry]  # by the name that the user or the cell gives it
    reading: Settings  # how the toolpath was read
    options: Settings  # in force
    programs: tuple[ManifestProgramEntry, ...]
    program_tolerance_mm: Known
    checked: tuple[CheckCoverageEntry, ...]
    unchecked: tuple[Text, ...]
    not_recomputed: tuple[Text, ...] = ()  # keys of result.json that verify takes as they are
    touching_pairs: tuple[TouchingPairEntry, ...] = ()
    warnings: tuple[Text, ...]
    files: dict[Text, ManifestFileEntry]  # every file of the folder but this one
    seal: Text = ""  # SHA-256 of all the rest: shows that it was edited, not by whom
