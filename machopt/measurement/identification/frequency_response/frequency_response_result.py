"""Result of an identification from frequency responses."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.data_types.stiffness import ArmStiffness
from machopt.measurement.identification.frequency_response.modal_damping import ModalDamping
from machopt.numerics.array_types import Array, ComplexArray, make_arrays_read_only


@dataclass(frozen=True, kw_only=True)
class JointResponseResult:
    """One joint."""

    joint: int  # 1 … 6
    k: float  # N·m/rad; not identified: that of the prior, changed by the responses
    interval: tuple[float, float]  # N·m/rad; not identified: lower bound and inf
    identified: bool
    reason: str  # why it is not identified; else empty
    damping: float  # viscous: N·m·s/rad; structural: loss factor
    damping_interval: tuple[float, float] | None  # None: not determined


@dataclass(frozen=True, kw_only=True)
class FrequencyResponseResult:
    """Everything that files and the page show."""

    stiffness: ArmStiffness  # to be written as stiffness.yaml
    law: str  # viscous or structural
    log_likelihood_gain: float  # of the chosen law over the other one
    joints: tuple[JointResponseResult, ...]
    modes: ModalDamping
    level: float  # of the intervals
    predicted: ComplexArray  # (N,) m/N
    noise: Array  # (G,) m/N, root mean square of the residuals of each response
    explained: Array  # (G,) share of the mean square of each response
    inflation: float  # of the covariance, by residuals that are correlated along the frequency
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        make_arrays_read_only(self)
