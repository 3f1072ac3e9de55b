"""Tables of moves, CSV and JSON."""

from __future__ import annotations

from machopt.programs.maker_contract import ProgramLanguage

LANGUAGES = (
    ProgramLanguage(
        package=__package__,
        name="program table",
        dialect="csv",
        post_dialect="table",
        pattern=r"^# machopt_program\b|^item,.*\bq1_deg\b",
        reader="reader:read_csv_program",
        uses_urdf_joints=True,
        external_order="cell",
    ),
    ProgramLanguage(
        package=__package__,
        name="program JSON",
        dialect="json",
        post_dialect="table",
        pattern=r'\A\s*\{\s*"machopt_program"',
        reader="reader:read_json_program",
        uses_urdf_joints=True,
        external_order="cell",
    ),
)
