"""JSON output of ``machopt verify --json``."""

from __future__ import annotations

from machopt.data_types.documents.document_base import Count, DocumentModel, Flag, Number, Text
from machopt.data_types.documents.verification_entries import CheckEntry, InformationEntry


class VerifyCheckEntry(CheckEntry):
    """A check with the keys by which others ask for it."""

    what: Text = ""  # the promise about ``file``
    because: Text = ""  # another file of the folder, that could not be read for this
    instead: Flag = False  # ``where`` says all: value and limit add nothing


class VerifyDocument(DocumentModel):
    """An output folder compared with cell and toolpath."""

    passed: Flag
    verdict: Text  # with what it does not cover
    samples: Count  # of the motion
    duration_s: Number
    notes: tuple[Text, ...]  # options that were given and that the folder was not made with
    checks: tuple[VerifyCheckEntry, ...]
    information: tuple[InformationEntry, ...] = ()  # no checks: nothing of it can fail
    not_recomputed: tuple[Text, ...] = ()  # claims of result.json that follow from the planner alone, by their keys
