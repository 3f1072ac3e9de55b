"""Single rows of a record that cannot be: far from what the model and all others say, or copied from the row before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from machopt.diagnose import calibrated
from machopt.diagnose.evidence.aside import comes_back
from machopt.diagnose.nouns.problem import Problem as Equations
from machopt.diagnose.nouns.repaired import exact, repaired
from machopt.diagnose.nouns.result import Diagnosis, Finding
from machopt.diagnose.record.pasted import coarse
from machopt.domain.location import located, rows_at
from machopt.domain.recording import Recording
from machopt.effects.record import OUTLIERS

Flags = NDArray[np.bool_]
SLIP = (10.0, 100.0, 1000.0)


def outliers(
    recording: Recording, diagnosis: Diagnosis, copies: Flags, problem: Equations, certain: Flags | None = None
) -> Finding | None:
    """Gross rows as a finding, where they are more than a tracker makes, or plainly a clerk's.

    Args:
        recording: as diagnosed.
        diagnosis: with the readings put aside.
        copies: (N,) rows that repeat the displacement of the row before under another load.
        problem: which readings are twins.
        certain: (N,) rows of these that hold another pose's reading, which are said however few they are.
    """
    out = ~diagnosis.used
    aside = out & ~comes_back(problem, diagnosis.errors.final, out)
    if not aside.any():
        return None
    measured = recording.displacement if recording.kind == "deflection" else recording.position
    slips = np.zeros(len(aside), bool)
    if measured is not None:
        d = measured[:, :3]
        predicted = d - diagnosis.errors.final[:, :3]
        noise = calibrated.RECORD.fits * 1e-3 * diagnosis.noise_floor
        for f in SLIP:
            large = (np.abs(d / f - predicted) < noise) & (np.abs(predicted) > calibrated.RECORD.slip_up * noise)
            small = (np.abs(d - predicted / f) < noise) & (np.abs(predicted) > calibrated.RECORD.slip_down * noise)
            slips |= aside & (large | small).any(axis=1)
    clerical = int((slips | (copies & aside)).sum())
    share = float(aside.mean())
    if share <= calibrated.RECORD.ordinary and (
        clerical < calibrated.RECORD.clerical or clerical < calibrated.RECORD.mostly * aside.sum()
    ):
        aside = aside & (np.zeros(len(aside), bool) if certain is None else certain)
        clerical = int(aside.sum())
    if not aside.any():
        return None
    where = rows_at(problem.row[aside].tolist())
    count = float(aside.sum())
    # that Gaussian noise makes even one of these rows
    by_noise = float(min(2.0 * ndtr(-calibrated.NOISE.gross) * diagnosis.errors.final.size, 1.0))
    return repaired(
        OUTLIERS.name,
        where,
        f"{clerical} look like slipped decimals or copied rows" if clerical else "",
        diagnosis.heldout_before,
        diagnosis.heldout_after,
        by_noise,
        {"count": exact(count)},
        law="gross errors",
        equation="residual beyond six robust standard deviations",
        stated={"rows": located(where).which},
    )


def copied(recording: Recording) -> Flags:
    """(N,) rows that repeat the measured values of the row before although the load or the pose is another."""
    values = recording.displacement if recording.kind == "deflection" else recording.position
    out = np.zeros(len(recording), bool)
    if values is None:
        return out
    v = values[:, :3]
    if coarse(v):
        return out
    same = (v[1:] == v[:-1]).all(axis=1) & v[1:].any(axis=1)
    moved = (recording.q[1:] != recording.q[:-1]).any(axis=1) & (recording.pose[1:] != recording.pose[:-1])
    if recording.wrench is not None:
        size = max(float(np.linalg.norm(recording.wrench[:, :3], axis=1).max()), 1e-9)
        change = np.linalg.norm(np.diff(recording.wrench[:, :3], axis=0), axis=1)
        moved |= change > calibrated.RECORD.different_load * size
    out[1:] = same & moved
    return out
