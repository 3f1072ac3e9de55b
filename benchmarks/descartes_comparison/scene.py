"""A cell of machopt as URDF, SRDF and plugin files of Tesseract: the same triangles, pairs, limits and clearance."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import trimesh
from opw_parameters import OpwParameters, find_opw_parameters
from scipy.spatial.transform import Rotation

from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.planning.pipeline.planning_setup import PlanningSetup

GROUP, ROOT, TIP, TCP, IK = "arm", "opw_base", "opw_tip", "tcp", "OPWInvKin"


def write_scene(setup: PlanningSetup, folder: Path, *, cutting: bool = True) -> None:
    """Write ``cell.urdf``, ``cell.srdf``, ``kinematics.yaml``, ``contacts.yaml`` and the meshes of a cell.

    Args:
        setup: planning setup of a cell without external joints.
        folder: receives the files.
        cutting: the cutter may touch the workpiece.
    """
    assert setup.collision is not None
    robot, tip = setup.robot, find_opw_parameters(setup.robot)
    bodies = setup.collision.bodies
    names = [f"body_{n}" for n in range(len(bodies))]
    used = {
        pair
        for pair, p in zip(setup.collision.stack.index, setup.collision.pairs, strict=True)
        if not (cutting and p.unless_cutting)
    }
    parts = [_describe_link(ROOT), _describe_link("link_0")]
    opw_inverse = np.linalg.inv(tip.T_base_opw)
    joints = [_describe_fixed(ROOT, "link_0", opw_inverse)]
    origin = np.vstack([np.zeros(3), robot.point])
    for k in range(6):
        parts.append(_describe_link(f"link_{k + 1}"))
        joints.append(_describe_joint(robot, setup, k, origin))
    for name, body in zip(names, bodies, strict=True):
        trimesh.Trimesh(body.vertices - origin[body.link], body.faces, process=False).export(folder / f"{name}.stl")
        parts.append(_describe_link(name, folder / f"{name}.stl"))
        joints.append(_describe_fixed(f"link_{body.link}", name, np.eye(4)))
    zero_tip = np.linalg.inv(_carry_to_zero(robot, tip)) @ tip.T_base_tip
    for name, T in ((TIP, zero_tip), (TCP, robot.T_base_flange_zero @ setup.arm.T_flange_tcp)):
        local = T.copy()
        local[:3, 3] -= origin[6]
        parts.append(_describe_link(name))
        joints.append(_describe_fixed("link_6", name, local))
    space = "https://github.com/tesseract-robotics/tesseract"
    head = f'<robot name="cell" xmlns:tesseract="{space}" tesseract:make_convex="false">'
    (folder / "cell.urdf").write_text("\n".join([head, *parts, *joints, "</robot>"]), encoding="utf-8")
    spared = [
        f'<disable_collisions link1="{names[i]}" link2="{names[j]}" reason="Never"/>'
        for i, j in itertools.combinations(range(len(bodies)), 2)
        if (i, j) not in used and (j, i) not in used
    ]
    (folder / "cell.srdf").write_text(
        "\n".join(
            [
                '<robot name="cell">',
                f'<group name="{GROUP}"><chain base_link="{ROOT}" tip_link="{TIP}"/></group>',
                f'<kinematics_plugin_config filename="file://{folder / "kinematics.yaml"}"/>',
                f'<contact_managers_plugin_config filename="file://{folder / "contacts.yaml"}"/>',
                *spared,
                "</robot>",
            ]
        ),
        encoding="utf-8",
    )
    (folder / "kinematics.yaml").write_text(_format_kinematics(tip), encoding="utf-8")
    (folder / "contacts.yaml").write_text(CONTACTS, encoding="utf-8")


def _carry_to_zero(robot: Robot, tip: OpwParameters) -> Array:
    """Return the motion of the flange from zero to the stretched posture."""
    return np.asarray(robot.compute_fk(tip.stretched) @ np.linalg.inv(robot.T_base_flange_zero))


def _describe_link(name: str, mesh: Path | None = None) -> str:
    if mesh is None:
        return f'<link name="{name}"/>'
    return f'<link name="{name}"><collision><geometry><mesh filename="file://{mesh}"/></geometry></collision></link>'


def _describe_origin(T: Array) -> str:
    rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
    xyz, rotation = (" ".join(f"{v:.12g}" for v in part) for part in (T[:3, 3], rpy))
    return f'<origin xyz="{xyz}" rpy="{rotation}"/>'


def _describe_fixed(parent: str, child: str, T: Array) -> str:
    return (
        f'<joint name="to_{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f"{_describe_origin(T)}</joint>"
    )


def _describe_joint(robot: Robot, setup: PlanningSetup, k: int, origin: Array) -> str:
    T = np.eye(4)
    T[:3, 3] = origin[k + 1] - origin[k]
    axis = " ".join(f"{v:.12g}" for v in robot.axis[k])
    speed = setup.cell.limits.velocity[k]
    return (
        f'<joint name="joint_{k + 1}" type="revolute"><parent link="link_{k}"/><child link="link_{k + 1}"/>'
        f'{_describe_origin(T)}<axis xyz="{axis}"/>'
        f'<limit lower="{setup.arm.lower[k]:.12g}" upper="{setup.arm.upper[k]:.12g}" '
        f'velocity="{speed:.12g}" effort="0"/></joint>'
    )


def _format_kinematics(tip: OpwParameters) -> str:
    lengths = "\n".join(f"              {k}: {v:.12g}" for k, v in tip.lengths.items())
    # the library: OPW's joint = sign · ours − offset; ours = stretched + sign · OPW's
    offsets = ", ".join(f"{v:.12g}" for v in tip.sign * tip.stretched)
    sign = ", ".join(f"{int(v)}" for v in tip.sign)
    return f"""kinematic_plugins:
  search_libraries:
    - tesseract_kinematics_opw_factory
    - tesseract_kinematics_opw_factories
    - tesseract_kinematics_kdl_factories
  fwd_kin_plugins:
    {GROUP}:
      default: KDLFwdKinChain
      plugins:
        KDLFwdKinChain: {{class: KDLFwdKinChainFactory, config: {{base_link: {ROOT}, tip_link: {TIP}}}}}
  inv_kin_plugins:
    {GROUP}:
      default: {IK}
      plugins:
        {IK}:
          class: OPWInvKinFactory
          config:
            base_link: {ROOT}
            tip_link: {TIP}
            params:
{lengths}
              offsets: [{offsets}]
              sign_corrections: [{sign}]
"""


CONTACTS = """contact_manager_plugins:
  search_libraries: [tesseract_collision_bullet_factories, tesseract_collision_fcl_factories]
  discrete_plugins:
    default: FCLDiscreteBVHManager
    plugins:
      FCLDiscreteBVHManager: {class: FCLDiscreteBVHManagerFactory}
      BulletDiscreteBVHManager: {class: BulletDiscreteBVHManagerFactory}
  continuous_plugins:
    default: BulletCastBVHManager
    plugins:
      BulletCastBVHManager: {class: BulletCastBVHManagerFactory}
"""
