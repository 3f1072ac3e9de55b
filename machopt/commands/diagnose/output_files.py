"""Files of ``machopt diagnose`` other than result and page, and its statement about a toolpath."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from machopt.cell.kinematics_file import write_kinematics
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.cell.tool_selection import select_single_tool
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.data_types.documents.diagnosis_document import JobEffectSection
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness
from machopt.effects.kinematic_corrections import extend_kinematics
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.options.plan_option_reader import load_options
from machopt.output.tables.residuals_table import ResidualsTable, write_residuals_csv
from machopt.report.page_data.diagnosis import locate_readings
from machopt.toolpath.unknown_words import read_for_plan

STIFFNESS, KINEMATICS = "stiffness.yaml", "kinematics.yaml"
_UNITS = {"N·m": "Nm", "µm": "um"}  # in column names


def write_residual_table(
    path: Path,
    recording: Recording | Sequence[Recording],
    diagnosis: DiagnosisResult,
    problem: DiagnosisProblem | None = None,
) -> None:
    """Write ``residuals.csv``: line, pose, session, used, and the residual before and after in each coordinate.

    Args:
        path: The file to write.
        recording: The recording, or the recordings that were joined.
        diagnosis: The diagnosis.
        problem: The equations of the diagnosis; None where they were not built.
    """
    page = locate_readings(recording, diagnosis, problem)
    prefix = "d" if diagnosis.channel == "deflection" else ""
    names = [
        f"{prefix if c.name in 'xyz' else ''}{c.name.replace(' ', '')}_{_UNITS.get(c.unit, c.unit)}"
        for c in page["coordinates"]
    ]
    table = ResidualsTable(
        row=page["row"],
        line=page["line"],
        file=page["file"],
        pose=page["pose"],
        session=page["session"],
        used=diagnosis.used,
        names=names,
        factors=[c.factor for c in page["coordinates"]],
        before=diagnosis.errors.residual,
        after=diagnosis.errors.final,
    )
    write_residuals_csv(path, table)


def write_stiffness_file(folder: Path, stiffness: ArmStiffness | None) -> None:
    """Write ``stiffness.yaml``, where there is a stiffness, and check that it can be read.

    Args:
        folder: The output folder.
        stiffness: The extended stiffness model; None where there is none.
    """
    if stiffness is None:
        return
    write_stiffness(folder / STIFFNESS, stiffness)
    load_stiffness(folder / STIFFNESS)  # what optimize cannot read is not written


def list_kinematic_corrections(d: DiagnosisResult) -> tuple[KinematicCorrection, ...]:
    """Return the kinematic corrections that are written, named or not.

    Args:
        d: The diagnosis.
    """
    return tuple(f.correction for f in (*d.findings, *d.unnamed) if isinstance(f.correction, KinematicCorrection))


def write_kinematics_file(folder: Path, cell: Cell, d: DiagnosisResult) -> None:
    """Write ``kinematics.yaml``, where a kinematic correction was found.

    Args:
        folder: The output folder.
        cell: The robot cell.
        d: The diagnosis.
    """
    found = list_kinematic_corrections(d)
    if not found:
        return
    known: KinematicCorrections | None = cell.kinematics
    write_kinematics(folder / KINEMATICS, extend_kinematics(known, found))


def compute_effect_on_job(
    cell: Cell,
    toolpath: Path | None,
    before: ArmStiffness | None,
    after: ArmStiffness | None,
    overrides: tuple[str, ...] = (),
) -> JobEffectSection | None:
    """What the findings change for a toolpath, against the cell as loaded; None without one or without two models.

    Args:
        cell: as loaded.
        toolpath: its file.
        before: springs refitted alone, of a cell that states none.
        after: with what was found.
        overrides: planning options, ``key=value``; they win over the cell's.
    """
    before = cell.stiffness or before
    if toolpath is None or after is None or before is None:
        return None
    from machopt.measurement.diagnosis.outputs.effect_on_toolpath import (
        compare_toolpath_plans,
    )  # the planner takes a second to load

    path = place_toolpath(read_for_plan(toolpath, get_reading_options(cell)), cell)
    return compare_toolpath_plans(
        select_single_tool(cell, path), before, after, path, load_options(cell.plan, overrides=overrides)
    )


def rank_findings_at_job(d: DiagnosisResult, effect: JobEffectSection | None) -> DiagnosisResult:
    """Return the diagnosis with its findings ranked by what they change at the job.

    Args:
        d: The diagnosis.
        effect: on the job; None: there is no job, and the order stays.
    """
    if effect is None:
        return d
    from machopt.measurement.diagnosis.outputs.effect_on_toolpath import rank_findings  # the planner loads slowly

    return replace(d, findings=rank_findings(d.findings, effect))
