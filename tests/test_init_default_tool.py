"""Default tool of ``init``: bodies end at the cutter for any angle; meshes have the same size in any unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_cell import urdf_text

from machopt.cell_setup.template.default_tool import build_tool
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.init_result import InitResult
from machopt.cell_setup.workpiece_placement import find_flange_direction, is_on_last_axis
from machopt.cli import main
from machopt.collision.collision_model import CollisionModel
from machopt.commands.init import run_init
from machopt.commands.validate import run_validate
from machopt.data_types.cell import Cell
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain, load_robot

PLACE = (1500.0, 0.0, 600.0)


def run_init_on_arm(folder: Path, text: str | None = None, **options: object) -> InitResult:
    (folder / "arm.urdf").write_text(text or urdf_text())
    return run_init(InitRequest(robot=folder / "arm.urdf", out=folder / "cell", workpiece_mm=PLACE, **options))  # type: ignore[arg-type]


def spindle_ends(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Return the rear and front end (3,) m of the spindle axis in the flange frame, seen along z of the TCP."""
    spindle = next(s for s in cell.tool.geometry if s.name == "spindle")
    axis, middle = spindle.T_parent_shape[:3, 2], spindle.T_parent_shape[:3, 3]
    ends = [middle + way * axis * spindle.size[1] / 2 for way in (-1.0, 1.0)]
    z = cell.tool.T_flange_tcp[:3, 2]
    first, last = sorted(ends, key=lambda p: float(p @ z))
    return first, last


@pytest.mark.parametrize("length", [None, 120.0, 250.0])
@pytest.mark.parametrize("angle", [0.0, 45.0, 90.0])
def test_tool_and_tool_point_match(angle: float, length: float | None, tmp_path: Path) -> None:
    cell = run_init_on_arm(tmp_path, tool_angle_deg=angle, tool_length_mm=length).cell
    assert cell.tool.cutter is not None
    T, out = cell.tool.T_flange_tcp, find_flange_direction(load_robot(cell))
    assert out is not None
    assert np.degrees(np.arccos(np.clip(T[:3, 2] @ out, -1, 1))) == pytest.approx(angle, abs=1e-3)
    rear, front = spindle_ends(cell)
    np.testing.assert_allclose(front + cell.tool.cutter.length * T[:3, 2], T[:3, 3], atol=2e-5)
    assert np.cross(front - rear, T[:3, 2]) == pytest.approx([0, 0, 0], abs=1e-5)
    assert [s.name for s in cell.tool.geometry] == (["bracket", "spindle"] if angle else ["spindle"])
    bodies = load_chain(cell)
    assert CollisionModel(cell, *bodies, 0.002).suspicious == ()
    output = [f.text for f in run_validate(tmp_path / "cell").findings if f.where.startswith("tool")]
    assert len(output) == (angle == 0.0)  # on axis 6: the rotation has no effect


def test_default_tool_is_a_bracket_of_45_degrees(tmp_path: Path) -> None:
    done = run_init_on_arm(tmp_path)
    assert done.cell.tool.T_flange_tcp[:3, 2] @ find_flange_direction(load_robot(done.cell)) == pytest.approx(
        np.sqrt(0.5), abs=1e-5
    )
    assert not any("expected gain 0" in g for g in done.guesses)


@pytest.mark.parametrize(
    "options",
    [
        {"tool_angle_deg": 0.0},
        {"tool_length_mm": 200.0},
        {"tcp_mm": (0.0, 0.0, 0.0)},
        {"tcp_rpy_deg": (0.0, 90.0, 0.0)},
    ],
)
def test_tool_on_the_last_axis_is_reported_immediately(options: dict[str, object], tmp_path: Path) -> None:
    robot = load_robot(run_init_on_arm(tmp_path, tool_angle_deg=90.0).cell)
    out = find_flange_direction(robot)
    assert out is not None
    if "tcp_mm" in options:
        options = {"tcp_mm": tuple(250.0 * out)}
    if "tcp_rpy_deg" in options:  # about another axis than the last one: not reported
        options = {"tcp_mm": tuple(250.0 * out + np.array([50.0, 50.0, 50.0]))}
    (tmp_path / "other").mkdir()
    done = run_init_on_arm(tmp_path / "other", **options)
    on_axis = is_on_last_axis(load_robot(done.cell), done.cell.tool.T_flange_tcp)
    assert any("expected gain 0 %" in g for g in done.guesses) == on_axis
    assert on_axis == (abs(float(np.linalg.norm(np.cross(out, done.cell.tool.T_flange_tcp[:3, 3])))) < 1e-3)


@pytest.mark.parametrize("options", [{"tcp_mm": (0.0, 0.0, 300.0)}, {"tcp_rpy_deg": (0.0, 0.0, 0.0)}])
def test_angle_beside_a_stated_tool_point_is_refused(options: dict[str, object], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--tool-angle-deg"):
        run_init_on_arm(tmp_path, tool_angle_deg=45.0, **options)
    run_init_on_arm(tmp_path, tool_angle_deg=0.0, **options)


def test_command_accepts_three_angles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.urdf").write_text(urdf_text())
    command = ["init", str(tmp_path / "arm.urdf"), "--workpiece-mm", "1500,0,600"]
    for angle in ("0", "45", "90"):
        assert main([*command, "-o", str(tmp_path / angle), "--tool-angle-deg", angle]) == 0
        assert ("expected gain 0 %" in capsys.readouterr().out) == (angle == "0")
    with pytest.raises(SystemExit, match="2"):
        main([*command, "-o", str(tmp_path / "c"), "--tool-angle-deg", "30"])
    assert main([*command, "-o", str(tmp_path / "d"), "--cutter-length-mm", "200"]) == 2
    assert "--tool-length-mm" in capsys.readouterr().err
    assert main([*command, "-o", str(tmp_path / "d"), "--cutter-length-mm", "200", "--tool-length-mm", "300"]) == 0


@pytest.mark.parametrize("seed", range(10))
def test_tool_points_along_its_spindle_in_any_flange_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    out = rng.normal(size=3)
    out /= np.linalg.norm(out)
    for angle in (0.0, 45.0, 90.0):
        tool = build_tool(out, angle, 200.0, 40.0)
        tip = np.array(tool.tcp_mm)
        along = 200.0 if angle == 0.0 else 80.0 + 120.0 * np.cos(np.radians(angle))
        assert tip @ out == pytest.approx(along, abs=0.01)
        assert np.linalg.norm(tip - (tip @ out) * out) == pytest.approx(
            0.0 if angle == 0.0 else 120.0 * np.sin(np.radians(angle)), abs=0.01
        )


SPINDLE = trimesh.creation.box((0.1, 0.1, 0.16))
UNITS = {"m": 1.0, "mm": 1e3, "inch": 1 / 0.0254}


@pytest.mark.parametrize("unit", sorted(UNITS))
@pytest.mark.parametrize("role", ["tool", "workpiece"])
@pytest.mark.parametrize("stated", [True, False])
def test_mesh_has_its_size_in_every_unit(role: str, unit: str, stated: bool, tmp_path: Path) -> None:
    """Inches cannot be recognised from the size: they must be stated."""
    if unit == "inch" and not stated:
        return
    mesh = SPINDLE.copy()
    mesh.apply_scale(UNITS[unit])
    file = tmp_path / "body.stl"
    mesh.export(file)
    done = run_init_on_arm(tmp_path, **{f"{role}_mesh": file}, mesh_unit=unit if stated else None)
    shapes = done.cell.tool.geometry if role == "tool" else done.cell.workpiece.geometry
    assert shapes[0].size[0] * UNITS[unit] == pytest.approx(1.0)
    assert any("--mesh-unit" in g for g in done.guesses) == (unit == "mm" and not stated)


@pytest.mark.parametrize(
    ("size", "scale", "factor"),
    [
        (0.3, None, 1.0),
        (300.0, None, 1e-3),
        (300.0, "0.001 0.001 0.001", 1.0),
        (3e5, "0.001 0.001 0.001", 1e-3),
        (900.0, None, 1e-3),
        (1500.0, "1 1 1", 1e-3),
    ],
)
def test_link_in_millimetres_is_scaled_with_a_note(
    size: float, scale: str | None, factor: float, tmp_path: Path
) -> None:
    trimesh.creation.box((size, size / 3, size / 3)).export(tmp_path / "link.stl")
    attribute = "" if scale is None else f' scale="{scale}"'
    mesh = f'<collision><geometry><mesh filename="link.stl"{attribute}/></geometry></collision>'
    visual = mesh.replace("collision>", "visual>")
    text = urdf_text().replace('<link name="flange"/>', f'<link name="flange">{visual}{mesh}</link>')
    done = run_init_on_arm(tmp_path, text)
    shapes = [s.shape for s in load_chain(done.cell)[1] if s.shape.kind == "mesh"]
    assert shapes[0].size[0] == pytest.approx(factor * (1.0 if scale is None else float(scale.split()[0])))
    assert bool(done.notes) == (factor != 1.0)
