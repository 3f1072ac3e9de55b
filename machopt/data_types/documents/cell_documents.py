"""JSON output of ``machopt init --json`` and ``machopt validate --json``."""

from __future__ import annotations

from typing import Literal

from machopt.data_types.documents.document_base import Count, DocumentModel, Text


class InitDocument(DocumentModel):
    """A cell folder that was written."""

    cell: Text  # the folder
    joints: tuple[Text, ...]
    flange_link: Text
    guesses: tuple[Text, ...]  # what the user should put in or look at
    warnings: tuple[Text, ...]


class RemarkEntry(DocumentModel):
    """One thing about a cell."""

    level: Literal["error", "warning"]  # error: there is no plan, or none that could be driven
    where: Text  # key of cell.yaml; empty where none is to blame
    text: Text  # what was found, and what would work


class ValidateDocument(DocumentModel):
    """Everything wrong or odd about a cell, errors first."""

    cell: Text  # as the user named it
    errors: Count
    warnings: Count
    findings: tuple[RemarkEntry, ...]
