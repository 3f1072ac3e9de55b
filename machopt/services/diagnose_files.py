"""Files of ``machopt diagnose`` beside result and page, and what it says of a toolpath."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from machopt.diagnose.nouns.problem import Problem
from machopt.diagnose.nouns.result import Diagnosis
from machopt.domain.cell import Cell
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.domain.recording import Recording
from machopt.domain.results.diagnosis import EffectOnJob
from machopt.domain.stiffness import Stiffness
from machopt.effects.corrections import extended
from machopt.formats.kinematics import write_kinematics
from machopt.formats.options import load_options
from machopt.formats.residuals import write_residuals_csv
from machopt.formats.setups import placed
from machopt.formats.stiffness import load_stiffness, write_stiffness
from machopt.formats.toolchoice import with_tool
from machopt.formats.unknownwords import read_for_plan
from machopt.report.gather.diagnose import places_of
from machopt.services.knownrobot import reading_of

STIFFNESS, KINEMATICS = "stiffness.yaml", "kinematics.yaml"
_UNITS = {"N·m": "Nm", "µm": "um"}  # in column names


def write_residuals(
    path: Path, recording: Recording | Sequence[Recording], diagnosis: Diagnosis, problem: Problem | None = None
) -> None:
    """``residuals.csv``: line, pose, session, used, and the residual before and after in each coordinate."""
    page = places_of(recording, diagnosis, problem)
    prefix = "d" if diagnosis.channel == "deflection" else ""
    names = [
        f"{prefix if c.name in 'xyz' else ''}{c.name.replace(' ', '')}_{_UNITS.get(c.unit, c.unit)}"
        for c in page["coordinates"]
    ]
    write_residuals_csv(
        path,
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


def write_model(folder: Path, stiffness: Stiffness | None) -> None:
    """``stiffness.yaml``, where there is one."""
    if stiffness is None:
        return
    write_stiffness(folder / STIFFNESS, stiffness)
    load_stiffness(folder / STIFFNESS)  # what optimize cannot read is not written


def corrections_of(d: Diagnosis) -> tuple[KinematicCorrection, ...]:
    """What is not elastic of what was found."""
    return tuple(f.correction for f in d.findings if isinstance(f.correction, KinematicCorrection))


def write_corrections(folder: Path, cell: Cell, d: Diagnosis) -> None:
    """``kinematics.yaml``, where something belongs there."""
    found = corrections_of(d)
    if not found:
        return
    known: Kinematics | None = cell.kinematics
    write_kinematics(folder / KINEMATICS, extended(known, found))


def effect_of(
    cell: Cell,
    toolpath: Path | None,
    before: Stiffness | None,
    after: Stiffness | None,
    overrides: tuple[str, ...] = (),
) -> EffectOnJob | None:
    """What the findings change for a toolpath, against the cell as it stands; None without one or without two models.

    Args:
        cell: as it stands.
        toolpath: its file.
        before: springs refitted alone, of a cell that states none.
        after: with what was found.
        overrides: planning options, ``key=value``; they win over the cell's.
    """
    before = cell.stiffness or before
    if toolpath is None or after is None or before is None:
        return None
    from machopt.diagnose.written.onjob import effect_on_job  # the planner takes a second to load

    path = placed(read_for_plan(toolpath, **reading_of(cell)), cell)
    return effect_on_job(with_tool(cell, path), before, after, path, load_options(cell.plan, overrides=overrides))
