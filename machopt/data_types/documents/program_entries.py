"""Entries of result.json about robot programs: files, model of the controller, comparison with the motion."""

from __future__ import annotations

from machopt.data_types.documents.document_base import Count, DocumentModel, Flag, Known, Number, Text


class FeedModelSection(DocumentModel):
    """What a stated model of the controller says of the feed."""

    mean_percent: Number
    held_length_percent: Number
    lowest_percent: Number
    lowest_at_move: Count
    cutting_time_s: Number
    rounding_max_mm: Number
    exact_stops: Count


class ReadBackSection(DocumentModel):
    """A program compared with motion and CAM file; null where a post has no such thing."""

    moves: Count
    positions_max_mm: Known
    orientations_max_deg: Known
    joints_max_deg: Known
    feeds_max_mm_min: Known
    path_max_mm: Known
    path_axis_max_deg: Known
    path_turn_max_deg: Known
    configuration_equal: Flag | None
    events_equal: Flag | None


class RobotProgramEntry(DocumentModel):
    """A robot program: where it is and what came back when it was read."""

    post: Text
    files: tuple[Text, ...]
    lines: Count
    tolerance_mm: Number
    moves_added: Count
    withheld: Text | None
    feed_model: FeedModelSection | None
    assumed: tuple[Text, ...]
    not_in_program: tuple[Text, ...]
    checked: ReadBackSection | None
    differences: tuple[Text, ...]
    tool: Text | None  # which it drives, where the job changes tools
