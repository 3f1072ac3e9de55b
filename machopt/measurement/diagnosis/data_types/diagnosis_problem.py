"""Data types of the regression problem: measured minus predicted values, base unknowns, and hypotheses.

All in SI. N readings (rows of a recording, or samples of a motion) with D coordinates each. They are flattened only
in :mod:`machopt.measurement.diagnosis.statistics.whitening`.
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
from machopt.effects.protocol import UNCATALOGUED as UNCATALOGUED  # noqa: PLC0414 - family of uncatalogued forms
from machopt.effects.protocol import Quantity as Quantity  # noqa: PLC0414 - laws of users take it from here
from machopt.effects.protocol import Shape as Shape  # noqa: PLC0414 - with it
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
Channel = Literal["deflection", "position", "torque"]


@dataclass(frozen=True, kw_only=True)
class BaseUnknown:
    """One unknown of the base model, which is always fitted."""

    name: str  # "joint 3", "registration x", "friction 2 viscous"
    unit: str  # SI
    lower: float = -np.inf
    location: str = ""  # location in the machine: "joint:3", "base" …
    prior: float | None = None  # prior standard deviation about zero, SI; None: no prior
    is_stated: bool = True  # model files or corrected readings state it; False: the written model has it at zero
    session: int | None = None  # index of the session whose recorded loads it multiplies by 1 + value; None: no gain
    key: ParameterKey | None = None  # its key in an arm model; None: not part of a model
    plausible_range: tuple[float, float] | None = None  # plausible minimum and maximum, SI; None: unlimited
    description_if_unstated: str = (
        ""  # what it is of the robot, where neither URDF nor cell has a word for it: reported where it is present
    )

    @property
    def spring_joint(self) -> int | None:
        """Joint, 1-based, whose spring it is; None if it is no spring."""
        return self.key.joint if self.key is not None and self.key.effect == JOINT_SPRING else None

    def is_plausible(self, value: float) -> bool:
        """Return whether a value is plausible for a real machine.

        Args:
            value: Value in SI.

        Returns:
            True inside ``plausible_range``.
        """
        return self.plausible_range is None or self.plausible_range[0] <= value <= self.plausible_range[1]


@dataclass(frozen=True, kw_only=True)
class CoordinateFamily:
    """Coordinates that share a unit and a noise level."""

    name: str  # "translation", "rotation", "joint 3"
    columns: tuple[int, ...]  # indices in D
    unit: str  # unit in reports, e.g. "mm"
    factor: float  # report unit per SI unit, e.g. 1e3
    stated_uncertainty: float | None = None  # 1 sigma of a reading as the recording states it, SI
    is_separate_instrument: bool = (
        False  # of an instrument of its own: reported beside, and used only for what is stated
    )


@dataclass(frozen=True, kw_only=True)
class DiagnosisProblem:
    """Measured minus predicted values as equations linear in the base unknowns."""

    channel: Channel
    y: Array  # (N, D) m, rad or N·m
    base: Array  # (N, D, P) per unit of each base unknown
    unknowns: tuple[BaseUnknown, ...]
    families: tuple[CoordinateFamily, ...]  # the first is the one that errors are reported in
    group: Ints  # (N,) cross-validation group: the pose; for motions a block of time
    visit: Ints  # (N,) one stay at a pose, an unbroken run of rows; nested in a group
    cycle: Ints  # (N,) one load cycle; nested in a visit
    session: Ints  # (N,)
    replicate: Ints  # (N,) equal labels (≥ 0) are replicates; −1: no replicate
    line: Ints  # (N,) line of the data file
    row: Ints  # (N,) 1-based data row
    scale: Array | None = (
        None  # (N, D) signal that a gain error multiplies (predicted displacement); None: no gain noise
    )
    excluded: Flags | None = None  # (N,) rows excluded by the record checks
    subtracted_displacement: Array | None = (
        None  # (N, D) K_C of load and weight, subtracted from y; a base unknown holds its uncertainty
    )
    time: Array | None = None  # (N,) s, if readings close in time may share an error
    order: Array | None = None  # (N,) time, or number of the row where no time is stated; None: visits have no order
    repeat: Ints | None = None  # (N,) what replicates are compared between: cycles of one stay; None: visits
    visits_for_cycles: bool = False  # load cycles are not labelled: a visit counts as one cycle
    present: Flags | None = None  # (N, D) measured coordinates; None: all. Elsewhere y and all columns are zero

    def __len__(self) -> int:
        return len(self.y)

    @property
    def replicate_visit(self) -> Ints:
        """Label (N,) of the visits, or cycles of one stay, between which replicates are compared."""
        return self.visit if self.repeat is None else self.repeat

    @property
    def dimensions(self) -> int:
        return int(self.y.shape[1])

    def mask_unmeasured(self, residual: Array) -> Array:
        """Set residuals of unmeasured coordinates to NaN.

        Args:
            residual: (N, D) residuals.

        Returns:
            (N, D) residuals.
        """
        return residual if self.present is None else np.where(self.present, residual, np.nan)

    def has_family(self, family: CoordinateFamily) -> Flags:
        """Return which readings have every coordinate of a family.

        Args:
            family: Coordinate family.

        Returns:
            (N,) True if complete.
        """
        if self.present is None:
            return np.ones(len(self), bool)
        return np.asarray(self.present[:, list(family.columns)].all(axis=1))


Quantities = Callable[[Array, Shape], Mapping[str, Quantity]]


@dataclass(frozen=True)
class RecordCorrection:
    """Correction of a recording fault; it concerns the data, not the robot."""

    effect: str
    location: str
    parameters: Mapping[str, Any]


Correction = StiffnessTerm | KinematicCorrection | RecordCorrection


@dataclass(frozen=True, kw_only=True)
class ShapeRefinement:
    """Refinement of a shape beyond its search grid, once its law is selected."""

    # shapes around a given one (included), up to a share of the distance to its grid neighbours
    shapes_around: Callable[[Shape, float], tuple[Shape, ...]]
    is_preferred: Callable[[Shape], bool] = lambda _: (
        False
    )  # a shape that is preferred if no other is significantly better
    describe_ambiguity: Callable[[Sequence[Shape]], str] = lambda _: (
        ""
    )  # text on shapes that the data cannot distinguish; appended to a note
    minimum_separation: float = 0.0  # least difference of several simultaneous shapes
    # for one number: range in which the ends of its interval are searched; None: around the best shape only
    search_range: tuple[float, float] | None = None
    search_ranges: tuple[tuple[float, float], ...] | None = None  # for several numbers, one range each


@dataclass(frozen=True)
class EffectHypothesis:
    """One law of one effect at one place: columns that are fitted together with the base.

    The first entry of ``quantities`` is the size of the effect. Detection limits are stated in it. It must be
    proportional to the coefficients.
    """

    effect: str  # name of a registered or user-defined effect
    location: str
    law: str  # name of the law: "play", "dead zone on total torque"
    equation: str  # with its source
    columns: Callable[[Shape], Array]  # (N, D, p) per unit of each coefficient; SI
    quantities: Quantities
    _: KW_ONLY  # the fields above may be positional: user files rely on it
    shapes: tuple[Shape, ...] = ((),)  # grid of nonlinear parameters: threshold, time constant, order …
    lower: tuple[float, ...] = ()  # lower bounds of the coefficients; empty: unbounded
    correction: Callable[[Array, Shape], Correction | None] = lambda x, shape: None
    note: str = ""  # where it is visible, e.g. "on load reversal"
    family: str = ""  # class of competing effects: "joint", "body", "sensor", "kinematic", "environment"
    curve: Callable[[Array, Shape], LawCurve] | None = None  # curve of the law for the report
    penalty: float = 0.0  # additional penalty beyond that of its coefficients, for flexible laws
    # nearest plausible coefficients (p,), in the metric (p, p) of the misfit
    project_to_plausible: Callable[[Array, Array], Array] | None = None
    prior_sigma: float | None = None  # prior standard deviation of every coefficient about zero; None: no prior
    sum_name: str = ""  # name of a sum of several shapes at one place ("waves"); empty: shapes do not add up
    refinement: ShapeRefinement | None = None  # refinement of the selected shape; None: a grid shape is final
    # whether coefficients and shape are plausible for a real machine
    is_plausible: Callable[[Array, Shape], bool] = lambda x, shape: True
    least_size: float = 0.0  # size, in its unit, below which the effect is no fault
    is_exact: bool = False  # the law describes its effect without remainder (a clock offset, a measured lag)
    # wrench (N, 6, p) N, N·m at the TCP, base_link axes, that acted in addition to the recorded one, per unit of each
    # coefficient; None: the law changes the displacement
    wrench_change: Callable[[Shape], Array] | None = None
    has_jumps: bool = False  # its shape moves discontinuities: the uncertainty of the shape is computed differently
    is_approximate: bool = False  # it only approximates its effect and leaves a remainder
    varies_between_sessions: bool = False  # it may differ between sessions: sessions without it are no counter-evidence
    typical_coefficients: Array | None = None  # (K, p) SI, typical coefficients; None: all are equally likely

    @property
    def name(self) -> tuple[str, str]:
        return self.effect, self.location

    @property
    def is_in_catalogue(self) -> bool:
        """Whether it may become a finding. Otherwise it only locates a mismatch and blocks other effects there."""
        return self.family != UNCATALOGUED


@dataclass(frozen=True, kw_only=True)
class LawCurve:
    """Curve of a law over its driving quantity, and the position of each reading on that axis, for the report's
    figure.
    """

    x: Array  # (M,) in report units
    law: Array  # (M,)
    x_label: str  # "torque at joint 3 in N·m"
    y_label: str  # "twist in arcmin"
    data_x: Array  # (N,)
    per_reading: Array  # (N,) the law at each reading, y units; data = this + residual along the column


@dataclass(frozen=True)
class UntestableEffect:
    """Effect that the recording cannot test."""

    effect: str
    location: str
    reason: str
    same_as: tuple[str, str] | None = None  # effect and place that it cannot be distinguished from here

    @property
    def name(self) -> tuple[str, str]:
        return self.effect, self.location


@dataclass(frozen=True)
class UncertainInputs:
    """Inputs of the model that are stated with an uncertainty."""

    columns: Array  # (N, D, P) m, rad per unit of each input's error
    unknowns: tuple[BaseUnknown, ...]  # each with a prior


@dataclass(frozen=True)
class HypothesisCatalogue:
    """All hypotheses that are tried on a problem."""

    hypotheses: tuple[EffectHypothesis, ...]
    untestable: tuple[UntestableEffect, ...] = ()
    axes: Mapping[str, Array] = field(default_factory=dict)  # name → (N,) values for locating a mismatch in the data
    extended_hypotheses: tuple[EffectHypothesis, ...] = ()  # tried only if the others leave more than noise
    uncatalogued_hypotheses: tuple[EffectHypothesis, ...] = ()  # tried in addition; they never become findings
    _: KW_ONLY
    uncertain_inputs: UncertainInputs | None = None  # fitted beside what a search selects
