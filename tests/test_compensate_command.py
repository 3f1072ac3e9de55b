"""``machopt optimize --compensate``: files, independent verification, detection of damaged files."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from output_damage.damage_case import update_manifest_hashes
from test_cli import changed_cell, optimize, result

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.data_types.plan_options import ProcessForce
from machopt.options.plan_option_reader import load_options
from machopt.report.template_rendering import bind_units
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.motion_verification import verify_motion

ROOT = FilePath(__file__).resolve().parent.parent
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> tuple[FilePath, FilePath, FilePath]:
    """The corner job on the KR500 with one long segment: toolpath, output without and with compensation."""
    folder = tmp_path_factory.mktemp("job")
    rows = [
        "-100,-60,40,0,0,1,rapid,,c",
        "-100,-60,-0.5,0,0,1,approach,1000,c",
        "60,-60,-0.5,0,0,1,cut,1500,c",
        "60,0,-0.5,0,0,1,cut,1500,c",
        "60,20,-0.5,0,0,1,cut,1500,c",
        "60,20,40,0,0,1,retract,1000,c",
    ]
    path = folder / "corner.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    coarse = ("--set", "rotation_step_deg=10")  # joint 4 turns by 49° between two planning points of the cut
    assert optimize(ROOT / "cells" / "kr500_milling", path, folder / "plain", *coarse) == 0
    assert optimize(ROOT / "cells" / "kr500_milling", path, folder / "shifted", "--compensate", *coarse) == 0
    return path, folder / "plain", folder / "shifted"


def table(file: FilePath) -> list[dict[str, str]]:
    with file.open() as lines:
        return list(csv.DictReader(lines))


def test_command_writes_the_shift_it_applies(job: tuple[FilePath, FilePath, FilePath]) -> None:
    path, plain, shifted = job
    assert not (plain / "compensation.csv").exists()
    assert "comp_dx_mm" not in table(plain / "points.csv")[0]
    assert result(plain)["compensation"] is None
    before, after = table(plain / "points.csv"), table(shifted / "points.csv")
    for a, b in zip(before, after, strict=True):
        assert [a[c] for c in ("x_mm", "y_mm", "z_mm", "i")] == [b[c] for c in ("x_mm", "y_mm", "z_mm", "i")]
        # rotation as executed, with rounded corners
        assert float(a["gamma_deg"]) == pytest.approx(float(b["gamma_deg"]), abs=0.1)
    comp = np.array([[float(r[f"comp_d{c}_mm"]) for c in "xyz"] for r in after])
    size, bend = np.linalg.norm(comp, axis=1), np.array([float(r["deflection_mm"]) for r in after])
    cut = np.array([r["move"] == "cut" for r in after])
    assert cut.tolist() == [False, False, True, True, True, False]
    np.testing.assert_allclose(size[3:5], bend[3:5], rtol=0.01)  # the executed rotation is slightly smoother
    assert size[2] < bend[2]  # the corner, where the force direction changes
    found = result(shifted)["compensation"]
    assert isinstance(found, dict)
    rows = np.array([[float(v) for v in r.values()] for r in table(shifted / "compensation.csv")])
    cutting = (rows[:, 0] > 1 + 1e-9) & (rows[:, 0] <= 4)
    assert found["max_mm"] == pytest.approx(np.linalg.norm(rows[cutting, 1:4], axis=1).max(), abs=1e-6)
    assert 0 < found["residual_mean_mm"] < 0.05 * found["uncompensated_mean_mm"]
    assert found["residual_max_mm"] < 2 * found["max_mm"]  # the force changes direction within 2 mm at the corner
    report = (shifted / "report.html").read_text()
    assert "the commanded path is shifted by up to" in report
    assert "c-shift" in report
    assert "c-shift" not in (plain / "report.html").read_text()
    assert json.loads((shifted / "result.json").read_text())["options"]["compensate"] is True
    # the program contains the shifted points and intermediate points where the path is not straight: 160 mm in eight
    # pieces
    program = (shifted / "corner_csv.src").read_text()
    lin = np.array([[float(v) for v in m] for m in re.findall(r"LIN \{X (\S+?),Y (\S+?),Z (\S+?),", program)])
    corners = np.array([[float(r[c]) for c in ("x_mm", "y_mm", "z_mm")] for r in after]) + comp
    for target in corners[1:]:
        assert np.linalg.norm(lin - target, axis=1).min() < 2e-4  # four decimals
    assert len(lin) >= len(table(path)) - 1
    # the feed is unchanged except at the corner, which becomes a step of half a millimetre
    assert result(shifted)["feed_held_share"] > result(plain)["feed_held_share"] - 0.05  # type: ignore[operator]
    assert found["length_mm"] in (5.0, 10.0, 20.0, 40.0)
    assert found["fade_mm"] in (5.0, 10.0, 20.0, 40.0)
    for verdict in (result(plain), result(shifted)):
        assert verdict["verification"]["passed"]  # type: ignore[index]  # limits, feed, path, contacts


def test_page_and_result_show_the_same_mean_and_maximum(job: tuple[FilePath, FilePath, FilePath]) -> None:
    """Mean over the cutting length, from the objective, in every place where it is shown."""
    for out in job[1:]:
        found = result(out)
        chosen = found["objective"]["chosen"]  # type: ignore[index]
        page = (out / "report.html").read_text()
        for name in ("mean", "worst"):
            card = re.search(rf"{name} deflection</div><div class=value>(\S+) <small>mm", page)
            assert card is not None
            assert float(card[1]) == pytest.approx(1e3 * chosen[name] * found["index_scale"], abs=5.1e-4)
        gain = {g["over"]: g for g in found["objective"]["gain"]}["jiao2022"]  # type: ignore[index]
        other = found["objective"]["jiao2022"]["mean"]  # type: ignore[index]
        # a shifted path is some micrometres longer, which changes its weights
        exact = 1e-9 if out == job[1] else 1e-3
        assert gain["mean_percent"] == pytest.approx(100 * (1 - chosen["mean"] / other), rel=exact)
        assert gain["std_percent"] is None  # the shipped file states no covariance
        assert bind_units(f"mean deflection {gain['mean_percent']:.0f} % less than with Jiao 2022") in page


def checks(out: FilePath, path: FilePath, **changes: object) -> dict[str, object]:
    cell = load_cell(ROOT / "cells" / "kr500_milling")
    options = replace(load_options(cell.plan), **changes)  # type: ignore[arg-type]
    return {c.name: c.passed for c in verify_motion(cell, read_toolpath(path), out, options=options).checks}


def test_verification_recomputes_the_shift(job: tuple[FilePath, FilePath, FilePath], tmp_path: FilePath) -> None:
    path, plain, shifted = job
    sound = checks(shifted, path)
    assert all(sound.values())
    assert {"compensation", "process force", "points.csv and compensation.csv"} <= set(sound)
    assert {"compensation smooth", "compensation bounded"} <= set(sound)
    assert checks(shifted, path, compensation_max=1e-4)["compensation bounded"] is False
    assert main(["verify", str(ROOT / "cells" / "kr500_milling"), str(path), str(shifted), "--quiet"]) == 0
    # the force is not stated here: the check is reported as not done
    assert checks(shifted, path, force=ProcessForce())["process force"] is None
    assert checks(shifted, path, force=ProcessForce(travel=120, normal=-250, axial=80))["process force"] is False
    assert checks(shifted, path, force=ProcessForce(travel=120, normal=250, axial=90))["process force"] is False

    def damaged(name: str, edit: dict[str, str], of: FilePath = shifted) -> set[str]:
        out = tmp_path / name
        shutil.copytree(of, out)
        for file, pattern in edit.items():
            rows = table(out / file)
            column, change = pattern.split("=")
            for r in rows:
                r[column] = f"{eval(change, {'x': float(r[column])}):.6f}"
            with (out / file).open("w", newline="") as lines:
                writer = csv.DictWriter(lines, rows[0])
                writer.writeheader()
                writer.writerows(rows)
        return {n for n, passed in checks(out, path).items() if passed is False}

    both = {"points.csv": "comp_dy_mm=x*1.2-0.01", "compensation.csv": "dy_mm=x*1.2-0.01"}
    assert {"compensation", "path"} <= damaged("more", both)
    assert "points.csv and compensation.csv" in damaged("one", {"points.csv": "comp_dz_mm=x+0.001"})
    assert {"compensation", "process force"} <= damaged("weaker", {"compensation.csv": "fy_N=0.9*x"})
    assert "compensation smooth" in damaged("jump", {"compensation.csv": "dx_mm=x+0.3*round(abs(x)*1e4)%2"})
    # motion of the uncompensated job with the tables of the compensated one
    out = tmp_path / "swapped"
    shutil.copytree(shifted, out)
    shutil.copy(plain / "trajectory.csv", out / "trajectory.csv")
    assert checks(out, path)["path"] is False
    (out / "compensation.csv").unlink()
    assert checks(out, path) == {"compensation.csv can be read": False}


def test_compliance_terms_enter_the_shift_and_its_verification(tmp_path: FilePath) -> None:
    """irb6700 drilling with compliance of link 4 and the tool: larger deflection and shift, verified by independent
    formulas."""
    path = tmp_path / "holes.csv"
    holes = [
        f"{x},-120,{z},0,0,1,{move},{feed},h"
        for x in (-150, -110)
        for z, move, feed in ((25, "rapid", ""), (-12, "cut", "260"), (25, "retract", "1000"))
    ]
    path.write_text(HEADER + "\n".join(holes) + "\n")
    stiff = ROOT / "cells" / "irb6700_drilling"
    soft = changed_cell(tmp_path, base=stiff)
    text = (soft / "stiffness.yaml").read_text()
    terms = """terms:
  - {effect: link_compliance, location: "link:4", parameters: {EI_Nm2: 3.0e+5, GJ_Nm2: 2.0e+5}}
  - {effect: tool_compliance, location: tool, parameters: {EI_Nm2: 2.0e+4, GJ_Nm2: 1.0e+4}}
  - {effect: geometric_stiffness, location: arm}
"""
    (soft / "stiffness.yaml").write_text(text + terms)
    found = {}
    for cell, name in ((stiff, "stiff"), (soft, "soft")):
        out = tmp_path / name
        assert optimize(cell, path, out, "--compensate", "--set", "rotation_step_deg=10") == 0
        found[name] = result(out)
    objective = [found[n]["objective"]["chosen"]["mean"] * found[n]["index_scale"] for n in found]  # type: ignore[index,call-overload]
    assert objective[1] > 1.05 * objective[0]
    compensation = [found[n]["compensation"]["mean_mm"] for n in found]  # type: ignore[index,call-overload]
    assert compensation[1] == pytest.approx(1e3 * objective[1], rel=0.01)
    assert compensation[0] == pytest.approx(1e3 * objective[0], rel=0.01)
    states = {c["name"]: c for c in found["soft"]["verification"]["checks"]}  # type: ignore[index,call-overload]
    assert states["compensation"]["passed"] is True  # the verifier computes every term independently
    assert states["path"]["passed"] is True


def test_job_infeasible_after_the_shift_ends_as_infeasible(
    tmp_path: FilePath, job: tuple[FilePath, FilePath, FilePath]
) -> None:
    cell = changed_cell(tmp_path)
    (cell / "stiffness.yaml").write_text("machopt_stiffness: 1\njoints_Nm_per_rad: [1e5, 1e5, 1e5, 1e5, 1e5, 1e5]\n")
    out = tmp_path / "out"
    assert optimize(cell, job[0], out, "--compensate", "--set", "rotation_step_deg=30", "--set", "collision=false") == 3
    found = result(out)
    assert found["compensation"] is None
    reasons = [p["reason"] for p in found["infeasible_points"]]  # type: ignore[attr-defined]
    assert reasons
    assert all("the shift against the deflection is refused: it is" in r for r in reasons)
    assert [p["point"] for p in found["infeasible_points"]] == [1, 2, 3, 4, 5]  # type: ignore[attr-defined]
    assert all("mm, more than compensation_max_mm 2" in r for r in reasons[:4])
    assert "mm per mm of path, more than 0.1" in reasons[4]  # along the retract move, in which the shift fades out
    assert not (out / "trajectory.csv").exists()


def test_rotation_is_chosen_that_allows_the_shift_to_be_driven(tmp_path: FilePath) -> None:
    """At the stiffest rotation the deflection changes too quickly; the adjacent rotation is chosen and reported."""
    u = np.linspace(0.0, 1.0, 15)
    t, b = 0.4 * np.sin(2 * np.pi * u), 0.6 * np.cos(12 * u)
    axis = np.column_stack([np.sin(t) * np.cos(b), np.sin(b) * np.cos(t), np.cos(t) * np.cos(b)])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    tip = np.column_stack([150 * u - 225, 40 + 20 * np.sin(6 * u), np.full(15, -10.0)])
    rows = [(tip[0] + 40 * axis[0], axis[0], "rapid", ""), (tip[0] + 5 * axis[0], axis[0], "approach", "1000")]
    rows += [(p, a, "cut", "1000") for p, a in zip(tip, axis, strict=True)]
    rows += [(tip[-1] + 5 * axis[-1], axis[-1], "retract", "1000")]
    lines = [",".join(f"{v:.6f}" for v in (*p, *a)) + f",{move},{feed},s" for p, a, move, feed in rows]
    path = tmp_path / "swarf.csv"
    path.write_text(HEADER + "\n".join(lines) + "\n")
    cell = ROOT / "cells" / "irb6700_drilling"
    settings = ("rotation_step_deg=20", "force_N.axial=750", "compensation_max_mm=5")
    arguments = ("--compensate", *(word for setting in settings for word in ("--set", setting)))
    assert optimize(cell, path, tmp_path / "out", *arguments) == 0
    message = (tmp_path / "out" / "report.html").read_text()
    assert "with that one the path shifted against the deflection could not be driven" in message
    assert "steer" not in result(tmp_path / "out")["options"]  # type: ignore[operator]  # the user asked for none


@pytest.mark.slow
def test_pecked_holes_have_a_stated_residual(tmp_path: FilePath) -> None:
    """Each peck is one cutting move with force, between moves without force."""
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for x in (-150, -50):
        rows += [f"{x},-200,{z},0,0,1,rapid," for z in (40, 25)]
        for z in (16, 8):
            rows += [f"{x},-200,{z},0,0,1,cut,420", f"{x},-200,25,0,0,1,retract,", f"{x},-200,{z + 1},0,0,1,rapid,"]
        rows += [f"{x},-200,0,0,0,1,cut,420", f"{x},-200,40,0,0,1,retract,"]
    (tmp_path / "pecks.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    arguments = ["optimize", str(ROOT / "cells" / "kr240_drilling"), str(tmp_path / "pecks.csv"), "-o", str(out)]
    assert main([*arguments, "--quiet", "--set", "compensate=true", "--set", "rotation_step_deg=15"]) == 0
    found = json.loads((out / "result.json").read_text(encoding="utf-8"))["compensation"]
    assert found is not None
    assert 0.0 < found["residual_mean_mm"] < 0.5 * found["uncompensated_mean_mm"]


def plan_pecks(folder: FilePath, rows: list[str], strength: tuple[float, float]) -> dict[str, float]:
    """Compensate a pecked hole through two layers; ``strength``: kc1 of the upper and the lower layer, N/mm²."""
    (folder / "pecks.csv").write_text("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n" + "\n".join(rows) + "\n")
    materials = ""
    for name, kc1 in zip(("upper", "lower"), strength, strict=True):
        law = f"kc1: {kc1}, mc: 0.25, chisel_N_mm2: {0.3 * kc1}"
        spread = "thrust_spread_percent: 2, torque_spread_percent: 2, source: t"
        materials += f"  {name}: {{drilling: {{{law}, {spread}}}}}\n"
    (folder / "process.yaml").write_text(
        f"machopt_process: 1\nmaterials:\n{materials}"
        "operations:\n  default: {kind: drilling, spindle_rpm: 4000, depth_mm: 18,\n"
        "    layers: [{material: upper, thickness_mm: 10}, {material: lower, thickness_mm: 7}]}\n"
    )
    given = ("--process", str(folder / "process.yaml"), "--compensate", "--set", "compensation_max_mm=9")
    files = (str(ROOT / "cells" / "kr240_drilling"), str(folder / "pecks.csv"), "-o", str(folder / "out"))
    assert main(["optimize", *files, *given, "--set", "rotation_step_deg=30", "--quiet"]) == 0
    found: dict[str, float] = json.loads((folder / "out" / "result.json").read_text())["compensation"]
    return found


def list_pecks(tops: tuple[float, float]) -> list[str]:
    """Return the cuts of the three pecks and the feed moves between them, with a retract height after each."""
    rows = []
    for z, top in zip((16, 8), tops, strict=True):
        rows += [f"-150,-200,{z},0,0,1,cut,420", f"-150,-200,{top},0,0,1,retract,3000"]
        rows += [f"-150,-200,{z + 1},0,0,1,approach,3000"]
    return [*rows, "-150,-200,0,0,0,1,cut,420", "-150,-200,40,0,0,1,retract,3000"]


@pytest.mark.slow
def test_pecks_of_different_thrust_are_fully_corrected(tmp_path: FilePath) -> None:
    """The shift changes in the air between the pecks and is constant in the cuts, also with long retract moves."""
    rows = [f"-150,-200,{z},0,0,1,rapid," for z in (40, 25)]
    found = plan_pecks(tmp_path, [*rows, *list_pecks((25, 25))], (800, 2000))
    assert found["uncompensated_mean_mm"] > 1.0
    assert found["residual_max_mm"] < 0.01


@pytest.mark.slow
def test_fade_length_grows_only_where_the_shift_fades(tmp_path: FilePath, capsys: pytest.CaptureFixture[str]) -> None:
    """Between the last two pecks the shift changes too quickly; a longer fade would only remove the ramp of the
    approach."""
    rows = [f"-150,-200,{z},0,0,1,rapid," for z in (60, 45)] + ["-150,-200,20,0,0,1,approach,3000"]
    found = plan_pecks(tmp_path, [*rows, *list_pecks((25, 14))], (100, 1300))
    assert (found["length_mm"], found["fade_mm"]) == (10.0, 20.0)
    first = [r for r in table(tmp_path / "out" / "compensation.csv") if float(r["point"]) == 1.0]
    assert len(first) == 1
    assert all(float(first[0][f"d{c}_mm"]) == 0.0 for c in "xyz")  # the approach of 28 mm starts without shift
    file = tmp_path / "out" / "result.json"
    text = file.read_text(encoding="utf-8")
    for name in ("length_mm", "fade_mm"):
        document = json.loads(text)
        document["compensation"][name] = 40.0
        file.write_text(json.dumps(document), encoding="utf-8")
        update_manifest_hashes(tmp_path / "out")
        given = (str(ROOT / "cells" / "kr240_drilling"), str(tmp_path / "pecks.csv"), str(tmp_path / "out"))
        process = ("--process", str(tmp_path / "process.yaml"))
        assert main(["verify", *given, *process, "--quiet"]) == 4
        assert "turns and fades" in capsys.readouterr().err
