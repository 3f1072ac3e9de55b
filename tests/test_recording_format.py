"""Recording folders: reading, writing and every kind of refusal."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.errors import InputError
from machopt.measurement.recording import load_recording, load_recordings, write_recording
from machopt.measurement.recording.recording_columns import CHANNELS
from machopt.measurement.recording.recording_merge import number_poses

YAML = """machopt_recording: 1
kind: deflection
data: data.csv
wrench_frame: tool
displacement_frame: base
registration: fit
wrench_point_mm: [0, 10, 200]
standard_uncertainty: {displacement_mm: 0.015, rotation_mrad: 0.05, force_N: 5, moment_Nm: 0, joint_deg: 0.005}
notes: by hand
"""
Q = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
HEAD = f"pose,cycle,session,{Q},fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,dx_mm,dy_mm,dz_mm,rx_mrad,ry_mrad,rz_mrad,branch"
GOOD = f"""# a comment
{HEAD}

1,1,2,0,-90,90,0,45.5,180,0,0,-500,1,2,3,0.1,0.2,-0.3,1,2,3,load
1,1,2,0,-90,90,0,45.5,180,0,0,0,0,0,0,0.01,0,0,0,0,0,unload
7,1,2,30,-90,90,0,45.5,180,0,0,-1e3,0,0,0,0,0,-0.6,0,0,0,
"""
PLAIN = f"{Q},fx_N,fy_N,fz_N,dx_mm,dy_mm,dz_mm"
ROW = "10.5,20,30,40,50,60,1,2,3,0.1,0.2,0.3"
DEG = np.pi / 180
HALF_DIGIT = {c.field: 0.51 * 10.0**-c.decimals * c.si for c in CHANNELS} | {
    "wrench_point": 1e-11
}  # m; twelve printed digits


def folder(tmp_path: Path, data: str | bytes = GOOD, yaml: str = YAML, name: str = "rec") -> Path:
    path = tmp_path / name
    path.mkdir(exist_ok=True)
    (path / "recording.yaml").write_text(yaml, encoding="utf-8")
    (path / "data.csv").write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def write_recording_yaml(kind: str = "deflection", data: str = "data.csv") -> str:
    return f"machopt_recording: 1\nkind: {kind}\ndata: {data}\nwrench_frame: base\ndisplacement_frame: base\n"


def read_refusal(path: Path, *parts: str) -> str:
    with pytest.raises(InputError) as caught:
        load_recording(path)
    text = str(caught.value)
    for part in parts:
        assert part in text
    return text


# ---------------------------------------------------------------- accepted content


def test_every_key_and_column_in_si(tmp_path: Path) -> None:
    path = folder(tmp_path)
    r = load_recording(path)
    assert (r.kind, r.source, len(r)) == ("deflection", "rec", 3)
    assert r.q[0] == pytest.approx(np.array([0, -90, 90, 0, 45.5, 180]) * DEG)
    assert r.pose.tolist() == [1, 1, 7]
    assert r.session.tolist() == [2, 2, 2]
    assert r.line.tolist() == [4, 5, 6]
    assert r.wrench is not None
    assert r.displacement is not None
    assert r.wrench[0].tolist() == [0, 0, -500, 1, 2, 3]
    assert r.wrench[2, 2] == -1000
    assert r.displacement[0] == pytest.approx([1e-4, 2e-4, -3e-4, 1e-3, 2e-3, 3e-3])
    assert r.branch is not None
    assert r.branch.tolist() == [1, -1, 0]
    assert (r.wrench_frame, r.displacement_frame, r.registration) == ("tool", "base", "fit")
    assert r.wrench_point == pytest.approx([0, 0.01, 0.2])
    u = r.uncertainty
    assert (u.force, u.moment) == (5, 0)
    assert (u.displacement, u.rotation, u.joint) == pytest.approx((1.5e-5, 5e-5, 0.005 * DEG))
    assert r.notes == "by hand"
    assert r.stated_labels == {"pose", "cycle", "session"}
    assert r.warnings == ()
    assert r.files == ("data.csv",)
    assert r.place(1) == "line 5"
    assert r.position is None
    assert not r.q.flags.writeable
    assert not r.wrench.flags.writeable
    by_file = load_recording(path / "recording.yaml")
    assert by_file.source == "rec"
    assert np.array_equal(by_file.q, r.q)


def test_bom_crlf_quotes_and_spaces_are_accepted(tmp_path: Path) -> None:
    plain_one = load_recording(folder(tmp_path))
    odd = "\ufeff" + GOOD.replace(",load", ',"load"').replace(",", " , ").replace("\n", "\r\n")
    assert_same(load_recording(folder(tmp_path, odd)), plain_one)


def test_absolute_and_motion(tmp_path: Path) -> None:
    text = f"{Q},x_mm,y_mm,z_mm,qw,qx,qy,qz,temperature_C\n1,2,3,4,5,6,1500,0,1000,0.7071,0,0.7071,0,21.5\n"
    r = load_recording(folder(tmp_path, text, write_recording_yaml("absolute")))
    assert r.position == pytest.approx(np.array([[1.5, 0, 1]]))
    assert r.quaternion is not None
    assert np.linalg.norm(r.quaternion, axis=1) == pytest.approx(1.0, abs=1e-15)
    assert r.temperature == pytest.approx(np.array([21.5]))
    qse = "time_s,qse2_deg,qse3_deg," + Q
    r = load_recording(
        folder(
            tmp_path, f"{qse}\n0,20,30,10,20,30,40,50,60\n0.1,21,31,11,21,31,41,51,61\n", write_recording_yaml("motion")
        )
    )
    assert r.q_secondary is not None
    assert np.isnan(r.q_secondary).all(axis=0).tolist() == [True, False, False, True, True, True]
    assert r.q_secondary[:, 1] == pytest.approx(np.array([20, 21]) * DEG)


def test_missing_labels_are_reported(tmp_path: Path) -> None:
    q = ["10,20,30,40,50,60", "10.5,20,30,40,50,60", "10.004,20,30,40,49.999,60"]
    text = PLAIN + "".join(f"\n{q[k]},1,2,3,0,0,0" for k in (1, 0, 2, 1)) + "\n"
    r = load_recording(folder(tmp_path, text, write_recording_yaml()))
    assert r.pose.tolist() == [0, 1, 1, 0]
    assert r.cycle.tolist() == [0, 1, 2, 3]
    assert r.session.tolist() == [0, 0, 0, 0]
    assert r.stated_labels == frozenset()


def test_poses_by_joint_position() -> None:
    step = 0.015 * DEG
    sweep = np.zeros((6, 6))
    sweep[:, 2] = step * np.arange(6)
    # adjacent poses differ by less than 0.02°, but the sweep is not combined into one pose
    assert number_poses(sweep, "absolute").tolist() == [0, 0, 1, 1, 2, 2]
    assert number_poses(sweep, "motion").tolist() == [0, 1, 2, 3, 4, 5]
    rng = np.random.default_rng(0)
    poses = rng.uniform(-1, 1, (40, 6))
    label = rng.permutation(np.repeat(np.arange(40), 5))
    jitter = poses[label] + rng.uniform(-0.005, 0.005, (200, 6)) * DEG
    found = number_poses(jitter, "deflection")
    assert len(set(zip(found.tolist(), label.tolist(), strict=True))) == 40
    assert found.max() == 39


def test_missing_moments_are_zero(tmp_path: Path) -> None:
    text = f"{PLAIN},mz_Nm\n{ROW},7\n"
    r = load_recording(folder(tmp_path, text, write_recording_yaml()))
    assert r.wrench is not None
    assert r.wrench.tolist() == [[1, 2, 3, 0, 0, 7]]
    r = load_recording(folder(tmp_path, f"{PLAIN}\n{ROW}\n", write_recording_yaml()))
    assert r.wrench is not None
    assert r.wrench.tolist() == [[1, 2, 3, 0, 0, 0]]
    assert r.displacement is not None
    assert r.displacement.shape == (1, 3)


def test_several_files_are_several_sessions(tmp_path: Path) -> None:
    path = folder(tmp_path, yaml=write_recording_yaml("motion", "[a.csv, b.csv]"))
    head = f"cycle,time_s,{Q},{Q.replace('q', 'qcmd')}"
    for name, start in (("a.csv", 0.0), ("b.csv", 0.0)):
        rows = [f"1,{start + 0.1 * k},10.5,2,3,4,5,6,1,2,3,4,5,6" for k in range(2)]
        (path / name).write_text("\n".join([head, *rows, ""]))
    r = load_recording(path)
    assert r.session.tolist() == [0, 0, 1, 1]
    assert r.cycle[0] == r.cycle[1] != r.cycle[2] == r.cycle[3]  # a cycle does not continue across sessions
    assert r.files == ("a.csv", "b.csv")
    assert r.line.tolist() == [2, 3, 2, 3]
    assert r.place(3) == "b.csv line 3"
    assert r.stated_labels == {"cycle", "session"}
    (path / "b.csv").write_text((path / "b.csv").read_text().replace("cycle", "pose", 1))
    read_refusal(path, "a.csv: has no column pose but b.csv has", "same columns")


# ---------------------------------------------------------------- warnings


def test_suspicious_values_are_warnings(tmp_path: Path) -> None:
    radians = PLAIN + "\n0.1,-1.57,1.57,0.2,0.7854,3.1416,1,2,3,0,0,0\n"
    (warning,) = load_recording(folder(tmp_path, radians, write_recording_yaml())).warnings
    assert "look like radians" in warning
    whole = PLAIN + "\n0,-2,3,0,5,1,1,2,3,0,0,0\n"
    assert load_recording(folder(tmp_path, whole, write_recording_yaml())).warnings == ()
    yaml = "machopt_recording: 1\nkind: deflection\ndata: data.csv\n"
    warnings = load_recording(folder(tmp_path, f"{PLAIN}\n{ROW}\n", yaml)).warnings
    assert [w.split(" is not given")[0] for w in warnings] == ["rec: wrench_frame", "rec: displacement_frame"]
    two = f"pose,{PLAIN}\n3,{ROW}\n3,{ROW.replace('30', '30.2', 1)}\n"
    (warning,) = load_recording(folder(tmp_path, two, write_recording_yaml())).warnings
    assert "readings of pose 3 lie 0.2° apart in q3_deg" in warning
    unused = f"{PLAIN},x_mm,y_mm,z_mm\n{ROW},1,2,3\n"
    (warning,) = load_recording(folder(tmp_path, unused, write_recording_yaml())).warnings
    assert "x_mm, y_mm, z_mm are not used in a recording of kind deflection" in warning


# ---------------------------------------------------------------- refused content


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("kind: deflection", "kind: deflecton", ["line 2: kind", "'deflecton'", "did you mean 'deflection'?"]),
        ("kind: deflection\n", "", ["kind: required key is missing"]),
        ("machopt_recording: 1", "machopt_recording: 2", ["line 1: machopt_recording", "found 2"]),
        ("notes: by hand", "note: by hand", ["line 9: note", "unknown key 'note'; did you mean 'notes'?"]),
        ("force_N: 5", "force: 5", ["standard_uncertainty.force", "did you mean 'force_N'?"]),
        ("displacement_mm: 0.015", "displacement_mm: 0", ["displacement_mm", "found 0", "greater than 0"]),
        ("wrench_frame: tool", "wrench_frame: flange", ["line 4: wrench_frame", "valid: base, tool"]),
        ("[0, 10, 200]", "[0, 10]", ["line 7: wrench_point_mm", "expected 3 values"]),
        ("[0, 10, 200]", "[0, 10, .nan]", ["line 7: wrench_point_mm[2]", "finite"]),
        ("data: data.csv", "data: dat.csv", ["line 3: data", "no such file: 'dat.csv'"]),
        ("data: data.csv", "data: 3", ["line 3: data", "found 3; expected the name of a data file"]),
        ("data: data.csv", "data: []", ["line 3: data", "empty list"]),
        ("data: data.csv", "data: [data.csv, 4]", ["line 3: data[1]", "found 4"]),
        ("data: data.csv", "data: [data.csv, ./data.csv]", ["data[1]", "'./data.csv' is listed twice"]),
        ("data: data.csv", "data: ../rec2/data.csv", ["line 3: data", "lies outside the recording folder"]),
        ("data: data.csv", "data: /etc/passwd", ["line 3: data", "lies outside the recording folder"]),
        ("data: data.csv\n", "", ["data: required key is missing; expected a data file, or a list of them"]),
    ],
)
def test_wrong_keys_are_refused(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    assert old in YAML
    read_refusal(folder(tmp_path, yaml=YAML.replace(old, new)), "recording.yaml", *parts)


def test_wrong_folders_are_refused(tmp_path: Path) -> None:
    read_refusal(tmp_path / "gone", "gone: no such file or folder; expected a recording folder")
    read_refusal(tmp_path, "holds no recording.yaml")
    path = folder(tmp_path)
    read_refusal(path / "data.csv", "is not a recording; expected a folder with recording.yaml")
    outside = tmp_path / "outside.csv"
    outside.write_text(GOOD)
    (path / "data.csv").unlink()
    (path / "data.csv").symlink_to(outside)
    read_refusal(path, "line 3: data: 'data.csv' lies outside the recording folder")


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("q1_deg", "q1_rad", ["line 2: unknown column 'q1_rad'; valid: pose, cycle"]),
        ("fx_N", "fx_n", ["line 2: unknown column 'fx_n'; did you mean 'fx_N'?"]),
        ("fx_N", "fx_kN", ["unknown column 'fx_kN'; valid: p"]),
        ("fx_N", "", ["line 2: column 10 has no name"]),
        ("fx_N", "wholly_else", ["unknown column 'wholly_else'; valid:"]),
        ("q1_deg", "q1_mm", ["line 2, column q1_mm: joints that slide are read in", "kind absolute and motion"]),
        ("q1_deg", "q2_deg", ["line 2: column 'q2_deg' is given twice, as columns 4 and 5; keep one"]),
        ("-90,90", "-90", ["line 4: found 21 fields; expected 22 as in the header"]),
        ("45.5", "nan", ["line 4, column q5_deg: found 'nan'; expected a finite number"]),
        ("45.5", "-inf", ["line 4, column q5_deg: found '-inf'; expected a finite number"]),
        ("45.5", "1e999", ["line 4, column q5_deg: found '1e999'; expected a finite number"]),
        ("45.5", "", ["line 4, column q5_deg: found an empty cell; expected a number"]),
        ("45.5", "four", ["line 4, column q5_deg: found 'four'; expected a number"]),
        ("45.5", "1_0", ["line 4, column q5_deg: found '1_0'; expected a number"]),
        ("45.5", '"45,5"', ["line 4, column q5_deg: found '45,5'; expected a number with a decimal point, 45.5"]),
        ("45.5", '"45.5', ["line 4: is not CSV"]),
        (",load", ",loading", ["line 4, column branch: found 'loading'; expected load or unload"]),
        ("7,1,2", "7.5,1,2", ["line 6, column pose: found 7.5; expected a whole number"]),
        ("7,1,2", "7,1,1e20", ["line 6, column session: found 1e+20; expected a whole number below 2^53"]),
        ("7,1,2", "7,x,2", ["line 6, column cycle: found 'x'; expected a number"]),
    ],
)
def test_wrong_cells_are_refused(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    assert old in GOOD
    read_refusal(folder(tmp_path, GOOD.replace(old, new, 1)), "data.csv", *parts)


@pytest.mark.parametrize(
    ("data", "kind", "parts"),
    [
        ("", "deflection", ["data.csv: holds no rows"]),
        (f"{PLAIN}\n", "deflection", ["line 1: holds a header but no rows"]),
        (f"{ROW}\n{ROW}\n", "deflection", ["line 1: holds numbers; expected a header line"]),
        (
            f"{PLAIN}\n{ROW}\n".replace(",", ";"),
            "deflection",
            ["line 1: columns are separated by semicolons; expected commas"],
        ),
        (
            f"{PLAIN}\n{ROW}\n".replace(",", ";").replace(".", ","),
            "deflection",
            ["separated by semicolons and decimals marked by commas", "a decimal point"],
        ),
        (f"{PLAIN}\n{ROW}\n".replace(",", "\t"), "deflection", ["separated by tabs"]),
        (
            f"{PLAIN}\n{ROW}\n".replace(".", ","),
            "deflection",
            ["line 2: found 16 fields; expected 12", "decimal comma"],
        ),
        (
            f"{PLAIN}\n{ROW}\n".replace("fz_N,", "").replace(",3,", ","),
            "deflection",
            ["line 1: column fz_N is missing; it is required with fx_N, fy_N"],
        ),
        (
            f"{Q},mz_Nm,dx_mm,dy_mm,dz_mm\n1,2,3,4,5,6,7,8,9,1\n",
            "deflection",
            ["line 1: column fx_N, fy_N, fz_N is missing; it is required with mz_Nm"],
        ),
        (
            f"{PLAIN.replace('dx_mm,dy_mm,', '')}\n{ROW.replace('0.1,0.2,', '')}\n",
            "deflection",
            ["column dx_mm, dy_mm is missing; it is required with dz_mm", "three dial gauges"],
        ),
        (f"{PLAIN}\n{ROW.replace('0.1,0.2', ',')}\n", "deflection", ["line 2, column dx_mm", "one gauge alone"]),
        (
            f"{PLAIN},rx_mrad\n{ROW},1\n",
            "deflection",
            ["column ry_mrad, rz_mrad is missing; it is required with dx_mm"],
        ),
        (
            f"{PLAIN}\n{ROW}\n".replace("q3_deg,", "").replace(",30,", ","),
            "deflection",
            ["column q3_deg is missing; it is required with q1_deg, q2_deg"],
        ),
        (
            f"{Q},dx_mm,dy_mm,dz_mm\n1,2,3,4,5,6,7,8,9\n",
            "deflection",
            ["kind deflection needs the columns fx_N, fy_N, fz_N; they are missing"],
        ),
        (
            f"{PLAIN}\n{ROW}\n",
            "absolute",
            ["x_mm, y_mm, z_mm; they are missing; the columns are those of kind deflection"],
        ),
        (f"{PLAIN}\n{ROW}\n", "motion", ["kind motion needs the columns time_s"]),
        (f"time_s,{Q}\n0,1,2,3,4,5,6\n", "motion", ["something to compare", "qcmd1_deg, qse1_deg, tau1_Nm"]),
        (
            f"{Q},x_mm,y_mm,z_mm,qw\n1,2,3,4,5,6,7,8,9,1\n",
            "absolute",
            ["column qx, qy, qz is missing; it is required with qw"],
        ),
        (
            f"{Q},x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,2,3,4,5,6,7,8,9,1,0,0,0\n1,2,3,4,5,6,7,8,9,1,0.1,0,0\n",
            "absolute",
            ["line 3, column qw, qx, qy, qz: found a quaternion of length 1.00499; expected 1"],
        ),
    ],
)
def test_wrong_tables_are_refused(tmp_path: Path, data: str, kind: str, parts: list[str]) -> None:
    read_refusal(folder(tmp_path, data, write_recording_yaml(kind)), "data.csv", *parts)


def test_other_encodings_are_refused(tmp_path: Path) -> None:
    read_refusal(folder(tmp_path, GOOD.replace("a comment", "20 °C").encode("latin-1")), "line 1", "is not UTF-8 text")
    read_refusal(folder(tmp_path, GOOD.encode("utf-16")), "is not UTF-8 text; expected CSV in UTF-8")


def test_time_increases_within_a_session(tmp_path: Path) -> None:
    head = f"session,time_s,{Q},fx_N,fy_N,fz_N"
    rows = [f"{s},{t},10,20,30,40,50,60,0,0,0" for s, t in ((1, 0.0), (1, 0.1), (2, 0.0), (1, 0.2), (2, 0.1))]
    path = folder(tmp_path, "\n".join([head, *rows, ""]), write_recording_yaml("motion"))
    assert load_recording(path).session.tolist() == [1, 1, 2, 1, 2]
    rows[3] = rows[3].replace("0.2", "0.1")
    path = folder(tmp_path, "\n".join([head, *rows, ""]), write_recording_yaml("motion"))
    read_refusal(
        path, "data.csv: line 5, column time_s: time does not rise: 0.1 s after 0.1 s in line 3", "column session"
    )


@settings(max_examples=scale_example_count(150), deadline=None)
@given(data=st.data())
def test_damaged_file_is_read_or_refused(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    which = data.draw(st.sampled_from(["data.csv", "recording.yaml"]))
    original = (GOOD if which == "data.csv" else YAML).encode()
    at = data.draw(st.integers(0, len(original)))
    junk = data.draw(
        st.binary(max_size=3) | st.sampled_from([b",", b";", b'"', b"\n", b"\r", b"nan", b"\x00", b"#", b"[", b": "])
    )
    damaged = original[:at] + junk + original[at + data.draw(st.integers(0, 30)) :]
    path = folder(tmp_path_factory.mktemp("f"))
    (path / which).write_bytes(damaged)
    message = str(path)
    try:
        r = load_recording(path)
        assert np.isfinite(r.q).all()
    except InputError as problem:
        message = str(problem)
    assert message.startswith(str(path))


# ---------------------------------------------------------------- Parquet


def test_parquet_needs_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = folder(tmp_path, b"PAR1 and so on")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    read_refusal(
        path,
        "is Parquet, which needs pyarrow: pip install '.[parquet]' in machopt's folder, or save the table as CSV",
    )


def test_parquet_equals_csv(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is an optional dependency")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [line.split(",") for line in GOOD.splitlines()[3:]]
    columns = {name: [row[k] for row in rows] for k, name in enumerate(HEAD.split(","))}
    typed = {
        name: [c or None for c in cells]
        if name == "branch"
        else [int(c) if name in HEAD[:18] else float(c) for c in cells]
        for name, cells in columns.items()
    }
    from_csv = load_recording(folder(tmp_path))
    path = folder(tmp_path, yaml=YAML.replace("data.csv", "data.parquet"))
    file = path / "data.parquet"

    def write(**changed: list[object]) -> None:
        parquet.write_table(pyarrow.table({**typed, **changed}), file)

    write()
    assert_same(load_recording(path), from_csv, but={"line", "files"})
    assert load_recording(path).line.tolist() == [1, 2, 3]
    write(q1_deg=[0.0, None, 1.0])
    read_refusal(path, "data.parquet: row 2, column q1_deg: found an empty cell; expected a number")
    write(q1_deg=[0.0, 1.0, float("nan")])
    read_refusal(path, "row 3, column q1_deg: found nan; expected a finite number")
    write(q1_deg=["0", "1", "2"])
    read_refusal(path, "schema, column q1_deg: is of type string; expected numbers")
    write(branch=[1, 2, 3])
    read_refusal(path, "row 1, column branch: found 1; expected a word")
    write(q13_deg=[1.0, 2.0, 3.0])
    read_refusal(path, "schema: unknown column 'q13_deg'; valid: pose")
    file.write_bytes(b"PAR1 and so on")
    read_refusal(path, "is not readable as Parquet")


# ---------------------------------------------------------------- several recordings


def test_recordings_are_combined(tmp_path: Path) -> None:
    a = folder(tmp_path, name="a")
    b = folder(tmp_path, name="b", yaml=YAML.replace("0.015", "0.02").replace("by hand", "next day"))
    r = load_recordings([a, b / "recording.yaml"])
    assert len(r) == 6
    assert r.source == "a + b"
    assert r.session.tolist() == [2, 2, 2, 3, 3, 3]
    assert r.pose.tolist() == [1, 1, 7, 1, 1, 7]  # the same joint positions
    assert r.cycle[0] == r.cycle[1] != r.cycle[3] == r.cycle[4]
    assert r.line.tolist() == [4, 5, 6, 4, 5, 6]
    assert [r.place(k) for k in (0, 5)] == ["a/data.csv line 4", "b/data.csv line 6"]
    assert r.uncertainty.displacement == pytest.approx(2e-5)
    assert r.notes == "by hand\nnext day"
    assert ["uncertainties of displacement" in w for w in r.warnings] == [True]
    assert_same(load_recordings([a]), load_recording(a))


def test_labels_of_different_poses_are_refused(tmp_path: Path) -> None:
    a = folder(tmp_path, name="a")
    near, far = GOOD.replace("45.5", "45.54"), GOOD.replace("45.5", "45.6")
    assert load_recordings([a, folder(tmp_path, near, name="b")]).pose.tolist() == [1, 1, 7, 1, 1, 7]
    r = load_recordings([a, folder(tmp_path, far, name="b")])
    assert r.pose.tolist() == [1, 1, 7, 8, 8, 14]
    (warning,) = r.warnings
    assert "pose 1 is another robot pose than pose 1 read before (2 such labels)" in warning
    assert "numbered from 8 on" in warning


def test_session_with_its_own_pose_numbers_is_matched(tmp_path: Path) -> None:
    """The second session measured every other pose, numbered from 1;
    a sign, zero or unit error is not accepted as this."""
    q = np.random.default_rng(3).uniform(-60.0, 60.0, (12, 6)).round(3)

    def lines(session: int, label: int, angles: np.ndarray) -> str:
        return f"{session},{label},{','.join(f'{v:.3f}' for v in angles)},0,0,-500,0.1,0.2,0.3\n"

    head = f"session,pose,{PLAIN}\n" + "".join(lines(1, k + 1, a) for k, a in enumerate(q))
    anew = head + "".join(lines(2, k + 1, a + 0.01) for k, a in enumerate(q[::2]))
    r = load_recording(folder(tmp_path, anew, write_recording_yaml()))
    assert r.pose.tolist() == [*range(12), *range(0, 12, 2)]
    assert any("session 2 counts its poses anew" in w for w in r.warnings)
    assert not any("one label is meant for one robot pose" in w for w in r.warnings)
    sign, zero, half = np.array([1, 1, 1, 1, -1, 1]), np.array([0, 0, 7.0, 0, 0, 0]), np.full(6, np.pi / 180)
    for written in (q * sign, q + zero, q * half, q):
        same = head + "".join(lines(2, k + 1, a) for k, a in enumerate(written))
        assert load_recording(folder(tmp_path, same, write_recording_yaml())).pose.tolist() == [*range(1, 13)] * 2


def test_unlabelled_poses_are_matched_by_joint_position(tmp_path: Path) -> None:
    one, two = f"{PLAIN}\n{ROW}\n", f"{PLAIN}\n{ROW.replace('10.5', '11', 1)}\n{ROW}\n"
    a, b = folder(tmp_path, one, write_recording_yaml(), "a"), folder(tmp_path, two, write_recording_yaml(), "b")
    r = load_recordings([a, b])
    assert r.pose.tolist() == [0, 1, 0]
    assert r.session.tolist() == [0, 1, 1]
    assert r.stated_labels == {"session"}
    c = folder(tmp_path, f"pose,{PLAIN}\n5,{ROW}\n", write_recording_yaml(), "c")
    r = load_recordings([a, c])
    assert r.pose.tolist() == [0, 0]
    assert any("all poses are numbered by joint position" in w for w in r.warnings)


def test_inconsistent_recordings_are_refused(tmp_path: Path) -> None:
    a, b = folder(tmp_path, name="a"), folder(tmp_path, name="b", yaml=YAML.replace("frame: base", "frame: tool"))
    with pytest.raises(InputError, match=r"b/data.csv: displacement_frame is tool but base in a/data.csv"):
        load_recordings([a, b])
    b = folder(tmp_path, name="b", yaml=YAML.replace("wrench_point_mm: [0, 10, 200]\n", ""))
    with pytest.raises(InputError, match="wrench_point is None but"):
        load_recordings([a, b])
    b = folder(tmp_path, GOOD.replace("pose", "temperature_C", 1), name="b")
    with pytest.raises(InputError, match=r"holds temperature, but a/data.csv no temperature; .* need the same columns"):
        load_recordings([a, b])
    with pytest.raises(InputError, match="given twice"):
        load_recordings([a, a / "recording.yaml"])
    with pytest.raises(InputError, match="no recordings given"):
        load_recordings([])


# ---------------------------------------------------------------- round trip


def assert_same(a: Recording, b: Recording, but: set[str] = frozenset()) -> None:  # type: ignore[assignment]
    """Check that all fields are equal: numbers to the printed digit or to double precision."""
    for f in fields(Recording):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if f.name in but:
            continue
        if isinstance(x, np.ndarray):
            # half of the last printed digit, and rounding for large numbers; labels exactly
            assert np.allclose(x, y, rtol=1e-14, atol=HALF_DIGIT.get(f.name, 0.0), equal_nan=True), f.name
        elif isinstance(x, StandardUncertainty):
            for g in fields(StandardUncertainty):
                assert getattr(x, g.name) == (
                    None if (v := getattr(y, g.name)) is None else pytest.approx(v, rel=1e-11)
                )
        else:
            assert x == y, f.name


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    n = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = 10.0 ** draw(st.integers(-6, 1))  # larger rotations than 1e5 mrad are refused
    kind = draw(st.sampled_from(["deflection", "absolute", "motion"]))

    def some(*shape: int) -> np.ndarray:
        return rng.normal(size=(n, *shape)) * scale

    def maybe(*shape: int) -> np.ndarray | None:
        return some(*shape) if draw(st.booleans()) else None

    quaternion = rng.normal(size=(n, 4))
    secondary = maybe(6)
    if secondary is not None:
        secondary[:, rng.permutation(6)[: draw(st.integers(0, 5))]] = np.nan
    label = draw(st.sampled_from([1, 10**9]))
    sigma = st.none() | st.floats(1e-9, 10)
    q = rng.uniform(-3, 3, (n, 6))
    return Recording(
        kind=kind,
        source="rec",
        q=q,
        pose=np.arange(n) * label + draw(st.integers(0, 3)),
        cycle=rng.integers(-3, 3, n),
        session=np.full(n, draw(st.integers(-2, 2))),
        line=np.arange(n) + 2,
        wrench=some(6) if kind == "deflection" else maybe(6),
        wrench_frame=draw(st.sampled_from(["base", "tool"])),
        wrench_point=draw(st.none() | st.just(rng.normal(size=3))),
        displacement=some(draw(st.sampled_from([3, 6]))) if kind == "deflection" else None,
        displacement_frame=draw(st.sampled_from(["base", "tool"])),
        position=some(3) if kind != "deflection" else None,
        quaternion=quaternion / np.linalg.norm(quaternion, axis=1)[:, None] if kind != "deflection" else None,
        time=np.cumsum(rng.uniform(1e-3, 1, n)) if kind == "motion" else maybe(),
        temperature=maybe(),
        branch=rng.integers(-1, 2, n).astype(np.int8) if draw(st.booleans()) else None,
        q_command=maybe(6),
        q_secondary=secondary,
        velocity=maybe(6),
        torque=maybe(6),
        current=maybe(6),
        registration=draw(st.sampled_from(["fixed", "fit"])),
        uncertainty=StandardUncertainty(
            displacement=draw(sigma), rotation=draw(sigma), force=draw(sigma), moment=draw(sigma), joint=draw(sigma)
        ),
        notes=draw(st.text(st.characters(codec="utf-8"), max_size=20)),
        stated_labels=frozenset({"pose", "cycle", "session"}),
        files=("data.csv",),
    )


@settings(max_examples=scale_example_count(60), deadline=None)
@given(made=recordings())
def test_round_trip(made: Recording, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("r") / "rec"
    write_recording(path, made)
    first = {p.name: p.read_bytes() for p in path.iterdir()}
    back = load_recording(path)
    but = {"warnings", *(["wrench_frame"] if made.wrench is None else [])}
    but |= {"displacement_frame"} if made.displacement is None else set()
    assert_same(back, made, but)
    write_recording(path, back)
    assert {p.name: p.read_bytes() for p in path.iterdir()} == first  # equal to the last printed digit
    assert set(first) == {"recording.yaml", "data.csv"}


def test_labels_are_written_where_informative(tmp_path: Path) -> None:
    made = replace(load_recording(folder(tmp_path, f"{PLAIN}\n{ROW}\n{ROW}\n", write_recording_yaml())), source="out")
    write_recording(tmp_path / "out", made)
    assert (tmp_path / "out" / "data.csv").read_text().startswith("q1_deg,")
    assert_same(load_recording(tmp_path / "out"), made)
    labelled = replace(made, cycle=np.array([4, 4]))  # a recording without the field `labelled` loses no label
    write_recording(tmp_path / "out", labelled)
    assert load_recording(tmp_path / "out").cycle.tolist() == [4, 4]
    assert (tmp_path / "out" / "data.csv").read_text().splitlines()[1] == (
        "4,10.5,20.0,30.0,40.0,50.0,60.0,1.0,2.0,3.0,0.0,0.0,0.0,0.1,0.2,0.3"
    )


def test_unwritable_recording_is_refused(tmp_path: Path) -> None:
    made = load_recording(folder(tmp_path, f"{PLAIN}\n{ROW}\n", write_recording_yaml()))
    with pytest.raises(InputError, match="reading 1 of fx_N is nan"):
        write_recording(tmp_path / "out", replace(made, wrench=np.full((1, 6), np.nan)))
    with pytest.raises(InputError, match="holds no reading"):
        write_recording(tmp_path / "out", replace(made, q=np.empty((0, 6))))
    with pytest.raises(InputError, match="cannot be written"):
        write_recording(tmp_path / "rec" / "data.csv", made)
    assert not (tmp_path / "out").exists()


def test_long_recordings_load_and_name_the_cell(tmp_path: Path) -> None:
    n = 100_000
    head = (
        f"time_s,{Q},"
        + ",".join(
            f"{p}{i}{u}"
            for p, u in (("qcmd", "_deg"), ("qse", "_deg"), ("qd", "_deg_s"), ("tau", "_Nm"), ("current", "_A"))
            for i in range(1, 7)
        )
        + ",x_mm,y_mm,z_mm"
    )
    cells = ",".join(["12.345678"] * 39)
    rows = [f"{0.004 * k:.3f},{cells}" for k in range(n)]
    path = folder(tmp_path, "\n".join([head, *rows, ""]), write_recording_yaml("motion"))
    assert len(load_recording(path)) == n
    rows[90_000] = rows[90_000].replace("12.345678", "12.34567S", 1)
    read_refusal(
        folder(tmp_path, "\n".join([head, *rows, ""]), write_recording_yaml("motion")),
        "line 90002, column q1_deg: found '12.34567S'",
    )


@pytest.mark.parametrize("end", ["\x85", "\u2028", "\u2029"])
def test_notes_preserve_line_ends(tmp_path: Path, end: str) -> None:
    found = load_recording(folder(tmp_path))
    write_recording(tmp_path / "again", replace(found, notes=f"one{end}two"))
    assert load_recording(tmp_path / "again").notes == f"one{end}two"
