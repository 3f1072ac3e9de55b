"""``machopt process``: published coefficients, frames, intervals, outliers, refusals, the written files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import machopt
from machopt.cell.cell_reader import load_cell
from machopt.cell.process_file import load_process
from machopt.cli import main
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.errors import InputError, RecordingError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.cutting.coefficient_fit import NAMES, fit_coefficients
from machopt.measurement.cutting.force_axes import compute_cut_forces
from machopt.measurement.recording import load_cutting_recording
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import MillingCut, MillingCutter

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "cells" / "kr500_milling"
PUBLISHED = np.array([958.8599, 250.8633, 146.3614, 15.7580, 19.4337, 18.2075])  # in the order of NAMES
SLOTS = """spindle_rpm,feed_mm_min,ap_mm,fx_N,fy_N,fz_N
6000,300,3,-39.80,63.02,-55.72
6000,600,3,-60.05,107.14,-70.91
6000,900,3,-71.60,137.67,-82.57
6000,1200,3,-76.75,171.27,-85.23
6000,1500,3,-78.49,210.74,-83.50
"""
"""Published mean forces of slots in aluminium; the source gives the axial force with the opposite sign."""
HEAD = """machopt_recording: 1
kind: cutting
data: data.csv
wrench_frame: feed
force_on: tool
cut: slot
cutter: {diameter_mm: 25, length_mm: 50, teeth: 2, helix_deg: 45}
"""
TRUTH = np.array([767.0, 168.8, 222.0, 27.7, 26.6, 0.7])
TWELVE = MillingCutter(diameter=0.012, teeth=3, helix=math.radians(38), length=0.03)


def record(folder: Path, data: str = SLOTS, head: str = HEAD) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.yaml").write_text(head, encoding="utf-8")
    (folder / "data.csv").write_text(data, encoding="utf-8")
    return folder


def fit(folder: Path, **options: float | bool):  # type: ignore[no-untyped-def]
    recording = load_cutting_recording(folder)
    force = compute_cut_forces(recording, load_cell(CELL, bodies=False))
    return fit_coefficients(recording, build_milling_cutter(recording.cutter), force, **options)  # type: ignore[arg-type]


def made_up(rng: np.random.Generator, noise: float, rows: int = 24) -> str:
    """Simulate up-milling, down-milling and slot cuts with the coefficients TRUTH; forces in travel, normal and
    axial direction."""
    K = MillingCoefficients(
        Ktc_Pa=TRUTH[0] * 1e6,
        Krc_Pa=TRUTH[1] * 1e6,
        Kac_Pa=TRUTH[2] * 1e6,
        Kte_N_m=TRUTH[3] * 1e3,
        Kre_N_m=TRUTH[4] * 1e3,
        Kae_N_m=TRUTH[5] * 1e3,
        h_range_m=(0.0, 1.0),
        sigma_log=0.0,
        source="",
    )
    lines = ["spindle_rpm,feed_mm_min,ae_mm,ap_mm,cut,fx_N,fy_N,fz_N"]
    for n in range(rows):
        side, ae, fz = ("up", "down", "slot")[n % 3], rng.uniform(2, 9), rng.uniform(0.02, 0.12)
        load = compute_mean_load(K, TWELVE, MillingCut(side), 0.012 if side == "slot" else ae / 1e3, 0.004)
        f = load.compute_load(fz / 1e3)[0, :3] + noise * rng.normal(size=3)
        lines.append(f"9000,{fz * 27000!r},{'' if side == 'slot' else repr(ae)},4,{side},{f[0]!r},{f[1]!r},{f[2]!r}")
    return "\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n"


MIXED = """machopt_recording: 1
kind: cutting
data: data.csv
wrench_frame: feed
force_on: tool
cutter: {diameter_mm: 12, length_mm: 30, teeth: 3, helix_deg: 38}
"""


def test_published_coefficients_from_published_means(tmp_path: Path) -> None:
    found = fit(record(tmp_path))
    np.testing.assert_allclose(found.values, PUBLISHED, rtol=1e-4)
    np.testing.assert_allclose(found.explained, [0.865, 0.997, 0.786], atol=1e-3)
    half = 0.5 * (found.high - found.low) / found.values
    names = dict(zip(NAMES, half, strict=True))
    assert names["Ktc"] < 0.1
    assert names["Krc"] > 0.4  # poorly determined, as the wide interval shows
    assert names["Kac"] > 0.6
    x = np.array([0.025, 0.05, 0.075, 0.1, 0.125])  # linear regression of the normal force, for comparison
    slope, residual = np.polyfit(x, [63.02, 107.14, 137.67, 171.27, 210.74], 1, full=True)[:2]
    sigma = math.sqrt(residual[0] / 3 / np.sum((x - x.mean()) ** 2))
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(sigma * 4 / (2 * 3), rel=1e-6)
    assert found.values[0] == pytest.approx(slope[0] * 4 / (2 * 3), rel=1e-9)


def test_three_cut_sides_recover_the_coefficients(tmp_path: Path) -> None:
    found = fit(record(tmp_path, made_up(np.random.default_rng(0), 0.0), MIXED))
    np.testing.assert_allclose(found.values, TRUTH, rtol=1e-6)


@pytest.mark.slow
def test_confidence_intervals_have_their_coverage(tmp_path: Path) -> None:
    rng, inside = np.random.default_rng(3), []
    for n in range(60):
        found = fit(record(tmp_path / str(n), made_up(rng, 4.0, 15), MIXED), keep_outliers=True)
        free = [name not in found.fixed for name in NAMES]
        inside.append(((found.low <= TRUTH) & (found.high >= TRUTH))[free].mean())
    assert 0.84 < np.mean(inside) < 0.96


def test_outliers_are_excluded_and_reported(tmp_path: Path) -> None:
    lines = made_up(np.random.default_rng(5), 2.0).splitlines()
    cells = lines[7].split(",")
    cells[6] = str(float(cells[6]) + 60.0)
    lines[7] = ",".join(cells)
    folder = record(tmp_path, "\n".join(lines) + "\n", MIXED)
    found = fit(folder)
    assert found.used.sum() == 23
    assert "outlier: the normal force is" in found.reasons[6]
    assert found.residual[1] < 0.3 * fit(folder, keep_outliers=True).residual[1]


def test_implausible_rows_are_excluded_with_a_reason(tmp_path: Path) -> None:
    lines = made_up(np.random.default_rng(5), 2.0).splitlines()
    lines[1] = lines[1].replace(lines[1].split(",")[2], "14", 1)  # wider than the cutter diameter
    lines[4] = ",".join([*lines[4].split(",")[:3], "40", *lines[4].split(",")[4:]])  # deeper than the cutting edges
    found = fit(record(tmp_path, "\n".join(lines) + "\n", MIXED))
    assert "at most the diameter 12 mm" in found.reasons[0]
    assert "at most the length of the cutting edges 30 mm" in found.reasons[3]
    assert found.used.sum() == 22


@pytest.mark.parametrize("frame", ["base", "tool"])
def test_forces_in_other_axes_are_rotated_into_the_cutting_frame(tmp_path: Path, frame: str) -> None:
    cell = load_cell(CELL, bodies=False)
    q = np.degrees([[0.1, -1.4, 1.6, 0.2, 0.7, -0.3], [-0.2, -1.2, 1.5, 0.1, 0.5, 0.4]])
    R = load_robot(cell).compute_fk(np.radians(q), cell.tool.T_flange_tcp)[:, :3, :3]
    rows = SLOTS.splitlines()
    out = [rows[0] + ",travel_x,travel_y,travel_z" + "".join(f",q{n}_deg" for n in range(1, 7))]
    for n, line in enumerate(rows[1:]):
        *head, fx, fy, fz = (float(v) for v in line.split(","))
        angle = 0.7 * n
        # in the TCP frame, whose z axis points to the workpiece
        travel = np.array([math.cos(angle), math.sin(angle), 0.0])
        axis = np.array([0.0, 0.0, -1.0])
        force = fx * travel + fy * np.cross(axis, travel) + fz * axis
        if frame == "base":
            travel, force = R[n % 2] @ travel, R[n % 2] @ force
        values = [*head, *force, *(3.0 * travel), *q[n % 2]]
        out.append(",".join(f"{v:.15g}" for v in values))
    head_text = HEAD.replace("wrench_frame: feed", f"wrench_frame: {frame}")
    found = fit(record(tmp_path, "\n".join(out) + "\n", head_text))
    np.testing.assert_allclose(found.values, PUBLISHED, rtol=1e-4)
    reversed_force = record(tmp_path / "r", "\n".join(out) + "\n", head_text.replace("on: tool", "on: workpiece"))
    with pytest.raises(RecordingError, match="another sign or frame"):
        fit(reversed_force)
    along = "\n".join(
        [
            out[0],
            out[1].replace(out[1], ",".join([*out[1].split(",")[:6], "0", "0", "0", *out[1].split(",")[9:]])),
            *out[2:],
        ]
    )
    with pytest.raises(RecordingError, match="direction of travel"):
        fit(record(tmp_path / "z", along + "\n", head_text))


@pytest.mark.parametrize(
    ("head", "data", "words"),
    [
        (HEAD.replace("wrench_frame: feed\n", ""), SLOTS, "wrench_frame"),
        (HEAD.replace("force_on: tool\n", ""), SLOTS, "force_on"),
        (HEAD.replace("kind: cutting", "kind: deflection"), SLOTS, "kind"),
        (HEAD.replace("cut: slot\n", ""), SLOTS, "no column cut"),
        (HEAD.replace("feed\n", "base\n"), SLOTS, "travel_x, travel_y, travel_z, q1_deg"),
        (HEAD, SLOTS.replace(",fz_N", "").replace(",-55.72", ""), "fields|fz_N"),
        (HEAD, SLOTS.replace("6000,300", "0,300"), "line 2, column spindle_rpm"),
        (HEAD, SLOTS.replace("6000,300", "6000,0"), "line 2, column feed_mm_min"),
        (HEAD, SLOTS.replace("ap_mm", "depth"), "unknown column 'depth'"),
        (HEAD, SLOTS.replace("ap_mm", "fz_mm"), "feed per tooth follows"),
        (HEAD.replace("teeth: 2, ", ""), SLOTS, "teeth"),
        (HEAD.replace("helix_deg: 45", "helix_deg: 0"), SLOTS, "hand of the helix"),
        (HEAD, "\n".join(SLOTS.splitlines()[:4]) + "\n", "4 or more are needed"),
        (
            HEAD,
            SLOTS.replace("600,", "310,").replace("900,", "320,").replace("1200,", "330,").replace("1500,", "340,"),
            "too close",
        ),
        (HEAD + "speed: 3\n", SLOTS, "speed"),
    ],
)
def test_invalid_recording_is_refused(tmp_path: Path, head: str, data: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        fit(record(tmp_path, data, head))


def test_invalid_cut_side_is_reported_with_its_line(tmp_path: Path) -> None:
    data = made_up(np.random.default_rng(1), 0.0).replace(",down,", ",climb,", 1)
    with pytest.raises(InputError, match=r"line 3, column cut.*climb"):
        load_cutting_recording(record(tmp_path, data, MIXED))


def test_negative_coefficient_from_noise_becomes_zero(tmp_path: Path) -> None:
    for seed in range(40):
        found = fit(record(tmp_path / str(seed), made_up(np.random.default_rng(seed), 8.0, 9), MIXED))
        assert (found.values >= 0).all()
        if "Kae" in found.fixed:
            assert any("Kae came out negative" in text for text in found.warnings)
            assert found.covariance[5].any() == np.False_
            return
    pytest.fail("no seed gives a negative Kae")


def test_command_writes_a_file_that_optimize_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = record(tmp_path / "slots"), tmp_path / "out"
    assert main(["process", str(CELL), str(folder), "-o", str(out), "--material", "al_measured"]) == 0
    output = capsys.readouterr().out
    assert "al_measured: 5 of 5 cuts used" in output
    assert "Krc" in output
    process = load_process(out / "process.yaml")
    material = process.materials["al_measured"].milling
    assert material is not None
    assert material.Ktc_Pa == pytest.approx(958.8599e6, rel=1e-4)
    assert material.h_range_m == pytest.approx((2.5e-5, 1.25e-4))
    assert "5 measured cuts" in material.source
    assert process.operations[0].label == "default"
    document = json.loads((out / "coefficients.json").read_text(encoding="utf-8"))
    assert document["coefficients"][0]["interval"][0] < 958.86 < document["coefficients"][0]["interval"][1]
    assert len(document["covariance"]) == 6
    files = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["files"]
    assert files["process.yaml"]["role"] == "process"
    assert files["cuts.csv"]["role"] == "table"
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Cutting coefficients of al_measured" in page
    assert "not determined" not in page
    assert main(["process", str(CELL), str(folder), "-o", str(tmp_path / "two"), "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["material"] == "slots"


def test_api_function_writes_the_same_files_as_the_command(tmp_path: Path) -> None:
    folder = record(tmp_path / "slots")
    assert main(["process", str(CELL), str(folder), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    found = machopt.fit_cutting_coefficients(CELL, folder, level_percent=90.0)
    assert found.values[0] == pytest.approx(958.8599, rel=1e-4)
    assert found.covariance.shape == (6, 6)
    file = found.save(tmp_path / "again")
    assert file.read_bytes() == (tmp_path / "out" / "process.yaml").read_bytes()
    with pytest.raises(InputError, match="level_percent"):
        machopt.fit_cutting_coefficients(CELL, folder, level_percent=3.0)


def test_cutter_of_the_cell_is_used_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head = "\n".join(line for line in HEAD.splitlines() if not line.startswith("cutter")) + "\n"
    assert main(["process", str(CELL), str(record(tmp_path / "a", head=head)), "-o", str(tmp_path / "out")]) == 0
    assert "that of the cell is taken: diameter 17 mm, 2 teeth, helix 30°" in capsys.readouterr().out


def test_commands_refer_to_the_one_that_reads_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = record(tmp_path / "a")
    assert main(["identify", str(CELL), str(folder), "-o", str(tmp_path / "out")]) == 2
    assert "machopt process reads them" in capsys.readouterr().err
    record(folder, head=HEAD.replace("kind: cutting", "kind: motion"))
    assert main(["process", str(CELL), str(folder), "-o", str(tmp_path / "out")]) == 2
    assert "is motion; expected cutting" in capsys.readouterr().err


def test_command_refuses_with_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = record(tmp_path / "slots", head=HEAD.replace("on: tool", "on: workpiece"))
    assert main(["process", str(CELL), str(folder), "-o", str(tmp_path / "out")]) == 2
    assert "another sign or frame" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["process", str(CELL), str(folder), "-o", str(tmp_path / "out"), "--level", "20"]) == 2
    assert "--level" in capsys.readouterr().err
