"""Table of detection rates by effect: found, missed and misnamed."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import diagnosis_rates_by_effect


def effect(name: str, place: str, value: float) -> dict[str, Any]:
    size = {"value": value, "unit": "arcmin"}
    return {
        "effect": name,
        "location": place,
        "accepted": [[name, place]],
        "size": size,
        "parameters": {"width": size},
        "absorbed": False,
        "noncentrality": 40.0,
    }


def case(
    folder: Path, name: str, group: str, effects: list[dict[str, Any]], found: list[tuple[str, str, float]]
) -> None:
    truth = {"case": name, "key": name, "group": group, "effects": effects, "ambient": [], "outlier_rows": []}
    (folder / f"{name}.truth.json").write_text(json.dumps(truth))
    out = folder / name / "out"
    out.mkdir(parents=True)
    (folder / name / "run.json").write_text(json.dumps({"problem": "", "exit_code": 0}))
    findings = [
        {
            "effect": e,
            "location": where,
            "parameters": {"width": {"value": v, "unit": "arcmin", "ci95": [0.9 * v, 1.1 * v], "ci90": [v, v]}},
        }
        for e, where, v in found
    ]
    output = {"verdict": "explained", "findings": findings, "detection_limits": []}
    (out / "diagnosis.json").write_text(json.dumps(output))


@pytest.fixture
def answered(tmp_path: Path) -> Path:
    play, loop = effect("joint_backlash", "joint:2", 1.0), effect("joint_hysteresis", "joint:3", 2.0)
    case(tmp_path, "a", "single", [play], [("joint_backlash", "joint:2", 1.05)])
    case(tmp_path, "b", "single", [play], [("joint_backlash", "joint:2", 2.0)])
    case(tmp_path, "c", "pair", [play, loop], [("joint_hysteresis", "joint:4", 2.0)])
    case(tmp_path, "d", "null", [], [("joint_creep", "joint:1", 1.0)])
    case(tmp_path, "e", "record", [effect("units", "column:dx_mm", 1.0)], [("outliers", "rows:3,4", 1.0)])
    case(tmp_path, "f", "outside", [], [])
    # not diagnosed
    (tmp_path / "g.truth.json").write_text((tmp_path / "f.truth.json").read_text().replace('"f"', '"g"'))
    return tmp_path


def test_each_effect_is_counted_where_expected_named_and_sized(answered: Path) -> None:
    c = diagnosis_rates_by_effect.count(diagnosis_rates_by_effect.evaluate_answers.read(answered))
    assert c.cases == 6
    assert (c.due["joint_backlash"], c.found["joint_backlash"]) == (3, 2)
    assert (c.named["joint_backlash"], c.wrong["joint_backlash"]) == (2, 0)
    assert (c.sized["joint_backlash"], c.held["joint_backlash"]) == (2, 1)
    assert (c.due["joint_hysteresis"], c.found["joint_hysteresis"]) == (1, 0)
    assert c.wrong["joint_hysteresis"] == 1
    assert (c.due["*nothing concealed*"], c.wrong["*nothing concealed*"]) == (1, 1)
    assert (c.due["*faults of the record*"], c.wrong["*faults of the record*"]) == (1, 0)
    assert (c.due["*physics outside the catalogue*"], c.wrong["*physics outside the catalogue*"]) == (1, 0)


def test_table_has_a_row_per_effect_with_wrong_names(answered: Path, capsys: pytest.CaptureFixture) -> None:
    table = answered / "table.md"
    assert diagnosis_rates_by_effect.main([f"ours={answered}", "--file", str(table)]) == 0
    assert table.read_text() == capsys.readouterr().out
    rows = {line.split(" | ")[0].strip("| "): line for line in table.read_text().splitlines()}
    assert "2 of 3 | 2, 0 | 1 of 2" in rows["`joint_backlash`"]
    assert "0 of 1 | 1, **1** | –" in rows["`joint_hysteresis`"]
    assert "1 cases | misled in 1" in rows["nothing concealed"]
    (answered / "empty").mkdir()
    assert diagnosis_rates_by_effect.main([f"none={answered / 'empty'}"]) == 2
