"""Diagnose measured poses: set up the equations, and linearise them anew during the search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EffectLocation
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.search.search_iterations import LinearisationPoint
from machopt.measurement.diagnosis.static import measured_pose_channel
from machopt.measurement.diagnosis.verdict.data_sufficiency import check_enough_readings
from machopt.numerics.array_types import Array

NO_LINEARISATION = LinearisationPoint()


@dataclass(kw_only=True)
class MeasuredPoseDiagnosis:
    """A diagnosis of measured poses."""

    cell: Cell
    recording: Recording
    robot: Robot
    masses: RobotMasses | None
    barred: frozenset[EffectLocation]  # effects and places that are not to be tried
    excluded: NDArray[np.bool_]  # (N,) rows that take no part
    options: selection_pipeline.DiagnosisOptions
    seed: int  # of every random choice
    notes: tuple[str, ...] = ()  # of the last problem that was built

    def run(self, terms: tuple[StiffnessTerm, ...]) -> tuple[DiagnosisResult, DiagnosisProblem]:
        """Diagnose with known terms.

        Args:
            terms: terms of the cell's stiffness that count as known.

        Returns:
            The diagnosis and its last problem. ``notes`` holds the notes of that problem.
        """
        self._terms = terms
        self._rng = np.random.default_rng(self.seed)
        self._fixed_springs = frozenset[int]()
        self._problem, catalogue = self._build(None, NO_LINEARISATION)
        check_enough_readings(self._problem, self.recording)
        options = replace(self.options, predicted="poses", is_static=True)
        result = selection_pipeline.diagnose_problem(self._problem, catalogue, options, self._rng, self._rebuild)
        return result, self._problem

    def _build(
        self, springs: Mapping[int, float] | None, about: LinearisationPoint
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        problem, catalogue, self.notes = measured_pose_channel.build_measured_pose_problem(
            self.recording,
            self.cell,
            self.robot,
            self.masses,
            self._rng,
            self._terms,
            springs,
            self._fixed_springs,
            about.corrections,
        )
        laws = tuple(h for h in catalogue.hypotheses if h.name not in self.barred)
        excluded = self.excluded if self.excluded.any() else None
        problem = replace(problem, time=self.recording.time, excluded=excluded)
        return problem, replace(catalogue, hypotheses=laws)

    def _rebuild(
        self, x: Array, doubted: frozenset[int], about: LinearisationPoint
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        unknowns = self._problem.unknowns
        springs = {
            u.spring_joint: float(value) for u, value in zip(unknowns, x, strict=True) if u.spring_joint is not None
        }
        self._fixed_springs |= {unknowns[n].spring_joint or 0 for n in doubted}
        self._problem, catalogue = self._build(springs, about)
        return self._problem, catalogue
