"""Reading of the sections of a cell file, with the URDF, meshes and files that they name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from os.path import isdir
from pathlib import Path

import numpy as np

from machopt.cell.cell_file_access import ANY_SIZE, CellFolder
from machopt.cell.cell_notes import list_cell_notes
from machopt.cell.cell_schema import CellKeys, PoseKeys, ShapeKeys, ToolKeys
from machopt.cell.collision_body_selection import find_missing_meshes, select_bodies
from machopt.cell.controller_section import build_controller
from machopt.cell.ignored_pairs import IgnoredPairReader
from machopt.cell.joint_count_checks import check_correction_joints, check_stiffness_joints
from machopt.cell.joint_reader import read_joints
from machopt.cell.joints.joint_chain import JointChain, check_carrier
from machopt.cell.kinematics_file import load_kinematics
from machopt.cell.machining_properties import (
    build_accuracy,
    build_cutter,
    parse_inertia,
    parse_pose_covariance,
    parse_workpiece_stiffness,
)
from machopt.cell.mesh import (
    ErrorFactory,
    MeshSurface,
    SceneSize,
    SizedBody,
    check_body_size,
    find_collada_original,
    find_open_surfaces,
    read_collada_surface,
    read_surface,
)
from machopt.cell.mesh.body_size_check import Role
from machopt.cell.mesh.collada_reader import compute_up_rotation
from machopt.cell.mesh.stock_mesh import read_stock_mesh
from machopt.cell.parsed_value_conversion import (
    build_file_error,
    check_unique_names,
    combine_tools,
    copy_limits_read_only,
    copy_read_only,
    find_links_without_bodies,
    find_missing_bodies,
    format_xacro_argument,
    get_solid_shape,
)
from machopt.cell.plausibility_checks import check_pose, check_stiffness, check_tool, compute_longest_side
from machopt.cell.process_file import StockKeys, load_process
from machopt.cell.stiffness.external_joint_stiffness import match_springs_to_joints
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cell.urdf import RobotDescription, UrdfModel, find_mesh, find_package, read_description
from machopt.cell.work_offsets import WorkOffsets
from machopt.data_types.cell import Cell, CollisionShape, IgnoredPair, Tool, Workpiece
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.process import CuttingProcess
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.stock import StockBody
from machopt.errors import CellError
from machopt.file_formats.file_reading import check_file
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, compute_rpy_matrix


def _format_urdf_scale(scale: float, factor: float) -> str:
    """Return the attribute that scales a mesh of the URDF by another factor."""
    return f'scale="{" ".join([f"{scale * factor:g}"] * 3)}" in the URDF'


@dataclass(kw_only=True)
class CellSectionReader:
    """One load: the document, where files may lie, and what piles up on the way."""

    document: YamlDocument
    keys: CellKeys
    folder: CellFolder
    any_chain: bool = False
    other_stiffness: Path | None = None
    other_process: Path | None = None
    bodies: bool = True  # of the robot, all
    warnings: list[str] = field(default_factory=list)
    read: dict[Path, MeshSurface] = field(default_factory=dict)
    surfaces: list[MeshSurface] = field(default_factory=list)  # of all meshes
    collada_axes: dict[Path, str] = field(default_factory=dict)  # of COLLADA files of the cell: the axis that is up
    reach: float = 0.0  # m, of the arm; 0 where it is not known
    scene: SceneSize = field(default_factory=lambda: SceneSize(0.0))

    def read_cell(self) -> Cell:
        keys, robot = self.keys, self.keys.robot
        self.folder.read.append(Path(self.document.file).resolve())
        named = self._find_packages()
        description = self._read_urdf(self.folder.resolve_file(("robot", "urdf"), robot.urdf), named)
        urdf = description.urdf
        joints = read_joints(urdf, keys, self.document, self.warnings, any_chain=self.any_chain)
        missing = {} if self.bodies else find_missing_meshes(urdf, named, self.folder.path)
        robot_bodies = select_bodies(description, joints.side, missing)
        urdf = robot_bodies.urdf
        self.warnings += robot_bodies.warnings
        self.reach, self.scene = joints.reach, SceneSize(joints.reach + joints.sliding)
        chain, prismatic = joints.chain, tuple(j.kind == "prismatic" for j in joints.chain.arm)
        packages = self._read_urdf_meshes(urdf, named)
        tools, workpiece = self._read_tools(), self._read_workpiece()
        setups = WorkOffsets.build_work_offsets(keys.offsets, workpiece, self._read_pose, self._read_shapes)
        name, tool = next(iter(tools.items()))
        stiffness, kinematics = self._read_stiffness(chain), self._read_kinematics(chain)
        obstacles = (*self._read_obstacles(urdf, chain), *setups.fixtures)
        may_touch = self._read_may_touch(urdf, tools, setups.workpiece, obstacles)
        return Cell(
            name=keys.name,
            folder=self.folder.path,
            urdf=urdf.path,
            packages=packages,
            base_link=robot.base_link,
            flange_link=robot.flange_link,
            arm_joints=tuple(j.name for j in chain.arm),
            external_joints=tuple(j.name for j in chain.external),
            external_prismatic=tuple(j.kind == "prismatic" for j in chain.external),
            expanded=robot_bodies.text,
            mimics=joints.mimics,
            may_touch=may_touch,
            arm_prismatic=prismatic if any(prismatic) else (),
            home=copy_read_only(joints.home[: len(chain.arm)]),
            external_home=copy_read_only(joints.home[len(chain.arm) :]),
            T_world_base=self._build_base_pose(urdf, bool(chain.external)),
            tool_change=None if joints.change is None else copy_read_only(joints.change),
            limits=copy_limits_read_only(joints.limits),
            tool=tool,
            tools=tools if keys.tools else {},
            tool_name=name if keys.tools else None,
            workpiece=setups.workpiece,
            offsets=setups.frames,
            fixtures=tuple(body.name for body in setups.fixtures),
            obstacles=obstacles,
            stiffness=stiffness,
            plan={} if keys.plan is None else keys.plan.given(),
            controller=build_controller(
                self.document, keys.controller, chain, self.folder.resolve_file, self._read_pose
            ),
            kinematics=kinematics,
            process=self._read_process(),
            accuracy=None if keys.accuracy is None else build_accuracy(keys.accuracy),
            gravity_compensator=robot.gravity_compensator,
            rated_payload=robot.rated_payload_kg,
            files=tuple(dict.fromkeys(self.folder.read)),
            warnings=tuple(self.warnings),
            notes=list_cell_notes(urdf, keys, joints, tools),
        )

    def _read_stiffness(self, chain: JointChain) -> ArmStiffness | None:
        """Read the stiffness file of the cell, or the requested other one."""
        keys, other = self.keys, self.other_stiffness
        if other is not None:
            check_file(other, expected="a stiffness.yaml", most=ANY_SIZE)
            self.folder.read.append(other.resolve())
        if keys.stiffness is None and other is None:
            return None
        found = load_stiffness(other or self.folder.resolve_file(("stiffness",), str(keys.stiffness)))
        prismatic = tuple(j.kind == "prismatic" for j in chain.external)
        external = match_springs_to_joints(found.external, tuple(j.name for j in chain.external), prismatic, found.file)
        found = replace(found, external=external)
        check_stiffness_joints(found, len(chain.arm))
        check_stiffness(found, keys, self.reach, self.document, self.warnings)
        if found.estimated:
            self.warnings.append(
                f"{Path(found.file or '').name} is estimated, not measured: the gain it promises is that of a "
                "typical arm (machopt plan-poses, then identify, would measure this one)"
            )
        return found

    def _read_kinematics(self, chain: JointChain) -> KinematicCorrections | None:
        if self.keys.kinematics is None:
            return None
        found = load_kinematics(self.folder.resolve_file(("kinematics",), self.keys.kinematics))
        check_correction_joints(found, len(chain.arm))
        return found

    def _read_process(self) -> CuttingProcess | None:
        if self.other_process is not None:
            check_file(self.other_process, expected="a process.yaml", most=ANY_SIZE)
            self.folder.read.append(self.other_process.resolve())
            return load_process(self.other_process, self._read_stock)
        if self.keys.process is None:
            return None
        return load_process(self.folder.resolve_file(("process",), self.keys.process), self._read_stock)

    def _read_stock(self, document: YamlDocument, keys: StockKeys) -> StockBody:
        """The part before machining, whose mesh lies in the cell folder."""
        fail = partial(document.build_error, ("stock", "mesh"))
        path = self.folder.resolve_inside(self.folder.path / keys.mesh, keys.mesh, fail)
        self.folder.read.append(self.folder.check_existing_file(path, keys.mesh, fail))
        return read_stock_mesh(path, 1.0 if keys.scale is None else keys.scale, keys.cell_mm / 1e3, fail)

    def _read_may_touch(
        self, urdf: UrdfModel, tools: dict[str, Tool], workpiece: Workpiece, obstacles: tuple[CollisionShape, ...]
    ) -> tuple[IgnoredPair, ...]:
        """Pairs of bodies that may touch, after a look at what bodies there are."""
        for tool in tools.values():
            check_unique_names(self.document, *tool.geometry, *workpiece.geometry, *obstacles)
        self.warnings += find_missing_bodies(next(iter(tools.values())), workpiece)
        self.warnings += find_open_surfaces(self.surfaces)
        pairs = IgnoredPairReader(
            urdf, self.keys.robot.flange_link, combine_tools(tools), workpiece, obstacles, self.document
        )
        found = pairs.pairs(self.keys.ignore_pairs, self.folder.resolve_file)
        self.warnings += pairs.warnings
        return found

    def _find_packages(self) -> dict[str, Path]:
        """The ``packages:`` map, at the top level or under robot."""
        named: dict[str, tuple[KeyPath, str]] = {}
        for n, folder in self.keys.packages.items():
            named[n] = (("packages", n), folder)
        for n, folder in self.keys.robot.packages.items():
            named[n] = (("robot", "packages", n), folder)
        out: dict[str, Path] = {}
        for n, (loc, folder) in named.items():
            fail = partial(self.document.build_error, loc)
            out[n] = self.folder.resolve_inside(self.folder.path / folder, folder, fail)
            if not isdir(out[n]):
                raise fail(f"no such folder: {folder} (searched for {out[n]})")
        return out

    def _read_urdf(self, path: Path, packages: dict[str, Path]) -> RobotDescription:
        """The robot's description; what it is made of lies in the cell."""

        def find(name: str) -> Path:
            found = find_package(name, path, packages, self.folder.path)
            return self.folder.resolve_inside(found, f"$(find {name})", partial(build_file_error, path))

        def may(file: Path) -> None:
            self.folder.resolve_inside(file, file.name, partial(build_file_error, path))

        found = read_description(
            path, {k: format_xacro_argument(v) for k, v in self.keys.robot.xacro_args.items()}, find, may
        )
        for file in found.files:
            self.folder.read.append(self.folder.resolve_inside(file, file.name, partial(build_file_error, file)))
        self.warnings += found.warnings
        return found

    def _read_urdf_meshes(self, urdf: UrdfModel, packages: dict[str, Path]) -> dict[str, Path]:
        """Check every collision mesh; returns all packages, the map's and those found next to the URDF."""
        self.warnings += [*urdf.warnings, *find_links_without_bodies(urdf)]
        found = dict(packages)
        for mesh in urdf.meshes:
            fail = partial(CellError, file=urdf.path, where=f"line {mesh.line}: collision mesh of link {mesh.link!r}")
            hit = find_mesh(urdf, mesh.uri, packages, self.folder.path, fail)
            path = self.folder.resolve_inside(hit.path, mesh.uri, fail)
            self.folder.check_existing_file(path, mesh.uri, fail)
            if hit.package is not None and hit.folder is not None:
                found[hit.package] = hit.folder
            self.folder.read.append(path)
            if path.suffix.lower() == ".dae" and path not in self.read:
                self.read[path], up = read_collada_surface(path, fail)
                if up != "Z_UP":
                    self.warnings.append(
                        f"{path.name} states {up}; as in RViz and MoveIt its coordinates are those of the link all the "
                        "same"
                    )
            self._check_mesh(path, mesh.scale, "link", fail, partial(_format_urdf_scale, mesh.scale))
        for solid in urdf.solids:
            at = partial(CellError, file=urdf.path, where=f"line {solid.line}: collision of link {solid.link!r}")
            self._add_warning(
                check_body_size(
                    SizedBody(f"a {solid.kind}", "link", solid.size, "its sizes {:g} times as large".format),
                    self.scene,
                    at,
                )
            )
        return found

    def _check_mesh(
        self, path: Path, scale: float, role: Role, fail: ErrorFactory, remedy: Callable[[float], str]
    ) -> None:
        """Read a mesh, check its size, and record its surface."""
        if (original := find_collada_original(path)) is not None:  # what the verifier reads in its place
            self.folder.read.append(self.folder.resolve_inside(original, original.name, fail))
        surface = self.read.get(path) or read_surface(path, fail)
        self.read[path] = surface
        self.surfaces.append(surface)
        self._add_warning(
            check_body_size(SizedBody(f"mesh {path.name}", role, surface.extent * scale, remedy), self.scene, fail)
        )

    def _read_tools(self) -> dict[str, Tool]:
        """The tool table; a cell's only tool by an empty name."""
        if self.keys.tool is not None:
            return {"": self._read_tool(self.keys.tool, ("tool",))}
        return {name: self._read_tool(keys, ("tools", name)) for name, keys in self.keys.tools.items()}

    def _read_tool(self, keys: ToolKeys, loc: KeyPath) -> Tool:
        cutter = keys.cutter
        check_tool(keys, loc, self.reach, self.document, self.warnings)
        return Tool(
            T_flange_tcp=self._read_pose((*loc, "tcp"), keys.tcp),
            mass=keys.mass_kg,
            com=copy_read_only(np.array(keys.com_mm) / 1e3),
            geometry=self._read_shapes((*loc, "geometry"), keys.geometry),
            cutter=None if cutter is None else build_cutter(cutter),
            inertia=None
            if keys.inertia_kg_m2 is None
            else self._build_inertia((*loc, "inertia_kg_m2"), keys.inertia_kg_m2),
            number=keys.tool_number,
        )

    def _build_inertia(self, loc: KeyPath, rows: list[list[float]]) -> Array:
        return parse_inertia(rows, partial(self.document.build_error, loc))

    def _read_workpiece(self) -> Workpiece:
        keys = self.keys.workpiece
        return Workpiece(
            stiffness=parse_workpiece_stiffness(
                keys.stiffness_N_mm, partial(self.document.build_error, ("workpiece", "stiffness_N_mm"))
            ),
            pose_covariance=parse_pose_covariance(
                keys.pose_covariance, partial(self.document.build_error, ("workpiece", "pose_covariance"))
            ),
            link=keys.link,
            T_link_workpiece=self._read_pose(("workpiece", "pose"), keys.pose),
            geometry=self._read_shapes(("workpiece", "geometry"), keys.geometry),
        )

    def _read_pose(self, loc: KeyPath, keys: PoseKeys) -> Array:
        """(4, 4) in SI of a frame; small positions are suspected to be metres."""
        check_pose(keys, loc, self.document, self.warnings)
        return _build_pose(keys)

    def _build_base_pose(self, urdf: UrdfModel, carried: bool) -> Array:
        """(4, 4) base_link in world, joints above it at zero; ``carried``: by or next to external joints, which make
        ``robot.pose`` the pose of the URDF's root."""
        robot = self.keys.robot
        T = self._read_pose(("robot", "pose"), robot.pose)
        for joint in urdf.chain(robot.base_link) if carried else ():
            T = T @ build_transform(compute_rpy_matrix(np.array(joint.rpy)), np.array(joint.xyz))
        return copy_read_only(T)

    def _read_obstacles(self, urdf: UrdfModel, chain: JointChain) -> tuple[CollisionShape, ...]:
        rows = self.keys.obstacles
        bodies = self._read_shapes(("obstacles",), rows)
        out = []
        for n, (row, body) in enumerate(zip(rows, bodies, strict=True)):
            if row.link != "world":
                check_carrier(row.link, urdf, chain, self.document, ("obstacles", n, "link"))
            out.append(replace(body, link=row.link))
        return tuple(out)

    def _read_shapes(self, loc: KeyPath, rows: Sequence[ShapeKeys]) -> tuple[CollisionShape, ...]:
        return tuple(self._read_shape((*loc, n), loc, row) for n, row in enumerate(rows))

    def _read_shape(self, loc: KeyPath, group: KeyPath, keys: ShapeKeys) -> CollisionShape:
        kind = {"obstacles": "obstacle", "tools": "tool"}.get(str(group[0]), group[0])
        name = keys.name or f"{kind}_{loc[-1]}"
        check_pose(keys, loc, self.document, self.warnings, near=False)
        T = _build_pose(keys)
        role: Role = "obstacle" if group[0] == "obstacles" else "tool" if group[0] in ("tool", "tools") else "workpiece"
        if keys.mesh is None:
            return self._build_solid(loc, name, role, keys, T)
        scale = 1.0 if keys.scale is None else keys.scale
        path = self.folder.resolve_file((*loc, "mesh"), keys.mesh)
        fail = partial(self.document.build_error, (*loc, "mesh"))
        if path.suffix.lower() == ".dae":
            up = self.collada_axes.get(path)
            if up is None:
                self.read[path], up = read_collada_surface(path, fail)
                self.collada_axes[path] = up
            T = copy_read_only(T @ compute_up_rotation(up))
        self._check_mesh(path, scale, role, fail, lambda factor: f"scale: {scale * factor:g}")
        return CollisionShape(name=name, kind="mesh", size=(scale,), mesh=path, T_parent_shape=T)

    def _build_solid(self, loc: KeyPath, name: str, role: Role, keys: ShapeKeys, T: Array) -> CollisionShape:
        """A box, cylinder or sphere; the schema lets exactly one through."""
        kind, given = get_solid_shape(keys)
        size = tuple(v / 1e3 for v in given)
        body = SizedBody(
            f"{kind}_mm {given}",
            role,
            compute_longest_side(size, kind),
            lambda factor: str([float(f"{v * factor:.6g}") for v in given]),
        )
        self._add_warning(check_body_size(body, self.scene, partial(self.document.build_error, (*loc, f"{kind}_mm"))))
        return CollisionShape(name=name, kind=kind, size=size, mesh=None, T_parent_shape=T)

    def _add_warning(self, message: str | None) -> None:
        if message is not None:
            self.warnings.append(message)


def _build_pose(keys: PoseKeys) -> Array:
    return copy_read_only(build_transform(compute_rpy_matrix(np.radians(keys.rpy_deg)), np.array(keys.xyz_mm) / 1e3))
