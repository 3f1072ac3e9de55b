"""What all channels of a motion share: samples, dynamics, and how a law's signal becomes columns of the problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.locations import format_joint_location
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.dynamics.rigid_body import RigidBodyDynamics
from machopt.kinematics.encoder_corrections import EncoderCorrection
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    Channel,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    Ints,
    LawCurve,
    Quantities,
    Shape,
    UntestableEffect,
)
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import build_ratio_refinement
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array

ARCMIN, ARCSEC = np.pi / 10800.0, np.pi / 648000.0


@dataclass(frozen=True, kw_only=True)
class MotionModel:
    """A recorded motion and everything that is computed from it once, at the rate of the recording. SI."""

    recording: Recording
    cell: Cell
    motion: MotionSignals
    dynamics: RigidBodyDynamics | None  # None: the URDF has no inertias
    predicted: Array | None  # (M, n) N·m rigid-body torque
    dimensions: int  # D of the problem
    lift: Callable[[int, Array], Array]  # joint, (M, p) → (N, D, p)
    prismatic: tuple[bool, ...]
    scale: Array | None = None  # (D,) of the problem's coordinates; None: 1
    known_terms: tuple[StiffnessTerm, ...] = ()  # of the cell's stiffness
    correction: EncoderCorrection | None = None  # of the cell's kinematics: true angles by those of the encoders
    free_gains: bool = False  # torques are currents, and how much a joint makes of its own is refitted
    joints_without_gain: frozenset[int] = (
        frozenset()
    )  # joints, from 0, of which nothing says what torque such a current is
    notes: list[str] = field(default_factory=list)
    untestable: list[UntestableEffect] = field(default_factory=list)

    @property
    def segment_start(self) -> Ints:
        """(M,) 1 where a segment begins."""
        return np.asarray(np.diff(self.motion.segment, prepend=self.motion.segment[0] - 1) != 0, np.int64)

    @property
    def time_step(self) -> Array:
        """(M,) s since the sample before; the sampling interval at the start of a segment."""
        out = np.diff(self.motion.time, prepend=self.motion.time[0])
        out[self.segment_start > 0] = 1.0 / self.motion.rate
        return out

    @property
    def joints(self) -> int:
        return int(self.motion.q.shape[1])

    def true_angles(self, q: Array) -> Array:
        """(M, n) rad that the arm stands at without load where encoders (or commands) say q (M, n)."""
        return q if self.correction is None else self.correction.compute_true_angles(q)

    def column(self, joint: int, x: Array) -> Array:
        """(N, D, p) of a signal (M,) or (M, p) of one joint."""
        return self.lift(joint, x[:, None] if x.ndim == 1 else x)

    def problem(
        self, channel: Channel, y: Array, base: Array, unknowns: Sequence[BaseUnknown], family: CoordinateFamily
    ) -> DiagnosisProblem:
        """Equations of a channel, with what the motion says of its stretches of time.

        Args:
            channel: what ``y`` is.
            y: (N, D) m, rad or N·m measured less predicted.
            base: (N, D, P) per unit of each unknown.
            unknowns: P of them.
            family: the coordinates, all of one kind.
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
        """(N, D, p) of a signal (M, D, p) of all coordinates; (N, D) of (M, D)."""
        part = self.motion.subtract_period_mean(self.motion.average_blocks(x))
        if self.scale is None:
            return part
        return part * (self.scale if x.ndim == 2 else self.scale[:, None])

    def is_joint_moving(self, joint: int) -> bool:
        """Whether a joint moves at all."""
        return bool(np.ptp(self.motion.q[:, joint]) > thresholds.MOTION.moves)


class ExplainedPower:
    """What columns take of a problem's power once the base is refitted beside them; coordinates weighted alike."""

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
        """Share of the length of (N, D, p) that the base cannot make up."""
        flat = (column * self.weight[:, None]).reshape(-1, column.shape[2])
        left = np.stack([self._project_out_base(x) for x in flat.T], axis=1)
        return float(np.linalg.norm(left) / max(np.linalg.norm(flat), np.finfo(float).tiny))

    def misfit(self, change: Array) -> float:
        """Power left by (N, D) taken as it is."""
        left = self.remaining - self._project_out_base((change * self.weight).reshape(-1))
        return float(left @ left)

    def gain(self, column: Array) -> float:
        """Power that (N, D, 1) takes with its best coefficient."""
        x = self._project_out_base((column[:, :, 0] * self.weight).reshape(-1))
        power = float(x @ x)
        return float(x @ self.remaining) ** 2 / power if power > 0 else 0.0


def build_joint_selector(
    motion: MotionSignals, dimensions: int, joints: list[int] | None = None, scale: Array | None = None
) -> Callable[[int, Array], Array]:
    """A joint's signal counts in its own coordinate only: joint torques, link-side encoders.

    Args:
        motion: the samples.
        dimensions: D.
        joints: which joint each coordinate is of; None: joint i is coordinate i.
        scale: (D,) of the problem's coordinates; None: 1.
    """

    def lift(joint: int, x: Array) -> Array:
        part = motion.subtract_period_mean(motion.average_blocks(x))
        out = np.zeros((len(part), dimensions, x.shape[1]))
        at = joint if joints is None else joints.index(joint)
        out[:, at] = part if scale is None else part * scale[at]
        return out

    return lift


def cache_columns(columns: Callable[[Shape], Array]) -> Callable[[Shape], Array]:
    """The same columns (N, D, p), worked out once a shape: a search asks several times, and samples are many."""
    known: dict[Shape, tuple[Ints, Array, tuple[int, ...]]] = {}

    def of(shape: Shape) -> Array:
        if shape not in known:
            whole = columns(shape)
            moved = np.flatnonzero(np.any(whole.any(axis=0), axis=1))  # both axes at once take five times as long
            known[shape] = moved, whole[:, moved], whole.shape
        moved, part, size = known[shape]
        out = np.zeros(size)
        out[:, moved] = part
        return out

    return of


def build_joint_law_hypothesis(
    scene: MotionModel,
    joint: int,
    effect: str,
    law: str,
    equation: str,
    signal: Callable[[Shape], Array],
    quantities: Quantities,
    shapes: tuple[Shape, ...] = ((),),
    **more: Any,
) -> EffectHypothesis:
    """A hypothesis at one joint from its signal (M,) or (M, p) at each shape."""
    return EffectHypothesis(
        effect=effect,
        location=format_joint_location(joint + 1),
        law=law,
        equation=equation,
        columns=lambda shape: scene.column(joint, signal(shape)),
        quantities=quantities,
        shapes=shapes,
        family=more.pop("family", "joint"),
        refinement=more.pop("refinement", build_ratio_refinement(shapes)),
        **more,
    )


def build_binned_curve(scene: MotionModel, x: Array, y: Array, x_label: str, y_label: str, bins: int = 80) -> LawCurve:
    """A law over what drives it: means over bins of the driver, and its value at every reading."""
    at, value = scene.motion.average_blocks(x), scene.motion.average_blocks(y)
    edges = np.quantile(at, np.linspace(0.0, 1.0, bins + 1))
    which = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    count = np.bincount(which, minlength=bins)
    good = count > 0
    mean_x = np.bincount(which, at, bins)[good] / count[good]
    mean_y = np.bincount(which, value, bins)[good] / count[good]
    return LawCurve(x=mean_x, law=mean_y, x_label=x_label, y_label=y_label, data_x=at, per_reading=value)
