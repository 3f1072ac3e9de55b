"""Result documents: published schemas equal the models, and invalid documents are reported."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from machopt.data_types.documents.batch_document import BatchComparisonSection, BatchJobDocument, BatchRowSection
from machopt.data_types.documents.diagnosis_document import EstimateSection
from machopt.data_types.documents.document_base import DocumentModel
from machopt.data_types.documents.json_schemas import DOCUMENTS, FOLDER, format_schema_name, render_schema
from machopt.data_types.documents.map_document import MapOptionsSection
from machopt.errors import InputError
from machopt.output import read_result, write_result

ROW = BatchRowSection(exit_code=0, verdict="done", reason="", mean=0.25, warnings=("a",))
RECORD = BatchJobDocument(machopt_batch_job=1, job="a", key="k", state="done", row=ROW, files=("points.csv",))


@pytest.mark.parametrize("document", DOCUMENTS)
def test_published_schema_is_current(document: str) -> None:
    """``python docs/make_reference.py`` rewrites the schemas."""
    assert (FOLDER / format_schema_name(document)).read_text(encoding="utf-8") == render_schema(document)


def test_no_unused_schema() -> None:
    assert {f.name for f in FOLDER.iterdir()} == {format_schema_name(d) for d in DOCUMENTS}


@pytest.mark.parametrize("document", DOCUMENTS)
def test_no_mapping_accepts_unknown_keys(document: str) -> None:
    schema = json.loads(render_schema(document))
    for name, part in {**schema.get("$defs", {}), document: schema}.items():
        assert part["additionalProperties"] is False, name


def test_written_documents_are_read(tmp_path: Path) -> None:
    write_result(tmp_path / "job.json", RECORD)
    assert read_result(tmp_path / "job.json", BatchJobDocument) == RECORD
    assert json.loads((tmp_path / "job.json").read_text())["row"] == {
        "exit_code": 0,
        "verdict": "done",
        "reason": "",
        "mean": 0.25,
        "warnings": ["a"],
    }
    write_result(tmp_path / "again.json", read_result(tmp_path / "job.json", BatchJobDocument))
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "job.json").read_bytes()


def test_numbers_are_valid_json() -> None:
    estimate_section = EstimateSection(
        value=np.float64(2.0), unit="mm", ci95=(np.float64(1.0), float("inf")), ci90=(float("nan"), 3)
    )
    assert estimate_section.to_json_types() == {"value": 2.0, "unit": "mm", "ci95": [1.0, None], "ci90": [None, 3]}
    assert isinstance(estimate_section.ci90[1], int)  # 3 is not written as 3.0


def test_key_that_is_a_python_keyword_keeps_its_name() -> None:
    plain = BatchComparisonSection(compared_with="b", rows=(), only_here=(), only_there=()).to_json_types()
    assert next(iter(plain)) == "with"
    assert BatchComparisonSection.model_validate(plain).compared_with == "b"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v: v.update(approved=True), "approved is no key of this file"),
        (lambda v: v["row"].pop("verdict"), "row.verdict is missing"),
        (lambda v: v["row"].update(mean="0.25"), "row.mean is '0.25'; a valid"),
        (lambda v: v["row"].update(exit_code=True), "row.exit_code is True"),
        (lambda v: v.update(machopt_batch_job=2), "machopt_batch_job is 2; 1 was expected"),
        (lambda v: v.update(row=[1]), "row is [1]; a valid dictionary"),
        (lambda v: v.update(files="points.csv"), "files is 'points.csv'"),
    ],
)
def test_invalid_content_is_named(tmp_path: Path, change: Any, said: str) -> None:
    value = RECORD.to_json_types()
    change(value)
    (tmp_path / "job.json").write_text(json.dumps(value))
    with pytest.raises(InputError, match=re.escape(said)) as problem:
        read_result(tmp_path / "job.json", BatchJobDocument)
    assert "job.json" in str(problem.value)


def test_results_are_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        RECORD.state = "crashed"  # type: ignore[misc]


def test_no_field_hides_a_method_of_pydantic() -> None:
    """A field named ``copy`` or ``json`` would replace a method."""
    for model in DOCUMENTS.values():
        assert not set(model.model_fields) & set(dir(DocumentModel)), model


def test_branch_may_be_picked_by_its_number() -> None:
    """The document of ``map --pick 3`` contains the number as requested."""
    requested = {"at_mm": None, "tool_axis": None, "gamma_deg": None, "rotations": None, "q_deg": None, "by": "k_min"}
    limits = {"limit_margin_deg": 0.0, "singularity_wrist_deg": None, "singularity_elbow_deg": None}
    expected = {**requested, **limits, "singularity_shoulder_mm": None, "collision": "self", "load": None}
    assert MapOptionsSection.model_validate({**expected, "pick": 3}).to_json_types()["pick"] == 3
    assert MapOptionsSection.model_validate({**expected, "pick": "best"}).to_json_types()["pick"] == "best"


def test_document_representation_states_its_verdict() -> None:
    """A cell of a notebook that ends with ``plan.save(…)`` shows one line."""
    shown = type("Shown", (DocumentModel,), {"__annotations__": {"version": str, "verdict": str}})
    assert repr(shown(version="1", verdict="done")) == "<Shown: done>"
    assert repr(ROW).startswith("BatchRowSection(")
