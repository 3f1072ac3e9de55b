"""Alternative explanations with the same compliance matrix over the recorded poses are both stated.

Torsion of a link about its own axis moves the following arm like a tilt of the bearing at its end about that axis. An
elastic coupling of joints 2 and 3 moves the arm like bending of link 2 in the plane of both joints.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnose_bearing_tilt import compute_tilt_displacement, compute_transverse_axis
from test_effects import build_posed_problem

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.effects.protocol import UNCATALOGUED
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.discrimination import open_hypotheses
from machopt.measurement.diagnosis.effect_columns import joint_torque, structural_compliance
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import bearing_tilt
from machopt.numerics.array_types import Array

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 1e-4  # m, largest simulated displacement that the joint springs cannot explain
CELLS = ("kr500_milling", "irb6700_drilling", "s420f_handling", "cutting_cobot")


def build_readings(cell_name: str, seed: int = 0) -> StaticReadings:
    """Simulate twelve poses with four loads (forces and moments) at each, in two sessions."""
    cell = load_cell(ROOT / "cells" / cell_name)
    robot, tool = load_robot(cell), cell.tool.T_flange_tcp
    assert cell.stiffness is not None
    rng = np.random.default_rng(seed)
    q = np.radians([0, -90, 100, 0, 60, 0]) + rng.uniform(-0.5, 0.5, (12, 6))
    q = np.tile(np.repeat(q, 4, axis=0), (2, 1))
    w = np.tile(np.concatenate([rng.uniform(-900, 900, (48, 3)), rng.uniform(-90, 90, (48, 3))], axis=1), (2, 1))
    pose, session, rows = np.tile(np.repeat(np.arange(12), 4), 2), np.repeat(np.arange(2), 48), np.arange(96)
    recording = Recording(
        kind="deflection", source="made up", q=q, pose=pose, cycle=rows, session=session, line=rows, wrench=w
    )
    return StaticReadings(
        recording=recording,
        robot=robot,
        T_flange_tcp=tool,
        masses=load_masses(cell),
        state=robot.compute_state(q, tool, bodies=True),
        wrench=w,
        dimensions=6,
        is_difference=True,
        compliance=1.0 / cell.stiffness.joints,
        session=session,
        visit=session * 12 + pose,
        cycle=rows,
    )


def list_laws(r: StaticReadings) -> list[EffectHypothesis]:
    return [*structural_compliance.build_structure_hypotheses(r), *joint_torque.build_load_test_couplings(r)]


def diagnose(r: StaticReadings, moved: Array) -> DiagnosisResult:
    forms = tuple(bearing_tilt.build_bearing_hypotheses(r))
    tried = HypothesisCatalogue(tuple(list_laws(r)), uncatalogued_hypotheses=forms)
    springs = (r.state.J * r.load_torque[:, None, :]).reshape(-1, 6)
    left = moved - (springs @ np.linalg.lstsq(springs, moved.reshape(-1), rcond=None)[0]).reshape(moved.shape)
    size = LARGEST / np.abs(left[:, :3]).max()
    options = selection_pipeline.DiagnosisOptions()
    return selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved * size), tried, options, np.random.default_rng(0)
    )


def move_by(r: StaticReadings, effect: str, location: str, law: str) -> Array:
    """Return the displacement (N, 6) of a law at the middle of its shape grid, with equal largest displacement for
    each coefficient."""
    h = next(h for h in list_laws(r) if (*h.name, h.law) == (effect, location, law))
    columns = h.columns(h.shapes[len(h.shapes) // 2])
    return np.asarray(columns @ (1.0 / np.abs(columns).max(axis=(0, 1))))


def is_never_one_name(found: DiagnosisResult, joint: int) -> bool:
    """Return whether nothing is named, or the bearing of the joint (1-based) is among the alternatives of each
    finding."""
    assert found.findings or found.verdict == "unexplained"
    return all((UNCATALOGUED, f"joint:{joint}") in f.one_of for f in found.findings)


@pytest.mark.proof
@pytest.mark.parametrize(
    ("cell_name", "joint", "way"),  # each cell occurs twice, and each bearing is tested on two cells
    [
        (cell_name, *bearing)
        for n, bearing in enumerate([(2, 0.7), (2, 2.0), (3, 1.2), (1, 1.5)])
        for cell_name in (CELLS[n], CELLS[n - 1])
    ],
)
def test_soft_bearing_never_gets_a_single_name(cell_name: str, joint: int, way: float) -> None:
    r = build_readings(cell_name)
    assert is_never_one_name(
        diagnose(r, compute_tilt_displacement(r, joint - 1, compute_transverse_axis(r, joint - 1, way))), joint
    )


@pytest.mark.slow
@pytest.mark.parametrize("cell_name", [pytest.param("kr500_milling", marks=pytest.mark.proof), "cutting_cobot"])
def test_link_torsion_is_named_together_with_the_equivalent_bearing(cell_name: str) -> None:
    r = build_readings(cell_name)
    found = diagnose(r, move_by(r, "link_compliance", "link:2", "twists"))
    assert found.verdict == "explained"
    assert [(f.effect, f.location) for f in found.findings] == [("link_compliance", "link:2")]
    assert (UNCATALOGUED, "joint:2") in found.findings[0].one_of or (UNCATALOGUED, "joint:3") in found.findings[
        0
    ].one_of
    assert "outside the catalogue" in found.sentence
    rivals = [n for n in found.findings[0].rivals if n.effect == UNCATALOGUED]
    assert rivals
    assert all(n.standing == "not excluded" and n.fit is None for n in rivals)


@pytest.mark.proof
@pytest.mark.parametrize("cell_name", ["irb6700_drilling", "s420f_handling"])
def test_elastic_coupling_and_equivalent_link_are_both_stated(cell_name: str) -> None:
    r = build_readings(cell_name)
    found = diagnose(r, move_by(r, "joint_coupling", "joint:2-3", "elastic coupling"))
    (finding,) = found.findings
    assert {("joint_coupling", "joint:2-3"), ("link_compliance", "link:2")} <= set(finding.one_of)
    assert "--discriminate" in found.next_experiment


@pytest.mark.proof
@pytest.mark.parametrize("cell_name", ["kr500_milling", "cutting_cobot"])
def test_link_without_an_equal_explanation_keeps_its_single_name(cell_name: str) -> None:
    r = build_readings(cell_name)
    found = diagnose(r, move_by(r, "link_compliance", "link:2", "bends"))
    assert [f.one_of for f in found.findings] == [(("link_compliance", "link:2"),)]


def build_finding(effect: str, location: str, *rivals: tuple[str, str]) -> SimpleNamespace:
    """Return a stub finding with the fields that the experiment design reads; an unnamed form has no fit."""
    fit = SimpleNamespace(coefficients=[1e-7], shape=[], correction=None)
    fitted = [(effect, location), *(name for name in rivals if name[0] != UNCATALOGUED)]
    every = [
        SimpleNamespace(effect=e, location=place, name=(e, place), law="law", fit=fit if (e, place) in fitted else None)
        for e, place in ((effect, location), *rivals)
    ]
    return SimpleNamespace(**{**vars(every[0]), "one_of": [(effect, location), *rivals], "rivals": every[1:]})


def test_unnamed_form_neither_starts_nor_hides_a_finding(tmp_path: Path) -> None:
    form = (UNCATALOGUED, "joint:2")
    link, base = build_finding("link_compliance", "link:1", form), build_finding("base_compliance", "base")
    sets, notes = open_hypotheses._build_rival_sets(SimpleNamespace(findings=[link, base]), tmp_path)  # type: ignore[arg-type]
    assert [one.candidate_laws[0].location for one in sets] == ["link:1", "base"]
    assert [note for note in notes if "unnamed joint:2" in note and "link:1" in note] == notes
    tool = build_finding("tool_compliance", "tool", ("link_compliance", "link:6"))
    sets, _ = open_hypotheses._build_rival_sets(SimpleNamespace(findings=[link, base, tool]), tmp_path)  # type: ignore[arg-type]
    assert [one.candidate_laws[0].location for one in sets] == ["tool"]
