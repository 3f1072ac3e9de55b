"""FANUC TP programs."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="FANUC",
        dialect="fanuc",
        pattern=r"^\s*/PROG\b",
        reader="reader:read_fanuc",
        checks="checks:CHECKS",
        feed_step=5.1e-5,  # speeds are printed in tenths of mm/s
        couples_frames=True,
    ),
)
