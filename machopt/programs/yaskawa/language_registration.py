"""Yaskawa JBI jobs."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="Yaskawa",
        dialect="jbi",
        pattern=r"^\s*/JOB\b",
        reader="reader:read_jbi",
        checks="checks:CHECKS",
        reads_pulses=True,
        feed_step=5.1e-5,  # speeds are printed in tenths of mm/s
        couples_frames=True,
    ),
)
