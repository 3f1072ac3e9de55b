"""Schema of the planning options: every key with its unit, default, bounds and meaning."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator, model_validator

from machopt.data_types.plan_options import ExternalMode, PlanMethod, PlanObjectiveKind, StiffnessIndex
from machopt.file_formats.strict_yaml import StrictSchema
from machopt.options.steering_schema import SteerKeys

MAX_STABILITY_RATIO = 4.0  # larger ratios are not computed
MAX_TILT_DEG = 45.0  # beyond it a lead is no longer a small change of what the CAM file programs


class ForceKeys(StrictSchema):
    travel: float | None = Field(default=None, description="N along the direction of travel")
    normal: float | None = Field(default=None, description="N along tool axis × travel")
    axial: float | None = Field(default=None, description="N along the tool axis towards the shank")


class WeightKeys(StrictSchema):
    mean: float | None = Field(
        default=None, ge=0, description="of the index over the length cut, as a share of a typical one"
    )
    worst: float | None = Field(default=None, ge=0, description="of its worst value, the same")
    travel: float | None = Field(
        default=None, ge=0, description="of joint travel, per 180 degrees summed over the axes"
    )
    rotation: float | None = Field(default=None, ge=0, description="of rotation about the tool axis, per 180 degrees")
    feed: float | None = Field(default=None, ge=0, description="of the share of the cutting time lost to slow axes")
    rapid: float | None = Field(
        default=None, ge=0, description="of the time of the rapid moves, as a share of the time of the job"
    )
    reorientation: float | None = Field(
        default=None,
        ge=0,
        description="of each branch change and each whole turn of a joint in a rapid move, as a share of the lowest "
        "objective that the index permits",
    )
    stability: float | None = Field(
        default=None,
        ge=0,
        description="of the shortfall of the stable depth of cut over the length milled: 0 from 1.2 times the planned "
        "depth on; needs process.yaml with modes",
    )
    clearance: float | None = Field(
        default=None,
        ge=0,
        description="of nearness to anything over the length cut: 1 at contact, 0 at clearance_full_mm",
    )


class ExternalJointOptionKeys(StrictSchema):
    """One external joint, by its name or as e1, e2 … in the order of the cell."""

    mode: ExternalMode | None = Field(
        default=None, description="locked (at home, or at_mm, at_deg); operation: one value for each; moving (default)"
    )
    operations: dict[str, ExternalMode] | None = Field(default=None, description="the mode of operations by label")
    weight: float | None = Field(default=None, ge=0, description="of its travel: 1 counts like a joint of the arm")
    at_mm: float | None = Field(default=None, description="where it is locked, mm")
    at_deg: float | None = Field(default=None, description="the same of a joint that turns, degrees")
    at_operations_mm: dict[str, float] | None = Field(
        default=None, description="position in operations, by label, mm; the others as the mode says"
    )
    at_operations_deg: dict[str, float] | None = Field(
        default=None, description="the same of a joint that turns, degrees"
    )
    preferred_mm: float | None = Field(default=None, description="value whose neighbourhood is preferred, mm")
    preferred_deg: float | None = Field(default=None, description="the same of a joint that turns, degrees")
    range_mm: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[lowest, highest] to use of its range, mm"
    )
    range_deg: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="the same of a joint that turns, degrees"
    )

    @model_validator(mode="after")
    def _check_one_unit(self) -> ExternalJointOptionKeys:
        given = [k for k, v in self.model_dump(exclude_none=True).items() if k.endswith(("_mm", "_deg"))]
        if len({k.rsplit("_", 1)[1] for k in given}) > 1:
            raise ValueError(f"found {', '.join(given)}; a joint slides (mm) or turns (deg), not both")
        for key in ("range_mm", "range_deg"):
            value = getattr(self, key)
            if value is not None and not value[0] <= value[1]:
                raise ValueError(f"{key}: found {value}; expected [lowest, highest]")
        return self


class FixedKeys(StrictSchema):
    point: int = Field(ge=0, description="0-based index of a toolpath point")
    gamma_deg: float = Field(ge=-180, le=180, description="rotation about the tool axis")


class TiltKeys(StrictSchema):
    """Permitted tilt of a ball cutter, degrees."""

    lead: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[lowest, highest] towards the direction of travel"
    )
    side: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[lowest, highest] towards tool axis × travel"
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> TiltKeys:
        for key in ("lead", "side"):
            value = getattr(self, key)
            if value is not None and not -MAX_TILT_DEG <= value[0] <= value[1] <= MAX_TILT_DEG:
                raise ValueError(
                    f"{key}: found {value}; expected [lowest, highest] with "
                    f"-{MAX_TILT_DEG:g} ≤ lowest ≤ highest ≤ {MAX_TILT_DEG:g}"
                )
        return self


class OperationKeys(StrictSchema):
    """Options of one operation of the toolpath."""

    tilt_deg: TiltKeys | None = Field(default=None, description="permitted tilt of a ball cutter in this operation")


class OptionKeys(StrictSchema):
    """Every planning option under the user's name; None means not given."""

    machopt_plan: Literal[1] | None = Field(default=None, description="the format of a --plan file")
    method: PlanMethod | None = Field(
        default=None,
        description="global: choice over the whole path; joint: after it, rotation and feed together for the shortest "
        "time in tolerance; jiao2022: the method of that paper; default: the CAM file's own rotation",
    )
    index: StiffnessIndex | None = Field(
        default=None, description="what is made small; auto: deflection where force_N is given, else compliance"
    )
    objective: PlanObjectiveKind | None = Field(
        default=None,
        description="index: the weighted index; tolerance: fewest points out of the tolerances of process.yaml first",
    )
    force_N: ForceKeys | None = Field(default=None, description="process force on the tool")
    weights: WeightKeys | None = Field(default=None, description="of the terms of the objective")
    rotation_step_deg: float | None = Field(default=None, ge=0.5, le=90, description="degrees, 0.5 to 90")
    rotation_range_deg: list[float] | None = Field(
        default=None, min_length=2, max_length=2, description="[lowest, highest]"
    )
    preferred_rotation_deg: float | None = Field(
        default=None, ge=-180, le=180, description="gamma whose neighbourhood is preferred"
    )
    preferred_weight: float | None = Field(
        default=None, ge=0, description="price of a deviation of 180 degrees from it"
    )
    fixed: list[FixedKeys] | None = Field(default=None, description="rotations that are given at toolpath points")
    steer: list[SteerKeys] | None = Field(
        default=None, description="pins, forbidden zones, preferences and branches by operation or points"
    )
    singularity_wrist_deg: float | None = Field(
        default=None, ge=0, le=45, description="least angle between axes 4 and 6, degrees"
    )
    singularity_elbow_deg: float | None = Field(
        default=None, ge=0, le=45, description="least angle from the stretched or folded arm, degrees"
    )
    singularity_shoulder_mm: float | None = Field(
        default=None, ge=0, le=1000, description="least distance of the wrist from axis 1, mm"
    )
    limit_margin_deg: float | None = Field(default=None, ge=0, le=45, description="kept from the joint limits, degrees")
    min_stability_ratio: float | None = Field(
        default=None,
        gt=0,
        le=MAX_STABILITY_RATIO,
        description="least stable depth of cut over the planned depth, where milled; needs process.yaml with modes; "
        "left out: no limit",
    )
    clearance_full_mm: float | None = Field(
        default=None, gt=0, le=500, description="distance from which more gains nothing, for weights.clearance"
    )
    clearance_mm: float | None = Field(default=None, ge=0, le=500, description="kept between everything checked, mm")
    collision_step_deg: float | None = Field(
        default=None, ge=0.05, le=10, description="joint step between collision checks, degrees"
    )
    collision: bool | None = Field(default=None, description="false: no collision check; the result states it")
    gouge_tolerance_mm: float | None = Field(
        default=None,
        gt=0,
        le=50,
        description="workpiece.geometry is the finished part, and a cutter deeper in it than this at a feed gouges; "
        "left out: not checked",
    )
    advised_feed_share: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="share of the holes and points too fast for their tolerance that are driven at the advised feed, "
        "those slowed least first; left out: the feeds of the file",
    )
    sample_ms: float | None = Field(default=None, ge=0.5, le=100, description="step of trajectory.csv, ms")
    path_tolerance_mm: float | None = Field(
        default=None, gt=0, le=10, description="by which the motion may round corners, mm"
    )
    axis_tolerance_deg: float | None = Field(
        default=None, gt=0, le=10, description="the same of the tool axis, degrees"
    )
    approach_feed_mm_min: float | None = Field(
        default=None, gt=0, le=120_000, description="of approach, retract and link moves that carry no feed, mm/min"
    )
    rapid_scale: float | None = Field(
        default=None, gt=0, le=1, description="share of the joint velocity limits used in rapid moves"
    )
    rapid_blend_mm: float | None = Field(
        default=None,
        ge=0,
        le=500,
        description="by which the tool may pass a point where a corner between rapid moves is rounded, mm; 0: it stops",
    )
    limit_scale: float | None = Field(
        default=None, gt=0, le=1, description="share of the joint limits used while cutting"
    )
    allow_gaps: bool | None = Field(
        default=None, description="true: cuts to points out of reach are left out and listed"
    )
    max_reentries: int | None = Field(
        default=None,
        ge=0,
        le=8,
        description="lifts inside of closed contours, to enter again in another posture; each leaves a mark",
    )
    compensate: bool | None = Field(
        default=None, description="true: drive a path shifted against the deflection under force_N"
    )
    compensation_max_mm: float | None = Field(default=None, gt=0, le=50, description="a larger shift is refused, mm")
    seed: int | None = Field(default=None, ge=0, description="of the tree search for rapid moves")
    external: dict[str, ExternalJointOptionKeys] | None = Field(
        default=None, description="how the external joints are used, by name or e1, e2 … in the order of the cell"
    )

    tilt_deg: TiltKeys | None = Field(
        default=None, description="permitted tilt of the tool axis against that of the CAM file; ball cutters only"
    )
    operations: dict[str, OperationKeys] | None = Field(
        default=None, description="options of single operations by their label, which take precedence"
    )

    @field_validator("rotation_range_deg")
    @classmethod
    def _convert_range(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and not -180 <= value[0] < value[1] <= 180:
            raise ValueError(f"found {value}; expected [lowest, highest] with -180 ≤ lowest < highest ≤ 180")
        return value

    @field_validator("fixed")
    @classmethod
    def _convert_fixed(cls, value: list[FixedKeys] | None) -> list[FixedKeys] | None:
        points = [f.point for f in value or ()]
        twice = sorted({p for p in points if points.count(p) > 1})
        if twice:
            raise ValueError(f"point {twice[0]} is given twice; give each point one rotation")
        return value

    def given(self) -> dict[str, object]:
        """Only what the user wrote."""
        return self.model_dump(exclude_none=True, exclude={"machopt_plan"})
