"""What driver, process server and job tell each other, a JSON line each: models, so that no side guesses at keys."""

from __future__ import annotations

from pydantic import Field

from machopt.data_types.documents.document_base import Count, DocumentModel, Flag, Known, Number, Settings, Text


class JobMessage(DocumentModel):
    """The fields of :class:`machopt.commands.optimize.request.OptimizeRequest`, paths as text, without the folder it
    writes to."""

    cell: Text
    toolpath: Text
    plan_file: Text | None = None
    overrides: tuple[Text, ...] = ()
    direct: Settings | None = None
    reading: Settings = Field(default_factory=dict)
    allow_external: Flag = False
    posts: tuple[Text, ...] = ()
    effects: tuple[Text, ...] = ()
    front: Flag = False
    program_tolerance_mm: Known = None
    tables: Text = "csv"
    map_all: Flag = False
    process: Text | None = None


class ServerReadyMessage(DocumentModel):
    """The server has imported and compiled."""

    ready: Flag


class JobStartedMessage(DocumentModel):
    """A job's process."""

    pid: Count


class JobEndedMessage(DocumentModel):
    """A job's process has ended."""

    status: Count  # as the system reports it
    peak_KiB: Count = 0  # the unit's own letters
    cpu_s: Number = 0.0
