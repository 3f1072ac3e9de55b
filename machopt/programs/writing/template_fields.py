"""Fields of the templates: one value per move, and values of the whole program. README.md lists them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from machopt.data_types.robot_program import LIN, JointMap, RobotController, RobotProgram
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.programs.writing.blend_zones import BlendZones, compute_blend_zones
from machopt.programs.writing.external_axes import (
    MOST,
    build_external_columns,
    build_external_fields,
    list_external_notes,
)
from machopt.programs.writing.orientation_angles import (
    convert_to_abc_deg,
    convert_to_positive_quaternion,
    convert_to_ur_rotation_vector,
    convert_to_xyz_deg,
)
from machopt.programs.writing.template_language import TemplateColumn, TemplateValue

MM, MM_MIN = 1e3, 6e4
ROUNDED = frozenset(
    ("rounded", "blend_m", "blend_mm", "zone_number", "corner", "corner_number", "cnt", "pl")
)  # fields of zones
UR_JOINT_SPEED = 1.05  # rad/s, Universal Robots' own default for movej, where the axis limits are not given


@dataclass(frozen=True)
class PostJob:
    """A program with its controller, and what every dialect computes from the two."""

    program: RobotProgram
    controller: RobotController
    axes_deg: Array  # (M, 6) as the controller counts them
    zone: BlendZones  # of the move's ends

    @classmethod
    def build(cls, program: RobotProgram, controller: RobotController, moves_per_part: int | None = None) -> PostJob:
        """Build a job from a program and its controller.

        Args:
            program: Robot program: targets, poses and moves in SI units.
            controller: Controller settings of the cell.
            moves_per_part: Largest number of moves per part, None without a limit.

        Returns:
            The job.
        """
        axes = (controller.joint_map or JointMap()).compute_axes_deg(program.q)
        return cls(program, controller, axes, compute_blend_zones(program, moves_per_part))

    @property
    def blend(self) -> Array:
        """(M,) m before and behind each move's end at which the controller may leave the line."""
        return self.zone.distance

    @property
    def T_mount_tcp(self) -> Array:
        """(4, 4) the tool in the controller's own flange frame."""
        T, mount = self.program.T_flange_tcp, self.controller.T_flange_mount
        return T if mount is None else invert_transform(mount) @ T

    @property
    def com_mm(self) -> Array:
        """(3,) mm, the tool's centre of mass in the controller's own flange frame."""
        mount = np.eye(4) if self.controller.T_flange_mount is None else self.controller.T_flange_mount
        return np.asarray(invert_transform(mount)[:3] @ np.append(self.program.tool_com, 1.0) * MM)

    @property
    def T_root_workpiece(self) -> Array:
        """(4, 4) the workpiece in the frame its targets are given from: the controller's robot coordinate system; with
        external axes the positioner's flange, or on a rail alone the controller's WORLD."""
        T, root = self.program.T_carrier_workpiece, self.controller.T_world_root
        if T is None:
            T, root = self.program.T_base_workpiece, self.controller.T_base_root
        elif self.program.part_rides:
            root = None
        return T if root is None else invert_transform(root) @ T


def build_pose_fields(prefix: str, T: Array) -> dict[str, Callable[[], Array]]:
    """Build every representation of poses: mm, m, and the orientation of each maker.

    Args:
        prefix: Prefix of the field names.
        T: Poses (..., 4, 4), m.

    Returns:
        Field → function that computes its values.
    """
    p, R = T[..., :3, 3], T[..., :3, :3]

    def named(names: str, make: Callable[[], Array]) -> dict[str, Callable[[], Array]]:
        memory: list[Array] = []

        def column(k: int) -> Array:
            if not memory:
                memory.append(make())
            return np.asarray(memory[0][..., k])

        return {prefix + name: (lambda k=k: column(k)) for k, name in enumerate(names.split())}  # type: ignore[misc]

    return {
        **named("x y z", lambda: p * MM),
        **named("x_m y_m z_m", lambda: p),
        **named("a b c", lambda: convert_to_abc_deg(R)),
        **named("r p w", lambda: convert_to_abc_deg(R)),
        **named("qw qx qy qz", lambda: convert_to_positive_quaternion(R)),
        **named("rvx rvy rvz", lambda: convert_to_ur_rotation_vector(R)),
        **named("ex ey ez", lambda: convert_to_xyz_deg(R)),
        **named("i j k", lambda: -R[..., :, 2]),
    }


def build_move_columns(job: PostJob) -> dict[str, Callable[[], TemplateColumn]]:
    """Build the template fields of every move, computed on demand.

    Args:
        job: Program, controller, axis values and blend zones.

    Returns:
        Field → function that computes its column.
    """
    p, c = job.program, job.controller
    n = len(p)
    out: dict[str, Callable[[], TemplateColumn]] = {**build_pose_fields("", p.T_workpiece_tcp)}
    for k in range(6):
        out[f"a{k + 1}"] = lambda k=k: job.axes_deg[:, k]  # type: ignore[misc]
        out[f"a{k + 1}_rad"] = lambda k=k: np.radians(job.axes_deg[:, k])  # type: ignore[misc]
        out[f"q{k + 1}"] = lambda k=k: p.q[:, k]  # type: ignore[misc]
        out[f"q{k + 1}_deg"] = lambda k=k: np.degrees(p.q[:, k])  # type: ignore[misc]
        pulses = None if c.pulses_per_deg is None else c.pulses_per_deg[k]
        out[f"pulse{k + 1}"] = lambda k=k, s=pulses: (  # type: ignore[misc]
            np.full(n, np.nan) if s is None else job.axes_deg[:, k] * s
        )
    out |= build_external_columns(p, c)
    words = [m.word for m in sorted(MoveKind)]
    labels = [*p.operations, ""]
    out |= {
        "index": lambda: np.arange(n),
        "kind_index": lambda: np.where(p.kind == LIN, np.cumsum(p.kind == LIN), np.cumsum(p.kind != LIN)) - 1,
        "feed_m_s": lambda: p.feed,
        "feed_mm_s": lambda: p.feed * MM,
        "feed_mm_min": lambda: p.feed * MM_MIN,
        "blend_m": lambda: job.blend,
        "blend_mm": lambda: job.blend * MM,
        "rounded": (job.blend > 0.0).tolist,
        "cptp": lambda: compute_rounded_percent(job),
        "move": lambda: [words[m] for m in p.moves.tolist()],
        "kind": lambda: ["lin" if k == LIN else "ptp" for k in p.kind.tolist()],
        "operation": lambda: [labels[o] for o in p.operation.tolist()],
        "time": lambda: np.full(n, np.nan) if p.time is None else p.time,
        "step": lambda: np.full(n, np.nan) if p.time is None else np.diff(p.time, prepend=np.nan),
    }
    return out


def compute_rounded_percent(job: PostJob) -> Array:
    """Compute the percentage of half a joint move at which its end may be rounded, (M,); NaN for an exact stop.

    Args:
        job: Program, controller, axis values and blend zones.
    """
    p = job.program
    if p.rapid_share is None:
        return np.full(len(p), np.nan)
    percent = np.floor(200.0 * p.rapid_share + 1e-6)
    return np.where((p.kind != LIN) & (job.blend > 0.0) & (percent >= 1.0), percent, np.nan)


def build_program_fields(job: PostJob) -> dict[str, TemplateValue]:
    """Build the template fields of the whole program.

    Args:
        job: Program, controller, axis values and blend zones.

    Returns:
        Field → value.
    """
    p, c = job.program, job.controller
    largest = float(job.blend[p.kind == LIN].max(initial=0.0))
    out: dict[str, TemplateValue] = {
        "total": len(p),
        "source": p.source,
        "ptp_percent": p.ptp_speed * 100.0,
        "ptp_share": p.ptp_speed,
        "ptp_rad_s": p.ptp_speed * (UR_JOINT_SPEED if p.axis_velocity is None else float(np.min(p.axis_velocity))),
        "ptps": max(int((p.kind != LIN).sum()), 1),
        "lins": max(int((p.kind == LIN).sum()), 1),
        "corner_mm": largest * MM if largest > 0.0 else float("nan"),
        "corner_m": largest if largest > 0.0 else float("nan"),
        "tool_number": float("nan") if c.tool_number is None else c.tool_number,
        "base_number": float("nan") if c.base_number is None else c.base_number,
        "mass": p.tool_mass,
        **build_external_fields(p, c),
        "exact": largest <= 0.0,
    }
    com = job.com_mm
    out |= {f"com_{axis}": float(v) for axis, v in zip("xyz", com, strict=True)}
    out |= {f"com_{axis}_m": float(v) / MM for axis, v in zip("xyz", com, strict=True)}
    names = [*p.joint_names, *(a.joint for a in p.external_axes)]
    out |= {f"joint_{k + 1}": names[k] if k < len(names) else "" for k in range(6 + MOST)}
    for prefix, T in (("tool_", job.T_mount_tcp), ("base_", job.T_root_workpiece)):
        out |= {name: float(make()) for name, make in build_pose_fields(prefix, T).items()}
    return out


def list_common_notes(job: PostJob, used: frozenset[str], samples: bool) -> list[str]:
    """List the notes for every program: origin of frames and angles, and what was not given.

    Args:
        job: Program, controller, axis values and blend zones.
        used: Names of the template fields that the post uses.
        samples: Whether the post writes samples.

    Returns:
        Lines of the note.
    """
    p = job.program
    notes = [
        f"written by machopt{f' from {p.source}' if p.source else ''}",
        f"{len(p)} moves. First run slowly and by hand",
    ]
    if job.controller.absolute_accuracy == "on":
        notes.append("absolute accuracy on: geometry and gravity are left to the controller")
        notes.append("a compensation is of the process force alone")
    if p.external_axes:
        notes += list_external_notes(p, job.controller)
        if p.T_carrier_workpiece is None:
            notes.append("the workpiece frame holds with the external axes where they stand at the first move")
    if samples:
        notes.append("control samples: the controller interpolates between them")
    elif p.blend > 0.0 and used & ROUNDED:
        notes.append(
            f"cutting moves run on where that passes a point by {p.blend * MM:g} mm at most, elsewhere exact stops"
        )
    else:
        notes.append("no rounding: the robot stops exactly at every point")
    return notes


def list_common_assumptions(job: PostJob) -> list[str]:
    """List what is assumed about a controller because the cell does not give it, for makers' programs.

    Args:
        job: Program, controller, axis values and blend zones.

    Returns:
        One sentence per assumption.
    """
    c = job.controller
    out = []
    if c.joint_map is None:
        out.append(
            "no controller.joint_map in the cell: axis angles are the URDF's joints, same sign, same zero, no coupling"
        )
    if job.program.T_carrier_workpiece is None and c.T_base_root is None:
        out.append("no controller.root in the cell: the robot's own coordinate system is base_link")
    if c.T_flange_mount is None:
        out.append("no controller.flange in the cell: tool 0 is the URDF's flange link")
    if not np.isfinite(job.program.tool_mass):
        out.append("no tool.mass_kg in the cell: set the load on the controller")
    return out


class LazyColumns(Mapping[str, TemplateColumn]):
    """Columns computed once, when first used."""

    def __init__(self, makers: Mapping[str, Callable[[], TemplateColumn]]) -> None:
        self._makers, self._made = makers, dict[str, TemplateColumn]()

    def __getitem__(self, name: str) -> TemplateColumn:
        if name not in self._made:
            self._made[name] = self._makers[name]()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)
