"""``machopt diagnose``: from a cell and a recording to what the model leaves out, the extended model, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.diagnose import engine, userterms
from machopt.diagnose.asked import Request, check
from machopt.diagnose.extended import beside, stiffness_of
from machopt.diagnose.result import Diagnosis
from machopt.diagnose.run import at_rest, in_motion
from machopt.diagnose.told import result_of
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.effects.own import Own, in_use, run
from machopt.formats.cell import load_cell
from machopt.formats.recording import load_recording, load_recordings
from machopt.output import output_folder, write_result
from machopt.report.diagnosis_page import write_diagnosis
from machopt.report.gather.diagnose import page_of
from machopt.services.diagnose_files import effect_of, write_corrections, write_model, write_residuals
from machopt.services.inputs import input_hashes, recording_inputs, single
from machopt.services.manifest import write_command_manifest

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What came out."""

    diagnosis: Diagnosis
    result: DiagnosisResult
    report: Path


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
    moving = recording.kind == "motion"
    cell = load_cell(request.cell, allow_external=request.allow_external, any_chain=moving)
    laws = userterms.load(own)
    check(request, recording.kind)
    options = engine.Options(most=request.max_findings, progress=progress)
    with output_folder(request.out) as folder:
        if moving:
            asked, job = request.channel, request.toolpath is not None
            found = in_motion(cell, recording, options, asked=asked, seed=request.seed, toolpath=job)
        else:
            found = at_rest(cell, recording, options, laws, accept=request.accept, seed=request.seed)
        made = stiffness_of(cell, found.diagnosis)
        d = beside(replace(found.diagnosis, warnings=(*cell.warnings, *found.diagnosis.warnings)), made)
        progress("writing the model and tables")
        model = write_model(folder, made.after)
        kinematics = write_corrections(folder, cell, d)
        if request.toolpath is not None and made.after is not None and made.before is not None:
            progress("what it changes for the toolpath")
        effect = effect_of(cell, request.toolpath, made.before, made.after)
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
