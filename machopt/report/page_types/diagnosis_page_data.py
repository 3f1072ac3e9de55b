"""Data of the diagnosis page: diagnosis, places of its readings in the files, and its effect on a job."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.numerics.array_types import Array, Ints
from machopt.report.scene.scene_types import CellScene


@dataclass(frozen=True)
class ReadingCoordinate:
    """One of the D coordinates of a reading."""

    name: str  # "x", "rx", "joint 3"
    unit: str  # of reports: "mm", "mrad", "N·m"
    factor: float  # report unit per SI unit
    main: bool  # of the family that errors are reported in


@dataclass(frozen=True)
class JobQuantityChange:
    """Value of a job under the model before and after the diagnosis."""

    what: str
    before: float
    after: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class JobEffect:
    """Effect of the findings on one toolpath; curves have one value for each point, empty where unknown."""

    toolpath: str
    sentence: str
    changes: tuple[JobQuantityChange, ...]
    point: Array = field(default_factory=lambda: np.zeros(0))
    gamma_before: Array = field(default_factory=lambda: np.zeros(0))  # deg
    gamma_after: Array = field(default_factory=lambda: np.zeros(0))
    deflection_before: Array = field(default_factory=lambda: np.zeros(0))  # mm, as the old model predicts it
    deflection_unchanged: Array = field(default_factory=lambda: np.zeros(0))  # old choice under the new model
    deflection_after: Array = field(default_factory=lambda: np.zeros(0))  # new choice under the new model


@dataclass(frozen=True, kw_only=True)
class DiagnosisPageData:
    """Data of the diagnosis page; N readings of D coordinates."""

    title: str
    cell: str
    recording: str
    version: str
    diagnosis: DiagnosisResult
    coordinates: tuple[ReadingCoordinate, ...]  # (D,)
    pose: Ints  # (N,)
    session: Ints  # (N,)
    line: Ints  # (N,) of the data file
    row: Ints  # (N,) 1-based data row
    file: tuple[str, ...]  # (N,) data file of each reading; empty where there is only one
    group_word: str  # what is held out together: "pose", "stretch"
    group_names: tuple[str, ...]  # (G,) of diagnosis.errors.groups
    branch: NDArray[np.int8] | None  # (N,) +1 loading, −1 unloading, 0 not stated
    facts: tuple[tuple[str, str], ...] = ()
    job: JobEffect | None = None
    scene: CellScene | None = None  # None: residuals that are no vectors in space
    q: Array = field(
        default_factory=lambda: np.zeros((0, 0))
    )  # (N, J) rad, where the arm stood; external joints at home
