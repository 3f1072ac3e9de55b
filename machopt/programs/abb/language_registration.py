"""ABB RAPID."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

# PROC of Sinumerik: heads of an archive, or types that RAPID does not have
_SINUMERIK = (
    r"^\s*(?:%_N_\w+_[MS]PF|(?:N[0-9]+\s*)?PROC\s+\w+\s*\(\s*(?:VAR\s+)?(?:REAL|INT|BOOL|CHAR|STRING|AXIS|FRAME)\b)"
)

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="ABB RAPID",
        dialect="rapid",
        pattern=rf"(?i)\A(?!(?s:.*?){_SINUMERIK})(?s:.*?)^\s*(?:%%%|MODULE\s+\w+|(?:LOCAL\s+)?PROC\s+\w+\s*\()",
        reader="reader:read_rapid",
        checks="checks:CHECKS",
        couples_frames=True,
        shows_coupling=True,
        external_order="number",
    ),
)
