"""Stäubli VAL3."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="Staubli VAL3",
        dialect="val3",
        pattern=r"staubli\.com/robotics/VAL3",
        reader="reader:read_val3",
        checks="checks:CHECKS",
        priority=10,  # holds movej( and movel( as URScript does
        parent_levels=1,  # the .pjx lies in the folder of the application
        external_order="ascending",
    ),
)
