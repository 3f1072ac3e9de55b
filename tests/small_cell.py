"""A small cell for tests: a KUKA-like arm of primitives, a table, a block to be machined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.cell import Cell, CollisionShape, CutterGeometry, JointLimits, Tool, Workpiece

OWN = Path(__file__).resolve().parent / "vendored_files" / "robots"  # sources in SOURCES.md
BESIDE = (
    Path(__file__).resolve().parents[2] / "shared" / "data" / "robots"
)  # more robots, next to a development checkout

# name, parent → child, joint origin, axis, limits in deg (dimensions of a KR 210)
_JOINTS = [
    ("a1", (0.0, 0.0, 0.675), "0 0 -1", (-185, 185)),
    ("a2", (0.350, 0.0, 0.0), "0 1 0", (-140, -5)),
    ("a3", (1.150, 0.0, 0.0), "0 1 0", (-120, 155)),
    ("a4", (1.0, 0.0, 0.041), "-1 0 0", (-350, 350)),
    ("a5", (0.0, 0.0, 0.0), "0 1 0", (-125, 125)),
    ("a6", (0.215, 0.0, 0.0), "-1 0 0", (-350, 350)),
]
_BODIES = {
    0: [('<box size="0.6 0.6 0.4"/>', "0 0 0.2", "0 0 0")],
    1: [('<cylinder radius="0.28" length="0.5"/>', "0.05 0 -0.05", "0 0 0")],
    2: [('<box size="1.35 0.24 0.3"/>', "0.575 0.0 0", "0 0 0")],
    3: [('<box size="0.9 0.26 0.26"/>', "0.45 0 0.041", "0 0 0")],
    4: [('<cylinder radius="0.09" length="0.2"/>', "-0.06 0 0", "0 1.5707963 0")],
    5: [('<sphere radius="0.09"/>', "0.03 0 0", "0 0 0")],
    6: [('<cylinder radius="0.08" length="0.02"/>', "-0.01 0 0", "0 1.5707963 0")],
}


def urdf_text() -> str:
    out = ['<robot name="small">']
    for i in range(7):
        shapes = "".join(
            f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>'
            for shape, xyz, rpy in _BODIES[i]
        )
        out.append(f'<link name="{"base_link" if i == 0 else f"link_{i}"}">{shapes}</link>')
    out.append('<link name="flange"/>')
    for i, (name, xyz, axis, (low, high)) in enumerate(_JOINTS):
        parent = "base_link" if i == 0 else f"link_{i}"
        out.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="link_{i + 1}"/>'
            f'<origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="0 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="{np.deg2rad(low)}" upper="{np.deg2rad(high)}" velocity="2" effort="1000"/>'
            "</joint>"
        )
    out.append(
        '<joint name="f" type="fixed"><parent link="link_6"/><child link="flange"/>'
        '<origin xyz="0 0 0" rpy="0 1.5707963267948966 0"/></joint></robot>'
    )
    return "\n".join(out)


def limits() -> JointLimits:
    lower, upper = (np.deg2rad([j[3][k] for j in _JOINTS]).astype(float) for k in (0, 1))
    return JointLimits(
        lower,
        upper,
        np.deg2rad([120, 115, 120, 190, 180, 260.0]),
        np.deg2rad([300, 300, 300, 500, 500, 800.0]),
        np.deg2rad([2000, 2000, 2000, 4000, 4000, 6000.0]),
    )


def pose(x: float, y: float, z: float, pitch: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    c, s = np.cos(pitch), np.sin(pitch)
    T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    T[:3, 3] = x, y, z
    return T


def small_cell(folder: Path, **changes: object) -> Cell:
    """Return a cell with the workpiece frame on a block 1.5 m in front of the robot and 0.6 m high; the robot is at
    the world origin."""
    urdf = folder / "robot.urdf"
    urdf.write_text(urdf_text())
    fields: dict[str, object] = {
        "name": "small",
        "folder": folder,
        "urdf": urdf,
        "packages": {},
        "base_link": "base_link",
        "flange_link": "flange",
        "arm_joints": tuple(j[0] for j in _JOINTS),
        "external_joints": (),
        "external_prismatic": (),
        "home": np.deg2rad([0, -90, 90, 0, 45, 0.0]),
        "external_home": np.zeros(0),
        "T_world_base": np.eye(4),
        "limits": limits(),
        "tool": Tool(
            T_flange_tcp=pose(0, 0, 0.35),
            mass=20.0,
            com=np.zeros(3),
            geometry=(
                CollisionShape(
                    name="spindle", kind="box", size=(0.12, 0.12, 0.28), mesh=None, T_parent_shape=pose(0, 0, 0.14)
                ),
            ),
            cutter=CutterGeometry(0.012, 0.06),
        ),
        "workpiece": Workpiece(
            "world",
            pose(1.5, 0, 0.6),
            (
                CollisionShape(
                    name="block", kind="box", size=(0.4, 0.5, 0.1), mesh=None, T_parent_shape=pose(0, 0, -0.05)
                ),
            ),
        ),
        "obstacles": (
            CollisionShape(
                name="table", kind="box", size=(1.0, 1.4, 0.1), mesh=None, T_parent_shape=pose(1.5, 0, 0.44)
            ),
            CollisionShape(
                name="post", kind="cylinder", size=(0.05, 0.5), mesh=None, T_parent_shape=pose(1.3, 0.6, 0.75)
            ),
        ),
        "stiffness": None,
    }
    return Cell(**{**fields, **changes})  # type: ignore[arg-type]


def robot_folder(name: str, *, meshes: bool = False) -> Path:
    """Return the folder of a real robot description; skip the test if it, or its required meshes, are not available."""
    own = OWN / name
    if own.is_dir() and (not meshes or any(own.rglob("*.stl"))):
        return own
    if (BESIDE / name).is_dir():
        return BESIDE / name
    pytest.skip(f"{name}: {'its meshes are' if meshes else 'its description is'} not here ({BESIDE})")


def real_cell(folder: Path, name: str, obstacles: tuple[CollisionShape, ...] = (), *, meshes: bool = False) -> Cell:
    """Return a cell of a real robot with the small cell's tool and the robot's own limits."""
    import xml.etree.ElementTree as ET

    root = robot_folder(name, meshes=meshes)
    urdf = root / f"{name}.urdf"
    tree = ET.parse(urdf)
    moving = [j for j in tree.iter("joint") if j.get("type") == "revolute"]
    flange = "flange" if any(x.get("name") == "flange" for x in tree.iter("link")) else "tool0"
    packages = {p.name: p for p in root.iterdir() if p.is_dir()}
    cell = small_cell(folder)
    return Cell(
        **{
            **cell.__dict__,
            "urdf": urdf,
            "packages": packages,
            "flange_link": flange,
            "folder": root,
            "arm_joints": tuple(str(j.get("name")) for j in moving),
            "home": np.zeros(6),
            "obstacles": obstacles or cell.obstacles,
        }
    )
