"""Strict schema of cell.yaml: its keys and their units."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from machopt.file_formats.strict_yaml import StrictSchema
from machopt.options.option_schema import OptionKeys

NumberTriple = Annotated[list[float], Field(min_length=3, max_length=3)]
Axis = Literal["j1", "j2", "j3", "j4", "j5", "j6"]
_PER_JOINT = "one per moving joint: arm joints, then external joints as listed"
_PAIRS = "expected pairs of names, [[link_1, link_3], …], or the name of an SRDF file"
SHAPE_KEYS = ("box_mm", "cylinder_mm", "sphere_mm", "mesh")


_FREE_TEXT = "write it as a comment: # …"


class PoseKeys(StrictSchema):
    xyz_mm: NumberTriple = Field(default=[0.0, 0.0, 0.0], description="x, y, z in mm")
    rpy_deg: NumberTriple = Field(
        default=[0.0, 0.0, 0.0], description="roll, pitch, yaw in degrees about fixed x, y, z"
    )


class ShapeKeys(PoseKeys):
    HINTS: ClassVar[dict[str, str]] = {
        "link": "bodies of the tool ride on flange_link, those of the part on workpiece.link; obstacles have the key",
        "size_mm": "give box_mm: [x, y, z] edge lengths",
        "radius_mm": "give sphere_mm: radius, or cylinder_mm: [radius, height]",
    }
    name: str | None = Field(default=None, min_length=1, description="a name for reports and pairs")
    box_mm: NumberTriple | None = Field(default=None, description="edge lengths x, y, z")
    cylinder_mm: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[radius, height along z]"
    )
    sphere_mm: float | None = Field(default=None, description="radius")
    mesh: str | None = Field(default=None, min_length=1, description="a file in the cell folder")
    scale: float | None = Field(
        default=None,
        gt=0,
        description="metres per unit of the mesh file; COLLADA states its unit, this is a factor more",
    )

    @model_validator(mode="after")
    def _check_one_shape(self) -> ShapeKeys:
        given = [k for k in SHAPE_KEYS if getattr(self, k) is not None]
        if len(given) != 1:
            raise ValueError(f"found {', '.join(given) or 'no shape'}; expected exactly one of {', '.join(SHAPE_KEYS)}")
        sizes = {
            "box_mm": self.box_mm,
            "cylinder_mm": self.cylinder_mm,
            "sphere_mm": None if self.sphere_mm is None else [self.sphere_mm],
        }.get(given[0])
        if sizes is not None and min(sizes) <= 0:
            raise ValueError(f"{given[0]}: found {sizes}; expected sizes above 0")
        if self.scale is not None and self.mesh is None:
            raise ValueError(f"scale belongs to a mesh; {given[0]} is in mm already")
        return self


class ObstacleKeys(ShapeKeys):
    link: str = Field(
        default="world", min_length=1, description="`world`, or a link of the URDF that a rail or positioner moves"
    )


class LimitKeys(StrictSchema):
    position_deg: list[Annotated[list[float], Field(min_length=2, max_length=2)]] | None = Field(
        default=None, description=f"[lowest, highest] {_PER_JOINT}; left out: the ranges of the URDF"
    )
    velocity_deg_s: list[float] | None = Field(
        default=None, description=f"deg/s (mm/s if prismatic), {_PER_JOINT}; left out: the velocities of the URDF"
    )
    acceleration_deg_s2: list[float] = Field(description=f"deg/s² (mm/s² if prismatic), {_PER_JOINT}")
    jerk_deg_s3: list[float] = Field(description=f"deg/s³ (mm/s³ if prismatic), {_PER_JOINT}")


class RobotKeys(StrictSchema):
    HINTS: ClassVar[dict[str, str]] = {
        "srdf": "name it as ignore_pairs: robot.srdf, at the top of cell.yaml",
        "xacro": "give the file as urdf: robot.urdf.xacro",
        "payload_kg": "give the tool's mass as tool.mass_kg",
    }
    urdf: str = Field(min_length=1, description="the URDF or xacro file, relative to the cell folder")
    xacro_args: dict[str, str | float | bool] = Field({}, description="values of the xacro file's arguments, by name")
    packages: dict[str, str] = Field({}, description="package:// names to folders, relative to the cell folder")
    base_link: str = Field(min_length=1, description="a link of the URDF")
    flange_link: str = Field(min_length=1, description="a link of the URDF")
    pose: PoseKeys = Field(
        default=PoseKeys(), description="base_link in world; with external joints: the URDF's root link"
    )
    arm_joints: list[str] | None = Field(default=None, min_length=6, description="names of joints 1 to 6")
    external_joints: list[str] = Field(default=[], description="names of rail, gantry and positioner joints")
    gravity_compensator: Literal["fitted", "none", "unknown"] = Field(
        default="unknown", description="whether the arm has a spring or cylinder at axis 2"
    )
    rated_payload_kg: float | None = Field(default=None, gt=0, description="of the data sheet")
    home_deg: list[float] = Field(min_length=6, description=f"degrees (mm if prismatic), {_PER_JOINT}")
    tool_change_deg: list[float] | None = Field(
        default=None,
        description=f"where tools are changed, degrees (mm if prismatic), {_PER_JOINT}; left out: at home",
    )
    limits: LimitKeys = Field(description="of every moving joint")


class ToolModeKeys(StrictSchema):
    f_Hz: float = Field(gt=0, description="natural frequency")
    zeta: float = Field(gt=0, lt=1, description="damping ratio")
    k_N_um: float = Field(gt=0, description="modal stiffness, N/µm")
    direction: NumberTriple | Literal["tool_x", "tool_y", "tool_z"] = Field(description="in TCP axes")


class CutterKeys(StrictSchema):
    diameter_mm: float = Field(gt=0, description="mm")
    length_mm: float = Field(gt=0, description="mm from the TCP back along -z")
    corner_mm: float = Field(default=0.0, ge=0, description="older name of corner_radius_mm")
    corner_radius_mm: float | None = Field(
        default=None, ge=0, description="0 for an end mill, half the diameter for a ball"
    )
    teeth: int | None = Field(default=None, ge=1, le=64, description="number of teeth")
    helix_deg: float | None = Field(default=None, gt=-80, lt=80, description="helix angle, + for a right-hand helix")
    point_deg: float | None = Field(default=None, gt=0, lt=180, description="included point angle of a drill")
    web_mm: float | None = Field(default=None, gt=0, description="web thickness of a drill")
    runout_mm: float = Field(default=0.0, ge=0, description="radial run-out")
    side_stiffness_N_mm: float | None = Field(default=None, gt=0, description="of tool and spindle at the tip")
    modes: list[ToolModeKeys] = Field(default=[], description="modes of tool and spindle at the tip")

    @property
    def corner_radius(self) -> float:
        """Corner radius in mm, by either name."""
        return self.corner_mm if self.corner_radius_mm is None else self.corner_radius_mm

    @model_validator(mode="after")
    def _check_corner_fits(self) -> CutterKeys:
        name = "corner_mm" if self.corner_radius_mm is None else "corner_radius_mm"
        if self.corner_radius_mm is not None and "corner_mm" in self.model_fields_set:
            raise ValueError("found corner_mm and corner_radius_mm; expected one of them")
        if self.corner_radius > self.diameter_mm / 2 + 1e-9:
            raise ValueError(f"{name} {self.corner_radius:g} is more than half the diameter, {self.diameter_mm / 2:g}")
        if self.web_mm is not None and self.web_mm >= self.diameter_mm:
            raise ValueError(f"web_mm {self.web_mm:g} is not below the diameter, {self.diameter_mm:g}")
        return self


class ToolKeys(StrictSchema):
    HINTS: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("name", "number", "description"), f"the tool needs none; {_FREE_TEXT}"),
        **dict.fromkeys(("diameter_mm", "length_mm"), "they belong to cutter: {diameter_mm: …, length_mm: …}"),
        **dict.fromkeys(("xyz_mm", "rpy_deg"), "they belong to tcp: {xyz_mm: […], rpy_deg: […]}"),
    }
    tcp: PoseKeys = Field(description="tool tip in flange_link, z out of the tool into the workpiece")
    mass_kg: float = Field(default=0.0, ge=0, description="kg")
    com_mm: NumberTriple = Field(default=[0.0, 0.0, 0.0], description="centre of mass x, y, z in the flange frame")
    geometry: list[ShapeKeys] = Field(default=[], description="bodies of spindle and holder, in flange_link")
    inertia_kg_m2: list[NumberTriple] | None = Field(
        default=None, min_length=3, max_length=3, description="3 × 3 about the centre of mass, flange axes"
    )
    cutter: CutterKeys | None = Field(default=None, description="the part that may touch the workpiece where it cuts")
    tool_number: int | None = Field(
        default=None, ge=0, description="of the tool stored in the controller, in a table of tools"
    )


class WorkpieceKeys(StrictSchema):
    link: str = Field(default="world", min_length=1, description="world or a link of the URDF")
    pose: PoseKeys = Field(description="the CAM coordinates in that link")
    geometry: list[ShapeKeys] = Field(default=[], description="bodies of the workpiece, in CAM coordinates")
    stiffness_N_mm: float | NumberTriple | None = Field(
        default=None, description="of the part at the tool: one number, or three along the CAM axes"
    )
    pose_covariance: list[Annotated[list[float], Field(min_length=6, max_length=6)]] | None = Field(
        default=None, min_length=6, max_length=6, description="x, y, z in mm and rx, ry, rz in mrad at the CAM origin"
    )


class WorkOffsetKeys(StrictSchema):
    pose: PoseKeys = Field(default=PoseKeys(), description="the frame that its coordinates count from, in workpiece")
    geometry: list[ShapeKeys] = Field(default=[], description="bodies of the part that lies there, in that frame")
    fixtures: list[ShapeKeys] = Field(default=[], description="what holds it, in that frame; rides on workpiece.link")


class JointMapKeys(StrictSchema):
    sign: list[Literal[-1, 1]] = Field(default=[1] * 6, min_length=6, max_length=6, description="1 or -1, axes 1 to 6")
    offset_deg: list[float] = Field(
        default=[0.0] * 6,
        min_length=6,
        max_length=6,
        description="the controller's axes where the URDF's joints are zero",
    )
    coupling: dict[Axis, dict[Axis, float]] = Field(
        default={}, description="{j3: {j2: 1}}: the controller's axis 3 counts once axis 2 on top"
    )

    @model_validator(mode="after")
    def _from_lower_axes(self) -> JointMapKeys:
        for axis, sources in self.coupling.items():
            for other in sources:
                if not other < axis:
                    raise ValueError(f"coupling: {axis} gains from {other}; expected an axis before {axis}")
        return self


class EventLineKeys(StrictSchema):
    spindle_on: str | None = Field(default=None, description="a line with @{value} in rpm and @{text}")
    spindle_off: str | None = Field(default=None, description="a line")
    coolant_on: str | None = Field(default=None, description="a line")
    coolant_off: str | None = Field(default=None, description="a line")
    tool: str | None = Field(default=None, description="a line with @{value}, the tool number")
    dwell: str | None = Field(default=None, description="a line with @{value} in s")
    stop: str | None = Field(default=None, description="a line")
    comment: str | None = Field(default=None, description="a line with @{text}")


class ExternalAxisControllerKeys(StrictSchema):
    number: int | None = Field(
        default=None,
        ge=1,
        le=6,
        description="which external axis of the controller: 1 for E1 or eax_a; by its place in the list if left out",
    )
    sign: Literal[-1, 1] = Field(default=1, description="1 or -1, the controller's direction against the URDF's")
    offset: float = Field(default=0.0, description="mm or degrees, the controller's value at the URDF's zero")
    unit: str | None = Field(
        default=None, pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$", description="ABB: the mechanical unit, such as STN1"
    )
    machine: int | None = Field(
        default=None, ge=1, le=7, description="KUKA: n of the MACHINE_DEF[n] that the positioner is, mostly 2"
    )
    pulses: float | None = Field(default=None, description="Yaskawa: encoder pulses per mm or degree")


class ControllerKeys(StrictSchema):
    post: str | None = Field(
        default=None, min_length=1, description="a post's name, or a .toml file in the cell folder; none is assumed"
    )
    joint_map: JointMapKeys | None = Field(default=None, description="controller = coupling(sign * joint + offset_deg)")
    root: PoseKeys | None = Field(default=None, description="the controller's robot coordinate system in base_link")
    flange: PoseKeys | None = Field(default=None, description="the controller's tool 0 in flange_link")
    world: PoseKeys | None = Field(
        default=None, description="the controller's WORLD in the cell's world, where a rail carries the robot"
    )
    external: dict[str, ExternalAxisControllerKeys] = Field(
        default={}, description="how the controller counts the external joints, by their names in the URDF"
    )
    tool_number: int | None = Field(default=None, ge=0, description="of the tool stored in the controller")
    base_number: int | None = Field(default=None, ge=0, description="of the base or user frame stored there")
    pulses_per_deg: list[float] | None = Field(default=None, min_length=6, max_length=6, description="encoder pulses")
    position_levels_mm: list[float] | None = Field(
        default=None, min_length=8, max_length=8, description="Yaskawa: how far from a point PL=1 … 8 begin, rising"
    )
    moves_per_part: int | None = Field(default=None, ge=2, description="longer programs are split")
    nonflip_j5: Literal["negative", "positive"] | None = Field(default=None, description="FANUC: J5 of CONFIG N")
    absolute_accuracy: Literal["on", "off", "unknown"] = Field(
        default="unknown",
        description="on: the controller corrects geometry and gravity sag itself, so that neither is corrected again",
    )
    lines: EventLineKeys = Field(
        default=EventLineKeys(), description="program lines for events, with @{value} (rpm, tool number, s) and @{text}"
    )


class AccuracyKeys(StrictSchema):
    HINTS: ClassVar[dict[str, str]] = {
        "rp_mm": "a data sheet's ISO 9283 RP is about 3.6 sigma of a coordinate: repeatability_mm is RP / 3.6",
    }
    absolute_mm: float | None = Field(default=None, ge=0, description="1 sigma of a coordinate of the position")
    absolute_deg: float | None = Field(default=None, ge=0, description="1 sigma of the orientation about an axis")
    repeatability_mm: float | None = Field(default=None, ge=0, description="1 sigma of a coordinate")
    lost_motion_arcmin: list[float] | None = Field(
        default=None, min_length=6, max_length=6, description="full width of joints 1 to 6"
    )
    includes_lost_motion: bool = Field(default=True, description="true: the numbers above contain the lost motion")
    source: str = Field(default="", description="where the numbers come from")


class CellKeys(StrictSchema):
    HINTS: ClassVar[dict[str, str]] = {
        **dict.fromkeys(
            ("collision", "collisions", "clearance_mm", "force_N", "method", "seed"),
            "planning options belong under plan:, or into the command as --set key=value",
        ),
        **dict.fromkeys(("options", "planning"), "planning options belong under plan:"),
        "post": "give it as controller: {post: …}",
        **dict.fromkeys(("unit", "units"), "lengths are in mm and angles in degrees, as each key says"),
        **dict.fromkeys(("notes", "description", "comment", "author", "version"), _FREE_TEXT),
        **dict.fromkeys(("fixtures", "fixture", "environment", "floor"), "bodies of the hall belong under obstacles:"),
        "part": "the part belongs under workpiece:",
        "external_joints": "it belongs under robot:",
    }
    machopt_cell: Literal[1] = Field(description="the format, 1")
    name: str = Field(min_length=1, description="a name for reports")
    robot: RobotKeys = Field(description="the arm")
    packages: dict[str, str] = Field({}, description="package:// names to folders, relative to the cell folder")
    tool: ToolKeys | None = Field(default=None, description="what the flange carries; or `tools`")
    tools: dict[str, ToolKeys] = Field(
        default={}, description="instead of `tool`: what it may carry, by the numbers or names of the CAM file"
    )
    workpiece: WorkpieceKeys = Field(description="where the CAM coordinates are")
    offsets: dict[str, WorkOffsetKeys] = Field(
        default={}, description="work offsets by the CAM file's names (G54, FIXTURE_B); all are there at once"
    )
    obstacles: list[ObstacleKeys] = Field(default=[], description="fixtures, walls, floor, in their link")
    stiffness: str | None = Field(default=None, min_length=1, description="a file in the cell folder")
    kinematics: str | None = Field(default=None, min_length=1, description="a file in the cell folder")
    process: str | None = Field(
        default=None, min_length=1, description="process.yaml: cutting conditions and tolerances"
    )
    accuracy: AccuracyKeys | None = Field(default=None, description="accuracy of the arm, for tolerances")
    ignore_pairs: list[str | list[str]] = Field(
        default=[],
        description="bodies that may touch: [[link_1, link_3], [tool, link_5], …] by names of links, bodies, `tool`, "
        "`workpiece`, `cutter` or `world` (everything fixed); or an SRDF file, whose disable_collisions count; or "
        "files and pairs in one list",
    )
    plan: OptionKeys | None = Field(default=None, description="the cell's own planning options")
    controller: ControllerKeys | None = Field(default=None, description="what robot programs need to know")

    @field_validator("tools", mode="before")
    @classmethod
    def _convert_numbers_to_names(cls, value: object) -> object:
        return {str(name): keys for name, keys in value.items()} if isinstance(value, dict) else value

    @model_validator(mode="after")
    def _check_tool_or_table(self) -> CellKeys:
        if (self.tool is None) == (not self.tools):
            raise ValueError(f"found {'both tool and tools' if self.tools else 'no tool'}; expected tool or tools")
        return self

    @field_validator("ignore_pairs", mode="before")
    @classmethod
    def _split_pairs_and_files(cls, value: object) -> object:
        """One file for a list of one; errors name all forms that are accepted."""
        entries = [value] if isinstance(value, str) else value
        if not isinstance(entries, list):
            raise ValueError(f"found {value!r}; {_PAIRS}")
        for n, entry in enumerate(entries):
            pair = isinstance(entry, list) and len(entry) == 2 and all(isinstance(name, str) for name in entry)
            if not (pair or isinstance(entry, str)):
                raise ValueError(f"found {entry!r} as entry {n + 1}; {_PAIRS}")
        return entries


class AnyChainRobotKeys(RobotKeys):
    arm_joints: list[str] | None = Field(default=None, min_length=1, description="names of the joints in chain order")
    home_deg: list[float] = Field(min_length=1, description=f"degrees (mm if prismatic), {_PER_JOINT}")


class AnyChainKeys(CellKeys):
    """A cell whose robot may be any chain of joints, a single axis on a bench too: nothing is planned for it."""

    robot: AnyChainRobotKeys
    tool: ToolKeys = ToolKeys(tcp=PoseKeys())
    workpiece: WorkpieceKeys = WorkpieceKeys(pose=PoseKeys())
