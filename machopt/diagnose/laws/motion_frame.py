"""What all channels of a motion share: samples, dynamics, and how a law's signal becomes columns of the problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.motion_signals import Motion
from machopt.diagnose.nouns.problem import (
    Channel,
    Curve,
    Family,
    Hypothesis,
    Ints,
    Problem,
    Quantities,
    Shape,
    Unknown,
    Untestable,
)
from machopt.diagnose.search.finer import between
from machopt.domain.cell import Cell
from machopt.domain.location import joint_at
from machopt.domain.recording import Recording
from machopt.domain.stiffness import Term
from machopt.model.correction import Correction
from machopt.model.rigid import Dynamics

ARCMIN, ARCSEC = np.pi / 10800.0, np.pi / 648000.0


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A recorded motion and everything that is computed from it once, at the rate of the recording. SI."""

    recording: Recording
    cell: Cell
    motion: Motion
    dynamics: Dynamics | None  # None: the URDF has no inertias
    predicted: Array | None  # (M, n) N·m rigid-body torque
    dimensions: int  # D of the problem
    lift: Callable[[int, Array], Array]  # joint, (M, p) → (N, D, p)
    prismatic: tuple[bool, ...]
    scale: Array | None = None  # (D,) of the problem's coordinates; None: 1
    known: tuple[Term, ...] = ()  # of the cell's stiffness
    correction: Correction | None = None  # of the cell's kinematics: true angles by those of the encoders
    free_gains: bool = False  # torques are currents, and how much a joint makes of its own is refitted
    unsized: frozenset[int] = frozenset()  # joints, from 0, of which nothing says what torque such a current is
    notes: list[str] = field(default_factory=list)
    untestable: list[Untestable] = field(default_factory=list)

    @property
    def first(self) -> Ints:
        """(M,) 1 where a segment begins."""
        return np.asarray(np.diff(self.motion.segment, prepend=self.motion.segment[0] - 1) != 0, np.int64)

    @property
    def step(self) -> Array:
        """(M,) s since the sample before; the sampling interval at the start of a segment."""
        out = np.diff(self.motion.time, prepend=self.motion.time[0])
        out[self.first > 0] = 1.0 / self.motion.rate
        return out

    @property
    def joints(self) -> int:
        return int(self.motion.q.shape[1])

    def true_angles(self, q: Array) -> Array:
        """(M, n) rad that the arm stands at without load where encoders (or commands) say q (M, n)."""
        return q if self.correction is None else self.correction.true_angles(q)

    def column(self, joint: int, x: Array) -> Array:
        """(N, D, p) of a signal (M,) or (M, p) of one joint."""
        return self.lift(joint, x[:, None] if x.ndim == 1 else x)

    def problem(self, channel: Channel, y: Array, base: Array, unknowns: Sequence[Unknown], family: Family) -> Problem:
        """Equations of a channel, with what the motion says of its stretches of time.

        Args:
            channel: what ``y`` is.
            y: (N, D) m, rad or N·m measured less predicted.
            base: (N, D, P) per unit of each unknown.
            unknowns: P of them.
            family: the coordinates, all of one kind.
        """
        m = self.motion
        return Problem(
            channel=channel,
            y=y,
            base=base,
            unknowns=tuple(unknowns),
            families=(family,),
            group=m.group,
            visit=m.visit,
            cycle=m.cycle,
            session=m.first(m.session),
            replicate=m.replicate,
            line=m.first(self.recording.line[m.index]),
            row=m.first(m.index) + 1,
        )

    def everywhere(self, x: Array) -> Array:
        """(N, D, p) of a signal (M, D, p) of all coordinates; (N, D) of (M, D)."""
        part = self.motion.within(self.motion.mean(x))
        if self.scale is None:
            return part
        return part * (self.scale if x.ndim == 2 else self.scale[:, None])

    def moves(self, joint: int) -> bool:
        """Whether a joint moves at all."""
        return bool(np.ptp(self.motion.q[:, joint]) > calibrated.MOTION.moves)


class PowerTaken:
    """What columns take of a problem's power once the base is refitted beside them; coordinates weighted alike."""

    def __init__(self, y: Array, base: Array, weight: Array) -> None:
        self.weight = weight
        B = (base * weight[:, None]).reshape(-1, base.shape[2])
        size = np.linalg.norm(B, axis=0)
        self.Q, _ = np.linalg.qr(B[:, size > 0] / size[size > 0])
        self.left = self._without((y * weight).reshape(-1))
        self.power = float(self.left @ self.left)

    def _without(self, x: Array) -> Array:
        return np.asarray(x - self.Q @ (self.Q.T @ x))

    def left_of(self, column: Array) -> float:
        """Share of the length of (N, D, p) that the base cannot make up."""
        flat = (column * self.weight[:, None]).reshape(-1, column.shape[2])
        left = np.stack([self._without(x) for x in flat.T], axis=1)
        return float(np.linalg.norm(left) / max(np.linalg.norm(flat), np.finfo(float).tiny))

    def misfit(self, change: Array) -> float:
        """Power left by (N, D) taken as it is."""
        left = self.left - self._without((change * self.weight).reshape(-1))
        return float(left @ left)

    def gain(self, column: Array) -> float:
        """Power that (N, D, 1) takes with its best coefficient."""
        x = self._without((column[:, :, 0] * self.weight).reshape(-1))
        power = float(x @ x)
        return float(x @ self.left) ** 2 / power if power > 0 else 0.0


def one_joint(
    motion: Motion, dimensions: int, joints: list[int] | None = None, scale: Array | None = None
) -> Callable[[int, Array], Array]:
    """A joint's signal counts in its own coordinate only: joint torques, link-side encoders.

    Args:
        motion: the samples.
        dimensions: D.
        joints: which joint each coordinate is of; None: joint i is coordinate i.
        scale: (D,) of the problem's coordinates; None: 1.
    """

    def lift(joint: int, x: Array) -> Array:
        part = motion.within(motion.mean(x))
        out = np.zeros((len(part), dimensions, x.shape[1]))
        at = joint if joints is None else joints.index(joint)
        out[:, at] = part if scale is None else part * scale[at]
        return out

    return lift


def remembered(columns: Callable[[Shape], Array]) -> Callable[[Shape], Array]:
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


def joint_law(
    scene: Scene,
    joint: int,
    effect: str,
    law: str,
    equation: str,
    signal: Callable[[Shape], Array],
    quantities: Quantities,
    shapes: tuple[Shape, ...] = ((),),
    **more: Any,
) -> Hypothesis:
    """A hypothesis at one joint from its signal (M,) or (M, p) at each shape."""
    return Hypothesis(
        effect=effect,
        location=joint_at(joint + 1),
        law=law,
        equation=equation,
        columns=lambda shape: scene.column(joint, signal(shape)),
        quantities=quantities,
        shapes=shapes,
        family=more.pop("family", "joint"),
        finer=more.pop("finer", between(shapes)),
        **more,
    )


def curve(scene: Scene, x: Array, y: Array, x_label: str, y_label: str, bins: int = 80) -> Curve:
    """A law over what drives it: means over bins of the driver, and its value at every reading."""
    at, value = scene.motion.mean(x), scene.motion.mean(y)
    edges = np.quantile(at, np.linspace(0.0, 1.0, bins + 1))
    which = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    count = np.bincount(which, minlength=bins)
    good = count > 0
    mean_x = np.bincount(which, at, bins)[good] / count[good]
    mean_y = np.bincount(which, value, bins)[good] / count[good]
    return Curve(x=mean_x, law=mean_y, x_label=x_label, y_label=y_label, data_x=at, per_reading=value)
