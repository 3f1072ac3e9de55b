"""Measured TCP poses at known joints: where the arm is, not how far it gives; shows geometry, weight and heat.

y is the measured TCP (or reflector) less what the encoders say, with what is known counted exactly: finite rotations,
corrections that the cell's kinematics.yaml holds, the equilibrium under weight and load at a first fit (K_C and all).
Columns of the base: joint compliances under weight and load; with ``registration: fit`` a small twist of each stand's
tracker frame about the middle of the points; each target's place in the flange. Coefficients of compliances and targets
are totals; the frame's twist is what a first robust fit left over.

The nominal model: :mod:`machopt.diagnose.resting.nominal_poses`. What may explain the rest:
:mod:`machopt.diagnose.resting.absolute_catalogue`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws import held, laws_geometry
from machopt.diagnose.nouns import loads, reflectors
from machopt.diagnose.nouns.problem import Catalogue, Family, Problem, Unknown
from machopt.diagnose.nouns.readings import BEHIND, Readings
from machopt.diagnose.resting import inclinometer
from machopt.diagnose.resting.absolute_catalogue import catalogue
from machopt.diagnose.resting.nominal_poses import About, Nominal
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.domain.recording import Recording
from machopt.domain.stiffness import Term
from machopt.effects import geometry
from machopt.effects.corrections import extended
from machopt.errors import InputError
from machopt.model.correction import correction_of
from machopt.model.robot import Masses, Robot, load_robot

Ints = NDArray[np.int64]


def build(
    recording: Recording,
    cell: Cell,
    robot: Robot,
    masses: Masses | None,
    rng: np.random.Generator,
    terms: tuple[Term, ...] = (),
    found: Mapping[int, float] | None = None,
    kept: frozenset[int] = frozenset(),
    about: tuple[KinematicCorrection, ...] = (),
) -> tuple[Problem, Catalogue, tuple[str, ...]]:
    """Equations and hypotheses of measured TCP poses.

    y = p_measured − p(q), p(q) the TCP by the encoder's joints; y ≈ B x, B the columns of the base.

    Args:
        recording: kind "absolute", N readings, as corrected by the record checks.
        cell: its TCP, stiffness (where the first fit starts) and kinematic corrections.
        robot: the arm whose joints ``recording.q`` are.
        masses: of links and tool; None where the URDF has none: then weight bends nothing.
        rng: nothing here is drawn at random; part of every channel's signature.
        terms: of the cell's stiffness, that count as known.
        found: compliance rad/(N·m) of joints, from 1, beside what was found before; None: nothing was looked for yet.
        kept: joints, from 1, whose springs are the cell's and not refitted.
        about: corrections that were found beside the cell's: the model is made linear about them, and what they do
            is part of y still, as the columns of their laws have it.

    Returns:
        Problem (D = 3, or 6 with rotation vectors in base axes where quaternions are recorded; 2 more where a tilt is),
        catalogue, notes.

    Raises:
        InputError: another kind of recording, or one without measured positions.

    Source: Klimchik et al. arXiv 1311.6810 (elasto-static calibration: y = J Δπ + J C Jᵀ w).
    Invalid: for a tracker frame turned by more than some degrees against base_link (register it first).
    """
    if recording.kind != "absolute" or recording.position is None:
        raise InputError(
            f"is a recording of kind {recording.kind!r}; measured poses are of kind 'absolute' with x_mm, y_mm, z_mm",
            file=recording.source,
        )
    there = _about(cell, about)
    model = Nominal(recording, cell, robot, masses, kept, there)
    frame = model.first_fit()
    unseen = model.unseen(frame)
    if not unseen <= kept:
        model = Nominal(recording, cell, robot, masses, kept | unseen, there)
        frame = model.first_fit()
    state, p, R = model.predict(frame)
    y = model.residual(frame, p, R)
    base, unknowns = model.columns(state, p)
    totals = model.joined(unknowns, frame)
    y = y + base @ totals
    springs = frame.compliance.copy()
    for joint, compliance in (found or {}).items():
        if joint not in model.kept:
            springs[joint - 1] = compliance
    readings = replace(model.readings(state, frame, springs), inclined=inclinometer.where(recording, cell))
    apart = _apart(model, base, unknowns)
    if readings.inclined is not None:
        more = inclinometer.equations(model, frame, state, readings.inclined, unknowns)
        y = np.concatenate([y, more.y], axis=1)
        base = more.beside(base)
        unknowns += more.unknowns
    if there is not None:
        y = y + _as_stated(readings, about)
    y = y - held.at_rest(readings, terms)
    visit, replicate = _labels(recording, readings.wrench)
    stated = recording.uncertainty
    families = [Family(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3, stated=stated.displacement)]
    if model.D == 6:
        families.append(Family(name="rotation", columns=(3, 4, 5), unit="mrad", factor=1e3, stated=stated.rotation))
    if readings.inclined is not None:
        families.append(
            Family(
                name=inclinometer.FAMILY,
                columns=(model.D, model.D + 1),
                unit="mrad",
                factor=1e3,
                stated=stated.tilt,
                beside=True,
            )
        )
    loaded = bool(np.abs(readings.wrench).max() > 0.0)
    problem = Problem(
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
        scale=readings.through(readings.wrench) if loaded else None,
        time=recording.time,
        present=None if readings.inclined is None else inclinometer.present(model.D, readings.inclined),
    )
    readings = replace(readings, visit=visit, cycle=visit)
    return problem, catalogue(readings, problem), (*model.notes(frame), *apart)


def _about(cell: Cell, found: tuple[KinematicCorrection, ...]) -> About | None:
    """The cell's arm with corrections that were found; None where there are none."""
    if not found:
        return None
    kinematics = extended(cell.kinematics, found)
    return About(load_robot(replace(cell, kinematics=kinematics)), kinematics)


def _as_stated(r: Readings, found: tuple[KinematicCorrection, ...]) -> Array:
    """(N, D) m, rad that corrections move the readings by, as the columns of their laws have it.

    The slope of the nominal model is another one by what weight does to an arm that is turned (1 in 50 of an offset of
    a large joint 2). The columns are what the numbers of the next fit multiply, so that y and they belong together.
    """
    frames = [c for c in found if c.effect == geometry.EFFECT.name]
    turned = correction_of(Kinematics(tuple(c for c in found if c not in frames)))
    out = r.seen(np.zeros((len(r), 6)), BEHIND)
    if turned is not None:
        delta = turned.delta(r.state.q)
        out = out + sum(r.lift(j, delta[:, j : j + 1])[:, :, 0] for j in range(6))
    for c in frames:
        at = geometry.placed(c.parameters)
        out = out + laws_geometry.twists(r, c.location) @ np.concatenate([at.shift, at.turn])
    return np.asarray(out)


def _labels(recording: Recording, wrench: Array) -> tuple[Ints, Ints]:
    """Arrival of each reading (pose × cycle × session), and which readings repeat each other: same pose, same load."""
    stand, target = reflectors.stands(recording), reflectors.which(recording)
    cycle = recording.cycle
    if recording.targets and "cycle" not in recording.labelled:  # reflectors are read one after the other
        cycle = _times(np.stack([recording.session, recording.pose, stand, target], axis=1))
    key = np.stack([recording.session, recording.pose, cycle, stand], axis=1)
    visit = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    size = np.array([max(float(np.abs(wrench[:, a : a + 3]).max()), 1e-9) for a in (0, 3)])
    w = wrench / loads.same(size, calibrated.RESTING.same_load, recording.uncertainty)
    if np.abs(wrench).max() == 0.0:
        w = np.zeros_like(wrench)
    replicate = np.full(len(recording), -1, np.int64)
    n = 0
    # from another stand too: its frame is fitted, and what differs then is the reading
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


def _times(key: Ints) -> Ints:
    """(N,) how often the same row of ``key`` (N, K) came before."""
    same = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.argsort(same, kind="stable")
    starts = np.flatnonzero(np.diff(same[order], prepend=-1))
    out = np.empty(len(same), np.int64)
    out[order] = np.arange(len(same)) - np.repeat(starts, np.diff(np.r_[starts, len(same)]))
    return out


def _apart(model: Nominal, base: Array, unknowns: Sequence[Unknown]) -> tuple[str, ...]:
    """What these poses cannot tell of tracker frames and reflectors, which is held by nominal places."""
    count = model.together(base, unknowns)
    if not count or not model.recording.targets:
        return ()
    return (
        f"in these poses {count} combination{'' if count == 1 else 's'} of tracker frames and reflectors' places "
        "cannot be told apart: nominal places hold them; poses that turn the flange otherwise would show them",
    )
