"""``machopt process`` with force waveforms: derivatives, independent simulator, true values, noise, refusals, files."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from machopt.cell.process_file import load_process
from machopt.cli import main
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.measurement.cutting.coefficient_fit import NAMES
from machopt.measurement.cutting.waveform.chip_integrals import build_chip_integrals
from machopt.measurement.cutting.waveform.residual_noise import compute_repeatable_ratio, fit_noise
from machopt.measurement.cutting.waveform.signal_checks import limit_samples
from machopt.measurement.cutting.waveform.waveform_model import _build_mixing
from machopt.measurement.recording import load_cutting_recording
from machopt.process.milling.instantaneous_force import compute_waveform
from machopt.process.milling.mean_force import get_axial_hand
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter

ROOT = Path(__file__).resolve().parents[2]
CELL = ROOT / "cells" / "kr500_milling"
TRUTH = np.array([767.0, 168.8, 222.0, 27.7, 26.6, 3.0])  # in the order of NAMES
SPEED, DIAMETER, HELIX, DEPTH = 100.0, 12e-3, 38.0, 4e-3
RUNOUT, RUNOUT_ANGLE = 8e-6, 0.6
HEAD = f"""machopt_recording: 1
kind: cutting
data: data.csv
wrench_frame: feed
force_on: tool
cut: up
cutter: {{diameter_mm: {1e3 * DIAMETER}, length_mm: 30, teeth: 3, helix_deg: {HELIX}}}
"""


def load_simulator() -> ModuleType:
    """Load the simulator of the benchmark, which does not import machopt."""
    path = ROOT / "benchmarks" / "waveform_fit_benchmark" / "milling_simulator.py"
    spec = importlib.util.spec_from_file_location("milling_simulator", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["milling_simulator"] = module  # dataclasses look up their module here
    spec.loader.exec_module(module)
    assert "machopt" not in path.read_text(encoding="utf-8").replace("independent of machopt", "")
    return module


SIMULATOR = load_simulator()


def simulate(time: np.ndarray, feed: float, offset: float, speed: float = SPEED, **other: object) -> np.ndarray:
    given = {
        "teeth": 3,
        "diameter": DIAMETER,
        "helix": math.radians(HELIX),
        "feed_per_tooth": feed,
        "ae": 5e-3,
        "ap": DEPTH,
        "side": "up",
        "speed": speed,
        "offset": offset,
        "runout": RUNOUT,
        "runout_angle": RUNOUT_ANGLE,
        "coefficients": TRUTH,
    }
    return SIMULATOR.simulate_forces(SIMULATOR.SimulatedCut(**(given | other)), time)  # type: ignore[no-any-return]


def build_rows(noise: float, abscissa: str = "time_s", disturbance: float = 0.0) -> list[str]:
    """Simulate two cuts of eight revolutions; the spindle speed is 0.2 % higher than stated."""
    rng = np.random.default_rng(5)
    rows = [f"cut_number,{abscissa},spindle_rpm,feed_mm_min,ae_mm,ap_mm,fx_N,fy_N,fz_N"]
    time = np.arange(320) / (40.0 * SPEED)
    for number, (feed, offset) in enumerate(((0.04e-3, 0.3), (0.1e-3, 2.1)), 1):
        force = simulate(time, feed, offset, 1.002 * SPEED) + noise * rng.normal(size=(len(time), 3))
        turned = 2.0 * math.pi * 1.002 * SPEED * time
        force[:, 1] += disturbance * np.exp(-(((turned + offset) % (2.0 * math.pi) - 3.0) ** 2) / 0.1)
        first = time if abscissa == "time_s" else np.degrees(turned + offset)
        for n in range(len(time)):
            values = (first[n], 60.0 * SPEED, feed * 3 * SPEED * 6e4, 5.0, 1e3 * DEPTH, *force[n])
            rows.append(f"{number}," + ",".join(f"{v:.9g}" for v in values))
    return rows


@pytest.fixture(scope="module")
def rows() -> list[str]:
    return build_rows(2.0)


def record(folder: Path, rows: list[str], head: str = HEAD) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.yaml").write_text(head, encoding="utf-8")
    (folder / "data.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def run(folder: Path, out: Path) -> dict[str, object]:
    assert main(["process", str(CELL), str(folder), "-o", str(out), "--material", "al7075", "--quiet"]) == 0
    return json.loads((out / "coefficients.json").read_text(encoding="utf-8"))  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, rows: list[str]) -> Path:
    """Return the output folder of the undisturbed recording."""
    folder = tmp_path_factory.mktemp("plain")
    run(record(folder / "r", rows), folder / "out")
    return folder / "out"


@pytest.mark.parametrize(
    ("teeth", "helix", "side", "ae", "runout"),
    [
        (2, 30.0, "up", 4e-3, 5e-6),
        (3, 38.0, "down", 3e-3, 12e-6),
        (2, 45.0, "slot", 12e-3, 8e-6),
        (4, -30.0, "up", 7e-3, 40e-6),
    ],
)
def test_derivatives_agree_with_finite_differences(
    teeth: int, helix: float, side: CutSide, ae: float, runout: float
) -> None:
    cutter = MillingCutter(diameter=DIAMETER, teeth=teeth, helix=math.radians(helix), length=0.03)
    chips = build_chip_integrals(cutter, MillingCut(side), ae, DEPTH)
    phi, feed, rho = np.linspace(0.0, 2.0 * math.pi, 301), 5e-5, runout * np.array([0.8, 0.6])
    slope = chips.evaluate(phi, feed, rho)[1]
    for n, step in enumerate(((1e-6, 0.0, 0.0), (0.0, 1e-10, 0.0), (0.0, 0.0, 1e-10))):
        more = chips.evaluate(phi + step[0], feed, rho + np.array(step[1:]))[0]
        less = chips.evaluate(phi - step[0], feed, rho - np.array(step[1:]))[0]
        expected = (more - less) / (2.0 * max(step))
        error = np.abs(slope[:, :, n] - expected).max(axis=0) / np.abs(expected).max(axis=0)
        assert np.median(error) < 1e-6  # a single angle within one step of a kink has half the jump


@pytest.mark.parametrize(
    ("teeth", "side", "ae", "runout"), [(1, "slot", 12e-3, 0.0), (2, "down", 4e-3, 10e-6), (4, "up", 5e-3, 15e-6)]
)
def test_forces_agree_with_trochoidal_tooth_paths(
    teeth: int, side: CutSide, ae: float, runout: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tolerance of 0.4 % of the largest force: slices of the simulator, and third-order terms in the feed."""
    monkeypatch.setattr(SIMULATOR, "SLICES", 400)
    feed = 1e-4
    cutter = MillingCutter(diameter=DIAMETER, teeth=teeth, helix=math.radians(HELIX), length=0.03)
    cut = MillingCut(side)
    time = np.arange(120) / 120.0 / SPEED
    expected = simulate(time, feed, 0.2, teeth=teeth, side=side, ae=ae, runout=runout, runout_angle=0.3)
    chips = build_chip_integrals(cutter, cut, ae, DEPTH)
    B = chips.evaluate(2.0 * math.pi * SPEED * time + 0.2, feed, runout * np.array([math.cos(0.3), math.sin(0.3)]))[0]
    found = np.einsum("fqb,q,sb->sf", _build_mixing(cut.mirror, get_axial_hand(cutter, cut)), TRUTH, B)
    np.testing.assert_array_less(np.abs(found - expected).max(axis=0), 4e-3 * np.abs(expected).max(axis=0))


def test_true_values_lie_in_the_intervals_and_the_file_reads_back(plain: Path) -> None:
    found = json.loads((plain / "coefficients.json").read_text(encoding="utf-8"))
    for entry, truth in zip(found["coefficients"], TRUTH, strict=True):
        low, high = entry["interval"]
        half = 0.5 * (high - low)
        # 90 % intervals: six of six within them are not expected
        assert low - half < truth < high + half, entry["name"]
        assert half < 0.2 * truth or entry["name"] == "Kae"
    waveform = found["waveform"]
    assert waveform["runout"]["amplitude_mm"] == pytest.approx(1e3 * RUNOUT, rel=0.1)
    assert waveform["runout"]["angle_deg"] == pytest.approx(math.degrees(RUNOUT_ANGLE), abs=4.0)
    assert [cut["spindle_rpm"] for cut in waveform["cuts"]] == pytest.approx([6012.0] * 2, rel=2e-4)
    offsets = [cut["offset_deg"] for cut in waveform["cuts"]]
    assert offsets == pytest.approx([math.degrees(0.3), math.degrees(2.1)], abs=1.0)
    process = load_process(plain / "process.yaml")
    milling = process.materials["al7075"].milling
    assert milling is not None
    assert milling.Ktc_Pa == pytest.approx(1e6 * found["coefficients"][0]["value"], rel=1e-5)
    assert "force waveforms of 2 measured cuts" in milling.source
    page = (plain / "report.html").read_text(encoding="utf-8")
    assert "Measured and fitted waveforms" in page
    assert "c-waveform-1" in page
    assert sorted(p.name for p in plain.iterdir()) == [
        "coefficients.json",
        "cuts.csv",
        "manifest.json",
        "process.yaml",
        "report.html",
    ]


def test_encoder_gives_one_common_offset_for_all_cuts(tmp_path: Path) -> None:
    found = run(record(tmp_path / "r", build_rows(2.0, "angle_deg")), tmp_path / "out")
    offsets = [cut["offset_deg"] for cut in found["waveform"]["cuts"]]  # type: ignore[index]
    assert offsets[0] == offsets[1]
    assert offsets[0] == pytest.approx(0.0, abs=1.0)
    assert found["coefficients"][0]["value"] == pytest.approx(TRUTH[0], rel=0.03)  # type: ignore[index]


def test_model_discrepancy_widens_the_intervals(tmp_path: Path, plain: Path) -> None:
    undisturbed = json.loads((plain / "coefficients.json").read_text(encoding="utf-8"))
    disturbed = run(record(tmp_path / "b", build_rows(2.0, disturbance=15.0)), tmp_path / "out_b")
    assert not undisturbed["waveform"]["misfit_significant"]
    assert disturbed["waveform"]["misfit_significant"]  # type: ignore[index]
    assert any("repeat with the rotation" in text for text in disturbed["warnings"])  # type: ignore[attr-defined]
    widths = [
        [entry["interval"][1] - entry["interval"][0] for entry in one["coefficients"]]  # type: ignore[attr-defined]
        for one in (undisturbed, disturbed)
    ]
    assert widths[1][0] > 1.5 * widths[0][0]


def test_autoregressive_noise_is_found_and_whitened() -> None:
    rng = np.random.default_rng(0)
    e = rng.normal(size=(4000, 3))
    for n in range(2, len(e)):
        e[n] += 1.2 * e[n - 1] - 0.5 * e[n - 2]
    noise = fit_noise([e[:2500], e[2500:]], 1e-9)
    for a in noise.coefficients:
        np.testing.assert_allclose(a[:2], [1.2, -0.5], atol=0.06)
    np.testing.assert_allclose(noise.sigma, 1.0, atol=0.05)
    white = noise.whiten(e)
    assert abs(np.corrcoef(white[1:, 0], white[:-1, 0])[0, 1]) < 0.05
    phases = np.linspace(0.0, 40.0 * math.pi, len(white))
    ratio, limit = compute_repeatable_ratio([phases], [white], 8)
    assert ratio < limit
    assert compute_repeatable_ratio([phases], [white + 0.5 * np.sin(phases)[:, None]], 8)[0] > limit


def test_long_recordings_are_truncated_per_cut(tmp_path: Path) -> None:
    lines = ["cut_number,time_s,spindle_rpm,feed_mm_min,ae_mm,ap_mm,fx_N,fy_N,fz_N"]
    lines += [
        f"{cut},{n * 1e-4:.4f},6000,720,5,4,{n},0,0" for cut, count in ((1, 20000), (2, 10000)) for n in range(count)
    ]
    recording = load_cutting_recording(record(tmp_path / "r", lines))
    assert isinstance(recording, WaveformRecording)
    short, force = limit_samples(recording, np.array(recording.samples.force), 3)
    assert short.first.tolist() == [0, 8000, 12000]
    assert force[8000, 0] == 0.0
    assert force[-1, 0] == 3999.0
    assert short.time is not None
    assert short.time[8001] == pytest.approx(1e-4)
    assert "first 12000 of 30000 samples" in short.samples.warnings[-1]
    same, _ = limit_samples(short, force, 3)
    assert same is short


def replace_cell(rows: list[str], line: int, column: str, value: str) -> list[str]:
    out = list(rows)
    cells = out[line - 1].split(",")
    cells[rows[0].split(",").index(column)] = value
    out[line - 1] = ",".join(cells)
    return out


def drop_column(rows: list[str], column: str) -> list[str]:
    k = rows[0].split(",").index(column)
    return [",".join(c for n, c in enumerate(row.split(",")) if n != k) for row in rows]


REFUSALS = {
    "nan": (lambda r: replace_cell(r, 7, "fy_N", "nan"), "line 7, column fy_N"),
    "negative speed": (lambda r: replace_cell(r, 5, "spindle_rpm", "-6000"), "line 5, column spindle_rpm"),
    "no axial force": (lambda r: drop_column(r, "fz_N"), "no column fz_N"),
    "cut off": (lambda r: [*r[:200], r[200][:12]], "line 201"),
    "few revolutions": (lambda r: r[:100], "4 revolutions or more"),
    "aliasing": (lambda r: [r[0], *r[1:321:8]], "aliasing; expected 8 or more"),
    "a gap": (lambda r: [*r[:50], *r[53:]], "line 51, column time_s"),
    "other feed": (lambda r: replace_cell(r, 9, "feed_mm_min", "1"), "line 9, column feed_mm_min"),
    "no cut numbers": (lambda r: drop_column(r, "cut_number"), "one cut number for each cut"),
    "cut number again": (lambda r: [*r[:641], r[2]], "cut 1 comes again"),
    "broken cut number": (lambda r: replace_cell(r, 3, "cut_number", "1.5"), "expected a whole number"),
    "other name": (lambda r: [r[0].replace("time_s", "t_s"), *r[1:]], "the name is time_s"),
    "kilonewton": (lambda r: [r[0].replace("fx_N", "fx_kN"), *r[1:]], "fx_kN"),
    "deeper than the edge": (lambda r: [row.replace(",5,4,", ",5,40,") for row in r], "at most the length"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_invalid_waveforms_are_refused_in_one_message(
    case: str, tmp_path: Path, rows: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    change, expected = REFUSALS[case]
    folder = record(tmp_path / "r", change(rows))
    assert main(["process", str(CELL), str(folder), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert expected in message
    assert "data.csv" in message
    assert not (tmp_path / "out").exists()


def test_wrong_sign_of_the_forces_is_reported(
    tmp_path: Path, rows: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "r", rows, HEAD.replace("force_on: tool", "force_on: workpiece"))
    code = main(["process", str(CELL), str(folder), "-o", str(tmp_path / "out"), "--quiet"])
    if code == 0:
        found = json.loads((tmp_path / "out" / "coefficients.json").read_text(encoding="utf-8"))
        assert any("frame and sign" in text for text in found["warnings"])
    else:
        assert code == 2
        assert "another sign or frame" in capsys.readouterr().err


def test_options_without_effect_and_ball_cutters_are_refused(
    tmp_path: Path, rows: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = record(tmp_path / "r", rows), str(tmp_path / "out")
    assert main(["process", str(CELL), str(folder), "-o", out, "--quiet", "--keep-outliers"]) == 2
    assert "--keep-outliers" in capsys.readouterr().err
    record(folder, rows, HEAD.replace("teeth: 3", "teeth: 3, corner_radius_mm: 6"))
    assert main(["process", str(CELL), str(folder), "-o", out, "--quiet"]) == 2
    assert "flat end mills" in capsys.readouterr().err


def test_mean_forces_do_not_import_casadi(tmp_path: Path) -> None:
    head = HEAD.replace("cut: up", "cut: slot")
    lines = ["spindle_rpm,feed_mm_min,ap_mm,fx_N,fy_N,fz_N"]
    lines += [f"6000,{300 * n},3,{-30 - 10 * n},{20 + 40 * n},{-50 - 7 * n}" for n in range(1, 6)]
    folder = record(tmp_path / "r", lines, head)
    code = (
        "import sys\nfrom machopt.cli import main\n"
        f"assert main(['process', {str(CELL)!r}, {str(folder)!r}, '-o', {str(tmp_path / 'out')!r}, '--quiet']) == 0\n"
        "print('casadi' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split()[-1] == "False"
    assert NAMES[0] == "Ktc"


@pytest.mark.parametrize(("teeth", "side", "ae"), [(3, "down", 4e-3), (4, "up", 5e-3), (5, "slot", 12e-3)])
def test_planned_forces_with_runout_agree_with_trochoidal_tooth_paths(
    teeth: int, side: CutSide, ae: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tooth sequence determines the chip thickness with three or more teeth: the wrong sequence gives a 40 % error.

    The planner's model uses circles instead of trochoids, and a contact arc that does not depend on run-out.
    """
    monkeypatch.setattr(SIMULATOR, "SLICES", 400)
    feed, runout = 1e-4, 15e-6
    cutter = MillingCutter(
        diameter=DIAMETER, teeth=teeth, helix=math.radians(HELIX), length=0.03, runout=runout, runout_angle=0.3
    )
    time = np.arange(120) / 120.0 / SPEED
    expected = simulate(time, feed, 0.2, teeth=teeth, side=side, ae=ae, runout=runout, runout_angle=0.3)
    angles = 2.0 * math.pi * SPEED * time + 0.2
    Ktc, Krc, Kac, Kte, Kre, Kae = (TRUTH * (1e6, 1e6, 1e6, 1e3, 1e3, 1e3)).tolist()
    known = MillingCoefficients(
        Ktc_Pa=Ktc,
        Krc_Pa=Krc,
        Kac_Pa=Kac,
        Kte_N_m=Kte,
        Kre_N_m=Kre,
        Kae_N_m=Kae,
        h_range_m=(1e-6, 1e-3),
        sigma_log=0.1,
        source="test",
    )
    found = compute_waveform(known, cutter, MillingCut(side), (ae, DEPTH), feed, angles).load[:, :3]
    np.testing.assert_array_less(np.abs(found - expected).max(axis=0), 0.08 * np.abs(expected).max(axis=0))
