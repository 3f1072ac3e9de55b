"""JSON answers of ``machopt view`` to its page."""

from __future__ import annotations

from machopt.data_types.documents.document_base import DocumentModel, Flag, Number, Text

Row = tuple[Text, Text, Text, Text, Text]


class ViewAnswerDocument(DocumentModel):
    """What came of an action of the page: plan, back, save or verify."""

    told: Text
    good: Flag
    shown: Flag | None = None  # the page is another one now
    saved: Flag | None = None  # the plan file is written
    checks: tuple[Row, ...] | None = None  # of verify: name, passed, found, limit, place


class ViewProgressDocument(DocumentModel):
    """What is being done while the page waits."""

    stage: Text  # empty: nothing
    seconds: Number
