"""``machopt identify``: written files, their use by other commands, refusals."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_arm import Simulated, SmoothField, TrueArm, random_loads, record, scattered_poses

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cell.stiffness.term_parser import parse_term
from machopt.cli import main
from machopt.cli.stiffness_commands import _format_identify_summary
from machopt.commands.identify.computation import compute_identification
from machopt.commands.identify.run import IdentifyResult, run_identify
from machopt.data_types.documents.identification_document import describe_unidentified_joint
from machopt.data_types.stiffness import ExternalJointSpring
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.identification.request import IdentifyRequest
from machopt.measurement.recording import write_recording

ROOT = Path(__file__).resolve().parent.parent
CELL = ROOT / "cells" / "kr240_drilling"
TRUE_K = np.array([1.6e6, 4.4e5, 8.1e5, 3.2e5, 4.3e5, 3.5e5])  # N·m/rad, up to 20 % different from the cell's values
MIDDLE = np.radians([0, -90, 100, 20, 60, 30.0])


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    """16 poses, 4 loads of up to 1500 N, two cycles; typical measurement noise."""
    cell = load_cell(CELL)
    robot, rng = load_robot(cell), np.random.default_rng(3)
    q = scattered_poses(robot, rng, 16, MIDDLE, 0.6)
    arm = TrueArm(robot, cell.tool.T_flange_tcp, 1.0 / TRUE_K)
    return record(arm, q, random_loads(rng, 16, 4, 1500.0, 150.0), rng, repeats=2)


@pytest.fixture(scope="module")
def done(simulated: Simulated, tmp_path_factory: pytest.TempPathFactory) -> IdentifyResult:
    folder = tmp_path_factory.mktemp("identify")
    write_recording(folder / "recording", simulated.recording)
    return run_identify(IdentifyRequest(cell=CELL, recordings=(folder / "recording",), out=folder / "out"))


def test_files_agree_with_each_other_and_with_the_truth(done: IdentifyResult, simulated: Simulated) -> None:
    out = done.report.parent
    assert sorted(p.name for p in out.iterdir()) == [
        "identification.json",
        "manifest.json",
        "readings.csv",
        "report.html",
        "stiffness.yaml",
    ]
    result = json.loads((out / "identification.json").read_text())
    assert result["machopt_identification"] == 1
    assert (result["readings"], result["poses"], result["model"]) == (128, 16, "constant")
    written = load_stiffness(out / "stiffness.yaml")
    inside = 0
    for joint, k, true in zip(result["joints"], written.joints, TRUE_K, strict=True):
        assert joint["identified"]
        assert joint["k_Nm_per_rad"] == pytest.approx(k)
        assert k == pytest.approx(true, rel=0.15)  # standard error of joint 6: 5 %; three of them allowed
        inside += joint["ci90"][0] <= true <= joint["ci90"][1]
    assert inside >= 4  # of six 90 % intervals; fewer than 4 occurs once in 80 recordings
    assert written.covariance is not None
    half = [(j["ci90"][1] - j["ci90"][0]) / 2 / j["k_Nm_per_rad"] for j in result["joints"]]
    sigma = np.sqrt(np.diag(written.covariance)) * written.joints
    ratio = np.array(half) / sigma
    assert ratio.min() > 1.6  # 1.645 for a normal distribution; the difference comes from the curvature of 1/c
    assert ratio.max() < 2.92  # 2.92: Student's t for two degrees of freedom; 16 poses have more
    # the error on unseen poses equals the noise: 36 µm per coordinate and 0.75 % of the load
    assert 0.03 < result["heldout_rmse_mm"] < 0.07
    assert result["rmse_mm"] <= result["heldout_rmse_mm"]
    assert len(result["outliers"]) >= simulated.outlier.sum() - 1  # noise may cover one


def test_readings_are_in_base_axes_with_their_prediction(done: IdentifyResult, simulated: Simulated) -> None:
    with (done.report.parent / "readings.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(simulated.recording)
    measured, predicted, unseen = (
        np.array([[float(r[f"{kind}_d{a}_mm"]) for a in "xyz"] for r in rows])
        for kind in ("measured", "predicted", "heldout")
    )
    assert simulated.recording.displacement is not None
    # tolerance: printed decimals
    np.testing.assert_allclose(measured, 1e3 * simulated.recording.displacement, atol=1e-5)
    good = ~simulated.outlier
    error = (predicted - 1e3 * simulated.displacement[:, :3])[good]
    assert np.sqrt(np.mean(error**2)) < 0.03  # mm; the measured displacements are 2 mm and more
    assert np.sqrt(np.mean((unseen - measured)[good] ** 2)) > np.sqrt(np.mean((predicted - measured)[good] ** 2))


def test_page_is_self_contained_and_states_the_main_result(done: IdentifyResult) -> None:
    html = done.report.read_text(encoding="utf-8")
    assert "http" not in html.replace("http://www.w3.org", "")  # no external resource is loaded
    assert "Joints 1, 2, 3, 4, 5 and 6 identified to" in html
    for chart in ("i-joints", "i-parity", "i-residual", "i-ellipse0", "i-subset0"):
        assert f'id="{chart}"' in html


def test_optimize_reads_what_identify_writes(done: IdentifyResult, tmp_path: Path) -> None:
    shutil.copytree(CELL, tmp_path / "cell")
    shutil.copy(done.report.parent / "stiffness.yaml", tmp_path / "cell" / "stiffness.yaml")
    cell = load_cell(tmp_path / "cell")
    assert cell.stiffness is not None
    np.testing.assert_allclose(cell.stiffness.joints, TRUE_K, rtol=0.15)
    assert cell.stiffness.covariance is not None


def test_grid_is_used_where_the_stiffness_varies(tmp_path: Path) -> None:
    cell = load_cell(CELL)
    robot, rng = load_robot(cell), np.random.default_rng(5)
    law = SmoothField.draw(1.0 / TRUE_K, rng, amplitude=0.3, scale=0.35)
    q = scattered_poses(robot, rng, 90, MIDDLE, 0.4)
    s = record(TrueArm(robot, cell.tool.T_flange_tcp, law), q, random_loads(rng, 90, 4, 1500.0, 200.0), rng)
    write_recording(tmp_path / "recording", s.recording)
    result = run_identify(
        IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", studies=False)
    ).result.to_json_types()
    assert result["model"] == "grid"
    assert result["heldout_rmse_mm"] < 0.8 * result["grid"]["heldout_rmse_constant_mm"]
    grid = load_stiffness(tmp_path / "out" / "stiffness.yaml").grid
    assert grid is not None
    assert grid.std is not None
    assert grid.joints.shape == (int(np.prod(result["grid"]["shape"])), 6)


def test_several_sessions_are_one_identification(simulated: Simulated, tmp_path: Path) -> None:
    r = simulated.recording
    first = r.pose < 8
    for name, rows in (("monday", first), ("tuesday", ~first)):
        assert r.wrench is not None
        assert r.displacement is not None
        part = replace(
            r,
            q=r.q[rows],
            pose=r.pose[rows],
            cycle=r.cycle[rows],
            session=r.session[rows],
            line=r.line[rows],
            wrench=r.wrench[rows],
            displacement=r.displacement[rows],
        )
        write_recording(tmp_path / name, part)
    both = (tmp_path / "monday", tmp_path / "tuesday")
    result = run_identify(
        IdentifyRequest(cell=CELL, recordings=both, out=tmp_path / "out", studies=False)
    ).result.to_json_types()
    assert (result["readings"], result["poses"]) == (128, 16)
    assert all(j["identified"] for j in result["joints"])


def test_term_is_fitted_with_the_joints_and_written(tmp_path: Path, simulated: Simulated) -> None:
    write_recording(tmp_path / "recording", simulated.recording)
    request = IdentifyRequest(
        cell=CELL,
        recordings=(tmp_path / "recording",),
        out=tmp_path / "out",
        studies=False,
        terms=("joint_coupling@joint:4-5",),
    )
    result = run_identify(request).result.to_json_types()
    (term,) = result["terms"]
    assert (term["effect"], term["location"]) == ("joint_coupling", "joint:4-5")
    assert term["ci90"][0] < 0 < term["ci90"][1]  # the true value is 0
    assert abs(term["value"]) < 0.2 / 3.2e5  # compared with the compliance of joint 4


@pytest.mark.parametrize("text", ["link_compliance", "@link:4", "tool_compliance@tool{length_mm 3", "x@"])
def test_invalid_terms_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--fit"):
        parse_term(text)


def test_parameters_of_a_fitted_term_are_validated() -> None:
    term = parse_term("tool_compliance@tool{length_mm: 400, form: beam}")
    assert (term.effect, term.location, term.parameters) == (
        "tool_compliance",
        "tool",
        {"length_mm": 400, "form": "beam"},
    )


def scale_displacements(simulated: Simulated, factor: float) -> Simulated:
    assert simulated.recording.displacement is not None
    return replace(
        simulated, recording=replace(simulated.recording, displacement=factor * simulated.recording.displacement)
    )


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_units_wrong_by_a_thousand_are_refused_by_name(simulated: Simulated, tmp_path: Path, factor: float) -> None:
    write_recording(tmp_path / "recording", scale_displacements(simulated, factor).recording)
    with pytest.raises(InputError, match="unit") as caught:
        run_identify(IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out"))
    assert "dx_mm" in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("newtons", "unit"), [(9.80665, "kilograms"), (4.4482216, "pounds")])
def test_loads_in_weight_units_lead_to_a_question(
    simulated: Simulated, tmp_path: Path, newtons: float, unit: str
) -> None:
    assert simulated.recording.wrench is not None
    write_recording(tmp_path / "recording", replace(simulated.recording, wrench=simulated.recording.wrench / newtons))
    request = IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", studies=False)
    with pytest.raises(InputError, match=unit):
        run_identify(request)
    retained = run_identify(replace(request, accept=("units",))).result.to_json_types()
    assert retained["joints"][1]["k_Nm_per_rad"] == pytest.approx(TRUE_K[1] / newtons, rel=0.15)


def test_two_poses_are_too_few_for_six_joints(simulated: Simulated, tmp_path: Path) -> None:
    r = simulated.recording
    rows = r.pose < 1
    assert r.wrench is not None
    assert r.displacement is not None
    part = replace(
        r,
        q=r.q[rows],
        pose=r.pose[rows],
        cycle=r.cycle[rows],
        session=r.session[rows],
        line=r.line[rows],
        wrench=r.wrench[rows],
        displacement=r.displacement[rows],
    )
    write_recording(tmp_path / "recording", part)
    result = run_identify(
        IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", studies=False)
    ).result.to_json_types()
    assert result["heldout_rmse_mm"] is None  # no pose remains for validation
    assert any("pose" in w for w in result["warnings"])


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"model": "cubic"}, "--model"),
        ({"grid_cell_mm": 0.0}, "--grid-cell-mm"),
        ({"level_percent": 100.0}, "--level"),
        ({"grid_shape": (1, 0, 1)}, "--grid-shape"),
        ({"plain": True, "model": "grid"}, "--plain"),
        ({"terms": ("link_complianc@link:4",)}, "effect"),
    ],
)
def test_inconsistent_options_are_refused(
    simulated: Simulated, tmp_path: Path, change: dict[str, object], where: str
) -> None:
    write_recording(tmp_path / "recording", simulated.recording)
    with pytest.raises(InputError, match=where):
        run_identify(
            replace(IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out"), **change)
        )  # type: ignore[arg-type]


def test_published_readings_without_an_explanation_are_reported(tmp_path: Path) -> None:
    cell = ROOT / "cells" / "irb6700_drilling"
    done = run_identify(
        IdentifyRequest(cell=cell, recordings=(cell / "recordings" / "zhang2025_table2",), out=tmp_path / "out")
    )
    assert done.result.to_json_types()["explained_share"] < 0.5
    assert "do not follow an arm of elastic joints" in done.report.read_text(encoding="utf-8")


def test_joint_warnings_are_complete_in_the_summary(done: IdentifyResult) -> None:
    """The summary omitted every warning that began with "joint ", including those of the cell."""
    own, shown = (
        "joint 'a6' is continuous; its range is taken as ±360°",
        describe_unidentified_joint(4, "no reading shows it"),
    )
    joints = tuple(
        j.model_copy(update={"identified": False, "reason": "no reading shows it"}) if j.joint == 4 else j
        for j in done.result.joints
    )
    lines = _format_identify_summary(done.result.model_copy(update={"warnings": (own, shown), "joints": joints}))
    assert f"  note: {own}" in lines
    assert sum("no reading shows it" in line for line in lines) == 1


def test_command_is_deterministic_and_prints_the_main_result_first(
    done: IdentifyResult, simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "recording"
    write_recording(recording, simulated.recording)
    words = ["identify", str(CELL), str(recording), "-o", str(tmp_path / "out"), "--quiet"]
    assert main([*words[:-1]]) == 0
    for name in ("stiffness.yaml", "readings.csv", "identification.json"):  # same input, same bytes
        assert (tmp_path / "out" / name).read_bytes() == (done.report.parent / name).read_bytes(), name
    out = capsys.readouterr().out
    assert "128 readings, 16 poses, constant model" in out
    assert out.count("N·m/rad") == 6
    assert main([*words[:-1], "--json", "--fit", "joint_coupling@joint:4-5", "--no-studies"]) == 0
    assert json.loads(capsys.readouterr().out)["terms"][0]["effect"] == "joint_coupling"
    assert main([*words, "--grid-shape", "1,1"]) == 2
    assert "expected three" in capsys.readouterr().err
    assert main(["identify", str(CELL), str(tmp_path / "none"), "-o", str(tmp_path / "o")]) == 2
    assert "recording.yaml" in capsys.readouterr().err


def test_plan_poses_and_map_are_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each option reaches the request; other tests cover what the options do."""
    words = [
        "plan-poses",
        str(CELL),
        "-o",
        str(tmp_path / "poses"),
        "--poses",
        "4",
        "--candidates",
        "60",
        "--starts",
        "1",
    ]
    assert main([*words, "--weights-kg", "50,100", "--arms-mm", "0,300", "--no-collision", "--quiet"]) == 0
    assert (tmp_path / "poses" / "recording_template" / "recording.yaml").is_file()
    words = ["map", str(CELL), "-o", str(tmp_path / "map"), "--joints", "a2,a3", "--step", "30", "--collision", "none"]
    assert main([*words, "--load-N=0,0,-500"]) == 0
    assert "report:" in capsys.readouterr().out
    assert main([word if word != "a2,a3" else "a9" for word in words]) == 2
    assert "a9" in capsys.readouterr().err


def test_ninety_percent_intervals_keep_their_key(simulated: Simulated, done: IdentifyResult, tmp_path: Path) -> None:
    """Other programs read the key ci90; another confidence level is written in addition."""
    write_recording(tmp_path / "recording", simulated.recording)
    request = IdentifyRequest(
        cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", level_percent=99.0, studies=False
    )
    wide = run_identify(request)
    for a, b in zip(done.result.to_json_types()["joints"], wide.result.to_json_types()["joints"], strict=True):
        assert a["ci90"] == pytest.approx(b["ci90"], rel=1e-9)
        assert b["interval"][0] < b["ci90"][0]
        assert b["interval"][1] > b["ci90"][1]
    assert "99 % interval" in wide.report.read_text(encoding="utf-8")


def test_unknown_error_code_is_refused(simulated: Simulated, tmp_path: Path) -> None:
    write_recording(tmp_path / "recording", simulated.recording)
    with pytest.raises(InputError, match="--accept: found 'unit'; valid: displacement_frame"):
        run_identify(
            IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", accept=("unit",))
        )
    with pytest.raises(InputError, match=r"--fit joint_friction@joint:1: effect 'joint_friction' is not known"):
        run_identify(
            IdentifyRequest(
                cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", terms=("joint_friction@joint:1",)
            )
        )


def test_page_of_few_readings_has_no_nan(simulated: Simulated, tmp_path: Path) -> None:
    r = simulated.recording
    rows = r.pose < 2
    assert r.wrench is not None
    assert r.displacement is not None
    down = np.zeros_like(r.wrench[rows])
    down[:, 2] = -200.0  # no torque on joint 1
    part = replace(
        r,
        q=r.q[rows],
        pose=r.pose[rows],
        cycle=r.cycle[rows],
        session=r.session[rows],
        line=r.line[rows],
        wrench=down,
        displacement=r.displacement[rows],
    )
    write_recording(tmp_path / "recording", part)
    done = run_identify(
        IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", accept=("load_sign",))
    )
    page = done.report.read_text(encoding="utf-8")
    assert "nan %" not in page
    assert "nan mm" not in page


def test_stiffness_of_external_joints_is_preserved_and_reported(simulated: Simulated, tmp_path: Path) -> None:
    write_recording(tmp_path / "recording", simulated.recording)
    rail = ExternalJointSpring(joint="rail", stiffness=4e7, slides=True, compliance=np.zeros((6, 6)), at=np.zeros(3))
    cell = load_cell(CELL)
    assert cell.stiffness is not None
    cell = replace(cell, stiffness=replace(cell.stiffness, external=(rail,)))
    request = IdentifyRequest(cell=CELL, recordings=(tmp_path / "recording",), out=tmp_path / "out", studies=False)
    found = compute_identification(request, lambda _: None, cell)
    assert found.identification.stiffness.external == (rail,)
    assert any("external_joints of stiffness.yaml (rail): not fitted" in output for output in found.result.warnings)
