"""Tables of other programs: the same readings for any column names, separators, units and number of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.errors import InputError, RecordingError
from machopt.measurement.recording import load_recording, workbook_tables
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
    """Return the names of the columns in a file with their suffixes."""
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
def test_every_spelling_gives_the_same_readings(name: str, tmp_path: Path) -> None:
    keys, files = VARIANTS[name]
    recording = load_recording(write(tmp_path, keys, files))
    np.testing.assert_allclose(np.degrees(recording.q), Q, atol=1e-9)
    assert recording.position is not None
    np.testing.assert_allclose(1e3 * recording.position, P, atol=1e-9)


def test_quaternion_in_the_order_x_y_z_w(tmp_path: Path) -> None:
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
def test_unreadable_content_is_named(name: str, tmp_path: Path) -> None:
    keys, files, output = WRONG[name]
    with pytest.raises(InputError, match=output):
        load_recording(write(tmp_path, keys, files))


def test_example_of_the_manual_is_read(tmp_path: Path) -> None:
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


def test_rows_without_tracker_target_are_left_out(tmp_path: Path) -> None:
    header, places = [*(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"], P.copy()
    places[[1, 4]] = 0.0
    recording = load_recording(write(tmp_path, "", {"data.csv": lines(header, np.hstack([Q, places]))}))
    assert recording.used is not None
    assert np.flatnonzero(~recording.used).tolist() == [1, 4]
    assert any("0, 0, 0" in w and "line 3" in w for w in recording.warnings)
    places[:] = 0.0  # zero is then not a lost target
    assert load_recording(write(tmp_path, "", {"data.csv": lines(header, np.hstack([Q, places]))})).used is None


def write_workbook(file: Path, header: list[str], rows: np.ndarray, sheet: str = "Messung", before: int = 0) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "Notes"
    page = book.create_sheet(sheet)
    for _ in range(before):
        page.append(["measured by hand"])
    page.append(header)
    for row in rows.tolist():
        page.append(row)
    book.save(file)


def check_readings(folder: Path) -> None:
    recording = load_recording(folder)
    np.testing.assert_allclose(np.degrees(recording.q), Q, atol=1e-9)
    assert recording.position is not None
    np.testing.assert_allclose(1e3 * recording.position, P, atol=1e-9)


def test_sheet_of_a_workbook(tmp_path: Path) -> None:
    header = [*(f"{j} [rad]" for j in J), "X [m]", "Y [m]", "Z [m]"]
    keys = f"{names(' [rad]', ' [m]')}format: {{sheet: Messung, skip_lines: 2}}\n"
    folder = write(tmp_path, keys.replace("data.csv", "data.xlsx"), {})
    (folder / "recording.yaml").write_text((folder / "recording.yaml").read_text().replace("data.csv", "data.xlsx"))
    write_workbook(folder / "data.xlsx", header, np.hstack([np.radians(Q), P / 1e3]), before=2)
    check_readings(folder)
    text = (folder / "recording.yaml").read_text().replace("Messung", "Mesung")
    (folder / "recording.yaml").write_text(text)
    with pytest.raises(RecordingError, match="Messung"):
        load_recording(folder)


def matlab_folder(tmp_path: Path, content: dict[str, object], columns: str) -> Path:
    from scipy.io import savemat

    folder = write(tmp_path, columns, {})
    text = (folder / "recording.yaml").read_text().replace("data.csv", "data.mat")
    (folder / "recording.yaml").write_text(text)
    savemat(folder / "data.mat", content, do_compression=True)
    return folder


MATRIX = "columns: {" + ", ".join(f'q{i}_deg: "Q(:,{i})"' for i in range(1, 7))


def test_vectors_matrices_and_structures_of_a_matlab_file(tmp_path: Path) -> None:
    columns = MATRIX + ', x_mm: "log.x", y_mm: "log.y", z_mm: "log.z"}\n'
    place = {name: P[:, n : n + 1] for n, name in enumerate("xyz")}
    check_readings(matlab_folder(tmp_path, {"Q": Q, "log": place, "label": "a", "rate": 8.0}, columns))


def test_matlab_columns_of_different_lengths_are_refused(tmp_path: Path) -> None:
    columns = MATRIX + ", x_mm: x, y_mm: y, z_mm: z}\n"
    folder = matlab_folder(tmp_path, {"Q": Q, "x": P[:-1, 0], "y": P[:, 1], "z": P[:, 2]}, columns)
    with pytest.raises(RecordingError, match="same number"):
        load_recording(folder)


@pytest.mark.parametrize("name", ["data.mat", "data.xlsx"])
@pytest.mark.parametrize(
    "content", [b"", b"no such file", b"MATLAB 7.3 MAT-file, Platform: GLNXA64", b"PK\x03\x04" + b"0" * 99]
)
def test_damaged_binary_files_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    folder = write(tmp_path, "", {})
    text = (folder / "recording.yaml").read_text().replace("data.csv", name)
    (folder / "recording.yaml").write_text(text)
    (folder / name).write_bytes(content)
    with pytest.raises(InputError):
        load_recording(folder)


def test_file_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workbook_tables, "MOST_UNPACKED", 1 << 20)
    folder = matlab_folder(tmp_path, {"Q": Q, "zeros": np.zeros((1 << 18, 2))}, MATRIX + "}\n")
    with pytest.raises(RecordingError, match="unpacks"):
        load_recording(folder)
    write_workbook(folder / "data.xlsx", list("abc"), np.zeros((40_000, 3)))
    (folder / "recording.yaml").write_text((folder / "recording.yaml").read_text().replace("data.mat", "data.xlsx"))
    with pytest.raises(RecordingError, match="unpacks"):
        load_recording(folder)
