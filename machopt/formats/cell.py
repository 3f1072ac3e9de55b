"""cell.yaml → :class:`machopt.domain.cell.Cell`: mm and degrees become SI, and everything is checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from os.path import exists, isdir
from pathlib import Path

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell, Cutter, MayTouch, Shape, Tool, Workpiece
from machopt.domain.kinematics import Kinematics
from machopt.domain.stiffness import Stiffness
from machopt.errors import InputError
from machopt.formats.cell_schema import AnyChainKeys, CellKeys, PoseKeys, ShapeKeys, ToolKeys
from machopt.formats.cellfolder import ANY_SIZE, CellFolder
from machopt.formats.cellparts import (
    any_of,
    different_names,
    first_taken,
    frozen,
    frozen_limits,
    given_solid,
    missing_bodies,
    of_file,
    unseen_links,
    unused_words,
    xacro_word,
)
from machopt.formats.chain import (
    Chain,
    check_carrier,
    limits_of_urdf,
    standing,
)
from machopt.formats.controller import controller_of
from machopt.formats.external_springs import resolved
from machopt.formats.joints import read_joints
from machopt.formats.kinematics import load_kinematics
from machopt.formats.maytouch import PairReader
from machopt.formats.mesh import Fail, Scene, Sized, Surface, judge_size, open_surfaces, original_of, read_surface
from machopt.formats.mesh.size import Role
from machopt.formats.opener import check_file
from machopt.formats.plausible import (
    box_extent,
    check_pose,
    check_stiffness,
    check_tool,
)
from machopt.formats.robotbodies import find_missing_meshes, select_bodies
from machopt.formats.setups import Setups
from machopt.formats.stiffness import load_stiffness
from machopt.formats.urdf import Description, Urdf, describe, find_mesh, find_package
from machopt.formats.yamlstrict import Document, Loc, read_yaml, validate
from machopt.se3 import rpy_matrix, transform


def load_cell(
    path: Path | str,
    *,
    allow_external: bool = False,
    any_chain: bool = False,
    stiffness: Path | None = None,
    bodies: bool = True,
) -> Cell:
    """Read a cell folder.

    Args:
        path: the cell folder, or its cell.yaml.
        allow_external: accept files outside the cell folder.
        any_chain: accept any number of revolute and prismatic joints between base and flange, and no tool and no
            workpiece: for a recorded motion, which needs no more than the chain's dynamics.
        stiffness: a stiffness.yaml to take in place of the one that the cell names, wherever it lies.
        bodies: False where only the kinematics is used: a missing collision mesh of the robot is a warning then.

    Raises:
        InputError: names file, line and key, what was found and what was expected.
    """
    document = read_yaml(cell_file(path))
    return cell_of(document, allow_external=allow_external, any_chain=any_chain, stiffness=stiffness, bodies=bodies)


def cell_file(path: Path | str) -> Path:
    """cell.yaml of a cell folder, or the file itself.

    Raises:
        InputError: there is none in the folder, or neither file nor folder.
    """
    file = Path(path)
    if isdir(file):
        file = file / "cell.yaml"
        if not exists(file):
            raise InputError("no cell.yaml in this folder", file=path)
    if not exists(file):
        raise InputError("there is no such file; a cell folder or its cell.yaml would work", file=path)
    return file


def cell_of(
    document: Document,
    *,
    allow_external: bool = False,
    any_chain: bool = False,
    stiffness: Path | None = None,
    bodies: bool = True,
) -> Cell:
    """A cell from cell.yaml as it was parsed; otherwise as :func:`load_cell`."""
    keys = validate(AnyChainKeys if any_chain else CellKeys, document)
    return _Reader(
        document=document,
        keys=keys,
        folder=CellFolder(document, Path(document.file).resolve().parent, allow_external),
        any_chain=any_chain,
        other_stiffness=stiffness,
        bodies=bodies,
    ).cell()


@dataclass(kw_only=True)
class _Reader:
    """One load: the document, where files may lie, and what piles up on the way."""

    document: Document
    keys: CellKeys
    folder: CellFolder
    any_chain: bool = False
    other_stiffness: Path | None = None
    bodies: bool = True  # of the robot, all
    warnings: list[str] = field(default_factory=list)
    read: dict[Path, Surface] = field(default_factory=dict)
    surfaces: list[Surface] = field(default_factory=list)  # of all meshes
    reach: float = 0.0  # m, of the arm; 0 where it is not known
    scene: Scene = field(default_factory=lambda: Scene(0.0))

    def cell(self) -> Cell:
        keys, robot = self.keys, self.keys.robot
        self.folder.read.append(Path(self.document.file).resolve())
        named = self.packages()
        description = self.urdf(self.folder.file(("robot", "urdf"), robot.urdf), named)
        urdf = description.urdf
        joints = read_joints(urdf, keys, self.document, self.warnings, any_chain=self.any_chain)
        missing = {} if self.bodies else find_missing_meshes(urdf, named, self.folder.path)
        robot_bodies = select_bodies(description, joints.side, missing)
        urdf = robot_bodies.urdf
        self.warnings += robot_bodies.warnings
        self.reach, self.scene = joints.reach, Scene(joints.reach + joints.sliding)
        chain, prismatic = joints.chain, tuple(j.kind == "prismatic" for j in joints.chain.arm)
        packages = self.urdf_meshes(urdf, named)
        tools, workpiece = self.tools(), self.workpiece()
        setups = Setups.of(keys.offsets, workpiece, self.pose, self.shapes)
        workpiece = setups.workpiece
        name, tool = next(iter(tools.items()))
        stiffness, kinematics = self.stiffness(chain), self.kinematics()
        obstacles = (*self.obstacles(urdf, chain), *setups.fixtures)
        may_touch = self.may_touch(urdf, tools, workpiece, obstacles)
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
            home=frozen(joints.home[: len(chain.arm)]),
            external_home=frozen(joints.home[len(chain.arm) :]),
            T_world_base=self.base(urdf, bool(chain.external)),
            change=None if joints.change is None else frozen(joints.change),
            limits=frozen_limits(joints.limits),
            tool=tool,
            tools=tools if keys.tools else {},
            tool_name=name if keys.tools else None,
            workpiece=workpiece,
            offsets=setups.frames,
            fixtures=tuple(body.name for body in setups.fixtures),
            obstacles=obstacles,
            stiffness=stiffness,
            plan={} if keys.plan is None else keys.plan.given(),
            controller=controller_of(self.document, keys.controller, chain, self.folder.file, self.pose),
            kinematics=kinematics,
            files=tuple(dict.fromkeys(self.folder.read)),
            warnings=tuple(self.warnings),
            notes=(
                *unused_words(urdf),
                *first_taken(tools),
                *limits_of_urdf(chain, keys),
                *joints.tightened,
                *standing(urdf, chain, joints.limits),
            ),
        )

    def stiffness(self, chain: Chain) -> Stiffness | None:
        """Of the file that the cell names, or of the other one that was asked for."""
        keys, other = self.keys, self.other_stiffness
        if other is not None:
            check_file(other, expected="a stiffness.yaml", most=ANY_SIZE)
            self.folder.read.append(other.resolve())
        if keys.stiffness is None and other is None:
            return None
        found = load_stiffness(other or self.folder.file(("stiffness",), str(keys.stiffness)))
        prismatic = tuple(j.kind == "prismatic" for j in chain.external)
        external = resolved(found.external, tuple(j.name for j in chain.external), prismatic, found.file)
        found = replace(found, external=external)
        check_stiffness(found, keys, self.reach, self.document, self.warnings)
        if found.estimated:
            self.warnings.append(
                f"{Path(found.file or '').name} is estimated, not measured: the gain it promises is that of a "
                "typical arm (machopt plan-poses, then identify, would measure this one)"
            )
        return found

    def kinematics(self) -> Kinematics | None:
        if self.keys.kinematics is None:
            return None
        return load_kinematics(self.folder.file(("kinematics",), self.keys.kinematics))

    def may_touch(
        self, urdf: Urdf, tools: dict[str, Tool], workpiece: Workpiece, obstacles: tuple[Shape, ...]
    ) -> tuple[MayTouch, ...]:
        """Pairs of bodies that may touch, after a look at what bodies there are."""
        for tool in tools.values():
            different_names(self.document, *tool.geometry, *workpiece.geometry, *obstacles)
        self.warnings += missing_bodies(next(iter(tools.values())), workpiece)
        self.warnings += open_surfaces(self.surfaces)
        pairs = PairReader(urdf, self.keys.robot.flange_link, any_of(tools), workpiece, obstacles, self.document)
        found = pairs.pairs(self.keys.ignore_pairs, self.folder.file)
        self.warnings += pairs.warnings
        return found

    def packages(self) -> dict[str, Path]:
        """The ``packages:`` map, which may stand at the top or under robot."""
        named: dict[str, tuple[Loc, str]] = {}
        for n, folder in self.keys.packages.items():
            named[n] = (("packages", n), folder)
        for n, folder in self.keys.robot.packages.items():
            named[n] = (("robot", "packages", n), folder)
        out: dict[str, Path] = {}
        for n, (loc, folder) in named.items():
            fail = partial(self.document.error, loc)
            out[n] = self.folder.inside(self.folder.path / folder, folder, fail)
            if not isdir(out[n]):
                raise fail(f"no such folder: {folder} (looked for {out[n]})")
        return out

    def urdf(self, path: Path, packages: dict[str, Path]) -> Description:
        """The robot's description; what it is made of lies in the cell."""

        def find(name: str) -> Path:
            found = find_package(name, path, packages, self.folder.path)
            return self.folder.inside(found, f"$(find {name})", partial(of_file, path))

        def may(file: Path) -> None:
            self.folder.inside(file, file.name, partial(of_file, path))

        found = describe(path, {k: xacro_word(v) for k, v in self.keys.robot.xacro_args.items()}, find, may)
        for file in found.files:
            self.folder.read.append(self.folder.inside(file, file.name, partial(of_file, file)))
        self.warnings += found.warnings
        return found

    def urdf_meshes(self, urdf: Urdf, packages: dict[str, Path]) -> dict[str, Path]:
        """Check every collision mesh; returns all packages, the map's and those found beside the URDF."""
        self.warnings += [*urdf.warnings, *unseen_links(urdf)]
        found = dict(packages)
        for mesh in urdf.meshes:

            def fail(message: str, link: str = mesh.link, line: int = mesh.line) -> InputError:
                return InputError(message, file=urdf.path, where=f"line {line}: collision mesh of link {link!r}")

            hit = find_mesh(urdf, mesh.uri, packages, self.folder.path, fail)
            path = self.folder.inside(hit.path, mesh.uri, fail)
            self.folder.existing(path, mesh.uri, fail)
            if hit.package is not None and hit.folder is not None:
                found[hit.package] = hit.folder
            self.folder.read.append(path)
            scale = mesh.scale

            def scaled(factor: float, scale: float = scale) -> str:
                return f'scale="{" ".join([f"{scale * factor:g}"] * 3)}" in the URDF'

            self.mesh(path, mesh.scale, "link", fail, scaled)
        for solid in urdf.solids:

            def at(message: str, link: str = solid.link, line: int = solid.line) -> InputError:
                return InputError(message, file=urdf.path, where=f"line {line}: collision of link {link!r}")

            self.warn(
                judge_size(
                    Sized(f"a {solid.kind}", "link", solid.size, "its sizes {:g} times as large".format), self.scene, at
                )
            )
        return found

    def mesh(self, path: Path, scale: float, role: Role, fail: Fail, remedy: Callable[[float], str]) -> None:
        """Read a mesh, judge its size, and note what surface it has."""
        if (original := original_of(path)) is not None:  # what the verifier reads in its place
            self.folder.read.append(self.folder.inside(original, original.name, fail))
        surface = self.read.get(path) or read_surface(path, fail)
        self.read[path] = surface
        self.surfaces.append(surface)
        self.warn(judge_size(Sized(f"mesh {path.name}", role, surface.extent * scale, remedy), self.scene, fail))

    def tools(self) -> dict[str, Tool]:
        """The tool table; a cell's only tool by an empty name."""
        if self.keys.tool is not None:
            return {"": self.tool(self.keys.tool, ("tool",))}
        return {name: self.tool(keys, ("tools", name)) for name, keys in self.keys.tools.items()}

    def tool(self, keys: ToolKeys, loc: Loc) -> Tool:
        cutter = keys.cutter
        check_tool(keys, loc, self.reach, self.document, self.warnings)
        return Tool(
            T_flange_tcp=self.pose((*loc, "tcp"), keys.tcp),
            mass=keys.mass_kg,
            com=frozen(np.array(keys.com_mm) / 1e3),
            geometry=self.shapes((*loc, "geometry"), keys.geometry),
            cutter=None
            if cutter is None
            else Cutter(cutter.diameter_mm / 1e3, cutter.length_mm / 1e3, cutter.corner_mm / 1e3),
            number=keys.tool_number,
        )

    def workpiece(self) -> Workpiece:
        keys = self.keys.workpiece
        return Workpiece(
            link=keys.link,
            T_link_workpiece=self.pose(("workpiece", "pose"), keys.pose),
            geometry=self.shapes(("workpiece", "geometry"), keys.geometry),
        )

    def pose(self, loc: Loc, keys: PoseKeys) -> Array:
        """(4, 4) in SI of a frame; small positions are suspected to be metres."""
        check_pose(keys, loc, self.document, self.warnings)
        return _pose(keys)

    def base(self, urdf: Urdf, carried: bool) -> Array:
        """(4, 4) base_link in world, joints above it at zero; ``carried``: by or beside external joints, which make
        ``robot.pose`` the pose of the URDF's root."""
        robot = self.keys.robot
        T = self.pose(("robot", "pose"), robot.pose)
        for joint in urdf.chain(robot.base_link) if carried else ():
            T = T @ transform(rpy_matrix(np.array(joint.rpy)), np.array(joint.xyz))
        return frozen(T)

    def obstacles(self, urdf: Urdf, chain: Chain) -> tuple[Shape, ...]:
        rows = self.keys.obstacles
        bodies = self.shapes(("obstacles",), rows)
        out = []
        for n, (row, body) in enumerate(zip(rows, bodies, strict=True)):
            if row.link != "world":
                check_carrier(row.link, urdf, chain, self.document, ("obstacles", n, "link"))
            out.append(replace(body, link=row.link))
        return tuple(out)

    def shapes(self, loc: Loc, rows: Sequence[ShapeKeys]) -> tuple[Shape, ...]:
        return tuple(self.shape((*loc, n), loc, row) for n, row in enumerate(rows))

    def shape(self, loc: Loc, group: Loc, keys: ShapeKeys) -> Shape:
        kind = {"obstacles": "obstacle", "tools": "tool"}.get(str(group[0]), group[0])
        name = keys.name or f"{kind}_{loc[-1]}"
        check_pose(keys, loc, self.document, self.warnings, near=False)
        T = _pose(keys)
        role: Role = "obstacle" if group[0] == "obstacles" else "tool" if group[0] in ("tool", "tools") else "workpiece"
        if keys.mesh is None:
            return self.solid(loc, name, role, keys, T)
        scale = 1.0 if keys.scale is None else keys.scale
        path = self.folder.file((*loc, "mesh"), keys.mesh)
        fail = partial(self.document.error, (*loc, "mesh"))
        self.mesh(path, scale, role, fail, lambda factor: f"scale: {scale * factor:g}")
        return Shape(name=name, kind="mesh", size=(scale,), mesh=path, T_parent_shape=T)

    def solid(self, loc: Loc, name: str, role: Role, keys: ShapeKeys, T: Array) -> Shape:
        """A box, cylinder or sphere; the schema lets exactly one through."""
        kind, given = given_solid(keys)
        size = tuple(v / 1e3 for v in given)
        body = Sized(
            f"{kind}_mm {given}",
            role,
            box_extent(size, kind),
            lambda factor: str([float(f"{v * factor:.6g}") for v in given]),
        )
        self.warn(judge_size(body, self.scene, partial(self.document.error, (*loc, f"{kind}_mm"))))
        return Shape(name=name, kind=kind, size=size, mesh=None, T_parent_shape=T)

    def warn(self, message: str | None) -> None:
        if message is not None:
            self.warnings.append(message)


def _pose(keys: PoseKeys) -> Array:
    return frozen(transform(rpy_matrix(np.radians(keys.rpy_deg)), np.array(keys.xyz_mm) / 1e3))
