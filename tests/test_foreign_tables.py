"""Tables as other programs write them: the same readings, whatever the names, marks, units and number of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError
from machopt.measurement.recording import load_recording
from machopt.numerics.array_types import Array

RNG = np.random.default_rng(3)
Q: Array = RNG.uniform(-90.0, 90.0, (6, 6)).round(3)
P: Array = RNG.uniform(-900.0, 900.0, (6, 3)).round(4)
DRAWN: Array = RNG.standard_normal((6, 4))
QUAT: Array = DRAWN / np.linalg.norm(DRAWN, axis=1, keepdims=True)
HEAD = "machopt_recording: 1\nkind: absolute\nregistration: fit\ndata: data.csv\n"


def write(folder: Path, keys: str, files: dict[str, bytes]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.yaml").write_text(HEAD + keys, encoding="utf-8")
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def lines(header: list[str], values: Array, mark: str = ",", decimal: str = ".", before: str = "") -> bytes:
    rows = [mark.join(repr(float(v)).replace(".", decimal) for v in row) for row in values]
    return (before + "\n".join([mark.join(header), *rows]) + "\n").encode("latin-1")


J = [f"J{i}" for i in range(1, 7)]


def names(angle: str = "", length: str = "") -> str:
    """Names of the columns in a file, with what stands behind them."""
    joints = ", ".join(f'q{i}_deg: "J{i}{angle}"' for i in range(1, 7))
    return f'columns: {{{joints}, x_mm: "X{length}", y_mm: "Y{length}", z_mm: "Z{length}"}}\n'


STEP = np.arange(6.0)[:, None]
VARIANTS: dict[str, tuple[str, dict[str, bytes]]] = {
    "our own names": (
        "",
        {"data.csv": lines([*(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"], np.hstack([Q, P]))},
    ),
    "semicolons and decimal commas": (
        f'{names("", "")}format: {{separator: ";", decimal: ","}}\n',
        {"data.csv": lines([*J, "X", "Y", "Z"], np.hstack([Q, P]), ";", ",")},
    ),
    "units in brackets": (
        f"{names(' [rad]', ' (m)')}",
        {
            "data.csv": lines(
                [*(f"{j} [rad]" for j in J), "X (m)", "Y (m)", "Z (m)"], np.hstack([np.radians(Q), P / 1e3])
            )
        },
    ),
    "units of the whole file, tabs": (
        f"{names('', '')}format: {{separator: tab, angle_unit: rad, length_unit: m}}\n",
        {"data.csv": lines([*J, "X", "Y", "Z"], np.hstack([np.radians(Q), P / 1e3]), "\t")},
    ),
    "spaces, a preamble and further columns": (
        f"{names('', '')}format: {{separator: space, skip_lines: 2, encoding: latin-1}}\n",
        {"data.csv": lines([*J, "X", "Y", "Z", "T"], np.hstack([Q, P, STEP]), "  ", before="Me\xdfreihe 7\n20 °C\n")},
    ),
    "two files, row by row": (
        f"{names('', '')}join: {{files: [tracker.csv]}}\n",
        {"data.csv": lines(J, Q), "tracker.csv": lines(["X", "Y", "Z"], P)},
    ),
    "two files by a key in another order": (
        f"{names('', '')}join: {{files: [tracker.csv], by: n}}\n",
        {
            "data.csv": lines(["n", *J], np.hstack([STEP, Q])),
            "tracker.csv": lines(["n", "X", "Y", "Z"], np.hstack([STEP, P])[::-1]),
        },
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_every_way_of_writing_gives_the_same_readings(name: str, tmp_path: Path) -> None:
    keys, files = VARIANTS[name]
    recording = load_recording(write(tmp_path, keys, files))
    np.testing.assert_allclose(np.degrees(recording.q), Q, atol=1e-9)
    assert recording.position is not None
    np.testing.assert_allclose(1e3 * recording.position, P, atol=1e-9)


def test_a_quaternion_in_the_order_x_y_z_w(tmp_path: Path) -> None:
    header = [*(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]
    other = np.hstack([Q, P, QUAT[:, [1, 2, 3, 0]]])
    folder = write(tmp_path, "format: {quaternion: xyzw}\n", {"data.csv": lines(header, other)})
    quaternion = load_recording(folder).quaternion
    assert quaternion is not None
    np.testing.assert_allclose(quaternion, QUAT, atol=1e-9)


PLAIN = {"data.csv": lines([*J, "X", "Y", "Z"], np.hstack([Q, P]))}
WRONG = {
    "no such column": (f"{names('', '')}".replace("J3", "Axis 3"), PLAIN, "Axis 3"),
    "no such name of ours": ('columns: {q1: "J1"}\n', PLAIN, "q1"),
    "an impossible unit": (
        f"{names(' [bar]', '')}",
        {"data.csv": lines([*(f"{j} [bar]" for j in J), "X", "Y", "Z"], np.hstack([Q, P]))},
        "bar",
    ),
    "files of different length": (
        f"{names('', '')}join: {{files: [b.csv]}}\n",
        {"data.csv": lines(J, Q), "b.csv": lines(["X", "Y", "Z"], P[:5])},
        "5 rows",
    ),
    "a key that is not there": (
        f"{names('', '')}join: {{files: [b.csv], by: n}}\n",
        {"data.csv": lines(["n", *J], np.hstack([STEP, Q])), "b.csv": lines(["X", "Y", "Z"], P)},
        "'n'",
    ),
    "a file outside": (f"{names('', '')}join: {{files: [../b.csv]}}\n", PLAIN, "outside"),
    "an unknown encoding": ("format: {encoding: klingon}\n", PLAIN, "klingon"),
    "a cell that is no number": (
        f"{names('', ' [m]')}",
        {"data.csv": lines([*J, "X [m]", "Y [m]", "Z [m]"], np.hstack([Q, P])).replace(b"\n", b"\nx", 2)},
        "line 2",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_read_is_named(name: str, tmp_path: Path) -> None:
    keys, files, said = WRONG[name]
    with pytest.raises(InputError, match=said):
        load_recording(write(tmp_path, keys, files))


def test_the_example_of_the_manual_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[1] / "docs" / "recordings.md").read_text(encoding="utf-8")
    angles, places, keys = (block.split("\n", 1)[1] for block in text.split("```")[1:6:2])
    for name, content in (("angles.csv", angles), ("tracker.csv", places), ("recording.yaml", keys)):
        (tmp_path / name).write_text(content, encoding="utf-8")
    recording = load_recording(tmp_path)
    assert recording.position is not None
    assert recording.temperature is not None
    np.testing.assert_allclose(recording.position[0], [1.70218, 0.11527, 1.35102])
    np.testing.assert_allclose(recording.q[1, :2], [0.4363, -1.3963])
    assert recording.temperature.tolist() == [21.3, 21.4]


def test_a_tracker_that_lost_its_target_is_left_out(tmp_path: Path) -> None:
    header, places = [*(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"], P.copy()
    places[[1, 4]] = 0.0
    recording = load_recording(write(tmp_path, "", {"data.csv": lines(header, np.hstack([Q, places]))}))
    assert recording.used is not None
    assert np.flatnonzero(~recording.used).tolist() == [1, 4]
    assert any("0, 0, 0" in w and "line 3" in w for w in recording.warnings)
    places[:] = 0.0  # then it is no lost target
    assert load_recording(write(tmp_path, "", {"data.csv": lines(header, np.hstack([Q, places]))})).used is None
