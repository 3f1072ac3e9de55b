"""``machopt optimize`` with a process: forces, errors and outcomes in tables and result; damages are detected."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from machopt.cli import main

ROOT = Path(__file__).resolve().parents[1]
PROCESS = """machopt_process: 1
materials:
  al: {drilling: {kc1: 800, mc: 0.25, chisel_N_mm2: 300,
    thrust_spread_percent: 25, torque_spread_percent: 9, source: t}}
operations:
  default: {kind: drilling, spindle_rpm: 3000, layers: [{material: al, thickness_mm: 12}], depth_mm: 12,
    tolerance: {position_mm: 0.4, axis_deg: 0.5}}
"""
ROWS = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(
    f"{x},{y},{z},0,0,1,{move},{feed},holes"
    for x, y in ((-150, -200), (-50, -200), (50, 200), (150, 200))
    for z, move, feed in ((40, "rapid", ""), (25, "rapid", ""), (0, "cut", 420), (40, "retract", ""))
)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("job")
    cell = folder / "cell"
    shutil.copytree(ROOT / "cells" / "kr240_drilling", cell)
    text = (cell / "cell.yaml").read_text()
    text = re.sub(r"cutter: \{[^}]*\}", "cutter: {diameter_mm: 6, length_mm: 70, point_deg: 135, web_mm: 0.9}", text)
    text = re.sub(r"(?m)^accuracy:.*\n", "", text)
    text += "process: process.yaml\naccuracy: {absolute_mm: 0.05, repeatability_mm: 0.02, source: assumed}\n"
    (cell / "cell.yaml").write_text(text)
    stiffness = re.sub(r"(?m)^(spread_percent|source):.*\n", "", (cell / "stiffness.yaml").read_text())
    (cell / "stiffness.yaml").write_text(stiffness + "spread_percent: 15\nsource: assumed\n")
    (cell / "process.yaml").write_text(PROCESS)
    (folder / "holes.csv").write_text(ROWS)
    return folder


def run(job: Path, name: str, *options: str) -> tuple[int, list[dict[str, str]], dict[str, object]]:
    out = job / name
    code = main(["optimize", str(job / "cell"), str(job / "holes.csv"), "-o", str(out), "--quiet", *options])
    with (out / "points.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return code, rows, json.loads((out / "result.json").read_text())


@pytest.fixture(scope="module")
def planned(job: Path) -> tuple[list[dict[str, str]], dict[str, object]]:
    code, rows, result = run(job, "out")
    assert code == 0
    return rows, result


def test_each_hole_has_an_outcome_at_its_deepest_point(planned: tuple[list[dict[str, str]], dict[str, object]]) -> None:
    rows, result = planned
    outcomes = {int(r["point"]): r["outcome"] for r in rows if r["outcome"]}
    assert sorted(outcomes) == [2, 6, 10, 14]
    process = result["process"]
    assert isinstance(process, dict)
    counts = process["in_tolerance"]["after"]
    assert sum(counts.values()) == 4
    assert all(counts[word] == list(outcomes.values()).count(word) for word in counts)
    for r in rows:
        cut = r["move"] == "cut"
        assert (float(r["f_axial_N"]) > 100.0) == cut
        assert bool(r["p_in"]) == cut
        if cut:
            p = float(r["p_in"])
            assert r["outcome"] == ("pass" if p >= 0.95 else "fail" if p < 0.5 else "marginal")
            low, nominal, high = (float(r[f"error_across{end}_mm"]) for end in ("_lo", "", "_hi"))
            assert low < high
            assert 0.0 < nominal < high
            assert re.fullmatch(r"joint:[1-6] 0\.\d\d", r["cause"])


def test_deflection_equals_that_of_the_thrust(planned: tuple[list[dict[str, str]], dict[str, object]]) -> None:
    rows, _ = planned
    for r in rows:
        if r["move"] == "cut":
            along = float(r["f_axial_N"]) / float(r["k_axial_N_mm"])
            assert float(r["error_along_mm"]) == pytest.approx(along, rel=1e-3)
            assert float(r["deflection_mm"]) >= along * 0.999


@pytest.mark.parametrize(
    ("column", "change"),
    [("p_in", 0.05), ("f_axial_N", 5.0), ("error_across_mm", 0.02), ("error_axis_deg", 0.01), ("tolerance_mm", -0.1)],
)
def test_changed_column_fails_the_verification(
    job: Path, planned: tuple[list[dict[str, str]], dict[str, object]], column: str, change: float, tmp_path: Path
) -> None:
    del planned
    out = tmp_path / "out"
    shutil.copytree(job / "out", out)
    with (out / "points.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    row = next(r for r in rows if r["p_in"])
    row[column] = f"{float(row[column]) - change:.6f}"
    with (out / "points.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    from machopt.cell.cell_reader import load_cell
    from machopt.data_types.plan_options import PlanOptions, ProcessForce
    from machopt.output.manifest_file import read_manifest
    from machopt.toolpath.toolpath_reader import read_toolpath
    from machopt.verification.folder.folder_checks import check_contents

    found = check_contents(
        load_cell(job / "cell"),
        read_toolpath(job / "holes.csv"),
        out,
        options=PlanOptions(force=ProcessForce(axial=250.0)),
        manifest=read_manifest(out)[0],
    )
    assert any(column in c.name for c in found.failed), [c.name for c in found.failed]


def test_failure_stated_as_unknown_fails_the_verification(
    job: Path, planned: tuple[list[dict[str, str]], dict[str, object]], tmp_path: Path
) -> None:
    del planned
    out = tmp_path / "out"
    shutil.copytree(job / "out", out)
    with (out / "points.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    row = next(r for r in rows if r["p_in"])
    row["p_in"], row["outcome"] = "", "unknown"
    with (out / "points.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    from machopt.cell.cell_reader import load_cell
    from machopt.data_types.plan_options import PlanOptions, ProcessForce
    from machopt.output.manifest_file import read_manifest
    from machopt.toolpath.toolpath_reader import read_toolpath
    from machopt.verification.folder.folder_checks import check_contents

    found = check_contents(
        load_cell(job / "cell"),
        read_toolpath(job / "holes.csv"),
        out,
        options=PlanOptions(force=ProcessForce(axial=250.0)),
        manifest=read_manifest(out)[0],
    )
    assert any("unknown outcomes" in c.name for c in found.failed), [c.name for c in found.failed]


@pytest.mark.parametrize(
    ("file", "pattern", "new", "word"),
    [
        ("cell.yaml", r"(?m)^accuracy:.*$", "", "accuracy"),
        ("stiffness.yaml", r"(?m)^spread_percent:.*$", "", "spread_percent"),
        ("stiffness.yaml", r"(?m)^spread_percent:.*$", "estimated: true", "estimated"),
        ("process.yaml", "thrust_spread_percent: 25, ", "", "spread of the force"),
    ],
)
def test_missing_input_makes_the_outcome_unknown(
    job: Path, tmp_path: Path, file: str, pattern: str, new: str, word: str
) -> None:
    other = tmp_path / "job"
    shutil.copytree(job / "cell", other / "cell")
    shutil.copy(job / "holes.csv", other)
    path = other / "cell" / file
    path.write_text(re.sub(pattern, new, path.read_text()))
    code, rows, result = run(other, "out")
    assert code == 0
    holes = [r for r in rows if r["outcome"]]
    assert [r["outcome"] for r in holes] == ["unknown"] * 4
    assert all(not r["p_in"] and 0.0 <= float(r["p_in_deflection_only"]) <= 1.0 for r in holes)
    process = result["process"]
    assert isinstance(process, dict)
    assert any(word in text for text in process["validity"])


def test_tolerance_objective_has_no_more_failures(
    job: Path, planned: tuple[list[dict[str, str]], dict[str, object]]
) -> None:
    rows, _ = planned
    code, other, _ = run(job, "tolerance", "--objective", "tolerance")
    assert code == 0

    def shortfall(table: list[dict[str, str]]) -> float:
        return float(np.mean([max(0.95 - float(r["p_in"]), 0.0) for r in table if r["p_in"]]))

    assert shortfall(other) <= shortfall(rows) + 0.01


def test_process_file_option_replaces_that_of_the_cell(job: Path, tmp_path: Path) -> None:
    file = tmp_path / "other.yaml"
    file.write_text(PROCESS.replace("position_mm: 0.4", "position_mm: 4"))
    code, rows, _ = run(job, "other", "--process", str(file))
    assert code == 0
    assert {r["outcome"] for r in rows if r["outcome"]} == {"pass"}
    arguments = ["verify", str(job / "cell"), str(job / "holes.csv"), str(job / "other"), "--quiet"]
    assert main([*arguments, "--process", str(file)]) == 0
    assert main(arguments) == 4


def test_verify_names_the_option_for_an_external_process_file(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(job / "cell", cell)
    (cell / "cell.yaml").write_text((cell / "cell.yaml").read_text().replace("process: process.yaml\n", ""))
    process = tmp_path / "cutting.yaml"
    shutil.move(cell / "process.yaml", process)
    toolpath = str(job / "holes.csv")
    out = tmp_path / "out"
    assert main(["optimize", str(cell), toolpath, "-o", str(out), "--quiet", "--process", str(process)]) == 0
    manifest = json.loads((out / "manifest.json").read_text())
    assert [entry["role"] for name, entry in manifest["inputs"].items() if "cutting" in name] == ["process"]
    capsys.readouterr()
    assert main(["verify", str(cell), toolpath, str(out), "--quiet"]) == 2
    assert "--process" in capsys.readouterr().err
    assert main(["verify", str(cell), toolpath, str(out), "--quiet", "--process", str(process)]) == 0
    process.write_text(process.read_text().replace("3000", "3100"))
    assert main(["verify", str(cell), toolpath, str(out), "--quiet", "--process", str(process)]) == 4
