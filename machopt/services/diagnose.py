"""``machopt diagnose``: from a cell and a recording to what the model leaves out, the extended model, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.diagnose.laws import userterms
from machopt.diagnose.nouns.asked import DiagnoseRequest, check
from machopt.diagnose.nouns.result import Diagnosis
from machopt.diagnose.run import at_rest, in_motion
from machopt.diagnose.search import engine
from machopt.diagnose.written.built import built
from machopt.diagnose.written.doubt import with_doubt
from machopt.diagnose.written.extended import beside, stiffness_of
from machopt.diagnose.written.told import result_of
from machopt.domain.cell import Cell
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.effects.own import Own, in_use, run
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.formats.recording import load_recording, load_recordings
from machopt.output import output_folder
from machopt.report.display import in_words
from machopt.report.gather.cell import cell_scene
from machopt.report.gather.diagnose import page_of
from machopt.services.diagnose_files import KINEMATICS, STIFFNESS, corrections_of, effect_of
from machopt.services.diagnosed import Diagnosed, write
from machopt.services.inputs import input_hashes, paths_read

Progress = Callable[[str], None]


@dataclass(frozen=True)
class DiagnoseOutcome:
    """What came out."""

    diagnosis: Diagnosis
    result: DiagnosisResult
    report: Path


def run_diagnose(request: DiagnoseRequest, progress: Progress = lambda _: None) -> DiagnoseOutcome:
    """Diagnose a recording of a cell's robot.

    Raises:
        InputError: bad cell, recording, laws or output folder.
    """
    own = run(request.terms)
    with in_use(own), output_folder(request.out, force=request.overwrite, inputs=paths_read(request)) as folder:
        refuse_without_pyarrow(request.tables)
        done = diagnosed(request, own, progress)
        write(done, folder, progress)
    return DiagnoseOutcome(done.diagnosis, done.result, request.out / "report.html")


def diagnosed(
    request: DiagnoseRequest, own: tuple[Own, ...], progress: Progress, cell: Cell | None = None
) -> Diagnosed:
    """What the model leaves out.

    Args:
        request: what was asked; its ``out`` is not looked at.
        own: the files of ``request.terms``, run and in use.
        cell: where it has been read already.
    """
    progress("reading cell and recording")
    paths = request.recordings
    recording = load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)
    moving = recording.kind == "motion"
    if cell is None:
        sliding = moving or any(recording.prismatic)
        cell = load_cell(request.cell, allow_external=request.allow_external, any_chain=sliding, bodies=False)
    laws = userterms.load(own)
    check(request, recording.kind)
    load_options(cell.plan, overrides=request.overrides)  # what is wrong with them is said before minutes of work
    options = engine.Options(most=request.most(recording.kind), progress=progress)
    if moving:
        asked, job = request.channel, request.toolpath is not None
        found = in_motion(cell, recording, options, asked=asked, seed=request.seed, toolpath=job)
        made = stiffness_of(cell, found.diagnosis)
    else:
        accept, seed = request.accept, request.seed
        found, made = built(
            cell, lambda barred: at_rest(cell, recording, options, laws, accept=accept, seed=seed, barred=barred)
        )
        progress("what the model may still lack")
    made = replace(made, after=with_doubt(cell, found, made.after))
    d = beside(replace(found.diagnosis, warnings=(*cell.warnings, *found.diagnosis.warnings)), made)
    if request.toolpath is not None and made.after is not None and made.before is not None:
        progress("what it changes for the toolpath")
    effect = effect_of(cell, request.toolpath, made.before, made.after, request.overrides)
    inputs = input_hashes(cell, request.recordings)
    said = request.said(recording.kind)
    result = result_of(
        cell,
        found.recording,
        d,
        model=None if made.after is None else STIFFNESS,
        kinematics=KINEMATICS if corrections_of(d) else None,
        effect_on_job=effect,
        options=said,
        inputs=inputs,
    )
    scene = None if moving else cell_scene(cell)[0]
    facts = tuple((k, in_words(v)) for k, v in (said | inputs).items())
    return Diagnosed(
        request=request,
        cell=cell,
        recording=found.recording,
        problem=found.problem,
        diagnosis=d,
        model=made.after,
        page=page_of(cell, found.recording, d, facts, effect, problem=found.problem, scene=scene),
        result=result,
    )
