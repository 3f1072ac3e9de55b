"""Faults of a recording are named; correct recordings cause no false positive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_load_tests import TRUE_K, add_measurement_errors, cell, plan_load_tests

from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.measurement.identification.data_quality.load_test_checks import (
    CODES,
    check_experiment,
    refuse_record_faults,
)
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault
from machopt.measurement.identification.identification_pipeline import identify_stiffness
from machopt.measurement.identification.options import IdentifyOptions

TOO_LITTLE = {"few_poses", "few_readings"}


def find_record_faults(record: Recording, prior: np.ndarray | None = TRUE_K) -> dict[str, RecordFault]:
    _, robot, T = cell()
    return {f.code: f for f in check_experiment(build_load_test_experiment(record, robot, T), robot, T, prior)}


def simulate_correct_record(seed: int = 41, *, rotations: bool = True, **design: object) -> Recording:
    rng = np.random.default_rng(seed)
    return add_measurement_errors(plan_load_tests(rng, **design), rng, rotations=rotations, outliers=0.0)  # type: ignore[arg-type]


def rows_of(record: Recording, rows: np.ndarray) -> Recording:
    names = ("q", "pose", "cycle", "session", "line", "wrench", "displacement")
    return replace(record, **{name: getattr(record, name)[rows] for name in names})


def scale_record(record: Recording, displacement: list[float], wrench: list[float]) -> Recording:
    d, w = np.repeat(displacement, 3), np.repeat(wrench, 3)
    return replace(record, displacement=record.displacement * d, wrench=record.wrench * w)


@pytest.mark.parametrize("prior", [TRUE_K, TRUE_K / 5, None], ids=["nominal", "off by five", "no nominal"])
@pytest.mark.parametrize(
    ("displacement", "wrench", "code", "says"),
    [
        ([1e-3, 1e-3], [1, 1], "units", "dx_mm … seem to hold metres"),
        ([1e3, 1e3], [1, 1], "units", "micrometres"),
        ([1e3, 1], [1, 1], "units", "micrometres"),
        ([1, 1], [1e-3, 1e-3], "units", "kilonewtons"),
        ([1, 1], [1, 1e3], "moment_units", "N·mm"),
        ([1, 1e-3], [1, 1], "rotation_units", "seem to hold rad;"),
        ([1, np.degrees(1e-3)], [1, 1], "rotation_units", "seem to hold degrees"),
    ],
)
def test_wrong_units_are_refused_by_name(
    displacement: list[float], wrench: list[float], code: str, says: str, prior: np.ndarray | None
) -> None:
    finding = find_record_faults(scale_record(simulate_correct_record(), displacement, wrench), prior)[code]
    assert finding.severity == "error"
    assert says in finding.message


@pytest.mark.parametrize(
    ("wrench", "displacement", "code"),
    [("base", "tool", "displacement_frame"), ("tool", "base", "wrench_frame"), ("tool", "tool", "frames")],
)
@pytest.mark.parametrize("rotations", [False, True])
def test_wrong_frame_is_refused(wrench: str, displacement: str, code: str, rotations: bool) -> None:
    wrong = replace(simulate_correct_record(rotations=rotations), wrench_frame=wrench, displacement_frame=displacement)
    finding = find_record_faults(wrong)[code]
    assert finding.severity == "error"
    assert "base" in finding.message
    # no further finding of the same cause
    assert not {"units", "rotation_units", "far_from_nominal"} & set(find_record_faults(wrong))


def test_tool_axes_stated_as_base_axes_are_refused() -> None:
    _, robot, T = cell()
    record = simulate_correct_record(rotations=False)
    R = robot.compute_fk(record.q, T)[:, :3, :3]
    turned = replace(record, displacement=np.einsum("nji,nj->ni", R, record.displacement))
    finding = find_record_faults(turned)["displacement_frame"]
    assert (finding.severity, "displacement_frame: tool would work" in finding.message) == ("error", True)
    options = IdentifyOptions(studies=False)
    with pytest.raises(InputError, match=r"made up: displacement_frame is stated \(or taken\) as base"):
        identify_stiffness(
            build_load_test_experiment(turned, robot, T),
            robot,
            T,
            ArmStiffness(joints=TRUE_K),
            options,
            np.random.default_rng(0),
        )
    accepted = replace(options, accept=frozenset({"displacement_frame"}))
    result = identify_stiffness(
        build_load_test_experiment(turned, robot, T),
        robot,
        T,
        ArmStiffness(joints=TRUE_K),
        accepted,
        np.random.default_rng(0),
    )
    assert any("displacement_frame: tool would work" in w for w in result.warnings)


def test_load_with_the_opposite_sign_is_refused() -> None:
    finding = find_record_faults(replace(simulate_correct_record(), wrench=-simulate_correct_record().wrench))[
        "load_sign"
    ]
    assert finding.severity == "error"
    assert "opposite sign" in finding.message


def test_moments_about_another_point_are_found() -> None:
    _, robot, T = cell()
    record = simulate_correct_record()
    tcp, flange = robot.compute_fk(record.q, T)[:, :3, 3], robot.compute_fk(record.q)[:, :3, 3]
    for point, code in ((np.zeros_like(tcp), "moment_at_base"), (flange, "moment_at_flange")):
        wrench = record.wrench.copy()
        wrench[:, 3:] += np.cross(tcp - point, wrench[:, :3])
        assert code in find_record_faults(replace(record, wrench=wrench))


def test_moments_inconsistent_with_forces_are_found_row_by_row() -> None:
    record = simulate_correct_record(rotations=False)
    wrench = record.wrench.copy()
    wrench[:, 3:] = np.cross([0.1, 0.05, -0.2], wrench[:, :3])  # all loads are applied at one lifting eye
    assert "moment_along_force" not in find_record_faults(replace(record, wrench=wrench))
    wrench[5, 3:] = wrench[5, [5, 3, 4]]  # columns exchanged
    finding = find_record_faults(replace(record, wrench=wrench))["moment_along_force"]
    assert finding.rows == (5,)
    assert "line 7" in finding.message
    wrench[5, 3:] = 40.0 * np.cross([1.0, 0.0, 0.0], wrench[5, :3]) + np.array([0.0, 0.0, 1e4])
    assert find_record_faults(replace(record, wrench=wrench))["lever_arm"].rows == (5,)


def test_duplicated_rows_are_found_unless_the_gauge_is_coarse() -> None:
    record = simulate_correct_record(rotations=False)
    twice = rows_of(record, np.r_[np.arange(len(record)), 3:9])
    finding = find_record_faults(twice)["repeated_rows"]
    assert finding.rows == tuple(range(len(record), len(record) + 6))
    coarse = replace(record, displacement=np.round(record.displacement, 5))  # dial gauges with a resolution of 0.01 mm
    assert "repeated_rows" not in find_record_faults(coarse)


def test_impossible_and_unloaded_displacements_are_found() -> None:
    record = simulate_correct_record(rotations=False)
    d, w = record.displacement.copy(), record.wrench.copy()
    d[9] *= 100.0
    w[20] = 0.0
    report = find_record_faults(replace(record, displacement=d, wrench=w))
    assert report["impossible_displacement"].rows == (9,)
    assert report["moved_without_load"].rows == (20,)


def test_insufficient_data_is_reported() -> None:
    record = simulate_correct_record(poses=3, loads=1, repeats=1, rotations=False)
    assert set(find_record_faults(record)) == TOO_LITTLE
    assert "only 3 poses" in find_record_faults(record)["few_poses"].message
    two = simulate_correct_record(poses=2, loads=6, repeats=2)
    assert "only 2 poses" in find_record_faults(two)["few_poses"].message


def test_stiffness_far_from_the_cell_is_a_warning() -> None:
    finding = find_record_faults(simulate_correct_record(), TRUE_K / 12)["far_from_nominal"]
    assert finding.severity == "warning"


def test_empty_recording_is_refused() -> None:
    record = simulate_correct_record()
    with pytest.raises(InputError, match="every displacement is zero"):
        find_record_faults(replace(record, displacement=np.zeros_like(record.displacement)))


def test_errors_are_raised_together_with_the_remedy() -> None:
    _, robot, T = cell()
    e = build_load_test_experiment(simulate_correct_record(), robot, T)
    findings = [
        RecordFault(code="a", severity="error", message="first"),
        RecordFault(code="b", severity="error", message="second"),
        RecordFault(code="c", severity="warning", message="third"),
    ]
    with pytest.raises(InputError, match=r"first \[a\]; second \[b\]") as raised:
        refuse_record_faults(e, findings)
    assert "accept a" in str(raised.value)
    assert refuse_record_faults(e, findings, {"a", "b"}) == ["first", "second", "third"]


@pytest.mark.proof
def test_correct_records_raise_no_alarm() -> None:
    """200 correct recordings: typical noise, hanging weights, few and many poses, small loads, coarse gauges."""
    rng = np.random.default_rng(42)
    alarms = []
    for n in range(200):
        poses, loads, repeats = int(rng.integers(4, 20)), int(rng.integers(1, 5)), int(rng.integers(1, 4))
        size = float(np.exp(rng.uniform(np.log(100), np.log(2500))))
        k = TRUE_K * np.exp(rng.uniform(-1, 1, 6))
        wrench = None
        if rng.random() < 0.4:  # a weight hung from one lifting eye, or a rope pulled in one direction
            down = np.array([0.0, 0.0, -1.0]) if rng.random() < 0.5 else rng.standard_normal(3)
            force = np.linspace(0.3, 1.0, loads)[:, None] * size * down / np.linalg.norm(down)
            wrench = np.concatenate([force, np.cross(rng.uniform(-0.3, 0.3, 3), force)], axis=1)
        made = plan_load_tests(
            rng, poses, loads, repeats, size, float(rng.choice([0.0, 50.0, 200.0])), k, wrench=wrench
        )
        record = add_measurement_errors(made, rng, rotations=bool(rng.integers(2)), outliers=0.0)
        if rng.random() < 0.3:
            record = replace(record, displacement=np.round(record.displacement, 5))
        prior = [None, TRUE_K, k][rng.integers(3)]
        report = find_record_faults(record, prior)
        alarms += [(n, f.code, f.message) for f in report.values() if f.code not in TOO_LITTLE]
    assert len(alarms) < 2, alarms  # less than 1 %


@pytest.mark.parametrize(("unit", "newtons"), [("kilograms", 9.80665), ("kilonewtons", 1e3)])
def test_forces_in_another_unit_than_their_moments_are_refused(unit: str, newtons: float) -> None:
    """Only the forces are scaled: no stiffness explains both forces and moments."""
    record = simulate_correct_record(rotations=False)
    lever = np.array([0.03, -0.02, 0.05])  # m: with forces in kN, moment divided by force is still shorter than the arm
    wrench = record.wrench.copy()
    wrench[:, 3:] = 1e-3 * wrench[:, 3:] + np.cross(lever, wrench[:, :3])
    A = build_load_test_experiment(replace(record, wrench=wrench), *cell()[1:]).response()
    exact = replace(record, wrench=wrench, displacement=A @ (1.0 / TRUE_K))
    assert "force_units" not in find_record_faults(exact)
    finding = find_record_faults(replace(exact, wrench=wrench / np.repeat([newtons, 1.0], 3)))
    code = "force_units" if "force_units" in finding else "moment_units"
    assert finding[code].severity == "error"
    assert unit in finding[code].message


def test_wrong_unit_of_force_or_moment_follows_from_the_displacement() -> None:
    for displacement, wrench, says in (([1, 1], [1e-3, 1], "kilonewtons"), ([1, 1], [1, 1e3], "N·mm")):
        finding = find_record_faults(scale_record(simulate_correct_record(), displacement, wrench))["moment_units"]
        assert says in finding.message


@pytest.mark.parametrize("frame", ["base", "tool"])
def test_joint_positions_in_radians_are_refused(frame: str) -> None:
    _, robot, T = cell()
    record = simulate_correct_record(rotations=False)
    R = robot.compute_fk(record.q, T)[:, :3, :3]
    if frame == "tool":
        turned = [
            np.einsum("nji,nbj->nbi", R, v.reshape(len(v), -1, 3)).reshape(v.shape)
            for v in (record.wrench, record.displacement)
        ]
        record = replace(
            record, wrench=turned[0], displacement=turned[1], wrench_frame="tool", displacement_frame="tool"
        )
        assert not {"frames", "joint_units"} & set(find_record_faults(record))
    finding = find_record_faults(replace(record, q=np.radians(record.q)))["joint_units"]
    assert finding.severity == "error"
    assert "radians" in finding.message


@pytest.mark.parametrize(
    ("factor", "says"), [(1 / 25.4, "inches"), (9.80665, "loads in kilograms"), (60.0, "hundredths of a millimetre")]
)
@pytest.mark.parametrize("prior", [TRUE_K, TRUE_K * 1.5], ids=["nominal", "softer"])
def test_units_wrong_by_ten_to_a_hundred_are_suspected_by_name(factor: float, says: str, prior: np.ndarray) -> None:
    warning = find_record_faults(scale_record(simulate_correct_record(rotations=False), [factor], [1, 1]), prior)[
        "far_from_nominal"
    ]
    assert warning.severity == "warning"
    assert says in warning.message


def test_unit_wrong_by_a_hundred_is_named_in_the_error() -> None:
    assert (
        "hundredths"
        in find_record_faults(scale_record(simulate_correct_record(rotations=False), [120.0], [1, 1]))["units"].message
    )


def test_robot_size_replaces_a_missing_cell_stiffness() -> None:
    assert not find_record_faults(simulate_correct_record(rotations=False), None)
    assert (
        "kilograms"
        in find_record_faults(scale_record(simulate_correct_record(rotations=False), [1], [1 / 9.81, 1 / 9.81]), None)[
            "far_from_nominal"
        ].message
    )


def test_wrong_frame_is_refused_in_strong_noise() -> None:
    """In strong noise the correct interpretation explains one third of the readings.

    The ratio of the residuals could not decide; the comparison pose by pose can.
    """
    rng = np.random.default_rng(44)
    record = add_measurement_errors(plan_load_tests(rng, force=60.0, moment=6.0), rng, outliers=0.0)
    assert not set(find_record_faults(record)) & set(CODES)
    for sign, frame, code in ((-1.0, "base", "load_sign"), (1.0, "tool", "displacement_frame")):
        wrong = replace(record, wrench=sign * record.wrench, displacement_frame=frame)
        assert find_record_faults(wrong)[code].severity == "error"


def test_moments_about_the_base_are_refused_where_they_change_the_stiffness() -> None:
    """Three quarters of the readings are explained with the wrong reference point,
    but with compliances wrong by a factor."""
    _, robot, T = cell()
    record = simulate_correct_record(rotations=False)
    wrench = record.wrench.copy()
    wrench[:, 3:] += np.cross(robot.compute_fk(record.q, T)[:, :3, 3], wrench[:, :3])
    assert find_record_faults(replace(record, wrench=wrench))["moment_at_base"].severity == "error"


def test_impossible_joint_positions_are_named() -> None:
    record = simulate_correct_record(rotations=False)
    assert "outside_limits" not in find_record_faults(record)
    q = record.q.copy()
    q[4, 1] += 2 * np.pi
    finding = find_record_faults(replace(record, q=q))["outside_limits"]
    assert finding.rows == (4,)
    assert "line 6: joint 2 is outside its limits" in finding.message


def test_common_unit_factor_of_all_joints_is_reported() -> None:
    """The factor of pounds (4.4) is within the uncertainty of a stiffness;
    the fault is recognised because all joints have the same factor."""
    from machopt.measurement.identification.data_quality.unit_checks import describe_common_stiffness_factor

    output = describe_common_stiffness_factor(TRUE_K / 4.448 * np.array([1.0, 1.1, 0.95, 1.0, 1.05, 1.0]), TRUE_K)
    assert output is not None
    assert "pounds" in output
    assert "kilograms" in str(describe_common_stiffness_factor(TRUE_K[:3] / 9.81, TRUE_K[:3]))
    assert (
        describe_common_stiffness_factor(TRUE_K / 4.448 * np.array([1.0, 1.6, 0.95, 1.0, 1.05, 0.7]), TRUE_K) is None
    )  # a different factor for each joint
    # the same factor for all joints, but close to 1
    assert describe_common_stiffness_factor(TRUE_K * 1.1, TRUE_K) is None
    assert describe_common_stiffness_factor(TRUE_K[:2] / 4.448, TRUE_K[:2]) is None  # two joints are not enough
