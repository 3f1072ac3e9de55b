"""A whole diagnosis: record mended, problem set up, engine run; what was wrong with the record is told beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose.laws import at_joint, held, userterms
from machopt.diagnose.moving import motion, next_motion
from machopt.diagnose.nouns import reflectors
from machopt.diagnose.nouns.problem import Catalogue, Problem
from machopt.diagnose.nouns.readings import History
from machopt.diagnose.nouns.result import Diagnosis, Finding, Name
from machopt.diagnose.record import gains, gross, labels, moved, nests, pose_units, repairs, slipped, tilt_columns
from machopt.diagnose.record.pasted import pasted
from machopt.diagnose.resting import absolute, deflection, elsewhere, loaded
from machopt.diagnose.resting.unweighed import weighed
from machopt.diagnose.search import engine
from machopt.diagnose.search.rounds import About, Rebuild
from machopt.diagnose.verdict import cellvalues, enough
from machopt.diagnose.verdict.words import sentence
from machopt.domain.cell import Cell, held_still
from machopt.domain.recording import Recording
from machopt.domain.stiffness import Stiffness, Term, held_over
from machopt.errors import InputError
from machopt.estimate.experiment import experiment
from machopt.model.elastic import ArmElasticity
from machopt.model.linkage import refuse_linked
from machopt.model.robot import GRAVITY, Masses, Robot, load_masses, load_robot

NOTHING = About()
FEWEST = 3  # points that fix a frame: fewer poses are nothing to look at


@dataclass(frozen=True)
class Examined:
    """A diagnosis with what the files are written from."""

    diagnosis: Diagnosis
    problem: Problem
    recording: Recording

    @property
    def weight_alone(self) -> bool:
        """Measured poses without any load but the arm's own weight."""
        return self.recording.kind == "absolute" and self.problem.scale is None


def at_rest(
    cell: Cell,
    recording: Recording,
    options: engine.Options,
    laws: list[tuple[str, userterms.Offer]],
    *,
    accept: tuple[str, ...],
    seed: int,
    barred: frozenset[Name] = frozenset(),
) -> Examined:
    """Load tests and poses.

    Args:
        cell: the robot cell.
        recording: of kind deflection or absolute.
        options: of the engine.
        laws: of the user's own.
        accept: findings about the record that are not to be mended.
        seed: of every random choice.
        barred: explanations of measured poses that are not to be looked for.

    Raises:
        InputError: a recording that cannot be right, or is too small for any answer.
    """
    refuse_linked(cell, "diagnose")
    motion.refuse_other_joints(recording, cell)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    masses = stated_masses(cell)
    prior = None if cell.stiffness is None else cell.stiffness.joints
    if laws and recording.kind != "deflection":
        raise InputError(
            "laws of your own are tried on load tests (kind deflection) only", where="--terms", file=recording.source
        )
    options.progress("checking the record")
    if recording.kind == "absolute" and len(recording) < FEWEST:
        raise InputError(
            f"found {len(recording)} reading{'' if len(recording) == 1 else 's'}; ten poses or more would work "
            "(machopt plan-poses chooses them)",
            file=recording.source,
        )
    right = _put_right(recording, cell, robot, masses, accept)
    recording = right.recording
    others = pasted(recording, robot, T)
    copies = gross.copied(recording) | others | slipped.lost(right.findings, len(recording))
    said = [*recording.warnings, *right.warnings, *held_still(cell)]
    notes: tuple[str, ...] = ()

    beside: list[Finding] = []

    def load_tests(terms: tuple[Term, ...]) -> tuple[Diagnosis, Problem]:
        known = None if cell.stiffness is None else Stiffness(joints=cell.stiffness.joints, terms=terms)

        def about(tcp: Array) -> tuple[Diagnosis, Problem]:
            return _load_tests(
                seed,
                recording,
                robot,
                tcp,
                known_masses(cell),
                laws,
                known,
                copies,
                options,
                limits=cell.arm_limits,
                stated=held.geometric(cell.stiffness),
                down=cell.T_world_base[:3, :3].T @ np.array([0.0, 0.0, -GRAVITY]),
            )

        done, tool = elsewhere.followed(T, about)
        beside[:] = [] if tool is None else [tool]
        return done

    def poses(terms: tuple[Term, ...]) -> tuple[Diagnosis, Problem]:
        rng, kept = np.random.default_rng(seed), frozenset[int]()

        def build(found: Mapping[int, float] | None, about: About = NOTHING) -> tuple[Problem, Catalogue]:
            nonlocal notes
            problem, catalogue, notes = absolute.build(
                recording, cell, robot, masses, rng, terms, found, kept, about.unloaded
            )
            laws = tuple(h for h in catalogue.hypotheses if h.name not in barred)
            problem = replace(problem, time=recording.time, excluded=copies if copies.any() else None)
            return problem, replace(catalogue, hypotheses=laws)

        problem, catalogue = build(None)
        _refuse_too_few(problem, recording)

        def again(x: Array, doubted: frozenset[int], about: About) -> tuple[Problem, Catalogue]:
            nonlocal problem, kept
            springs = {u.spring: float(v) for u, v in zip(problem.unknowns, x, strict=True) if u.spring is not None}
            kept |= {problem.unknowns[n].spring or 0 for n in doubted}
            problem, catalogue = build(springs, about)
            return problem, catalogue

        return engine.diagnose(problem, catalogue, replace(options, predicted="poses"), rng, again), problem

    terms = _held(cell, robot, masses)
    if recording.kind == "deflection":
        d, problem = held.diagnosed(terms, load_tests)
    else:
        d, problem = held.diagnosed(terms, poses, held.in_poses)
    aside = gross.outliers(recording, d, copies, problem, others)
    said += cellvalues.far_off(d, prior)
    said += elsewhere.told(T, beside)
    said += () if cell.stiffness is None else held_over(cell.stiffness.external)
    if recording.kind == "absolute" and cell.stiffness is not None and cell.stiffness.position is not None:
        said += cell.stiffness.position.beyond(recording.q)
    mended, overnight = moved.warmed(right.findings, d.findings)
    whole = _with_record(d, [*mended, *beside], aside, (*right.stood, *overnight, *notes), tuple(said))
    return Examined(enough.judged(whole, problem), problem, recording)


@dataclass(frozen=True)
class _PutRight:
    """A record as it was meant, and what that took."""

    recording: Recording
    findings: list[Finding]
    stood: tuple[str, ...]  # where reflectors stood
    warnings: tuple[str, ...]


def _put_right(
    recording: Recording, cell: Cell, robot: Robot, masses: Masses | None, accept: tuple[str, ...]
) -> _PutRight:
    """Columns and units first, then what single nests and sessions have for themselves, then labels and gains."""
    T, prior = cell.tool.T_flange_tcp, None if cell.stiffness is None else cell.stiffness.joints
    recording, found = pose_units.mended(recording, robot, T, accept)
    recording, stood = reflectors.brought(recording, robot, T)
    guessed = cell.stiffness is not None and cell.stiffness.estimated
    recording, mended, warnings = repairs.mend(recording, robot, T, prior, accept, estimated=guessed)
    found = [*found, *mended]
    if recording.kind == "absolute" and "columns" not in accept:
        recording, sitting = nests.mended(recording, cell, robot, masses)
        found += sitting
    if recording.kind == "absolute":
        recording, put_down = moved.mended(recording, robot, T, accept)
        recording, assigned = tilt_columns.mended(recording, cell, robot, masses, accept)
        found += [*put_down, *assigned]
    recording, relabelled = labels.mended(recording, robot, T, accept)
    recording, louder = gains.mended(recording, robot, T, accept)
    return _PutRight(recording, [*found, *relabelled, *louder], tuple(stood), tuple(warnings))


def _held(cell: Cell, robot: Robot, masses: Masses | None) -> tuple[Term, ...]:
    """The terms of the cell's stiffness that count as known; refuses what no plan could use either."""
    if cell.stiffness is None:
        return ()
    ArmElasticity(robot, cell.tool.T_flange_tcp, cell.stiffness, cell.arm_limits, masses)
    return held.terms_of(cell.stiffness.terms)


def _load_tests(
    seed: int,
    recording: Recording,
    robot: Robot,
    T: Array,
    masses: Masses | None,
    laws: list[tuple[str, userterms.Offer]],
    known: Stiffness | None,
    copies: NDArray[np.bool_],
    options: engine.Options,
    *,
    limits: tuple[Array, Array],
    stated: bool,
    down: Array,
) -> tuple[Diagnosis, Problem]:
    """Of load tests; K_C is a finding unless it is ``stated`` by the cell.

    Args:
        limits: (6,) and (6,) rad.
        down: (3,) m/s² in base_link, gravity.
    """
    tests = loaded.where_it_stands(experiment(recording, robot, T), recording, robot, T, masses)
    memo: dict[str, History] = {}
    terms = None
    if known is not None and known.terms:  # what they add to the springs
        r = deflection.readings_of(recording, tests, robot, T, masses, 1.0 / known.joints, memo)
        lived, settled = at_joint.lived_through(r, known.terms)
        whole = ArmElasticity(robot, T, replace(known, terms=settled), limits, masses).at(recording.q)
        springs = ArmElasticity(robot, T, Stiffness(joints=known.joints)).at(recording.q)
        terms = lived + whole.respond(tests.wrench) - springs.respond(tests.wrench)

    alone: Array | None = None

    def build(compliance: Array | None, found: tuple[Term, ...] = ()) -> tuple[Problem, Catalogue]:
        nonlocal alone
        bodies = deflection.beside_springs(robot, T, recording.q, found)
        problem, catalogue, readings = deflection.build(
            recording, tests, robot, T, masses, compliance, memo, terms, alone, bodies, down
        )
        alone = readings.compliance if alone is None else alone
        if stated:
            problem = replace(problem, known=None)
        own = userterms.offered(laws, readings)
        return problem, replace(catalogue, hypotheses=(*catalogue.hypotheses, *own))

    problem, catalogue = build(None)
    if copies.any():
        problem = replace(problem, excluded=copies)
    _refuse_too_few(problem, recording)
    rebuild = _excluding(lambda x, _, about: build(np.maximum(x[:6], 0.0), about.bodies), copies)
    rng = np.random.default_rng(seed)
    d = engine.diagnose(problem, catalogue, replace(options, predicted="load tests"), rng, rebuild)
    return d, problem


def _refuse_too_few(problem: Problem, recording: Recording) -> None:
    """Raise where what is refitted in any case could make up every reading."""
    unknowns = sum(u.prior is None or u.location == "tool" for u in problem.unknowns)  # places of reflectors too
    distinct = min(len(problem), 2 * len(np.unique(problem.group)))  # more repeats of one posture tell no more
    if distinct * problem.dimensions > unknowns and problem.y.size >= 2 * unknowns:
        return
    poses = len(np.unique(problem.group))
    raise InputError(
        f"{len(problem)} reading{'' if len(problem) == 1 else 's'} of {problem.dimensions} coordinates in {poses} "
        f"pose{'' if poses == 1 else 's'} cannot be held against a model that refits {unknowns} numbers to them; ten "
        "poses or more would work (machopt plan-poses chooses them)",
        file=recording.source,
    )


def _excluding(rebuild: Rebuild, rows: NDArray[np.bool_]) -> Rebuild:
    if not rows.any():
        return rebuild

    def again(x: Array, doubted: frozenset[int], about: About) -> tuple[Problem, Catalogue]:
        problem, catalogue = rebuild(x, doubted, about)
        return replace(problem, excluded=rows), catalogue

    return again


def in_motion(
    cell: Cell, recording: Recording, options: engine.Options, *, asked: str, seed: int, toolpath: bool
) -> Examined:
    """Time series.

    Args:
        cell: the robot cell.
        recording: of kind motion.
        options: of the engine.
        asked: the channel, or "auto".
        seed: of every random choice.
        toolpath: what it changes for one is asked for too.

    Raises:
        InputError: joints, signals or a channel that lead nowhere.
    """
    motion.refuse_other_joints(recording, cell)
    if toolpath and (len(cell.arm_joints) != 6 or cell.arm_prismatic):
        raise InputError(
            "a toolpath needs an arm of six revolute joints; without it the motion is diagnosed all the same",
            where="--toolpath",
        )
    possible = motion.channels(recording, cell)
    if not possible:
        raise InputError(
            "nothing that was recorded can be predicted: joint torque with inertias in the URDF, link-side encoders "
            "(qse1_deg …) or a tracked TCP (x_mm …) would work"
            + (
                "; of current1_A … nothing says the torque: motor_gain_Nm_per_A and gear_ratio in recording.yaml do"
                if recording.current is not None
                else ""
            ),
            file=recording.source,
        )
    channel = possible[0] if asked == "auto" else asked
    if channel not in possible:
        raise InputError(f"found {channel}; this recording allows {', '.join(possible)}", where="--channel")
    options.progress(f"signals and equations, channel {channel}")
    words = {
        "torque": "stretches of joint torque",
        "link": "stretches of link-side position",
        "tip": "stretches of tip",
    }
    notes: tuple[str, ...] = ()
    found: tuple[Finding, ...] = ()

    def stretches(terms: tuple[Term, ...]) -> tuple[Diagnosis, Problem]:
        nonlocal notes, found
        rng = np.random.default_rng(seed)
        problem, catalogue, notes, found = motion.build(recording, cell, channel, rng, terms=terms)
        return engine.diagnose(problem, catalogue, replace(options, predicted=words[channel]), rng), problem

    six = len(cell.arm_joints) == 6 and not cell.arm_prismatic
    terms = _held(cell, load_robot(cell), stated_masses(cell)) if six else ()
    d, problem = held.diagnosed(terms, stretches, held.in_torques if channel == "torque" else held.in_motions)
    options.progress("the next motion")
    d = replace(d, next_experiment=next_motion.suggested(cell, channel, d))
    # what leaves the record as it is, like a lag behind the command, changes no error of this channel
    beside = [f if f.record else replace(f, before=d.heldout_before, after=d.heldout_before) for f in found]
    return Examined(_with_record(d, beside, None, notes, (*recording.warnings, *held_still(cell))), problem, recording)


def _with_record(
    d: Diagnosis, mended: list[Finding], aside: Finding | None, notes: tuple[str, ...], warnings: tuple[str, ...]
) -> Diagnosis:
    """The diagnosis with what was wrong with the record: mended things first, gross rows last."""
    findings = (*mended, *d.findings, *(() if aside is None else (aside,)))
    before, explained, verdict = d.heldout_before, d.explained, d.verdict
    if mended:  # the record was part of the mismatch: counted from what it left as it was
        before = max([before, *(f.before for f in mended if np.isfinite(f.before))])
        beyond, left = before**2 - d.noise_floor**2, max(d.heldout_after**2 - d.noise_floor**2, 0.0)
        explained = float(np.clip(1.0 - left / beyond, 0.0, 1.0)) if beyond > 0 else d.explained
    if mended and d.verdict == "unexplained":  # what the record hid is put right, and more is there
        verdict = "partly_explained"
    out = replace(
        d,
        findings=findings,
        verdict=verdict,
        heldout_before=before,
        explained=explained,
        notes=(*d.notes, *notes),
        warnings=warnings,
    )
    return replace(out, sentence=sentence(out)) if findings != d.findings else out


def stated_masses(cell: Cell) -> Masses | None:
    """Of links and tool, as far as they are stated; None where none is."""
    try:
        masses = load_masses(cell)
    except InputError:
        return None
    return masses if masses.mass.sum() > 0 else None


def known_masses(cell: Cell) -> Masses | None:
    """As load tests know them; None where the URDF has none of the arm's long links, and weight is unknown."""
    masses = stated_masses(cell)
    return masses if weighed(masses) else None
