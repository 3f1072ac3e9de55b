"""Tables of model selection stages: executed by the engine and printed in the documentation."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from test_diagnose_multiple_effects import model

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.model_selection.search import candidate_checks, search_stages

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_diagnosis_stages", ROOT / "docs" / "make_diagnosis_stages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_stages_page_is_current(pages: ModuleType) -> None:
    assert pages.PAGE.read_text(encoding="utf-8") == pages.page(), "run python docs/make_diagnosis_stages.py"


def test_every_stage_is_described_and_its_thresholds_exist(pages: ModuleType) -> None:
    stages = [stage for _, stage in pages.list_selection_stages()]
    known = {t.key for t in thresholds.list_thresholds()}
    assert len({s.name for s in stages}) == len(stages) > 20
    for stage in stages:
        assert stage.statistic
        assert stage.reference
        assert stage.rejects
        assert set(stage.levels) <= known, stage.name


def test_every_stage_has_its_ablation_figures(pages: ModuleType) -> None:
    figures = json.loads((ROOT / "benchmarks" / "diagnosis_stage_ablation.json").read_text(encoding="utf-8"))
    names = {stage.name for _, stage in pages.list_selection_stages()} - {"few effects"}
    assert set(figures["stages"]) == names
    assert figures["cases"] >= 10


@pytest.mark.parametrize("name", ["gain", "unseen groups", "significance"])
def test_engine_executes_the_table_of_checks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """If one check of the table rejects all candidates, nothing is selected, with and without the search stages."""
    base, laws = model({("transmission_error", "joint:2"): (2.0,)}, 51)
    some = [t for t in laws if t.hypothesis.name == ("transmission_error", "joint:2")]

    def select() -> int:
        return len(search_stages.search_effects(base, some, 2, np.random.default_rng(0), 1.0)[1])

    assert select() == 1
    checks = tuple(
        candidate_checks.CandidateCheck(
            name=c.name,
            statistic=c.statistic,
            levels=c.levels,
            reference=c.reference,
            rejects=c.rejects,
            is_passed=(lambda *_: False) if c.name == name else c.is_passed,
        )
        for c in candidate_checks.CANDIDATE_CHECKS
    )
    monkeypatch.setattr(candidate_checks, "CANDIDATE_CHECKS", checks)
    assert select() == 0
    monkeypatch.setattr(search_stages, "SEARCH_STAGES", ())
    assert select() == 0
