"""Planning options in SI, as the planner takes them; the user's keys carry units
(:mod:`machopt.options.plan_option_reader`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi, radians
from typing import Any, Literal

import numpy as np

from machopt.numerics.array_types import Array

PlanMethod = Literal["global", "joint", "jiao2022", "default"]
PlanObjectiveKind = Literal["index", "tolerance"]
StiffnessIndex = Literal["auto", "deflection", "stiffness", "jiao2022"]


@dataclass(frozen=True)
class FixedRotation:
    """The user's own rotation at one toolpath point."""

    point: int
    gamma: float  # rad


@dataclass(frozen=True, kw_only=True)
class SteeringRule:
    """User's decision about some places; :mod:`machopt.data_types.steering_rules` resolves which these are."""

    operation: str = ""  # its label; "": by points
    points: tuple[int, int] | None = None  # first and last toolpath point; None without an operation: all
    gamma: float | None = None  # rad, the rotation there
    forbid: tuple[float, float] | None = None  # rad, no rotation between these, from the first on in the positive sense
    prefer: float | None = None  # rad; deviation from it is priced with ``weight``
    weight: float = 0.1
    branch: int | None = None  # the only branch to use
    joint: str = ""  # an external joint, by its name or as e1, e2 …; then the wish is about it alone
    at: float | None = None  # m or rad, its position there
    away: tuple[float, float] | None = None  # m or rad, forbidden range
    unit: Literal["mm", "deg", ""] = ""  # of ``at`` and ``away``

    @property
    def forbids(self) -> bool:
        """Whether the rule can make a plan infeasible; a preference cannot."""
        return any(v is not None for v in (self.gamma, self.forbid, self.branch, self.at, self.away))


@dataclass(frozen=True)
class ProcessForce:
    """Force of the process on the tool, in path axes."""

    travel: float = 0.0  # N, along the direction of travel
    normal: float = 0.0  # N, along tool axis × travel
    axial: float = 0.0  # N, along the tool axis towards the shank (pushes the robot back)
    is_per_point: bool = False  # the toolpath has a force of its own at some points

    @property
    def given(self) -> bool:
        """Whether a force is known at any point."""
        return self.is_per_point or any((self.travel, self.normal, self.axial))

    def resolve_components(self, own: Array | None) -> tuple[Any, Any, Any]:
        """Return the force along travel, normal and axis, N; of each point where the toolpath has its own.

        Args:
            own: (n, 3) N, components of the points, NaN where this force holds; None: it holds at all.
        """
        if own is None:
            return self.travel, self.normal, self.axial
        given = np.array([self.travel, self.normal, self.axial])
        resolved = np.where(np.isnan(own), given, own)
        return resolved[..., :1], resolved[..., 1:2], resolved[..., 2:]


@dataclass(frozen=True, kw_only=True)
class ObjectiveWeights:
    """Weights of the objective; all terms are made dimensionless first (see planning/cost/objective.py)."""

    mean: float = 1.0  # mean index along the path
    worst: float = 0.5  # worst index along the path
    travel: float = 0.03  # joint travel, per 180° summed over the axes
    rotation: float = 0.1  # total rotation about the tool axis, per 180°
    feed: float = 2.0  # time lost because the axes cannot follow the programmed feed, per share of the cutting time
    rapid: float = 0.5  # time of the rapid moves, per share of the time of the job
    reorientation: float = (
        0.02  # each branch change and whole turn in a rapid move, as a share of the lowest possible J
    )
    stability: float = 0.0  # shortfall of the stable depth of cut, mean along the path
    clearance: float = 0.05  # nearness to anything, mean along the path: 1 at contact, 0 from clearance_full on


ExternalMode = Literal["locked", "operation", "moving"]


@dataclass(frozen=True, kw_only=True)
class ExternalJointOptions:
    """Use of one external joint."""

    joint: str  # its name, or e1, e2 … in the order of the cell
    mode: ExternalMode | None = None  # locked: at ``at`` or home; operation: one value each; moving, also None
    operations: tuple[tuple[str, ExternalMode], ...] = ()  # modes of operations by label, before ``mode``
    weight: float = 1.0  # of its travel, as a share of that of a joint of the arm
    at: float | None = None  # m or rad, where it is locked
    preferred: float | None = None  # m or rad
    range: tuple[float, float] | None = None  # m or rad, within its limits
    unit: Literal["mm", "deg", ""] = ""  # of what is given; "": nothing with a unit is
    at_operations: tuple[tuple[str, float], ...] = ()  # m or rad, position in operations by label

    @property
    def locks(self) -> bool:
        """Whether it is locked, at least in some operations."""
        return self.mode == "locked" or "locked" in dict(self.operations).values()

    @property
    def moves(self) -> bool:
        """Whether its value is chosen, at least in some operations."""
        return self.mode != "locked" or any(mode != "locked" for _, mode in self.operations)


@dataclass(frozen=True)
class TiltRange:
    """Permitted tilt of the tool axis against that of the CAM file."""

    lead: tuple[float, float] = (0.0, 0.0)  # rad, towards the direction of travel
    side: tuple[float, float] = (0.0, 0.0)  # rad, towards tool axis × travel

    @property
    def is_free(self) -> bool:
        """Whether it permits any tilt at all."""
        return any(self.lead) or any(self.side)


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """All options of one plan."""

    method: PlanMethod = "global"
    index: StiffnessIndex = "auto"
    objective: PlanObjectiveKind = "index"  # tolerance: fewest points out of tolerance first, then J
    force: ProcessForce = field(default_factory=ProcessForce)
    weights: ObjectiveWeights = field(default_factory=ObjectiveWeights)
    rotation_step: float = radians(5.0)  # rad
    rotation_range: tuple[float, float] = (-pi, pi)
    preferred_rotation: float | None = None  # rad; deviation from it is priced with preferred_weight
    preferred_weight: float = 0.1
    fixed: tuple[FixedRotation, ...] = ()
    steer: tuple[SteeringRule, ...] = ()
    singularity_wrist: float = radians(5.0)  # least angle between axes 4 and 6
    singularity_elbow: float = radians(3.0)  # least angle from the stretched or folded arm
    singularity_shoulder: float = 0.05  # m, least distance of the wrist centre from axis 1
    limit_margin: float = radians(0.5)  # rad, distance kept from joint limits
    min_stability_ratio: float | None = None  # least stable depth of cut over the planned one; None: no limit
    clearance: float = 0.002  # m, required between everything checked
    clearance_full: float = 0.05  # m, from which more gains nothing, where the objective counts it
    collision_step: float = radians(1.0)  # joint step between collision checks
    collision: bool = True
    gouge: float | None = None  # m by which the cutter may be in the part, taken as finished; None: not looked for
    advised_feed_share: float | None = None  # of the points too fast for their tolerance; None: the file's feeds
    sample: float = 0.012  # s
    path_tolerance: float = 15e-6  # m, corner rounding
    axis_tolerance: float = radians(0.03)  # rad
    approach_feed: float = 0.05  # m/s for approach, retract and link moves that carry no feed
    rapid_scale: float = 0.8  # share of the joint velocity limits used in rapid moves
    rapid_blend: float = 0.02  # m by which a rounded corner of rapid moves may pass its point; 0: stops
    limit_scale: float = 0.97  # share of the velocity, acceleration and jerk limits used while cutting
    allow_gaps: bool = False
    max_reentries: int = 0  # lifts inside of closed contours, each followed by a new entry at the same point
    compensate: bool = False  # drive a path shifted against the deflection predicted under ``force``
    compensation_max: float = 0.002  # m, a larger shift is refused: a unit is wrong, or the arm far too soft
    seed: int = 0
    external: tuple[ExternalJointOptions, ...] = ()
    tilt: TiltRange | None = None  # of a ball cutter; None: the tool axis is that of the CAM file
    tilt_operations: tuple[tuple[str, TiltRange], ...] = ()  # the same of operations by label, before ``tilt``

    @property
    def is_searched(self) -> bool:
        """Whether the sequence is searched over all configurations."""
        return self.method in ("global", "joint")

    @property
    def tilts(self) -> bool:
        """Whether the tool axis may differ from that of the CAM file anywhere."""
        return any(r is not None and r.is_free for r in (self.tilt, *dict(self.tilt_operations).values()))

    def tilt_range_of(self, operation: str) -> TiltRange:
        """Return the permitted tilt in an operation.

        Args:
            operation: its label.
        """
        return dict(self.tilt_operations).get(operation, self.tilt) or TiltRange()
