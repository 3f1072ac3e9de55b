"""Universal Robots URScript."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="URScript",
        dialect="urscript",
        pattern=r"^\s*(?:def|thread)\s+\w+\(.*\)\s*:|^\s*(?:movej|movel|movep|servoj)\(",
        reader="reader:read_urscript",
        priority=20,  # KRL has DEF, too
    ),
)
