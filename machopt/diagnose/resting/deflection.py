"""Load tests: how far the TCP moves under a known load; the channel that shows elasticity of every kind.

y is the measured displacement less what is known beyond the linear law (K_C of load and weight, exact); the base is
the six joint compliances and, from the second session on, a gain of the force per session, which no recording of a
robot is free of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws import at_beside, at_body, at_heat, at_joint, at_sensor
from machopt.diagnose.nouns import loads
from machopt.diagnose.nouns.problem import Catalogue, Family, Hypothesis, Problem, Unknown, Untestable
from machopt.diagnose.nouns.readings import History, Readings
from machopt.diagnose.resting import bearings, unweighed
from machopt.diagnose.resting.loaded import beyond_linear
from machopt.diagnose.search import unnamed
from machopt.domain.location import joint_at
from machopt.domain.parameters import joint_spring
from machopt.domain.recording import Recording
from machopt.domain.stiffness import LEAST_STIFFNESS, Stiffness, Term
from machopt.effects import registry
from machopt.estimate.clusters import clusters
from machopt.estimate.experiment import Experiment
from machopt.estimate.robust import start
from machopt.model.elastic import ArmElasticity
from machopt.model.robot import Masses, Robot

Ints = NDArray[np.int64]
GEOMETRIC = "K_C"
RIGID = 1e18  # N·m/rad, of springs that give nothing
UNWEIGHED = "whose weight stiffens joints like a balancer does"


def build(
    recording: Recording,
    tests: Experiment,
    robot: Robot,
    T_flange_tcp: Array,
    masses: Masses | None,
    compliance: Array | None = None,
    memo: dict[str, History] | None = None,
    terms: Array | None = None,
    alone: Array | None = None,
    bodies: Array | None = None,
    down: Array | None = None,
) -> tuple[Problem, Catalogue, Readings]:
    """Equations and hypotheses of a load test.

    Args:
        recording: kind "deflection", as corrected by the record checks.
        tests: the same in base axes.
        robot, T_flange_tcp: the arm.
        masses: of links and tool; None where the URDF has none of the long links.
        compliance: (6,) rad/(N·m) found before; None: by least absolute deviations.
        memo: histories of an earlier call for the same tests.
        terms: (N, 6) m, rad, what the cell's own terms explain; None: it has none.
        alone: (6,) rad/(N·m) found with nothing beside the springs; None: ``compliance`` is.
        bodies: (N, 6, 6) compliance at the TCP of bodies found before; None: none was.
        down: (3,) m/s² in base_link, gravity; with it weight that no file tells is in the base model.

    Raises:
        InputError: springs that hold no load at all.
    """
    if terms is not None:
        tests = replace(tests, measured=tests.measured - terms[:, : tests.dimensions])
    load = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    A = tests.response()
    c = start(A, tests.measured, load) if compliance is None else compliance
    curved = beyond_linear(tests, robot, T_flange_tcp, masses, np.clip(c, 0.0, 1.0 / LEAST_STIFFNESS))
    known = np.zeros_like(tests.measured) if curved is None else curved
    y = tests.measured - known
    c = np.clip(start(A, y, load) if compliance is None else compliance, 0.0, 1.0 / LEAST_STIFFNESS)
    labels = clusters(tests)
    readings = replace(readings_of(recording, tests, robot, T_flange_tcp, masses, c, memo), alone=alone, bodies=bodies)
    predicted = A @ c
    gains = [predicted * (readings.session == s)[:, None] for s in range(1, int(readings.session.max()) + 1)]
    base = np.concatenate([A, *(g[:, :, None] for g in gains)], axis=2)
    unknowns = [
        Unknown(name=f"joint {j}", unit="rad/(N·m)", lower=0.0, location=joint_at(j), key=joint_spring(j))
        for j in range(1, 7)
    ]
    unknowns += [
        Unknown(
            name=f"force gain, session {s + 1}", unit="1", location="sensor:force", prior=calibrated.RESTING.force_gain
        )
        for s in range(1, len(gains) + 1)
    ]
    if curved is not None:  # known but for the compliances in it
        base = np.concatenate([base, curved[:, :, None]], axis=2)
        unknowns.append(Unknown(name=GEOMETRIC, unit="1", location="arm", prior=calibrated.RESTING.known_to))
    if unweighed.missing(masses) and down is not None:
        weights, moments = unweighed.columns(readings, down, unweighed.left_open(masses))
        base = np.concatenate([base, weights], axis=2)
        unknowns += moments
    u = tests.uncertainty
    families = [Family(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3, stated=u.displacement)]
    if tests.dimensions == 6:
        families.append(Family(name="rotation", columns=(3, 4, 5), unit="mrad", factor=1e3, stated=u.rotation))
    problem = Problem(
        channel="deflection",
        y=y,
        base=base,
        unknowns=tuple(unknowns),
        families=tuple(families),
        group=tests.pose,
        visit=readings.visit,
        cycle=tests.cycle if labels.has_cycle else readings.visit,
        session=readings.session,
        replicate=replicates(tests, recording),
        line=tests.line,
        row=np.arange(1, len(tests) + 1),
        scale=predicted,
        known=known if curved is not None else None,
        visits_for_cycles=not labels.has_cycle,
    )
    tried = catalogue(readings, curved)
    laws = (*tried.hypotheses, *unnamed.hypotheses(readings))
    return problem, replace(tried, hypotheses=laws, nameless=tuple(bearings.hypotheses(readings))), readings


def beside_springs(robot: Robot, T_flange_tcp: Array, q: Array, bodies: Sequence[Term]) -> Array | None:
    """(N, 6, 6) compliance at the TCP of bodies alone, at joints q (N, 6) rad; None without any."""
    if not bodies:
        return None
    stiff = Stiffness(joints=np.full(6, RIGID), terms=tuple(bodies))
    arm = ArmElasticity(robot, T_flange_tcp, stiff).at(q)
    return np.stack([arm.respond(np.broadcast_to(w, (len(q), 6))) for w in np.eye(6)], axis=2)


def readings_of(
    recording: Recording,
    tests: Experiment,
    robot: Robot,
    T_flange_tcp: Array,
    masses: Masses | None,
    compliance: Array,
    memo: dict[str, History] | None = None,
) -> Readings:
    """The readings of a load test with what gears may remember of it; see :func:`build`."""
    _, visit = np.unique(np.stack([tests.pose, tests.session], axis=1), axis=0, return_inverse=True)
    _, session = np.unique(tests.session, return_inverse=True)
    return Readings(
        recording=recording,
        robot=robot,
        T_flange_tcp=T_flange_tcp,
        masses=masses,
        state=tests.state,
        wrench=tests.wrench,
        dimensions=tests.dimensions,
        differences=True,
        compliance=compliance,
        session=session.reshape(-1),
        visit=visit.reshape(-1),
        cycle=tests.cycle,
        memo={} if memo is None else memo,
    )


def catalogue(r: Readings, curved: Array | None) -> Catalogue:
    """Every effect that load tests can show."""
    out: list[Hypothesis] = []
    missing: list[Untestable] = []
    drives = np.quantile(np.abs(r.load_torque), 0.9, axis=0)
    for j in range(6):
        if drives[j] < calibrated.RESTING.turned_by_load * drives.max():
            missing.append(Untestable("joint_nonlinear_stiffness", joint_at(j + 1), "no load turns this joint"))
            continue
        for kind in registry.of_joint_torque():
            laws, reason = at_joint.hypotheses(r, j, kind)
            out += laws
            if reason:
                missing.append(Untestable(kind.name, joint_at(j + 1), reason))
    if unweighed.missing(r.masses):
        why = f"{unweighed.of_links(r.masses)}, {UNWEIGHED}"
        missing.append(Untestable("gravity_compensator", joint_at(2), why))
    else:
        out += at_beside.in_load_tests(r)
    out += [*at_joint.couplings(r), *at_body.hypotheses(r)]
    out += at_sensor.hypotheses(r)
    if curved is None:
        missing.append(Untestable("geometric_stiffness", "arm", "the springs found do not hold the recorded loads"))
    offered = {h.name for h in out}
    for effect in registry.of_angles():
        if (effect.called, effect.tried[0]) not in offered:  # an elastic effect may share its word
            why = "it needs no load and cancels in displacements"
            missing.append(Untestable(effect.called, effect.tried[0], why))
    missing.append(Untestable("payload", "tool", "weight cancels in displacements"))
    drift = at_heat.hypotheses(r)
    out += drift
    if not drift:
        why = "displacements count from the unloaded state of the same minute, and nothing says how long that lasted"
        missing.append(Untestable("thermal_drift", "environment", why))
    force = np.linalg.norm(r.wrench[:, :3], axis=1)
    axes = {"load": force, "session": r.session.astype(float)}
    if r.recording.branch is not None:
        axes["branch"] = r.recording.branch.astype(float)
    if r.recording.time is not None:
        axes["time"] = r.recording.time
    axes |= {f"q{j + 1}": r.state.q[:, j] for j in range(6)}
    return Catalogue(tuple(out), tuple(missing), axes)


def replicates(tests: Experiment, recording: Recording) -> Ints:
    """(N,) label of readings of the same pose, load and branch; −1 for a reading without a twin."""
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
        w /= loads.same(np.array([force, moment]), calibrated.RESTING.same_load, recording.uncertainty)
        free = np.ones(len(rows), bool)
        for k in range(len(rows)):
            if not free[k]:
                continue
            near = free & (branch[rows] == branch[rows[k]]) & (np.abs(w - w[k]).max(axis=1) < 1.0)
            free[near] = False
            for times in _in_turn(tests.cycle[rows[near]]):  # what is read again while it rests may have crept on
                if len(times) > 1:
                    out[rows[near][times]] = n
                    n += 1
    return out


def _in_turn(cycle: Ints) -> list[Ints]:
    """Numbers of readings that are the first of their cycle, the second, …"""
    seen: dict[int, int] = {}
    turns: list[list[int]] = []
    for k, label in enumerate(cycle.tolist()):
        turn = seen.get(label, 0)
        seen[label] = turn + 1
        if turn == len(turns):
            turns.append([])
        turns[turn].append(k)
    return [np.array(t, np.int64) for t in turns]
