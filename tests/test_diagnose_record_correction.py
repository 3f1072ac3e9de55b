"""Record correction: units, frames, signs and duplicates are found, named by their column and corrected."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_hidden_effects import (
    ARCMIN,
    CELLS,
    HiddenEffects,
    NoiseLevels,
    arm,
    build_rough_backlash,
    load_tests,
    plan_load_tests,
    solve_equilibrium,
)

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.parameter_keys import build_joint_spring_key
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_quality import outlier_rows, pose_units, static_record_correction
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown
from machopt.measurement.diagnosis.data_types.diagnosis_result import BaseCoefficient, Finding
from machopt.measurement.diagnosis.static import loaded_equilibrium_terms
from machopt.measurement.diagnosis.verdict.cell_stiffness_comparison import describe_deviating_springs
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault as Problem

CELL = "kr240_drilling"


@cache
def robot(cell: str = CELL) -> tuple[Robot, np.ndarray, np.ndarray]:
    found = load_cell(CELLS / cell)
    assert found.stiffness is not None
    return load_robot(found), found.tool.T_flange_tcp, found.stiffness.joints


@cache
def simulate_correct_recording(
    rotations: bool = False, frame: str = "base", cell: str = CELL, force: float = 1500.0
) -> Recording:
    """Simulate forces of 1.5 kN; with rotations, additional moments of 200 N·m."""
    rng = np.random.default_rng(3)
    a = arm(cell)
    truth = HiddenEffects(a.nominal * rng.uniform(0.75, 1.3, 6), {2: build_rough_backlash(0.3 * ARCMIN, 80.0)})
    plan = plan_load_tests(a, rng, poses=12, loads=3, force=force, moment=0.13 * force if rotations else 0.0)
    return load_tests(a, truth, plan, rng, NoiseLevels(outliers=0.0), rotations=rotations, frame=frame)


def scale_columns(r: Recording, group: str, factor: float) -> Recording:
    """Multiply one group of columns by the factor of another unit."""
    assert r.wrench is not None
    assert r.displacement is not None
    if group == "q1_deg":
        return replace(r, q=factor * r.q)
    w, d = r.wrench.copy(), r.displacement.copy()
    target, columns = {
        "fx_N": (w, slice(0, 3)),
        "mx_Nm": (w, slice(3, 6)),
        "dx_mm": (d, slice(0, 3)),
        "rx_mrad": (d, slice(3, 6)),
    }[group]
    target[:, columns] *= factor
    return replace(r, wrench=w, displacement=d)


def mend(r: Recording, cell: str = CELL, **options) -> tuple[Recording, list[Finding], list[str]]:
    arm_, T, prior = robot(cell)
    return static_record_correction.correct_static_record(r, arm_, T, prior, **options)


def test_correct_recording_remains_unchanged() -> None:
    for r in (
        simulate_correct_recording(),
        simulate_correct_recording(rotations=True),
        simulate_correct_recording(frame="tool"),
    ):
        corrected, findings, _ = mend(r)
        assert findings == []
        assert corrected is r


UNITS = [
    ("dx_mm", 1e-3, False),
    ("dx_mm", 1 / 25.4, False),
    ("dx_mm", 1e3, False),
    ("dx_mm", 0.1, False),
    ("dx_mm", 1e-3, True),
    ("dx_mm", 1 / 25.4, True),
    ("dx_mm", 1e3, True),
    ("fx_N", 1e-3, False),
    ("fx_N", 1 / 9.80665, False),
    ("fx_N", 1 / 4.44822, False),
    ("fx_N", 1e-3, True),
    ("fx_N", 1 / 9.80665, True),
    ("mx_Nm", 1e3, True),
    ("rx_mrad", 1e-3, True),
    ("rx_mrad", float(np.degrees(1e-3)), True),
    ("rx_mrad", 1e3, True),
    ("q1_deg", float(np.pi / 180), False),
    ("q1_deg", float(np.pi / 180), True),
]


@pytest.mark.parametrize(("group", "factor", "rotations"), UNITS)
def test_wrong_unit_is_named_by_its_columns_and_corrected(group: str, factor: float, rotations: bool) -> None:
    r = simulate_correct_recording(rotations)
    corrected, findings, _ = mend(scale_columns(r, group, factor))
    assert [(f.effect, f.location) for f in findings] == [("units", f"column:{group}")]
    assert findings[0].parameters["factor"].value == pytest.approx(factor, rel=1e-9)
    assert findings[0].record
    for name in ("q", "wrench", "displacement"):
        assert np.allclose(getattr(corrected, name), getattr(r, name), rtol=1e-12, atol=0.0)


def test_kilograms_in_all_rows_are_corrected_in_all() -> None:
    r = simulate_correct_recording(rotations=True)
    kilograms = scale_columns(scale_columns(r, "fx_N", 1 / 9.80665), "mx_Nm", 1 / 9.80665)
    corrected, findings, _ = mend(kilograms)
    assert [f.location for f in findings] == ["column:fx_N"]
    assert np.allclose(corrected.wrench, r.wrench)  # type: ignore[arg-type]


def test_factor_of_a_million_is_one_finding() -> None:
    r = simulate_correct_recording()
    corrected, findings, _ = mend(scale_columns(r, "dx_mm", 1e6))
    assert [f.location for f in findings] == ["column:dx_mm"]
    assert findings[0].parameters["factor"].value == pytest.approx(1e6)
    assert np.allclose(corrected.displacement, r.displacement)  # type: ignore[arg-type]


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_springs_three_times_off_the_cell_are_no_unit_error(factor: float) -> None:
    arm_, T, prior = robot()
    r = simulate_correct_recording()
    corrected, findings, _ = static_record_correction.correct_static_record(r, arm_, T, prior * factor)
    assert findings == []
    assert corrected is r


def test_joint_ten_times_softer_is_no_unit_error() -> None:
    """The displacement per load is then many times that of the cell, too, but most joints agree with the cell."""
    arm_, T, prior = robot()
    r = simulate_correct_recording()
    for joint in range(3):
        # 40 times the stiffness in the cell; the arm has a fortieth of it
        soft = prior * np.where(np.arange(6) == joint, 40.0, 1.0)
        corrected, findings, _ = static_record_correction.correct_static_record(r, arm_, T, soft)
        assert findings == [], f"joint {joint + 1}"
        assert corrected is r


def test_displacements_with_the_stated_scatter_have_the_stated_unit() -> None:
    """An arm seven times stiffer than in its cell looks like a unit error (cm), but the scatter of its tracker has
    the stated size."""
    arm_, T, prior = robot()
    r = simulate_correct_recording()
    stiff = replace(r, displacement=r.displacement / 7.0)  # type: ignore[operator]
    assert [f.effect for f in static_record_correction.correct_static_record(stiff, arm_, T, prior)[1]] == [
        "units"
    ]  # replicates scatter by a seventh of the stated uncertainty
    rng = np.random.default_rng(0)
    noisy = replace(stiff, displacement=stiff.displacement + 15e-6 * rng.standard_normal(r.displacement.shape))  # type: ignore[union-attr]
    stated = replace(r.uncertainty, displacement=15e-6)
    assert static_record_correction.correct_static_record(replace(noisy, uncertainty=stated), arm_, T, prior)[1] == []
    unsaid = replace(r.uncertainty, displacement=None)
    assert [
        f.effect
        for f in static_record_correction.correct_static_record(replace(noisy, uncertainty=unsaid), arm_, T, prior)[1]
    ] == ["units"]


def test_estimated_stiffness_does_not_separate_pounds_from_a_soft_arm() -> None:
    arm_, T, prior = robot()
    pounds = scale_columns(simulate_correct_recording(), "fx_N", 1 / 4.44822)
    assert [f.location for f in static_record_correction.correct_static_record(pounds, arm_, T, prior)[1]] == [
        "column:fx_N"
    ]
    assert static_record_correction.correct_static_record(pounds, arm_, T, prior, estimated=True)[1] == []
    kilograms = scale_columns(simulate_correct_recording(), "fx_N", 1 / 9.80665)
    assert [
        f.location for f in static_record_correction.correct_static_record(kilograms, arm_, T, prior, estimated=True)[1]
    ] == ["column:fx_N"]


def test_accepted_values_are_not_corrected() -> None:
    r = scale_columns(simulate_correct_recording(), "dx_mm", 1 / 25.4)
    corrected, findings, _ = mend(r, accept=("units",))
    assert findings == []
    assert corrected is r


def test_wrong_frames_and_signs_are_named_and_corrected() -> None:
    r, tool = simulate_correct_recording(), simulate_correct_recording(frame="tool")
    assert r.wrench is not None
    cases = [
        (replace(tool, wrench_frame="base"), "force_sensor_frame", "sensor:force", tool.wrench, "tool"),
        (replace(r, wrench_frame="tool"), "force_sensor_frame", "sensor:force", r.wrench, "base"),
        (replace(r, displacement_frame="tool"), "displacement_frame", "sensor:displacement", r.wrench, "base"),
        (replace(r, wrench=-r.wrench), "load_geometry", "sensor:force", r.wrench, "base"),
    ]
    for wrong, effect, where, wrench, frame in cases:
        corrected, findings, _ = mend(wrong)
        assert [(f.effect, f.location) for f in findings] == [(effect, where)]
        assert np.allclose(corrected.wrench, wrench)  # type: ignore[arg-type]
        assert (corrected.wrench_frame, corrected.displacement_frame) == (frame, "base")


def test_moments_about_the_flange_are_named_and_corrected() -> None:
    r = simulate_correct_recording(rotations=True)
    arm_, T, _ = robot()
    assert r.wrench is not None
    lever = arm_.compute_fk(r.q, T)[:, :3, 3] - arm_.compute_fk(r.q)[:, :3, 3]
    w = r.wrench.copy()
    w[:, 3:] += np.cross(lever, w[:, :3])
    corrected, findings, _ = mend(replace(r, wrench=w))
    assert [(f.effect, f.location) for f in findings] == [("load_geometry", "sensor:force")]
    message, want = build_load_test_experiment(corrected, arm_, T), build_load_test_experiment(r, arm_, T)
    assert np.abs(message.wrench - want.wrench).max() < 1e-9


def test_duplicates_are_separated_from_replicates() -> None:
    r = simulate_correct_recording()
    assert r.displacement is not None
    assert not outlier_rows.find_copied_rows(r).any()
    d = r.displacement.copy()
    for n in (12, 33, 51):
        d[n] = d[n - 1]
    assert np.flatnonzero(outlier_rows.find_copied_rows(replace(r, displacement=d))).tolist() == [12, 33, 51]
    coarse = replace(r, displacement=np.round(d, 5))  # resolution 0.01 mm: equal consecutive readings are no evidence
    assert not outlier_rows.find_copied_rows(coarse).any()


def test_wrench_in_tool_axes_turns_with_the_sagging_tool() -> None:
    """The sensor frame of the simulation is deflected by weight; the encoder pose does not include this."""
    arm_, T, _ = robot()
    base, tool = simulate_correct_recording(), simulate_correct_recording(frame="tool")
    masses = load_masses(load_cell(CELLS / CELL))
    true = build_load_test_experiment(base, arm_, T).wrench
    tests = build_load_test_experiment(tool, arm_, T)
    straight = np.abs(tests.wrench - true).max()
    turned = np.abs(
        loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(tests, tool, arm_, T, masses).wrench - true
    ).max()
    assert straight > 5.0  # N of 1500 N: 3 mrad
    assert turned < 0.2 * straight  # spring uncertainty of some percent; without backlash and rotation by the load
    load_test_experiment = build_load_test_experiment(base, arm_, T)
    assert (
        loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(load_test_experiment, base, arm_, T, masses)
        is load_test_experiment
    )


@pytest.mark.parametrize("weight_only", [False, True])
def test_displacements_in_sagged_tool_axes_are_corrected(weight_only: bool) -> None:
    """A compliant arm: the tool axes rotate by milliradians, which changes displacements of millimetres."""
    arm_, T, _ = robot()
    a, rng = arm(CELL), np.random.default_rng(31)
    truth = HiddenEffects(a.nominal / 3.0)
    plan = plan_load_tests(a, rng, poses=12, sessions=1, loads=3, force=2500.0)
    base = load_tests(a, truth, plan, rng, NoiseLevels(outliers=0.0))
    assert base.displacement is not None
    R = solve_equilibrium(a, truth, plan)[1]
    shown = np.maximum.accumulate(np.where(plan.loaded & weight_only, 0, np.arange(len(R))))[plan.loaded]
    tool = replace(base, displacement=np.einsum("nji,nj->ni", R[shown], base.displacement), displacement_frame="tool")
    tests = build_load_test_experiment(tool, arm_, T)
    masses = load_masses(load_cell(CELLS / CELL))
    retained = loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(tests, tool, arm_, T, masses)
    straight, turned = (np.abs(t.measured - base.displacement).max() for t in (tests, retained))
    assert straight > 1e-5  # m
    assert turned < 0.35 * straight


@pytest.mark.parametrize("offset_N", [(7.0, 19.0, -2.0), (48.0, 19.0, 31.0)])
def test_force_offset_does_not_hide_the_tool_sag(offset_N: tuple[float, float, float]) -> None:
    """K_C and a force offset are as large as the effect of the deflection; the rotated force was then named a
    tracker frame rotation."""
    arm_, T, _ = robot()
    tool = simulate_correct_recording(frame="tool")
    assert tool.wrench is not None
    off = replace(tool, wrench=tool.wrench + np.array([*offset_N, 0.0, 0.0, 0.0]))
    tests = build_load_test_experiment(off, arm_, T)
    assert (
        loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(
            tests, off, arm_, T, load_masses(load_cell(CELLS / CELL))
        )
        is not tests
    )


def test_weights_in_encoder_tool_axes_remain() -> None:
    """The fit of the springs distinguishes this case from a sensor that deflects with the arm."""
    arm_, T, _ = robot()
    base = simulate_correct_recording()
    assert base.wrench is not None
    R = arm_.compute_fk(base.q, T)[:, :3, :3]
    w = np.einsum("nji,nbj->nbi", R, base.wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    load_test_experiment = build_load_test_experiment(replace(base, wrench=w, wrench_frame="tool"), arm_, T)
    retained = loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(
        load_test_experiment,
        replace(base, wrench=w, wrench_frame="tool"),
        arm_,
        T,
        load_masses(load_cell(CELLS / CELL)),
    )
    assert retained is load_test_experiment


def test_spring_far_from_the_cell_is_reported() -> None:
    def joint(number: int, value: float, sigma: float) -> BaseCoefficient:
        return BaseCoefficient(
            BaseUnknown(name=f"joint {number}", unit="rad/(N·m)", key=build_joint_spring_key(number)),
            value,
            value,
            sigma,
        )

    found = [joint(1, 1e-6, 1e-8), joint(2, 1e-5, 1e-7), joint(3, 1e-5, 9e-6), joint(4, 1e-7, 1e-9)]
    output = describe_deviating_springs(SimpleNamespace(coefficients=found), np.full(6, 1e6))  # type: ignore[arg-type]
    assert [s[:27] for s in output] == ["joint 2 comes out 10 times ", "joint 4 comes out 10 times "]
    assert "softer (100000 N·m/rad)" in output[0]  # not in exponent notation, as in a data sheet
    assert "stiffer" in output[1]
    assert describe_deviating_springs(SimpleNamespace(coefficients=found), None) == []  # type: ignore[arg-type]


def test_every_check_has_its_correction_or_none() -> None:
    """Each check result is passed to :func:`static_record_correction._apply_correction`; a result without a
    correction rule leaves the recording unchanged."""
    arm_, T, _ = robot()
    r = simulate_correct_recording(rotations=True)
    assert r.wrench is not None
    at_base = r.wrench.copy()
    p = arm_.compute_fk(r.q, T)[:, :3, 3]
    at_base[:, 3:] += np.cross(p, at_base[:, :3])

    def put_right(code: str, wrong: Recording, column: str = "", factor: float = 1.0) -> Recording | None:
        return static_record_correction._apply_correction(
            wrong, Problem(code=code, severity="error", message="said", column=column, factor=factor), arm_, T
        )

    both = put_right("frames", replace(r, wrench_frame="tool", displacement_frame="tool"))
    assert both is not None
    assert (both.wrench_frame, both.displacement_frame) == ("base", "base")
    lever = put_right("moment_at_base", replace(r, wrench=at_base))
    assert lever is not None
    np.testing.assert_allclose(lever.wrench, r.wrench, atol=1e-9)
    assert put_right("moment_at_base", replace(r, wrench=at_base, wrench_frame="tool")) is None
    assert put_right("units", r) is None  # no column to scale
    assert put_right("something new", r) is None
    scaled_back = put_right("moment_units", scale_columns(r, "mx_Nm", 1e3), "mx_Nm", 1e-3)
    assert scaled_back is not None
    np.testing.assert_allclose(scaled_back.wrench, r.wrench, rtol=1e-12)


def test_uncorrectable_error_is_reported_first(monkeypatch: pytest.MonkeyPatch) -> None:
    arm_, T, prior = robot()
    odd = Problem(code="something new", severity="error", message="nobody has seen this before")
    monkeypatch.setattr(static_record_correction, "check_experiment", lambda *_: [odd])
    r = simulate_correct_recording()
    corrected, findings, warnings = static_record_correction.correct_static_record(r, arm_, T, prior)
    assert corrected is r
    assert findings == []
    assert warnings == ["nobody has seen this before"]
    assert static_record_correction.correct_static_record(r, arm_, T, prior, accept=("something new",))[2] == [
        "nobody has seen this before"
    ]


def test_no_measurement_is_no_duplicate() -> None:
    r = simulate_correct_recording()
    assert not outlier_rows.find_copied_rows(replace(r, displacement=None)).any()
    arm_, T, _ = robot()
    poses = replace(r, kind="absolute", displacement=None, wrench=None, position=None)
    assert pose_units.correct_pose_units(poses, arm_, T) == (poses, [])
