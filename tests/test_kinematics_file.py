"""kinematics.yaml end to end: reader, mapping between encoder angles and true angles, planned and verified motion."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import KR500, PASS, changed_cell, optimize, toolpath

from machopt.cell.cell_reader import load_cell
from machopt.cell.kinematics_file import load_kinematics, write_kinematics
from machopt.data_types.cell import JointLimits
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.effects.kinematic_corrections import extend_kinematics
from machopt.effects.measured_angle_range import compute_measured_range
from machopt.errors import InputError
from machopt.kinematics.encoder_corrections import EncoderCorrection, build_encoder_correction
from machopt.kinematics.urdf_loading import load_robot
from machopt.options.plan_option_reader import load_options
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.kinematics.encoder_correction import check_correction_range, compute_true_angles
from machopt.verification.motion.motion_verification import verify_motion

OFFSET = KinematicCorrection("joint_zero_offset", "joint:3", {"offset_deg": 0.2})
WAVES = KinematicCorrection(
    "transmission_error", "joint:1", {"per_turn": [3, 100.5], "cos_arcsec": [30.0, 40.0], "sin_arcsec": [-12.0, 20.0]}
)
WAVE = KinematicCorrection("transmission_error", "joint:5", {"per_turn": 2, "cos_arcsec": 60.0, "sin_arcsec": 0.0})
COUPLING = KinematicCorrection("joint_coupling", "joint:4-5", {"ratio": 1e-3})
ALL = KinematicCorrections((OFFSET, WAVES, WAVE, COUPLING))
HEAD = "machopt_kinematics: 1\ncorrections:\n"


def correction(kinematics: KinematicCorrections = ALL) -> EncoderCorrection:
    made = build_encoder_correction(kinematics)
    assert made is not None
    return made


# the file -------------------------------------------------------------------------------------------------------


def test_written_file_is_read_back(tmp_path: Path) -> None:
    write_kinematics(tmp_path / "k.yaml", ALL)
    assert load_kinematics(tmp_path / "k.yaml") == ALL
    small = KinematicCorrections((KinematicCorrection("joint_coupling", "joint:5-6", {"ratio": 1e-7}),))
    write_kinematics(tmp_path / "k.yaml", small)  # a YAML 1.1 reader would read 1e-07 as text
    assert load_kinematics(tmp_path / "k.yaml") == small
    assert "1.0e-07" in (tmp_path / "k.yaml").read_text()
    write_kinematics(tmp_path / "k.yaml", KinematicCorrections())
    assert build_encoder_correction(load_kinematics(tmp_path / "k.yaml")) is None


def entry(effect: str, location: str, parameters: str) -> str:
    return f'  - {{effect: {effect}, location: "{location}", parameters: {{{parameters}}}}}\n'


REFUSED = [
    (entry("joint_zero_ofset", "joint:1", "offset_deg: 1"), ["line 3", "did you mean 'joint_zero_offset'?"]),
    (entry("link_compliance", "link:1", "EI: 1"), ["link_compliance", "stiffness.yaml"]),
    (entry("joint_zero_offset", "joint:13", "offset_deg: 1"), ["corrections[0].location", "'joint:13'", "joint:12"]),
    (entry("joint_coupling", "joint:5-4", "ratio: 0.001"), ["'joint:5-4'", "i < j"]),
    (entry("joint_zero_offset", "joint:1", "offset_rad: 1"), ["unknown key 'offset_rad'", "offset_deg"]),
    (entry("joint_zero_offset", "joint:1", ""), ["offset_deg is missing"]),
    (entry("joint_zero_offset", "joint:1", "offset_deg: x"), ["found the text 'x'", "degrees"]),
    (entry("joint_zero_offset", "joint:1", "offset_deg: [1]"), ["found a list of 1", "a number"]),
    (entry("joint_zero_offset", "joint:1", "offset_deg: 30"), ["found 30", "at most 10 degrees"]),
    (entry("transmission_error", "joint:1", "per_turn: 0, cos_arcsec: 1, sin_arcsec: 1"), ["per_turn", "more than 0"]),
    (entry("transmission_error", "joint:1", "per_turn: [1, 2], cos_arcsec: 1, sin_arcsec: 1"), ["differ in length"]),
    (
        entry("transmission_error", "joint:1", "per_turn: [2, 2], cos_arcsec: [1, 1], sin_arcsec: [1, 1]"),
        ["each order once"],
    ),
    (
        entry("transmission_error", "joint:2", "per_turn: 200, cos_arcsec: 600, sin_arcsec: 0"),
        ["joint 2", "0.58 rad per rad", "0.5"],
    ),
    (
        entry("transmission_error", "joint:2", "per_turn: 2, cos_arcsec: 6, sin_arcsec: 0, range_deg: [10, -5]"),
        ["range_deg", "[10, -5]", "the lower first"],
    ),
    (entry("joint_zero_offset", "joint:1", "offset_deg: 1, range_deg: [1, 2]"), ["unknown key 'range_deg'"]),
    (
        entry("transmission_error", "joint:2", "per_turn: 1, cos_arcsec: 4000, sin_arcsec: 0, range_deg: [-5, 10]"),
        ["joint 2", "0.51 rad per rad"],  # 0.02 from the wave, 35 / 16 of its amplitude over 5 degrees
    ),
    (2 * entry("joint_zero_offset", "joint:1", "offset_deg: 1"), ["line 4", "is given twice"]),
    ("  - {effect: joint_zero_offset}\n", ["required key is missing"]),
]


@pytest.mark.parametrize(("rows", "parts"), REFUSED)
def test_refusals_name_place_found_and_expected(tmp_path: Path, rows: str, parts: list[str]) -> None:
    (tmp_path / "k.yaml").write_text(HEAD + rows)
    with pytest.raises(InputError) as caught:
        load_kinematics(tmp_path / "k.yaml")
    message = str(caught.value)
    assert "k.yaml" in message
    for part in parts:
        assert part in message, message


def test_new_corrections_add_to_known_ones() -> None:
    more = (
        KinematicCorrection("joint_zero_offset", "joint:3", {"offset_deg": -0.05}),
        KinematicCorrection("joint_zero_offset", "joint:2", {"offset_deg": 0.01}),
        KinematicCorrection("transmission_error", "joint:5", {"per_turn": 2, "cos_arcsec": 1.0, "sin_arcsec": 4.0}),
        KinematicCorrection("transmission_error", "joint:5", {"per_turn": 7, "cos_arcsec": 5.0, "sin_arcsec": 6.0}),
    )
    both = extend_kinematics(ALL, more)
    assert {(c.effect, c.location): c.parameters for c in both.corrections}["transmission_error", "joint:5"] == {
        "per_turn": [2.0, 7.0],
        "cos_arcsec": [61.0, 5.0],
        "sin_arcsec": [4.0, 6.0],
    }
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    parts = (
        correction().compute_correction(q)
        + correction(KinematicCorrections(more[:3])).compute_correction(q)
        + correction(KinematicCorrections(more[3:])).compute_correction(q)
    )
    np.testing.assert_allclose(correction(both).compute_correction(q), parts, atol=1e-15)
    assert extend_kinematics(None, ()) == KinematicCorrections()


RANGED = KinematicCorrections(
    (
        OFFSET,
        *(
            KinematicCorrection(c.effect, c.location, {**c.parameters, "range_deg": ends})
            for c, ends in ((WAVES, [-40.0, 25.5]), (WAVE, [-90.0, 10.0]))
        ),
    )
)


def test_waves_apply_in_their_measured_range_and_fade_out_beyond() -> None:
    q = np.radians(np.linspace(-60.0, 60.0, 2401))[:, None] * np.ones(6)
    ranged, whole = correction(RANGED), correction(KinematicCorrections((OFFSET, WAVES, WAVE)))
    np.testing.assert_allclose(
        compute_true_angles(RANGED, q), ranged.compute_true_angles(q), atol=2e-15
    )  # the verifier's own code
    inside = np.abs(np.degrees(q[:, 0]) + 7.25) <= 32.75
    np.testing.assert_array_equal(ranged.compute_correction(q)[inside, 0], whole.compute_correction(q)[inside, 0])
    gone = (np.degrees(q[:, 0]) < -45.0) | (np.degrees(q[:, 0]) > 30.5)
    assert not ranged.compute_correction(q)[gone, 0].any()
    assert (ranged.compute_correction(q)[gone, 2] == np.radians(0.2)).all()  # an offset applies everywhere
    np.testing.assert_allclose(ranged.compute_encoder_angles(ranged.compute_true_angles(q)), q, atol=2e-15)
    h = 1e-5
    for part in ranged.parts:  # the first three derivatives, including the fading ends of the range
        for order in (1, 2, 3):
            slope = (part.compute_angle(q + h, order - 1) - part.compute_angle(q - h, order - 1)) / (2.0 * h)
            size = max(float(np.abs(slope).max()), 1e-9)
            # the fourth derivative is discontinuous
            np.testing.assert_allclose(part.compute_angle(q, order), slope, atol=1e-3 * size)


def test_planner_and_verifier_report_angles_beyond_the_measured_range(tmp_path: Path) -> None:
    q = np.radians(np.array([[-30.0] * 6, [20.0] * 6]))
    (output,) = correction(RANGED).list_range_violations(q)
    assert "joint 5" in output
    assert "-90.0° to 10.0°" in output
    assert "-30.0° to 20.0°" in output
    (check,) = check_correction_range(RANGED, q)
    assert check.passed is None  # information only
    assert "joint:5" in check.name
    assert "1 of 2 samples" in check.where
    assert correction(ALL).list_range_violations(q) == []
    assert check_correction_range(ALL, q) == []
    write_kinematics(tmp_path / "k.yaml", RANGED)
    assert load_kinematics(tmp_path / "k.yaml") == RANGED


def test_waves_of_another_range_are_added_to_known_ones() -> None:
    both = extend_kinematics(ALL, RANGED.corrections[1:])
    assert len(both.corrections) == len(ALL.corrections) + 2
    q = np.random.default_rng(4).uniform(-2, 2, (5, 6))
    parts = correction().compute_correction(q) + correction(
        KinematicCorrections(RANGED.corrections[1:])
    ).compute_correction(q)
    np.testing.assert_allclose(correction(both).compute_correction(q), parts, atol=1e-15)
    again = extend_kinematics(RANGED, RANGED.corrections[1:])  # the same range is merged
    assert [c.parameters.get("range_deg") for c in again.corrections] == [None, [-40.0, 25.5], [-90.0, 10.0]]
    assert again.corrections[2].parameters["cos_arcsec"] == 120.0


def test_range_excludes_isolated_ends() -> None:
    q = np.radians(np.r_[-90.0, np.linspace(-180.0, -122.0, 50)])
    assert compute_measured_range(q) == [-180.0, -122.0]
    # with two readings it is unknown which one is isolated
    assert compute_measured_range(np.radians([0.0, 120.0])) == [0.0, 120.0]


# the mapping ----------------------------------------------------------------------------------------------------


def test_two_programs_invert_the_map() -> None:
    q = np.random.default_rng(0).uniform(-3, 3, (500, 6))
    placed = correction().compute_true_angles(q)
    np.testing.assert_allclose(correction().compute_encoder_angles(placed), q, atol=2e-15)  # rounding of 3 rad
    np.testing.assert_allclose(compute_true_angles(ALL, q), placed, atol=2e-15)  # the verifier's own code
    assert np.degrees(placed - q)[0, 2] == pytest.approx(0.2, abs=1e-12)
    np.testing.assert_allclose(
        placed[:, 4] - q[:, 4], 1e-3 * q[:, 3] + np.radians(1 / 60) * np.cos(2 * q[:, 4]), atol=2e-15
    )
    q[3, 2] = np.nan
    assert np.isnan(correction().compute_encoder_angles(q)[3, 2])
    assert np.isfinite(correction().compute_encoder_angles(q)[4]).all()


def test_path_of_encoder_angles_has_correct_derivatives() -> None:
    """The Taylor series at h is compared with the mapping itself: the remainder is of fourth order."""
    rng = np.random.default_rng(2)
    D = rng.normal(size=(40, 4, 6)) * np.array([1.0, 0.3, 0.3, 0.3])[None, :, None]
    E = correction().compute_encoder_path(D)
    errors = []
    for h in (2e-3, 1e-3):
        powers = np.array([1.0, h, h**2 / 2, h**3 / 6])
        exact = correction().compute_encoder_angles(np.einsum("k,mkj->mj", powers, D))
        errors.append(np.abs(np.einsum("k,mkj->mj", powers, E) - exact).max())
    assert errors[1] < errors[0] / 12  # 16 without rounding
    assert errors[1] < 1e-9


def test_limits_of_true_angles_keep_the_encoders_within_theirs() -> None:
    ones = np.ones(6)
    low, high = -np.array([3.0, 2.0, 2.5, 6.0, 2.0, 6.0]), np.array([3.0, 1.0, 2.5, 6.0, 2.0, 6.0])
    limits = JointLimits(low, high, ones, ones, ones)
    inner = correction().compute_true_limits(limits)
    rng = np.random.default_rng(3)
    corners = np.where(rng.random((2000, 6)) < 0.5, inner.lower, inner.upper)
    q = correction().compute_encoder_angles(corners)
    assert (q >= limits.lower - 1e-12).all()
    assert (q <= limits.upper + 1e-12).all()
    # the margin is at most what the coupling can take: 6e-3 rad at joint 5
    offset = np.radians([0.0, 0.0, OFFSET.parameters["offset_deg"], 0.0, 0.0, 0.0])
    np.testing.assert_allclose(inner.upper - offset, limits.upper, atol=2 * 6e-3 + 1e-3)
    np.testing.assert_allclose((inner.lower - offset)[[1, 2, 3, 5]], limits.lower[[1, 2, 3, 5]], atol=1e-15)


# the job --------------------------------------------------------------------------------------------------------


def plan_milling_pass(folder: Path, kinematics: KinematicCorrections | None) -> tuple[Path, Path, Path]:
    """Return (cell, toolpath, out) of one milling pass."""
    folder.mkdir()
    edits = [("stiffness: stiffness.yaml", "stiffness: stiffness.yaml\nkinematics: kinematics.yaml")]
    cell = changed_cell(folder, *edits if kinematics is not None else ())
    if kinematics is not None:
        write_kinematics(cell / "kinematics.yaml", kinematics)
    table = toolpath(folder, PASS)
    assert optimize(cell, table, folder / "out") == 0
    return cell, table, folder / "out"


def joints(file: Path) -> np.ndarray:
    with file.open() as lines:
        rows = list(csv.DictReader(lines))
    return np.radians([[float(r[f"q{i}_deg"]) for i in range(1, 7)] for r in rows])


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    return plan_milling_pass(tmp_path_factory.mktemp("job") / "plain", None)


@pytest.fixture(scope="module", params=["offset", "all"])
def corrected(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    kinematics = KinematicCorrections((OFFSET,)) if request.param == "offset" else ALL
    return plan_milling_pass(tmp_path_factory.mktemp("job") / request.param, kinematics)


def test_exported_joints_move_the_arm_to_the_toolpath(corrected: tuple[Path, Path, Path]) -> None:
    """To 1 µm at every point of points.csv (six decimals of a degree are 0.05 µm at 3 m), by the verifier's mapping."""
    cell = load_cell(corrected[0])
    robot, path = load_robot(cell), read_toolpath(corrected[1])
    q = joints(corrected[2] / "points.csv")
    T = np.linalg.inv(np.linalg.inv(cell.T_world_base) @ cell.workpiece.T_link_workpiece)
    placed = T @ robot.compute_fk(compute_true_angles(cell.kinematics, q), cell.tool.T_flange_tcp)
    assert np.linalg.norm(placed[:, :3, 3] - path.position, axis=1).max() < 1e-6
    naive = T @ robot.compute_fk(q, cell.tool.T_flange_tcp)
    # the test would fail without the correction
    assert np.linalg.norm(naive[:, :3, 3] - path.position, axis=1).min() > 1e-4
    motion = joints(corrected[2] / "trajectory.csv")
    # home is given as encoder angles
    np.testing.assert_allclose(motion[[0, -1]], cell.home[None].repeat(2, 0), atol=1e-11)


def test_verification_computes_the_corrections_independently(corrected: tuple[Path, Path, Path]) -> None:
    cell, path = load_cell(corrected[0]), read_toolpath(corrected[1])
    options = load_options(cell.plan, None, [])
    found = verify_motion(cell, path, corrected[2], options=options)
    assert found.ok
    assert next(c for c in found.checks if c.name == "path").value < 0.02  # mm, corners rounded by up to 15 µm
    without = verify_motion(replace(cell, kinematics=None), path, corrected[2], options=options)
    assert {c.name for c in without.failed} >= {"path", "points.csv on the toolpath"}


def test_result_names_the_file_and_limits_hold(corrected: tuple[Path, Path, Path]) -> None:
    result = json.loads((corrected[2] / "result.json").read_text())
    assert "kinematics.yaml" in result["inputs"]
    checks = {c["name"]: c for c in result["verification"]["checks"]}
    for name in ("joint velocity", "joint acceleration", "joint jerk"):  # checked for the exported angles
        assert checks[name]["passed"]


def test_zero_offset_alone_shifts_one_column(plain: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """If nothing else changes, the encoder angle
    of q3 is the true angle minus 0.2° while cutting; other joints are equal."""
    _, _, out = plan_milling_pass(tmp_path / "offset", KinematicCorrections((OFFSET,)))
    a, b = joints(plain[2] / "points.csv"), joints(out / "points.csv")
    np.testing.assert_allclose(np.degrees(b - a), np.array([[0, 0, -0.2, 0, 0, 0]]).repeat(len(a), 0), atol=2e-6)


def test_file_without_corrections_changes_no_byte(plain: tuple[Path, Path, Path], tmp_path: Path) -> None:
    _, _, out = plan_milling_pass(tmp_path / "empty", KinematicCorrections())
    for name in ("trajectory.csv", "points.csv", "pass_csv.src", "pass_csv.dat"):
        assert (out / name).read_bytes() == (plain[2] / name).read_bytes()


def test_shipped_cell_has_no_corrections() -> None:
    assert load_cell(KR500).kinematics is None
