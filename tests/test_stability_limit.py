"""``min_stability_ratio``: respected along the executed path, refused if not computable, never lost by relaxing."""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from process.delay_reference import ChebyshevMap, semi_discretization_radius
from random_small_jobs import ROOT, choose_place_above_cut, random_job, write_job
from stability_postures import build_delay_system, choose_rows

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.errors import InputError
from machopt.verification.tables.csv_columns import read_columns

CELL = ROOT / "cells" / "kr500_milling"
PROCESS = CELL / "process.yaml"
COARSE = ("rotation_step_deg=10",)


def optimize(toolpath: Path, out: Path, *overrides: str, process: Path = PROCESS) -> int:
    request = OptimizeRequest(cell=CELL, toolpath=toolpath, out=out, overrides=(*COARSE, *overrides), process=process)
    return run_optimize(request).exit_code


def read_ratios(out: Path) -> np.ndarray:
    """Return the ratios of the milled points; inf where no limit is stated."""
    table = read_columns(out / "points.csv")
    milled = [n for n, word in enumerate(table["chatter"]) if word not in ("", "unknown")]
    return np.array([float(table["a_lim_mm"][n] or "inf") / float(table["ap_mm"][n]) for n in milled])


def read_result(out: Path) -> dict:
    return json.loads((out / "result.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_limit_is_respected_and_verified(tmp_path: Path) -> None:
    path = ROOT / "toolpaths" / "plain.csv"
    assert optimize(path, tmp_path / "free") == 0
    assert optimize(path, tmp_path / "kept", "min_stability_ratio=1.5") == 0
    assert read_ratios(tmp_path / "free").min() < 1.0
    assert read_ratios(tmp_path / "kept").min() >= 1.5 * (1.0 - 1e-4)
    stated = read_result(tmp_path / "kept")["process"]["stability"]
    assert stated["min_stability_ratio"] == 1.5
    assert stated["unstable"] == stated["unknown"] == 0
    assert stated["unknown_points"] == []
    checks = {c["name"]: c["passed"] for c in read_result(tmp_path / "kept")["verification"]["checks"]}
    assert checks["requested: min_stability_ratio"] is True
    assert checks["points.csv stability at min_stability_ratio"] is True


@pytest.mark.slow
def test_limit_holds_between_the_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All planning points of the executed path are checked, including those added between toolpath points."""
    from machopt.commands.optimize import computation

    plans = []
    original = computation.plan_job
    monkeypatch.setattr(computation, "plan_job", lambda *a, **k: plans.append(original(*a, **k)) or plans[-1])
    assert optimize(ROOT / "toolpaths" / "plain.csv", tmp_path / "out", "min_stability_ratio=1.3") == 0
    plan, stability = plans[-1].plan, plans[-1].plan.setup.arm.stability
    points = np.arange(len(plan.path.index))
    ratio = stability.compute_ratios(plan.setup.arm, plan.path, points, plan.chosen.assignment.q)
    assert np.isfinite(ratio).sum() > 100
    assert ratio.min() >= 1.3 * (1.0 - 1e-6)


@pytest.mark.slow
def test_points_without_a_stable_configuration_name_the_best_ratio(tmp_path: Path) -> None:
    path = ROOT / "toolpaths" / "contour_5axis.csv"
    short = tmp_path / "part.csv"
    rows = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    short.write_text("\n".join([rows[0], rows[1], *rows[420:520]]) + "\n", encoding="utf-8")
    assert optimize(short, tmp_path / "out", "min_stability_ratio=4") == 3
    points = read_result(tmp_path / "out")["infeasible_points"]
    unstable = [p for p in points if p["status"] == "unstable"]
    assert unstable
    assert all("min_stability_ratio" in p["help"] for p in unstable)
    best = [p["best_stability"]["ratio"] for p in unstable]
    assert all(0.0 < ratio < 4.0 for ratio in best)
    worst = min(best)  # a limit below it makes the points feasible again
    optimize(short, tmp_path / "less", f"min_stability_ratio={0.98 * worst:.3f}")
    again = read_result(tmp_path / "less")["infeasible_points"]
    assert not [p for p in again if p["status"] == "unstable"]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("modes:", "# modes:"), "damping_percent"),
        (("damping_percent: 3", "damping_percent: [3, 3]"), "damping_percent"),
        (
            (
                "kind: milling, material: al7075, spindle_rpm: 12000, ae_mm: 1, ap_mm: 6, cut: down, surface: side",
                "kind: force, force_N: {travel: 5}",
            ),
            "milling",
        ),
    ],
)
def test_incomputable_limit_is_refused(tmp_path: Path, change: tuple[str, str], word: str) -> None:
    text = PROCESS.read_text(encoding="utf-8")
    assert change[0] in text
    text = text.replace(*change)
    if "force_N" in change[1]:
        text = text.split("tolerance:")[0].rstrip().rstrip(",") + "}\n" + text[text.index("modes:") :]
    (tmp_path / "process.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        optimize(
            ROOT / "toolpaths" / "plain.csv",
            tmp_path / "out",
            "min_stability_ratio=1",
            process=tmp_path / "process.yaml",
        )
    assert error.value.where == "min_stability_ratio"
    assert word in str(error.value)


def test_limit_without_a_process_is_refused(tmp_path: Path) -> None:
    request = OptimizeRequest(
        cell=CELL, toolpath=ROOT / "toolpaths" / "plain.csv", out=tmp_path / "out", overrides=("min_stability_ratio=1",)
    )
    with pytest.raises(InputError) as error:
        run_optimize(request)
    assert error.value.where == "min_stability_ratio"


@pytest.mark.parametrize("value", ["0", "-1", "4.5", ".nan", "x"])
def test_ratios_out_of_range_are_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(InputError):
        optimize(ROOT / "toolpaths" / "plain.csv", tmp_path / "out", f"min_stability_ratio={value}")


RATIOS = (2.0, 1.4, 1.0, 0.6, 0.2, None)


def find_lost_ratios(seed: int, folder: Path) -> list[float | None]:
    """Return relaxed ratios at which a job is infeasible although it is feasible with a stricter one."""
    rng = np.random.default_rng(seed)
    origin, axis = choose_place_above_cut(ROOT / "toolpaths" / "contour_5axis.csv", rng)
    job = write_job(folder / "job.csv", random_job(rng, ("line", "arc", "pivot", "zigzag")), origin, axis)
    codes = {r: optimize(job, folder / str(r), *(() if r is None else (f"min_stability_ratio={r}",))) for r in RATIOS}
    feasible = False
    out = []
    for r, code in codes.items():
        if feasible and code != 0:
            out.append(r)
        feasible |= code == 0
    return out


@pytest.mark.slow
def test_relaxing_the_limit_keeps_a_job_feasible(tmp_path: Path) -> None:
    assert find_lost_ratios(3, tmp_path) == []


@pytest.mark.proof
@pytest.mark.parametrize("seed", [20, 22, 24])
def test_relaxing_the_limit_keeps_jobs_feasible(seed: int, tmp_path: Path) -> None:
    assert find_lost_ratios(seed, tmp_path) == []


@pytest.mark.slow
def test_limits_of_a_plan_against_semi_discretization(tmp_path: Path) -> None:
    """Modes by the verification, 24 intervals per tooth period, compared with collocation, whose error is far smaller.

    Where the law of second order determines the limit, it is 85 to 103 % of the exact one: the highest mode of the arm
    has ωT = 3.4 here, and the law is a safe bound only if all modes have ωT < 0.5. Otherwise it is an estimate.
    """
    job = ROOT / "toolpaths" / "plain.csv"
    assert optimize(job, tmp_path / "out") == 0
    governed = 0
    for row, limit in choose_rows(tmp_path / "out", 5):
        system, second_order = build_delay_system(CELL, PROCESS, job, tmp_path / "out", row)
        is_governed = limit > 0.99 * second_order
        below = (0.97 if is_governed else 0.95) * limit
        assert semi_discretization_radius(system, below, 24) < 1.0
        assert ChebyshevMap(system, 12).radius(below) < 1.0
        if is_governed:
            governed += 1
            assert semi_discretization_radius(system, limit / 0.85, 24) > 1.0
    assert governed >= 2


@pytest.mark.slow
def test_modes_of_the_tool_enter_the_limit(tmp_path: Path) -> None:
    """A soft spindle mode along the x axis of the tool: the executed cut respects the ratio of the smaller limit."""
    shutil.copytree(CELL, tmp_path / "cell")
    file = tmp_path / "cell" / "cell.yaml"
    text = file.read_text(encoding="utf-8")
    start = text.index("teeth:")
    mode = "modes: [{f_Hz: 400, zeta: 0.04, k_N_um: 0.3, direction: [1, 0, 0]}], "
    file.write_text(text[:start] + mode + text[start:], encoding="utf-8")
    job = ROOT / "toolpaths" / "plain.csv"
    words = {}
    for name, overrides in (("free", ()), ("kept", ("min_stability_ratio=0.76",))):
        request = OptimizeRequest(
            cell=tmp_path / "cell", toolpath=job, out=tmp_path / name, overrides=(*COARSE, *overrides), process=PROCESS
        )
        assert run_optimize(request).exit_code == 0
        words[name] = set(read_columns(tmp_path / name / "points.csv")["chatter"])
    assert "spindle" in words["free"]
    assert read_ratios(tmp_path / "kept").min() >= 0.76 * (1.0 - 1e-4)
    assert read_ratios(tmp_path / "free").min() < 0.76


@pytest.mark.slow
def test_points_of_unknown_stability_are_listed(tmp_path: Path) -> None:
    """The stability of a ball cutter is unknown: the constraint applies to the flat end mill alone."""
    cell = tmp_path / "cell"
    shutil.copytree(CELL, cell)
    content = yaml.safe_load((cell / "cell.yaml").read_text(encoding="utf-8"))
    flat = content.pop("tool")
    ball = copy.deepcopy(flat)
    ball["cutter"]["corner_radius_mm"] = 0.5 * ball["cutter"]["diameter_mm"]
    content["tools"] = {"1": flat, "2": ball}
    (cell / "cell.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation,tool,nx,ny,nz"]
    for tool in (1, 2):
        rows.append(f"60,-81,40,0,0,1,rapid,,a{tool},{tool},,,")
        rows += [f"{60 - 20 * n},-81,-0.5,0,0,1,cut,1200,a{tool},{tool},0,-1,0" for n in range(5)]
        rows.append(f"-20,-81,40,0,0,1,rapid,,a{tool},{tool},,,")
    (tmp_path / "job.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    found = {}
    for name, overrides in (("plain", ()), ("kept", ("min_stability_ratio=0.1",))):
        request = OptimizeRequest(
            cell=cell,
            toolpath=tmp_path / "job.csv",
            out=tmp_path / name,
            overrides=("rotation_step_deg=30", *overrides),
            process=PROCESS,
        )
        assert run_optimize(request).exit_code == 0
        found[name] = read_result(tmp_path / name)
    table = read_columns(tmp_path / "kept" / "points.csv")
    unknown = [n for n, word in enumerate(table["chatter"]) if word == "unknown"]
    stated = found["kept"]["process"]["stability"]
    assert (stated["unknown"], stated["stable"] + stated["unstable"]) == (5, 5)
    assert stated["unknown_points"] == [[unknown[0], unknown[-1]]]
    assert len(found["kept"]["warnings"]) == len(found["plain"]["warnings"]) + 1
    checks = {c["name"]: c["passed"] for c in found["kept"]["verification"]["checks"]}
    assert checks["min_stability_ratio at points of unknown stability"] is None
    assert "min_stability_ratio at points of unknown stability" not in {
        c["name"] for c in found["plain"]["verification"]["checks"]
    }
