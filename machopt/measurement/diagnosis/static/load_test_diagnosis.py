"""Diagnose load tests: set up the equations about a TCP, and linearise them anew during the search."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.kinematics.robot import GRAVITY, Robot, RobotMasses
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding
from machopt.measurement.diagnosis.data_types.static_readings import GearLoadHistory
from machopt.measurement.diagnosis.effect_columns import existing_terms, joint_torque, user_hypotheses
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.search.search_iterations import LinearisationPoint
from machopt.measurement.diagnosis.static import load_test_channel, loaded_equilibrium_terms, tcp_offset
from machopt.measurement.diagnosis.verdict.data_sufficiency import check_enough_readings
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.numerics.array_types import Array
from machopt.numerics.content_cache import NoContentKeyError, build_content_key
from machopt.stiffness.arm_stiffness import ArmElasticity

UserLaws = Sequence[tuple[str, user_hypotheses.HypothesisSource]]


@dataclass(kw_only=True)
class LoadTestDiagnosis:
    """A diagnosis of load tests, about the TCP of the cell or the one that the readings show."""

    cell: Cell
    recording: Recording
    robot: Robot
    masses: RobotMasses | None  # as load tests know them; None: weight is unknown
    user_laws: UserLaws
    excluded: NDArray[np.bool_]  # (N,) rows that take no part
    options: selection_pipeline.DiagnosisOptions
    seed: int  # of every random choice
    tcp_findings: list[Finding] = field(default_factory=list)  # the TCP's offset, where one was found

    def run(self, terms: tuple[StiffnessTerm, ...]) -> tuple[DiagnosisResult, DiagnosisProblem]:
        """Diagnose with known terms.

        Args:
            terms: terms of the cell's stiffness that count as known.

        Returns:
            The diagnosis and its problem. ``tcp_findings`` holds the TCP's offset.
        """
        stiffness = self.cell.stiffness
        self._known = None if stiffness is None else ArmStiffness(joints=stiffness.joints, terms=terms)
        done, tool = tcp_offset.diagnose_about_found_tcp(self.cell.tool.T_flange_tcp, self._diagnose_about)
        self.tcp_findings = [] if tool is None else [tool]
        return done

    def _diagnose_about(self, T_flange_tcp: Array) -> tuple[DiagnosisResult, DiagnosisProblem]:
        equations = _LoadTestEquations(self, T_flange_tcp, self._known)
        problem, catalogue = equations.build(None)
        check_enough_readings(problem, self.recording)
        options = replace(self.options, predicted="load tests", is_static=True)
        rng = np.random.default_rng(self.seed)
        key = self.build_search_key(T_flange_tcp, self._known)
        return selection_pipeline.diagnose_problem(problem, catalogue, options, rng, equations.rebuild, key), problem

    def build_search_key(self, T_flange_tcp: Array, known: ArmStiffness | None) -> Hashable:
        """Build a key that is equal for equal inputs of the search.

        What a search finds is the same whatever is written or shown of it; that has no part in the key.

        Args:
            T_flange_tcp: (4, 4) TCP in the flange frame.
            known: joint springs and known terms of the cell.

        Returns:
            The key; None where an input cannot be compared, so that the search must not be stored.
        """
        stiffness = self.cell.stiffness
        inputs = (
            (T_flange_tcp, known, self.recording, self.robot, self.masses, self.excluded),
            (self.seed, self.options.max_effects),
            (self.cell.T_world_base, self.cell.arm_limits, existing_terms.has_geometric_stiffness(stiffness)),
        )
        try:
            return build_content_key(inputs), tuple(self.user_laws)
        except NoContentKeyError:
            return None


class _LoadTestEquations:
    """Equations of load tests about one TCP; the first linearisation fixes the reference compliance.

    Args:
        diagnosis: recording, robot and options.
        T_flange_tcp: (4, 4) TCP in the flange frame.
        known: joint springs and known terms of the cell.
    """

    def __init__(self, diagnosis: LoadTestDiagnosis, T_flange_tcp: Array, known: ArmStiffness | None) -> None:
        self._diagnosis, self._T = diagnosis, T_flange_tcp
        recording, robot, masses = diagnosis.recording, diagnosis.robot, diagnosis.masses
        self._tests: LoadTestExperiment = loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(
            build_load_test_experiment(recording, robot, T_flange_tcp), recording, robot, T_flange_tcp, masses
        )
        self._memory: dict[str, GearLoadHistory] = {}
        self._reference_compliance: Array | None = None
        self._term_displacement = None if known is None or not known.terms else self._compute_term_displacement(known)

    def _compute_term_displacement(self, known: ArmStiffness) -> Array:
        """Return what the known terms add to the displacement of the joint springs."""
        d, T, tests = self._diagnosis, self._T, self._tests
        recording, robot, masses = d.recording, d.robot, d.masses
        readings = load_test_channel.build_load_test_readings(
            recording, tests, robot, T, masses, 1.0 / known.joints, self._memory
        )
        memory_terms, settled = joint_torque.compute_memory_term_displacement(readings, known.terms)
        limits = d.cell.arm_limits
        whole = ArmElasticity(robot, T, replace(known, terms=settled), limits, masses).evaluate(recording.q)
        springs = ArmElasticity(robot, T, ArmStiffness(joints=known.joints)).evaluate(recording.q)
        return memory_terms + whole.compute_twist(tests.wrench) - springs.compute_twist(tests.wrench)

    def build(
        self, compliance: Array | None, bodies: tuple[StiffnessTerm, ...] = ()
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        """Build the problem about joint compliances and compliant bodies.

        Args:
            compliance: (6,) rad/(N·m); None: those that the readings show.
            bodies: compliant bodies that were found.
        """
        d, T = self._diagnosis, self._T
        down = d.cell.T_world_base[:3, :3].T @ np.array([0.0, 0.0, -GRAVITY])
        problem, catalogue, readings = load_test_channel.build_load_test_problem(
            d.recording,
            self._tests,
            d.robot,
            T,
            d.masses,
            compliance,
            self._memory,
            self._term_displacement,
            self._reference_compliance,
            load_test_channel.compute_body_compliance(d.robot, T, d.recording.q, bodies),
            down,
        )
        if self._reference_compliance is None:
            self._reference_compliance = readings.compliance
        if existing_terms.has_geometric_stiffness(d.cell.stiffness):
            problem = replace(problem, subtracted_displacement=None)
        if d.excluded.any():
            problem = replace(problem, excluded=d.excluded)
        own = user_hypotheses.build_user_hypotheses(list(d.user_laws), readings)
        return problem, replace(catalogue, hypotheses=(*catalogue.hypotheses, *own))

    def rebuild(
        self, x: Array, doubted: frozenset[int], about: LinearisationPoint
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        """Build the problem about the coefficients of the last iteration.

        Args:
            x: coefficients of the base model; the first n are joint compliances, rad/(N·m).
            doubted: base unknowns that are doubted; load tests have none.
            about: effects that were found.
        """
        del doubted
        return self.build(np.maximum(x[: len(self._diagnosis.robot.joints)], 0.0), about.bodies)
