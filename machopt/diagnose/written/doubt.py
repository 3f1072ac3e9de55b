"""How far an arm may be from the stiffness that a diagnosis writes: covariance of its springs, and what it may lack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws import at_joint
from machopt.diagnose.nouns.problem import Flags
from machopt.diagnose.nouns.result import Diagnosis, rms
from machopt.diagnose.resting import deflection
from machopt.diagnose.run import Examined, stated_masses
from machopt.domain.cell import Cell
from machopt.domain.stiffness import Discrepancy, PositionError, Stiffness
from machopt.effects import registry
from machopt.effects.protocol import timed
from machopt.estimate.clusters import Components, clusters
from machopt.estimate.experiment import Experiment, experiment
from machopt.estimate.noise import reading_covariance
from machopt.identify.discrepancy import UNKNOWN, Readings, discrepancy, suspects_of
from machopt.model.elastic import ArmElasticity
from machopt.model.robot import Masses, Robot, load_robot

JOINTS = 6


def with_doubt(cell: Cell, found: Examined, stiffness: Stiffness | None) -> Stiffness | None:
    """The stiffness that a diagnosis makes of a cell's, with how sure it is."""
    if stiffness is None:
        return None
    known = None if cell.stiffness is None else cell.stiffness.position
    position = of_poses(found) if found.recording.kind == "absolute" else known
    if stiffness is cell.stiffness:
        return stiffness if position is known else replace(stiffness, position=position)
    stiffness = replace(stiffness, position=position)
    out = replace(stiffness, covariance=_springs(cell, found.diagnosis, stiffness))
    if found.recording.kind != "deflection":
        return out
    doubt = _of_load_tests(cell, found, stiffness)
    return out if doubt is None else replace(out, covariance=_covariance(doubt), discrepancy=doubt)


def of_poses(found: Examined) -> PositionError | None:
    """How far the TCP is from the extended model on poses that no fit saw; None where these are too few to hold out."""
    d, recording = found.diagnosis, found.recording
    before, after = (rms(e[d.used][:, :3]) for e in (d.errors.residual, d.errors.final))
    poses = len(np.unique(recording.pose[d.used]))
    if poses < calibrated.PROOF.fewest_groups or not np.isfinite([before, after]).all():
        return None
    q = recording.q[d.used][:, :JOINTS]
    return PositionError(after, before, d.noise_floor / 1e3, poses, np.stack([q.min(axis=0), q.max(axis=0)], axis=1))


def _springs(cell: Cell, d: Diagnosis, stiffness: Stiffness) -> Array | None:
    """(6, 6) of the joints' compliances by the refit; a joint that kept the cell's value as unsure as that one was."""
    known = None if cell.stiffness is None else cell.stiffness.covariance
    variance = np.zeros(JOINTS)
    refitted = {c.unknown.spring: c for c in d.coefficients if c.unknown.spring is not None}
    for j, k in enumerate(stiffness.joints):
        c = refitted.get(j + 1)
        kept = cell.stiffness is not None and k == cell.stiffness.joints[j]
        if c is not None and not kept and np.isfinite(c.sigma):
            variance[j] = c.sigma**2
        else:
            variance[j] = (UNKNOWN / k) ** 2 if known is None else known[j, j]
    return np.diag(variance)


def _covariance(doubt: Discrepancy) -> Array:
    """(6, 6) of the joints, of all that may be otherwise."""
    at = [doubt.parts.index(f"joint {j}") for j in range(1, JOINTS + 1)]
    ways = np.vstack([doubt.shift[at], doubt.modes[:, at]])
    return np.asarray(ways.T @ ways)


def _of_load_tests(cell: Cell, found: Examined, stiffness: Stiffness) -> Discrepancy | None:
    """What the extended model leaves of the load tests, as a plan reads it."""
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    masses = stated_masses(cell)
    tests = experiment(found.recording, robot, T)
    residual = tests.measured - _as_planned(found, tests, robot, T, masses, stiffness, cell.arm_limits)
    used = found.diagnosis.used
    groups = clusters(tests)
    typical = np.array([_typical(residual[used, c : c + 3]) for c in range(0, tests.dimensions, 3)])
    arm = ArmElasticity(robot, T, stiffness, cell.arm_limits, masses)
    V = reading_covariance(tests, 1.0 / stiffness.joints, arm.terms, tests.uncertainty, typical)
    stated = (tests.uncertainty.displacement is not None, tests.uncertainty.rotation is not None)
    readings = Readings(
        residual=residual,
        wrench=tests.wrench,
        clusters=groups,
        precision=np.where(used[:, None, None], 1.0, 1e-9) * np.linalg.inv(V),
        robust=np.repeat(used[:, None].astype(float), tests.dimensions, axis=1),
        components=tuple(
            Components(max(1.0, float(np.mean(_white(residual[used], V, c, used))))) for c in range(len(V))
        ),
        stated=stated[: len(V)],
    )
    suspects = suspects_of(arm, tests, masses)
    return discrepancy(suspects, tests.state, stiffness.joints, readings)


def _as_planned(
    found: Examined,
    tests: Experiment,
    robot: Robot,
    T: Array,
    masses: Masses | None,
    stiffness: Stiffness,
    limits: tuple[Array, Array],
) -> Array:
    """(N, D) what a plan makes of the same loads: it knows no history, so gears that remember come from rest.

    A law with a memory may fit readings by what they did before and yet be another law; nothing of that comes back in
    a job, and what the plan's reading of it leaves here is the least it leaves there. What only needs time is not off
    by having had less of it.
    """
    r = deflection.readings_of(found.recording, tests, robot, T, masses, 1.0 / stiffness.joints)
    slow = {e.called for e in registry.of_joint_torque() if timed(e.laws[0])}
    lived, rest = at_joint.lived_through(r, [t for t in stiffness.terms if t.effect in slow])
    rest = (*rest, *(t for t in stiffness.terms if t.effect not in slow))
    whole = ArmElasticity(robot, T, replace(stiffness, terms=rest), limits, masses).at(tests.state.q)
    return np.asarray((lived + whole.respond(tests.wrench))[:, : tests.dimensions])


def _white(residual: Array, V: Array, channel: int, used: Flags) -> Array:
    """Squares of the residuals by their own covariance, a coordinate."""
    part = residual[:, 3 * channel : 3 * channel + 3]
    return np.asarray(np.einsum("ni,nij,nj->n", part, np.linalg.inv(V[channel][used]), part) / 3.0)


def _typical(residual: Array) -> float:
    return max(float(1.4826 * np.median(np.abs(residual))), calibrated.NOISE.least)
