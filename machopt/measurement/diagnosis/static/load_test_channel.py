"""Channel of load tests: displacement of the TCP under a known load. It shows all kinds of compliance.

y is the measured displacement minus the known nonlinear part (K_C of load and weight, exact). The base has the six
joint compliances and, from the second session on, a force gain per session, because every recording has such gain
errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_joint_location
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.parameter_keys import build_joint_spring_key
from machopt.data_types.stiffness import LEAST_STIFFNESS, ArmStiffness, StiffnessTerm
from machopt.effects import prior_scales, registry
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types import load_resolution
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
    UntestableEffect,
)
from machopt.measurement.diagnosis.data_types.pose_visits import (
    count_replicated_readings,
    label_unbroken_runs,
    nest_labels,
)
from machopt.measurement.diagnosis.data_types.static_readings import GearLoadHistory, StaticReadings
from machopt.measurement.diagnosis.effect_columns import (
    gravity_compensator,
    joint_torque,
    sensor_errors,
    structural_compliance,
    thermal_drift,
)
from machopt.measurement.diagnosis.model_selection import unmodelled_slip_and_external_forces
from machopt.measurement.diagnosis.static import bearing_tilt, unknown_link_masses
from machopt.measurement.diagnosis.static.loaded_equilibrium_terms import compute_nonlinear_displacement
from machopt.measurement.estimation.error_clusters import build_error_clusters
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity

Ints = NDArray[np.int64]
GEOMETRIC = "K_C"
RIGID = 1e18  # N·m/rad, numerically rigid springs
UNKNOWN_MASS_REASON = "whose weight stiffens joints like a balancer does"


def build_load_test_problem(
    recording: Recording,
    tests: LoadTestExperiment,
    robot: Robot,
    T_flange_tcp: Array,
    masses: RobotMasses | None,
    compliance: Array | None = None,
    memo: dict[str, GearLoadHistory] | None = None,
    terms: Array | None = None,
    alone: Array | None = None,
    bodies: Array | None = None,
    down: Array | None = None,
) -> tuple[DiagnosisProblem, HypothesisCatalogue, StaticReadings]:
    """Build equations and hypotheses of a load test.

    Args:
        recording: Load tests after the corrections of the recording.
        tests: Load-test experiment: the recording in base axes with arm states.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        masses: Link and tool masses; None if the URDF has none for the long links.
        compliance: (6,) joint compliance found earlier, rad/(N·m); None: by least absolute deviations.
        memo: Cache of load histories of the same tests.
        terms: (N, 6) displacement by the cell's own terms, m and rad; None without terms.
        alone: (6,) joint compliance fitted without other effects, rad/(N·m); None: ``compliance``.
        bodies: (N, 6, 6) compliance at the TCP of bodies found earlier; None without bodies.
        down: (3,) gravity in base_link, m/s²; with it unknown link weights enter the base model.

    Returns:
        Problem, hypotheses, and the prepared readings.

    Raises:
        InputError: The springs are unstable under the loads.
    """
    if terms is not None:
        tests = replace(tests, measured=tests.measured - terms[:, : tests.dimensions])
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    A = tests.response()
    c = fit_least_absolute_deviations(A, tests.measured, load) if compliance is None else compliance
    curved = compute_nonlinear_displacement(tests, robot, T_flange_tcp, masses, np.clip(c, 0.0, 1.0 / LEAST_STIFFNESS))
    known = np.zeros_like(tests.measured) if curved is None else curved
    y = tests.measured - known
    c = np.clip(
        fit_least_absolute_deviations(A, y, load) if compliance is None else compliance, 0.0, 1.0 / LEAST_STIFFNESS
    )
    labels = build_error_clusters(tests)
    readings = replace(
        build_load_test_readings(recording, tests, robot, T_flange_tcp, masses, c, memo),
        springs_only_compliance=alone,
        bodies=bodies,
    )
    predicted = A @ c
    gains = [predicted * (readings.session == s)[:, None] for s in range(1, int(readings.session.max()) + 1)]
    base = np.concatenate([A, *(g[:, :, None] for g in gains)], axis=2)
    unknowns = [
        BaseUnknown(
            name=f"joint {j}",
            unit="rad/(N·m)",
            lower=0.0,
            location=format_joint_location(j),
            key=build_joint_spring_key(j),
        )
        for j in range(1, readings.joint_count + 1)
    ]
    unknowns += [
        BaseUnknown(
            name=f"force gain, session {_describe_session(recording, s)}",
            unit="1",
            location="sensor:force",
            prior=prior_scales.FORCE_GAIN.scale,
            session=s,
        )
        for s in range(1, len(gains) + 1)
    ]
    if curved is not None:  # known except for the compliances that it depends on
        base = np.concatenate([base, curved[:, :, None]], axis=2)
        unknowns.append(
            BaseUnknown(
                name=GEOMETRIC, unit="1", location="arm", prior=prior_scales.GEOMETRIC_STIFFNESS.scale, is_stated=False
            )
        )
    if unknown_link_masses.list_links_without_mass(masses) and down is not None:
        weights, moments = unknown_link_masses.build_link_moment_columns(
            readings, down, unknown_link_masses.list_unknown_moments(masses)
        )
        base = np.concatenate([base, weights], axis=2)
        unknowns += moments
    u = tests.uncertainty
    families = [
        CoordinateFamily(
            name="translation", columns=(0, 1, 2), unit="mm", factor=1e3, stated_uncertainty=u.displacement
        )
    ]
    if tests.dimensions == 6:
        families.append(
            CoordinateFamily(name="rotation", columns=(3, 4, 5), unit="mrad", factor=1e3, stated_uncertainty=u.rotation)
        )
    replicate = label_replicates(tests, recording)
    problem = DiagnosisProblem(
        channel="deflection",
        y=y,
        base=base,
        unknowns=tuple(unknowns),
        families=tuple(families),
        group=tests.pose,
        visit=readings.visit,
        cycle=nest_labels(readings.visit, tests.cycle) if labels.has_cycle else readings.visit,
        session=readings.session,
        replicate=replicate,
        order=np.arange(len(tests), dtype=float) if recording.time is None else recording.time,
        repeat=select_replicate_visits(recording, replicate, readings.visit),
        line=tests.line,
        row=np.arange(1, len(tests) + 1),
        scale=predicted,
        subtracted_displacement=known if curved is not None else None,
        visits_for_cycles=not labels.has_cycle,
    )
    tried = build_load_test_catalogue(readings, curved)
    laws = (*tried.hypotheses, *unmodelled_slip_and_external_forces.build_interface_hypotheses(readings))
    return (
        problem,
        replace(tried, hypotheses=laws, uncatalogued_hypotheses=tuple(bearing_tilt.build_bearing_hypotheses(readings))),
        readings,
    )


def compute_body_compliance(
    robot: Robot, T_flange_tcp: Array, q: Array, bodies: Sequence[StiffnessTerm]
) -> Array | None:
    """Compute the compliance at the TCP of bodies alone.

    Args:
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        q: (N, 6) joint angles, rad.
        bodies: Body terms.

    Returns:
        (N, 6, 6); None without bodies.
    """
    if not bodies:
        return None
    stiff = ArmStiffness(joints=np.full(q.shape[1], RIGID), terms=tuple(bodies))
    arm = ArmElasticity(robot, T_flange_tcp, stiff).evaluate(q)
    return np.stack([arm.compute_twist(np.broadcast_to(w, (len(q), 6))) for w in np.eye(6)], axis=2)


def build_load_test_readings(
    recording: Recording,
    tests: LoadTestExperiment,
    robot: Robot,
    T_flange_tcp: Array,
    masses: RobotMasses | None,
    compliance: Array,
    memo: dict[str, GearLoadHistory] | None = None,
) -> StaticReadings:
    """Build the prepared readings of a load test; see :func:`build_load_test_problem`.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        tests: Load-test experiment: the recording in base axes with arm states.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        masses: Link and tool masses; None if unknown.
        compliance: (6,) joint compliance, rad/(N·m).
        memo: Cache of load histories of the same tests.

    Returns:
        The readings.
    """
    visit = label_unbroken_runs([tests.pose, tests.session])
    _, session = np.unique(tests.session, return_inverse=True)
    return StaticReadings(
        recording=recording,
        robot=robot,
        T_flange_tcp=T_flange_tcp,
        masses=masses,
        state=tests.state,
        wrench=tests.wrench,
        dimensions=tests.dimensions,
        is_difference=True,
        compliance=compliance,
        session=session.reshape(-1),
        visit=visit,
        cycle=tests.cycle,
        histories={} if memo is None else memo,
    )


def build_load_test_catalogue(r: StaticReadings, curved: Array | None) -> HypothesisCatalogue:
    """Build every hypothesis that load tests can show.

    Args:
        r: Prepared readings.
        curved: (N, D) nonlinear displacement (K_C); None if the springs are unstable.

    Returns:
        The catalogue with untestable effects.
    """
    out: list[EffectHypothesis] = []
    missing: list[UntestableEffect] = []
    drives = np.quantile(np.abs(r.load_torque), 0.9, axis=0)
    for j in range(r.joint_count):
        if drives[j] < thresholds.SHARES.rank * drives.max():
            missing.append(
                UntestableEffect("joint_nonlinear_stiffness", format_joint_location(j + 1), "no load turns this joint")
            )
            continue
        for kind in registry.select_joint_torque_effects():
            laws, reason = joint_torque.build_joint_hypotheses(r, j, kind)
            out += laws
            if reason:
                missing.append(UntestableEffect(kind.name, format_joint_location(j + 1), reason))
    if unknown_link_masses.list_links_without_mass(r.masses):
        why = f"{unknown_link_masses.describe_missing_masses(r.masses)}, {UNKNOWN_MASS_REASON}"
        missing.append(UntestableEffect("gravity_compensator", format_joint_location(2), why))
    else:
        out += gravity_compensator.build_load_test_hypotheses(r)
    out += [*joint_torque.build_load_test_couplings(r), *structural_compliance.build_structure_hypotheses(r)]
    out += sensor_errors.build_load_test_sensor_hypotheses(r)
    if curved is None:
        missing.append(
            UntestableEffect("geometric_stiffness", "arm", "the springs found do not hold the recorded loads")
        )
    offered = {h.name for h in out}
    for effect in registry.select_angle_effects():
        if (effect.file_word, effect.search_places[0]) not in offered:  # an elastic effect may share its word
            why = "it needs no load and cancels in displacements"
            missing.append(UntestableEffect(effect.file_word, effect.search_places[0], why))
    missing.append(UntestableEffect("payload", "tool", "weight cancels in displacements"))
    drift = thermal_drift.build_thermal_hypotheses(r)
    out += drift
    if not drift:
        why = "displacements count from the unloaded state of the same minute, and its duration is unknown"
        missing.append(UntestableEffect("thermal_drift", "environment", why))
    force = np.linalg.norm(r.wrench[:, :3], axis=1)
    axes = {"load": force, "session": r.session.astype(float)}
    if r.recording.branch is not None:
        axes["branch"] = r.recording.branch.astype(float)
    if r.recording.time is not None:
        axes["time"] = r.recording.time
    axes |= {f"q{j + 1}": r.state.q[:, j] for j in range(r.joint_count)}
    return HypothesisCatalogue(tuple(out), tuple(missing), axes)


def _describe_session(recording: Recording, index: int) -> int:
    """Return the label of a session as the file states it; sessions of several files are counted from 1."""
    several = len(recording.files) > 1 and int(recording.session.min()) == 0
    if "session" not in recording.stated_labels or several:
        return index + 1
    return int(np.unique(recording.session)[index])


def select_replicate_visits(recording: Recording, replicate: Ints, visit: Ints) -> Ints | None:
    """Select what replicates are compared between.

    Args:
        recording: Load tests or measured poses.
        replicate: (N,) label of equal pose and load; −1 without one.
        visit: (N,) stay at a pose.

    Returns:
        (N,) load cycles where no pose was visited twice and the recording states cycles; None: the visits.
    """
    if "cycle" not in recording.stated_labels:
        return None
    if count_replicated_readings(replicate, visit) >= thresholds.COUNTS.min_degrees_of_freedom:
        return None
    return nest_labels(visit, recording.cycle)


def label_replicates(tests: LoadTestExperiment, recording: Recording) -> Ints:
    """Label readings of equal pose, load and branch as replicates.

    Args:
        tests: Load-test experiment: the recording in base axes with arm states.
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        (N,) label; −1 for a reading without a replicate.
    """
    out = np.full(len(tests), -1, np.int64)
    branch = np.zeros(len(tests)) if recording.branch is None else recording.branch
    if recording.branch is None:  # rising or falling: the order tells
        size = np.linalg.norm(tests.wrench[:, :3], axis=1)
        for label in np.unique(tests.cycle):
            rows = np.flatnonzero(tests.cycle == label)
            peak = int(np.argmax(size[rows]))
            branch[rows] = np.where(np.arange(len(rows)) <= peak, 1, -1)
    n = 0
    for pose in np.unique(tests.pose):
        rows = np.flatnonzero(tests.pose == pose)
        w = tests.wrench[rows].copy()
        force, moment = np.linalg.norm(w[:, :3], axis=1).max(), np.linalg.norm(w[:, 3:], axis=1).max()
        w /= load_resolution.compute_load_tolerance(
            np.array([force, moment]), thresholds.SHARES.load_tolerance, recording.uncertainty
        )
        is_unlabelled = np.ones(len(rows), bool)
        for k in range(len(rows)):
            if not is_unlabelled[k]:
                continue
            is_same_load = is_unlabelled & (branch[rows] == branch[rows[k]]) & (np.abs(w - w[k]).max(axis=1) < 1.0)
            is_unlabelled[is_same_load] = False
            for same_load_rows in _list_readings_by_cycle_position(
                tests.cycle[rows[is_same_load]]
            ):  # repeated readings within a cycle may differ by creep
                if len(same_load_rows) > 1:
                    out[rows[is_same_load][same_load_rows]] = n
                    n += 1
    return out


def _list_readings_by_cycle_position(cycle: Ints) -> list[Ints]:
    """Return the readings that are the first of their cycle, the second, and so on."""
    seen: dict[int, int] = {}
    turns: list[list[int]] = []
    for k, label in enumerate(cycle.tolist()):
        turn = seen.get(label, 0)
        seen[label] = turn + 1
        if turn == len(turns):
            turns.append([])
        turns[turn].append(k)
    return [np.array(t, np.int64) for t in turns]
