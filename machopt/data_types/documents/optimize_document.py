"""result.json of ``machopt optimize``."""

from __future__ import annotations

from machopt.data_types.documents.document_base import (
    Count,
    DocumentModel,
    First,
    Flag,
    Hashes,
    Known,
    Number,
    Numbers,
    Settings,
    Text,
)
from machopt.data_types.documents.process_entries import ProcessSection
from machopt.data_types.documents.program_entries import RobotProgramEntry
from machopt.data_types.documents.verification_entries import VerificationSection


class IgnoredWordEntry(DocumentModel):
    """A word of the CAM file without effect."""

    word: Text
    count: Count
    first_line: Count
    understood: Flag
    stops: Flag = False  # it may move points or frames: no plan is made unless --accept-unknown names it


class ToolpathSection(DocumentModel):
    """What was read."""

    source: Text
    format: Text
    points: Count
    cutting_points: Count
    operations: tuple[Text, ...]
    ignored: tuple[IgnoredWordEntry, ...]


class ObjectivePartsSection(DocumentModel):
    """J and its parts, dimensionless; times ``index_scale``, mean and worst are the index's own.

    ``index_scale`` is the median over the candidates of this run: totals of runs with other grids are on other scales.
    """

    total: Known
    mean: Known
    worst: Known
    travel: Known
    rotation: Known
    feed: Known
    preferred: Known
    clearance: Known
    tolerance: Known = 0.0  # price of the points out of tolerance, with `objective: tolerance`
    stability: Known = 0.0  # weights.stability times the mean shortfall of the stable depth of cut
    rapid: Known = 0.0  # time of the rapid moves as a share of that of the job
    reorientation: Known = 0.0  # branch changes and whole turns in rapid moves, times the lowest J the index permits


class ChoiceObjectiveSection(ObjectivePartsSection):
    """The same of a choice that need not be feasible throughout."""

    feasible_share: Number


class ValueStepEntry(DocumentModel):
    """Largest distance of neighbouring values of one external joint in the grid of the bound."""

    joint: Text
    step: Number
    unit: Text  # mm or deg


class ExternalSearchBoundSection(DocumentModel):
    """How good the plan is at least when the values of the external joints are free too.

    Over all sequences of a grid of values (and the plan's own), rotations and branches at some stations; ``plan`` is
    the plan's J there. The figures are null where there is no bound, and ``why_none`` says why. ``gap_percent`` is
    null where ``plan`` is below ``lower_bound``, too: the plan lies between grid values, where no bound applies.
    The bound holds for the grid alone, whose values are up to ``values_apart`` from each other: it proves nothing about
    plans between them. It counts index, travel, rotation and velocities; the other terms of J are never negative.
    """

    why_none: Text
    values: Count
    stations: Count
    rotation_step_deg: Known
    sequence: Known
    lower_bound: Known
    plan: Known
    gap_percent: Known
    values_apart: tuple[ValueStepEntry, ...] = ()


class SearchBoundSection(DocumentModel):
    """How good the plan is at least, against the grid of rotations, with the external joints as chosen."""

    sequence: Number
    lower_bound: Number
    gap_percent: Number
    beyond_grid_percent: Number
    plan_above_bound_percent: Known = None  # of the driven curve at all points; the gap holds at the stations alone
    external: ExternalSearchBoundSection | None = None  # None: no external joint was free


class MeanGainEntry(DocumentModel):
    """How much less the mean index is than a yardstick's; null where unknown."""

    over: Text
    mean_percent: Known
    std_percent: Known
    ci90: tuple[Known, Known] | None
    distinguishable: Flag | None


class ObjectivesSection(DocumentModel):
    """Yardsticks, the best of the grid and what was chosen."""

    cam_default: ChoiceObjectiveSection
    jiao2022: ChoiceObjectiveSection
    grid: ObjectivePartsSection
    search: SearchBoundSection | None
    chosen: ChoiceObjectiveSection
    gain: tuple[MeanGainEntry, ...]


class ParetoPlanEntry(DocumentModel):
    """A whole plan of the trade-off."""

    plan: Text
    changed: Text
    mean_index: Known
    worst_index: Known
    cycle_time_s: Number
    joint_travel_deg: Number
    clearance_mm: Known
    in_tolerance: Count | None = None  # holes and points that pass; null where nothing has a tolerance
    marginal: Count | None = None
    fail: Count | None = None
    unknown: Count | None = None
    mean_error_mm: Known = None  # nominal, of holes and points with a tolerance, at the driven feed
    worst_error_mm: Known = None
    least_stability_ratio: Known = None  # stable depth of cut over the planned one, at most 10; null: not known
    posture_changes: Count = 0  # branch changes and whole turns in rapid moves
    objective: Known
    dominated: Flag


class WorstPointSection(DocumentModel):
    """The softest point that is cut to."""

    point: Count
    k_axial_N_mm: Known
    k_normal_N_mm: Known
    deflection_mm: Known
    deflection_ci90_mm: tuple[Number, Number] | None  # intervals: null where no uncertainty of the springs is known
    deflection_along_mm: Known  # along the tool axis, + towards the shank
    deflection_along_ci90_mm: tuple[Number, Number] | None
    deflection_across_mm: Known
    deflection_across_ci90_mm: tuple[Number, Number] | None
    gamma_deg: Number
    k_jiao_x_N_mm: Known
    q_deg: Numbers


class RemovedDeflectionEntry(DocumentModel):
    """How much of the mean deflection a compensation removes; intervals null where no uncertainty is known."""

    operation: Text
    removed_percent: Number
    removed_ci90_percent: tuple[Number, Number] | None
    residual_mean_mm: Number
    residual_mean_ci90_mm: tuple[Number, Number] | None
    residual_max_mm: Number
    residual_max_ci90_mm: tuple[Number, Number] | None


class PositionErrorSection(DocumentModel):
    """How far the TCP is from where the plan says, 1 sigma of a coordinate, by measured poses; nothing counts it in."""

    std_mm: Number
    beyond_mm: Number  # outside the angles of the poses
    outside_percent: Number  # of the cutting points
    outside_joints: tuple[Count, ...]
    corrected: Flag  # the kinematics that was found with it is in use
    noise_mm: Number
    poses: Count


class CompensationSection(DocumentModel):
    """The shift and what it is predicted to leave: by the model, and with what is known of the model's error."""

    length_mm: Known  # over which the shift turns at a corner; the longest of the tools
    fade_mm: Known = None  # over which it fades in and out; the longest of the tools
    max_mm: Number
    mean_mm: Number
    uncompensated_mean_mm: Number
    residual_max_mm: Number
    residual_mean_mm: Number
    removed: RemovedDeflectionEntry | None
    operations: tuple[RemovedDeflectionEntry, ...]


class TiltBoundEntry(DocumentModel):
    """Lower bounds in units of ``index_scale``: the best vertex of each station over a grid, without motion."""

    mean: Number  # over the length cut
    worst: Number
    stations: Count
    tilts: Count
    rotation_step_deg: Number


class TiltSection(DocumentModel):
    """Tilt of the tool against the axis of the CAM file at the cut points, lowest and highest."""

    lead_deg: tuple[Number, Number]
    side_deg: tuple[Number, Number]
    bound: TiltBoundEntry | None


class JointWindowEntry(DocumentModel):
    """One window of the joint optimisation of posture and feed."""

    window: Text
    nodes: Count
    accepted: bool
    reason: Text  # why its result is not driven; empty where it is
    run_before_s: Known  # duration of its run at the advised feeds; null where it cannot be driven
    run_after_s: Known


class JointMethodEntry(DocumentModel):
    """Method joint for one tool: cycle times at the advised feeds of either posture, under the feeds of the file."""

    accepted: bool  # false: the path of the plan is driven, at its own advised feeds
    reason: Text  # why it is not accepted; empty where it is
    fixed_path_s: Known
    joint_s: Known
    windows: tuple[JointWindowEntry, ...]


class ReentryEntry(DocumentModel):
    """Lifts inside of closed contours of one tool (max_reentries); changes are relative to the plan without them."""

    points: tuple[Count, ...]  # toolpath points at which the tool is lifted and enters again
    reason: Text  # why there are fewer than permitted; empty where there are not
    objective_without: Known  # J of the plan without, before corners are rounded
    objective: Known  # J of the motion
    mean_percent: Known  # change of the mean index
    worst_percent: Known  # change of the worst index


class BestStabilityEntry(DocumentModel):
    """The most stable configuration within limits and margins; collisions are not considered."""

    ratio: Known  # stable depth of cut over the planned one; null without a limit
    gamma_deg: Number


class InfeasiblePointEntry(DocumentModel):
    """A point without a configuration."""

    point: Count
    status: Text
    reason: Text
    help: Text
    best_stability: BestStabilityEntry | None = None  # where min_stability_ratio excludes configurations


class MotionBreakEntry(DocumentModel):
    """Two places that no motion joins; null means home, and numbers that do not apply."""

    from_point: Known
    to_point: Known
    code: Text
    reason: Text
    help: Text
    joint: Count | None
    value_deg: Known
    limit_deg: Known
    pair: Text | None


class FeedDipEntry(DocumentModel):
    """A stretch below the programmed feed."""

    first_point: Known
    last_point: Known
    lowest_ratio: Number
    where: Text
    axis: Count
    limit: Text


class ObstructedRapidEntry(DocumentModel):
    """A rapid move that was not found."""

    before: Known
    after: Known
    reason: Text


class ToolSegmentEntry(DocumentModel):
    """A stretch of the job with one tool on, in the order of the job."""

    tool: Text
    first_point: Count
    last_point: Count
    operations: tuple[Text, ...]
    mean_index: Known  # over the length it cuts, in SI; null without cuts or where points are missing
    worst_index: Known


class OptimizeDocument(DocumentModel):
    """The whole file."""

    machopt_result: First
    version: Text
    verdict: Text
    exit_code: Count
    production_blockers: tuple[Text, ...]  # what has to be settled before the part is made, the gravest first
    unchecked: tuple[Text, ...]
    inputs: Hashes
    outputs: Hashes
    options: Settings
    reading: Settings
    cell: Text
    toolpath: ToolpathSection
    index: Text
    index_scale: Known
    chosen_from: Text
    objective: ObjectivesSection
    front: tuple[ParetoPlanEntry, ...] | None
    tools: tuple[ToolSegmentEntry, ...] | None  # where the job changes tools
    worst_point: WorstPointSection | None
    compensation: CompensationSection | None
    tilt: TiltSection | None = None  # null where the tool axis is that of the CAM file; older results have no such key
    joint: tuple[JointMethodEntry, ...] | None = None  # one a tool; null with another method
    reentry: tuple[ReentryEntry, ...] | None = None  # one a tool; null where max_reentries is 0
    position_error: PositionErrorSection | None  # null where the stiffness comes without measured poses
    process: ProcessSection | None  # null where no process is stated
    infeasible_points: tuple[InfeasiblePointEntry, ...]
    breaks: tuple[MotionBreakEntry, ...]
    cycle_time_s: Known
    dwell_s: Known  # of it, what the file waits at the points that are driven and before the first
    feed_held_share: Known
    feed_dips: tuple[FeedDipEntry, ...]  # where the axes do not hold the feed
    feed_stops: tuple[FeedDipEntry, ...]  # ramps from and to stops that the path demands: no lost feed
    rapid_detours: tuple[Text, ...]
    obstructions: tuple[ObstructedRapidEntry, ...]
    verification: VerificationSection | None
    programs: tuple[RobotProgramEntry, ...]
    notes: tuple[Text, ...]
    warnings: tuple[Text, ...]
    timings_s: dict[Text, Number]
