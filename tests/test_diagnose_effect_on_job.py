"""Effect of a finding on a toolpath: both plans, and the old choice under the new model."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.commands.diagnose.output_files import compute_effect_on_job
from machopt.data_types.documents.diagnosis_document import JobEffectSection
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.errors import InputError
from machopt.measurement.diagnosis.outputs.effect_on_toolpath import (
    TEST_FORCE,
    _format_effect_sentence,
    compare_toolpath_plans,
    rank_findings,
)
from machopt.options.plan_option_reader import load_options
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma
from machopt.report.page_data.diagnosis import build_job_effect
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parent.parent
CELL = load_cell(ROOT / "cells" / "kr500_milling")
assert CELL.stiffness is not None
OLD = CELL.stiffness
C = 1.0 / OLD.joints
FOUND = StiffnessTerm(
    "joint_hysteresis", "joint:4", {"law": "play", "weights_rad_per_Nm": [2.0 * float(C[3])], "thresholds_Nm": [20.0]}
)
NEW = replace(OLD, terms=(*OLD.terms, FOUND))
PATH = ROOT / "toolpaths" / "plain.csv"
# weight the mean deflection only, so that replanning always reduces it
ONLY_MEAN = ["rotation_step_deg=20", "collision=false", "weights={mean: 1, worst: 0, travel: 0, rotation: 0, feed: 0}"]
OPTIONS = load_options(CELL.plan, None, ONLY_MEAN)


@pytest.fixture(scope="module")
def effect() -> dict[str, Any]:
    """Return the result of ``diagnose --toolpath`` with these ``--set`` options; ``plans`` uses the same options."""
    found = compute_effect_on_job(CELL, PATH, OLD, NEW, tuple(ONLY_MEAN))
    assert found is not None
    return found.to_json_types()


@pytest.fixture(scope="module")
def plans() -> tuple[Plan, Plan]:
    toolpath = read_toolpath(PATH)
    old, new = (plan_path(replace(CELL, stiffness=s), toolpath, OPTIONS) for s in (OLD, NEW))
    return old, new


def compute_deflections(choice: Plan, stiffness: ArmStiffness) -> np.ndarray:
    """Return the deflections (P,) in mm of the planned configurations, from joint springs and the backlash dead zone
    only."""
    d, q = choice.directions, choice.chosen.assignment.q
    J = ArmElasticity(choice.setup.robot, CELL.tool.T_flange_tcp, OLD).compute_jacobian(q)[0]
    tau = np.einsum("mci,mc->mi", J[:, :3], d.force)
    turned = tau * C
    for term in stiffness.terms:
        weight, threshold = term.parameters["weights_rad_per_Nm"][0], term.parameters["thresholds_Nm"][0]
        turned[:, 3] += weight * np.sign(tau[:, 3]) * np.maximum(np.abs(tau[:, 3]) - threshold, 0.0)
    return np.asarray(1e3 * np.linalg.norm(np.einsum("mci,mi->mc", J[:, :3], turned), axis=1))


def test_values_equal_those_of_two_plans(effect: dict[str, Any], plans: tuple[Plan, Plan]) -> None:
    """The tolerance 1e-9 covers a different order of the same arithmetic."""
    old, new = plans
    path = old.path
    cases = {
        "before": compute_deflections(old, OLD),
        "unchanged": compute_deflections(old, NEW),
        "after": compute_deflections(new, NEW),
    }
    cut = path.counted
    for case, value in cases.items():
        assert effect["deflection_mm"][case]["mean"] == pytest.approx(path.weight[cut] @ value[cut], rel=1e-9)
        points = np.where(cut & path.is_point, value, 0.0)
        assert effect["deflection_mm"][case]["worst"] == pytest.approx(points.max(), rel=1e-9)
        assert effect["worst_point"][case] == path.index[points.argmax()]
        np.testing.assert_allclose(effect[f"deflection_{case}_mm"], value[path.is_point], rtol=1e-9)
    turned = np.degrees(np.abs(np.angle(np.exp(1j * (compute_gamma(new) - compute_gamma(old))))))[cut]
    rotation = effect["rotation"]
    assert rotation["mean_change_deg"] == pytest.approx(turned.mean(), abs=1e-9)
    assert rotation["max_change_deg"] == pytest.approx(turned.max(), abs=1e-9)
    assert rotation["changed_share"] == pytest.approx((turned > 1.0).mean())
    assert effect["points_compared"] == cut.sum()
    assert effect["points_not_reached"] == 0
    assert effect["reason"] is None


def test_finding_costs_and_replanning_recovers_a_part(effect: dict[str, Any]) -> None:
    d = effect["deflection_mm"]
    assert d["unchanged"]["mean"] > 1.1 * d["before"]["mean"]  # the gear deflects up to three times as much
    assert d["after"]["mean"] < 0.97 * d["unchanged"]["mean"]
    assert effect["rotation"]["changed_share"] > 0.2
    assert f"{d['unchanged']['mean']:.3f} mm in the mean (believed: {d['before']['mean']:.3f})" in effect["sentence"]
    assert f"leaves {d['after']['mean']:.3f} mm" in effect["sentence"]


def test_page_and_file_contain_the_effect_on_the_job(effect: dict[str, Any]) -> None:
    json.dumps(effect, allow_nan=False)  # every point of this path is reachable, so the data contain no NaN
    page = build_job_effect(JobEffectSection.model_validate(effect))
    assert page.toolpath == "plain.csv"
    assert (
        len(page.point)
        == len(page.gamma_before)
        == len(page.gamma_after)
        == len(page.deflection_after)
        == len(read_toolpath(PATH))
    )
    assert [c.unit for c in page.changes] == ["mm"] * 4
    assert page.changes[0].after > page.changes[0].before


def test_no_finding_changes_nothing() -> None:
    same = compare_toolpath_plans(CELL, OLD, OLD, read_toolpath(PATH), OPTIONS).to_json_types()
    assert same["rotation"] == {"mean_change_deg": 0.0, "max_change_deg": 0.0, "changed_share": 0.0}
    assert same["deflection_mm"]["before"] == same["deflection_mm"]["unchanged"] == same["deflection_mm"]["after"]
    assert "the rotation stays as it is" in same["sentence"]


def test_default_force_is_used_without_a_process_force() -> None:
    options = replace(OPTIONS, force=replace(OPTIONS.force, travel=0.0, normal=0.0, axial=0.0))
    found = compare_toolpath_plans(CELL, OLD, NEW, read_toolpath(PATH), options).to_json_types()
    assert found["force"] == f"{TEST_FORCE:g} N along the tool axis"
    assert found["deflection_mm"]["unchanged"]["mean"] >= found["deflection_mm"]["before"]["mean"]
    assert found["force"] in found["sentence"]


def _table(folder: Path, x: float) -> Path:
    file = folder / "path.csv"
    rows = [
        f"{x},0,50,0,0,1,rapid,,a",
        f"{x},0,0,0,0,1,approach,900,a",
        f"{x + 40},0,0,0,0,1,cut,900,a",
        f"{x + 40},0,50,0,0,1,retract,900,a",
    ]
    file.write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n" + "\n".join(rows) + "\n")
    return file


def test_infeasible_plan_is_a_reason(tmp_path: Path) -> None:
    far = compare_toolpath_plans(CELL, OLD, NEW, read_toolpath(_table(tmp_path, 9000.0)), OPTIONS).to_json_types()
    assert "out of reach" in far["reason"]
    assert far["reason"] in far["sentence"]
    assert build_job_effect(JobEffectSection.model_validate(far)).changes == ()
    hard = StiffnessTerm(
        "joint_nonlinear_stiffness",
        "joint:3",
        {"law": "knee", "extra_rad_per_Nm": -2.0 * float(C[2]), "knee_Nm": 300.0},
    )
    against = compare_toolpath_plans(
        CELL, OLD, replace(OLD, terms=(hard,)), read_toolpath(_table(tmp_path, 0.0)), OPTIONS
    ).to_json_types()
    assert "joint_nonlinear_stiffness takes" in against["reason"]


def test_unreachable_points_are_left_out_and_counted(tmp_path: Path) -> None:
    file = _table(tmp_path, 0.0)
    rows = "\n".join(["9000,0,50,0,0,1,rapid,,b", "9000,0,0,0,0,1,approach,900,b", "9040,0,0,0,0,1,cut,900,b"])
    file.write_text(file.read_text() + rows + "\n")
    options = load_options(CELL.plan, None, [*ONLY_MEAN, "allow_gaps=true"])
    found = compare_toolpath_plans(CELL, OLD, NEW, read_toolpath(file), options).to_json_types()
    assert found["reason"] is None
    assert found["points_not_reached"] > 0
    assert "out of reach" in found["not_reached_because"]
    assert "cannot be compared" in found["sentence"]
    assert np.isfinite(found["deflection_mm"]["after"]["mean"])


def test_unreadable_toolpath_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv"):
        compare_toolpath_plans(CELL, OLD, NEW, read_toolpath(tmp_path / "none.csv"), OPTIONS)


def test_worse_new_plan_is_not_called_better() -> None:
    def said(after: float) -> str:
        point = {"before": 1.0, "unchanged": 1.0, "after": 1.0}
        return _format_effect_sentence(
            {"before": 1.04, "unchanged": 1.144, "after": after},
            {"before": 1.4, "unchanged": 1.543, "after": 1.543},
            point,
            4.0,
            1.0,
            "1000 N",
            0,
            60,
        )

    assert said(1.149).endswith("no less in the mean.")
    assert said(1.143).endswith("hardly less.")


def test_findings_are_ranked_by_their_effect_on_the_job(effect: dict[str, Any]) -> None:
    entries = effect["by_finding"]
    sizes = [e["deflection_mm"] for e in entries]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 0.0
    names = [(e["effect"], e["location"]) for e in entries]
    assert ("joint_hysteresis", "joint:4") in names
    small = SimpleNamespace(effect="joint_zero_offset", location="joint:1")
    large = SimpleNamespace(effect="joint_hysteresis", location="joint:4")
    section = JobEffectSection(toolpath="t", sentence="s", reason=None, changes=(), by_finding=tuple(entries))
    assert rank_findings((small, large), section) == (large, small)  # type: ignore[arg-type]
    assert rank_findings((small, large), None) == (small, large)  # type: ignore[arg-type]
