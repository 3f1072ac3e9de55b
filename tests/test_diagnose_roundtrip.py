"""Round trip of diagnose: with the written findings in the cell, no finding remains, for each channel."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording
from test_diagnose_tcp_poses import arm as six_joints
from test_diagnose_tcp_poses import measure, poses
from test_diagnose_tcp_poses import readings as at_rest
from test_effects import TOY, toy

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cli import main
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry
from machopt.effects.protocol import JointLoading
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    DiagnosisProblem,
    HypothesisCatalogue,
    RecordCorrection,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.measurement.diagnosis.effect_columns import existing_terms
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import measured_pose_hypothesis_catalogue
from machopt.measurement.recording import write_recording
from machopt.numerics.array_types import Array

__all__ = ["toy"]  # a pytest fixture
NO_FILE = {
    "payload",
    "joint_friction",
    "joint_elasticity",
    "units",
    "time_skew",
    "servo_lag",
    "transmission_error",
    "joint_coupling",
}
ROOT = Path(__file__).resolve().parent.parent
CELL = ROOT / "cells" / "kr240_drilling"
TRACKED = six_joints()[0].folder


@dataclass(frozen=True)
class Noted:
    """Stub of a diagnosis result."""

    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ("before",)


class _Bare:
    """A problem whose base explains nothing."""

    def __init__(self, n: int) -> None:
        self.base = np.zeros((n, 6, 1))


def test_pose_finding_equals_the_written_stiffness_term() -> None:
    """For every elastic law and shape: columns times coefficients equal the displacement of the written term."""
    cell = load_cell(CELL)
    q = poses()[:20]
    load = np.random.default_rng(1).normal(size=(20, 6)) * np.array([500, 500, 500, 80, 80, 80.0])
    r = at_rest(load_masses(cell), load, q)
    r = replace(r, recording=replace(r.recording, time=None, temperature=None))
    catalogue = measured_pose_hypothesis_catalogue.build_measured_pose_catalogue(r, _Bare(20))  # type: ignore[arg-type]
    observed = set()
    for h in catalogue.hypotheses:
        for shape in h.shapes[:: max(len(h.shapes) // 3, 1)]:
            columns = h.columns(shape)
            size = np.abs(columns).max(axis=(0, 1))
            x = 1e-5 / np.where(size > 0.0, size, np.inf) * np.arange(1.0, columns.shape[2] + 1.0)
            term = h.correction(x, shape)
            if isinstance(term, StiffnessTerm):
                moved = existing_terms.compute_known_pose_displacement(r, (term,))
                np.testing.assert_allclose(moved, columns @ x, rtol=1e-9, atol=1e-16, err_msg=f"{h.name} {h.law}")
                observed.add(h.effect)
    assert observed == {
        "joint_nonlinear_stiffness",
        "joint_backlash",
        "joint_pose_dependent_stiffness",
        "joint_coupling",
        "link_compliance",
        "base_compliance",
        "tool_compliance",
    }


def simulate_vertical_joint(folder: Path) -> tuple[Recording, Array, object]:
    """Return the Fourier-series motion of one joint without weight, its load and the cell."""
    rng = np.random.default_rng(7)
    turned = np.eye(4)
    turned[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    cell = replace(arm(folder, 1, tool=5.0), T_world_base=turned)
    t, q, v, a = build_fourier_motion(1, rng, periods=5)
    load = -load_dynamics(cell).compute_torque(q, v, a)
    return build_motion_recording(t, q, v), load, cell


def test_motion_finding_equals_the_written_stiffness_term(tmp_path: Path) -> None:
    """Every law of a single joint's torque, including laws with memory."""
    recording, load, cell = simulate_vertical_joint(tmp_path)
    other = replace(recording, q_secondary=recording.q + load / 2e6)
    problem, catalogue, _, _ = motion_channels.build_motion_problem(other, cell, "link", np.random.default_rng(0))  # type: ignore[arg-type]
    observed = set()
    for h in catalogue.hypotheses:
        if h.effect not in {e.name for e in registry.select_joint_torque_effects()}:
            continue
        for shape in h.shapes[-1:]:
            columns = h.columns(shape)
            x = 1e-5 / np.abs(columns).max(axis=(0, 1)) * np.arange(1.0, columns.shape[2] + 1.0)
            term = h.correction(x, shape)
            assert isinstance(term, StiffnessTerm)
            less, *_ = motion_channels.build_motion_problem(
                other, cell, "link", np.random.default_rng(0), terms=(term,)
            )  # type: ignore[arg-type]
            np.testing.assert_allclose(problem.y - less.y, columns @ x, rtol=1e-7, atol=1e-15, err_msg=h.law)
            observed.add(h.law)
    assert {"play", "Bouc–Wen", "cubic"} <= observed


def test_user_effect_is_found_in_a_motion(toy: object, tmp_path: Path) -> None:
    """The effect is found from link-side encoders and written as a term; with the term in the cell nothing is found."""
    recording, load, cell = simulate_vertical_joint(tmp_path)
    law, shape = TOY.joint_laws[0], np.array([0.3 * np.abs(load).max()])
    more = 2e-6 * law.columns(shape, JointLoading(load[:, 0]))
    noise = 5e-6 * np.random.default_rng(2).normal(size=load.shape)
    other = replace(recording, q_secondary=recording.q + load / 2e6 + more + noise)

    def diagnosed(terms: tuple[StiffnessTerm, ...]) -> tuple[selection_pipeline.DiagnosisResult, DiagnosisProblem]:
        problem, catalogue, *_ = motion_channels.build_motion_problem(
            other, cell, "link", np.random.default_rng(0), terms=terms
        )  # type: ignore[arg-type]
        own = replace(catalogue, hypotheses=tuple(h for h in catalogue.hypotheses if h.effect in OWN))
        return selection_pipeline.diagnose_problem(
            problem, own, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
        ), problem

    OWN = (TOY.name, "joint_backlash", "joint_hysteresis")
    found, _ = diagnosed(())
    assert [(f.effect, f.location) for f in found.findings] == [(TOY.name, "joint:1")]
    term = found.findings[0].correction
    assert isinstance(term, StiffnessTerm)
    again, _ = existing_terms.diagnose_with_known_terms((term,), diagnosed)
    assert again.verdict == "consistent"
    assert "count as known: joint_jelly joint:1" in again.notes[-1]


def test_terms_not_used_by_a_channel_are_reported() -> None:
    """A link term in motions, or a balancer term in poses, has no effect there; no message may state that it was
    compensated.

    The torque of a balancer loads neither the gear nor the motor in a motion.
    """
    play = StiffnessTerm("joint_backlash", "joint:2", {"half_gap_arcmin": 1.0})
    link = StiffnessTerm("link_compliance", "link:3", {"EI_Nm2": 1e7})
    across = StiffnessTerm("joint_coupling", "joint:4-5", {})
    balancer = StiffnessTerm("gravity_compensator", "joint:2", {})
    assert [existing_terms.is_known_in_motions(t) for t in (play, link, across, balancer)] == [True, False, False, True]
    assert [existing_terms.is_known_in_torques(t) for t in (play, link, across, balancer)] == [
        False,
        False,
        False,
        True,
    ]
    assert [existing_terms.is_known_in_poses(t) for t in (play, link, balancer)] == [True, True, False]
    d = cast("selection_pipeline.DiagnosisResult", Noted())
    known: list[tuple[StiffnessTerm, ...]] = []

    def look(terms: tuple[StiffnessTerm, ...]) -> tuple[selection_pipeline.DiagnosisResult, DiagnosisProblem]:
        known.append(terms)
        return d, cast("DiagnosisProblem", None)

    output, _ = existing_terms.diagnose_with_known_terms((play, link), look, existing_terms.is_known_in_motions)
    assert known == [(play,)]
    assert output.notes == (
        "before",
        "the cell's own terms that this kind of recording does not count: link_compliance link:3",
        "the cell's own terms count as known: joint_backlash joint:2",
    )


def moving() -> Recording:
    """Simulate all channels of a motion of the shipped arm without any effect: joints, link-side encoders, torques,
    TCP."""
    cell, rng = load_cell(CELL), np.random.default_rng(11)
    assert cell.stiffness is not None
    t, q, v, a = build_fourier_motion(6, rng, periods=2, rate=50.0)
    q, v, a = 0.9 * q + np.radians([0, -90, 100, 0, 60, 0]), 0.9 * v, 0.9 * a
    tau = load_dynamics(cell).compute_torque(q, v, a)
    bent = q - tau / cell.stiffness.joints
    tip = load_robot(cell).compute_fk(bent, cell.tool.T_flange_tcp)[:, :3, 3]
    noisy = tau + 0.01 * np.abs(tau).max(axis=0) * rng.normal(size=tau.shape)
    return build_motion_recording(t, q, v, noisy, q_secondary=bent, position=tip)


@pytest.mark.parametrize("channel", ["link", "tip", "torque"])
def test_motion_findings_are_compensated_by_a_cell_that_contains_them(channel: motion_channels.MotionChannel) -> None:
    """For every effect of the registry: a correction in the cell changes the readings by the columns of its law."""
    cell, recording = load_cell(CELL), moving()
    assert cell.stiffness is not None
    cell = replace(cell, stiffness=replace(cell.stiffness, terms=()))

    def made(
        terms: tuple[StiffnessTerm, ...], kinematics: KinematicCorrections | None = None
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        rng, holding = np.random.default_rng(0), replace(cell, kinematics=kinematics)
        return motion_channels.build_motion_problem(recording, holding, channel, rng, terms=terms)[:2]

    problem, catalogue = made(())
    observed: dict[str, str] = {}
    for h in catalogue.hypotheses:
        if (h.effect, h.law) in observed.items():
            continue  # one joint per law
        columns = h.columns(h.shapes[-1])
        size = 30.0 if channel == "torque" else 1e-5  # N·m; rad or m
        x = size / np.abs(columns).max(axis=(0, 1)) * np.arange(1.0, columns.shape[2] + 1.0)
        found = h.correction(x, h.shapes[-1])
        if found is None or isinstance(found, RecordCorrection):
            assert h.effect in NO_FILE, h.name
            continue
        elastic = isinstance(found, StiffnessTerm)
        less, _ = made((found,) if elastic else (), None if elastic else KinematicCorrections((found,)))
        off, moved = problem.y - less.y, columns @ x
        # for the TCP, springs are fitted first; torques are weighted by a newly estimated noise
        assert np.abs(off - moved).max() < (0.05 if channel != "link" else 1e-6) * np.abs(moved).max(), h.law
        observed[h.effect] = h.law
    wanted = {"torque": {"gravity_compensator"}}.get(channel, {"joint_backlash", "joint_creep", "transmission_error"})
    assert wanted <= set(observed)


# --- complete commands --------------------------------------------------------------------------------------


def simulate_one_sided_joint() -> Recording:
    """Simulate poses of an arm whose joint 3 is softer on one side: a sin(2 q₃) τ₃ under weight; noise 20 µm."""
    cell, robot, masses = six_joints()
    assert cell.stiffness is not None
    a = 0.5 / cell.stiffness.joints[2]

    def delta(q: Array) -> Array:
        tau = compute_gravity_torque(robot, masses, robot.compute_state(q, cell.tool.T_flange_tcp, bodies=True))[0]
        out = np.zeros_like(q)
        out[:, 2] = a * np.sin(2.0 * q[:, 2]) * tau[:, 2]
        return out

    return measure(delta=delta, noise=2e-5)


def simulate_backlash_motion() -> Recording:
    """Simulate link-side encoders of a moving arm with a play operator at joint 1, which weight does not load to one
    side; noise 50 µrad."""
    cell = load_cell(CELL)
    assert cell.stiffness is not None
    rng = np.random.default_rng(3)
    t, q, v, a = build_fourier_motion(6, rng, periods=4)
    q = 0.5 * q + np.radians([0, -90, 100, 0, 60, 0])
    load = -load_dynamics(cell).compute_torque(q, 0.5 * v, 0.5 * a)
    law = registry.EFFECTS["joint_hysteresis"].joint_laws[0]
    first = np.zeros(len(t), np.int64)
    first[0] = 1
    twist = load / cell.stiffness.joints
    shape = np.array([0.3 * np.abs(load[:, 0]).max()])
    twist[:, 0] += (
        2.0 / cell.stiffness.joints[0] * law.columns(shape, JointLoading(load[:, 0], segment_start=first))[:, 0]
    )
    return build_motion_recording(t, q, 0.5 * v, q_secondary=q + twist + 5e-5 * rng.normal(size=q.shape))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "cell", "found"),
    [
        (simulate_one_sided_joint, TRACKED, "joint_pose_dependent_stiffness"),
        (simulate_backlash_motion, CELL, "joint_hysteresis"),
    ],
)
def test_written_finding_in_the_cell_leaves_nothing(make: object, cell: Path, found: str, tmp_path: Path) -> None:
    """With the commands: diagnose, copy its stiffness.yaml into the cell, run map, and diagnose again without a
    finding."""
    write_recording(tmp_path / "rec", make())  # type: ignore[operator]
    shutil.copytree(cell, tmp_path / "cell")
    words = ["--quiet", "-o"]
    assert main(["diagnose", str(cell), str(tmp_path / "rec"), *words, str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found in {f["effect"] for f in result["findings"]}
    written = load_stiffness(tmp_path / "out" / "stiffness.yaml")
    assert found in {t.effect for t in written.terms}
    shutil.copy(tmp_path / "out" / "stiffness.yaml", tmp_path / "cell" / "stiffness.yaml")
    assert (
        main(["map", str(tmp_path / "cell"), *words, str(tmp_path / "map"), "--step", "500", "--collision", "none"])
        == 0
    )
    assert main(["diagnose", str(tmp_path / "cell"), str(tmp_path / "rec"), *words, str(tmp_path / "again")]) == 0
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert again["verdict"] == "consistent"
    assert not [f for f in again["findings"] if f["effect"] != "geometric_stiffness"]
    if "geometric_stiffness" in {t.effect for t in written.terms}:  # K_C that the cell states is no finding
        assert again["findings"] == []
