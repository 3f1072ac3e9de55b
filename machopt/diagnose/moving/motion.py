"""Diagnosis of a motion: which channel its signals allow, and the equations and catalogue of that channel.

``link``: link-side against motor-side encoders; ``tip``: tracked TCP against the commanded joints; ``torque``: joint
torque against rigid-body dynamics from the URDF's inertias.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws import at_beside
from machopt.diagnose.laws.motion_frame import Scene, one_joint, remembered
from machopt.diagnose.moving import checks, columns, currents, link, masses, tip, torque
from machopt.diagnose.nouns.motion_signals import Motion, signals
from machopt.diagnose.nouns.problem import Catalogue, Problem, Untestable
from machopt.diagnose.nouns.result import Finding
from machopt.domain.cell import Cell
from machopt.domain.recording import Recording
from machopt.domain.stiffness import Term
from machopt.errors import InputError
from machopt.model.correction import correction_of
from machopt.model.rigid import Dynamics, NoInertiaError, load_dynamics

Predicted = Literal["link", "tip", "torque"]
WORDS: dict[Predicted, str] = {
    "link": "link-side against motor-side joint position",
    "tip": "tracked position of the TCP",
    "torque": "joint torque by rigid-body dynamics from the URDF's inertias",
}


def channels(recording: Recording, cell: Cell) -> tuple[Predicted, ...]:
    """Which channels can be predicted and compared, the one that shows most first."""
    out: list[Predicted] = []
    other = recording.q_secondary
    if other is not None and any(np.isfinite(x).all() and np.ptp(x) > 1e-6 for x in other.T):
        out.append("link")
    if recording.position is not None and len(cell.arm_joints) == 6 and not cell.arm_prismatic:
        out.append("tip")
    if (recording.torque is not None or currents.gainless(recording)) and _dynamics(cell) is not None:
        out.append("torque")
    return tuple(out)


def refuse_other_joints(recording: Recording, cell: Cell) -> None:
    """Raise where the recording's joints are not the cell's."""
    n = recording.q.shape[1]
    slides = cell.arm_prismatic or (False,) * len(cell.arm_joints)
    if n != len(slides):
        raise InputError(
            f"the recording has {n} joint{'s' if n > 1 else ''}, the cell's arm {len(slides)}: "
            f"{', '.join(cell.arm_joints)}; one column q1_deg (q1_mm where it slides) … for each of them would work",
            file=recording.source,
        )
    for j, (own, name) in enumerate(zip(slides, cell.arm_joints, strict=True)):
        if own != (recording.prismatic or (False,) * n)[j]:
            found, right = ("deg", "mm") if own else ("mm", "deg")
            raise InputError(
                f"q{j + 1}_{found} is of a joint that {'turns' if own else 'slides'}, but {name!r} of the cell "
                f"{'slides' if own else 'turns'}; q{j + 1}_{right} is expected",
                file=recording.source,
            )


def build(
    recording: Recording,
    cell: Cell,
    channel: Predicted,
    rng: np.random.Generator,
    *,
    repeats: bool = True,
    terms: tuple[Term, ...] = (),
) -> tuple[Problem, Catalogue, tuple[str, ...], tuple[Finding, ...]]:
    """Equations of one channel of a motion, and what may explain what they leave.

    Args:
        recording: of kind motion.
        cell: with the URDF; of its chain only the arm joints count.
        channel: one of :func:`channels`.
        rng: not used by these channels, which leave nothing to chance.
        terms: of the cell's stiffness, that count as known: those of single joints, and balancers.
        repeats: hold a phase of a motion that repeats out of all periods at once; False: stretches of time alone.

    Returns:
        Problem, catalogue, notes for the reader, and findings about the record.

    Raises:
        InputError: the signals that the channel needs are missing or make no sense.
    """
    n = min(len(cell.arm_joints), recording.q.shape[1])
    mended, found = checks.units(recording, n)
    mended, warnings = checks.quality(mended, n)
    motion = signals(mended, n, repeats=repeats)
    dynamics = _dynamics(cell)
    predicted = _predicted(dynamics, motion, terms)
    free_gains, unsized = currents.gainless(mended) and predicted is not None, frozenset[int]()
    if predicted is not None and free_gains:
        made = currents.torques(mended, motion, predicted)
        mended, unsized, warnings = made.recording, made.unsized, [*warnings, made.said]
    elif predicted is not None and channel == "torque":
        mended, exchanged = columns.mended(mended, motion, predicted)
        mended, of_torque = checks.torque_side(mended, motion, predicted)
        found += [*exchanged, *of_torque]
    scene = replace(
        _scene(mended, cell, motion, dynamics, predicted), known=terms, free_gains=free_gains, unsized=unsized
    )
    scene.notes.extend(warnings)
    if scene.correction is not None and channel != "torque":
        corrected = ", ".join(dict.fromkeys(part.said for part in scene.correction.parts))
        scene.notes.append(f"corrections of the cell's kinematics.yaml count as known: {corrected}")
    problem, catalogue, more = _equations(scene, channel)
    if channel != "tip":
        found += checks.servo_lag(mended, motion)
    if found:
        errors = (
            _errors(problem),
            _as_stated(recording, cell, channel, repeats, terms) if mended is not recording else None,
        )
        found = [_weighed(f, *errors) for f in found]
    missing = [*catalogue.untestable]
    if float(np.ptp(motion.time)) < calibrated.MOTION.long_s:
        missing.append(
            Untestable("thermal_drift", "environment", f"{np.ptp(motion.time):.0f} s are too short for heat")
        )
    if recording.q_command is None and channel != "tip":
        missing.append(Untestable("servo_lag", "controller", "the commanded joints are not recorded"))
    kept, nameless = (
        tuple(replace(h, columns=remembered(h.columns)) for h in laws)
        for laws in (catalogue.hypotheses, catalogue.nameless)
    )
    catalogue = replace(catalogue, hypotheses=kept, untestable=tuple(missing), nameless=nameless)
    return problem, catalogue, tuple(scene.notes), (*found, *more)


def _scene(
    recording: Recording, cell: Cell, motion: Motion, dynamics: Dynamics | None, predicted: Array | None
) -> Scene:
    n = motion.q.shape[1]
    prismatic = tuple(dynamics is not None and dynamics.prismatic(j) for j in range(n))
    return Scene(
        recording=recording,
        cell=cell,
        motion=motion,
        dynamics=dynamics,
        predicted=predicted,
        dimensions=n,
        lift=one_joint(motion, n),
        prismatic=prismatic,
        correction=correction_of(cell.kinematics),
        notes=[*motion.notes],
    )


def _equations(scene: Scene, channel: Predicted) -> tuple[Problem, Catalogue, list[Finding]]:
    if channel == "torque":
        return *torque.build(scene), []
    if channel == "link":
        joints = link.seen(scene)
        lift = one_joint(scene.motion, len(joints), joints)
        return *link.build(replace(scene, dimensions=len(joints), lift=lift), joints), []
    from machopt.model.robot import load_robot

    if scene.joints != 6:
        raise InputError(
            f"{scene.recording.source}: a tracked TCP needs an arm of six joints; the cell has {scene.joints}"
        )
    return tip.build(scene, load_robot(scene.cell))


def _as_stated(
    recording: Recording, cell: Cell, channel: Predicted, repeats: bool, terms: tuple[Term, ...]
) -> Array | None:
    """Errors of the record as it stands; None where no equations can be made of it."""
    motion = signals(recording, min(len(cell.arm_joints), recording.q.shape[1]), repeats=repeats)
    dynamics = _dynamics(cell)
    scene = _scene(recording, cell, motion, dynamics, _predicted(dynamics, motion, terms))
    if channel == "link" and not link.seen(scene):
        return None  # joints that seem to stand still
    return _errors(_equations(scene, channel)[0])


def _errors(problem: Problem) -> Array:
    """(G,) rmse of the first family by group, in its report unit, of the base fitted without the group.

    What is held near a statement (masses of links) is left at it: freely fitted it makes up for another unit.
    """
    free = [u.prior is None for u in problem.unknowns]
    left = masses.heldout(problem.y, problem.base[:, :, free], problem.group, np.ones(problem.dimensions))
    return problem.families[0].factor * np.sqrt(
        left / np.unique(problem.group, return_counts=True)[1] / problem.dimensions
    )


def _weighed(found: Finding, errors: Array, stated: Array | None) -> Finding:
    """A finding of the record with the median error of stretches that no fit saw, as stated and as put right."""
    if np.isfinite(found.before):
        return found
    after = float(np.median(errors))
    before = after if stated is None or not found.record else float(np.median(stated))
    return replace(found, before=before, after=after)


def _predicted(dynamics: Dynamics | None, motion: Motion, terms: tuple[Term, ...]) -> Array | None:
    """(M, n) N·m that motors and gears carry by rigid bodies and the balancers that the cell knows of."""
    if dynamics is None:
        return None
    return dynamics.torque(motion.q, motion.v, motion.a) - at_beside.known(terms, motion.q)


def _dynamics(cell: Cell) -> Dynamics | None:
    """The arm's dynamics; None where the URDF has no inertias."""
    try:
        return load_dynamics(cell)
    except NoInertiaError:
        return None
