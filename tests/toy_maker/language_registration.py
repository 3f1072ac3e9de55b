"""Toy language."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package="machopt.programs.toy_maker",
        name="toy program",
        dialect="toy",
        pattern=r"\ATOYROBOT$",
        reader="reader:read_toy",
        checks="checks:CHECKS",
    ),
)
