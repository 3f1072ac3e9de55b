"""``machopt diagnose``: from a cell and a recording to what the model leaves out, the extended model, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from os.path import isfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose import absolute, at_joint, deflection, engine, motion, record, userterms
from machopt.diagnose.extended import beside, stiffness_of
from machopt.diagnose.history import History
from machopt.diagnose.problem import Catalogue, Problem
from machopt.diagnose.result import Diagnosis, Finding
from machopt.diagnose.words import sentence
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.domain.recording import Recording
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.domain.stiffness import Stiffness
from machopt.effects.corrections import extended
from machopt.effects.own import Own, in_use, run
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.kinematics import write_kinematics
from machopt.formats.options import load_options
from machopt.formats.recording import load_recording, load_recordings
from machopt.formats.stiffness import load_stiffness, write_stiffness
from machopt.formats.toolpath import read_toolpath
from machopt.identify.experiment import experiment
from machopt.model.elastic import ArmElasticity
from machopt.model.linkage import refuse_linked
from machopt.model.robot import Masses, Robot, load_masses, load_robot
from machopt.output import output_folder, write_result
from machopt.report.diagnosis_page import write_diagnosis
from machopt.services.diagnose_result import page_of, result_of, write_residuals
from machopt.services.inputs import input_hashes, recording_inputs, single
from machopt.services.knownrobot import known_robot
from machopt.services.manifest import write_command_manifest

Array = NDArray[np.float64]
Progress = Callable[[str], None]
GEOMETRIC = "geometric_stiffness"  # counted in any case


@dataclass(frozen=True)
class Request:
    """One run."""

    cell: Path
    recordings: tuple[Path, ...]
    out: Path
    channel: str = "auto"
    toolpath: Path | None = None
    terms: tuple[Path, ...] = ()  # Python files with laws of the user's own
    max_findings: int = 3
    accept: tuple[str, ...] = ()
    seed: int = 0
    allow_external: bool = False


@dataclass(frozen=True)
class Outcome:
    """What came out."""

    diagnosis: Diagnosis
    result: DiagnosisResult
    report: Path


@dataclass(frozen=True)
class _Found:
    """A diagnosis with what the files are written from."""

    diagnosis: Diagnosis
    problem: Problem
    recording: Recording


def run_diagnose(request: Request, progress: Progress = lambda _: None) -> Outcome:
    """Diagnose a recording of a cell's robot.

    Raises:
        InputError: bad cell, recording, laws or output folder.
    """
    own = run(request.terms)
    with in_use(own):
        return _diagnosed(request, own, progress)


def _diagnosed(request: Request, own: tuple[Own, ...], progress: Progress) -> Outcome:
    progress("reading cell and recording")
    paths = request.recordings
    recording = load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)
    in_motion = recording.kind == "motion"
    cell = load_cell(request.cell, allow_external=request.allow_external, any_chain=in_motion)
    laws = userterms.load(own)
    if request.toolpath is not None and not isfile(request.toolpath):  # said before minutes of work, not after
        raise InputError(
            "there is no such file; a toolpath that optimize reads would work",
            file=request.toolpath,
            where="--toolpath",
        )
    if request.channel != "auto" and recording.kind != "motion":
        raise InputError(
            f"found {request.channel}; channels are of a motion, this recording is of kind {recording.kind!r}",
            where="--channel",
        )
    options = engine.Options(most=request.max_findings, progress=progress)
    with output_folder(request.out) as folder:
        if in_motion:
            found = _motion(request, cell, recording, options)
        else:
            found = _at_rest(request, cell, recording, options, laws)
        made = stiffness_of(cell, found.diagnosis)
        before, after = made.before, made.after
        d = beside(replace(found.diagnosis, warnings=(*cell.warnings, *found.diagnosis.warnings)), made)
        progress("writing the model and tables")
        model = _write_model(folder, after)
        kinematics = _write_kinematics(folder, cell, d)
        effect = None
        if request.toolpath is not None and after is not None and before is not None:
            from machopt.diagnose.onjob import effect_on_job  # the planner takes a second to load

            progress("what it changes for the toolpath")
            toolpath = read_toolpath(request.toolpath, robot=known_robot(cell))
            effect = effect_on_job(cell, before, after, toolpath, load_options(cell.plan))
        inputs = input_hashes(cell, request.recordings)
        said = {
            "channel": request.channel,
            "max_findings": request.max_findings,
            "seed": request.seed,
            "accept": list(request.accept),
            "terms": [p.name for p in request.terms],
        }
        result = result_of(
            cell,
            found.recording,
            d,
            model=model,
            kinematics=kinematics,
            effect_on_job=effect,
            options=said,
            inputs=inputs,
        )
        write_residuals(folder / "residuals.csv", found.recording, d, found.problem)
        progress("report")
        facts = tuple((k, str(v)) for k, v in (said | inputs).items())
        write_diagnosis(folder / "report.html", page_of(cell, found.recording, d, facts, effect, problem=found.problem))
        write_result(folder / "diagnosis.json", result)
        read = [single(f, "terms") for f in request.terms]
        read += [] if request.toolpath is None else [single(request.toolpath, "toolpath")]
        write_command_manifest(
            folder,
            "diagnose",
            request,
            cell,
            verdict=result.verdict,
            inputs=(*recording_inputs(request.recordings), *read),
        )
    return Outcome(d, result, request.out / "report.html")


def _at_rest(
    request: Request, cell: Cell, recording: Recording, options: engine.Options, laws: list[tuple[str, userterms.Offer]]
) -> _Found:
    """Load tests and poses."""
    refuse_linked(cell, "diagnose")
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    masses = _masses(cell)
    prior = None if cell.stiffness is None else cell.stiffness.joints
    if laws and recording.kind != "deflection":
        raise InputError(
            "laws of your own are tried on load tests (kind deflection) only", where="--terms", file=recording.source
        )
    options.progress("checking the record")
    recording, mended, warnings = record.mend(recording, robot, T, prior, request.accept)
    copies = record.copied(recording)
    said = [*recording.warnings, *warnings]
    if recording.kind == "deflection":
        known = None
        if cell.stiffness is not None:
            limits = cell.limits.lower[:6], cell.limits.upper[:6]
            ArmElasticity(robot, T, cell.stiffness, limits, masses)  # refuses what no plan could use either
            terms = tuple(t for t in cell.stiffness.terms if t.effect != GEOMETRIC)
            known = Stiffness(cell.stiffness.joints, terms=terms)
        d, problem = _load_tests(request, recording, robot, T, masses, laws, known, copies, options)
        held = () if known is None else known.terms
        again = {(f.effect, f.location) for f in d.findings} & {(t.effect, t.location) for t in held}
        if known is not None and again:  # a law that the cell holds already is fitted anew, not on top of itself
            options.progress("once more without what the cell holds of it")
            known = replace(known, terms=tuple(t for t in held if (t.effect, t.location) not in again))
            d, problem = _load_tests(request, recording, robot, T, masses, laws, known, copies, options)
        notes: tuple[str, ...] = ()
        if held:
            notes = (f"the cell's own terms count as known: {', '.join(f'{t.effect} {t.location}' for t in held)}",)
    else:
        rng = np.random.default_rng(request.seed)
        problem, catalogue, notes = absolute.build(recording, cell, robot, masses, rng)
        problem = replace(problem, time=recording.time, excluded=copies if copies.any() else None)
        _refuse_too_few(problem, recording)
        d = engine.diagnose(problem, catalogue, replace(options, predicted="poses"), rng)
    gross = record.outliers(recording, d, copies, problem)
    return _Found(_with_record(d, mended, gross, notes, tuple(said)), problem, recording)


def _load_tests(
    request: Request,
    recording: Recording,
    robot: Robot,
    T: Array,
    masses: Masses | None,
    laws: list[tuple[str, userterms.Offer]],
    known: Stiffness | None,
    copies: NDArray[np.bool_],
    options: engine.Options,
) -> tuple[Diagnosis, Problem]:
    tests = record.where_it_stands(experiment(recording, robot, T), recording, robot, T, masses)
    memo: dict[str, History] = {}
    terms = None
    if known is not None and known.terms:  # what they add to the springs
        r = deflection.readings_of(recording, tests, robot, T, masses, 1.0 / known.joints, memo)
        lived, settled = at_joint.lived_through(r, known.terms)
        whole = ArmElasticity(robot, T, replace(known, terms=settled), masses=masses).at(recording.q)
        springs = ArmElasticity(robot, T, Stiffness(known.joints)).at(recording.q)
        terms = lived + whole.respond(tests.wrench) - springs.respond(tests.wrench)

    def build(compliance: Array | None) -> tuple[Problem, Catalogue]:
        problem, catalogue, readings = deflection.build(recording, tests, robot, T, masses, compliance, memo, terms)
        own = userterms.offered(laws, readings)
        return problem, replace(catalogue, hypotheses=(*catalogue.hypotheses, *own))

    problem, catalogue = build(None)
    if copies.any():
        problem = replace(problem, excluded=copies)
    _refuse_too_few(problem, recording)
    rebuild = _excluding(lambda x: build(np.maximum(x[:6], 0.0)), copies)
    rng = np.random.default_rng(request.seed)
    d = engine.diagnose(problem, catalogue, replace(options, predicted="load tests"), rng, rebuild)
    return d, problem


def _refuse_too_few(problem: Problem, recording: Recording) -> None:
    """Raise where what is refitted in any case could make up every reading."""
    unknowns = sum(u.prior is None for u in problem.unknowns)
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


def _excluding(rebuild: engine.Rebuild, rows: NDArray[np.bool_]) -> engine.Rebuild:
    if not rows.any():
        return rebuild

    def again(x: Array) -> tuple[Problem, Catalogue]:
        problem, catalogue = rebuild(x)
        return replace(problem, excluded=rows), catalogue

    return again


def _motion(request: Request, cell: Cell, recording: Recording, options: engine.Options) -> _Found:
    """Time series."""
    motion.refuse_other_joints(recording, cell)
    if request.toolpath is not None and (len(cell.arm_joints) != 6 or cell.arm_prismatic):
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
                "; of current1_A … nothing says the torque: times torque constant and gear ratio it is tau1_Nm"
                if recording.current is not None
                else ""
            ),
            file=recording.source,
        )
    channel = possible[0] if request.channel == "auto" else request.channel
    if channel not in possible:
        raise InputError(f"found {channel}; this recording allows {', '.join(possible)}", where="--channel")
    rng = np.random.default_rng(request.seed)
    options.progress(f"signals and equations, channel {channel}")
    problem, catalogue, notes, found = motion.build(recording, cell, channel, rng)
    words = {
        "torque": "stretches of joint torque",
        "link": "stretches of link-side position",
        "tip": "stretches of tip",
    }
    d = engine.diagnose(problem, catalogue, replace(options, predicted=words[channel]), rng)
    # what leaves the record as it is, like a lag behind the command, changes no error of this channel
    beside = [f if f.record else replace(f, before=d.heldout_before, after=d.heldout_before) for f in found]
    return _Found(_with_record(d, beside, None, notes, recording.warnings), problem, recording)


def _with_record(
    d: Diagnosis, mended: list[Finding], gross: Finding | None, notes: tuple[str, ...], warnings: tuple[str, ...]
) -> Diagnosis:
    """The diagnosis with what was wrong with the record: mended things first, gross rows last."""
    findings = (*mended, *d.findings, *(() if gross is None else (gross,)))
    before, explained, verdict = d.heldout_before, d.explained, d.verdict
    if mended:  # the record was part of the mismatch: counted from what it left as it was
        before = max([before, *(f.before for f in mended if np.isfinite(f.before))])
        beyond, left = before**2 - d.noise_floor**2, max(d.heldout_after**2 - d.noise_floor**2, 0.0)
        explained = float(np.clip(1.0 - left / beyond, 0.0, 1.0)) if beyond > 0 else d.explained
    if len(findings) > len(d.findings):
        verdict = (
            "explained"
            if d.verdict in ("consistent", "explained") or explained >= engine.CLOSED
            else ("partly_explained")
        )
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


def _masses(cell: Cell) -> Masses | None:
    try:
        masses = load_masses(cell)
    except InputError:
        return None
    return masses if masses.mass.sum() > 0 else None


def _write_model(folder: Path, stiffness: Stiffness | None) -> str | None:
    if stiffness is None:
        return None
    write_stiffness(folder / "stiffness.yaml", stiffness)
    load_stiffness(folder / "stiffness.yaml")  # what optimize cannot read is not written
    return "stiffness.yaml"


def _write_kinematics(folder: Path, cell: Cell, d: Diagnosis) -> str | None:
    found = tuple(f.correction for f in d.findings if isinstance(f.correction, KinematicCorrection))
    if not found:
        return None
    known: Kinematics | None = cell.kinematics
    write_kinematics(folder / "kinematics.yaml", extended(known, found))
    return "kinematics.yaml"
