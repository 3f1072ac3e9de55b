"""Cutting process of a job: operations, materials and tolerances, as process.yaml states them. SI units.

In: process.yaml, read by :mod:`machopt.cell.process_file`. Out: :mod:`machopt.process` computes forces from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Literal

from machopt.data_types.cutting_coefficients import DrillingCoefficients, MillingCoefficients
from machopt.data_types.plan_options import ProcessForce
from machopt.data_types.stock import StockBody

OperationKind = Literal["drilling", "countersinking", "reaming", "milling", "force"]
HOLE_KINDS = ("drilling", "countersinking", "reaming")
SpindleDirection = Literal["cw", "ccw"]
CutSide = Literal["up", "down", "slot"]
MachinedSurface = Literal["side", "floor", "table"]
ToleranceReference = Literal["absolute", "relative"]


@dataclass(frozen=True, kw_only=True)
class ToleranceLimits:
    """Limits ± of the errors at a point; inf: no limit."""

    position: float = inf  # m, distance of the hole's axis from nominal, across it
    axis: float = inf  # rad, angle of the hole's axis
    depth: float = inf  # m, along the axis at depth
    surface: float = inf  # m, along the surface normal
    reference: ToleranceReference = "absolute"

    @property
    def is_given(self) -> bool:
        """Whether any limit is given."""
        return min(self.position, self.axis, self.depth, self.surface) < inf


@dataclass(frozen=True)
class StackLayer:
    """Layer of a stack that is drilled."""

    material: str
    thickness: float  # m


@dataclass(frozen=True, kw_only=True)
class ProcessOperation:
    """Cutting conditions of one operation of the toolpath."""

    label: str  # as in the CAM file; "default": every other operation
    kind: OperationKind
    points: tuple[int, int] | None = None  # first and last toolpath point; None: the whole operation
    spindle_speed: float | None = None  # rev/s; None: that of the toolpath
    spindle: SpindleDirection = "cw"  # seen from the shank; cw is M3
    layers: tuple[StackLayer, ...] = ()  # of a hole, from the surface on
    material: str = ""  # of a milled part
    depth: float | None = None  # m, surface to the deepest tip; None: that of the file's cycle
    pilot: float = 0.0  # m, diameter
    countersink: float | None = None  # m, diameter
    countersink_angle: float | None = None  # rad, included
    reaming_stock: float | None = None  # m, on the diameter
    clamp: float = 0.0  # N, of the pressure foot
    foot_friction: float | None = None  # coefficient, for the warning of a skid
    wear: tuple[float, float] = (1.0, 1.0)  # factor of the force, lowest and highest
    scatter: float = 0.0  # 1 sigma of the logarithm, from hole to hole
    spread: float | None = None  # 1 sigma of the logarithm of a given force
    ae: float | None = None  # m, radial depth of cut
    ap: float | None = None  # m, axial depth of cut
    cut: CutSide | None = None
    is_alternating: bool = False  # passes that reverse change between up and down
    takes_stock: bool = False  # ae, ap and side of each point come from the stock
    surface: MachinedSurface = "side"
    force: ProcessForce | None = None  # given force
    rake: float = 0.0  # deg, of the drill's lips
    tolerance: ToleranceLimits = field(default_factory=ToleranceLimits)

    @property
    def is_hole(self) -> bool:
        """Whether the operation makes holes along the tool axis: by its kind, or a given force with limits of holes."""
        limits = self.tolerance
        is_point_operation = self.kind == "force" and min(limits.position, limits.axis, limits.depth) < inf
        return self.kind in HOLE_KINDS or is_point_operation


@dataclass(frozen=True, kw_only=True)
class CuttingMaterial:
    """Cutting-force coefficients of one material."""

    name: str
    milling: MillingCoefficients | None = None
    drilling: DrillingCoefficients | None = None
    has_milling_spread: bool = True  # False: the file states none; the coefficients carry 0
    has_drilling_spread: bool = True
    accepts_unusual: bool = False  # a negative coefficient, or Krc above Ktc, is meant


@dataclass(frozen=True, kw_only=True)
class ModeDamping:
    """Damping ratios of the arm's modes in ascending frequency; one value holds for all."""

    ratios: tuple[float, ...]
    source: str = ""

    def get_ratio(self, mode: int) -> float | None:
        """Return the damping ratio of a mode, None where none is stated.

        Args:
            mode: 0-based number of the mode in ascending frequency.
        """
        if len(self.ratios) == 1:
            return self.ratios[0]
        return self.ratios[mode] if mode < len(self.ratios) else None


@dataclass(frozen=True, kw_only=True)
class CuttingProcess:
    """Content of process.yaml."""

    operations: tuple[ProcessOperation, ...]
    materials: Mapping[str, CuttingMaterial] = field(default_factory=dict)
    quantile: float = 0.95  # probability that "pass" needs
    damping: ModeDamping | None = None
    stock: StockBody | None = None  # the part before machining, where an operation takes its engagement from it
    has_unused_stock: bool = False  # a stock is named, and no operation takes its engagement from it
    file: Path | None = field(default=None, compare=False)


@dataclass(frozen=True, kw_only=True)
class ArmAccuracy:
    """Accuracy of the arm, 1 sigma a coordinate; NaN where it is not stated."""

    absolute: float = float("nan")  # m
    absolute_angle: float = float("nan")  # rad
    repeatability: float = float("nan")  # m
    lost_motion: tuple[float, ...] = ()  # rad, full width per joint
    includes_lost_motion: bool = True  # the numbers above contain it
    source: str = ""
