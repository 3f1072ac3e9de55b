"""JSON schemas of the YAML files that machopt reads, generated from the models, for editors.

An editor checks and completes a file that begins with ``# yaml-language-server: $schema=PATH``.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from pydantic import BaseModel

from machopt.cell import cell_schema, kinematics_file
from machopt.cell.process_file import process_schema
from machopt.cell.stiffness import stiffness_file
from machopt.input_files import job_list_keys
from machopt.measurement.recording import cutting_recording_reader, frequency_response_reader
from machopt.measurement.recording import recording_schema as recording_keys
from machopt.options import option_schema

FOLDER = Path(__file__).with_name("schemas")
FILES: dict[str, type[BaseModel]] = {
    "cell.yaml": cell_schema.CellKeys,
    "plan.yaml": option_schema.OptionKeys,
    "stiffness.yaml": stiffness_file._StiffnessFileKeys,
    "kinematics.yaml": kinematics_file._KinematicsFileKeys,
    "process.yaml": process_schema.ProcessKeys,
    "recording.yaml": recording_keys.RecordingKeys,
    "cutting_recording.yaml": cutting_recording_reader.CuttingRecordingKeys,  # recording.yaml of measured cuts
    "frf_recording.yaml": frequency_response_reader.FrequencyResponseKeys,  # recording.yaml of frequency responses
    "jobs.yaml": job_list_keys.JobListKeys,
}
"""What a file is usually called → its model."""


def format_schema_name(file: str) -> str:
    """Return the name of a schema file: ``cell.schema.json`` of ``cell.yaml``.

    Args:
        file: Name of the YAML file, such as ``cell.yaml``.
    """
    return f"{Path(file).stem}.schema.json"


@cache
def render_schema(file: str) -> str:
    """Render the schema of one YAML file.

    Args:
        file: Name of the YAML file, such as ``cell.yaml``.

    Returns:
        Text of the schema file.
    """
    schema = FILES[file].model_json_schema(mode="validation")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": file}
    return json.dumps({**head, **schema, "title": file}, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path = FOLDER) -> None:
    """Write all schema files.

    Args:
        folder: Target folder.
    """
    folder.mkdir(exist_ok=True)
    for file in FILES:
        (folder / format_schema_name(file)).write_text(render_schema(file), encoding="utf-8", newline="\n")
