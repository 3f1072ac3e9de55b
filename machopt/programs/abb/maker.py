"""ABB RAPID."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="ABB RAPID",
        dialect="rapid",
        pattern=r"(?i)^\s*(?:%%%|MODULE\s+\w+|(?:LOCAL\s+)?PROC\s+\w+\s*\()",
        reader="reader:read_rapid",
        checks="checks:CHECKS",
        couples_frames=True,
        shows_coupling=True,
        external_order="number",
    ),
)
