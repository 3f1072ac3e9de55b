"""JSON answers of ``machopt view`` to its page."""

from __future__ import annotations

from machopt.data_types.documents.document_base import Count, DocumentModel, Flag, Known, Number, Text

Row = tuple[Text, Text, Text, Text, Text]


class ViewOutcomeSection(DocumentModel):
    """A hole or milled point at the rotation of a dragged handle; without compensation."""

    point: Count  # toolpath point that carries the outcome
    outcome: Text  # pass, marginal, fail, unknown or unreachable
    error_name: Text  # across, along, axis or normal
    error_mm: Known  # nominal; null where an angle decides
    error_deg: Known
    tolerance_mm: Known
    p_in: Known  # of all tolerances; of the deflection alone where the outcome is unknown
    reason: Text  # why the outcome is unknown


class ViewAnswerDocument(DocumentModel):
    """What came of an action of the page: plan, back, save, verify or outcome."""

    message: Text
    good: Flag
    shown: Flag | None = None  # the page is another one now
    saved: Flag | None = None  # the plan file is written
    outcome: ViewOutcomeSection | None = None  # of outcome; null where the point has no tolerance
    checks: tuple[Row, ...] | None = None  # of verify: name, passed, found, limit, place


class ViewProgressDocument(DocumentModel):
    """What is being done while the page waits."""

    stage: Text  # empty: nothing
    seconds: Number
