"""Data of the optimize report: plain arrays in SI, every part optional except the summary, for any outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.documents.optimize_document import JointMethodEntry
from machopt.data_types.toolpath import IgnoredWord, ToolpathEvent
from machopt.numerics.array_types import Array
from machopt.report.scene.scene_types import OptimizeScene

Quantity = Literal["deflection", "stiffness", "index"]
"""What is optimised: deflection in m (small is good), stiffness in N/m or a bare index (large is good)."""

STATUS_NAMES = (
    "feasible",
    "unreachable",
    "joint limit",
    "wrist singularity",
    "elbow singularity",
    "shoulder singularity",
    "collision",
    "not checked",
    "excluded by the rotation range, a pin or a zone",
    "below min_stability_ratio",
)
"""Meaning of the codes in :attr:`RotationMap.status`, by
:class:`machopt.report.page_types.map_sample_states.PlaceCode`."""


@dataclass(frozen=True)
class GainOverBaseline:
    """Gain of the mean along the path over a baseline."""

    baseline: str  # e.g. "Jiao 2022"
    share: float  # 1 − mean/mean of it, of deflection or compliance; negative: worse; NaN where that is not feasible
    std: float = float("nan")  # 1 sigma of ``share`` from the stiffness's own uncertainty, NaN where it is not known
    interval: tuple[float, float] = (float("nan"), float("nan"))  # 90 %
    distinguishable: bool = True  # False: the interval holds zero


@dataclass(frozen=True, kw_only=True)
class ShiftSummary:
    """The commanded path against the programmed one, where the predicted deflection is compensated."""

    worst: float  # m
    mean: float  # m, over the length cut
    left_worst: float  # m, predicted distance of the bent tool from the programmed path
    left_mean: float  # m
    left_worst90: tuple[float, float] | None = None  # m, 90 % intervals; None where the stiffness's error is unknown
    left_mean90: tuple[float, float] | None = None
    removed90: tuple[float, float] | None = None  # share of the mean deflection


@dataclass(frozen=True, kw_only=True)
class BoundCertificate:
    """Bound of the distance from the optimum; values of the objective."""

    objective: float
    bound: float  # no sequence over the grid has less
    gap: float  # share that a better sequence over the grid could save at most
    beyond: float  # share saved by leaving the grid; negative: lost
    above: float = 0.0  # share by which the driven curve is above the bound; negative: below
    external: str = ""  # what holds over the values of the external joints, in words


@dataclass(frozen=True, kw_only=True)
class TradeOffPoint:
    """One complete plan of the trade-off front."""

    name: str
    changed: str  # against the options in force
    mean: float  # mm, or mm/N where no force is given
    worst: float
    cycle: float  # s
    travel: float  # deg, of all axes together
    clearance: float | None  # mm, least at the points
    dominated: bool
    in_tolerance: int | None = None  # holes and points that pass
    others: tuple[int, int, int] | None = None  # marginal, fail, unknown
    mean_error: float | None = None  # mm, nominal, of holes and points with a tolerance
    worst_error: float | None = None
    least_stability: float | None = None  # stable depth of cut over the planned one
    changes: int = 0  # branch changes and whole turns in rapid moves


@dataclass(frozen=True, kw_only=True)
class ResultSummary:
    """Summary of gain and safety; NaN for what was not computed."""

    outcome: Literal["done", "infeasible", "verification_failed"]
    verification: Literal["passed", "failed", "not run"]
    quantity: Quantity
    worst_default: float  # at the worst point, with the CAM's default rotation
    worst_jiao2022: float  # with the source paper's method
    worst_chosen: float
    mean_default: float  # mean over the length cut; of a stiffness: the stiffness of the mean compliance
    mean_chosen: float
    worst_parts: str = ""  # the deflection at the worst point along and across the tool axis, with intervals, in words
    gains: tuple[GainOverBaseline, ...] = ()  # of the mean, over each baseline
    shift: ShiftSummary | None = None
    certificate: BoundCertificate | None = None
    feed_held: float = float("nan")  # share 0…1 of the cutting time at the programmed feed
    cycle_time: float = float("nan")  # s
    cutting_time: float = float("nan")  # s
    path_length: float = float("nan")  # m
    points: int = 0
    infeasible_points: int = 0
    nearest_miss: float = float("nan")  # m
    nearest_pair: str = ""  # e.g. "link5 – fixture"
    nearest_point: int = -1
    misfit: str = ""  # a sentence where the stiffness is known to miss its own readings
    note: str = ""  # one further sentence for the verdict
    unchecked: tuple[str, ...] = ()  # what was switched off or left out, in the words of the verdict
    blockers: tuple[str, ...] = ()  # what has to be settled before the part is made, the gravest first


@dataclass(frozen=True, kw_only=True)
class RotationMap:
    """The index over path length and rotation about the tool axis, with the lines drawn on it."""

    s: Array  # (N,) m, path length of the station, not falling
    point: Array  # (N,) toolpath point of the station
    rotation: Array  # (R,) rad, rising, uniform
    index: Array  # (N, R) in the unit of the summary's quantity, NaN where there is none
    status: NDArray[np.uint8]  # (N, R) codes of STATUS_NAMES
    chosen: Array  # (N,) rad, NaN where there is none
    jiao2022: Array  # (N,) rad
    cam_default: Array  # (N,) rad
    offset: Array | None = None  # (N,) rad, γ − φ
    collisions: str = ""  # how much of it was checked for collisions, one sentence
    before: Array | None = None  # (N,) rad, the chosen line of the plan that this one is compared with


@dataclass(frozen=True, kw_only=True)
class PathSeries:
    """Values along the toolpath, one entry a point; NaN where unknown."""

    s: Array  # (N,) m
    operation: NDArray[np.int32]  # (N,) index into ReportData.operations, −1 for none
    cutting: NDArray[np.bool_]  # (N,)
    index_default: Array  # (N,) in the summary's quantity
    index_jiao2022: Array  # (N,)
    index_chosen: Array  # (N,)
    k_axial: Array  # (N,) N/m at the tip
    k_normal: Array  # (N,) N/m
    k_jiao2022: Array  # (N,) N/m, K_fd along the tool axis
    deflection: Array  # (N,) m
    tolerance: Array  # (N,) m
    clearance: Array  # (N,) m
    nearest_pair: tuple[str, ...]  # (N,)
    singularity: Array  # (N,) rad
    limit_margin: Array  # (N,) rad
    shift: Array | None = None  # (N, 3) m in workpiece, added to the commanded path
    phi: Array | None = None  # (N,) rad, the chosen rotation from the carried reference
    gamma: Array | None = None  # (N,) rad, the same from the direction of travel


@dataclass(frozen=True, kw_only=True)
class MotionSeries:
    """The exported samples, arm joints first, then external axes."""

    time: Array  # (S,) s
    s: Array  # (S,) m along the toolpath, NaN outside
    q: Array  # (S, J) rad or m
    velocity_ratio: Array  # (S, J) |dq/dt| over its limit
    joint_names: tuple[str, ...]  # (J,)
    prismatic: tuple[bool, ...]  # (J,)
    lower: Array  # (J,)
    upper: Array  # (J,)
    feed_programmed: Array  # (S,) m/s, NaN in rapid moves
    feed_actual: Array  # (S,) m/s
    cutting: NDArray[np.bool_]  # (S,)
    acceleration_ratio: Array | None = None  # (S, J)
    jerk_ratio: Array | None = None  # (S, J)


@dataclass(frozen=True, kw_only=True)
class FeedDipRow:
    """A stretch where the programmed feed could not be held."""

    point: float
    s: float  # m
    time: float  # s, when it begins
    duration: float  # s
    feed_programmed: float  # m/s
    feed_lowest: float  # m/s
    cause: str  # e.g. "a4 acceleration"


@dataclass(frozen=True, kw_only=True)
class WorstPointRow:
    """One of the points that decide the result."""

    point: int
    operation: str
    value: float  # in the summary's quantity
    value_default: float
    gamma: float  # rad
    phi: float  # rad
    deflection: float  # m
    tolerance: float  # m
    k_axial: float  # N/m
    clearance: float  # m
    reason: str  # e.g. "arm stretched; joint 2 carries 61 % of the deflection"
    deflection_std: float = float("nan")  # m, 1 sigma from the stiffness's own uncertainty


@dataclass(frozen=True, kw_only=True)
class InfeasiblePointRow:
    """Infeasible point with the reason and the missing distance."""

    point: int
    operation: str
    position: Array  # (3,) m in workpiece
    status: str
    reason: str
    shortfall: str  # e.g. "38 mm out of reach"
    help: str = ""  # what would help


@dataclass(frozen=True)
class MotionBreak:
    """Two successive places without a motion between them."""

    before: str  # "point 3", "home"
    after: str
    reason: str
    help: str


@dataclass(frozen=True, kw_only=True)
class OperationRow:
    """One operation of the toolpath."""

    label: str
    kind: str  # "point" or "trajectory"
    points: int
    length: float  # m
    time: float  # s
    worst_default: float  # in the summary's quantity
    worst_chosen: float
    nearest_miss: float  # m
    feed_held: float  # share 0…1
    status: str = "ok"
    tool: str = ""  # which is on; empty where the job has one


@dataclass(frozen=True)
class CheckRow:
    """One line of the verification; ``passed`` is None where it could not be run."""

    name: str
    passed: bool | None
    found: str
    allowed: str
    where: str = ""


@dataclass(frozen=True)
class InformationRow:
    """Measured value without a condition."""

    name: str
    found: str
    where: str = ""


@dataclass(frozen=True, kw_only=True)
class ProgramRow:
    """One written robot program with its read-back result; NaN for what a format does not state."""

    post: str
    files: tuple[str, ...]  # relative to the page, the one that is run first
    lines: int
    added: int  # moves put in to keep to the tolerance
    tolerance: float  # m, allowed between the controller's lines and the motion
    moves: int = 0
    position_error: float = float("nan")  # m, largest over all targets
    angle_error: float = float("nan")  # rad
    joint_error: float = float("nan")  # rad, of joint targets
    feed_error: float = float("nan")  # m/s
    path_error: float = float("nan")  # m, between the motion and the lines the controller draws
    axis_error: float = float("nan")  # rad, the same between tool axes
    turn_error: float = float("nan")  # rad, the same between orientations
    configuration_equal: bool | None = None  # None: its targets have none
    events_equal: bool = True
    differences: tuple[str, ...] = ()  # what is not as it should be, in words
    checked: bool = True  # False: no reader here knows its language
    withheld: str = ""  # why none of its files is left
    assumed: tuple[str, ...] = ()  # of the controller, because the cell does not say it
    unstarted: tuple[str, ...] = ()  # words of the CAM file that are comments in it
    feed_mean: float = float("nan")  # share of the programmed feed held by the controller's model; NaN for streams
    feed_lowest: float = float("nan")  # the same of the slowest cutting move
    feed_deviation: float = float("nan")  # m by which rounded corners pass their points


@dataclass(frozen=True)
class ExcludedPairRow:
    """Pair of bodies that is not checked, with the reason."""

    first: str
    second: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class TolerancePointRow:
    """A hole or milled point with a tolerance."""

    number: int  # from 1, in the order of the job
    point: int  # toolpath point
    operation: str
    outcome: str
    probability: float  # NaN where it is not known
    deflection_only: bool  # the probability is that of the deflection alone
    errors: tuple[tuple[str, float, float, float], ...]  # name, nominal, 5 %, 95 %; m, or rad of the axis
    tolerance: str
    cause: str


@dataclass(frozen=True, kw_only=True)
class ToleranceSeries:
    """Error and force along the path, N toolpath points, SI."""

    error: Array  # (N,) across holes, normal to surfaces
    lower: Array  # (N,)
    upper: Array  # (N,)
    limit: Array  # (N,) ±
    force: Array  # (N, 3) N along travel, normal, axis


@dataclass(frozen=True)
class StabilityMap:
    """Stable depth of cut over the planned depth: S places along the path, R rotations."""

    s: Array  # (S,) m
    rotation: Array  # (R,) rad
    ratio: Array  # (S, R) inf: no limit; NaN: no posture
    chosen: Array  # (S,) rad, NaN where there is none
    least: float | None = None  # min_stability_ratio; None: not requested


@dataclass(frozen=True, kw_only=True)
class ToleranceData:
    """Tolerances of the job."""

    headline: str
    counts: tuple[tuple[str, int, int, int], ...]  # outcome; CAM default, Jiao 2022, chosen
    operations: tuple[tuple[str, str, str, str, str], ...]  # label, limits, reference, outcomes, worst
    rows: tuple[TolerancePointRow, ...]  # worst first
    hidden: int  # rows left out of the table
    shares: tuple[tuple[str, float], ...]  # source of variance, share
    sources: tuple[tuple[str, str], ...]
    validity: tuple[str, ...]
    series: ToleranceSeries | None = None
    stability: StabilityMap | None = None
    stability_words: str = ""
    stock: tuple[tuple[str, str], ...] = ()  # what the job does to its stock


@dataclass(frozen=True, kw_only=True)
class ReportData:
    """All data of the optimize report."""

    title: str
    cell: str
    toolpath: str
    version: str
    summary: ResultSummary
    hashes: tuple[tuple[str, str], ...] = ()  # file, sha256
    options: tuple[tuple[str, str], ...] = ()
    map: RotationMap | None = None
    view: OptimizeScene | None = None
    path: PathSeries | None = None
    motion: MotionSeries | None = None
    dips: tuple[FeedDipRow, ...] = ()
    feed_stops: tuple[tuple[str, int], ...] = ()  # ramps from and to stops that the path demands: where, how many
    worst: tuple[WorstPointRow, ...] = ()
    infeasible: tuple[InfeasiblePointRow, ...] = ()
    breaks: tuple[MotionBreak, ...] = ()
    operations: tuple[OperationRow, ...] = ()
    ignored: tuple[IgnoredWord, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # what the cell's files hold and nothing uses
    excluded_pairs: tuple[ExcludedPairRow, ...] = ()
    adjacent_pairs: tuple[ExcludedPairRow, ...] = ()  # of links next to each other, which no check compares
    checks: tuple[CheckRow, ...] = ()
    information: tuple[InformationRow, ...] = ()
    programs: tuple[ProgramRow, ...] = ()
    front: tuple[TradeOffPoint, ...] = ()
    joint_method: tuple[JointMethodEntry, ...] = ()  # one a tool
    timings: tuple[tuple[str, float], ...] = ()  # stage, s
    events: tuple[ToolpathEvent, ...] = ()
    tolerances: ToleranceData | None = None
    created: str = ""  # date as text; left empty the page is byte for byte reproducible
