"""Loading of the arm from the URDF of a cell: kinematics, collision bodies and masses, read by pinocchio."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from machopt.data_types.cell import Cell, CollisionShape, list_geometry_files, select_geometry
from machopt.errors import CellError
from machopt.kinematics.as_built_geometry import BEHIND_FLANGE, compute_link_displacements
from machopt.kinematics.mimic_joints import compute_coupling_matrix, compute_rest_configuration, list_chain_joints
from machopt.kinematics.robot import GRAVITY, LinkShape, Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.numerics.content_cache import ContentCache
from machopt.numerics.rigid_transforms import invert_transform

ROBOTS: ContentCache[Robot] = ContentCache(4)
"""Arms by all that they depend on: one command needs the same one at several places, with and without corrections."""


def load_robot(cell: Cell) -> Robot:
    """Reduce the cell's URDF to a :class:`Robot` with as-built geometry; no mesh is read.

    Args:
        cell: cell with the URDF.

    Raises:
        InputError: the chain from base_link to flange_link does not consist of the six arm joints.
    """
    tool, part = replace(cell.tool, geometry=()), replace(cell.workpiece, geometry=())
    drawn = replace(select_geometry(cell), tool=tool, tools={}, workpiece=part, obstacles=())
    inputs = drawn, cell.urdf_text
    return ROBOTS.get(inputs, lambda: _build_as_built_robot(cell, _read_chain(cell)[0])[0])


CHAINS: ContentCache[tuple[Robot, tuple[LinkShape, ...]]] = ContentCache()
"""Arms with their bodies; pinocchio loads every mesh of an arm for its shapes."""


def load_chain(cell: Cell) -> tuple[Robot, tuple[LinkShape, ...]]:
    """Return the arm's kinematics and its collision bodies, both read from the URDF at q = 0.

    Args:
        cell: cell with the URDF.
    """
    places = tuple(str(path) for path in (cell.folder, *cell.packages.values(), *list_geometry_files(cell)))
    inputs = places, select_geometry(cell), cell.urdf_text, list_geometry_files(cell)
    return CHAINS.get(inputs, lambda: _read_robot_with_shapes(cell))


def _read_robot_with_shapes(cell: Cell) -> tuple[Robot, tuple[LinkShape, ...]]:
    robot, model, data, T_base_world, ids = _read_chain(cell)
    shapes = _read_link_shapes(cell, model, data, T_base_world, ids)
    robot, moved = _build_as_built_robot(cell, robot)
    if moved is not None:
        shapes = tuple(_move_link_shape(s, moved[s.link]) for s in shapes)
    return robot, shapes


def _build_as_built_robot(cell: Cell, drawn: Robot) -> tuple[Robot, Array | None]:
    """Return the arm with as-built lines and flange, and the displacements of its links
    (:func:`machopt.kinematics.as_built_geometry.compute_link_displacements`).
    """
    moved = compute_link_displacements(np.vstack([drawn.point, drawn.T_base_flange_zero[:3, 3]]), cell.kinematics)
    if moved is None:
        return drawn, None
    R, p = moved[1:BEHIND_FLANGE, :3, :3], moved[1:BEHIND_FLANGE, :3, 3]
    axis = np.einsum("kij,kj->ki", R, drawn.axis)
    point = np.einsum("kij,kj->ki", R, drawn.point) + p
    zero = moved[BEHIND_FLANGE] @ drawn.T_base_flange_zero
    return replace(drawn, axis=axis, point=point, T_base_flange_zero=zero, nominal=drawn), moved


def _move_link_shape(s: LinkShape, T: Array) -> LinkShape:
    return replace(s, shape=replace(s.shape, T_parent_shape=T @ s.shape.T_parent_shape))


def _read_chain(cell: Cell) -> tuple[Robot, object, object, Array, list[int]]:
    """The arm's kinematics; pinocchio's model, its data at q = 0, ``T_base_world``, and the number of each joint."""
    import pinocchio as pin

    model = load_urdf_model(cell)
    data, rest = model.createData(), compute_rest_configuration(cell, model)
    pin.framesForwardKinematics(model, data, rest)
    base = find_frame(cell, model, cell.base_link)
    T_world_base = data.oMf[base].homogeneous
    T_base_world = invert_transform(T_world_base)
    n = len(cell.arm_joints)
    axis, point, lower, upper = np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty(n)
    ids = []
    for i, name in enumerate(cell.arm_joints):
        if not model.existJointName(name):
            have = ", ".join(model.names[1:])
            raise CellError(
                f"arm joint {name!r} is not a moving joint of the URDF; it has {have}",
                file=cell.urdf,
                where="robot.arm_joints",
            )
        j = model.getJointId(name)
        ids.append(j)
        T = T_base_world @ data.oMi[j].homogeneous
        column = pin.computeFrameJacobian(
            model, model.createData(), rest, _find_joint_frame(model, j), pin.ReferenceFrame.LOCAL
        )[:, model.idx_vs[j]]
        way = column[:3] if cell.arm_prismatic[i : i + 1] == (True,) else column[3:]
        axis[i], point[i] = T[:3, :3] @ way, T[:3, 3]
        lower[i], upper[i] = cell.limits.lower[i], cell.limits.upper[i]
        if model.nqs[j] == 1:  # a continuous joint has only the cell's limits
            lower[i], upper[i] = model.lowerPositionLimit[model.idx_qs[j]], model.upperPositionLimit[model.idx_qs[j]]
        if not np.isclose(np.linalg.norm(way), 1.0, atol=1e-9):
            raise CellError(f"arm joint {name!r} is not revolute", file=cell.urdf, where="robot.arm_joints")
    flange = find_frame(cell, model, cell.flange_link)
    joints = list_chain_joints(model, model.frames[flange].parentJoint, base)
    if [j for j in joints if j in ids] != ids:
        raise CellError(
            f"flange link {cell.flange_link!r} is not carried by the last arm joint {cell.arm_joints[-1]!r}",
            file=cell.urdf,
            where="robot.flange_link",
        )
    robot = Robot(
        joints=cell.arm_joints,
        axis=axis,
        point=point,
        T_base_flange_zero=T_base_world @ data.oMf[flange].homogeneous,
        lower=lower,
        upper=upper,
        coupling=compute_coupling_matrix(cell, model, joints, ids),
        slides=np.array(cell.arm_prismatic) if any(cell.arm_prismatic) else None,
    )
    return robot, model, data, T_base_world, ids


def load_masses(cell: Cell) -> RobotMasses:
    """Return the URDF's links and the cell's tool as masses; links without inertia and base_link are left out.

    Gravity acts along −z of world. Links on other branches belong to the arm joint that carries them, at the pose
    of their own joints at zero.

    Args:
        cell: cell with the URDF and the tool.
    """
    import pinocchio as pin

    model = load_urdf_model(cell)
    data = model.createData()
    pin.framesForwardKinematics(model, data, compute_rest_configuration(cell, model))
    T_base_world = invert_transform(data.oMf[find_frame(cell, model, cell.base_link)].homogeneous)
    ids = [model.getJointId(name) for name in cell.arm_joints]
    found = []
    for j in range(1, model.njoints):
        carrier = j
        while carrier > 0 and carrier not in ids:
            carrier = model.parents[carrier]
        if carrier > 0 and model.inertias[j].mass > 0.0:
            T = T_base_world @ data.oMi[j].homogeneous
            inertia = model.inertias[j]
            link = ids.index(carrier) + 1
            found.append((link, inertia.mass, T[:3, :3] @ inertia.lever + T[:3, 3], link))
    if cell.tool.mass > 0.0:
        T = T_base_world @ data.oMf[find_frame(cell, model, cell.flange_link)].homogeneous
        found.append((len(ids), cell.tool.mass, T[:3, :3] @ cell.tool.com + T[:3, 3], BEHIND_FLANGE))
    com = np.array([c for _, _, c, _ in found], float).reshape(-1, 3)
    moved = _build_as_built_robot(cell, _read_chain(cell)[0])[1] if cell.kinematics else None
    if moved is not None:
        com = np.array([moved[w, :3, :3] @ c + moved[w, :3, 3] for c, (*_, w) in zip(com, found, strict=True)])
    return RobotMasses(
        np.array([b for b, *_ in found], np.int64),
        np.array([m for _, m, *_ in found], float),
        com.reshape(-1, 3),
        cell.T_world_base[:3, :3].T @ np.array([0.0, 0.0, -GRAVITY]),
    )


def load_urdf_model(cell: Cell) -> Any:
    """Return the pinocchio model of the cell's URDF.

    Args:
        cell: cell with the URDF.

    Raises:
        InputError: pinocchio cannot build the model.
    """
    import pinocchio as pin

    try:
        return pin.buildModelFromXML(cell.urdf_text)
    except ValueError as problem:
        raise CellError(f"the robot model cannot be built: {_shorten_message(problem)}", file=cell.urdf) from None


def _shorten_message(problem: ValueError) -> str:
    """Return the beginning of a loader's message, which may contain the rest of the file."""
    return " ".join(str(problem).split())[:200]


def find_frame(cell: Cell, model: object, name: str) -> int:
    """Return the number of a link's frame in the pinocchio model.

    Args:
        cell: cell with the URDF, for the message.
        model: pinocchio model.
        name: name of the link.

    Raises:
        InputError: the link does not exist.
    """
    if not model.existFrame(name):  # type: ignore[attr-defined]
        links = ", ".join(f.name for f in model.frames if str(f.type) == "BODY")  # type: ignore[attr-defined]
        raise CellError(f"link {name!r} is not in the URDF; it has {links}", file=cell.urdf)
    return int(model.getFrameId(name))  # type: ignore[attr-defined]


def _find_joint_frame(model: object, joint: int) -> int:
    return int(model.getFrameId(model.names[joint]))  # type: ignore[attr-defined]


def _read_shape(cell: Cell, g: Any, T: Array) -> CollisionShape:
    """One collision body of the URDF, with its (4, 4) pose in base_link."""
    kind = type(g.geometry).__name__
    if g.meshPath and kind.startswith("BVH"):
        return _read_mesh_shape(cell, g, T)
    if kind == "Box":
        size = tuple(2.0 * float(h) for h in g.geometry.halfSide)
        return CollisionShape(name=g.name, kind="box", size=size, mesh=None, T_parent_shape=T)
    if kind == "Cylinder":
        extent = float(g.geometry.radius), 2.0 * float(g.geometry.halfLength)
        return CollisionShape(name=g.name, kind="cylinder", size=extent, mesh=None, T_parent_shape=T)
    if kind == "Sphere":
        radius = (float(g.geometry.radius),)
        return CollisionShape(name=g.name, kind="sphere", size=radius, mesh=None, T_parent_shape=T)
    raise CellError(
        f"collision geometry {g.name!r} is a {kind}; mesh, box, cylinder or sphere would work", file=cell.urdf
    )


def _read_link_shapes(
    cell: Cell, model: object, data: object, T_base_world: Array, ids: list[int]
) -> tuple[LinkShape, ...]:
    """Collision bodies of the URDF, placed in base_link at q = 0; those on other branches of the tree count as base."""
    import pinocchio as pin

    text = cell.urdf_text
    for name, folder in cell.packages.items():  # a package's folder may have another name than the package
        from xml.sax.saxutils import quoteattr  # imported here: it loads urllib

        text = text.replace(f"package://{name}/", quoteattr(f"{folder}/")[1:-1])
    folders = [str(cell.urdf.parent), str(cell.folder)]
    try:
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, package_dirs=folders)
    except ValueError as problem:
        raise CellError(f"its collision bodies cannot be loaded: {_shorten_message(problem)}", file=cell.urdf) from None
    described = len(ElementTree.fromstring(text).findall("{*}link/{*}collision"))
    if len(geometry.geometryObjects) != described:  # the parser skips what it cannot read, with a line in the log
        raise CellError(
            f"describes {described} collision bodies, of which the robot model has {len(geometry.geometryObjects)}; "
            "a body that is not there cannot be checked",
            file=cell.urdf,
        )
    shapes = []
    for g in geometry.geometryObjects:
        joint, above = g.parentJoint, []
        while joint > 0:
            above.append(joint)
            joint = model.parents[joint]  # type: ignore[attr-defined]
        link = next((ids.index(joint) + 1 for joint in above if joint in ids), 0)
        T = T_base_world @ data.oMi[g.parentJoint].homogeneous @ g.placement.homogeneous  # type: ignore[attr-defined]
        shape = _read_shape(cell, g, T)
        names = tuple(str(model.names[j]) for j in above)  # type: ignore[attr-defined]
        shapes.append(LinkShape(link, shape, names, str(model.frames[g.parentFrame].name)))  # type: ignore[attr-defined]
    return tuple(shapes)


def _read_mesh_shape(cell: Cell, g: Any, T: Array) -> CollisionShape:
    from pathlib import Path

    scale = np.asarray(g.meshScale, float)
    if not np.allclose(scale, scale[0]):
        raise CellError(
            f"collision mesh {g.name!r} is scaled unevenly {scale.tolist()}; one scale would work", file=cell.urdf
        )
    return CollisionShape(name=g.name, kind="mesh", size=(float(scale[0]),), mesh=Path(g.meshPath), T_parent_shape=T)
