"""Diagnose one channel of a motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.measurement.diagnosis.model_selection import selection_pipeline

PREDICTED = {
    "torque": "stretches of joint torque",
    "link": "stretches of link-side position",
    "tip": "stretches of tip",
}


@dataclass(kw_only=True)
class MotionDiagnosis:
    """A diagnosis of one channel of a motion."""

    cell: Cell
    recording: Recording
    channel: motion_channels.MotionChannel
    options: selection_pipeline.DiagnosisOptions
    seed: int  # of every random choice
    notes: tuple[str, ...] = ()  # of the last problem that was built
    record_findings: tuple[Finding, ...] = ()  # what is wrong with the signals

    def run(self, terms: tuple[StiffnessTerm, ...]) -> tuple[DiagnosisResult, DiagnosisProblem]:
        """Diagnose with known terms.

        Args:
            terms: terms of the cell's stiffness that count as known.

        Returns:
            The diagnosis and its problem. ``notes`` and ``record_findings`` belong to that problem.
        """
        rng = np.random.default_rng(self.seed)
        problem, catalogue, self.notes, self.record_findings = motion_channels.build_motion_problem(
            self.recording, self.cell, self.channel, rng, terms=terms
        )
        options = replace(self.options, predicted=PREDICTED[self.channel])
        return selection_pipeline.diagnose_problem(problem, catalogue, options, rng), problem
