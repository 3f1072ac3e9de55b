"""Channel of measured TCP poses at known joint angles: absolute position. It shows geometry, gravity and thermal
effects.

y is the measured TCP (or reflector) minus the encoder model. Known effects are exact: finite rotations, the
corrections of the cell's kinematics.yaml, and the equilibrium under weight and load at a first fit (with K_C). Base
columns: joint compliances under weight and load; with ``registration: fit`` a small twist of each tracker frame about
the centroid of the points; the position of each target in the flange. Coefficients of compliances and targets are
totals. The frame twist is relative to a first robust fit.

Nominal model: :mod:`machopt.measurement.diagnosis.static.measured_pose_model`. Hypotheses:
:mod:`machopt.measurement.diagnosis.static.measured_pose_hypothesis_catalogue`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects.kinematic_corrections import extend_kinematics
from machopt.effects.structure import as_built_joint_frames as structure_link_geometry
from machopt.errors import RecordingError
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types import load_resolution, reflectors_and_tracker_frames
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    HypothesisCatalogue,
)
from machopt.measurement.diagnosis.data_types.pose_visits import label_unbroken_runs
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.measurement.diagnosis.effect_columns import as_built_joint_frames, existing_terms
from machopt.measurement.diagnosis.static import inclinometer_equations, link_mass_columns
from machopt.measurement.diagnosis.static.measured_pose_hypothesis_catalogue import build_measured_pose_catalogue
from machopt.measurement.diagnosis.static.measured_pose_model import CorrectedArm, NominalPoseModel
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]


def build_measured_pose_problem(
    recording: Recording,
    cell: Cell,
    robot: Robot,
    masses: RobotMasses | None,
    rng: np.random.Generator,
    terms: tuple[StiffnessTerm, ...] = (),
    found: Mapping[int, float] | None = None,
    fixed_joints: frozenset[int] = frozenset(),
    about: tuple[KinematicCorrection, ...] = (),
) -> tuple[DiagnosisProblem, HypothesisCatalogue, tuple[str, ...]]:
    """Build equations and hypotheses of measured TCP poses: y = p_measured − p(q) ≈ B x, with base columns B.

    Not valid for a tracker frame rotated by more than some degrees relative to base_link; register it first.

    Args:
        recording: N measured poses after the corrections of the recording.
        cell: Cell with TCP, stiffness (start of the first fit) and kinematic corrections.
        robot: Kinematic model for the joint angles ``recording.q``.
        masses: Link and tool masses; None if the URDF has none: no deflection by weight.
        rng: Not used; part of the common signature of channels.
        terms: Terms of the cell's stiffness that count as known.
        found: Compliance of joints (1-based) with the effects found so far, rad/(N·m); None before the first
            search.
        fixed_joints: Joints (1-based) with the cell's spring, not refitted.
        about: Corrections found so far. The model is linearised about them, and their effect remains in y
            through the columns of their laws.

    Returns:
        Problem (D = 3, or 6 with rotation vectors if quaternions are recorded, plus 2 with an inclinometer),
        hypotheses, notes.

    Raises:
        InputError: Another kind of recording, or no measured positions.

    Source:
        Klimchik et al. arXiv 1311.6810 (elasto-static calibration: y = J Δπ + J C Jᵀ w).
    """
    if recording.kind != "absolute" or recording.position is None:
        raise RecordingError(
            f"is a recording of kind {recording.kind!r}; measured poses are of kind 'absolute' with x_mm, y_mm, z_mm",
            file=recording.source,
        )
    there = _build_corrected_arm(cell, about)
    model = NominalPoseModel(recording, cell, robot, masses, fixed_joints, there)
    frame = model.fit_base()
    unseen = model.find_undetermined_springs(frame)
    if not unseen <= fixed_joints:
        model = NominalPoseModel(recording, cell, robot, masses, fixed_joints | unseen, there)
        frame = model.fit_base()
    state, p, R = model.predict(frame)
    y = model.residual(frame, p, R)
    base, unknowns = model.columns(state, p)
    totals = model.build_start_values(unknowns, frame)
    y = y + base @ totals
    springs = frame.compliance.copy()
    for joint, compliance in (found or {}).items():
        if joint not in model.kept_springs:
            springs[joint - 1] = compliance
    readings = replace(
        model.build_readings(state, frame, springs),
        inclinometer=inclinometer_equations.find_inclinometer(recording, cell),
    )
    apart = _describe_undetermined_frames(model, base, unknowns)
    if readings.inclinometer is not None:
        more = inclinometer_equations.build_inclinometer_equations(model, frame, state, readings.inclinometer, unknowns)
        y = np.concatenate([y, more.y], axis=1)
        base = more.append_columns(base)
        unknowns += more.unknowns
    if there is not None:
        y = y + _compute_stated_displacement(readings, about)
    y = y - existing_terms.compute_known_pose_displacement(readings, terms)
    visit, replicate = _build_visit_labels(recording, readings.wrench)
    stated = recording.uncertainty
    families = [
        CoordinateFamily(
            name="translation", columns=(0, 1, 2), unit="mm", factor=1e3, stated_uncertainty=stated.displacement
        )
    ]
    if model.D == 6:
        families.append(
            CoordinateFamily(
                name="rotation", columns=(3, 4, 5), unit="mrad", factor=1e3, stated_uncertainty=stated.rotation
            )
        )
    if readings.inclinometer is not None:
        families.append(
            CoordinateFamily(
                name=inclinometer_equations.FAMILY,
                columns=(model.D, model.D + 1),
                unit="mrad",
                factor=1e3,
                stated_uncertainty=stated.tilt,
                is_separate_instrument=True,
            )
        )
    loaded = bool(np.abs(readings.wrench).max() > 0.0)
    problem = DiagnosisProblem(
        channel="position",
        y=y,
        base=base,
        unknowns=tuple(unknowns),
        families=tuple(families),
        group=recording.pose,
        visit=visit,
        cycle=visit,
        session=readings.session,
        replicate=replicate,
        line=recording.line,
        row=np.arange(1, len(recording) + 1),
        scale=readings.compute_displacement(readings.wrench) if loaded else None,
        time=recording.time,
        order=np.arange(len(recording), dtype=float) if recording.time is None else recording.time,
        present=None
        if readings.inclinometer is None
        else inclinometer_equations.mark_measured_coordinates(model.D, readings.inclinometer),
    )
    readings = replace(readings, visit=visit, cycle=visit)
    catalogue = replace(
        build_measured_pose_catalogue(readings, problem),
        uncertain_inputs=link_mass_columns.build_link_mass_inputs(readings),
    )
    return problem, catalogue, (*model.build_notes(frame), *apart)


def _build_corrected_arm(cell: Cell, found: tuple[KinematicCorrection, ...]) -> CorrectedArm | None:
    """Return the cell's arm with found corrections; None without corrections."""
    if not found:
        return None
    kinematics = extend_kinematics(cell.kinematics, found)
    return CorrectedArm(load_robot(replace(cell, kinematics=kinematics)), kinematics)


def _compute_stated_displacement(r: StaticReadings, found: tuple[KinematicCorrection, ...]) -> Array:
    """Return the displacement (N, D) m, rad of corrections by the columns of their laws.

    The slope of the nominal model differs by the effect of weight on a rotated arm (2 % of an offset of a large joint
    2). The next fit multiplies these columns, so y must be consistent with them.
    """
    frames = [c for c in found if c.effect == structure_link_geometry.EFFECT.name]
    turned = build_encoder_correction(KinematicCorrections(tuple(c for c in found if c not in frames)))
    out = r.project_to_measured(np.zeros((len(r), 6)), BODY_BEHIND_FLANGE)
    if turned is not None:
        delta = turned.compute_correction(r.state.q)
        out = out + sum(r.lift_joint_twist(j, delta[:, j : j + 1])[:, :, 0] for j in range(r.joint_count))
    for c in frames:
        at = structure_link_geometry.read_frame_offset(c.parameters)
        out = out + as_built_joint_frames.compute_frame_columns(r, c.location) @ np.concatenate([at.shift, at.turn])
    return np.asarray(out)


def _build_visit_labels(recording: Recording, wrench: Array) -> tuple[Ints, Ints]:
    """Return the visit of each reading, an unbroken run of rows, and replicate labels (same pose, same load)."""
    stand, target = (
        reflectors_and_tracker_frames.index_tracker_frames(recording),
        reflectors_and_tracker_frames.index_reflectors(recording),
    )
    labels = [recording.session, recording.pose, stand]
    # without the column all rows have the same cycle: what is read during one stay is no replicate
    visit = label_unbroken_runs([*labels, recording.cycle] if "cycle" in recording.stated_labels else labels)
    size = np.array([max(float(np.abs(wrench[:, a : a + 3]).max()), 1e-9) for a in (0, 3)])
    w = wrench / load_resolution.compute_load_tolerance(size, thresholds.SHARES.load_tolerance, recording.uncertainty)
    if np.abs(wrench).max() == 0.0:
        w = np.zeros_like(wrench)
    replicate = np.full(len(recording), -1, np.int64)
    n = 0
    # replicates may be from different tracker stations: the frame is fitted
    seen = np.unique(np.stack([recording.pose, target], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    for pose in range(int(seen.max()) + 1):
        rows = np.flatnonzero(seen == pose)
        while len(rows):
            near = np.abs(w[rows] - w[rows[0]]).max(axis=1) < 1.0
            if near.sum() > 1:
                replicate[rows[near]] = n
                n += 1
            rows = rows[~near]
    return visit, replicate


def _describe_undetermined_frames(
    model: NominalPoseModel, base: Array, unknowns: Sequence[BaseUnknown]
) -> tuple[str, ...]:
    """Return notes on tracker frames and reflectors that only nominal positions determine."""
    count = model.count_undetermined_directions(base, unknowns)
    if not count or not model.recording.targets:
        return ()
    return (
        f"in these poses {count} combination{'' if count == 1 else 's'} of tracker frames and reflectors' places "
        "cannot be separated: nominal places fix them; poses with other flange orientations would show them",
    )
