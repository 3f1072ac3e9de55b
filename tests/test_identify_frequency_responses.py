"""``machopt identify`` of frequency responses: derivatives, independent responses, bounds, refusals, written files."""

from __future__ import annotations

import importlib.util
import json
import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import machopt
from machopt.cell.cell_reader import load_cell
from machopt.cell.process_file import load_process
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cli import main
from machopt.dynamics.rigid_body import load_dynamics
from machopt.errors import RecordingError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.identification.frequency_response.frequency_response_pipeline import _compute_covariance
from machopt.measurement.identification.frequency_response.modal_damping import compute_modal_damping
from machopt.measurement.identification.frequency_response.response_equations import (
    ResponseEquations,
    build_response_equations,
)
from machopt.measurement.identification.frequency_response.response_fit import build_prior, fit_responses
from machopt.measurement.identification.frequency_response.response_model import DampingLaw, build_response_model
from machopt.measurement.recording.frequency_response_reader import load_frequency_responses
from machopt.process.stability.structural_modes import compute_arm_modes

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr500_milling"
SPRINGS = np.array([1.2e7, 7.0e6, 4.5e6, 5.5e5, 2.6e5, 3.0e5])  # N·m/rad, different from the cell's values
DAMPING = 0.06 * SPRINGS / (2.0 * math.pi * 30.0)  # N·m·s/rad
FREQUENCY = np.arange(5.0, 76.0, 2.0)
POSES = np.radians([[0, -90, 90, 0, 45, 0], [40, -75, 105, 50, 60, 20]])
HEAD = "machopt_recording: 1\nkind: frf\ndata: data.csv\ndirection_frame: base\n"
AXES = [f"{what}_{axis}" for what in ("excitation", "response") for axis in "xyz"]
COLUMNS = ["pose", "frequency_Hz", "re_m_per_N", "im_m_per_N", *(f"q{n}_deg" for n in range(1, 7)), *AXES]
PROCESS = """machopt_process: 1   # kept
materials: {al: {milling: {Ktc: 700, Krc: 200, source: test}}}
operations: {default: {kind: milling, material: al, spindle_rpm: 6000, ae_mm: 1, ap_mm: 2, cut: up}}
"""


def load_simulator() -> ModuleType:
    """Load the simulator of the benchmark; it imports nothing from machopt."""
    path = ROOT / "benchmarks" / "frequency_response_benchmark" / "arm_simulator.py"
    spec = importlib.util.spec_from_file_location("arm_simulator", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["arm_simulator"] = module  # required by dataclasses, which look up their module
    spec.loader.exec_module(module)
    return module


SIMULATOR = load_simulator()


def build_rows(
    pairs: tuple[tuple[int, int], ...] = ((0, 0), (1, 1), (2, 2)), noise: float = 0.03, poses: int = 2
) -> list[str]:
    rng, arm = np.random.default_rng(2), SIMULATOR.build_arm(CELL, np.ones(6))
    rows = [",".join(COLUMNS)]
    for pose, q in enumerate(POSES[:poses], 1):
        for force, sensor in pairs:
            pair = np.eye(3)[force], np.eye(3)[sensor]
            H = SIMULATOR.simulate_responses(arm, q, pair, 2.0 * np.pi * FREQUENCY, SPRINGS, DAMPING)
            H = H + noise * np.median(np.abs(H)) * (rng.normal(size=len(H)) + 1j * rng.normal(size=len(H)))
            for f, value in zip(FREQUENCY, H, strict=True):
                numbers = [f, value.real, value.imag, *np.degrees(q), *pair[0], *pair[1]]
                rows.append(f"{pose}," + ",".join(f"{v:.9g}" for v in numbers))
    return rows


@pytest.fixture(scope="module")
def rows() -> list[str]:
    return build_rows()


def record(folder: Path, rows: list[str], head: str = HEAD) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.yaml").write_text(head, encoding="utf-8")
    (folder / "data.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def equations(rows: list[str], tmp_path_factory: pytest.TempPathFactory) -> ResponseEquations:
    recording = load_frequency_responses(record(tmp_path_factory.mktemp("frf") / "r", rows))
    cell = load_cell(CELL, bodies=False)
    return build_response_equations(recording, cell, load_robot(cell), None)


@pytest.mark.parametrize("law", ["viscous", "structural"])
def test_receptance_and_derivatives(law: DampingLaw, equations: ResponseEquations) -> None:
    model = build_response_model(equations, law)
    x = np.concatenate([np.log(SPRINGS), np.log(np.linspace(0.03, 0.1, 6))])
    H, J = model.evaluate(x)
    scale = equations.omega / equations.reference if law == "viscous" else np.ones(len(equations.omega))
    Z = np.eye(6) * np.exp(x[:6]) * (1.0 + 1j * np.exp(x[6:]) * scale[:, None, None])
    Z = Z - equations.omega[:, None, None] ** 2 * equations.mass
    direct = np.einsum("ni,ni->n", equations.response, np.linalg.solve(Z, equations.excitation[..., None])[..., 0])
    np.testing.assert_allclose(H, direct, rtol=1e-10)
    for n in range(12):
        step = 1e-6 * (np.arange(12) == n)
        expected = (model.evaluate(x + step)[0] - model.evaluate(x - step)[0]) / 2e-6
        np.testing.assert_allclose(J[:, n], expected, atol=1e-6 * np.abs(J[:, n]).max())
    by_mass = model.evaluate_mass_derivatives(x)
    for body in range(6):
        change = 1e-6 * equations.body_mass[body]
        more, less = (
            build_response_model(replace(equations, mass=equations.mass + sign * change), law).evaluate(x)[0]
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(by_mass[:, body], (more - less) / 2e-6, atol=1e-6 * np.abs(by_mass[:, body]).max())


def test_mass_matrix_and_levers_agree_with_independent_code(equations: ResponseEquations) -> None:
    dynamics = load_dynamics(load_cell(CELL, bodies=False))
    np.testing.assert_allclose(equations.mass[:1], dynamics.compute_mass_matrix(POSES[:1]), atol=1e-9)
    arm = SIMULATOR.build_arm(CELL, np.ones(6))
    pair = np.eye(3)[0], np.eye(3)[0]
    H = SIMULATOR.simulate_responses(arm, POSES[0], pair, 2.0 * np.pi * FREQUENCY, SPRINGS, DAMPING)
    model = build_response_model(equations, "viscous")
    x = np.log(np.concatenate([SPRINGS, DAMPING / SPRINGS * equations.reference]))
    np.testing.assert_allclose(model.evaluate(x)[0][: len(FREQUENCY)], H, rtol=1e-8)


def test_true_values_lie_in_the_intervals_and_files_are_read_back(tmp_path: Path, rows: list[str]) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    (cell / "process.yaml").write_text(PROCESS, encoding="utf-8")
    with (cell / "cell.yaml").open("a", encoding="utf-8") as file:
        file.write("process: process.yaml\n")
    out = tmp_path / "out"
    assert main(["identify", str(cell), str(record(tmp_path / "r", rows)), "-o", str(out), "--quiet"]) == 0
    found = json.loads((out / "frequency_response.json").read_text(encoding="utf-8"))
    assert found["damping_law"] == "viscous"
    assert found["poses"] == 2
    for joint, k, d in zip(found["joints"], SPRINGS, DAMPING, strict=True):
        if joint["identified"]:
            low, high = joint["interval"]
            # widened interval: 90 % intervals rarely contain all six true values
            assert low / (high / low) < k < high * (high / low)
        else:
            assert joint["interval"][1] is None
        low, high = joint["damping_interval"]
        if low is not None:
            assert low / (high / low) < d < high * (high / low)
    assert sum(joint["identified"] for joint in found["joints"]) >= 5
    stiffness = load_stiffness(out / "stiffness.yaml")
    np.testing.assert_allclose(stiffness.joints[:5], SPRINGS[:5], rtol=0.02)
    assert stiffness.covariance is not None
    process = load_process(out / "process.yaml")
    assert process.damping is not None
    modes = compute_arm_modes(
        load_dynamics(load_cell(CELL, bodies=False)).compute_mass_matrix(POSES), 1.0 / SPRINGS, np.zeros((2, 3, 6))
    )
    ratios = []  # from the complex roots of the damped equations of motion
    for M in load_dynamics(load_cell(CELL, bodies=False)).compute_mass_matrix(POSES):
        A = np.block(
            [
                [np.zeros((6, 6)), np.eye(6)],
                [-np.linalg.solve(M, np.diag(SPRINGS)), -np.linalg.solve(M, np.diag(DAMPING))],
            ]
        )
        roots = sorted((r for r in np.linalg.eigvals(A) if r.imag > 0.0), key=abs)
        ratios.append([-r.real / abs(r) for r in roots])
    listed = np.array(process.damping.ratios)
    np.testing.assert_allclose(listed[:3], np.mean(ratios, axis=0)[:3], rtol=0.03)
    assert found["modes"][0]["frequency_Hz"][0] == pytest.approx(modes.frequency[:, 0].min(), rel=0.01)
    assert "# kept" in (out / "process.yaml").read_text(encoding="utf-8")
    assert "Measured and fitted responses" in (out / "report.html").read_text(encoding="utf-8")
    assert (out / "frequency_responses.csv").read_text(encoding="utf-8").count("\n") == len(rows)


def test_unexcited_joint_gets_a_bound_without_interval(tmp_path: Path) -> None:
    """In a pose with a plane of symmetry, forces in this plane move joints 2, 3 and 5 only."""
    out = tmp_path / "out"
    folder = record(tmp_path / "r", build_rows(((2, 2), (0, 0)), poses=1))
    identified = machopt.identify_frequency_responses(CELL, folder)
    assert identified.save(out) == out / "stiffness.yaml"
    found = json.loads((out / "frequency_response.json").read_text(encoding="utf-8"))
    assert identified.is_identified == tuple(joint["identified"] for joint in found["joints"])
    np.testing.assert_allclose(identified.joint_damping, [joint["damping"] for joint in found["joints"]], rtol=1e-9)
    loose = [joint for joint in found["joints"] if not joint["identified"]]
    assert {1, 4} <= {joint["joint"] for joint in loose}
    assert all("do not determine" in joint["reason"] for joint in loose)
    for joint in loose:
        low, high = joint["interval"]
        assert high is None
        assert low < SPRINGS[joint["joint"] - 1]
    written = load_stiffness(out / "stiffness.yaml")
    np.testing.assert_allclose(identified.joint_stiffness, written.joints, rtol=1e-9)
    with pytest.raises(machopt.InputError, match="level_percent"):
        machopt.identify_frequency_responses(CELL, folder, level_percent=20.0)
    assert written.covariance is not None
    for joint in loose:
        n = joint["joint"] - 1
        assert written.covariance[n, n] == pytest.approx(written.joints[n] ** -2.0, rel=1e-6)


def test_coherence_gives_the_noise_of_each_frequency(tmp_path: Path) -> None:
    """The noise is |H|² (1 − γ²)/γ² for any |H|; its mean over seven frequencies is used."""
    rows = build_rows(((0, 0),), noise=0.0, poses=1)
    values = [row.split(",") for row in rows[1:]]
    size = np.array([math.hypot(float(v[2]), float(v[3])) for v in values])
    noise = 1e-8 * (1.0 + np.arange(len(size)))
    gamma = size**2 / (size**2 + noise**2)
    lines = [rows[0] + ",coherence", *(f"{row},{g!r}" for row, g in zip(rows[1:], gamma.tolist(), strict=True))]
    cell = load_cell(CELL, bodies=False)
    found = build_response_equations(
        load_frequency_responses(record(tmp_path / "r", lines)), cell, load_robot(cell), None
    )
    expected = [np.sqrt(np.mean(noise[max(n - 3, 0) : n + 4] ** 2)) for n in range(len(size))]
    np.testing.assert_allclose(found.shape, expected, rtol=0.03)  # coherences above 0.9999 are limited to that value


def test_uncertain_masses_widen_the_intervals(equations: ResponseEquations) -> None:
    """The added variance equals that of refits with the mass of one link changed at a time."""
    model, prior = build_response_model(equations, "viscous"), build_prior(SPRINGS, True)
    fit = fit_responses(model, np.log(np.concatenate([SPRINGS, DAMPING / SPRINGS * equations.reference])), prior)
    plain, wide = (np.diag(_compute_covariance(model, fit, sigma)) for sigma in (None, 0.05))
    assert (wide[:4] > 4.0 * plain[:4]).all()
    moved = np.zeros(12)
    for body in range(6):
        other = replace(equations, mass=equations.mass + 1e-3 * equations.body_mass[body])
        change = fit_responses(build_response_model(other, "viscous"), fit.x, prior).x - fit.x
        moved += (0.05 * change / 1e-3) ** 2
    np.testing.assert_allclose(np.sqrt(wide - plain)[:4], np.sqrt(moved)[:4], rtol=0.15)


def replace_cell(rows: list[str], line: int, column: str, value: str) -> list[str]:
    out = list(rows)
    cells = out[line - 1].split(",")
    cells[COLUMNS.index(column)] = value
    out[line - 1] = ",".join(cells)
    return out


def drop_column(rows: list[str], column: str) -> list[str]:
    k = COLUMNS.index(column)
    return [",".join(c for n, c in enumerate(row.split(",")) if n != k) for row in rows]


def scale(rows: list[str], factor: float) -> list[str]:
    out = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        cells[2:4] = [repr(factor * float(v)) for v in cells[2:4]]
        out.append(",".join(cells))
    return out


REFUSALS = {
    "nan": (lambda r: replace_cell(r, 7, "re_m_per_N", "nan"), "line 7, column re_m_per_N"),
    "negative frequency": (lambda r: replace_cell(r, 5, "frequency_Hz", "-5"), "line 5, column frequency_Hz"),
    "no direction": (lambda r: drop_column(r, "response_y"), "no column response_y"),
    "zero direction": (lambda r: replace_cell(r, 2, "excitation_x", "0"), "line 2, column excitation_x"),
    "millimetres": (lambda r: scale(r, 1e3), "mm/N are 1000 times as large"),
    "micrometres": (lambda r: scale(r, 1e6), "expected displacement over force in m/N"),
    "column in mm": (lambda r: [r[0].replace("re_m_per_N", "re_mm_per_N"), *r[1:]], "divide mm/N by 1000"),
    "cut off": (lambda r: [*r[:40], r[40][:20]], "line 41"),
    "few lines": (lambda r: r[:6], "5 frequencies; expected 8 or more"),
    "twice": (lambda r: [*r, r[-1]], "twice"),
    "two poses, one label": (lambda r: replace_cell(r, 3, "q1_deg", "3"), "column pose"),
    "zero response": (lambda r: replace_cell(replace_cell(r, 4, "re_m_per_N", "0"), 4, "im_m_per_N", "0"), "line 4"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_invalid_responses_are_refused_in_one_message(
    case: str, tmp_path: Path, rows: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    change, expected = REFUSALS[case]
    folder = record(tmp_path / "r", change(rows))
    assert main(["identify", str(CELL), str(folder), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert expected in message
    assert "data.csv" in message
    assert not (tmp_path / "out").exists()


def test_options_without_effect_are_refused(
    tmp_path: Path, rows: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = record(tmp_path / "r", rows), str(tmp_path / "out")
    assert main(["identify", str(CELL), str(folder), "-o", out, "--quiet", "--model", "grid"]) == 2
    assert "--model" in capsys.readouterr().err
    assert main(["identify", str(CELL), str(folder), str(folder), "-o", out, "--quiet"]) == 2
    assert "expected one of kind frf" in capsys.readouterr().err
    assert main(["identify", str(CELL), str(folder), "-o", out, "--dry-run"]) == 2
    assert "without --dry-run" in capsys.readouterr().err
    assert main(["diagnose", str(CELL), str(folder), "-o", out, "--quiet"]) == 2
    assert "is frf, frequency responses" in capsys.readouterr().err
    assert main(["process", str(CELL), str(folder), "-o", out, "--quiet"]) == 2
    assert "is frf" in capsys.readouterr().err


@pytest.mark.parametrize("labelled", [True, False])
def test_encoder_scatter_does_not_split_a_response(labelled: bool, rows: list[str], tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scattered = [rows[0]]
    for row in rows[1:]:
        cells = row.split(",")
        for n in range(1, 7):
            k = COLUMNS.index(f"q{n}_deg")
            cells[k] = f"{float(cells[k]) + rng.uniform(-0.01, 0.01):.6f}"
        scattered.append(",".join(cells))
    given = (rows, scattered) if labelled else tuple(drop_column(some, "pose") for some in (rows, scattered))
    exact, found = (load_frequency_responses(record(tmp_path / f"r{n}", some)) for n, some in enumerate(given))
    assert found.responses == exact.responses == 6
    assert np.array_equal(found.group, exact.group)


def test_one_label_for_two_poses_is_refused(rows: list[str], tmp_path: Path) -> None:
    same = [rows[0], *("1," + row.partition(",")[2] for row in rows[1:])]
    with pytest.raises(RecordingError, match="one label for each pose"):
        load_frequency_responses(record(tmp_path / "r", same))


@pytest.mark.parametrize("labelled", [0, 1])
def test_labels_in_one_of_two_files_are_refused(labelled: int, rows: list[str], tmp_path: Path) -> None:
    folder = record(tmp_path / "r", rows, HEAD.replace("data: data.csv", "data: [a.csv, b.csv]"))
    half = 1 + (len(rows) - 1) // 2
    parts = [[rows[0], *rows[1:half]], [rows[0], *rows[half:]]]
    for n, name in enumerate(("a.csv", "b.csv")):
        lines = parts[n] if n == labelled else drop_column(parts[n], "pose")
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="column pose is in some of the files only"):
        load_frequency_responses(folder)


def test_modes_below_the_measured_band_are_not_determined(equations: ResponseEquations) -> None:
    model, prior = build_response_model(equations, "viscous"), build_prior(SPRINGS, True)
    fit = fit_responses(model, np.log(np.concatenate([SPRINGS, DAMPING / SPRINGS * equations.reference])), prior)
    covariance = _compute_covariance(model, fit, None)
    whole = compute_modal_damping(model, fit, covariance)
    assert whole.known > 0
    narrow = replace(equations, omega=np.maximum(equations.omega, 2.0 * np.pi * 1.1 * whole.frequency[:, 0].max()))
    assert compute_modal_damping(build_response_model(narrow, "viscous"), fit, covariance).known == 0
