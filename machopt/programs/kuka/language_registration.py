"""KUKA KRL."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="KUKA KRL",
        dialect="krl",
        pattern=r"(?i)^\s*(?:&ACCESS|(?:GLOBAL\s+)?DEF\s+\w+\s*\(|DEFDAT\s+\w+)",
        reader="reader:read_krl",
        checks="checks:CHECKS",
        couples_frames=True,
        shows_coupling=True,
        external_order="number",
    ),
)
