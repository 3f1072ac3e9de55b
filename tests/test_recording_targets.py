"""Reflectors, tracker stations and motors of a recording folder: read, written, refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_recording_format import folder, read_refusal

from machopt.errors import InputError
from machopt.measurement.recording import load_recording, load_recordings, write_recording

Q = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
ABSOLUTE = "machopt_recording: 1\nkind: absolute\ndata: data.csv\nregistration: fit\n"
PLACES = "targets_mm: {1: [60, 0, 15], 2: [-30.5, 52, 15], nest: [0, 0, 40]}\n"
SEEN = (("1", 7), ("2", 7), ("nest", 7), ("1", 9), ("2", 9))
ROWS = "\n".join(f"10,20,30,40,{50 + n},60,{100 * n},{n * n},5,{t},{f}" for n, (t, f) in enumerate(SEEN))
TABLE = f"{Q},x_mm,y_mm,z_mm,target,frame\n{ROWS}\n"
TILTED = "tilt_link: 3\n"
MOTION = "machopt_recording: 1\nkind: motion\ndata: data.csv\n"
RATIOS = "gear_ratio: [100, -120, 100, 80, 80, 50]\n"


def test_each_row_has_a_target_and_a_station(tmp_path: Path) -> None:
    found = load_recording(folder(tmp_path, TABLE, ABSOLUTE + PLACES))
    assert [t.name for t in found.targets] == ["1", "2", "nest"]
    assert found.targets[1].place == pytest.approx((-0.0305, 0.052, 0.015))
    assert found.target is not None
    assert found.target.tolist() == [0, 1, 2, 0, 1]
    assert found.frame is not None
    assert found.frame.tolist() == [7, 7, 7, 9, 9]
    write_recording(tmp_path / "again", found)
    again = load_recording(tmp_path / "again")
    assert again.targets == found.targets
    np.testing.assert_array_equal(again.target, found.target)
    np.testing.assert_array_equal(again.frame, found.frame)


def test_list_of_places_is_numbered_from_1_or_from_0(tmp_path: Path) -> None:
    places = "targets_mm: [[60, 0, 15], [-30, 52, 15]]\n"
    for names in ("12", "01"):
        rows = "\n".join(f"10,20,30,40,{50 + n},60,{100 * n},{n * n},5,{names[n % 2]}" for n in range(4))
        found = load_recording(folder(tmp_path, f"{Q},x_mm,y_mm,z_mm,target\n{rows}\n", ABSOLUTE + places, names))
        assert [t.name for t in found.targets] == list(names)
        assert found.target is not None
        assert found.target.tolist() == [0, 1, 0, 1]


def test_stations_of_two_folders_differ(tmp_path: Path) -> None:
    paths = [folder(tmp_path, TABLE, ABSOLUTE + PLACES, name) for name in ("a", "b")]
    found = load_recordings(paths)
    assert found.frame is not None
    assert len(np.unique(found.frame)) == 4
    other = folder(tmp_path, TABLE, ABSOLUTE + PLACES.replace("-30.5", "-31"), "c")
    with pytest.raises(InputError, match="targets"):
        load_recordings([paths[0], other])


@pytest.mark.parametrize(
    ("yaml", "table", "parts"),
    [
        (ABSOLUTE, TABLE, ("column target needs targets_mm",)),
        (ABSOLUTE + PLACES, TABLE.replace(",nest,", ",3,"), ("line 4", "found '3'", "1, 2, nest")),
        (ABSOLUTE + PLACES.replace("15]", "abc]"), TABLE, ("targets_mm", "three numbers")),
        (ABSOLUTE + "targets_mm: {1: [60, 0]}\n", TABLE, ("targets_mm", "three numbers")),
        (ABSOLUTE + "targets_mm: 60\n", TABLE, ("targets_mm", "place of each target")),
        (ABSOLUTE.replace("fit", "fixed") + PLACES, TABLE, ("registration", "frame", "fit")),
        (ABSOLUTE + PLACES, TABLE.replace(",target", ",temperature_C").replace("nest", "3"), ("target is missing",)),
        (ABSOLUTE + "gear_ratio: [1]\n", TABLE, ("gear_ratio", "kind motion")),
        (ABSOLUTE + PLACES, TABLE.replace("x_mm,", "tilt_x_mrad,"), ("tilt_x_mrad", "tilt_link")),
        (ABSOLUTE + PLACES + "tilt_link: link_3\n", TABLE, ("tilt_x_mrad", "missing", "tilt_link link_3")),
        (MOTION, TABLE.replace("x_mm,", "tilt_x_mrad,"), ("tilt_x_mrad", "kind absolute")),
        (ABSOLUTE + PLACES + "tilt_link: [3]\n", TABLE, ("tilt_link", "link of the URDF")),
        (ABSOLUTE + PLACES + TILTED, TABLE.replace("frame", "tilt_x_mrad"), ("tilt_y_mrad is missing",)),
        (MOTION + "tilt_link: 3\n", TABLE, ("tilt_link", "kind absolute")),
        (MOTION + PLACES, TABLE, ("targets_mm", "kind absolute")),
    ],
)
def test_invalid_content_is_reported(tmp_path: Path, yaml: str, table: str, parts: tuple[str, ...]) -> None:
    read_refusal(folder(tmp_path, table, yaml), *parts)


def motion(*, motors: bool = True, current: bool = True, slip: float = 0.0) -> str:
    """Five samples of joints, motors and currents."""
    q = np.outer(np.arange(5.0), np.arange(1.0, 7.0))
    columns = {"time_s": np.arange(5) * 0.01} | {f"q{j + 1}_deg": q[:, j] for j in range(6)}
    if motors:
        turns = q * np.array([100, -120, 100, 80, 80, 50]) + 3.0
        turns[:, 4] += slip * np.arange(5)
        columns |= {f"motor{j + 1}_deg": turns[:, j] for j in range(6)}
    if current:
        columns |= {f"current{j + 1}_A": q[:, j] + 0.5 for j in range(6)}
    rows = zip(*columns.values(), strict=True)
    return ",".join(columns) + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows) + "\n"


def test_torque_is_current_times_gain_times_ratio(tmp_path: Path) -> None:
    found = load_recording(folder(tmp_path, motion(), MOTION + RATIOS + "motor_gain_Nm_per_A: [1, 1, 1, 2, 2, 0.5]\n"))
    assert found.torque is not None
    assert found.current is not None
    np.testing.assert_allclose(found.torque, found.current * [100, -120, 100, 160, 160, 25])
    assert any("passes for" in w for w in found.warnings)
    assert any("motor1_deg" in w for w in found.warnings)


def test_coupling_matrix_converts_motor_to_joint_values(tmp_path: Path) -> None:
    C = np.diag([0.01, -1 / 120, 0.01, 0.0125, 0.0125, 0.02])
    C[5, 4] = 0.001
    yaml = f"{MOTION}coupling_matrix: {C.tolist()}\nmotor_gain_Nm_per_A: [1, 1, 1, 1, 1, 1]\n"
    lines = [line.split(",") for line in motion().splitlines()]
    keep = [n for n, name in enumerate(lines[0]) if not name.startswith("q")]
    bare = "\n".join(",".join(line[n] for n in keep) for line in lines) + "\n"
    found = load_recording(folder(tmp_path, bare, yaml))
    turns = np.outer(np.arange(5.0), np.arange(1.0, 7.0)) * [100, -120, 100, 80, 80, 50] + 3.0
    np.testing.assert_allclose(found.q, np.radians(turns @ C.T), atol=1e-12)
    assert found.torque is not None
    assert found.current is not None
    # the power of the joints equals that of the motors
    power = np.einsum("nj,nj->n", found.torque, np.radians(turns) @ C.T)
    np.testing.assert_allclose(power, np.einsum("nj,nj->n", found.current, np.radians(turns)))


@pytest.mark.parametrize(
    ("yaml", "table", "parts"),
    [
        (MOTION, motion(current=False), ("motor1_deg", "gear_ratio")),
        (MOTION + "motor_gain_Nm_per_A: [1, 1, 1, 1, 1, 1]\n", motion(), ("motor_gain_Nm_per_A", "gear_ratio")),
        (MOTION + RATIOS + "motor_gain_Nm_per_A: [1, 1, 1, 1, 1, 1]\n", motion(current=False), ("current1_A",)),
        (MOTION + RATIOS.replace("50]", "50, 1]"), motion(), ("7 motors", "6 joints")),
        (MOTION + RATIOS.replace("50]", "0]"), motion(), ("gear_ratio", "zero")),
        (MOTION + RATIOS + "coupling_matrix: [[1]]\n", motion(), ("coupling_matrix", "gear_ratio")),
        (MOTION + "coupling_matrix: [[1, 1], [1, 1]]\n", motion(), ("singular",)),
        (MOTION + RATIOS, motion(slip=30.0), ("motor5_deg", "qse5_deg")),
    ],
)
def test_impossible_motors_are_refused(tmp_path: Path, yaml: str, table: str, parts: tuple[str, ...]) -> None:
    read_refusal(folder(tmp_path, table, yaml), *parts)


def test_empty_tilts_of_a_link_are_preserved(tmp_path: Path) -> None:
    lines = TABLE.splitlines()
    cells = ("tilt_x_mrad,tilt_y_mrad", "0.5,-0.25", ",", "nan,NaN", "1,2", "0,0")
    table = "\n".join(f"{line},{cell}" for line, cell in zip(lines, cells, strict=True)) + "\n"
    yaml = ABSOLUTE + PLACES + TILTED + "standard_uncertainty: {tilt_mrad: 0.02}\n"
    found = load_recording(folder(tmp_path, table, yaml))
    nan = [np.nan, np.nan]
    np.testing.assert_allclose(found.tilt, 1e-3 * np.array([[0.5, -0.25], nan, nan, [1, 2], [0, 0]]))
    assert (found.tilt_link, found.uncertainty.tilt) == ("3", pytest.approx(2e-5))
    write_recording(tmp_path / "again", found)
    again = load_recording(tmp_path / "again")
    np.testing.assert_array_equal(again.tilt, found.tilt)
    assert (again.tilt_link, again.uncertainty) == (found.tilt_link, found.uncertainty)
    read_refusal(folder(tmp_path, table.replace("0.5,-0.25", "0.5,x"), yaml, "b"), "line 2", "tilt_y_mrad", "'x'")
    empty = "\n".join(f"{line},{'tilt_x_mrad,tilt_y_mrad' if n == 0 else ','}" for n, line in enumerate(lines)) + "\n"
    read_refusal(folder(tmp_path, empty, yaml, "c"), "tilt_x_mrad", "holds no number")
