"""JSON schemas of the result documents, generated from the models and stored in this folder for other programs."""

from __future__ import annotations

import json
from pathlib import Path

from machopt.data_types.documents.batch_document import BatchDocument, BatchJobDocument, JobTimingDocument
from machopt.data_types.documents.cell_documents import InitDocument, ValidateDocument
from machopt.data_types.documents.coefficients_document import CoefficientsDocument
from machopt.data_types.documents.diagnosis_document import DiagnosisDocument
from machopt.data_types.documents.document_base import DocumentModel
from machopt.data_types.documents.frequency_response_document import FrequencyResponseDocument
from machopt.data_types.documents.identification_document import IdentificationDocument
from machopt.data_types.documents.inspect_documents import (
    InspectedCellDocument,
    InspectedRobotDocument,
    InspectedToolpathDocument,
)
from machopt.data_types.documents.manifest_document import ManifestDocument
from machopt.data_types.documents.map_document import MapDocument
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.documents.place_document import PlaceDocument
from machopt.data_types.documents.pose_plan_document import PosesDocument
from machopt.data_types.documents.table_rows import PointsTableRow, TrajectoryTableRow
from machopt.data_types.documents.verify_document import VerifyDocument
from machopt.data_types.documents.view_document import ViewAnswerDocument, ViewProgressDocument

FOLDER = Path(__file__).with_name("schemas")
DOCUMENTS: dict[str, type[DocumentModel]] = {
    "result.json": OptimizeDocument,
    "trajectory.csv": TrajectoryTableRow,
    "points.csv": PointsTableRow,
    "manifest.json": ManifestDocument,
    "identification.json": IdentificationDocument,
    "diagnosis.json": DiagnosisDocument,
    "coefficients.json": CoefficientsDocument,
    "frequency_response.json": FrequencyResponseDocument,
    "plan.json": PosesDocument,
    "map.json": MapDocument,
    "place.json": PlaceDocument,
    "batch.json": BatchDocument,
    "job.json": BatchJobDocument,
    "timing.json": JobTimingDocument,
    "inspect-toolpath": InspectedToolpathDocument,
    "inspect-cell": InspectedCellDocument,
    "inspect-robot": InspectedRobotDocument,
    "validate": ValidateDocument,
    "init": InitDocument,
    "verify": VerifyDocument,
    "view-answer": ViewAnswerDocument,
    "view-progress": ViewProgressDocument,
}
"""File of an output folder (a table: its row), or command that prints with ``--json`` and writes none → its model."""


def format_schema_name(document: str) -> str:
    """Return the schema's file name: ``result.schema.json`` of ``result.json``.

    Args:
        document: File name of the document, such as ``result.json``.
    """
    return f"{Path(document).stem}.schema.json"


def render_schema(document: str) -> str:
    """Return the schema of one document as JSON text.

    Args:
        document: File name of the document, such as ``result.json``.
    """
    schema = DOCUMENTS[document].model_json_schema(by_alias=True, mode="serialization")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": document}
    return json.dumps({**head, **schema, "title": document}, indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path = FOLDER) -> None:
    """Write all schemas.

    Args:
        folder: Folder of the schemas.
    """
    folder.mkdir(exist_ok=True)
    for document in DOCUMENTS:
        (folder / format_schema_name(document)).write_text(render_schema(document), encoding="utf-8", newline="\n")
