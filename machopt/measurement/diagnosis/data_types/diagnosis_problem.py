"""The nouns of a diagnosis: what was measured, what is refitted in any case, and what may explain the rest.

All in SI. N readings (rows of a recording, or samples of a motion), D coordinates each, flattened nowhere but in
:mod:`machopt.measurement.diagnosis.statistics.whitening`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.data_types.parameter_keys import JOINT_SPRING, ParameterKey
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects.protocol import Quantity as Quantity  # noqa: PLC0414 - laws of users take it from here
from machopt.effects.protocol import Shape as Shape  # noqa: PLC0414 - with it
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
Channel = Literal["deflection", "position", "torque"]
UNCATALOGUED = "unnamed"  # family of what no word of the catalogue means


@dataclass(frozen=True, kw_only=True)
class BaseUnknown:
    """One coefficient of the base model."""

    name: str  # "joint 3", "registration x", "friction 2 viscous"
    unit: str  # SI
    lower: float = -np.inf
    location: str = ""  # where in the machine: "joint:3", "base" …
    prior: float | None = None  # 1 sigma about zero, SI, of what is known to be small; None: nothing is known
    key: ParameterKey | None = None  # what it is of an arm; None: nothing that a model keeps
    plausible_range: tuple[float, float] | None = None  # least and most that something built has, SI; None: anything
    description_if_unstated: str = (
        ""  # what it is of the robot, where neither URDF nor cell has a word for it: told where it is there
    )

    @property
    def spring_joint(self) -> int | None:
        """The joint, from 1, whose spring it is."""
        return self.key.joint if self.key is not None and self.key.effect == JOINT_SPRING else None

    def is_plausible(self, value: float) -> bool:
        """Whether something built may have that value."""
        return self.plausible_range is None or self.plausible_range[0] <= value <= self.plausible_range[1]


@dataclass(frozen=True, kw_only=True)
class CoordinateFamily:
    """Coordinates that share a unit and a level of noise."""

    name: str  # "translation", "rotation", "joint 3"
    columns: tuple[int, ...]  # indices in D
    unit: str  # of reports, e.g. "mm"
    factor: float  # report unit per SI unit, e.g. 1e3
    stated_uncertainty: float | None = None  # 1 sigma of a reading as the recording states it, SI
    is_separate_instrument: bool = (
        False  # of an instrument of its own: told beside, and good for no more than is stated
    )


@dataclass(frozen=True, kw_only=True)
class DiagnosisProblem:
    """What was measured less what the nominal model predicts, as equations linear in the base unknowns."""

    channel: Channel
    y: Array  # (N, D) m, rad or N·m
    base: Array  # (N, D, P) per unit of each base unknown
    unknowns: tuple[BaseUnknown, ...]
    families: tuple[CoordinateFamily, ...]  # the first is the one that errors are reported in
    group: Ints  # (N,) held out and resampled together: the pose; in motion a stretch of time
    visit: Ints  # (N,) one arrival at a pose (pose in a session); inside a group
    cycle: Ints  # (N,) one load cycle; inside a visit
    session: Ints  # (N,)
    replicate: Ints  # (N,) readings with the same label (≥ 0) measured the same thing; −1: no twin
    line: Ints  # (N,) line of the data file
    row: Ints  # (N,) 1-based data row
    scale: Array | None = None  # (N, D) size of what a gain error acts on (predicted displacement); None: no such noise
    excluded: Flags | None = None  # (N,) rows that the record checks put aside
    subtracted_displacement: Array | None = (
        None  # (N, D) K_C of load and weight, already taken off y; a base unknown holds its doubt
    )
    time: Array | None = None  # (N,) s, where readings of one hour may share an error that those of another do not
    visits_for_cycles: bool = False  # load cycles have no label: a visit stands for all that it holds
    present: Flags | None = None  # (N, D) what was measured; None: all. Elsewhere y and all columns are zero

    def __len__(self) -> int:
        return len(self.y)

    @property
    def dimensions(self) -> int:
        return int(self.y.shape[1])

    def mask_unmeasured(self, residual: Array) -> Array:
        """(N, D) residuals, NaN where nothing was measured."""
        return residual if self.present is None else np.where(self.present, residual, np.nan)

    def has_family(self, family: CoordinateFamily) -> Flags:
        """(N,) readings that have every coordinate of a family."""
        if self.present is None:
            return np.ones(len(self), bool)
        return np.asarray(self.present[:, list(family.columns)].all(axis=1))


Quantities = Callable[[Array, Shape], Mapping[str, Quantity]]


@dataclass(frozen=True)
class RecordCorrection:
    """What is wrong with the record, never with the robot: stays in the diagnosis."""

    effect: str
    location: str
    parameters: Mapping[str, Any]


Correction = StiffnessTerm | KinematicCorrection | RecordCorrection


@dataclass(frozen=True, kw_only=True)
class ShapeRefinement:
    """What a shape of a grid is settled by, once its law is chosen."""

    # shapes around one, it among them, as far to either side as a share of the way to the grid's next
    shapes_around: Callable[[Shape, float], tuple[Shape, ...]]
    is_preferred: Callable[[Shape], bool] = lambda _: (
        False
    )  # a shape that is taken where another is no better by the data
    describe_ambiguity: Callable[[Sequence[Shape]], str] = lambda _: (
        ""
    )  # of shapes that the data cannot tell apart; added to a note
    minimum_separation: float = 0.0  # several shapes at once differ by this at least, else they are one
    # of one number: least and most that the ends of its interval are looked for in; None: about the best shape alone
    search_range: tuple[float, float] | None = None
    search_ranges: tuple[tuple[float, float], ...] | None = None  # of several numbers, each with an interval of its own


@dataclass(frozen=True)
class EffectHypothesis:
    """One law of one effect at one place: columns that are fitted beside the base.

    The first entry of ``quantities`` is the effect's size: detection limits are stated in it, and it must grow with
    the coefficients (twice the coefficients, twice the size).
    """

    effect: str  # a word of the vocabulary, or a user's own
    location: str
    law: str  # which of the rival laws, in words: "play", "dead zone on total torque"
    equation: str  # with its source
    columns: Callable[[Shape], Array]  # (N, D, p) per unit of each coefficient; SI
    quantities: Quantities
    _: KW_ONLY  # what stands above may be given by position: files of users' own do
    shapes: tuple[Shape, ...] = ((),)  # grid of what is not linear: threshold, time constant, order …
    lower: tuple[float, ...] = ()  # bounds of the coefficients; empty: free
    correction: Callable[[Array, Shape], Correction | None] = lambda x, shape: None
    note: str = ""  # where it shows, e.g. "on load reversal"
    family: str = ""  # effects that are rivals of one kind: "joint", "body", "sensor", "kinematic", "environment"
    curve: Callable[[Array, Shape], LawCurve] | None = None  # the law itself, for the report
    penalty: float = 0.0  # beyond that of its coefficients; for laws that are flexible enough to fit anything
    # coefficients (p,) that something built can have, nearest to the given ones by how the misfit grows (p, p)
    project_to_plausible: Callable[[Array, Array], Array] | None = None
    prior_sigma: float | None = (
        None  # 1 sigma about zero of every coefficient, of what makers hold; None: nothing is known
    )
    sum_name: str = ""  # several of its shapes at one place are one law again, so called ("waves"); empty: they are not
    refinement: ShapeRefinement | None = None  # how its shape is settled once it is chosen; None: one of ``shapes``
    # whether anything built has such coefficients at such a shape; where not, the law is no more than a shape that fits
    is_plausible: Callable[[Array, Shape], bool] = lambda x, shape: True
    is_exact: bool = False  # the law leaves nothing of its effect (a clock, a measured lag), however large that is
    has_jumps: bool = (
        False  # its shape moves leaps between readings, not slopes: how far it may be off is told otherwise
    )
    is_approximate: bool = False  # it is only like what is there, and leaves much of it, anywhere
    varies_between_sessions: bool = (
        False  # it may well be another each day: sessions that did not see it say nothing against it
    )
    typical_coefficients: Array | None = (
        None  # (K, p) SI, coefficients as such a thing mostly has them; None: any are as likely
    )

    @property
    def name(self) -> tuple[str, str]:
        return self.effect, self.location

    @property
    def is_in_catalogue(self) -> bool:
        """Whether a finding may be made of it; else it says where something is, and keeps others from its place."""
        return self.family != UNCATALOGUED


@dataclass(frozen=True, kw_only=True)
class LawCurve:
    """A law as a line over what drives it, and each reading's place on that axis, for the report's picture."""

    x: Array  # (M,) in report units
    law: Array  # (M,)
    x_label: str  # "torque at joint 3 in N·m"
    y_label: str  # "twist in arcmin"
    data_x: Array  # (N,)
    per_reading: Array  # (N,) the law at each reading, y units; data = this + residual along the column


@dataclass(frozen=True)
class UntestableEffect:
    """An effect whose signals the recording does not have."""

    effect: str
    location: str
    reason: str
    same_as: tuple[str, str] | None = None  # the effect and place that it cannot be told from in this recording

    @property
    def name(self) -> tuple[str, str]:
        return self.effect, self.location


@dataclass(frozen=True)
class HypothesisCatalogue:
    """Everything that is tried on a problem."""

    hypotheses: tuple[EffectHypothesis, ...]
    untestable: tuple[UntestableEffect, ...] = ()
    axes: Mapping[str, Array] = field(default_factory=dict)  # name → (N,) for locating a mismatch in the data
    extended_hypotheses: tuple[
        EffectHypothesis, ...
    ] = ()  # tried where the others leave more than noise: too many to try on noise
    uncatalogued_hypotheses: tuple[
        EffectHypothesis, ...
    ] = ()  # tried then and where several parts were found: none of these is ever named
