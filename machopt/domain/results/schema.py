"""The JSON schemas of the result documents, made from the models; they lie beside this file, for other programs."""

from __future__ import annotations

import json
from pathlib import Path

from machopt.domain.results.base import Part
from machopt.domain.results.batch import BatchRecord, BatchResult, JobTiming
from machopt.domain.results.cells import InitResult, ValidateResult
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.domain.results.identification import IdentificationResult
from machopt.domain.results.inspected import CellInspected, RobotInspected, ToolpathInspected
from machopt.domain.results.manifest import ManifestResult
from machopt.domain.results.maps import MapResult
from machopt.domain.results.optimize import OptimizeResult
from machopt.domain.results.place import PlaceResult
from machopt.domain.results.poses import PosesResult
from machopt.domain.results.tables import PointRow, TrajectoryRow
from machopt.domain.results.verified import VerifyResult
from machopt.domain.results.view import ViewAnswer, ViewProgress

FOLDER = Path(__file__).with_name("schemas")
DOCUMENTS: dict[str, type[Part]] = {
    "result.json": OptimizeResult,
    "trajectory.csv": TrajectoryRow,
    "points.csv": PointRow,
    "manifest.json": ManifestResult,
    "identification.json": IdentificationResult,
    "diagnosis.json": DiagnosisResult,
    "plan.json": PosesResult,
    "map.json": MapResult,
    "place.json": PlaceResult,
    "batch.json": BatchResult,
    "job.json": BatchRecord,
    "timing.json": JobTiming,
    "inspect-toolpath": ToolpathInspected,
    "inspect-cell": CellInspected,
    "inspect-robot": RobotInspected,
    "validate": ValidateResult,
    "init": InitResult,
    "verify": VerifyResult,
    "view-answer": ViewAnswer,
    "view-progress": ViewProgress,
}
"""File of an output folder (a table: its row), or command that prints with ``--json`` and writes none → its model."""


def schema_name(document: str) -> str:
    """``result.schema.json`` of ``result.json``."""
    return f"{Path(document).stem}.schema.json"


def schema_text(document: str) -> str:
    """The schema of one document, as its file has it."""
    schema = DOCUMENTS[document].model_json_schema(by_alias=True, mode="serialization")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": document}
    return json.dumps({**head, **schema, "title": document}, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path = FOLDER) -> None:
    """Write all of them."""
    folder.mkdir(exist_ok=True)
    for document in DOCUMENTS:
        (folder / schema_name(document)).write_text(schema_text(document), encoding="utf-8", newline="\n")
