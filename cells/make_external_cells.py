"""Writes the example cells with external axes: a KR500 on a rail, a KR240 beside a two-axis turntable.

Run ``python cells/make_external_cells.py [cell …]``. Arms, tools and stiffness are those of ``make_cells.py``; here are
the rail and the turntable, the parts and what they stand on. Lengths in mm.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from making.cellfiles import CellFiles, as_list, block
from making.kr240 import kr240_drilling
from making.kr500 import kr500_milling
from making.shapes import box, cylinder
from making.written import JERK_TIME, write_cell

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class External:
    """What a cell has beyond one of ``make_cells.py``."""

    cell: CellFiles
    urdf: str  # links and joints
    joints: tuple[str, ...]
    home: tuple[float, ...]  # mm or deg
    velocity: tuple[float, ...]  # mm/s or deg/s
    acceleration: tuple[float, ...]
    link: str  # that the workpiece stands on
    base_mm: tuple[float, float, float]  # the URDF's root in world
    plan: str = ""  # YAML lines


def solid(shape: str, xyz: str) -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry>{shape}</geometry></collision>'


def joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "", limit: str = "") -> str:
    end = f'<axis xyz="{axis}"/><limit {limit} effort="0"/>' if axis else ""
    return (
        f'  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{end}</joint>'
    )


def kr500_rail() -> External:
    """6 m of rail along y; a beam of 6 m beside it, longer than the arm reaches from any one place."""
    x, z = 2100.0, 900.0  # middle of the beam's top
    cell = replace(
        kr500_milling(),
        folder="kr500_rail",
        title="KR500 on a 6 m rail, milling a beam longer than its reach",
        workpiece_mm=(x, 0, z),
        workpiece_rpy=(0, 0, 0),
        workpiece_mesh=box((-0.2, -3.0, -0.12), (0.2, 3.0, 0.0)),
        obstacles=(
            block("bed", (900, 8000, 200), (0, 0, 100)),
            block("table", (500, 6200, 60), (x, 0, z - 152)),
            *(
                block(f"stand_{k}", (400, 300, z - 184), (x, y, (z - 184) / 2))
                for k, y in enumerate((-2400, 0, 2400), 1)
            ),
        ),
        extra={},
    )
    carriage = solid('<box size="1.0 1.3 0.23"/>', "0 0 -0.125")
    urdf = "\n".join(
        [
            '  <link name="hall"/>',
            f'  <link name="carriage">{carriage}</link>',
            joint("rail", "prismatic", "hall", "carriage", "0 -3 0.45", "0 1 0", 'lower="0" upper="6" velocity="1.2"'),
            joint("stand", "fixed", "carriage", "base_link", "0 0 0"),
        ]
    )
    plan = "  external: {rail: {mode: moving}}"
    return External(cell, urdf, ("rail",), (3000.0,), (1200.0,), (1500.0,), "world", (0, 0, 0), plan)


def kr240_turntable() -> External:
    """A turn-tilt table in front of the arm; a drum of 600 mm on it, drilled all round."""
    x, z = 2000.0, 700.0  # the tilt axis
    cell = replace(
        kr240_drilling(),
        folder="kr240_turntable",
        title="KR240 with a two-axis turntable, drilling round a drum",
        workpiece_mm=(0, 0, 40),
        workpiece_rpy=(0, 0, 0),
        workpiece_mesh=cylinder("z", 0.0, 0.4, 0.3, n=96),
        obstacles=(
            block("pedestal", (900, 900, 194), (0, 0, 97)),
            block("post_left", (250, 120, z), (x, 560, z / 2)),
            block("post_right", (250, 120, z), (x, -560, z / 2)),
        ),
        extra={},
    )
    cradle = [
        solid('<box size="0.5 0.94 0.1"/>', "0 0 -0.15"),
        solid('<box size="0.2 0.06 0.26"/>', "0 0.45 -0.03"),
        solid('<box size="0.2 0.06 0.26"/>', "0 -0.45 -0.03"),
    ]
    plate = solid('<cylinder radius="0.35" length="0.04"/>', "0 0 0.02")
    urdf = "\n".join(
        [
            '  <link name="hall"/>',
            f'  <link name="cradle">{"".join(cradle)}</link>',
            f'  <link name="plate">{plate}</link>',
            joint("stand", "fixed", "hall", "base_link", "0 0 0.2"),
            joint("tilt", "revolute", "hall", "cradle", "2 0 0.7", "0 1 0", 'lower="-1.6" upper="1.6" velocity="1.5"'),
            joint("turn", "revolute", "cradle", "plate", "0 0 -0.09", "0 0 1", 'lower="-6.3" upper="6.3" velocity="2"'),
        ]
    )
    plan = "  external: {tilt: {mode: moving}, turn: {mode: moving}}"
    speed, rate = (80.0, 110.0), (160.0, 220.0)
    return External(cell, urdf, ("tilt", "turn"), (0.0, 0.0), speed, rate, "plate", (0, 0, 0), plan)


def write(made: External, cells: Path) -> None:
    """The cell of ``make_cells.py``, then what is added to it, into its folder among ``cells``."""
    write_cell(made.cell, cells)
    folder = cells / made.cell.folder
    urdf = (folder / "robot.urdf").read_text(encoding="utf-8")
    urdf = urdf.replace("made by cells/make_cells.py", "made by cells/make_external_cells.py")
    (folder / "robot.urdf").write_text(urdf.replace("</robot>", f"{made.urdf}\n</robot>"), encoding="utf-8")
    text = (folder / "cell.yaml").read_text(encoding="utf-8")

    def change(old: str, new: str) -> None:
        nonlocal text
        if text.count(old) != 1:
            raise ValueError(f"{old!r} stands {text.count(old)} times in {folder}/cell.yaml")
        text = text.replace(old, new)

    def append(key: str, values: tuple[float, ...]) -> None:
        line = next(row for row in text.splitlines() if row.strip().startswith(f"{key}:"))
        change(line, f"{line[:-1]}, {', '.join(f'{v:.6g}' for v in values)}]")

    change("made by cells/make_cells.py", "made by cells/make_external_cells.py")
    change("external_joints: []", f"external_joints: [{', '.join(made.joints)}]")
    change(f"pose: {{xyz_mm: {as_list(made.cell.base_mm)}, rpy", f"pose: {{xyz_mm: {as_list(made.base_mm)}, rpy")
    change("  link: world", f"  link: {made.link}")
    append("home_deg", made.home)
    append("velocity_deg_s", made.velocity)
    append("acceleration_deg_s2", made.acceleration)
    append("jerk_deg_s3", tuple(a / JERK_TIME for a in made.acceleration))
    (folder / "cell.yaml").write_text(f"{text}{made.plan}\n" if made.plan else text, encoding="utf-8")


CELLS: dict[str, Callable[[], External]] = {"kr500_rail": kr500_rail, "kr240_turntable": kr240_turntable}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or CELLS:
        write(CELLS[wanted](), HERE)
        print(HERE / wanted)
