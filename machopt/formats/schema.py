"""The JSON schemas of the YAML files that machopt reads, made from the models; they lie beside this file, for editors.

A file that begins with ``# yaml-language-server: $schema=PATH`` is checked and completed by them while it is written.
"""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import BaseModel

from machopt.formats import cell_schema, joblist, kinematics, option_keys, stiffness
from machopt.formats.recording import keys as recording_keys

FOLDER = Path(__file__).with_name("schemas")
FILES: dict[str, type[BaseModel]] = {
    "cell.yaml": cell_schema.CellKeys,
    "plan.yaml": option_keys.OptionKeys,
    "stiffness.yaml": stiffness._StiffnessFile,
    "kinematics.yaml": kinematics._KinematicsFile,
    "recording.yaml": recording_keys.RecordingFile,
    "jobs.yaml": joblist.ListKeys,
}
"""What a file is usually called → its model."""


def schema_name(file: str) -> str:
    """``cell.schema.json`` of ``cell.yaml``."""
    return f"{Path(file).stem}.schema.json"


def schema_text(file: str) -> str:
    """The schema of one file, as its own file has it."""
    schema = FILES[file].model_json_schema(mode="validation")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": file}
    return json.dumps({**head, **schema, "title": file}, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path = FOLDER) -> None:
    """Write all of them."""
    folder.mkdir(exist_ok=True)
    for file in FILES:
        (folder / schema_name(file)).write_text(schema_text(file), encoding="utf-8", newline="\n")
