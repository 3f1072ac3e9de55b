"""Data shared by all channels of a motion: samples, dynamics, and the transformation of a law's signal to columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypedDict, Unpack

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import format_joint_location
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.dynamics.rigid_body import RigidBodyDynamics
from machopt.kinematics.encoder_corrections import EncoderCorrection
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    Channel,
    CoordinateFamily,
    Correction,
    DiagnosisProblem,
    EffectHypothesis,
    Ints,
    LawCurve,
    Quantities,
    Shape,
    ShapeRefinement,
    UntestableEffect,
)
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import build_ratio_refinement
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array

ARCMIN, ARCSEC = np.pi / 10800.0, np.pi / 648000.0


@dataclass(frozen=True, kw_only=True)
class MotionModel:
    """Recorded motion with all quantities computed once at the sampling rate, SI."""

    recording: Recording
    cell: Cell
    motion: MotionSignals
    dynamics: RigidBodyDynamics | None  # None: the URDF has no inertias
    predicted: Array | None  # (M, n) N·m rigid-body torque
    dimensions: int  # D of the problem
    lift: Callable[[int, Array], Array]  # joint index and (M, p) signal → (N, D, p) columns
    prismatic: tuple[bool, ...]
    scale: Array | None = None  # (D,) of the problem's coordinates; None: 1
    known_terms: tuple[StiffnessTerm, ...] = ()  # of the cell's stiffness
    correction: EncoderCorrection | None = None  # of the cell's kinematics: encoder angles → true angles
    free_gains: bool = False  # torques are converted currents; a gain of each joint is refitted
    joints_without_gain: frozenset[int] = frozenset()  # joints (0-based) with an undetermined torque constant
    notes: list[str] = field(default_factory=list)
    untestable: list[UntestableEffect] = field(default_factory=list)

    @property
    def segment_start(self) -> Ints:
        """Flags (M,): 1 where a segment begins."""
        return np.asarray(np.diff(self.motion.segment, prepend=self.motion.segment[0] - 1) != 0, np.int64)

    @property
    def time_step(self) -> Array:
        """Time (M,) s since the sample before; the sampling interval at the start of a segment."""
        out = np.diff(self.motion.time, prepend=self.motion.time[0])
        out[self.segment_start > 0] = 1.0 / self.motion.rate
        return out

    @property
    def joints(self) -> int:
        return int(self.motion.q.shape[1])

    def true_angles(self, q: Array) -> Array:
        """Convert encoder (or commanded) angles to true joint angles without load.

        Args:
            q: (M, n) encoder or commanded angles, rad.

        Returns:
            (M, n) rad.
        """
        return q if self.correction is None else self.correction.compute_true_angles(q)

    def column(self, joint: int, x: Array) -> Array:
        """Transform the signal of one joint to columns of the problem.

        Args:
            joint: Joint index, 0-based.
            x: (M,) or (M, p) signal.

        Returns:
            (N, D, p).
        """
        return self.lift(joint, x[:, None] if x.ndim == 1 else x)

    def problem(
        self, channel: Channel, y: Array, base: Array, unknowns: Sequence[BaseUnknown], family: CoordinateFamily
    ) -> DiagnosisProblem:
        """Build the problem of a channel with the cross-validation labels of the motion.

        Args:
            channel: Name of the channel.
            y: (N, D) measured minus predicted, m, rad or N·m.
            base: (N, D, P) columns per unit of each unknown.
            unknowns: The P unknowns.
            family: Coordinate family, common to all coordinates.

        Returns:
            The problem.
        """
        m = self.motion
        return DiagnosisProblem(
            channel=channel,
            y=y,
            base=base,
            unknowns=tuple(unknowns),
            families=(family,),
            group=m.group,
            visit=m.visit,
            cycle=m.cycle,
            session=m.select_block_labels(m.session),
            replicate=m.replicate,
            line=m.select_block_labels(self.recording.line[m.index]),
            row=m.select_block_labels(m.index) + 1,
        )

    def average_coordinates(self, x: Array) -> Array:
        """Average signals of all coordinates over blocks of samples.

        Args:
            x: (M, D, p) or (M, D) signals.

        Returns:
            (N, D, p) or (N, D).
        """
        part = self.motion.subtract_period_mean(self.motion.average_blocks(x))
        if self.scale is None:
            return part
        return part * (self.scale if x.ndim == 2 else self.scale[:, None])

    def is_joint_moving(self, joint: int) -> bool:
        """Return whether a joint moves.

        Args:
            joint: Joint index, 0-based.

        Returns:
            True if its range exceeds the threshold.
        """
        return bool(np.ptp(self.motion.q[:, joint]) > thresholds.LIMITS.joint_motion)


class ExplainedPower:
    """Power of a problem that columns explain after the base was projected out; equal weight for all coordinates."""

    def __init__(self, y: Array, base: Array, weight: Array) -> None:
        self.weight = weight
        B = (base * weight[:, None]).reshape(-1, base.shape[2])
        size = np.linalg.norm(B, axis=0)
        self.Q, _ = np.linalg.qr(B[:, size > 0] / size[size > 0])
        self.remaining = self._project_out_base((y * weight).reshape(-1))
        self.power = float(self.remaining @ self.remaining)

    def _project_out_base(self, x: Array) -> Array:
        return np.asarray(x - self.Q @ (self.Q.T @ x))

    def compute_remaining_share(self, column: Array) -> float:
        """Compute the share of columns that the base cannot reproduce.

        Args:
            column: (N, D, p) columns.

        Returns:
            Ratio of norms, 0 to 1.
        """
        flat = (column * self.weight[:, None]).reshape(-1, column.shape[2])
        left = np.stack([self._project_out_base(x) for x in flat.T], axis=1)
        return float(np.linalg.norm(left) / max(np.linalg.norm(flat), np.finfo(float).tiny))

    def misfit(self, change: Array) -> float:
        """Compute the residual power after subtraction of a fixed signal.

        Args:
            change: (N, D) signal.

        Returns:
            Weighted sum of squares.
        """
        left = self.remaining - self._project_out_base((change * self.weight).reshape(-1))
        return float(left @ left)

    def gain(self, column: Array) -> float:
        """Compute the power that a column explains with its best coefficient.

        Args:
            column: (N, D, 1) column.

        Returns:
            Reduction of the weighted sum of squares.
        """
        x = self._project_out_base((column[:, :, 0] * self.weight).reshape(-1))
        power = float(x @ x)
        return float(x @ self.remaining) ** 2 / power if power > 0 else 0.0


def build_joint_selector(
    motion: MotionSignals, dimensions: int, joints: list[int] | None = None, scale: Array | None = None
) -> Callable[[int, Array], Array]:
    """Build the transformation for channels with one coordinate per joint: joint torques, secondary encoders.

    Args:
        motion: Motion signals.
        dimensions: Number of coordinates D.
        joints: Joint of each coordinate; None: joint i is coordinate i.
        scale: (D,) scale of the coordinates; None: 1.

    Returns:
        Function from joint index and (M, p) signal to (N, D, p) columns.
    """

    def lift(joint: int, x: Array) -> Array:
        part = motion.subtract_period_mean(motion.average_blocks(x))
        out = np.zeros((len(part), dimensions, x.shape[1]))
        at = joint if joints is None else joints.index(joint)
        out[:, at] = part if scale is None else part * scale[at]
        return out

    return lift


def cache_columns(columns: Callable[[Shape], Array]) -> Callable[[Shape], Array]:
    """Cache the columns of each shape, because a search evaluates them several times.

    Args:
        columns: Function from a shape to columns (N, D, p).

    Returns:
        The cached function.
    """
    known: dict[Shape, tuple[Ints, Array, tuple[int, ...]]] = {}

    def of(shape: Shape) -> Array:
        if shape not in known:
            whole = columns(shape)
            moved = np.flatnonzero(np.any(whole.any(axis=0), axis=1))  # reducing both axes at once is five times slower
            known[shape] = moved, whole[:, moved], whole.shape
        moved, part, size = known[shape]
        out = np.zeros(size)
        out[:, moved] = part
        return out

    return of


class HypothesisFields(TypedDict, total=False):
    """Further fields of :class:`EffectHypothesis` that laws of motions set."""

    lower: tuple[float, ...]
    correction: Callable[[Array, Shape], Correction | None]
    note: str
    family: str
    curve: Callable[[Array, Shape], LawCurve] | None
    sum_name: str
    refinement: ShapeRefinement | None


def build_joint_law_hypothesis(
    scene: MotionModel,
    joint: int,
    effect: str,
    law: str,
    equation: str,
    signal: Callable[[Shape], Array],
    quantities: Quantities,
    shapes: tuple[Shape, ...] = ((),),
    **more: Unpack[HypothesisFields],
) -> EffectHypothesis:
    """Build a hypothesis at one joint from its signal.

    Args:
        scene: Motion model.
        joint: Joint index, 0-based.
        effect: Name of the effect.
        law: Name of the law.
        equation: Equation of the law.
        signal: Function from a shape to the signal (M,) or (M, p).
        quantities: Function from coefficients and shape to reported quantities.
        shapes: Grid of shapes.
        **more: Further fields of :class:`EffectHypothesis`.

    Returns:
        The hypothesis.
    """
    fields: HypothesisFields = {"family": "joint", "refinement": build_ratio_refinement(shapes), **more}
    return EffectHypothesis(
        effect=effect,
        location=format_joint_location(joint + 1),
        law=law,
        equation=equation,
        columns=lambda shape: scene.column(joint, signal(shape)),
        quantities=quantities,
        shapes=shapes,
        **fields,
    )


def build_binned_curve(scene: MotionModel, x: Array, y: Array, x_label: str, y_label: str, bins: int = 80) -> LawCurve:
    """Build the curve of a law as means over bins of its driving quantity.

    Args:
        scene: Motion model.
        x: (M,) driving quantity, report units.
        y: (M,) value of the law, report units.
        x_label: Axis label of x.
        y_label: Axis label of y.
        bins: Number of bins with equal counts.

    Returns:
        The curve with the value at every reading.
    """
    at, value = scene.motion.average_blocks(x), scene.motion.average_blocks(y)
    edges = np.quantile(at, np.linspace(0.0, 1.0, bins + 1))
    which = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    count = np.bincount(which, minlength=bins)
    good = count > 0
    mean_x = np.bincount(which, at, bins)[good] / count[good]
    mean_y = np.bincount(which, value, bins)[good] / count[good]
    return LawCurve(x=mean_x, law=mean_y, x_label=x_label, y_label=y_label, data_x=at, per_reading=value)
